"""Address-event words of one size, as a layout says where each field lies."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from edge_vpr.errors import UsageError
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.source import Columns
from edge_vpr.stream.gate import LATE_US, STEP_US, Clock
from edge_vpr.stream.protocols.protocol import Encoder, made_up_events
from edge_vpr.stream.protocols.words import SEARCH_WORDS, Raw, WordDecoder, assemble


@dataclass(frozen=True)
class Field:
    """Bits ``shift`` to ``shift + bits - 1`` of a word; no bits: there is no such field."""

    shift: int = 0
    bits: int = 0

    @property
    def mask(self) -> int:
        """Largest value."""
        return (1 << self.bits) - 1


@dataclass(frozen=True)
class Layout:
    """Where the fields of a word lie.

    Parameters
    ----------
    size : int
        Bytes a word, 2 to 8.
    big : bool
        Most significant byte first.
    x, y, p, t : Field
        Without `p` all events are ON; without `t` an event's time is that of its arrival.
    tick_us : int
        Microseconds a tick of `t`.
    sync_mask, sync_value : int
        Bits that every event's word has, and their values; other words are no events.
    off_is_one : bool
        Whether the polarity bit says OFF.
    """

    size: int
    big: bool
    x: Field
    y: Field
    p: Field = Field()
    t: Field = Field()
    tick_us: int = 1
    sync_mask: int = 0
    sync_value: int = 0
    off_is_one: bool = False

    @property
    def clock(self) -> Clock:
        """The device's clock, or that of the host."""
        return Clock(self.t.bits, self.tick_us) if self.t.bits else Clock()

    @property
    def plausible(self) -> tuple[int, int]:
        """Ticks that an event may be late, and come later, and still look right."""
        late = min(LATE_US // self.tick_us, (1 << self.t.bits) // 16)
        return late, (1 << self.t.bits) // 2

    def check_sensor(self, name: str, sensor: Sensor) -> None:
        """Raise `UsageError` if the sensor has more columns or rows than the fields can say."""
        if sensor.width > 1 << self.x.bits or sensor.height > 1 << self.y.bits:
            raise UsageError(
                f"{name} holds up to {1 << self.x.bits}x{1 << self.y.bits} pixels, and not "
                f"{sensor}: use another protocol"
            )


class LayoutDecoder(WordDecoder):
    """Decodes words of a layout; sync bits and steps of time show where they begin."""

    def __init__(self, name: str, layout: Layout, sensor: Sensor) -> None:
        layout.check_sensor(name, sensor)
        super().__init__(
            sensor, layout.clock, layout.size,
            search_words=SEARCH_WORDS, notice_words=8,
        )  # fmt: skip
        self.layout = layout
        self._memory = np.array([-1], dtype=np.int64)  # time of the last word, -1: none

    def _samples(self) -> Iterable[bytes]:
        words = LayoutEncoder("sample", self.layout, self.sensor).encode(made_up_events())
        # a byte is lost in the midst of them
        yield words[: len(words) // 2] + words[len(words) // 2 + 1 :]

    def _words(self, raw: Raw) -> npt.NDArray[np.uint64]:
        return assemble(raw, self.layout.size, big=self.layout.big)

    def _good(self, raw: Raw) -> npt.NDArray[np.bool_]:
        words = self._words(raw)
        good = in_sync(words, self.layout)
        if words.size > 1:
            # the first after other bytes has only the next one to agree with
            fits = follows(words, self.layout)
            good &= np.append(fits, False) | np.insert(fits, 0, False)
        return good

    def _usable(self, raw: Raw) -> int:
        layout = self.layout
        if not (layout.sync_mask or layout.t.bits):
            return raw.size // layout.size
        late, step = layout.plausible
        usable = _usable(
            self._words(raw), np.uint64(layout.sync_mask), np.uint64(layout.sync_value),
            np.uint64(layout.t.shift), layout.t.mask, late,
            min(step, STEP_US // layout.tick_us), self._memory,
        )  # fmt: skip
        return int(usable)

    def _columns(self, raw: Raw) -> Columns:
        return take_fields(self._words(raw), self.layout, self._host_us)

    def _pace(self, raw: Raw) -> float:
        return pace_of(self._words(raw), self.layout)

    def _search(self, raw: Raw) -> int:
        self._memory[:] = -1
        return super()._search(raw)


def follows(words: npt.NDArray[np.uint64], layout: Layout) -> npt.NDArray[np.bool_]:
    """Tell of each word but the first whether its time can be that of the next event."""
    if not layout.t.bits:
        return np.ones(max(0, words.size - 1), dtype=np.bool_)
    late, step = layout.plausible
    t = ((words >> np.uint64(layout.t.shift)) & np.uint64(layout.t.mask)).astype(np.int64)
    steps: npt.NDArray[np.int64] = np.subtract(t[1:], t[:-1])
    return ((steps + late) & layout.t.mask) <= step + late


def in_sync(words: npt.NDArray[np.uint64], layout: Layout) -> npt.NDArray[np.bool_]:
    """Tell of each word whether its sync bits are right."""
    return (words & np.uint64(layout.sync_mask)) == layout.sync_value


def pace_of(words: npt.NDArray[np.uint64], layout: Layout) -> float:
    """Ticks from one word to the next, the median; 0 where there is no time."""
    if not layout.t.bits or words.size < 2:
        return 0.0
    t = (words >> np.uint64(layout.t.shift)) & np.uint64(layout.t.mask)
    times = t.astype(np.int64)
    steps: npt.NDArray[np.int64] = np.subtract(times[1:], times[:-1])
    return float(np.median(steps & layout.t.mask))


def take_fields(words: npt.NDArray[np.uint64], layout: Layout, host_us: int) -> Columns:
    """Split words to columns; without a time field all came at `host_us`."""

    def field(where: Field, dtype: type[np.generic]) -> npt.NDArray[np.generic]:
        return ((words >> np.uint64(where.shift)) & np.uint64(where.mask)).astype(dtype)

    t = field(layout.t, np.int64) if layout.t.bits else np.full(words.size, host_us, np.int64)
    p = field(layout.p, np.bool_) != layout.off_is_one
    if not layout.p.bits:
        p = np.ones(words.size, dtype=np.bool_)
    return Columns(t, field(layout.x, np.uint16), field(layout.y, np.uint16), p)


@njit(cache=True, nogil=True)
def _usable(words, sync_mask, sync_value, t_shift, t_mask, late, step, memory):  # type: ignore[no-untyped-def]
    """Count words up to one whose sync bits are wrong, or that an odd step of time leads to.

    A step that is only long or backwards costs no more than a search, which finds the same place.
    """
    last = memory[0]
    for i in range(words.size):
        if words[i] & sync_mask != sync_value:
            return i
        if t_mask:
            t = np.int64((words[i] >> t_shift) & np.uint64(t_mask))
            if last >= 0 and ((t - last + late) & t_mask) > step + late:
                return i
            last = t
    memory[0] = last
    return words.size


class LayoutEncoder(Encoder):
    """Makes the words of a layout."""

    def __init__(self, name: str, layout: Layout, sensor: Sensor) -> None:
        layout.check_sensor(name, sensor)
        super().__init__(sensor)
        self.layout = layout

    def encode(self, events: Events) -> bytes:
        """Encode events; times wrap."""
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
