"""Interface of protocols: decoders from pieces of bytes of any size to events, and encoders.

One registry is behind all of them: ``open_decoder("edvs:format=E3", sensor)``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Literal

from edge_vpr.errors import UsageError
from edge_vpr.events import Columns, Events, Sensor, join_events
from edge_vpr.live.protocols.health import UNKNOWN, Health
from edge_vpr.live.protocols.timestamps import Clock, TimestampFilter
from edge_vpr.plugins import Registry

__all__ = [
    "PROTOCOLS",
    "Clock",
    "Decoder",
    "Encoder",
    "Health",
    "OptionReader",
    "ProtocolName",
    "open_decoder",
    "open_encoder",
    "parse_protocol",
    "protocol_names",
]


class Decoder:
    """Decodes the bytes of one stream as they arrive.

    Parameters
    ----------
    accounting : {"exact", "unknown"}
        How well the number of events that never arrived is known.

    Attributes
    ----------
    resync_bytes : int
        Number of undamaged bytes after a fault that suffice to find the next event.
    baud : int
        Rate of a serial port, unless the user gives one.
    remark : str
        Current message for the user, if any.
    timestamps : TimestampFilter
        Checks the events, and keeps the clock.
    """

    resync_bytes: int = 0
    baud: int = 115_200
    remark: str = ""

    def __init__(self, sensor: Sensor, clock: Clock, accounting: str = UNKNOWN) -> None:
        self.sensor = sensor
        self.health = Health(accounting)
        self._pending = b""
        self._host_us = 0
        #: Whether the bytes come as they are sent, so that the clock cannot be ahead of the host's.
        self.live = False
        self.timestamps = TimestampFilter(sensor, clock, self.health)

    @property
    def reached_us(self) -> int:
        """Time up to which the stream is known: no later event is earlier than this."""
        return self.timestamps.reached_us

    def setup(self) -> bytes:
        """Return the commands to send when the link opens."""
        return b""

    def greeting(self) -> bytes:
        """Return what to send again and again while nothing comes.

        A device that starts, or restarts, after the link was opened has not seen `setup`.
        """
        return self.setup()

    def teardown(self) -> bytes:
        """Return the commands to send before the link closes."""
        return b""

    def feed(self, data: bytes, host_us: int = 0) -> Events:
        """Decode the next bytes.

        Parameters
        ----------
        data : bytes
            Of any number.
        host_us : int
            Arrival time on the host's clock; also the time of events that have none themselves.

        Returns
        -------
        Events
            In time order, on the sensor, and not earlier than those returned before; n may be 0.
        """
        self._host_us = host_us
        if self.live:
            self.timestamps.hear(host_us)
        self.health.bytes += len(data)
        return self._take(self._pending + data if self._pending else data, final=False)

    def gap(self, dropped_bytes: int = 0) -> Events:
        """Handle missing bytes before the next ones: an overrun, or a link that was disconnected.

        Returns
        -------
        Events
            Whole events that were waiting for bytes that will not come.
        """
        events = self._take(self._pending, final=True)
        self.health.skipped_bytes += len(self._pending)
        self._pending = b""
        self.health.pending_bytes = 0
        if dropped_bytes:
            self.health.overruns += 1
            self.health.overrun_bytes += dropped_bytes
        self._lose_sync()
        return events

    def finish(self) -> Events:
        """End the stream.

        Returns
        -------
        Events
            Whole events that were waiting for bytes that will not come.
        """
        events = self._take(self._pending, final=True)
        self.timestamps.finish()
        return events

    def _take(self, data: bytes, *, final: bool) -> Events:
        """Decode bytes, keep those that are left, and count the others as decoded or skipped."""
        health, skipped_before = self.health, self.health.skipped_bytes
        events, rest = self._decode_events(data, final=final)
        self._pending, health.pending_bytes = rest, len(rest)
        skipped = health.skipped_bytes - skipped_before
        health.decoded_bytes += len(data) - len(rest) - skipped
        return join_events(events)

    def _decode_events(self, data: bytes, *, final: bool) -> tuple[list[Events], bytes]:
        """Decode as `_decode` does, and filter the events."""
        parts, rest = self._decode(data, final=final)
        return [self.timestamps.admit(part) for part in parts], rest

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        """Decode as much as possible; return the events and the bytes to decode again later.

        All other bytes are counted in ``health.skipped_bytes``. With `final`, no bytes follow.
        """
        raise NotImplementedError

    def _lose_sync(self) -> None:
        """Search for the beginning of the next event."""


class Encoder(ABC):
    """Encodes events as the bytes of a device; for tests, bridges and firmware authors.

    Attributes
    ----------
    host_needs_options : bool
        Whether the bytes do not show the options of the protocol, so that a host is given them too.
    waits_for_host : bool
        Whether the device is silent until the host has sent something.
    """

    host_needs_options: bool = False
    waits_for_host: bool = False

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor

    def start(self) -> bytes:
        """Return the bytes that begin a stream."""
        return b""

    @abstractmethod
    def encode(self, events: Events) -> bytes:
        """Encode events, which are in time order and not earlier than those before."""

    def idle(self, now_us: int) -> bytes:
        """Return bytes that report a silence until `now_us`, if the protocol has such."""
        return b""

    def respond(self, command: bytes) -> bytes:
        """Return the answer to bytes that the host sent."""
        return b""


class OptionReader:
    """Reads the options of a protocol, each once; options that remain are errors."""

    def __init__(self, protocol: str, options: dict[str, str]) -> None:
        self._protocol, self._left = protocol, options
        self._names: list[str] = []

    def choice(self, name: str, allowed: tuple[str, ...]) -> str:
        """Read one of `allowed`; the first one if the option is absent."""
        self._names.append(name)
        value = self._left.pop(name, allowed[0])
        if value not in allowed:
            raise UsageError(
                f"{self._protocol}: {name}={value}: expected one of {', '.join(allowed)}"
            )
        return value

    def text(self, name: str) -> str | None:
        """Read any text; None if the option is absent."""
        self._names.append(name)
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
        """Raise UsageError for options that were not read."""
        if self._left:
            names = ", ".join(self._names) or "none"
            raise UsageError(
                f"{self._protocol} has no option {', '.join(self._left)}: it has {names}"
            )


# Protocols by name: built-in ones, and those that other packages register.


#: An entry point of this group names a module with ``open_decoder(name, sensor, options)`` and
#: ``open_encoder(name, sensor, options)``; both functions take an `OptionReader`.
GROUP = "edge_vpr.protocols"

ProtocolName = Literal["evpr", "edvs", "evt2", "evt21", "evt3", "aer"]
#: The protocols of this package, by the name that ``--protocol`` takes, and their modules.
PROTOCOLS: dict[str, str] = {
    "evpr": "edge_vpr.live.protocols.evpr",  # this project's frames: numbers, drop counts, CRC-32
    "edvs": "edge_vpr.live.protocols.edvs",  # eDVS E0 to E4
    "evt2": "edge_vpr.live.protocols.evt",  # raw Prophesee words
    "evt21": "edge_vpr.live.protocols.evt",
    "evt3": "edge_vpr.live.protocols.evt",
    "aer": "edge_vpr.live.protocols.aer",  # address-event words, described by a TOML layout
}
_REGISTRY = Registry(GROUP, PROTOCOLS)


def parse_protocol(text: str) -> tuple[str, dict[str, str]]:
    """Split text such as ``edvs`` or ``edvs:format=E3,sync=1`` into a name and options."""
    name, _, rest = text.partition(":")
    options = {}
    for item in filter(None, rest.split(",")):
        key, equals, value = item.partition("=")
        if not (key and equals and value):
            raise UsageError(
                f"protocol {text!r}: option {item!r} is not NAME=VALUE: write for example "
                "edvs:format=E3"
            )
        options[key] = value
    return name, options


def protocol_names() -> list[str]:
    """Return the names of all protocols, those of other packages last."""
    return _REGISTRY.names()


def open_decoder(protocol: str, sensor: Sensor) -> Decoder:
    """Make the decoder of a protocol.

    Parameters
    ----------
    protocol : str
        Name, with options after a colon: ``edvs:format=E3,sync=1``.
    """
    decoder: Decoder = _open("open_decoder", protocol, sensor)
    return decoder


def open_encoder(protocol: str, sensor: Sensor) -> Encoder:
    """Make the encoder of a protocol; see `open_decoder`."""
    encoder: Encoder = _open("open_encoder", protocol, sensor)
    return encoder


def _open(function: str, protocol: str, sensor: Sensor) -> Any:
    name, options = parse_protocol(protocol)
    module = _REGISTRY.load(name)
    if module is None:
        raise UsageError(
            f"protocol {name!r} is unknown: choose one of {', '.join(protocol_names())}"
        )
    reader = OptionReader(name, options)
    opened = getattr(module, function)(name, sensor, reader)
    reader.done()
    return opened
