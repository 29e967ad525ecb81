"""Our own frames; `docs/protocol_evpr.md` is their specification."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
from numba import njit

from edge_vpr.errors import UsageError
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.source import Columns
from edge_vpr.stream.gate import Clock
from edge_vpr.stream.health import EXACT
from edge_vpr.stream.protocols.cobs import stuff, unstuff
from edge_vpr.stream.protocols.protocol import Decoder, Encoder, OptionReader, made_up_events

#: Longest frame before stuffing, and with stuffing (without the zero at its end).
MAX_FRAME = 8_192
MAX_STUFFED = MAX_FRAME + MAX_FRAME // 254 + 1
#: kind, widths, boot, sequence, dropped, base time
HEADER = struct.Struct("<BBHIIQ")
CHECK = struct.Struct("<I")
VERSION = 1
_NO_FRAME = b"\0"


class EvprDecoder(Decoder):
    """Decodes frames; a frame is delivered whole and undamaged, or not at all."""

    resync_bytes = MAX_STUFFED + 1

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor, Clock(confirm=1), EXACT)
        self._frame = np.empty(MAX_STUFFED, dtype=np.uint8)
        self._boot: int | None = None
        self._next = 0  # sequence number that the next frame should have
        self._dropped = 0
        self._endless = False  # within a frame that is too long already
        self._reserve(1 << 14)

    def _samples(self) -> Iterable[bytes]:
        yield EvprEncoder(Sensor(1, 1)).encode(made_up_events())

    def setup(self) -> bytes:
        """Say that the host is there, by an empty frame."""
        return _NO_FRAME

    def _reserve(self, words: int) -> None:
        self._t = np.empty(words, dtype=np.int64)
        self._x, self._y = np.empty(words, np.uint16), np.empty(words, np.uint16)
        self._p = np.empty(words, dtype=np.bool_)

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        *frames, rest = data.split(_NO_FRAME)
        if len(data) // 3 > self._t.size:
            self._reserve(len(data) // 3)
        n = 0
        for frame in frames:
            if self._endless:
                self.health.skipped_bytes += len(frame) + 1
                self._endless = False
            elif frame:
                found = self._take_frame(frame, n)
                if found < 0:
                    self.health.crc_errors += 1
                    self.health.resyncs += 1
                    self.health.skipped_bytes += len(frame) + 1
                else:
                    n += found
                    self.health.frames += 1
        if self._endless or len(rest) > MAX_STUFFED or (final and rest):
            self.health.skipped_bytes += len(rest)
            if not self._endless:
                self.health.crc_errors += 1
                self.health.resyncs += 1
                self._endless = True
            rest = b""
        self._endless = self._endless and not final
        return [Columns(self._t[:n], self._x[:n], self._y[:n], self._p[:n])], rest

    def _take_frame(self, stuffed: bytes, at: int) -> int:
        """Decode one frame into the columns from `at` on; return its events, -1 if damaged."""
        if len(stuffed) > MAX_STUFFED:
            return -1
        frame = self._frame
        size = unstuff(np.frombuffer(stuffed, dtype=np.uint8), frame)
        end = size - CHECK.size
        if (
            end < HEADER.size
            or zlib.crc32(frame[:end].data) != CHECK.unpack_from(frame.data, end)[0]
        ):
            return -1
        kind, widths, boot, sequence, dropped, base = HEADER.unpack_from(frame.data)
        width = kind & 15
        x_bits, y_bits = widths & 15, widths >> 4
        words = end - HEADER.size
        if kind >> 4 != VERSION or width not in (3, 4) or words % width or base >= 1 << 62:
            return -1
        if x_bits + y_bits + 2 > 8 * width:
            return -1
        self._gate.start_at(base)
        self._idle_at = -1 if words else base
        n = _take_words(
            frame[HEADER.size : end], width, x_bits, y_bits, base,
            self._t[at:], self._x[at:], self._y[at:], self._p[at:],
        )  # fmt: skip
        self._account(boot, sequence, dropped, n)
        return int(n)

    def _account(self, boot: int, sequence: int, dropped: int, n: int) -> None:
        """Compare the device's running totals, modulo 2^32, with ours."""
        health = self.health
        if self._boot is None:
            self._next, self._dropped = sequence, dropped
        elif boot != self._boot:
            health.device_resets += 1
            self._next, self._dropped = 0, 0
        missing = (sequence - self._next) & 0xFFFFFFFF
        health.sequence_gaps += missing > 0
        health.lost += missing
        health.lost_at_most = health.lost
        health.device_dropped += (dropped - self._dropped) & 0xFFFFFFFF
        self._boot, self._dropped = boot, dropped
        self._next = (sequence + n) & 0xFFFFFFFF


@njit(cache=True, nogil=True)
def _take_words(data, width, x_bits, y_bits, base, t, x, y, p):  # type: ignore[no-untyped-def]
    """Little-endian words: from the lowest bit on x, y, polarity, time since the word before.

    A word whose time field is all ones is a pause, as long as its other bits say.
    """
    p_at = x_bits + y_bits
    t_at = p_at + 1
    x_mask, y_mask = (1 << x_bits) - 1, (1 << y_bits) - 1
    pause, pause_mask = (1 << (8 * width - t_at)) - 1, (1 << t_at) - 1
    now, n = np.int64(base), 0
    for i in range(0, data.size, width):
        word = np.int64(data[i]) | np.int64(data[i + 1]) << 8 | np.int64(data[i + 2]) << 16
        if width == 4:
            word |= np.int64(data[i + 3]) << 24
        step = word >> t_at
        if step == pause:
            now += word & pause_mask
            continue
        now += step
        t[n] = now
        x[n] = word & x_mask
        y[n] = word >> x_bits & y_mask
        p[n] = word >> p_at & 1
        n += 1
    return n


class EvprEncoder(Encoder):
    """Makes frames of as many events as fit.

    Parameters
    ----------
    sensor : Sensor
    width : {3, 4}
        Bytes an event.
    boot : int
        Number of this run of the device.
    frame_bytes : int
        Longest frame before stuffing; shorter ones lose less to a damaged byte.

    Attributes
    ----------
    dropped : int
        Events the device had to drop so far; set by whoever drops them.
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
        """Give a frame without events at time 0, so that the host's time 0 is the device's."""
        return self.idle(0)

    def idle(self, now_us: int) -> bytes:
        """Give a frame without events: the device is alive, and nothing was lost."""
        return self._frame_of(b"", now_us)

    def encode(self, events: Events) -> bytes:
        """Encode as one frame or several."""
        frames = []
        for i in range(0, events.size, self._words):
            words, counted, base = self._words_of(events[i : i + self._words])
            # pauses are words as well, so that a quiet stretch takes more than one frame
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
        """Lay out words; tell which are events, and what time it is before each."""
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
        return stuff(frame + CHECK.pack(zlib.crc32(frame))) + _NO_FRAME


def open_decoder(name: str, sensor: Sensor, options: OptionReader) -> Decoder:
    """Make a decoder; widths are in each frame, so that it has no options."""
    return EvprDecoder(sensor)


def open_encoder(name: str, sensor: Sensor, options: OptionReader) -> Encoder:
    """Make an encoder."""
    return EvprEncoder(
        sensor,
        width=int(options.choice("width", ("4", "3"))),
        boot=options.integer("boot", 0, 0, 0xFFFF),
        frame_bytes=options.integer("frame", 2_048, 64, MAX_FRAME),
    )
