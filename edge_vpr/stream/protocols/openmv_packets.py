"""Packets of OpenMV's protocol, version 2: how they look, and how they are found in bytes.

Little-endian: the mark AA D5, sequence number, channel, flags, opcode, length of the payload, a
checksum of these eight bytes; then, if there is a payload, it and a checksum of it.

Sources, for all of ``openmv*.py``: the camera's side is `protocol/omv_protocol.c` and `.h` and
`modules/py_protocol.c` of https://github.com/openmv/openmv (firmware 5.0), the maker's host is the
package `openmv` 1.0.7 on PyPI, and the scripts that run on the camera and read them on a computer
are `tools/genx320-event-streaming` of https://github.com/openmv/openmv-projects. Where the pages
on docs.openmv.io say otherwise, the code of both sides decides.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numba import njit

from edge_vpr.stream.health import Health
from edge_vpr.stream.protocols.openmv_checksums import TABLE16, TABLES32, crc, crc16, crc32

SYNC = b"\xaa\xd5"
#: mark, sequence, channel, flags, opcode, length, CRC-16 of these
HEADER = struct.Struct("<2sBBBBHH")
CHECK = struct.Struct("<I")
#: What a length field can say, and the longest packet.
MAX_PAYLOAD = 0xFFFF
MAX_PACKET = HEADER.size + MAX_PAYLOAD + CHECK.size
#: A USB line opened at this rate speaks packets; at any other it is MicroPython's prompt.
BAUD = 921_600


class Flag:
    """Bits of the flags; plain numbers, since an enumeration's take longer than the rest."""

    ACK = 1
    NAK = 2
    RTX = 4  # sent again
    ACK_REQ = 8
    FRAGMENT = 16  # more of the same message follows
    EVENT = 32  # sent unasked; takes no sequence number


class Opcode(IntEnum):
    """Commands; an answer has its command's."""

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
    """What a refusal (NAK) says."""

    FAILED = 1
    INVALID = 2
    TIMEOUT = 3
    BUSY = 4
    CHECKSUM = 5
    SEQUENCE = 6
    OVERFLOW = 7


#: Capabilities: checksums, sequence numbers, acknowledgements, events; then the longest payload.
CAPS = struct.Struct("<IH10x")
CAP_CRC, CAP_SEQ, CAP_ACK, CAP_EVENTS = 1, 2, 4, 8
#: A channel in the list: number, flags, name.
ENTRY = struct.Struct("<BB14s")
#: What to read: offset, length.
EXTENT = struct.Struct("<II")


class Packet(NamedTuple):
    """One whole, undamaged packet."""

    sequence: int
    channel: int
    flags: int
    opcode: int
    payload: bytes


def pack(
    opcode: int, sequence: int, channel: int = 0, flags: int = 0, payload: bytes = b""
) -> bytes:
    """Make one packet."""
    head = HEADER.pack(SYNC, sequence & 0xFF, channel, flags, opcode, len(payload), 0)[:8]
    packet = head + struct.pack("<H", crc(head, 16))
    return packet + payload + CHECK.pack(crc(payload, 32)) if payload else packet


# what is found in one chunk: bytes done with, and counts; then the number of the next packet, and
# how many bytes have been joined
_STATE = np.dtype(
    [
        (name, "<i8")
        for name in ("at", "skipped_bytes", "resyncs", "errors", "packets", "sequence", "joined")
    ]
)


class PacketFinder:
    """Finds packets, and joins the payloads of one channel's fragments as they follow each other.

    Attributes
    ----------
    limit : int
        Longest payload to believe in.
    channel : int
        Whose fragments to join; -1 for none.
    sequence : int
        Number of the next packet.
    joined : ndarray of uint8, shape (n,)
        Fragments found before the packet that `find` returned; valid until the next call.
    at : int
        Bytes done with since `start`.
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
        """Begin with new bytes.

        Parameters
        ----------
        data : bytes
        trust : int
            A packet that begins before this byte, and is not whole, is none.
        """
        self._data, self._raw = data, np.frombuffer(data, dtype=np.uint8)
        self._trust = trust
        self._state[0] = (0, 0, 0, 0, 0, self.sequence, 0)
        if self._out.size < len(data) + 16:
            self._out = np.empty(len(data) + 16, dtype=np.uint8)

    def find(self, before: bytes = b"") -> Packet | None:
        """Find the next packet; `before` is what stands in front of the fragments joined."""
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
        """Bytes done with."""
        return int(self._state["at"].item())

    def count(self, health: Health) -> None:
        """Count what has been found, and what was no packet, since `start`."""
        _, skipped, resyncs, errors, packets, _, _ = self._state.item()
        health.frames += packets
        health.crc_errors += errors
        health.skipped_bytes += skipped
        health.resyncs += resyncs


@njit(cache=True, nogil=True)
def _find(  # type: ignore[no-untyped-def]
    data, state, out, limit, channel, trust, table16, tables32
):
    """Go on to the next packet that is no fragment to join; tell whether there is one."""
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
            s["resyncs"] += 1
            bad_from = -1
        s["packets"] += 1
        # 0x26 is a read, 16 a fragment and nothing else
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
        s["resyncs"] += 1
    s["at"] = at
    return found
