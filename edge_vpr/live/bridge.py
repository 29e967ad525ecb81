"""Simulated camera: sends a recording over a link as a device would.

Its links are the device's ends of those in `links`.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import select
import socket
import termios
import threading
import time
import tty
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr.events import Events
from edge_vpr.live.links import (
    DescriptorLink,
    Link,
    LinkClosed,
    LinkError,
    SocketLink,
    TcpLink,
    address_of,
    as_link_error,
    bracketed,
    host_port,
    listening_socket,
    open_serial,
)
from edge_vpr.live.protocols import Encoder

# The device's ends of links.


#: Largest datagram, which fits into one Ethernet packet.
DATAGRAM_BYTES = 1_400


class VirtualLink(DescriptorLink):
    """The device's end of a pseudo-terminal; a host opens its `address`."""

    def __init__(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        super().__init__(os.ttyname(slave), master)
        # held open, so that a host can connect and disconnect
        self._slave = slave
        self._as_made = termios.tcgetattr(slave)

    def opened(self) -> bool:
        """Return whether a host has configured the terminal, as hosts do with a serial port."""
        return termios.tcgetattr(self._slave) != self._as_made

    def drain(self, timeout: float) -> bool:
        """Wait until the host has read everything, and return whether it has.

        Closing a terminal discards the rest.
        """
        end, quiet = time.monotonic() + timeout, 0
        while time.monotonic() < end and quiet < 3:
            waiting = fcntl.ioctl(self._slave, termios.FIONREAD, b"\0\0\0\0")
            quiet = 0 if any(waiting) else quiet + 1
            time.sleep(0.02)
        return quiet == 3

    def close(self) -> None:
        """See `Link.close`."""
        if self._fd >= 0:
            os.close(self._slave)
        super().close()


class TcpServerLink(Link):
    """TCP port of a bridge, for one host; others are refused."""

    def __init__(self, host: str, port: int) -> None:
        self._server = listening_socket(host, port, "listen on tcp://")
        super().__init__(address_of("tcp", self._server))
        self._host: TcpLink | None = None

    def accepted(self, timeout: float) -> TcpLink | None:
        """Return the link to the host once one is connected, after at most `timeout` seconds."""
        if self._host is None and select.select([self._server], [], [], timeout)[0]:
            self._host = TcpLink(self.address, self._server.accept()[0])
            self._server.close()
        return self._host

    def read(self, timeout: float) -> bytes:
        """See `Link.read`."""
        host = self.accepted(timeout)
        return host.read(timeout) if host else b""

    def write(self, data: bytes, timeout: float) -> int:
        """See `Link.write`."""
        host = self.accepted(timeout)
        return host.write(data, timeout) if host else 0

    def drain(self, timeout: float) -> bool:
        """Wait until the host hangs up, and return whether it has.

        Closing while bytes of the host are unread discards what it has not read.
        """
        end = time.monotonic() + timeout
        with contextlib.suppress(LinkError):
            if self._host is not None:
                self._host.end()
                while time.monotonic() < end:
                    self._host.read(0.1)
                return False
        return True

    def close(self) -> None:
        """See `Link.close`."""
        if self._host is not None:
            self._host.close()
        self._server.close()


class UdpSenderLink(SocketLink):
    """UDP sender of a bridge, which cannot know whether its datagrams arrive."""

    two_way = False

    def __init__(self, host: str, port: int) -> None:
        with as_link_error(f"udp://{host}:{port}"):
            resolved = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            # not connected, because a missing receiver would then be an error
            sock = socket.socket(resolved[0], socket.SOCK_DGRAM)
        self._to = resolved[4]
        super().__init__(f"udp://{bracketed(host)}:{port}", sock)

    def read(self, timeout: float) -> bytes:
        """Wait."""
        time.sleep(timeout)
        return b""

    def _put(self, data: bytes) -> int:
        return self._socket.sendto(data[:DATAGRAM_BYTES], self._to)


def open_device_link(address: str, *, baud: int = 115_200, flow_control: bool = False) -> Link:
    """Open the device's end of a link, for a bridge.

    Parameters
    ----------
    address : str
        ``virtual`` for a pseudo-terminal, ``tcp://[HOST]:PORT`` to listen (port 0: any free one;
        loopback unless a host is named), ``udp://HOST:PORT`` to send to, or a serial port.
    """
    if address == "virtual":
        return VirtualLink()
    if address.startswith("tcp://"):
        return TcpServerLink(*host_port(address))
    if address.startswith("udp://"):
        return UdpSenderLink(*host_port(address))
    return open_serial(address, baud, flow_control=flow_control)


# Replay of a recording, with or without faults of the line.


#: Intervals at which events are sent, and at which an idle device reports that it is idle.
SLICE_US = 5_000
IDLE_US = 100_000
_AT_ONCE = 1 << 16


@dataclass(frozen=True)
class LineFaults:
    """Faults of a bad line.

    Parameters
    ----------
    drop, flip, insert : float
        Chance of each byte to vanish, to have one bit inverted, to be followed by a random one.
    garbage : int
        Random bytes before the start.
    stall : float
        Seconds of silence, once; events queue up.
    stall_at : float
        When, in seconds of the recording.
    """

    drop: float = 0.0
    flip: float = 0.0
    insert: float = 0.0
    garbage: int = 0
    stall: float = 0.0
    stall_at: float = 1.0

    @classmethod
    def parse(cls, text: str) -> LineFaults:
        """Read ``drop=1e-4,flip=1e-5,stall=5@20``, where the stall begins at 20 s."""
        largest = {"drop": 1.0, "flip": 1.0, "insert": 1.0, "garbage": 1e6, "stall": 3_600.0}
        values: dict[str, float] = {}
        for item in filter(None, text.split(",")):
            name, _, value = item.partition("=")
            if name == "stall":
                value, later, at = value.partition("@")
                values["stall_at"] = _number(at) if later else cls.stall_at
            values[name] = _number(value)
            if (
                name not in largest
                or not 0 <= values[name] <= largest[name]
                or not 0 <= values.get("stall_at", 0.0) < math.inf
            ):
                raise UsageError(
                    f"fault {item!r}: expected one of {', '.join(largest)} and a value, for "
                    "example drop=1e-4,stall=5@20"
                )
        garbage = int(values.pop("garbage", 0))
        return cls(garbage=garbage, **values)

    def corrupt(self, data: bytes, rng: np.random.Generator) -> bytes:
        """Return the bytes that arrive when `data` is sent."""
        raw = np.frombuffer(data, dtype=np.uint8).copy()
        if self.flip:
            hit = rng.random(raw.size) < self.flip
            raw[hit] ^= (1 << rng.integers(0, 8, int(hit.sum()))).astype(np.uint8)
        if self.insert:
            at = np.flatnonzero(rng.random(raw.size) < self.insert)
            raw = np.insert(raw, at, rng.integers(0, 256, at.size).astype(np.uint8))
        if self.drop:
            raw = raw[rng.random(raw.size) >= self.drop]
        return raw.tobytes()


def _number(text: str) -> float:
    """Return a number; NaN if it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


class Bridge:
    """Replays events.

    Parameters
    ----------
    speed : float
        Times real time; 0 is as fast as the link takes it.
    seed : int
        Of the faults.

    Attributes
    ----------
    sent_events, sent_bytes : int
        Before the faults.
    behind_s : float
        How much later than at their time events were sent, at most; 0 without a speed.
    """

    def __init__(
        self,
        link: Link,
        encoder: Encoder,
        *,
        speed: float = 1.0,
        faults: LineFaults | None = None,
        seed: int = 0,
    ) -> None:
        self._link, self._encoder, self._speed = link, encoder, speed
        self._faults = LineFaults() if faults is None else faults
        self._rng = np.random.default_rng(seed)
        self.stopping = threading.Event()
        self.sent_events = self.sent_bytes = 0
        self.behind_s = 0.0

    def wait_for_host(self) -> None:
        """Wait until a host has connected and, if the protocol requires it, has sent a request."""
        while not self.stopping.is_set():
            if self._encoder.waits_for_host and self._link.two_way:
                command = self._link.read(0.1)
                if command:
                    self._send(self._encoder.respond(command), corrupt=False)
                    return
            elif isinstance(self._link, TcpServerLink):
                if self._link.accepted(0.1):
                    return
            elif isinstance(self._link, VirtualLink) and not self._link.opened():
                self.stopping.wait(0.05)
            else:
                # opening a terminal discards bytes that came before
                self.stopping.wait(0.5)
                return

    def run(self, recording: Iterable[Events]) -> None:
        """Send everything; stop early if `stopping` is set or the host has gone."""
        try:
            self.wait_for_host()
            garbage = self._rng.integers(0, 256, self._faults.garbage).astype(np.uint8)
            self._put(garbage.tobytes())
            self._send(self._encoder.start(), corrupt=False)
            self._replay(recording)
            if isinstance(self._link, VirtualLink | TcpServerLink):
                self._drain(self._link)
        except LinkClosed:
            return

    def _drain(self, link: VirtualLink | TcpServerLink) -> None:
        """Wait for the host, at most 10 s, and a second after `stopping` is set."""
        end, stopped = time.monotonic() + 10.0, False
        while not link.drain(0.1) and time.monotonic() < end:
            if self.stopping.is_set() and not stopped:
                end, stopped = min(end, time.monotonic() + 1.0), True

    def _replay(self, recording: Iterable[Events]) -> None:
        start_s, stalled, now = time.monotonic(), self._faults.stall == 0, 0
        for chunk in recording:
            cuts = [0, *(np.flatnonzero(np.diff(chunk.t // SLICE_US)) + 1).tolist(), len(chunk)]
            parts = [chunk[a:b] for a, b in pairwise(cuts)] if self._speed else [chunk]
            for events in parts:
                if self.stopping.is_set():
                    return
                due = int(events.t[-1]) if events.size else now
                while self._speed and now + IDLE_US < due and not self.stopping.is_set():
                    now += IDLE_US
                    self._serve_until(start_s + now / 1e6 / self._speed)
                    self._send(self._encoder.idle(now))
                now = due
                if self._speed:
                    moment_s = start_s + now / 1e6 / self._speed
                    late_s = time.monotonic() - moment_s
                    # a stall was asked for
                    if late_s > max(self.behind_s, self._faults.stall):
                        self.behind_s = late_s
                    self._serve_until(moment_s)
                else:
                    self._serve(0.0)
                if not stalled and now >= 1e6 * self._faults.stall_at:
                    stalled = True
                    self.stopping.wait(self._faults.stall)
                self._send(self._encoder.encode(events))
                self.sent_events += events.size
        self._send(self._encoder.idle(now))

    def _serve(self, timeout: float) -> None:
        """Answer the host for at most `timeout` seconds."""
        command = self._link.read(timeout)
        if command:
            self._send(self._encoder.respond(self._faults.corrupt(command, self._rng)))

    def _serve_until(self, moment: float) -> None:
        while not self.stopping.is_set():
            wait = moment - time.monotonic()
            self._serve(min(max(wait, 0.0), 0.1))
            if wait <= 0:
                return

    def _send(self, data: bytes, *, corrupt: bool = True) -> None:
        self.sent_bytes += len(data)
        self._put(self._faults.corrupt(data, self._rng) if data and corrupt else data)

    def _put(self, data: bytes) -> None:
        view = memoryview(data)
        while view and not self.stopping.is_set():
            view = view[self._link.write(bytes(view[:_AT_ONCE]), 0.1) :]
