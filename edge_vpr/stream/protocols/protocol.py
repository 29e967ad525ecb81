"""Interface of protocols: decoders from bytes in pieces of any size to events, and encoders."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr.events import Events, Sensor, join_events, make_events
from edge_vpr.recordings.source import Columns
from edge_vpr.stream.health import UNKNOWN, Health
from edge_vpr.stream.timestamp_filter import Clock, TimestampFilter

Options = Mapping[str, str]
"""What follows the colon in ``edvs:format=E3,sync=1``."""


class Decoder:
    """Takes the bytes of one stream as they come.

    Parameters
    ----------
    sensor : Sensor
    clock : Clock
    accounting : {"exact", "bound", "unknown"}
        How much the protocol can know of events that never arrived.

    Attributes
    ----------
    health : Health
    resync_bytes : int
        After a fault, the next event is found once so many undamaged bytes have followed.
    baud : int
        Of a serial port, where nothing else is said.
    tick_s : float
        `to_send` wants to be called so often while nothing comes.
    remark : str
        What the user should know now, if anything.
    """

    resync_bytes: int = 0
    baud: int = 115_200
    tick_s: float = 0.1
    remark: str = ""

    def __init__(self, sensor: Sensor, clock: Clock, accounting: str = UNKNOWN) -> None:
        self.sensor = sensor
        self.health = Health(accounting)
        self._pending = b""
        self._host_us = 0
        # time of the device after the newest event, if the protocol states it; else -1
        self._idle_at = -1
        self._timestamps = TimestampFilter(sensor, clock, self.health)

    def adopt(self, health: Health) -> None:
        """Count in the `health` of another decoder from now on."""
        self.health = self._timestamps.health = health

    @property
    def reached_us(self) -> int:
        """Time up to which the stream is known: no later event is earlier than this."""
        return self._timestamps.reached_us

    def warm_up(self) -> None:
        """Compile what decoding needs, which takes up to seconds, before the first bytes come.

        Neither the decoder's state nor its health changes.
        """
        for sample in self._samples():
            scratch = copy.deepcopy(self)
            scratch.feed(sample)
            scratch.gap(1)
            scratch.finish()

    def _samples(self) -> Iterable[bytes]:
        """Give streams that need, together, all of this decoder's kernels."""
        return ()

    def setup(self) -> bytes:
        """Return the commands to send when the link opens."""
        return b""

    def teardown(self) -> bytes:
        """Return the commands to send before the link closes."""
        return b""

    def to_send(self, now_s: float) -> bytes:
        """Return what to send to the device now; called after each chunk, and while none comes.

        Parameters
        ----------
        now_s : float
            On a clock that never goes back.
        """
        return b""

    def feed(self, data: bytes, host_us: int = 0) -> Events:
        """Take the next bytes.

        Parameters
        ----------
        data : bytes
            Any number of them.
        host_us : int
            When they came, on the host's clock; the time of events that have none themselves.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            In time order, on the sensor, after all those before; n may be 0.
        """
        self._host_us = host_us
        self.health.bytes += len(data)
        return self._take(self._pending + data if self._pending else data, final=False)

    def gap(self, lost_bytes: int = 0) -> Events:
        """Handle missing bytes before the next ones: an overrun, or a lost link.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            Events that were whole, and waited for bytes that will not come.
        """
        events = self._take(self._pending, final=True)
        self.health.skipped_bytes += len(self._pending)
        self._pending = b""
        self.health.pending_bytes = 0
        if lost_bytes:
            self.health.overruns += 1
            self.health.overrun_bytes += lost_bytes
        self._lose_sync()
        return events

    def finish(self) -> Events:
        """End the stream.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            Events that were whole, and waited for bytes that will not come.
        """
        events = self._take(self._pending, final=True)
        self._timestamps.finish()
        return events

    def _take(self, data: bytes, *, final: bool) -> Events:
        before = self.health.skipped_bytes
        events, self._pending = self._decode_events(data, final=final)
        used = len(data) - len(self._pending)
        self.health.decoded_bytes += used - (self.health.skipped_bytes - before)
        self.health.pending_bytes = len(self._pending)
        if self._idle_at >= 0:
            self._timestamps.reach(self._idle_at)
            self._idle_at = -1
        return join_events(events)

    def _decode_events(self, data: bytes, *, final: bool) -> tuple[list[Events], bytes]:
        """Decode as `_decode` does, and filter the events."""
        parts, rest = self._decode(data, final=final)
        return [self._timestamps.admit(part) for part in parts], rest

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        """Decode what can be decoded; return the events and the bytes to see again.

        Bytes that are neither events nor seen again are counted in ``health.skipped_bytes``. If
        `final`, nothing follows.
        """
        raise NotImplementedError

    def _lose_sync(self) -> None:
        """Forget where the next event begins."""


class Encoder(ABC):
    """Makes the bytes that a device would send; for tests, bridges and firmware authors."""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor

    def start(self) -> bytes:
        """Begin a stream."""
        return b""

    @abstractmethod
    def encode(self, events: Events) -> bytes:
        """Encode events, in time order, after all those before."""

    def idle(self, now_us: int) -> bytes:
        """Report that nothing happened until `now_us`, if the protocol can."""
        return b""

    def respond(self, command: bytes) -> bytes:
        """Answer what the host sent."""
        return b""

    def to_send(self, now_s: float) -> bytes:
        """Return what to send now without a request; called repeatedly."""
        return b""

    #: Whether the host speaks first, so that a device is silent until then.
    waits_for_host: bool = False
    #: Events that wait to be fetched by the host, and how many may; a device drops what is more.
    held: int = 0
    capacity: int = 0


def synthetic_events(n: int = 1_000) -> Events:
    """Make events that fit any sensor, to encode as a sample."""
    return make_events(np.arange(n) * 10, np.zeros(n), np.zeros(n), np.arange(n) % 2)


class OptionReader:
    """Reads a protocol's options, each once; what is left over is a mistake.

    Raises
    ------
    UsageError
        From `done`, if an option is unknown.
    """

    def __init__(self, protocol: str, options: Options) -> None:
        self._protocol = protocol
        self._left = dict(options)
        self._known: list[str] = []

    def choice(self, name: str, allowed: tuple[str, ...]) -> str:
        """Read one of `allowed`, the first if absent."""
        self._known.append(name)
        value = self._left.pop(name, allowed[0])
        if value not in allowed:
            raise UsageError(
                f"{self._protocol}: {name}={value}: expected one of {', '.join(allowed)}"
            )
        return value

    def text(self, name: str) -> str | None:
        """Read any text, None if absent."""
        self._known.append(name)
        return self._left.pop(name, None)

    def integer(self, name: str, default: int, low: int, high: int) -> int:
        """Read a whole number from `low` to `high`."""
        value = self.text(name)
        if value is None:
            return default
        if not value.isdigit() or not low <= int(value) <= high:
            raise UsageError(f"{self._protocol}: {name}={value}: expected {low} to {high}")
        return int(value)

    def done(self) -> None:
        """Raise for options that were not read."""
        if self._left:
            known = ", ".join(self._known) or "none"
            raise UsageError(
                f"{self._protocol} has no option {', '.join(self._left)}: it has {known}"
            )
