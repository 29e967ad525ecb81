"""Simulated camera that answers a host as OpenMV's firmware does.

It is written from the firmware's sources (see `openmv_packets`), and independent of the host's
side: it finds commands with code of its own, in plain Python.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from edge_vpr.events import Events, Sensor
from edge_vpr.live import protocols
from edge_vpr.live.protocols import Encoder, OptionReader, parse_protocol
from edge_vpr.live.protocols.openmv import read_channel, record_encoder
from edge_vpr.live.protocols.openmv_packets import (
    CAPS,
    CHECK,
    ENTRY,
    EXTENT,
    HEADER,
    SYNC,
    Cap,
    Flag,
    Opcode,
    Packet,
    Status,
    crc,
    pack,
)

#: A buffer of 4,096 bytes without header and checksum.
MAX_PAYLOAD = 4_096 - HEADER.size - CHECK.size
MIN_PAYLOAD = 64 - HEADER.size - CHECK.size
#: Fragment size of a channel written in Python with `read`; with `readp`, it is the longest.
READ_BYTES = 512
RETRY_S, RETRIES = 0.5, 3
_STDIN, _DYNAMIC = 1, 32


@dataclass
class _Sent:
    """Packet that waits for its acknowledgement."""

    packet: Packet
    at_s: float | None = None
    wait_s: float = RETRY_S
    tries: int = RETRIES


class Camera:
    """Answers commands of a host.

    Parameters
    ----------
    fragment : int
        Bytes of one fragment of the data that is read.

    Attributes
    ----------
    buffers : deque of bytes
        Contents of the channel. The host reads one buffer whole, which is then freed.
    reading : bytes
        Buffer that was freed last, until the host sends another command.
    """

    def __init__(self, fragment: int = READ_BYTES) -> None:
        self._fragment = fragment
        self._names = {0: ("usb", 64), 1: ("stdin", 6), 2: ("stdout", 1), 3: ("stream", 25)}
        self._number: int | None = None
        self.buffers: deque[bytes] = deque()
        self.reading = b""
        self._pending = b""
        self._stats = [0] * 8
        self._reset()

    def _reset(self) -> None:
        self._sequence = 0
        self._caps = Cap.CRC | Cap.SEQ | Cap.ACK | Cap.EVENTS
        self._limit = MAX_PAYLOAD
        self._outbox: deque[Packet] = deque()
        self._sent: _Sent | None = None

    def register(self, name: str) -> bytes:
        """Register the channel, as a script does, and return the event for the host."""
        self._number = len(self._names)
        self._names[self._number] = (name, _DYNAMIC)
        self._stats[6] += 1
        return pack(Opcode.SYS_EVENT, self._sequence, 0, Flag.EVENT, struct.pack("<H", 0))

    def receive(self, data: bytes) -> bytes:
        """Take the bytes that the host sent; return the answers."""
        self._pending += data
        out = b""
        while (packet := self._next_command()) is not None:
            self._take(packet)
            out += self._pump()
        return out + self._pump()

    def tick(self, now_s: float) -> bytes:
        """Send a packet again that was not acknowledged in time."""
        sent = self._sent
        if sent is None:
            return b""
        if sent.at_s is None:
            sent.at_s = now_s
        if now_s - sent.at_s <= sent.wait_s:
            return b""
        if sent.tries == 0:
            self._reset()
            return b""
        sent.tries -= 1
        sent.at_s, sent.wait_s = now_s, 2 * sent.wait_s
        return self._again(sent)

    def _again(self, sent: _Sent) -> bytes:
        self._stats[4] += 1
        return sent.packet._replace(flags=sent.packet.flags | Flag.RTX).packed()

    def _next_command(self) -> Packet | None:
        """Find the next packet; a whole SYNC behind an incomplete packet is accepted."""
        data = self._pending
        at, kept = 0, -1
        while True:
            at = data.find(SYNC, at)
            if at < 0 or len(data) - at < HEADER.size:
                break
            _, sequence, channel, flags, opcode, length, check = HEADER.unpack_from(data, at)
            checked = self._caps & Cap.CRC
            if checked and crc(data[at : at + 8], 16) != check:
                at += 1
                continue
            if kept >= 0 and (opcode, channel, length) != (Opcode.SYNC, 0, 0):
                at += 1
                continue
            if length > self._limit:
                self._refuse(opcode, channel, Status.OVERFLOW)
                at += 1
                continue
            end = at + HEADER.size + length + (CHECK.size if length else 0)
            if len(data) < end:
                kept, at = at, at + 1
                continue
            payload = data[at + HEADER.size : at + HEADER.size + length]
            self._pending = data[end:]
            wrong = length and crc(payload, 32) != CHECK.unpack_from(data, end - CHECK.size)[0]
            if checked and wrong:
                self._stats[2] += 1
                self._refuse(opcode, channel, Status.CHECKSUM)
                data, at = self._pending, 0
                continue
            return Packet(sequence, channel, flags, opcode, payload)
        if kept >= 0:
            at = kept
        elif at < 0:
            at = len(data) - data.endswith(SYNC[:1])
        self._pending = data[at:]
        return None

    def _take(self, packet: Packet) -> None:
        if packet.flags & (Flag.ACK | Flag.NAK):
            sent = self._sent
            if sent is not None and sent.packet[:1] + sent.packet[3:4] == (
                packet.sequence,
                packet.opcode,
            ):
                if packet.flags & Flag.ACK:
                    self._sent = None
                else:
                    sent.at_s = -sent.wait_s  # treated as late
        elif packet.opcode == Opcode.SYNC:
            self._reset()
            self._answer(Opcode.SYNC, 0, b"", Flag.ACK)
            # the answer to SYNC has the number 0, and so has the next command
            self._sequence = 0
        elif self._caps & Cap.SEQ and packet.sequence != self._sequence:
            self._stats[3] += 1
            self._refuse(packet.opcode, packet.channel, Status.SEQUENCE)
        elif packet.channel and packet.opcode <= Opcode.SYS_EVENT:
            self._refuse(packet.opcode, packet.channel, Status.INVALID)
        else:
            self._stats[1] += 1
            self.reading = b""
            self._obey(packet)

    def _obey(self, packet: Packet) -> None:
        """Carry out a command."""
        opcode, channel, payload = packet.opcode, packet.channel, packet.payload
        answer = self._protocol_answer(opcode)
        if answer is not None:
            self._answer(opcode, channel, answer)
        elif opcode == Opcode.SET_CAPS:
            self._set_caps(payload)
        elif opcode == Opcode.SIZE and channel == self._number:
            self._answer(opcode, channel, CHECK.pack(self._size()))
        elif opcode == Opcode.READ and channel == self._number and len(payload) == EXTENT.size:
            self._read(*EXTENT.unpack(payload))
        elif opcode in (Opcode.LOCK, Opcode.UNLOCK):
            self._refuse(opcode, channel, Status.BUSY)
        elif opcode in (Opcode.IOCTL, Opcode.WRITE) and channel == _STDIN:
            self._answer(opcode, channel, b"", Flag.ACK)
        else:
            self._refuse(opcode, channel, Status.INVALID)

    def _protocol_answer(self, opcode: int) -> bytes | None:
        """Answer a command that concerns no channel of the script; None for any other."""
        if opcode == Opcode.GET_CAPS:
            return CAPS.pack(self._caps, self._limit)
        if opcode == Opcode.STATS:
            return struct.pack("<8I", *self._stats)
        if opcode == Opcode.VERSION:
            # versions of the protocol, the boot loader and the firmware
            return struct.pack("<9B7x", 1, 0, 0, 1, 0, 0, 5, 0, 0)
        if opcode == Opcode.SYS_INFO:
            return bytes(76)
        if opcode == Opcode.LIST:
            entries = self._names.items()
            return b"".join(ENTRY.pack(n, flags, name.encode()) for n, (name, flags) in entries)
        if opcode == Opcode.POLL:
            return CHECK.pack(bool(self.buffers) << (self._number or 0))
        return None

    def _set_caps(self, payload: bytes) -> None:
        if len(payload) != CAPS.size or not (MIN_PAYLOAD <= CAPS.unpack(payload)[1] <= MAX_PAYLOAD):
            self._refuse(Opcode.SET_CAPS, 0, Status.INVALID)
            return
        self._answer(Opcode.SET_CAPS, 0, b"", Flag.ACK)
        self._caps, self._limit = CAPS.unpack(payload)

    def _size(self) -> int:
        return len(self.buffers[0]) if self.buffers else 0

    def _read(self, offset: int, length: int) -> None:
        """Send a part of the first buffer, or zeros, as the maker's scripts do."""
        number = self._number or 0
        if length == 0:
            self._refuse(Opcode.READ, number, Status.INVALID)
            return
        data = bytes(min(length, 1 << 20))
        if self.buffers:
            data = self.buffers[0][offset : offset + length]
            if offset + length == len(self.buffers[0]):
                self.reading = self.buffers.popleft()
        self._answer(Opcode.READ, number, data, fragment=self._fragment)

    def _refuse(self, opcode: int, channel: int, status: Status) -> None:
        self._answer(opcode, channel, struct.pack("<H", status), Flag.NAK)

    def _answer(
        self, opcode: int, channel: int, data: bytes, flags: int = 0, fragment: int = 1 << 16
    ) -> None:
        step = min(fragment, self._limit)
        if self._caps & Cap.ACK and not flags & (Flag.ACK | Flag.NAK):
            flags |= Flag.ACK_REQ
        for at in range(0, max(1, len(data)), step):
            more = Flag.FRAGMENT if at + step < len(data) else 0
            part = data[at : at + step]
            self._outbox.append(Packet(self._sequence, channel, flags | more, opcode, part))
            self._sequence = (self._sequence + 1) & 0xFF

    def _pump(self) -> bytes:
        """Send packets up to the first one that needs an acknowledgement."""
        out = bytearray()
        while self._outbox and self._sent is None:
            packet = self._outbox.popleft()
            self._stats[0] += 1
            out += packet.packed()
            if packet.flags & Flag.ACK_REQ:
                self._sent = _Sent(packet)
        return bytes(out)


#: Number of buffers of a script.
BUFFERS = 8


class CameraEncoder(Encoder):
    """Camera with a script that registers one channel.

    Parameters
    ----------
    encode_records : callable
        Encodes events as the channel's records.
    buffer_events : int
        Number of events in one of the script's buffers.
    """

    host_needs_options = True
    waits_for_host = True

    def __init__(
        self,
        sensor: Sensor,
        channel: str,
        encode_records: Callable[[Events], bytes],
        *,
        buffer_events: int = 8_192,
        fragment: int = READ_BYTES,
    ) -> None:
        super().__init__(sensor)
        self._channel, self._encode, self._most = channel, encode_records, buffer_events
        self.capacity = buffer_events * BUFFERS
        self._camera = Camera(fragment)
        self._counts: deque[int] = deque()
        self._in_flight = 0

    def start(self) -> bytes:
        """See `Encoder.start`."""
        return self._camera.register(self._channel)

    def encode(self, events: Events) -> bytes:
        """Hold events until the host requests them."""
        for at in range(0, events.size, self._most):
            part = events[at : at + self._most]
            self._camera.buffers.append(self._encode(part))
            self._counts.append(part.size)
        self.held += events.size
        return b""

    def respond(self, command: bytes) -> bytes:
        """See `Encoder.respond`."""
        answer = self._camera.receive(command)
        self._count()
        return answer

    def to_send(self, now_s: float) -> bytes:
        """See `Encoder.to_send`."""
        return self._camera.tick(now_s)

    def _count(self) -> None:
        """Count the events in the buffers and those that are being sent."""
        while len(self._counts) > len(self._camera.buffers):
            self._in_flight = self._counts.popleft()
        if not self._camera.reading:
            self._in_flight = 0
        self.held = sum(self._counts) + self._in_flight


def open_encoder(protocol: str, sensor: Sensor) -> Encoder:
    """Make an encoder of any protocol, of OpenMV's a camera unless the channel has a number."""
    name, options = parse_protocol(protocol)
    if name != "openmv":
        return protocols.open_encoder(protocol, sensor)
    channel, records_format = read_channel(OptionReader(name, options))
    if isinstance(channel, int):
        return protocols.open_encoder(protocol, sensor)
    return CameraEncoder(sensor, channel, record_encoder(records_format, sensor))
