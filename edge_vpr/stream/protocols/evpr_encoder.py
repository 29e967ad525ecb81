"""Encoder of this project's own frames, which `docs/protocol_evpr.md` specifies."""

from __future__ import annotations

import zlib

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.events import Events, Sensor
from edge_vpr.stream.protocols.cobs import stuff
from edge_vpr.stream.protocols.evpr_frames import CHECK, FRAME_END, HEADER, VERSION
from edge_vpr.stream.protocols.protocol import Encoder


class EvprEncoder(Encoder):
    """Encodes events as frames of as many events as fit.

    Parameters
    ----------
    sensor : Sensor
    width : {3, 4}
        Bytes an event.
    boot : int
        Number that identifies this run of the device.
    frame_bytes : int
        Length of the longest frame before stuffing. With shorter frames, a damaged byte loses less.

    Attributes
    ----------
    dropped : int
        Number of events that the device has dropped so far; set by the code that drops them.
    """

    waits_for_host = True

    def __init__(
        self, sensor: Sensor, width: int = 4, boot: int = 0, frame_bytes: int = 2_048
    ) -> None:
        super().__init__(sensor)
        self._x_bits = max(1, (sensor.width - 1).bit_length())
        self._y_bits = max(1, (sensor.height - 1).bit_length())
        self._t_at = self._x_bits + self._y_bits + 1
        if max(self._x_bits, self._y_bits) > 15 or self._t_at + 1 > 8 * width:
            raise UsageError(
                f"evpr: an event of a {sensor} sensor does not fit {width} bytes: use width=4, "
                "or a part of the sensor"
            )
        self._width, self._boot = width, boot
        self._words = (frame_bytes - HEADER.size - CHECK.size) // width
        self._sequence = 0
        self.dropped = 0

    def start(self) -> bytes:
        """Return a frame without events at time 0, so that the host has the same time 0."""
        return self.idle(0)

    def idle(self, now_us: int) -> bytes:
        """Return a frame without events: the device is running, and nothing was lost."""
        return self._frame_of(b"", now_us)

    def encode(self, events: Events) -> bytes:
        """Encode events as one or more frames."""
        frames = []
        for i in range(0, events.size, self._words):
            words, counted, base = self._words_of(events[i : i + self._words])
            # pauses are words too, so that a quiet stretch may take more than one frame
            cuts = range(0, len(words), self._words)
            for cut in cuts:
                part = words[cut : cut + self._words]
                raw = part.astype("<u4").view(np.uint8).reshape(-1, 4)[:, : self._width]
                frames.append(self._frame_of(raw.tobytes(), int(base[cut])))
                self._sequence += int(counted[cut : cut + self._words].sum())
        return b"".join(frames)

    def _words_of(
        self, events: Events
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
        """Return words, which of them are events, and the time before each."""
        t = events["t"]
        steps = np.diff(t, prepend=t[0])
        pause = (1 << (8 * self._width - self._t_at)) - 1
        longest = (1 << self._t_at) - 1
        pauses = np.where(steps >= pause, -(-steps // longest), 0)
        at = np.arange(t.size) + np.cumsum(pauses)
        words = np.empty(t.size + int(pauses.sum()), dtype=np.int64)
        counted = np.zeros(words.size, dtype=np.bool_)
        counted[at] = True
        paused = np.where(pauses > 0, steps, 0)
        words[counted] = (
            (steps - paused) << self._t_at
            | events["p"].astype(np.int64) << (self._t_at - 1)
            | events["y"].astype(np.int64) << self._x_bits
            | events["x"]
        )
        took = np.zeros(words.size, dtype=np.int64)
        took[counted] = steps - paused
        if paused.any():
            owner = np.repeat(np.arange(t.size), pauses)
            first = np.repeat(np.cumsum(pauses) - pauses, pauses)
            number = np.arange(owner.size) - first
            length = np.minimum(longest, paused[owner] - number * longest)
            words[~counted] = pause << self._t_at | length
            took[~counted] = length
        return words, counted, t[0] + np.cumsum(took) - took

    def _frame_of(self, words: bytes, base: int) -> bytes:
        header = HEADER.pack(
            VERSION << 4 | self._width,
            self._y_bits << 4 | self._x_bits,
            self._boot & 0xFFFF,
            self._sequence & 0xFFFFFFFF,
            self.dropped & 0xFFFFFFFF,
            base,
        )
        frame = header + words
        return stuff(frame + CHECK.pack(zlib.crc32(frame))) + FRAME_END
