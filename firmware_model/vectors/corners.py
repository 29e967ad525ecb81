"""Cases that reach every corner, made for any design: small maps, and streams by construction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

from firmware_model.descriptor import DescriptorModel, Event, WindowResult
from firmware_model.design import Design
from firmware_model.memories import Codes, Memories, Pixel
from firmware_model.vectors.case import Case


class Stream:
    """A stimulus under construction, by the clock of the design.

    Parameters
    ----------
    design : Design
    pixels : sequence of (x, y)
    start : int
    """

    def __init__(self, design: Design, pixels: Sequence[Pixel], start: int = 0) -> None:
        self.design = design
        self.pixels = pixels
        self.start = start
        self.events: list[Event] = []
        self._window = 0  # number of the open one, of windows by time
        self._counted = 0

    def at(self, x: int, y: int, offset: int = 0, on: bool = True) -> None:
        """Add an event, `offset` microseconds after the start of the open window."""
        t = self.start + self._window * self.design.tau_us + offset
        self.events.append(Event(t % (1 << self.design.timestamp_bits), x, y, on))
        if (x, y) in self.pixels:
            self._counted = (self._counted + 1) % self.design.window_events

    def slot(self, slot: int, times: int = 1, offset: int = 0) -> None:
        """Add events that are counted by a slot."""
        pixel, on = self.pixels[slot % self.design.pixels], slot < self.design.pixels
        for _ in range(times):
            self.at(*pixel, offset, on)

    def fill(self, counts: Sequence[int]) -> None:
        """Add events of one window, so many for each slot, and end it.

        A window by count is ended by further events at the last slot.
        """
        for slot, count in enumerate(counts):
            self.slot(slot, count)
        self.end()

    def end(self) -> None:
        """End the open window."""
        if self.design.window == "time":
            self._window += 1
        elif self._counted:
            self.slot(self.design.slots - 1, self.design.window_events - self._counted)

    def skip(self, windows: int) -> None:
        """Let time pass."""
        self._window += windows

    def close(self) -> None:
        """Add the event that lets a device know that the last window by time has ended."""
        if self.design.window == "time":
            self.at(*self.pixels[0])


def choose_pixels(design: Design) -> list[Pixel]:
    """Pixels that lie in the sensor's corners, two in a column and two in a row, and elsewhere.

    The last pixel of the last row is left out where not all are selected.
    """
    right, bottom = design.width - 1, design.height - 1
    first = [(0, 0), (right, 0), (0, bottom), (right // 2, bottom // 2), (right // 2, 0)]
    number = design.width * design.height
    # steps of a prime visit every pixel, unless it divides their number
    step = next(p for p in (7919, 104_729, 1) if number % p or p == 1)
    visited = (i * step % number for i in range(number))
    elsewhere = ((flat % design.width, flat // design.width) for flat in visited)
    chosen: dict[Pixel, None] = {}
    for pixel in chain(first, elsewhere):
        if len(chosen) == design.pixels:
            break
        if pixel != (right, bottom) or design.pixels == number:
            chosen[pixel] = None
    return list(chosen)


def corner_cases(design: Design) -> list[Case]:
    """Make the cases of the suite ``corners``.

    Maps are small and made for each case. Some cases change the design where a corner needs it:
    they carry their own.

    Parameters
    ----------
    design : Design

    Returns
    -------
    list of Case
        Of a design with a single code of a bit or two, those that it has room for.
    """
    design = replace(design, places=_roomy(design))
    cases = [_event_case(name, variant) for name, variant in _event_designs(design).items()]
    for name, (variant, rows) in _patterns(design).items():
        case = _pattern_case(name, variant, rows)
        if case is not None:
            cases.append(case)
    return cases


def _roomy(design: Design) -> int:
    """Places that hold two sequences with more than an exclusion zone between and around them."""
    return 3 * design.length + 3 * (design.exclusion + 2)


def _event_designs(design: Design) -> dict[str, Design]:
    by_time = replace(design, window="time", tau_us=max(design.tau_us, 4))
    # a window that holds a counter's full range
    by_count = replace(
        design, window="count", window_events=max(design.window_events, design.count_max + 9)
    )
    odd = next(p for p in range(2, design.slots + 3) if design.slots % p)
    return {
        "events_by_time": by_time,
        "events_by_count": by_count,
        "both_polarities": replace(by_time, polarity=not design.polarity),
        "both_polarities_by_count": replace(by_count, polarity=not design.polarity),
        "unfilled_lanes": replace(by_time, lanes=odd),
        "several_code_tables": replace(by_time, full_scales=_two_scales(design)),
        "sequence_longer_than_seen": replace(
            by_time, length=design.length + 9, places=design.places + 9
        ),
        "one_place": replace(by_time, places=1, length=1),
        "narrow_clock": replace(by_time, timestamp_bits=by_time.tau_us.bit_length() + 2),
    }


def _two_scales(design: Design) -> tuple[int, int]:
    scale = design.full_scales[0]
    return scale, scale // 2 or 2


def _event_case(name: str, design: Design) -> Case:
    """Build a stream with everything that an event and a window can be."""
    pixels = choose_pixels(design)
    tables = [slot % len(design.full_scales) for slot in range(design.slots)]
    period = 1 << design.timestamp_bits
    # the clock wraps within the third window
    start = (period - 5 * design.tau_us // 2) % period if design.window == "time" else 0
    stream = Stream(design, pixels, start)
    last, top, tau = design.slots - 1, design.count_max, design.tau_us
    by_time = design.window == "time"

    _ramp(stream, 1)
    # one counter over its limit by one, its neighbours not
    stream.slot(0, top + 1)
    stream.end()
    stream.slot(last, top - 1)
    stream.slot(0)
    stream.slot(last, 3)
    stream.end()
    # A B A, and the same pixel with and without another event between
    for slot in (0, last, 0, 0, last, last):
        stream.slot(slot)
    stream.at(*_unselected(design, pixels))
    stream.slot(last)
    _off_everything(stream)
    stream.end()
    for polarity in (True, False):
        for x, y in pixels[:5]:
            stream.at(x, y, min(1, tau - 1), polarity)
    if by_time:
        stream.slot(0, 1, tau - 1)  # the last microsecond
        stream.slot(0, 1, tau)  # and the one behind it
        stream.skip(1)
        stream.slot(0, 1, -1)  # late by one
        stream.slot(last, 2, 1)
        stream.skip(1 if _narrow(design) else 5)
        stream.slot(0)
        stream.skip(1)
        # over the very edge of several windows at once
        stream.skip(0 if _narrow(design) else 3)
        stream.slot(last)
    stream.end()
    stream.fill([1] * design.slots)
    stream.fill([2 if design.slots > 1 else 1] * design.slots)
    windows = 1 if design.length > design.exclusion + 9 else design.length + 3
    for number in range(min(windows, 12)):
        _ramp(stream, number)
    stream.close()
    places = _told_places(design, pixels, tables, stream)
    return Case(name, Memories(design, pixels, places, tables), tuple(stream.events), start)


def _narrow(design: Design) -> bool:
    """Whether the clock is too short for a gap of several windows."""
    return 6 * design.tau_us >= 1 << (design.timestamp_bits - 1)


def _ramp(stream: Stream, number: int) -> None:
    """Add a window with few events, other ones for each number."""
    design = stream.design
    total = min(design.window_events, 40) if design.window == "count" else 40
    for i in range(total):
        stream.slot((i * (number + 2) + number) % design.slots, 1, min(i, design.tau_us - 1))
    stream.end()


def _off_everything(stream: Stream) -> None:
    """Corners of the sensor, selected pixels' neighbours by address, and beyond the sensor."""
    design, pixels = stream.design, stream.pixels
    right, bottom = design.width - 1, design.height - 1
    for x, y in ((0, 0), (right, 0), (0, bottom), (right, bottom)):
        stream.at(x, y)
    for x, y in pixels[:5]:
        for other in range(0, design.height, max(1, design.height // 9)):
            stream.at(x, other)
        stream.at((x + 1) % design.width, y)
    for x, y in ((right + 1, bottom), (right, bottom + 1), (0, bottom + 1), (right + 1, 0)):
        if x < 1 << 16 and y < 1 << 15:
            stream.at(x, y)
    lookup = Memories(design, pixels, [[0] * design.slots] * design.places).lookup()
    shared = (
        (x, y)
        for y in range(design.height)
        for x in range(design.width)
        if lookup(x, y) is None and lookup.taken(x, y)
    )
    for _, pixel in zip(range(4), shared, strict=False):
        stream.at(*pixel)


def _unselected(design: Design, pixels: Sequence[Pixel]) -> Pixel:
    chosen = set(pixels)
    for i in range(design.width * design.height):
        if (i % design.width, i // design.width) not in chosen:
            return i % design.width, i // design.width
    return design.width, 0


def _told_places(
    design: Design, pixels: Sequence[Pixel], tables: Sequence[int], stream: Stream
) -> list[Codes]:
    """Places that the stream comes by, one window in two, with others between."""
    blank = Memories(design, pixels, [[0] * design.slots] * design.places, tables)
    seen = [window.codes for window in _windows(blank, stream)]
    places = []
    for k in range(design.places):
        codes = seen[(k * 3) % len(seen)]
        if k % 2:
            codes = tuple(design.code_max - code for code in codes)
        places.append(codes)
    return places


def _windows(memories: Memories, stream: Stream) -> list[WindowResult]:
    model = DescriptorModel(memories, stream.start)
    results = [result for event in stream.events for result in model.take(event)]
    return [result for result in results if isinstance(result, WindowResult)]


def _patterns(design: Design) -> dict[str, tuple[Design, str]]:
    """Lay out maps by pattern; the query is the same in every window.

    n is its own descriptor, at distance zero; 1 and 2 differ from it by one code and two; f is as
    far as a place can be.
    """
    length, zone = design.length, design.exclusion
    near, far = "n" * length, "f" * (length + zone + 1)
    ratio = replace(design, accept="ratio", ratio=(1, 2))
    below = replace(design, accept="ratio", ratio=(1, 3))
    margin = {t: replace(design, accept="margin", margin=t) for t in (1, 2)}
    one, two = near[:-1] + "1", near[:-1] + "2"
    return {
        "tie_of_two": (design, far + near + "n" + far),
        "tie_of_three": (design, near + "nn" + far + "f"),
        "tie_across_zone": (ratio, far + near + "f" * (zone + 1) + near + far),
        "all_places_equal": (design, "n" * (length + 2 * zone + 4)),
        "all_places_far": (design, "f" * (length + 2 * zone + 4)),
        "tie_of_seconds": (design, near + far + one + far + one),
        "tie_of_seconds_on_the_left": (design, far + one + far + one + far + near + far),
        "tie_of_seconds_on_both_sides": (design, far + one + far + near + far + one),
        "second_on_the_left": (margin[1], far + one + far + near + far),
        "second_on_the_right": (margin[2], near + far + one),
        "nearer_in_the_zone": (design, far + near + "1" + far + two + far),
        "ratio_at_threshold": (ratio, one + far + two),
        "ratio_below_threshold": (below, one + far + two),
        "best_comes_last": (design, "f2" + two + one + "1" + near),
        "zone_covers_the_map": (design, "f" * zone + near),
        "diagonal_off_the_map": (
            replace(design, length=length + 1),
            "n" * length + "f" * (length + zone + 2),
        ),
    }


def _pattern_case(name: str, design: Design, rows: str) -> Case | None:
    """Make the case of a pattern; None if the descriptor has no room for its distances."""
    design = replace(design, places=len(rows))
    pixels = choose_pixels(design)
    stream = Stream(design, pixels)
    windows = design.length + 2
    if name in ("all_places_far", "tie_of_two") and design.window == "time":
        # all windows empty, so that nothing can be further than the largest code in every slot; an
        # event elsewhere in each of them, since a clock may be too narrow for such a silence
        for _ in range(windows):
            stream.at(*_unselected(design, pixels))
            stream.end()
    else:
        for _ in range(windows):
            stream.fill([1 + (slot % 3 == 0) for slot in range(design.slots)])
    stream.close()
    blank = Memories(design, pixels, [[0] * design.slots] * design.places)
    query = _windows(blank, stream)[0].codes
    furthest = tuple(0 if 2 * code > design.code_max else design.code_max for code in query)
    row = {"n": query, "f": furthest}
    for steps in (1, 2):
        if str(steps) in rows:
            moved = _moved(design, query, steps)
            if moved is None:
                return None
            row[str(steps)] = moved
    places = [row[kind] for kind in rows]
    return Case(name, Memories(design, pixels, places), tuple(stream.events))


def _moved(design: Design, codes: Codes, steps: int) -> Codes | None:
    """Move codes to a distance of so many steps; None if there is no room."""
    moved = list(codes)
    for slot, code in enumerate(codes):
        up = design.code_max - code
        step = min(steps, max(up, code))
        moved[slot] += step if step <= up else -step
        steps -= step
    return None if steps else tuple(moved)
