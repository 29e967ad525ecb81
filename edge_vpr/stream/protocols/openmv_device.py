"""Camera's side of OpenMV's protocol, for bridges and tests."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from edge_vpr.events import Events, Sensor
from edge_vpr.stream.protocols.openmv_camera import READ_BYTES, Camera
from edge_vpr.stream.protocols.openmv_packets import Opcode, pack
from edge_vpr.stream.protocols.protocol import Encoder

#: Number of buffers of a script, and most events of an unrequested packet.
BUFFERS, PACKET_EVENTS = 8, 256


class CameraEncoder(Encoder):
    """Camera with a script that registers one channel.

    Parameters
    ----------
    sensor : Sensor
    channel : str
    make : callable
        Function that encodes events as records.
    buffer_events : int
        Number of events in one of the script's buffers.
    """

    waits_for_host = True

    def __init__(
        self,
        sensor: Sensor,
        channel: str,
        make: Callable[[Events], bytes],
        *,
        buffer_events: int = 8_192,
        fragment: int = READ_BYTES,
    ) -> None:
        super().__init__(sensor)
        self._channel, self._make, self._most = channel, make, buffer_events
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
            self._camera.buffers.append(self._make(part))
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


class PushingEncoder(Encoder):
    """Device that sends the packets of one channel without a request."""

    def __init__(self, sensor: Sensor, channel: int, make: Callable[[Events], bytes]) -> None:
        super().__init__(sensor)
        self._channel, self._make = channel, make
        self._sequence = 0

    def encode(self, events: Events) -> bytes:
        """Encode events."""
        return b"".join(
            self._packet(self._make(events[i : i + PACKET_EVENTS]))
            for i in range(0, events.size, PACKET_EVENTS)
        )

    def _packet(self, payload: bytes) -> bytes:
        packet = pack(Opcode.READ, self._sequence, self._channel, 0, payload)
        self._sequence = (self._sequence + 1) & 0xFF
        return packet
