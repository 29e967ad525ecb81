"""Host's side of the dialogue with an OpenMV camera: decides which command comes next.

The host synchronises, agrees on capabilities and lists the channels. Then it repeats: poll, ask for
the size, read. One sequence number counts the packets of both directions. A command has the number
of the next packet that the camera will send; its answer has the same number, and each further
fragment has the next one. (The maker's page on reliability describes one number for each direction;
neither its host nor its firmware has that.)

The camera frees a buffer once it has sent it. With acknowledgements off, as in the maker's own tool
for the GENX320, it sends nothing twice, and a lost fragment remains lost. With them on, the camera
sends one fragment at a time and repeats it after 0.5 s without an answer. A refusal (NAK) would be
faster, but the firmware takes it for an answer to the repetition as well, and resets the dialogue
after three. Like the maker's host, this one therefore never refuses.

After any fault, the dialogue begins again once an answer has been missing for some time: the camera
accepts SYNC in any state, and it makes the camera forget the dialogue so far.
"""

from __future__ import annotations

import struct

from edge_vpr.errors import printable
from edge_vpr.stream.protocols.openmv_packets import (
    CAPS,
    ENTRY,
    EXTENT,
    MAX_PAYLOAD,
    Cap,
    Flag,
    Opcode,
    Packet,
    Status,
    pack,
)

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


class Session:
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
        """Begin the dialogue again."""
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
            self.wait_anew()

    def wait_anew(self) -> None:
        """Restart the wait for an answer."""
        if not self._command:
            self._moment = None

    def acknowledge(self, packet: Packet) -> None:
        """Add the acknowledgement of a packet to the bytes to send."""
        self._acknowledgements += pack(packet.opcode, packet.sequence, packet.channel, Flag.ACK)

    def hear_event(self, packet: Packet) -> None:
        """Handle an event of the camera: channels appear and disappear with its script."""
        if packet.channel == 0:
            self._relist = True

    def hear(self, packet: Packet) -> None:
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
            self._hear_refusal(packet)
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

    def _hear_refusal(self, packet: Packet) -> None:
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
