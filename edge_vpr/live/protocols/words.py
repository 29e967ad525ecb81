"""Words of one size without frames: how their beginning is found, and words of a layout."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError
from edge_vpr.events import Events, Sensor
from edge_vpr.live.protocols import STEP_US, Clock, Decoder, Encoder, damaged_sample
from edge_vpr.recordings.reading import Columns, empty_columns

# The search for the beginning of words.
#
# Nothing marks the beginning of a word; it is found from the properties of valid words. A decoder
# that has lost the beginning tries every offset over the next words, and takes the one with the
# most valid words.


Raw = npt.NDArray[np.uint8]

#: Number of words that are used to find the beginning.
SEARCH_WORDS = 32


class Reading(NamedTuple):
    """Quality of the words from one offset; all numbers are as a kernel returns them."""

    good: float  #: Number of valid words.
    first: float  #: Index of the first valid word; the number of words if there is none.
    #: How fast time runs, which is faster if the reading is shifted; 0 if words do not show it.
    pace: float = 0.0
    moves: float = 1.0  #: Share of words that differ from the previous one.
    #: 1 if every word has the marks that words must have, whatever its time; else 0.
    marked: float = 0.0


class WordDecoder(Decoder):
    """Decoder of words of `size` bytes.

    Parameters
    ----------
    size : int
        Bytes of a word.
    search_words : int
        Number of words that decide between two offsets.
    notice_words : int
        Number of words within which a shifted stream is noticed.
    """

    def __init__(
        self,
        sensor: Sensor,
        clock: Clock,
        size: int,
        *,
        search_words: int = SEARCH_WORDS,
        notice_words: int,
    ) -> None:
        super().__init__(sensor, clock)
        self._size = size
        self._search_words = search_words
        self._searching = True
        # whether this search was counted; bytes before the first event of a device are no loss
        self._counted = True
        self.resync_bytes = (search_words + notice_words + 1) * size

    @abstractmethod
    def _readings(self, raw: Raw, most: int) -> list[Reading]:
        """Count the valid words of up to `most` from each offset, without changing the state."""

    @abstractmethod
    def _take_words(self, raw: Raw) -> tuple[int, Columns, bool]:
        """Decode words up to one that shows that the beginning of words is lost.

        Returns the number of words, their events (valid until the next call), and whether it is
        lost.
        """

    def _lose_sync(self) -> None:
        self._searching, self._counted = True, False

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        raw = np.frombuffer(data, dtype=np.uint8)
        size, at, parts = self._size, 0, []
        while True:
            if self._searching:
                needed = 1 if final else self._search_words + 1
                if raw.size - at < needed * size:
                    break
                skip = self._search(raw[at:])
                at += skip
                self.health.skipped_bytes += skip
                # a search that ends where it began has lost nothing
                self.health.resyncs += skip > 0 and not self._counted
                self._counted |= skip > 0
                if self._searching:
                    continue
            words = (raw.size - at) // size
            used, columns, lost = self._take_words(raw[at : at + words * size])
            at += used * size
            if used == words:
                parts.append(columns)
                break
            if used:
                # the next words are decoded into the same memory
                parts.append(Columns(*(column.copy() for column in columns)))
            if lost:
                self._lose_sync()
        return parts, data[at:]

    def _search(self, raw: Raw) -> int:
        """Return the number of bytes to skip to the next word; stay lost if none is near."""
        size = self._size
        most = min(self._search_words, raw.size // size)
        # first byte at which any word is valid
        first = min(raw.size, most * size)
        readings = self._readings(raw, most)
        candidates = []
        for offset, reading in enumerate(readings):
            words = min(most, (raw.size - offset) // size)
            first = min(first, offset + int(reading.first) * size)
            # random bytes have a smaller share of valid words, damaged streams a larger one
            if reading.first == 0 and reading.good * 4 >= words * 3:
                candidates.append((reading.pace, -reading.good * most // words, offset))
        if candidates:
            self._searching = False
            return min(candidates)[2]
        if readings[0].marked:
            # the events are so rare that their times give no information
            self._searching = False
            return 0
        return first if first > 0 else min(raw.size, max(1, most // 2) * size)


@kernel
def word_at(raw, at, size, big):  # type: ignore[no-untyped-def]
    """Join `size` bytes to a word, as an unsigned integer of 64 bits."""
    word, eight = np.uint64(0), np.uint64(8)
    for i in range(size):
        word = word << eight | np.uint64(raw[at + (i if big else size - 1 - i)])
    return word


# Address-event words, with the fields that a layout describes.


Form = npt.NDArray[np.void]

#: Most microseconds by which words of a device are out of order.
DISORDER_US = 1_000
#: Number of words within which a shifted stream is noticed.
NOTICE_WORDS = 40
# values of a layout for kernels; each field has a shift and a mask
_FORM = np.dtype(
    [
        (name, "<u8")
        for name in (
            "size", "big", "off", "sync_mask", "sync", "late", "span",
            "x", "x_mask", "y", "y_mask", "p", "p_mask", "t", "t_mask",
        )
    ]
)  # fmt: skip
# An odd step of time adds the first number to a score, and a good one subtracts 1. If the score
# exceeds the second number, the beginning of words is lost.
_ODD, _TOO_ODD = 4, 8
# time of the last word (-1: there is none), and score of the last steps
_MEMORY = np.dtype([("last", "<i8"), ("odd", "<i8")])
_NOTHING = (-1, 0)


@dataclass(frozen=True)
class Field:
    """Bits ``shift`` to ``shift + bits - 1`` of a word; a field without bits is absent."""

    shift: int = 0
    bits: int = 0

    @property
    def mask(self) -> int:
        """Largest value of the field."""
        return (1 << self.bits) - 1


@dataclass(frozen=True)
class Layout:
    """Position of the fields in a word."""

    size: int  #: Bytes of a word, 2 to 8.
    big: bool  #: Whether the most significant byte comes first.
    #: x, y, p, t: without `p` all events are ON; without `t` the time of an event is that of its
    #: arrival.
    x: Field
    y: Field
    p: Field = Field()
    t: Field = Field()
    tick_us: int = 1  #: Microseconds of a tick of `t`.
    #: sync_mask, sync_value: bits that the word of every event has, and their values; other words
    #: are not events.
    sync_mask: int = 0
    sync_value: int = 0
    off_is_one: bool = False  #: Whether the polarity bit is set for OFF.

    @property
    def clock(self) -> Clock:
        """Clock of the device, or that of the host if words have no time."""
        return Clock(self.t.bits, self.tick_us) if self.t.bits else Clock()

    def form(self) -> Form:
        """Return the values for kernels, as an array of one record."""
        # ticks that an event may lie before and after the last one to be plausible
        period = 1 << self.t.bits
        late = min(DISORDER_US // self.tick_us, period // 16)
        span = late + min(max(1, STEP_US // self.tick_us), period // 2)
        values = [self.size, self.big, self.off_is_one, self.sync_mask, self.sync_value, late, span]
        for field in (self.x, self.y, self.p, self.t):
            values += [field.shift, field.mask]
        return np.array([tuple(values)], dtype=_FORM)

    def check_sensor(self, name: str, sensor: Sensor) -> None:
        """Raise `UsageError` if the sensor has more columns or rows than the fields can hold."""
        if sensor.width > 1 << self.x.bits or sensor.height > 1 << self.y.bits:
            raise UsageError(
                f"{name} holds up to {1 << self.x.bits}x{1 << self.y.bits} pixels, and not "
                f"{sensor}: use another protocol"
            )


class LayoutDecoder(WordDecoder):
    """Decodes words of a layout; sync bits and time steps show where they begin."""

    def __init__(self, name: str, layout: Layout, sensor: Sensor) -> None:
        layout.check_sensor(name, sensor)
        super().__init__(sensor, layout.clock, layout.size, notice_words=NOTICE_WORDS)
        self.layout = layout
        self._form = layout.form()
        self._memory = np.array([_NOTHING], dtype=_MEMORY)
        self._columns = empty_columns(0)

    def _samples(self) -> Iterable[bytes]:
        yield damaged_sample(LayoutEncoder("sample", self.layout, self.sensor))

    def _readings(self, raw: Raw, most: int) -> list[Reading]:
        return read_words(raw, most, self._form)

    def _take_words(self, raw: Raw) -> tuple[int, Columns, bool]:
        words = raw.size // self.layout.size
        if words > self._columns.t.size:
            self._columns = empty_columns(words)
        t, x, y, p = self._columns
        used = int(_take(raw, self._form, self._memory, self._host_us, t, x, y, p))
        return used, Columns(t[:used], x[:used], y[:used], p[:used]), used < words

    def _lose_sync(self) -> None:
        super()._lose_sync()
        self._memory[0] = _NOTHING


def read_words(raw: Raw, most: int, form: Form) -> list[Reading]:
    """Evaluate up to `most` words from each offset; `form` is that of `Layout.form`."""
    return [Reading(*row) for row in _read(raw, most, form).tolist()]


@kernel
def _take(raw, form, memory, host_us, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode words up to one with wrong sync bits, or with one odd time step too many.

    A single odd step may be a silence, a damaged time or a restart; `TimestampFilter` decides.
    """
    f, m = form[0], memory[0]
    size, big = np.int64(f["size"]), f["big"] != 0
    words = raw.size // size
    x_at, x_mask, y_at, y_mask = f["x"], f["x_mask"], f["y"], f["y_mask"]
    p_at, p_mask, t_at, t_mask = f["p"], f["p_mask"], f["t"], f["t_mask"]
    sync_mask, sync, off = f["sync_mask"], f["sync"], f["off"] != 0
    late, span, period = np.int64(f["late"]), np.int64(f["span"]), np.int64(t_mask)
    last, odd = m["last"], m["odd"]
    for i in range(words):
        word = word_at(raw, i * size, size, big)
        if word & sync_mask != sync:
            return i
        if period:
            time = np.int64(word >> t_at & t_mask)
            if last >= 0 and (time - last + late) & period > span:
                odd += _ODD
                if odd > _TOO_ODD:
                    return i
            elif odd:
                odd -= 1
            last = time
            t[i] = time
        else:
            t[i] = host_us
        x[i] = word >> x_at & x_mask
        y[i] = word >> y_at & y_mask
        p[i] = (word >> p_at & p_mask != 0) != off if p_mask else True
    m["last"], m["odd"] = last, odd
    return words


@kernel
def _read(raw, most, form):  # type: ignore[no-untyped-def]
    """Count words with the right sync bits and a plausible time after the previous word."""
    f = form[0]
    size, big, t_at, t_mask = np.int64(f["size"]), f["big"] != 0, f["t"], f["t_mask"]
    late, span, period = np.int64(f["late"]), np.int64(f["span"]), np.int64(t_mask)
    sync_mask, sync = f["sync_mask"], f["sync"]
    readings = np.zeros((min(size, raw.size - size + 1), 5))
    steps = np.zeros(max(1, most - 1), dtype=np.int64)
    for offset in range(len(readings)):
        words = min(most, (raw.size - offset) // size)
        before = word_at(raw, offset, size, big)
        synced = before & sync_mask == sync
        good, moves, marked = 1 if synced else 0, 1, sync_mask != 0 and synced
        first = 0 if synced and words == 1 else words
        for i in range(1, words):
            word = word_at(raw, offset + i * size, size, big)
            step = np.int64(word >> t_at & t_mask) - np.int64(before >> t_at & t_mask)
            steps[i - 1] = step & period
            moves += word != before
            fits = (step + late) & period <= span
            # the first word after other bytes can only be checked against the next one
            if synced and fits:
                first = min(first, i - 1)
            before, synced = word, word & sync_mask == sync
            if synced and fits:
                good += 1
                first = min(first, i)
            marked &= synced
        readings[offset, 0], readings[offset, 1] = good, first
        readings[offset, 2] = np.median(steps[: max(1, words - 1)]) if period else 0.0
        readings[offset, 3], readings[offset, 4] = moves / words, marked
    return readings


class LayoutEncoder(Encoder):
    """Encodes events as words of a layout."""

    def __init__(self, name: str, layout: Layout, sensor: Sensor) -> None:
        layout.check_sensor(name, sensor)
        super().__init__(sensor)
        self.layout = layout

    def encode(self, events: Events) -> bytes:
        """Encode events; their times wrap."""
        layout = self.layout
        polarity = events["p"] ^ layout.off_is_one
        words = np.full(events.size, layout.sync_value, dtype=np.uint64)
        for where, values in (
            (layout.x, events["x"]),
            (layout.y, events["y"]),
            (layout.p, polarity),
            (layout.t, events["t"] // layout.tick_us),
        ):
            field = values.astype(np.int64) & where.mask
            words |= field.astype(np.uint64) << np.uint64(where.shift)
        as_bytes = words.astype(">u8").view(np.uint8).reshape(-1, 8)[:, 8 - layout.size :]
        return (as_bytes if layout.big else as_bytes[:, ::-1]).tobytes()
