"""Kernels that decode this project's own frames, which `docs/protocol_evpr.md` specifies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.recordings.columns import Columns
from edge_vpr.stream.following import follow_kept
from edge_vpr.stream.protocols.cobs import Bytes, unstuff
from edge_vpr.stream.protocols.crc32 import crc32
from edge_vpr.stream.protocols.evpr_frames import CHECK, HEADER, MAX_STUFFED, VERSION
from edge_vpr.stream.timestamp_filter import (
    admit_columns,
    counts_of,
    no_columns,
    reach,
    room_for,
    start_clock,
)

_HEADER_BYTES, _CHECK_BYTES = HEADER.size, CHECK.size
#: A frame that was sent less than this before the last one is a repetition.
REPEAT_US = 1_000_000
# State between frames.
MEMORY = np.dtype(
    [
        ("boot", "<i8"),  # number of the device's start; -1: no frame yet
        ("next", "<i8"),  # expected sequence number of the next frame
        ("dropped", "<i8"),  # events that the device has reported as dropped
        ("last", "<i8"),  # base time of the last frame
    ]
)
# Results of the frames of one chunk.
BROUGHT = np.dtype(
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
        ("base", "<i8"),  # base time of the first frame
        ("idle_at", "<i8"),  # time that the last frame states without events; -1: it has events
    ]
)


class FrameRoom(NamedTuple):
    """Room for the frames of one chunk, and the state that is kept between chunks.

    Attributes
    ----------
    plain : ndarray of uint8, shape (MAX_STUFFED,)
        One frame without stuffing.
    columns : Columns
        Events of all frames.
    memory : ndarray of MEMORY, shape (1,)
    brought : ndarray of BROUGHT, shape (1,)
    """

    plain: Bytes
    columns: Columns
    memory: npt.NDArray[np.void]
    brought: npt.NDArray[np.void]

    @classmethod
    def of(cls, size: int, memory: npt.NDArray[np.void]) -> FrameRoom:
        """Make room for the events of frames of `size` bytes in total."""
        plain, brought = np.empty(MAX_STUFFED, dtype=np.uint8), np.zeros(1, dtype=BROUGHT)
        return cls(plain, no_columns(size // 3), memory, brought)


@kernel
def decode_frames(box, clock, data):  # type: ignore[no-untyped-def]
    """Decode whole frames, and filter their events.

    Parameters
    ----------
    box : Boxed
        Box of a `FrameRoom` with room for `data`.
    clock : Boxed
        Box of the state of a `TimestampFilter`.
    data : bytes
        Frames, each with the zero at its end.

    Returns
    -------
    events : ndarray of EVENT_DTYPE, shape (n,)
    frames, decoded : int
        Number of undamaged frames, and of events in them.
    same : bool
        Whether all other counts are as before, in `FrameRoom.brought` and of the clock.
    reached : int
        Time up to which the stream is known, see `TimestampFilter.reached_us`.
    """
    room, raw = FrameRoom(*box.value), np.frombuffer(data, dtype=np.uint8)
    brought, before = room.brought, counts_of(clock)
    brought.view(np.int64)[:] = 0
    n, start = 0, 0
    for i in range(raw.size):
        if raw[i] != 0:
            continue
        if i > start:
            size = unstuff(raw[start:i], room.plain) if i - start <= MAX_STUFFED else -1
            n += _take_frame(room, size - _CHECK_BYTES, i - start + 1, n)
        start = i + 1
    found = brought[0]
    if found["frames"]:
        start_clock(clock, found["base"])
    t, x, y, p = room.columns
    out = room_for(clock, n)
    delivered = admit_columns(clock, t[:n], x[:n], y[:n], p[:n], out)
    reached = reach(clock, found["idle_at"] if found["frames"] else np.int64(-1))
    same = not (found["damaged"] or found["repeats"] or found["gaps"] or found["resets"])
    same = same and not found["dropped"] and counts_of(clock) == before
    return out[:delivered], found["frames"], n, same, reached


@kernel
def follow_frames(bursts, followed, room, clock, data):  # type: ignore[no-untyped-def]
    """Decode whole frames, and match their events.

    Parameters
    ----------
    bursts, followed : Boxed
        See `follow_kept`.
    room, clock : Boxed
        See `decode_frames`.
    data : bytes
        Frames with up to `FEW` events.

    Returns
    -------
    tuple
        Results of `decode_frames` and of `follow_kept`.
    """
    decoded = decode_frames(room, clock, data)
    return decoded, follow_kept(bursts, followed, decoded[0])


@kernel
def _number(data, at, size):  # type: ignore[no-untyped-def]
    number = np.int64(0)
    for i in range(size):
        number |= np.int64(data[at + i]) << (8 * i)
    return number


@kernel
def _take_frame(room, end, taken, first):  # type: ignore[no-untyped-def]
    """Decode a frame whose checksum is at `end`, and compare the device's totals with ours.

    The frame took `taken` bytes on the line. Its events are written from `first` on, and counted.
    """
    plain, columns, memory, brought = room
    last, found = memory[0], brought[0]
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
        found["damaged"] += 1
        found["skipped_bytes"] += taken
        return 0
    boot, sequence = _number(plain, 2, 2), _number(plain, 4, 4)
    dropped, base = _number(plain, 8, 4), _number(plain, 12, 8)
    # running totals are modulo 2^32
    missing = (sequence - last["next"]) & 0xFFFFFFFF
    if last["boot"] < 0:
        last["next"], last["dropped"], missing = sequence, dropped, 0
    elif boot != last["boot"] or missing >= 1 << 31:
        if boot == last["boot"] and 0 <= last["last"] - base < REPEAT_US:
            found["repeats"] += 1
            found["skipped_bytes"] += taken
            return 0
        # a new run of the device, even if it did not change its boot number
        found["resets"] += 1
        last["next"], last["dropped"], missing = 0, 0, sequence
    found["gaps"] += missing > 0
    found["lost"] += missing
    found["dropped"] += (dropped - last["dropped"]) & 0xFFFFFFFF
    if found["frames"] == 0:
        found["base"] = base
    found["frames"] += 1
    found["idle_at"] = -1 if words else base
    form = width, x_bits, y_bits
    events = _take_words(plain[_HEADER_BYTES:end], form, base, columns, first)
    last["boot"], last["dropped"], last["last"] = boot, dropped, base
    last["next"] = (sequence + events) & 0xFFFFFFFF
    return events


@kernel
def _take_words(data, form, base, columns, first):  # type: ignore[no-untyped-def]
    """Decode little-endian words: from the lowest bit x, y, polarity, time since the last word.

    A word whose time field is all ones is a pause of the length in its other bits. `form` has the
    width of a word in bytes, and the widths of x and y in bits. Events are written from `first` on.
    """
    (width, x_bits, y_bits), (t, x, y, p) = form, columns
    p_at = x_bits + y_bits
    t_at = p_at + 1
    x_mask, y_mask = (1 << x_bits) - 1, (1 << y_bits) - 1
    pause, pause_mask = (1 << (8 * width - t_at)) - 1, (1 << t_at) - 1
    now, n = np.int64(base), first
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
    return n - first
