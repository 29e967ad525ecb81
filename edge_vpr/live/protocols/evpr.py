"""Frames of this project, which `docs/protocol_evpr.md` specifies: decoder and encoder."""

from __future__ import annotations

import struct
import zlib
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel, shared_state
from edge_vpr.errors import UsageError
from edge_vpr.events import Columns, Events, Sensor, empty_columns
from edge_vpr.live.protocols import Clock, Decoder, Encoder, OptionReader
from edge_vpr.live.protocols.health import EXACT
from edge_vpr.live.protocols.timestamps import (
    admit_columns,
    reach,
    restart_clock,
    start_clock,
)

#: Longest frame before stuffing, and after stuffing (without the zero at its end).
MAX_FRAME = 8_192
MAX_STUFFED = MAX_FRAME + MAX_FRAME // 254 + 1
#: kind, widths, boot, sequence, dropped, base time
HEADER = struct.Struct("<BBHIIQ")
CHECK = struct.Struct("<I")
VERSION = 1
#: ends each frame; on its own, it is an empty frame
FRAME_END = b"\0"


# Consistent overhead byte stuffing: converts any bytes to bytes without a zero.
#
# S. Cheshire, M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Trans. Networking 7(2), 1999.
# A zero can then mark the end of a frame, and a reader that is out of sync waits for the next.


Bytes = npt.NDArray[np.uint8]


def stuff(data: bytes) -> bytes:
    r"""Return the bytes without a zero, with one more byte for each 254 bytes or part of them.

    Examples
    --------
    >>> stuff(b"a\x00b").hex(" ")
    '02 61 02 62'
    """
    out = np.empty(len(data) + len(data) // 254 + 2, dtype=np.uint8)
    n = _stuff(np.frombuffer(data, dtype=np.uint8), out)
    return out[:n].tobytes()


@kernel
def _stuff(data: Any, out: Any) -> Any:
    code_at, n, code = 0, 1, 1
    for i in range(data.size):
        if data[i] != 0:
            out[n] = data[i]
            n += 1
            code += 1
        if data[i] == 0 or code == 255:
            out[code_at] = code
            code_at, code = n, 1
            n += 1
    out[code_at] = code
    return n


@kernel
def unstuff(data: Any, out: Any) -> Any:
    """Decode `data`, which has no zero, into `out`; return its length, or -1 if it is damaged."""
    i, n = 0, 0
    while i < data.size:
        code: Any = np.int64(data[i])
        if code == 0 or i + code > data.size:
            return -1
        for k in range(i + 1, i + code):
            out[n] = data[k]
            n += 1
        i += code
        if code < 255 and i < data.size:
            out[n] = 0
            n += 1
    return n


# CRC-32 as computed by zlib, for use within kernels.


#: remainders of each byte with 0 to 7 zero bytes after it, shape (8, 256)
_TABLES = np.array(
    [
        [zlib.crc32(bytes([byte, *[0] * zeros]), 0xFFFFFFFF) ^ 0xFFFFFFFF for byte in range(256)]
        for zeros in range(8)
    ]
)


@kernel
def crc32(data: Any, start: Any, stop: Any) -> Any:
    """Return the checksum of ``data[start:stop]``.

    Parameters
    ----------
    data : ndarray of uint8, shape (n,)
        Bytes, of which a part is checked.
    start, stop : int
        From 0 to n.
    """
    value = np.int64(0xFFFFFFFF)
    i = start
    # eight bytes a step, since their remainders do not depend on each other
    while i + 8 <= stop:
        value = (
            _TABLES[7, (value & 255) ^ data[i]]
            ^ _TABLES[6, ((value >> 8) & 255) ^ data[i + 1]]
            ^ _TABLES[5, ((value >> 16) & 255) ^ data[i + 2]]
            ^ _TABLES[4, (value >> 24) ^ data[i + 3]]
            ^ _TABLES[3, data[i + 4]]
            ^ _TABLES[2, data[i + 5]]
            ^ _TABLES[1, data[i + 6]]
            ^ _TABLES[0, data[i + 7]]
        )
        i += 8
    while i < stop:
        value = (value >> 8) ^ _TABLES[0, (value & 255) ^ data[i]]
        i += 1
    return value ^ 0xFFFFFFFF


# Kernels that decode frames.


_HEADER_BYTES, _CHECK_BYTES = HEADER.size, CHECK.size
#: A frame that was sent less than this before the last one is a repetition.
REPEAT_US = 1_000_000
# State between frames.
_STATE = np.dtype(
    [
        ("boot", "<i8"),  # number of the device's start; -1: no frame yet
        ("next", "<i8"),  # expected sequence number of the next frame
        ("dropped", "<i8"),  # events that the device has reported as dropped
        ("last", "<i8"),  # base time of the last frame
        ("x_bits", "<i8"),  # that the expected sensor needs
        ("y_bits", "<i8"),
    ]
)
# Results of the frames of one chunk.
_COUNTS = np.dtype(
    [
        # number of each kind
        ("frames", "<i8"),
        ("damaged", "<i8"),
        ("skipped_bytes", "<i8"),
        ("repeats", "<i8"),
        ("gaps", "<i8"),
        ("lost", "<i8"),
        ("dropped", "<i8"),
        ("resets", "<i8"),
        ("narrow", "<i8"),  # frames whose x or y have fewer bits than the expected sensor needs
        ("base", "<i8"),  # base time of the last frame
        ("idle", "<i8"),  # whether the last frame states its time without events
    ]
)


class FrameBuffers(NamedTuple):
    """Buffers for the frames of one chunk, and the state that is kept between chunks."""

    plain: Bytes  #: Shape (MAX_STUFFED,): one frame without stuffing.
    columns: Columns  #: Events of one frame.
    state: npt.NDArray[np.void]  #: Shape (1,): state that is kept between chunks.
    counts: npt.NDArray[np.void]  #: Shape (1,): counts of what the chunk held.

    @classmethod
    def of(cls, state: npt.NDArray[np.void]) -> FrameBuffers:
        """Make buffers for the longest frame."""
        plain, counts = np.empty(MAX_STUFFED, dtype=np.uint8), np.zeros(1, dtype=_COUNTS)
        return cls(plain, empty_columns(MAX_STUFFED // 3), state, counts)


@kernel
def _decode_frames(kernel_state, clock, data):  # type: ignore[no-untyped-def]
    """Decode whole frames, and filter their events.

    Parameters
    ----------
    kernel_state : KernelState
        Of `FrameBuffers`.
    clock : KernelState
        Of the state of a `TimestampFilter`.
    data : bytes
        Frames, each with the zero at its end.

    Returns
    -------
    t, x, y, p : ndarray, shape (n,)
        Events.
    decoded : int
        Number of events in undamaged frames. All other counts are in `FrameBuffers.counts`.
    """
    buffers, raw = FrameBuffers(*kernel_state.value), np.frombuffer(data, dtype=np.uint8)
    buffers.counts.view(np.int64)[:] = 0
    n, start, end, totals = 0, 0, 0, buffers.counts[0]
    t, x, y, p = buffers.columns
    most = raw.size // 3 + 1  # with one that is held
    t_out, x_out = np.empty(most, np.int64), np.empty(most, np.uint16)
    y_out, p_out = np.empty(most, np.uint16), np.empty(most, np.bool_)
    for i in range(raw.size):
        if raw[i] != 0:
            continue
        if i > start:
            size = unstuff(raw[start:i], buffers.plain) if i - start <= MAX_STUFFED else -1
            frames, resets = totals["frames"], totals["resets"]
            events = _take_frame(buffers, size - _CHECK_BYTES, i - start + 1)
            # the clock takes one frame after the other, so that it is the same for any chunks
            if totals["frames"] > frames:
                start_clock(clock, totals["base"])
                if totals["resets"] > resets:
                    restart_clock(clock, totals["base"])
                end += admit_columns(
                    clock, t[:events], x[:events], y[:events], p[:events],
                    t_out[end:], x_out[end:], y_out[end:], p_out[end:],
                )  # fmt: skip
                if totals["idle"]:
                    reach(clock, totals["base"])
            n += events
        start = i + 1
    return t_out[:end], x_out[:end], y_out[:end], p_out[:end], n


@kernel
def _number(data, at, size):  # type: ignore[no-untyped-def]
    number = np.int64(0)
    for i in range(size):
        number |= np.int64(data[at + i]) << (8 * i)
    return number


@kernel
def _take_frame(buffers, end, taken):  # type: ignore[no-untyped-def]
    """Decode a frame whose checksum is at `end`, and compare the device's totals with ours.

    The frame took `taken` bytes on the line. Its events are in the columns, and counted.
    """
    plain, columns, state, counts = buffers
    last, totals = state[0], counts[0]
    width, x_bits, y_bits = (
        np.int64(plain[0] & 15),
        np.int64(plain[1] & 15),
        np.int64(plain[1] >> 4),
    )
    words = end - _HEADER_BYTES
    if (
        words < 0
        or _number(plain, end, _CHECK_BYTES) != crc32(plain, 0, end)
        or plain[0] >> 4 != VERSION
        or (width != 3 and width != 4)
        or words % width
        or x_bits + y_bits + 2 > 8 * width
        or plain[19] >= 64  # base time of 2^62 or more
    ):
        totals["damaged"] += 1
        totals["skipped_bytes"] += taken
        return 0
    boot, sequence = _number(plain, 2, 2), _number(plain, 4, 4)
    dropped, base = _number(plain, 8, 4), _number(plain, 12, 8)
    # running totals are modulo 2^32
    missing = (sequence - last["next"]) & 0xFFFFFFFF
    if last["boot"] < 0:
        last["next"], last["dropped"], missing = sequence, dropped, 0
    elif boot != last["boot"] or missing >= 1 << 31:
        if boot == last["boot"] and 0 <= last["last"] - base < REPEAT_US:
            totals["repeats"] += 1
            totals["skipped_bytes"] += taken
            return 0
        # a new run of the device, even if it did not change its boot number
        totals["resets"] += 1
        last["next"], last["dropped"], missing = 0, 0, sequence
    totals["narrow"] += x_bits < last["x_bits"] or y_bits < last["y_bits"]
    totals["gaps"] += missing > 0
    totals["lost"] += missing
    totals["dropped"] += (dropped - last["dropped"]) & 0xFFFFFFFF
    totals["frames"] += 1
    totals["base"], totals["idle"] = base, words == 0
    form = width, x_bits, y_bits
    events = _take_words(plain[_HEADER_BYTES:end], form, base, columns)
    last["boot"], last["dropped"], last["last"] = boot, dropped, base
    last["next"] = (sequence + events) & 0xFFFFFFFF
    return events


@kernel
def _take_words(data, form, base, columns):  # type: ignore[no-untyped-def]
    """Decode little-endian words: from the lowest bit x, y, polarity, time since the last word.

    A word whose time field is all ones is a pause of the length in its other bits. `form` has the
    width of a word in bytes, and the widths of x and y in bits.
    """
    (width, x_bits, y_bits), (t, x, y, p) = form, columns
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


# Encoder and decoder of a stream.


def _bits_of(sensor: Sensor) -> tuple[int, int]:
    """Return the least numbers of bits of x and of y."""
    return max(1, (sensor.width - 1).bit_length()), max(1, (sensor.height - 1).bit_length())


class EvprEncoder(Encoder):
    """Encodes events as frames of as many events as fit.

    Parameters
    ----------
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
        self._x_bits, self._y_bits = _bits_of(sensor)
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
        t = events.t
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
            | events.p.astype(np.int64) << (self._t_at - 1)
            | events.y.astype(np.int64) << self._x_bits
            | events.x
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


class EvprDecoder(Decoder):
    """Decodes frames; a frame is delivered whole and undamaged, or not at all."""

    resync_bytes = MAX_STUFFED + 1

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor, Clock(vouched=True), EXACT)
        self._endless = False  # within a frame that is already too long
        state = np.array([(-1, 0, 0, 0, *_bits_of(sensor))], dtype=_STATE)
        buffers = FrameBuffers.of(state)
        self._counts, self._buffers = buffers.counts, shared_state(buffers)

    def setup(self) -> bytes:
        """Return an empty frame, which reports the host's presence."""
        return FRAME_END

    def _decode_events(self, data: bytes, *, final: bool) -> tuple[list[Events], bytes]:
        frames, rest = self._cut(data, final=final)
        return [self._take_frames(frames)] if frames else [], rest

    def _cut(self, data: bytes, *, final: bool = False) -> tuple[bytes, bytes]:
        """Return the frames of these bytes, each with the zero at its end, and the rest."""
        if data.endswith(FRAME_END) and not self._endless:
            return data, b""
        end = data.rfind(FRAME_END) + 1
        start, rest = 0, data[end:]
        if end and self._endless:
            start = data.index(FRAME_END) + 1
            self.health.skipped_bytes += start
            self._endless = False
        if self._endless or len(rest) > MAX_STUFFED or (final and rest):
            self.health.skipped_bytes += len(rest)
            if not self._endless:
                self.health.crc_errors += 1
                self.health.resyncs += 1
                self._endless = True
            rest = b""
        self._endless = self._endless and not final
        return data[start:end], rest

    def _take_frames(self, frames: bytes) -> Events:
        """Decode whole frames, and count what they show in the health."""
        health = self.health
        *columns, decoded = _decode_frames(self._buffers, self.timestamps.kernel_state, frames)
        events = Events(*columns)
        self.timestamps.report(decoded, len(events))
        counts = cast("tuple[int, ...]", self._counts.item())
        whole, damaged, skipped, repeats, gaps, lost, dropped, resets, narrow, _, _ = counts
        health.frames += whole
        if narrow:
            self.remark = (
                f"the camera's sensor is smaller than {self.sensor}, since its frames have fewer "
                "bits for x or y: use the map of this camera, or give its sensor="
            )
        health.crc_errors += damaged
        health.resyncs += damaged
        health.skipped_bytes += skipped
        health.repeats += repeats
        health.sequence_gaps += gaps
        health.lost += lost
        health.device_dropped += dropped
        health.device_resets += resets
        return events


def open_decoder(name: str, sensor: Sensor, options: OptionReader) -> Decoder:
    """Make a decoder; it has no options, since each frame states its widths."""
    return EvprDecoder(sensor)


def open_encoder(name: str, sensor: Sensor, options: OptionReader) -> Encoder:
    """Make an encoder."""
    return EvprEncoder(
        sensor,
        width=int(options.choice("width", ("4", "3"))),
        boot=options.integer("boot", 0, 0, 0xFFFF),
        frame_bytes=options.integer("frame", 2_048, 64, MAX_FRAME),
    )
