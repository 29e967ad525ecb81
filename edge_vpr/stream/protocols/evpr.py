"""Our own frames; `docs/protocol_evpr.md` is their specification."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from numba import njit

from edge_vpr.errors import UsageError
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.source import Columns
from edge_vpr.stream.health import EXACT
from edge_vpr.stream.protocols.cobs import Bytes, stuff, unstuff
from edge_vpr.stream.protocols.protocol import Decoder, Encoder, OptionReader, synthetic_events
from edge_vpr.stream.timestamp_filter import Clock, no_columns

#: Longest frame before stuffing, and with stuffing (without the zero at its end).
MAX_FRAME = 8_192
MAX_STUFFED = MAX_FRAME + MAX_FRAME // 254 + 1
#: kind, widths, boot, sequence, dropped, base time
HEADER = struct.Struct("<BBHIIQ")
CHECK = struct.Struct("<I")
VERSION = 1
_HEADER_BYTES, _CHECK_BYTES = HEADER.size, CHECK.size
_NO_FRAME = b"\0"


#: A frame that was sent before the last one, by less than this, came twice.
REPEAT_US = 1_000_000
# what is remembered from frame to frame: boot (-1: no frame yet), sequence number that the next
# frame should have, drops told so far, the last frame's base time
_MEMORY = np.dtype([("boot", "<i8"), ("next", "<i8"), ("dropped", "<i8"), ("last", "<i8")])
# what the frames of one chunk brought: how many of each kind, the first base time, and the time
# that a last frame without events tells (-1: it has events)
_BROUGHT = np.dtype(
    [
        (name, "<i8")
        for name in (
            "frames", "damaged", "skipped_bytes", "repeats", "gaps", "lost", "dropped", "resets",
            "base", "idle_at",
        )
    ]
)  # fmt: skip


class EvprDecoder(Decoder):
    """Decodes frames; a frame is delivered whole and undamaged, or not at all."""

    resync_bytes = MAX_STUFFED + 1

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor, Clock(confirm=1), EXACT)
        self._memory = np.array([(-1, 0, 0, 0)], dtype=_MEMORY)
        self._endless = False  # within a frame that is too long already
        self._reserve(1 << 12)

    def _samples(self) -> Iterable[bytes]:
        yield EvprEncoder(Sensor(1, 1)).encode(synthetic_events())

    def setup(self) -> bytes:
        """Say that the host is there, by an empty frame."""
        return _NO_FRAME

    def _reserve(self, size: int) -> None:
        """Make room for what frames of `size` bytes together can hold."""
        self._plain = np.empty(size, dtype=np.uint8)
        self._spans = np.empty((size // 2 + 1, 3), dtype=np.int64)
        self._room = no_columns(size // 3)

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        end = data.rfind(_NO_FRAME) + 1
        parts, rest = [], data[end:]
        if end:
            start = 0
            if self._endless:
                start = data.index(_NO_FRAME) + 1
                self.health.skipped_bytes += start
                self._endless = False
            parts.append(self._take_frames(np.frombuffer(data, dtype=np.uint8)[start:end]))
        if self._endless or len(rest) > MAX_STUFFED or (final and rest):
            self.health.skipped_bytes += len(rest)
            if not self._endless:
                self.health.crc_errors += 1
                self.health.resyncs += 1
                self._endless = True
            rest = b""
        self._endless = self._endless and not final
        return parts, rest

    def _take_frames(self, raw: Bytes) -> Columns:
        """Decode frames, each with the zero at its end."""
        if raw.size > self._plain.size:
            self._reserve(raw.size)
        n = _unstuff_frames(raw, self._plain, self._spans)
        spans, plain = self._spans[:n], self._plain.data
        # zlib's checksum is several times faster than a compiled one of our own
        checks = np.array(
            [zlib.crc32(plain[at : at + size]) for at, size, _ in spans.tolist()], dtype=np.int64
        )
        brought = np.zeros(1, dtype=_BROUGHT)
        t, x, y, p = self._room
        events = _take_frames(self._plain, spans, checks, self._memory, brought, t, x, y, p)
        self._account(cast("tuple[int, ...]", brought.item()))
        return Columns(t[:events], x[:events], y[:events], p[:events])

    def _account(self, brought: Any) -> None:
        health = self.health
        frames, damaged, skipped, repeats, gaps, lost, dropped, resets, base, idle_at = brought
        health.frames += frames
        health.crc_errors += damaged
        health.resyncs += damaged
        health.skipped_bytes += skipped
        health.repeats += repeats
        health.sequence_gaps += gaps
        health.lost += lost
        health.lost_at_most = health.lost
        health.device_dropped += dropped
        health.device_resets += resets
        if frames:
            self._timestamps.start_at(base)
            self._idle_at = idle_at


@njit(cache=True, nogil=True)
def _unstuff_frames(raw, plain, spans):  # type: ignore[no-untyped-def]
    """Undo the stuffing of every frame; count them.

    A span says where the plain frame lies, how many bytes its checksum covers (none if it is
    damaged beyond that), and how many bytes it took on the line.
    """
    frames, start, at = 0, 0, 0
    for i in range(raw.size):
        if raw[i] != 0:
            continue
        if i > start:
            stuffed = i - start
            size = unstuff(raw[start:i], plain[at:]) if stuffed <= MAX_STUFFED else -1
            whole = size >= _HEADER_BYTES + _CHECK_BYTES
            spans[frames, 0] = at
            spans[frames, 1] = size - _CHECK_BYTES if whole else 0
            spans[frames, 2] = stuffed + 1
            frames += 1
            at += size if whole else 0
        start = i + 1
    return frames


@njit(cache=True, nogil=True)
def _number(data, at, size):  # type: ignore[no-untyped-def]
    number = np.int64(0)
    for i in range(size):
        number |= np.int64(data[at + i]) << (8 * i)
    return number


@njit(cache=True, nogil=True)
def _take_frames(plain, spans, checks, memory, brought, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode the frames that are whole, and compare the device's running totals with ours."""
    last, found = memory[0], brought[0]
    n = 0
    for i in range(checks.size):
        at, end = spans[i, 0], spans[i, 0] + spans[i, 1]
        width, x_bits, y_bits = plain[at] & 15, plain[at + 1] & 15, plain[at + 1] >> 4
        words = end - at - _HEADER_BYTES
        if (
            words < 0
            or _number(plain, end, _CHECK_BYTES) != checks[i]
            or plain[at] >> 4 != VERSION
            or (width != 3 and width != 4)
            or words % width
            or x_bits + y_bits + 2 > 8 * width
            or plain[at + 19] >= 64  # a base time of 2^62
        ):
            found["damaged"] += 1
            found["skipped_bytes"] += spans[i, 2]
            continue
        boot, sequence = _number(plain, at + 2, 2), _number(plain, at + 4, 4)
        dropped, base = _number(plain, at + 8, 4), _number(plain, at + 12, 8)
        # running totals are modulo 2^32
        missing = (sequence - last["next"]) & 0xFFFFFFFF
        if last["boot"] < 0:
            last["next"], last["dropped"], missing = sequence, dropped, 0
        elif boot != last["boot"] or missing >= 1 << 31:
            if boot == last["boot"] and 0 <= last["last"] - base < REPEAT_US:
                found["repeats"] += 1
                found["skipped_bytes"] += spans[i, 2]
                continue
            # anew, even if the device forgot to change the number of its start
            found["resets"] += 1
            last["next"], last["dropped"], missing = 0, 0, sequence
        found["gaps"] += missing > 0
        found["lost"] += missing
        found["dropped"] += (dropped - last["dropped"]) & 0xFFFFFFFF
        if found["frames"] == 0:
            found["base"] = base
        found["frames"] += 1
        found["idle_at"] = -1 if words else base
        events = _take_words(
            plain[at + _HEADER_BYTES : end], width, x_bits, y_bits, base, t[n:], x[n:], y[n:], p[n:]
        )
        last["boot"], last["dropped"], last["last"] = boot, dropped, base
        last["next"] = (sequence + events) & 0xFFFFFFFF
        n += events
    return n


@njit(cache=True, nogil=True)
def _take_words(data, width, x_bits, y_bits, base, t, x, y, p):  # type: ignore[no-untyped-def]
    """Little-endian words: from the lowest bit on x, y, polarity, time since the word before.

    A word whose time field is all ones is a pause, as long as its other bits say.
    """
    width, x_bits, y_bits = np.int64(width), np.int64(x_bits), np.int64(y_bits)
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
