"""Devices that the tests of streams speak as: a new protocol, or a format of one, is a row here."""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import struct
import termios
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edge_vpr.events import Events, Sensor
from edge_vpr.live.bridge import Bridge, LineFaults, open_device_link
from edge_vpr.live.links import Link
from edge_vpr.live.protocols import open_encoder
from edge_vpr.live.reader import Chunk
from edge_vpr.live.session import LiveSession
from edge_vpr.matching.match import Match


class Device(NamedTuple):
    """A device, and the host that listens to it."""

    sends: str  #: What `open_encoder` takes.
    host: str  #: What `open_decoder` takes.
    checked: bool = False  #: Whether a checksum guards each event.
    clock_bits: int = 0  #: Of a clock that wraps; 0 of one that does not.
    typical: bool = False  #: Whether whole sessions are tested with it.


DEVICES = (
    Device("evpr", "evpr", checked=True, typical=True),
    Device("evpr:width=3,frame=200", "evpr", checked=True),
    Device("edvs:format=E0", "edvs:format=E0"),
    Device("edvs:format=E1", "edvs:format=E1"),
    Device("edvs:format=E1,sync=0", "edvs:format=E1,sync=0"),
    Device("edvs:format=E2", "edvs:format=E2", clock_bits=16),
    Device("edvs", "edvs", clock_bits=24, typical=True),
    Device("edvs:format=E3,dialect=old", "edvs:format=E3,dialect=old", clock_bits=32),
    Device("edvs:format=E4,sync=0", "edvs:format=E4,sync=0", clock_bits=32),
    Device("evt2", "evt2", clock_bits=34, typical=True),
    Device("evt21", "evt21", clock_bits=34, typical=True),
    Device("evt3", "evt3", clock_bits=24, typical=True),
    Device("aer", "aer", clock_bits=16),
    Device("aer:layout=jaer8", "aer:layout=jaer8", clock_bits=32, typical=True),
)


def sent_by(pieces: Events | Iterable[Events], sensor: Sensor) -> bytes:
    """What a device of EVPR sends of events, or of pieces of them, from its opening on."""
    encoder = open_encoder("evpr", sensor)
    parts = [pieces] if isinstance(pieces, Events) else pieces
    return encoder.start() + b"".join(map(encoder.encode, parts))


def rows_of(log: Path | str, kind: str) -> list[dict[str, Any]]:
    """Rows of a kind in what `stream` prints with `--json`, or in its log."""
    text = log.read_text() if isinstance(log, Path) else log
    return [row for row in map(json.loads, text.splitlines()) if row["kind"] == kind]


def wait_until(condition: Callable[[], object], seconds: float = 60) -> None:
    """Wait until something holds; fail if that takes too long."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


def bytes_waiting(file: Any) -> int:
    """Bytes that the system holds for who reads a terminal or a pipe."""
    count: int = struct.unpack("i", fcntl.ioctl(file.fileno(), termios.FIONREAD, bytes(4)))[0]
    return count


def send_all(link: Link, data: bytes) -> None:
    """Write all bytes to a link; fail if the other side takes them too slowly."""
    end = time.monotonic() + 60
    while data:
        assert time.monotonic() < end
        data = data[link.write(data, 0.5) :]


def greeted(link: Link) -> None:
    """Wait until the host has said that it is there."""
    wait_until(lambda: link.read(0.1), 120)


class Clock:
    """The time for a module whose `time` a test replaces; it goes on when the test says so.

    Attributes
    ----------
    off_s : float
        By how much the time of day was set.
    """

    CLOCK_BOOTTIME = time.CLOCK_BOOTTIME

    def __init__(self) -> None:
        self.now_s = 1_000.0
        self.off_s = 1.7e9

    def clock_gettime_ns(self, clock: int) -> int:
        """As `time.clock_gettime_ns`."""
        return round(1e9 * self.now_s)

    def monotonic(self) -> float:
        """As `time.monotonic`."""
        return self.now_s

    def time(self) -> float:
        """As `time.time`."""
        return self.off_s + self.now_s

    def sleep(self, seconds: float) -> None:
        """Be later."""
        self.now_s += seconds


class TimedCamera:
    """Stands in for the reader of a line: each call brings what came in the last 10 ms.

    Parameters
    ----------
    silent_s, held_up_s : float
        When nothing more comes, on a line that stays for 5 s, and when the host stands for 3 s.
    """

    live = drops = True
    address, remark, lost_link, error = "camera", "", "", None
    line_errors, dead_s = 0, 0.0

    def __init__(
        self,
        clock: Clock,
        events: Events,
        sensor: Sensor,
        faults: str = "",
        silent_s: float = math.inf,
        held_up_s: float = math.inf,
    ) -> None:
        self.clock, self.events, self.begin_s = clock, events, clock.monotonic()
        self.encoder, self.sent = open_encoder("evpr", sensor), 0
        self.opening = self.encoder.start()
        self.faults, self.rng = LineFaults.parse(faults), np.random.default_rng(0)
        self.silent_s, self.held_up_s = silent_s, held_up_s

    @property
    def now_s(self) -> float:
        """Seconds since it began."""
        return self.clock.monotonic() - self.begin_s

    @property
    def ended(self) -> bool:
        """See `LinkReader.ended`."""
        return self.sent == self.events.size or self.now_s > self.silent_s + 5

    def take(self, timeout: float) -> Chunk | None:
        """See `LinkReader.take`."""
        self.clock.sleep(0.01)
        if self.now_s > self.held_up_s:
            self.clock.sleep(3)
            self.held_up_s = math.inf
        end = int(np.searchsorted(self.events.t, 1e6 * min(self.now_s, self.silent_s)))
        end = min(end, self.sent + 2_000)  # as many as a line brings in this time
        piece, self.sent = self.events[self.sent : end], end
        data = self.faults.corrupt(self.encoder.encode(piece), self.rng) if piece.size else b""
        data, self.opening = self.opening + data, b""
        return Chunk(data, self.clock.monotonic()) if data else None

    def send(self, data: bytes, timeout: float = 1.0) -> None:
        """See `LinkReader.send`."""

    def stop(self) -> None:
        """See `LinkReader.stop`."""


class Pipe(Link):
    """A link that a test fills: each read gives one piece. It knows who reads it.

    Attributes
    ----------
    filled : int
        Bytes so far.
    error : Exception, optional
        Raised once all pieces were read.
    """

    def __init__(self) -> None:
        super().__init__("pipe")
        self.waiting: list[bytes] = []
        self.filled = 0
        self.arrived = threading.Condition()
        self.readers: list[threading.Thread] = []
        self.within = 0
        self.error: Exception | None = None

    def fill(self, data: bytes) -> None:
        """Let a piece arrive."""
        with self.arrived:
            self.waiting += [data] if data else []
            self.filled += len(data)
            self.arrived.notify_all()

    def read(self, timeout: float) -> bytes:
        """See `Link.read`."""
        self.within += 1
        assert self.within == 1, "two read at once"
        try:
            with self.arrived:
                self.arrived.wait_for(lambda: self.waiting or self.error, timeout)
                if self.error is not None and not self.waiting:
                    raise self.error
                if not self.waiting:
                    return b""
                self.readers.append(threading.current_thread())
                return self.waiting.pop(0)
        finally:
            self.within -= 1

    def write(self, data: bytes, timeout: float) -> int:
        """See `Link.write`."""
        return len(data)

    def close(self) -> None:
        """See `Link.close`."""
        assert not self.within, "closed while it is read"


def polled(session: LiveSession, condition: Callable[[], object]) -> list[Match]:
    """Poll a session until something holds; return its matches."""
    matches: list[Match] = []

    def holds() -> object:
        matches.extend(session.poll())
        return condition()

    wait_until(holds)
    return matches


def fed(session: LiveSession, pipe: Pipe, data: bytes) -> list[Match]:
    """Give a session bytes that it gets in one read; return the matches until then."""
    pipe.fill(data)
    return polled(session, lambda: session.health.bytes == pipe.filled)


class Playing(NamedTuple):
    """A camera that sends to whoever opens its address, and hangs up at the end."""

    address: str
    bridge: Bridge
    thread: threading.Thread


def play(
    pieces: Iterable[Events],
    sensor: Sensor,
    device: str = "evpr",
    faults: LineFaults | None = None,
) -> Playing:
    """Send pieces of a recording as a device, as fast as the host takes them."""
    link = open_device_link("tcp://127.0.0.1:0")
    bridge = Bridge(link, open_encoder(device, sensor), speed=0, faults=faults)

    def run() -> None:
        with contextlib.closing(link):
            bridge.run(pieces)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return Playing(link.address, bridge, thread)
