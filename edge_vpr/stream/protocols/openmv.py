"""OpenMV's protocol, version 2: packets with two checksums, events in the payload.

Packets are decoded as they come. To ask the camera for a channel again and again is the part of
a host that speaks the whole protocol, which this is not; `docs/stream.md` says what that means.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.source import Columns
from edge_vpr.stream.gate import Clock
from edge_vpr.stream.health import BOUND
from edge_vpr.stream.protocols.protocol import Decoder, Encoder, OptionReader

SYNC = b"\xaa\xd5"
#: sync, sequence, channel, flags, opcode, length, CRC-16 of these
HEADER = struct.Struct("<2sBBBBHH")
CHECK = struct.Struct("<I")
#: type (0 OFF, 1 ON, 2 to 5 triggers), seconds, milliseconds, microseconds, column, row
EVENT_BYTES = 12
_ACK, _NAK, _RTX, _FRAGMENT = 1, 2, 4, 16
#: Longest packet, and longest run of fragments that is put together.
MAX_PACKET = HEADER.size + 0xFFFF + CHECK.size
MAX_PAYLOAD = 1 << 20
#: The clock's seconds have 16 bits.
_PERIOD_US = 65_536 * 1_000_000


def _table(polynomial: int, bits: int) -> npt.NDArray[np.uint32]:
    rows = []
    for byte in range(256):
        value = byte << (bits - 8)
        for _ in range(8):
            value = (value << 1) ^ (polynomial if value >> (bits - 1) else 0)
            value &= (1 << bits) - 1
        rows.append(value)
    return np.array(rows, dtype=np.uint32)


_TABLES = {16: _table(0xF94F, 16), 32: _table(0xFA567D89, 32)}


def crc(data: bytes, bits: int) -> int:
    """Checksum of 16 or 32 bits: not reflected, all ones at first, nothing done at the end.

    Examples
    --------
    >>> hex(crc(b"123456789", 16)), hex(crc(b"123456789", 32))
    ('0xe541', '0x41b403d3')
    """
    return int(_crc(np.frombuffer(data, dtype=np.uint8), _TABLES[bits], bits))


@njit(cache=True, nogil=True)
def _crc(data: Any, table: Any, bits: Any) -> Any:
    value, mask = np.int64((1 << bits) - 1), (1 << bits) - 1
    for byte in data:
        value = (value << 8 & mask) ^ np.int64(table[(value >> (bits - 8)) ^ byte])
    return value


class OpenmvDecoder(Decoder):
    """Decodes packets of one channel; a packet is delivered whole and undamaged, or not at all.

    Parameters
    ----------
    sensor : Sensor
    channel : int
        Its number, which the camera gives by name; 0 is the protocol's own.
    """

    resync_bytes = MAX_PACKET + HEADER.size

    def __init__(self, sensor: Sensor, channel: int) -> None:
        super().__init__(sensor, Clock(confirm=1), BOUND)
        self._channel = channel
        self._sequence: int | None = None
        self._fragments = b""
        self._now = self._last = 0

    def _lose_sync(self) -> None:
        self._fragments = b""

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        parts: list[Columns] = []
        at, bad_from = 0, -1
        while True:
            found = data.find(SYNC, at)
            if found < 0:
                # the first half of the mark may be there already
                found = len(data) - (not final and data.endswith(SYNC[:1]))
            if found > at and bad_from < 0:
                bad_from = at
            at = max(at, found)
            if len(data) - at < HEADER.size:
                break
            _, sequence, channel, flags, _, length, check = HEADER.unpack_from(data, at)
            size = HEADER.size + length + (CHECK.size if length else 0)
            whole = crc(data[at : at + 8], 16) == check
            if whole and len(data) - at < size and not final:
                break
            payload = data[at + HEADER.size : at + HEADER.size + length]
            if whole and length:
                end = at + size
                whole = len(data) >= end and crc(payload, 32) == CHECK.unpack_from(data, end - 4)[0]
            if not whole:
                self.health.crc_errors += 1
                bad_from = at if bad_from < 0 else bad_from
                at += 1
                continue
            self._skip(bad_from, at)
            bad_from = -1
            at += size
            self.health.frames += 1
            self._take_packet(sequence, channel, flags, payload, parts)
        self._skip(bad_from, at)
        return parts, data[at:]

    def _skip(self, start: int, stop: int) -> None:
        if start >= 0:
            self.health.skipped_bytes += stop - start
            self.health.resyncs += 1

    def _take_packet(
        self, sequence: int, channel: int, flags: int, payload: bytes, parts: list[Columns]
    ) -> None:
        if self._sequence is not None and not flags & _RTX:
            missing = (sequence - self._sequence) & 0xFF
            if missing:
                self.health.sequence_gaps += 1
                # each packet may have held nothing, or as much as a packet can
                self.health.lost_at_most += missing * (0xFFFF // EVENT_BYTES)
                self._fragments = b""
        self._sequence = (sequence + 1) & 0xFF
        if channel != self._channel or flags & (_ACK | _NAK):
            return
        payload = self._fragments + payload
        if flags & _FRAGMENT and len(payload) <= MAX_PAYLOAD:
            self._fragments = payload
            return
        self._fragments = b""
        whole = len(payload) // EVENT_BYTES * EVENT_BYTES
        self.health.lost += len(payload) > whole
        self.health.lost_at_most += len(payload) > whole
        parts.append(self._events_of(payload[:whole]))

    def _events_of(self, payload: bytes) -> Columns:
        kind, s, ms, us, x, y = np.frombuffer(payload, dtype="<u2").reshape(-1, 6).T
        real = kind < 2
        raw = s.astype(np.int64) * 1_000_000 + ms.astype(np.int64) * 1_000 + us
        raw = raw[real]
        if raw.size:
            # the seconds wrap after 18.2 hours
            half = _PERIOD_US // 2
            steps = (np.diff(raw, prepend=self._last) + half) % _PERIOD_US - half
            self._last = int(raw[-1])
            raw = self._now + np.cumsum(steps)
            self._now = int(raw[-1])
        return Columns(raw, x[real], y[real], kind[real] == 1)


class OpenmvEncoder(Encoder):
    """Makes packets of the channel ``events``."""

    def __init__(self, sensor: Sensor, channel: int, packet_events: int = 256) -> None:
        super().__init__(sensor)
        self._channel, self._packet_events = channel, packet_events
        self._sequence = 0

    def encode(self, events: Events) -> bytes:
        """Encode events."""
        t = events["t"] % _PERIOD_US
        fields = (
            events["p"],
            t // 1_000_000,
            t // 1_000 % 1_000,
            t % 1_000,
            events["x"],
            events["y"],
        )
        rows = np.stack([field.astype("<u2") for field in fields], axis=1)
        step = self._packet_events
        return b"".join(
            self._packet(rows[i : i + step].tobytes()) for i in range(0, events.size, step)
        )

    def _packet(self, payload: bytes) -> bytes:
        header = HEADER.pack(SYNC, self._sequence, self._channel, 0, 0, len(payload), 0)[:8]
        self._sequence = (self._sequence + 1) & 0xFF
        checked = header + struct.pack("<H", crc(header, 16)) + payload
        return checked + CHECK.pack(crc(payload, 32))


def open_decoder(name: str, sensor: Sensor, options: OptionReader) -> Decoder:
    """Make a decoder."""
    return OpenmvDecoder(sensor, options.integer("channel", 4, 0, 255))


def open_encoder(name: str, sensor: Sensor, options: OptionReader) -> Encoder:
    """Make an encoder."""
    return OpenmvEncoder(sensor, options.integer("channel", 4, 0, 255))
