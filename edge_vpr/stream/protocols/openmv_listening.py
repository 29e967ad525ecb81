"""Decoding of OpenMV's packets to events, for decoders that send commands or only listen."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from edge_vpr.events import Events, Sensor, make_events
from edge_vpr.recordings.columns import Columns
from edge_vpr.stream.health import BOUND
from edge_vpr.stream.protocols.openmv_device import PushingEncoder
from edge_vpr.stream.protocols.openmv_packets import (
    HEADER,
    MAX_PACKET,
    MAX_PAYLOAD,
    Flag,
    Packet,
    PacketFinder,
)
from edge_vpr.stream.protocols.openmv_records import EventRecords, Records, open_maker
from edge_vpr.stream.protocols.protocol import Decoder


class PacketDecoder(Decoder):
    """Finds packets and decodes records; subclasses handle the packets."""

    resync_bytes = MAX_PACKET + HEADER.size

    def __init__(self, sensor: Sensor, records: Records) -> None:
        super().__init__(sensor, records.clock, BOUND)
        self._records = records
        self._finder = PacketFinder()
        self._distrusted = 0
        #: the beginning of a record, and the number of bytes to skip before the next record begins
        self._rest, self._skip = b"", 0

    def _take(self, data: bytes, *, final: bool) -> Events:
        events = super()._take(data, final=final)
        self._count_wraps()
        return events

    def finish(self) -> Events:
        """See `Decoder.finish`."""
        events = super().finish()
        self._count_wraps()
        return events

    def _count_wraps(self) -> None:
        """Count wraps of the 18.2 h clock; `TimestampFilter` counts only those of powers of two."""
        if isinstance(self._records, EventRecords):
            self.health.wraps = self._records.wraps

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        finder, parts = self._finder, list[Columns]()
        finder.start(data, len(data) + 1 if final else self._distrusted)
        self._distrusted = 0
        while True:
            self._aim(finder)
            packet = finder.find(self._rest)
            if finder.joined.size > len(self._rest):
                self._take_joined(finder, finder.joined.size - len(self._rest))
                self._take_bytes(finder.joined, parts)
            if packet is None:
                break
            self._take_packet(packet, parts)
        finder.count(self.health)
        return parts, data[finder.at :]

    def _aim(self, finder: PacketFinder) -> None:
        """Set which fragments can be joined, and the limits for valid packets."""
        raise NotImplementedError

    def _take_joined(self, finder: PacketFinder, n_bytes: int) -> None:
        """Handle the arrival of `n_bytes` in joined fragments, which `_take_bytes` decodes."""
        raise NotImplementedError

    def _take_packet(self, packet: Packet, parts: list[Columns]) -> None:
        """Handle any other packet."""
        raise NotImplementedError

    def _take_bytes(self, raw: npt.NDArray[np.uint8], parts: list[Columns]) -> int:
        """Decode the whole records in `raw`, which begins with the bytes left over before."""
        skip = min(self._skip, raw.size)
        self._skip -= skip
        whole = skip + (raw.size - skip) // self._records.size * self._records.size
        self._rest = raw[whole:].tobytes()
        if whole > skip:
            # a copy is aligned for arrays of words
            aligned = raw[:whole] if skip == 0 else raw[skip:whole].copy()
            parts.append(self._records.decode(aligned, self.health, self._host_us))
        return (whole - skip) // self._records.size


class ListeningDecoder(PacketDecoder):
    """Decodes the packets of one channel of a device that sends them without commands.

    Parameters
    ----------
    sensor : Sensor
    channel : int
        Number of the channel.
    records : Records
    """

    def __init__(self, sensor: Sensor, channel: int, records: Records) -> None:
        super().__init__(sensor, records)
        self._channel = channel
        self._sequence: int | None = None
        self._fragments = False
        #: whether a record begins at the next bytes
        self._placed = True

    def _samples(self) -> Iterable[bytes]:
        maker = open_maker(self._records.name, self.sensor)
        encoder = PushingEncoder(self.sensor, self._channel, maker)
        yield encoder.encode(make_events([0], [0], [0], [1]))

    def _lose_sync(self) -> None:
        self._rest = b""
        self._placed = not self._fragments

    def _aim(self, finder: PacketFinder) -> None:
        finder.limit = MAX_PAYLOAD
        joins = self._placed and self._sequence is not None
        finder.channel = self._channel if joins else -1
        finder.sequence = self._sequence or 0

    def _take_joined(self, finder: PacketFinder, n_bytes: int) -> None:
        self._fragments = True
        self._sequence = finder.sequence

    def _take_packet(self, packet: Packet, parts: list[Columns]) -> None:
        most = self._records.most
        if self._sequence is not None and not packet.flags & (Flag.RTX | Flag.EVENT):
            missing = (packet.sequence - self._sequence) & 0xFF
            if missing:
                self.health.sequence_gaps += 1
                # each missing packet may have been empty, or as large as a packet can be
                self.health.lost_at_most += missing * (MAX_PAYLOAD // self._records.size) * most
                self._records.lose()
                self._lose_sync()
        self._sequence = (packet.sequence + 1) & 0xFF
        if packet.channel != self._channel or packet.flags & (Flag.ACK | Flag.NAK | Flag.EVENT):
            return
        last = not packet.flags & Flag.FRAGMENT
        self._fragments |= not last
        if self._placed:
            raw = np.frombuffer(self._rest + packet.payload, dtype=np.uint8)
            self._take_bytes(raw, parts)
        else:
            # this is the end of a message whose beginning is missing
            self.health.lost_at_most += (len(packet.payload) // self._records.size + 1) * most
        if last:
            self.health.lost_at_most += bool(self._rest)
            self._rest, self._placed = b"", True
