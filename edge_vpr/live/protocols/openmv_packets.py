"""Packets of OpenMV's protocol, version 2: their layout, and how they are found in bytes.

A packet is little-endian: the mark AA D5, sequence number, channel, flags, opcode, length of the
payload, and a checksum of these eight bytes. If there is a payload, it follows with its own
checksum.

Sources, for all of ``openmv*.py``: the camera's side is `protocol/omv_protocol.c` and `.h` and
`modules/py_protocol.c` of https://github.com/openmv/openmv (firmware 5.0), the maker's host is the
package `openmv` 1.0.7 on PyPI, and the scripts that run on the camera and those that read their
data on a computer are `tools/genx320-event-streaming` of https://github.com/openmv/openmv-projects.
Where the pages on docs.openmv.io differ from the code of both sides, the code is followed.

The maker's package is not used, although its host reads the simulated camera to the bit. After a
fragment is lost it reads the buffer again, which the camera has freed, and returns the zeros that
come instead: 3,000 events that never were, and no word of the 3,000 that are gone. Python 3.11 has
no `in` for its enumerations, an unknown refusal ends the program by `sys.exit(0)`, it reads 0.6
million events a second (this module, 4.9 million), and it requires pygame.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.live.protocols import Health

# Both checksums of OpenMV's packets.


def _tables(polynomial: int, bits: int, count: int) -> npt.NDArray[np.int64]:
    """Return the remainders of each byte with 0, 1, ... zero bytes after it."""
    mask = (1 << bits) - 1
    rows = np.zeros((count, 256), dtype=np.int64)
    for byte in range(256):
        value = byte << (bits - 8)
        for _ in range(8):
            value = ((value << 1) ^ (polynomial if value >> (bits - 1) else 0)) & mask
        rows[0, byte] = value
    for k in range(1, count):
        before = rows[k - 1]
        rows[k] = ((before << 8) & mask) ^ rows[0][before >> (bits - 8)]
    return rows


TABLE16 = _tables(0xF94F, 16, 1)
TABLES32 = _tables(0xFA567D89, 32, 8)


def crc(data: bytes, bits: int) -> int:
    """Return the checksum of 16 or 32 bits: not reflected, initially all ones, no final step.

    Examples
    --------
    >>> hex(crc(b"123456789", 16)), hex(crc(b"123456789", 32))
    ('0xe541', '0x41b403d3')
    """
    raw = np.frombuffer(data, dtype=np.uint8)
    if bits == 16:
        return int(crc16(raw, 0, raw.size, TABLE16))
    return int(crc32(raw, 0, raw.size, TABLES32))


@kernel
def crc16(data: Any, start: Any, stop: Any, tables: Any) -> Any:
    """Process one byte a step, since headers are short."""
    value = np.int64(0xFFFF)
    for i in range(start, stop):
        value = ((value << 8) & 0xFFFF) ^ tables[0, (value >> 8) ^ data[i]]
    return value


@kernel
def crc32(data: Any, start: Any, stop: Any, tables: Any) -> Any:
    """Process eight bytes a step, since their remainders do not depend on each other."""
    value = np.int64(0xFFFFFFFF)
    i = start
    while i + 8 <= stop:
        value = (
            tables[7, (value >> 24) ^ data[i]]
            ^ tables[6, ((value >> 16) & 255) ^ data[i + 1]]
            ^ tables[5, ((value >> 8) & 255) ^ data[i + 2]]
            ^ tables[4, (value & 255) ^ data[i + 3]]
            ^ tables[3, data[i + 4]]
            ^ tables[2, data[i + 5]]
            ^ tables[1, data[i + 6]]
            ^ tables[0, data[i + 7]]
        )
        i += 8
    while i < stop:
        value = ((value << 8) & 0xFFFFFFFF) ^ tables[0, (value >> 24) ^ data[i]]
        i += 1
    return value


SYNC = b"\xaa\xd5"
#: mark, sequence, channel, flags, opcode, length, CRC-16 of these
HEADER = struct.Struct("<2sBBBBHH")
CHECK = struct.Struct("<I")
#: Largest value of a length field, and longest packet.
MAX_PAYLOAD = 0xFFFF
MAX_PACKET = HEADER.size + MAX_PAYLOAD + CHECK.size
#: A USB line opened at this rate carries packets; at any other rate, it is MicroPython's prompt.
BAUD = 921_600


class Flag:
    """Bits of the flags, as plain integers: those of an enumeration would take most of the time."""

    ACK = 1
    NAK = 2
    RTX = 4  # sent again
    ACK_REQ = 8
    FRAGMENT = 16  # more of the same message follows
    EVENT = 32  # sent without a request; takes no sequence number


class Opcode(IntEnum):
    """Commands; an answer has the opcode of its command."""

    SYNC = 0x00
    GET_CAPS = 0x01
    SET_CAPS = 0x02
    STATS = 0x03
    VERSION = 0x04
    SYS_INFO = 0x12
    SYS_EVENT = 0x13
    LIST = 0x20
    POLL = 0x21
    LOCK = 0x22
    UNLOCK = 0x23
    SHAPE = 0x24
    SIZE = 0x25
    READ = 0x26
    WRITE = 0x27
    IOCTL = 0x28
    CHANNEL_EVENT = 0x29


class Status(IntEnum):
    """Reasons of a refusal (NAK)."""

    FAILED = 1
    INVALID = 2
    TIMEOUT = 3
    BUSY = 4
    CHECKSUM = 5
    SEQUENCE = 6
    OVERFLOW = 7


class Cap:
    """Bits of the capabilities: checksums, sequence numbers, acknowledgements, events."""

    CRC, SEQ, ACK, EVENTS = 1, 2, 4, 8


#: Capabilities and longest payload.
CAPS = struct.Struct("<IH10x")
#: A channel in the list: number, flags, name.
ENTRY = struct.Struct("<BB14s")
#: Part to read: offset, length.
EXTENT = struct.Struct("<II")


class Packet(NamedTuple):
    """One whole, undamaged packet."""

    sequence: int
    channel: int
    flags: int
    opcode: int
    payload: bytes

    def packed(self) -> bytes:
        """Return its bytes."""
        return pack(self.opcode, self.sequence, self.channel, self.flags, self.payload)


def pack(
    opcode: int, sequence: int, channel: int = 0, flags: int = 0, payload: bytes = b""
) -> bytes:
    """Return the bytes of one packet."""
    head = HEADER.pack(SYNC, sequence & 0xFF, channel, flags, opcode, len(payload), 0)[:8]
    packet = head + struct.pack("<H", crc(head, 16))
    return packet + payload + CHECK.pack(crc(payload, 32)) if payload else packet


# results for one chunk: processed bytes, and counts; then the number of the next packet, the
# number of joined bytes, and whether the last processed byte was of no packet, which is kept: bad
# bytes that a chunk cuts are one fault
_NAMES = "at", "skipped_bytes", "resyncs", "errors", "packets", "sequence", "joined", "searching"
_STATE = np.dtype([(name, "<i8") for name in _NAMES])


class PacketFinder:
    """Finds packets, and joins the payloads of consecutive fragments of one channel.

    Attributes
    ----------
    limit : int
        Longest payload of a valid packet.
    channel : int
        Channel whose fragments are joined; -1 for none.
    joined : ndarray of uint8, shape (n,)
        Fragments found before the packet that `find` returned; valid until the next call.
    """

    def __init__(self) -> None:
        self.limit = MAX_PAYLOAD
        self.channel = -1
        self._state = np.zeros(1, dtype=_STATE)
        self._data = b""
        self._raw = np.zeros(0, dtype=np.uint8)
        self._out = np.zeros(0, dtype=np.uint8)
        self._trust = 0

    @property
    def sequence(self) -> int:
        """Number of the next packet."""
        return int(self._state["sequence"].item())

    @sequence.setter
    def sequence(self, value: int) -> None:
        self._state["sequence"] = value & 0xFF

    def start(self, data: bytes, trust: int) -> None:
        """Set the bytes in which packets are found.

        Parameters
        ----------
        trust : int
            An incomplete packet that begins before this byte is invalid.
        """
        self._data, self._raw = data, np.frombuffer(data, dtype=np.uint8)
        self._trust = trust
        self._state[0] = (0, 0, 0, 0, 0, self.sequence, 0, self._state["searching"].item())
        if self._out.size < len(data) + 16:
            self._out = np.empty(len(data) + 16, dtype=np.uint8)

    def find(self, before: bytes = b"") -> Packet | None:
        """Find the next packet; `before` is put in front of the joined fragments."""
        self._out[: len(before)] = np.frombuffer(before, dtype=np.uint8)
        self._state["joined"] = len(before)
        found = _find(
            self._raw, self._state, self._out, self.limit, self.channel, self._trust,
            TABLE16, TABLES32,
        )  # fmt: skip
        self.joined = self._out[: self._state["joined"].item()]
        if not found:
            return None
        at = self.at
        _, sequence, channel, flags, opcode, length, _ = HEADER.unpack_from(self._data, at)
        payload = self._data[at + HEADER.size : at + HEADER.size + length]
        self._state["at"] = at + HEADER.size + length + (CHECK.size if length else 0)
        return Packet(sequence, channel, flags, opcode, payload)

    @property
    def at(self) -> int:
        """Number of processed bytes since `start`."""
        return int(self._state["at"].item())

    def count(self, health: Health) -> None:
        """Add the packets found and the other bytes since `start` to `health`."""
        _, skipped, resyncs, errors, packets, *_ = self._state.item()
        health.frames += packets
        health.crc_errors += errors
        health.skipped_bytes += skipped
        health.resyncs += resyncs


@kernel
def _find(  # type: ignore[no-untyped-def]
    data, state, out, limit, channel, trust, table16, tables32
):
    """Advance to the next packet that is not a fragment to join; return whether there is one."""
    s = state[0]
    n, at, bad_from = data.size, s["at"], -1
    found = False
    while True:
        start = at
        while at + 1 < n and not (data[at] == 0xAA and data[at + 1] == 0xD5):
            at += 1
        if at + 1 == n and (data[at] != 0xAA or at < trust):
            at = n
        if at > start and bad_from < 0:
            bad_from = start
        if at + 1 >= n:
            break
        whole, believed = n - at >= 10, True
        size = 10
        if whole:
            believed = (
                crc16(data, at, at + 8, table16) == int(data[at + 8]) | int(data[at + 9]) << 8
            )
            length = int(data[at + 6]) | int(data[at + 7]) << 8
            believed = believed and length <= limit
            if length:
                size += length + 4
            whole = n - at >= size
            if believed and whole and length:
                end = at + size - 4
                check = 0
                for k in range(4):
                    check |= int(data[end + k]) << (8 * k)
                believed = crc32(data, at + 10, end, tables32) == check
        if believed and not whole:
            if at >= trust:
                break
            believed = False
        if not believed:
            s["errors"] += 1
            if bad_from < 0:
                bad_from = at
            at += 1
            continue
        if bad_from >= 0:
            s["skipped_bytes"] += at - bad_from
            s["resyncs"] += 1 - s["searching"]
            bad_from = -1
        s["searching"] = 0
        s["packets"] += 1
        # joins only reads (0x26) whose only flag is that of a fragment (16)
        if (
            data[at + 5] != 0x26
            or data[at + 3] != channel
            or data[at + 4] != 16
            or data[at + 2] != s["sequence"]
        ):
            found = True
            break
        fill = s["joined"]
        if size > 14:
            out[fill : fill + size - 14] = data[at + 10 : at + size - 4]
            s["joined"] = fill + size - 14
        s["sequence"] = (s["sequence"] + 1) & 0xFF
        at += size
    if bad_from >= 0:
        s["skipped_bytes"] += at - bad_from
        s["resyncs"] += 1 - s["searching"]
        s["searching"] = 1
    s["at"] = at
    return found
