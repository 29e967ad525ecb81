"""OpenMV's protocol, version 2: events of a camera with a GENX320, requested or unrequested.

The camera has named channels. A script on it registers ``events`` or ``raw_events``, whose number
is in the list of channels. `docs/stream.md` names the scripts.
"""

from __future__ import annotations

import copy

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.events import Events, Sensor, make_events
from edge_vpr.recordings.columns import Columns
from edge_vpr.stream.protocols.openmv_device import CameraEncoder, PushingEncoder
from edge_vpr.stream.protocols.openmv_host import POLL_S, Session
from edge_vpr.stream.protocols.openmv_listening import ListeningDecoder, PacketDecoder
from edge_vpr.stream.protocols.openmv_packets import BAUD, Flag, Opcode, Packet, PacketFinder
from edge_vpr.stream.protocols.openmv_records import (
    FORMATS,
    EventRecords,
    Records,
    open_maker,
    open_records,
)
from edge_vpr.stream.protocols.protocol import Decoder, Encoder, OptionReader


class AskingDecoder(PacketDecoder):
    """Requests packets from a camera; a packet is delivered whole and undamaged, or not at all.

    If an answer began to arrive, its loss is known to the record: the camera has stated the number
    of bytes, and has freed them. If no part arrived, the camera may still hold the data. The camera
    does not report what it dropped before a request.

    Parameters
    ----------
    sensor : Sensor
    channel : str
        Name of the channel.
    records : Records
    acknowledge : bool
        Ask the camera to repeat lost packets. This is slower, as only one fragment is sent at a
        time.
    """

    baud = BAUD

    def __init__(
        self, sensor: Sensor, channel: str, records: Records, *, acknowledge: bool = False
    ) -> None:
        super().__init__(sensor, records)
        self._session = Session(channel, acknowledge)
        self._unanswered = 0
        #: of the current read: its bytes, bytes received or passed over, and records received
        self._size = self._position = self._came = 0

    def setup(self) -> bytes:
        """See `Decoder.setup`."""
        return self._session.opening()

    def to_send(self, now_s: float) -> bytes:
        """See `Decoder.to_send`."""
        session = self._session
        if session.overdue(now_s):
            self.health.retries += 1
            self._unanswered += session.awaited == Opcode.SYNC
            self._give_up()
            session.restart()
            # the rest of an incomplete packet will not come
            self._distrusted = len(self._pending)
        out = session.send(now_s)
        self.tick_s, self.remark = session.tick_s, session.remark
        if self._unanswered > 1:
            self.remark = (
                f"the camera does not answer: open a serial port at {BAUD} baud, and have "
                "firmware 5.0 or later on the camera"
            )
        return out

    def feed(self, data: bytes, host_us: int = 0) -> Events:
        """See `Decoder.feed`."""
        session, errors = self._session, self.health.crc_errors
        before = session.sequence, session.awaited
        events = super().feed(data, host_us)
        if (session.sequence, session.awaited) != before:
            session.wait_anew()
        if self.health.crc_errors > errors:
            session.hurry()
        return events

    def finish(self) -> Events:
        """See `Decoder.finish`."""
        events = super().finish()
        self._give_up()
        return events

    def gap(self, lost_bytes: int = 0) -> Events:
        """See `Decoder.gap`."""
        events = super().gap(lost_bytes)
        if not lost_bytes:
            # the caller that opened the link again has sent the opening command
            self._session.opening()
        return events

    def _lose_sync(self) -> None:
        self._give_up()
        self._session.restart()

    def warm_up(self) -> None:
        """See `Decoder.warm_up`; a scratch decoder speaks with a simulated camera."""
        scratch = copy.deepcopy(self)
        maker = open_maker(self._records.name, self.sensor)
        camera = CameraEncoder(self.sensor, self._session.name, maker)
        camera.start()
        camera.encode(make_events([0], [0], [0], [1]))
        command = scratch.setup()
        for step in range(20):
            scratch.feed(camera.respond(command))
            command = scratch.to_send(step * POLL_S)
        scratch.finish()

    def _aim(self, finder: PacketFinder) -> None:
        session = self._session
        finder.limit, finder.sequence = session.limit, session.sequence
        reading = session.awaited == Opcode.READ
        # data beyond the requested size is not joined, so that each packet is checked
        joins = reading and self._position < self._size
        finder.channel = session.channel if joins and session.channel is not None else -1

    def _take_joined(self, finder: PacketFinder, n_bytes: int) -> None:
        self._position += n_bytes
        self._session.sequence = finder.sequence

    def _take_bytes(self, raw: npt.NDArray[np.uint8], parts: list[Columns]) -> int:
        n = super()._take_bytes(raw, parts)
        self._came += n
        return n

    def _take_packet(self, packet: Packet, parts: list[Columns]) -> None:
        session, flags = self._session, packet.flags
        if flags & Flag.ACK_REQ:
            session.acknowledge(packet)
        if flags & Flag.EVENT:
            session.hear_event(packet)
            return
        if flags & Flag.RTX and packet.sequence != session.sequence:
            return  # received before; only its acknowledgement was lost
        self._unanswered = 0
        if (
            session.awaited == packet.opcode == Opcode.READ
            and packet.channel == session.channel
            and not flags & (Flag.ACK | Flag.NAK)
        ):
            self._take_fragment(packet, parts)
            return
        before = session.awaited
        session.hear(packet)
        if before == Opcode.READ != session.awaited:
            self._give_up()
        elif before != Opcode.READ == session.awaited:
            self._size, self._position, self._came = session.size, 0, 0
            self._rest, self._skip = b"", 0

    def _take_fragment(self, packet: Packet, parts: list[Columns]) -> None:
        """Decode a fragment of the requested data; all fragments but the last have one length."""
        session, n = self._session, len(packet.payload)
        missing = (packet.sequence - session.sequence) & 0xFF
        last = not packet.flags & Flag.FRAGMENT
        start = self._size - n if last else self._position + missing * n
        if (
            start < self._position
            or start + n > self._size
            or (start > self._position) != (missing > 0)
        ):
            # the fragment does not fit the request
            self.health.crc_errors += 1
            self._give_up()
            session.restart()
            return
        if missing:
            self.health.sequence_gaps += 1
            self._rest, self._skip = b"", -start % self._records.size
            self._records.lose()
        session.sequence = (packet.sequence + 1) & 0xFF
        self._position = start + n
        self._take_bytes(np.frombuffer(self._rest + packet.payload, dtype=np.uint8), parts)
        if last:
            self._account()
            session.poll()

    def _give_up(self) -> None:
        """Stop waiting for the requested data."""
        if self._position < self._size:
            self.health.sequence_gaps += 1
            self._account()

    def _account(self) -> None:
        """Count the missing records of the requested data."""
        missing = self._size // self._records.size - self._came
        if missing > 0:
            self.health.lost_at_most += missing * self._records.most
            if self._position and isinstance(self._records, EventRecords):
                self.health.lost += missing
            self._records.lose()
        self._size = self._position = self._came = 0
        self._rest, self._skip = b"", 0


def open_decoder(name: str, sensor: Sensor, options: OptionReader) -> Decoder:
    """Make a decoder."""
    channel, records_format = _channel(options)
    acknowledge = options.choice("ack", ("off", "on")) == "on"
    records = open_records(records_format)
    if isinstance(channel, int):
        return ListeningDecoder(sensor, channel, records)
    return AskingDecoder(sensor, channel, records, acknowledge=acknowledge)


def open_encoder(name: str, sensor: Sensor, options: OptionReader) -> Encoder:
    """Make an encoder."""
    channel, records_format = _channel(options)
    make = open_maker(records_format, sensor)
    if isinstance(channel, int):
        return PushingEncoder(sensor, channel, make)
    return CameraEncoder(sensor, channel, make)


def _channel(options: OptionReader) -> tuple[str | int, str]:
    """Read the name or number of the channel, and the format of its records."""
    channel = options.text("channel") or "events"
    records_format = options.choice("format", ("auto", *FORMATS))
    if records_format == "auto":
        # the formats of the maker's scripts
        records_format = "evt21" if channel == "raw_events" else "events"
    if not channel.isdigit():
        return channel, records_format
    if int(channel) > 255:
        raise UsageError(f"openmv: channel={channel}: expected 0 to 255, or a name")
    return int(channel), records_format
