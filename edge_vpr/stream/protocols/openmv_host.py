"""The host's side of the dialogue with an OpenMV camera: decides which command comes next.

Synchronise, agree on capabilities, list the channels, and then poll, ask for the size and read,
again and again. One number counts the packets of both directions: a command has the number of the
next packet that the camera will send, which its answer then has; each further fragment takes the
next. (The maker's page on reliability speaks of a number for each direction; neither its host nor
its firmware does so.)

The camera frees a buffer once it has sent it, and with acknowledgements off, as the maker's own
tool for the GENX320 has them, it sends nothing twice. A lost fragment is then lost. With them on,
the camera sends one fragment at a time and repeats it after 0.5 s without an answer. A refusal
(NAK) would be faster; but the firmware takes it for an answer to the repetition as well, gives up
after three and starts anew, so that, like the maker's host, this one never refuses.

Whatever goes wrong, after a while without an answer the conversation begins again: SYNC is taken
in any state, and makes the camera forget the conversation before.
"""

from __future__ import annotations

import struct

from edge_vpr.errors import printable
from edge_vpr.stream.protocols.openmv_packets import (
    CAP_ACK,
    CAP_CRC,
    CAP_EVENTS,
    CAP_SEQ,
    CAPS,
    ENTRY,
    EXTENT,
    MAX_PAYLOAD,
    Flag,
    Opcode,
    Packet,
    Status,
    pack,
)

#: An answer is late after this, as in the maker's host; doubled each time in a row up to this.
PATIENCE_S, LONGEST_S = 1.0, 4.0
#: A camera that repeats what is lost has given up by then.
REPEATED_S = 8.0
#: After damaged bytes it is late sooner, if nobody sends it again.
DAMAGED_S = 0.1
#: An empty channel is asked again after this, as by the maker's tool, and a missing one after that.
POLL_S, LIST_S = 0.004, 0.25
#: Longest answer that is put together, but for what is read.
_LONGEST_ANSWER = 1 << 16
#: The least that the firmware takes for the longest payload.
_LEAST_PAYLOAD = 50
#: Characters of the names of channels that are told.
_LONGEST_LIST = 200


class Session:
    """Asks a camera for one channel.

    Parameters
    ----------
    name : str
        Of the channel.
    acknowledge : bool
        Ask the camera to repeat what is lost.

    Attributes
    ----------
    sequence : int
        Number of the next packet.
    awaited : Opcode
        Whose answer comes next.
    channel : int or None
        Number of the channel, once it is known.
    size : int
        Bytes of what is being read.
    limit : int
        Longest payload, once it is agreed on.
    remark : str
        What the user should know.
    """

    def __init__(self, name: str, acknowledge: bool) -> None:
        self.name, self._acknowledge = name, acknowledge
        self._patience, self._hurried = PATIENCE_S, False
        self.remark = ""
        self.restart()

    def restart(self) -> None:
        """Begin again."""
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
        #: empty once it is sent
        self._command = pack(opcode, self.sequence, channel, 0, payload)
        self._pause = pause
        if opcode == Opcode.READ and self._acknowledge:
            # what is lost comes again, after 0.5 s, and 1, 2 and 4 s later
            self._patience = REPEATED_S
        #: when the pause is over, or else when the answer is late; None: counted from the next send
        self._moment: float | None = None

    def opening(self) -> bytes:
        """Return the opening command, for a caller that sends it."""
        out, self._command = self._command, b""
        return out

    @property
    def tick_s(self) -> float:
        """`send` wants to be called this often."""
        return self._pause or 0.1

    def send(self, now_s: float) -> bytes:
        """Return what to send now."""
        out, self._acknowledgements = self._acknowledgements, b""
        if self._moment is None:
            self._moment = now_s + (self._pause if self._command else self._patience)
        if self._command and now_s >= self._moment:
            out += self._command
            self._command, self._pause = b"", 0.0
            self._moment = now_s + self._patience
        return out

    def overdue(self, now_s: float) -> bool:
        """Return whether an answer is late; the limit for the next one is then longer."""
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
            # also where none is awaited: it was asked twice, and the camera has forgotten the rest
            self.restart()
            self._ask(Opcode.GET_CAPS)
        elif self.awaited == Opcode.SYNC:
            return
        elif packet.opcode != self.awaited or packet.sequence != self.sequence:
            # an answer to something else may be old; a refusal, or a gap, is about what is asked
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
                self.restart()  # too short

    def _hear_refusal(self, packet: Packet) -> None:
        status = int.from_bytes(packet.payload[:2], "little")
        if status in (Status.FAILED, Status.INVALID, Status.BUSY):
            # the channel is gone, or has nothing yet
            self.sequence = (self.sequence + 1) & 0xFF
            self._ask(Opcode.LIST, pause=LIST_S)
        else:
            self.restart()

    def _go_on(self, answer: bytes) -> None:
        """Choose the command that follows an answer."""
        if self.awaited == Opcode.GET_CAPS:
            self._offered = max(_LEAST_PAYLOAD, CAPS.unpack_from(answer)[1])
            wanted = CAP_CRC | CAP_SEQ | CAP_EVENTS | (CAP_ACK if self._acknowledge else 0)
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
        """Ask for more data, when all has been read."""
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
