"""OpenMV's protocol, version 2: events of a camera with a GENX320, requested or unrequested."""

from __future__ import annotations

import copy
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError, printable
from edge_vpr.events import Events, Sensor, make_events
from edge_vpr.live.protocols import Clock, Decoder, Encoder, Health, OptionReader
from edge_vpr.live.protocols.evt import ENCODERS
from edge_vpr.live.protocols.health import BOUND
from edge_vpr.live.protocols.openmv_packets import (
    BAUD,
    CAPS,
    ENTRY,
    EXTENT,
    HEADER,
    MAX_PACKET,
    MAX_PAYLOAD,
    Cap,
    Flag,
    Opcode,
    Packet,
    PacketFinder,
    Status,
    pack,
)
from edge_vpr.recordings.prophesee import EvtWordDecoder
from edge_vpr.recordings.reading import Columns, empty_columns

# The host's side of the dialogue with a camera: which command comes next.
#
# The host synchronises, agrees on capabilities and lists the channels. Then it repeats: poll, ask
# for the size, read. One sequence number counts the packets of both directions. A command has the
# number of the next packet that the camera will send; its answer has the same number, and each
# further fragment has the next one. (The maker's page on reliability describes one number for each
# direction; neither its host nor its firmware has that.)
#
# The camera frees a buffer once it has sent it. With acknowledgements off, as in the maker's own
# tool for the GENX320, it sends nothing twice, and a lost fragment remains lost. With them on, the
# camera sends one fragment at a time and repeats it after 0.5 s without an answer. A refusal (NAK)
# would be faster, but the firmware takes it for an answer to the repetition as well, and resets
# the dialogue after three. Like the maker's host, this one therefore never refuses.
#
# After any fault, the dialogue begins again once an answer has been missing for some time: the
# camera accepts SYNC in any state, and it makes the camera forget the dialogue so far.


#: Seconds after which an answer is late, as in the maker's host, and the limit of this time, which
#: doubles with each late answer in a row.
PATIENCE_S, LONGEST_S = 1.0, 4.0
#: A camera that repeats lost packets has given up after this time.
REPEATED_S = 8.0
#: Seconds after damaged bytes until an answer is late, if the camera does not repeat it.
DAMAGED_S = 0.1
#: Seconds until an empty channel is polled again, as in the maker's tool, and until the channels
#: are listed again if the channel is missing.
POLL_S, LIST_S = 0.004, 0.25
#: Most bytes of an answer that is joined from fragments, except that to a read.
_LONGEST_ANSWER = 1 << 16
#: Smallest limit of the payload that the firmware accepts.
_LEAST_PAYLOAD = 50
#: Most characters of the channels' names in a message.
_LONGEST_LIST = 200


class Dialogue:
    """Requests the data of one channel from a camera.

    Parameters
    ----------
    name : str
        Name of the channel.
    acknowledge : bool
        Ask the camera to repeat lost packets.

    Attributes
    ----------
    sequence : int
        Number of the next packet.
    awaited : Opcode
        Command whose answer comes next.
    channel : int or None
        Number of the channel, once it is known.
    size : int
        Number of bytes of the current read.
    limit : int
        Longest payload, once it has been agreed on.
    remark : str
        Message for the user.
    """

    def __init__(self, name: str, acknowledge: bool) -> None:
        self.name, self._acknowledge = name, acknowledge
        self._patience, self._hurried = PATIENCE_S, False
        self.remark = ""
        self.restart()

    def restart(self) -> None:
        """Restart the dialogue."""
        self.sequence = 0
        self.channel: int | None = None
        self.size = 0
        self.limit = MAX_PAYLOAD
        self._answer = b""
        self._acknowledgements = b""
        self._relist = False
        self._ask(Opcode.SYNC)

    def _ask(
        self, opcode: Opcode, channel: int = 0, payload: bytes = b"", pause: float = 0.0
    ) -> None:
        self.awaited = opcode
        #: empty after it was sent
        self._command = pack(opcode, self.sequence, channel, 0, payload)
        self._pause = pause
        if opcode == Opcode.READ and self._acknowledge:
            # a lost packet is sent again after 0.5 s, and 1, 2 and 4 s later
            self._patience = REPEATED_S
        #: end of the pause, or time at which the answer is late; None: counted from the next `send`
        self._moment: float | None = None

    def opening(self) -> bytes:
        """Return the opening command for a caller that sends it itself."""
        out, self._command = self._command, b""
        return out

    @property
    def tick_s(self) -> float:
        """Interval in seconds at which `send` is to be called."""
        return self._pause or 0.1

    def send(self, now_s: float) -> bytes:
        """Return the bytes to send now."""
        out, self._acknowledgements = self._acknowledgements, b""
        if self._moment is None:
            self._moment = now_s + (self._pause if self._command else self._patience)
        if self._command and now_s >= self._moment:
            out += self._command
            self._command, self._pause = b"", 0.0
            self._moment = now_s + self._patience
        return out

    def overdue(self, now_s: float) -> bool:
        """Return whether an answer is late; the time limit for the next one is then longer."""
        late = not self._command and self._moment is not None and now_s >= self._moment
        if late:
            self._patience = min(2 * self._patience, max(LONGEST_S, self._patience))
        return late

    def hurry(self) -> None:
        """Shorten the wait after damaged bytes, or wait for their repetition."""
        if not self._hurried:
            self._hurried = True
            self._patience = REPEATED_S if self._acknowledge else DAMAGED_S
            self.restart_wait()

    def restart_wait(self) -> None:
        """Restart the wait for an answer."""
        if not self._command:
            self._moment = None

    def acknowledge(self, packet: Packet) -> None:
        """Add the acknowledgement of a packet to the bytes to send."""
        self._acknowledgements += pack(packet.opcode, packet.sequence, packet.channel, Flag.ACK)

    def receive_event(self, packet: Packet) -> None:
        """Handle an event of the camera: channels appear and disappear with its script."""
        if packet.channel == 0:
            self._relist = True

    def receive(self, packet: Packet) -> None:
        """Handle an answer without data."""
        if packet.opcode == Opcode.SYNC and packet.flags & Flag.ACK:
            # Also if no SYNC is awaited: it was sent twice, and the camera has forgotten the rest.
            self.restart()
            self._ask(Opcode.GET_CAPS)
        elif self.awaited == Opcode.SYNC:
            return
        elif packet.opcode != self.awaited or packet.sequence != self.sequence:
            # an answer to another command may be old; a refusal or a gap concerns the current one
            if packet.opcode == self.awaited or packet.flags & Flag.NAK:
                self.restart()
        elif packet.flags & Flag.NAK:
            self._receive_refusal(packet)
        else:
            self.sequence = (self.sequence + 1) & 0xFF
            self._answer += packet.payload
            if packet.flags & Flag.FRAGMENT and len(self._answer) < _LONGEST_ANSWER:
                return
            answer, self._answer = self._answer, b""
            try:
                self._go_on(answer)
            except struct.error:
                self.restart()  # the answer is too short

    def _receive_refusal(self, packet: Packet) -> None:
        status = int.from_bytes(packet.payload[:2], "little")
        if status in (Status.FAILED, Status.INVALID, Status.BUSY):
            # the channel has disappeared, or has no data yet
            self.sequence = (self.sequence + 1) & 0xFF
            self._ask(Opcode.LIST, pause=LIST_S)
        else:
            self.restart()

    def _go_on(self, answer: bytes) -> None:
        """Prepare the command that follows an answer."""
        if self.awaited == Opcode.GET_CAPS:
            self._offered = max(_LEAST_PAYLOAD, CAPS.unpack_from(answer)[1])
            wanted = Cap.CRC | Cap.SEQ | Cap.EVENTS | (Cap.ACK if self._acknowledge else 0)
            self._ask(Opcode.SET_CAPS, payload=CAPS.pack(wanted, self._offered))
        elif self.awaited == Opcode.SET_CAPS:
            self.limit = self._offered
            self._ask(Opcode.LIST)
        elif self.awaited == Opcode.LIST:
            self._choose(answer)
        elif self.awaited == Opcode.POLL:
            self._patience, self._hurried = PATIENCE_S, False
            ready = int.from_bytes(answer[:4], "little") >> (self.channel or 0) & 1
            if self._relist:
                self.poll()
            elif ready:
                self._ask(Opcode.SIZE, self.channel or 0)
            else:
                self._ask(Opcode.POLL, pause=POLL_S)
        elif self.awaited == Opcode.SIZE:
            self.size = int.from_bytes(answer[:4], "little")
            if self.size:
                self._ask(Opcode.READ, self.channel or 0, EXTENT.pack(0, self.size))
            else:
                self._ask(Opcode.POLL, pause=POLL_S)

    def poll(self) -> None:
        """Request more data after all has been read."""
        self._ask(Opcode.LIST if self._relist else Opcode.POLL)

    def _choose(self, answer: bytes) -> None:
        """Find the channel by its name."""
        self._relist = False
        numbers = {}
        for at in range(0, len(answer) - ENTRY.size + 1, ENTRY.size):
            number, _, name = ENTRY.unpack_from(answer, at)
            numbers[name.split(b"\0")[0].decode("ascii", "replace")] = number
        self.channel = numbers.get(self.name)
        if self.channel is not None:
            self.remark = ""
            self._ask(Opcode.POLL)
            return
        there = printable(", ".join(numbers) or "none", _LONGEST_LIST)
        self.remark = (
            f"the camera has no channel {printable(self.name)} (it has {there}): start a script on "
            "it that registers one, or name another with openmv:channel=NAME"
        )
        self._ask(Opcode.LIST, pause=LIST_S)


# Contents of the camera's channels: consecutive records of one size.


Raw = npt.NDArray[np.uint8]

#: The seconds of the channel `events` have 16 bits, so that its clock wraps after 18.2 hours.
PERIOD_US = 65_536 * 1_000_000


class Records(ABC):
    """Decodes the records of one channel.

    Attributes
    ----------
    name : str
        One of `FORMATS`.
    size : int
        Bytes of one record.
    most : int
        Largest number of events in one record.
    wraps : int
        Number of wraps of the clock of the camera, which the records continue.
    """

    name: str
    size: int
    most: int
    wraps: int = 0

    @abstractmethod
    def decode(self, raw: Raw, health: Health, host_us: int) -> Columns:
        """Decode the whole records of one reply or a part of it."""

    def lose(self) -> None:  # noqa: B027, not every kind remembers anything
        """Handle the loss of records before the next ones."""


class EventRecords(Records):
    """Decodes ``events``: type, seconds, milliseconds, microseconds, column, row, as u16.

    Type 0 is OFF, 1 is ON; 2 to 5 are edges of the trigger inputs, which are not events.
    """

    name, size, most = "events", 12, 1

    def __init__(self) -> None:
        # last time on the device's clock, the same time without wraps, and number of wraps
        self._state = np.array([-1, 0, 0], dtype=np.int64)

    @property
    def wraps(self) -> int:  # type: ignore[override]
        """Number of wraps of the clock."""
        return int(self._state[2])

    def decode(self, raw: Raw, health: Health, host_us: int) -> Columns:
        """See `Records.decode`; an invalid record is counted as undated."""
        rows = raw.view("<u2").reshape(-1, 6)
        t, x, y, p = empty_columns(len(rows))
        n, odd = _events(rows, t, x, y, p, self._state)
        health.reject_undated(odd)
        return Columns(t[:n], x[:n], y[:n], p[:n])


@kernel
def _events(rows, t, x, y, p, state):  # type: ignore[no-untyped-def]
    half = PERIOD_US // 2
    last, now = state[0], state[1]
    n = odd = 0
    for i in range(rows.shape[0]):
        kind = rows[i, 0]
        if kind > 5 or rows[i, 2] > 999 or rows[i, 3] > 999:
            odd += 1
            continue
        if kind > 1:
            continue
        time = np.int64(rows[i, 1]) * 1_000_000 + np.int64(rows[i, 2]) * 1_000 + rows[i, 3]
        if last < 0:
            last = now = time
        step = time - last
        if step < -half:
            step += PERIOD_US
            state[2] += 1
        elif step >= half:
            step -= PERIOD_US
            state[2] -= 1
        now += step
        last = time
        t[n], x[n], y[n], p[n] = now, rows[i, 4], rows[i, 5], kind == 1
        n += 1
    state[0], state[1] = last, now
    return n, odd


class EvtRecords(Records):
    """Decodes ``raw_events`` as Prophesee words, whose state is kept between replies."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._words = words = EvtWordDecoder(name, 1)
        self.size, self.most = words.dtype.itemsize, words.per_word

    @property
    def wraps(self) -> int:  # type: ignore[override]
        """Number of wraps of the clock."""
        return self._words.wraps

    def decode(self, raw: Raw, health: Health, host_us: int) -> Columns:
        """See `Records.decode`."""
        columns = self._words.decode(raw.view(self._words.dtype))
        health.reject_undated(self._words.take_undated())
        # the decoder's columns are valid until its next call, but a reply may come in two parts
        return Columns(*(np.array(column) for column in columns))

    def lose(self) -> None:
        """See `Records.lose`; time and place of the missing words are not known."""
        self._words.lose()


class AerRecords(Records):
    """Decodes ``raw_events`` as 19 bits in three bytes, without a time of their own."""

    name, size, most = "aer", 3, 1

    def decode(self, raw: Raw, health: Health, host_us: int) -> Columns:
        """See `Records.decode`."""
        low, middle, high = raw.reshape(-1, 3).T.astype(np.uint16)
        y = low | (middle & 1) << 8
        x = middle >> 1 | (high & 3) << 7
        return Columns(np.full(y.size, host_us, dtype=np.int64), x, y, high & 4 != 0)


FORMATS = ("events", "evt2", "evt21", "evt3", "aer")


def record_decoder(records_format: str) -> Records:
    """Make a decoder of one of `FORMATS`."""
    if records_format == "events":
        return EventRecords()
    return AerRecords() if records_format == "aer" else EvtRecords(records_format)


def record_encoder(records_format: str, sensor: Sensor) -> Callable[[Events], bytes]:
    """Return the function that encodes events in one of `FORMATS`."""
    if records_format == "events":
        return _event_rows
    if records_format == "aer":
        return _aer_bytes
    return ENCODERS[records_format](sensor).encode


def _event_rows(events: Events) -> bytes:
    t = events["t"] % PERIOD_US
    rows = np.empty((events.size, 6), dtype="<u2")
    rows[:, 0], rows[:, 1], rows[:, 2] = events["p"], t // 1_000_000, t // 1_000 % 1_000
    rows[:, 3], rows[:, 4], rows[:, 5] = t % 1_000, events["x"], events["y"]
    return rows.tobytes()


def _aer_bytes(events: Events) -> bytes:
    word = events["y"].astype(np.uint32) | events["x"].astype(np.uint32) << 9
    word |= events["p"].astype(np.uint32) << 18
    return word.astype("<u4").view(np.uint8).reshape(-1, 4)[:, :3].tobytes()


#: Most events of an unrequested packet.
PACKET_EVENTS = 256


class PushingEncoder(Encoder):
    """Device that sends the packets of one channel without a request."""

    host_needs_options = True

    def __init__(
        self, sensor: Sensor, channel: int, encode_records: Callable[[Events], bytes]
    ) -> None:
        super().__init__(sensor)
        self._channel, self._encode = channel, encode_records
        self._sequence = 0

    def encode(self, events: Events) -> bytes:
        """Encode events."""
        return b"".join(
            self._packet(self._encode(events[i : i + PACKET_EVENTS]))
            for i in range(0, events.size, PACKET_EVENTS)
        )

    def _packet(self, payload: bytes) -> bytes:
        packet = pack(Opcode.READ, self._sequence, self._channel, 0, payload)
        self._sequence = (self._sequence + 1) & 0xFF
        return packet


# From packets to events: what decoders that ask and decoders that only listen have in common.


class PacketDecoder(Decoder):
    """Finds packets and decodes records; subclasses handle the packets."""

    resync_bytes = MAX_PACKET + HEADER.size

    def __init__(self, sensor: Sensor, records: Records) -> None:
        super().__init__(sensor, Clock(confirm=1), BOUND)  # a checksum protects each record
        self._records = records
        self._finder = PacketFinder()
        self._distrusted = 0
        #: the beginning of a record, and the number of bytes to skip before the next record begins
        self._rest, self._skip = b"", 0

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
            aligned.flags.writeable = False  # as bytes are, or another kernel would be compiled
            parts.append(self._records.decode(aligned, self.health, self._host_us))
            self.health.wraps = self._records.wraps
        return (whole - skip) // self._records.size


class ListeningDecoder(PacketDecoder):
    """Decodes the packets of one channel of a device that sends them without commands.

    Parameters
    ----------
    channel : int
        Number of the channel.
    """

    def __init__(self, sensor: Sensor, channel: int, records: Records) -> None:
        super().__init__(sensor, records)
        self._channel = channel
        self._sequence: int | None = None
        self._fragments = False
        #: whether a record begins at the next bytes
        self._placed = True

    def _samples(self) -> Iterable[bytes]:
        encode = record_encoder(self._records.name, self.sensor)
        encoder = PushingEncoder(self.sensor, self._channel, encode)
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


# The decoder that asks a camera.
#
# The camera has named channels. A script on it registers ``events`` or ``raw_events``, whose number
# is in the list of channels. `docs/serial.md` names the scripts.


class AskingDecoder(PacketDecoder):
    """Requests packets from a camera; a packet is delivered whole and undamaged, or not at all.

    If an answer began to arrive, its loss is known to the record: the camera has stated the number
    of bytes, and has freed them. If no part arrived, the camera may still hold the data. The camera
    does not report what it dropped before a request.

    Parameters
    ----------
    channel : str
        Name of the channel.
    acknowledge : bool
        Ask the camera to repeat lost packets. This is slower, as only one fragment is sent at a
        time.
    """

    baud = BAUD

    def __init__(
        self, sensor: Sensor, channel: str, records: Records, *, acknowledge: bool = False
    ) -> None:
        super().__init__(sensor, records)
        self._dialogue = Dialogue(channel, acknowledge)
        self._unanswered = 0
        #: of the current read: its bytes, bytes received or passed over, and records received
        self._size = self._position = self._came = 0

    def setup(self) -> bytes:
        """See `Decoder.setup`."""
        return self._dialogue.opening()

    def greeting(self) -> bytes:
        """Return nothing: `to_send` asks a silent camera again."""
        return b""

    def to_send(self, now_s: float) -> bytes:
        """See `Decoder.to_send`."""
        dialogue = self._dialogue
        if dialogue.overdue(now_s):
            self.health.retries += 1
            self._unanswered += dialogue.awaited == Opcode.SYNC
            self._give_up()
            dialogue.restart()
            # the rest of an incomplete packet will not come
            self._distrusted = len(self._pending)
        out = dialogue.send(now_s)
        self.tick_s, self.remark = dialogue.tick_s, dialogue.remark
        if self._unanswered > 1:
            self.remark = (
                f"the camera does not answer: open a serial port at {BAUD} baud, and have "
                "firmware 5.0 or later on the camera"
            )
        return out

    def feed(self, data: bytes, host_us: int = 0) -> Events:
        """See `Decoder.feed`."""
        dialogue, errors = self._dialogue, self.health.crc_errors
        before = dialogue.sequence, dialogue.awaited
        events = super().feed(data, host_us)
        if (dialogue.sequence, dialogue.awaited) != before:
            dialogue.restart_wait()
        if self.health.crc_errors > errors:
            dialogue.hurry()
        return events

    def finish(self) -> Events:
        """See `Decoder.finish`."""
        events = super().finish()
        self._give_up()
        return events

    def gap(self, dropped_bytes: int = 0) -> Events:
        """See `Decoder.gap`."""
        events = super().gap(dropped_bytes)
        if not dropped_bytes:
            # the caller that opened the link again has sent the opening command
            self._dialogue.opening()
        return events

    def _lose_sync(self) -> None:
        self._give_up()
        self._dialogue.restart()

    def warm_up(self) -> None:
        """See `Decoder.warm_up`; packets and records are those of a device that is not asked."""
        ListeningDecoder(self.sensor, 0, copy.deepcopy(self._records)).warm_up()

    def _aim(self, finder: PacketFinder) -> None:
        dialogue = self._dialogue
        finder.limit, finder.sequence = dialogue.limit, dialogue.sequence
        reading = dialogue.awaited == Opcode.READ
        # data beyond the requested size is not joined, so that each packet is checked
        joins = reading and self._position < self._size
        finder.channel = dialogue.channel if joins and dialogue.channel is not None else -1

    def _take_joined(self, finder: PacketFinder, n_bytes: int) -> None:
        self._position += n_bytes
        self._dialogue.sequence = finder.sequence

    def _take_bytes(self, raw: npt.NDArray[np.uint8], parts: list[Columns]) -> int:
        n = super()._take_bytes(raw, parts)
        self._came += n
        return n

    def _take_packet(self, packet: Packet, parts: list[Columns]) -> None:
        dialogue, flags = self._dialogue, packet.flags
        if flags & Flag.ACK_REQ:
            dialogue.acknowledge(packet)
        if flags & Flag.EVENT:
            dialogue.receive_event(packet)
            return
        if flags & Flag.RTX and packet.sequence != dialogue.sequence:
            return  # received before; only its acknowledgement was lost
        self._unanswered = 0
        if (
            dialogue.awaited == packet.opcode == Opcode.READ
            and packet.channel == dialogue.channel
            and not flags & (Flag.ACK | Flag.NAK)
        ):
            self._take_fragment(packet, parts)
            return
        before = dialogue.awaited
        dialogue.receive(packet)
        if before == Opcode.READ != dialogue.awaited:
            self._give_up()
        elif before != Opcode.READ == dialogue.awaited:
            self._size, self._position, self._came = dialogue.size, 0, 0
            self._rest, self._skip = b"", 0

    def _take_fragment(self, packet: Packet, parts: list[Columns]) -> None:
        """Decode a fragment of the requested data; all fragments but the last have one length."""
        dialogue, n = self._dialogue, len(packet.payload)
        missing = (packet.sequence - dialogue.sequence) & 0xFF
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
            dialogue.restart()
            return
        if missing:
            self.health.sequence_gaps += 1
            self._rest, self._skip = b"", -start % self._records.size
            self._records.lose()
        dialogue.sequence = (packet.sequence + 1) & 0xFF
        self._position = start + n
        self._take_bytes(np.frombuffer(self._rest + packet.payload, dtype=np.uint8), parts)
        if last:
            self._account()
            dialogue.poll()

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
    channel, records_format = read_channel(options)
    acknowledge = options.choice("ack", ("off", "on")) == "on"
    records = record_decoder(records_format)
    if isinstance(channel, int):
        return ListeningDecoder(sensor, channel, records)
    return AskingDecoder(sensor, channel, records, acknowledge=acknowledge)


def open_encoder(name: str, sensor: Sensor, options: OptionReader) -> Encoder:
    """Make an encoder of a device that sends without being asked."""
    channel, records_format = read_channel(options)
    if not isinstance(channel, int):
        raise UsageError(
            f"openmv: channel={channel}: only a device that sends without being asked is played: "
            "give the number of its channel, such as openmv:channel=4"
        )
    return PushingEncoder(sensor, channel, record_encoder(records_format, sensor))


def read_channel(options: OptionReader) -> tuple[str | int, str]:
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
