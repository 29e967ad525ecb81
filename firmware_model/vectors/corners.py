"""The suite ``corners``: streams and small maps that reach each corner by construction."""

from __future__ import annotations

from dataclasses import replace

from firmware_model.design import LENGTH, Design
from firmware_model.memories import Codes, Memories
from firmware_model.vectors.case import Case, Stream


def corner_cases(design: Design) -> list[Case]:
    """Make the cases of the suite ``corners``.

    Maps are small and made for each case. Where a corner needs another design, the case changes it
    and carries its own.

    Parameters
    ----------
    design : Design
        If it has the place filter or contrast codes, these are replaced by sequences and counts:
        the cases of the filter and of contrast codes are in `filter_cases`.

    Returns
    -------
    list of Case
        For a design with a single code of one or two bits, only the cases that fit it.
    """
    if design.filters:
        # places with room for a sequence; their number is replaced below
        places = design.places + LENGTH
        design = replace(
            design, matching="sequence", length=0, trust=0, places=places, places_per_window=1,
            gains=1,
        )  # fmt: skip
    design = replace(design, code="counts", places=_roomy(design))
    one = replace(
        design, window="time", pixels=1, places=1, length=1, exclusion=0, lookup_depth=0
    )  # fmt: skip
    return [
        *event_cases(design), *match_cases(design), _half_a_period_late(design),
        _long_silence(one), _many_ties(one),
    ]  # fmt: skip


def _roomy(design: Design) -> int:
    """Return a number of places with room for two sequences, and zones around and between them."""
    return 3 * design.length + 3 * (design.exclusion + 2)


# Corner cases of events and windows: streams with every kind of event and window.


def event_cases(design: Design) -> list[Case]:
    """Make the corner cases of events and windows."""
    designs = _event_designs(design)
    cases = [_event_case(name, variant) for name, variant in designs.items()]
    by_time = designs["events_by_time"]
    return [*cases, _many_windows(by_time), _near_ends(by_time)]


def _event_designs(design: Design) -> dict[str, Design]:
    by_time = replace(design, window="time", tau_us=max(design.tau_us, 4))
    # a window with more events than a counter can hold
    by_count = replace(
        design, window="count", window_events=max(design.window_events, design.count_max + 9)
    )
    wider = 4 * (design.exclusion // 4 + 1)
    odd = next(p for p in range(2, design.slots + 3) if design.slots % p)
    return {
        "events_by_time": by_time,
        "events_by_count": by_count,
        "unfilled_lanes": replace(by_time, lanes=odd),
        "columns_above_511": replace(by_time, width=max(design.width, 1000), lookup_depth=0),
        "sequence_longer_than_seen": replace(
            by_time, length=design.length + 9, places=design.places + 9
        ),
        "one_place": replace(by_time, places=1, length=1),
        "no_zone": replace(by_time, exclusion=0),
        "wider_zone": replace(by_time, exclusion=wider, places=design.places + 3 * wider),
        "narrowest_clock": replace(by_time, timestamp_bits=by_time.tau_us.bit_length() + 1),
        "narrow_clock": replace(by_time, timestamp_bits=by_time.tau_us.bit_length() + 2),
        "clock_of_12_bits": replace(by_time, timestamp_bits=12, tau_us=500),
    }


def _event_case(name: str, design: Design) -> Case:
    """Make a case whose stream has every kind of event and window."""
    period = 1 << design.timestamp_bits
    # the clock wraps within the third window
    start = (period - 5 * design.tau_us // 2) % period if design.window == "time" else 0
    stream = Stream(design, start)
    last, top, tau = design.slots - 1, design.count_max, design.tau_us
    by_time = design.window == "time"

    _ramp(stream, 1)
    # one counter beyond its limit by one, its neighbours unchanged
    stream.slot(0, top + 1)
    stream.end()
    stream.slot(last, top - 1)
    stream.slot(0)
    stream.slot(last, 3)
    stream.end()
    # pixels in the order A B A, and one pixel repeated with and without an event between
    for slot in (0, last, 0, 0, last, last):
        stream.slot(slot)
    stream.unselected()
    stream.slot(last)
    _off_everything(stream)
    stream.end()
    for polarity in (True, False):
        for x, y in stream.pixels[:5]:
            stream.at(x, y, min(1, tau - 1), polarity)
    if by_time:
        stream.slot(0, 1, tau - 1)  # the last microsecond of the window
        stream.slot(0, 1, tau)  # the first microsecond after it
        stream.skip(1)
        stream.slot(0, 1, -1)  # too late by one microsecond
        stream.slot(last, 2, 1)
        stream.skip(1 if _narrow(design) else 5)
        stream.slot(0)
        stream.skip(1)
        # an event exactly at the boundary, after several windows at once
        stream.skip(0 if _narrow(design) else 3)
        stream.slot(last)
    stream.end()
    if by_time:
        # the end of a window does not ask where an event is
        below = design.height < 1 << 15
        stream.at(0 if below else design.width, design.height if below else 0)
    stream.fill([1] * design.slots)
    stream.fill([2 if design.slots > 1 else 1] * design.slots)
    windows = 1 if design.length > design.exclusion + 9 else design.length + 3
    for number in range(min(windows, 12)):
        _ramp(stream, number)
    stream.close()
    return _case(name, stream)


def _narrow(design: Design) -> bool:
    """Return whether the clock is too short for a gap of several windows."""
    return 6 * design.tau_us >= 1 << (design.timestamp_bits - 1)


def _ramp(stream: Stream, number: int) -> None:
    """Add a window with few events, different ones for each `number`."""
    design = stream.design
    total = min(design.window_events, 40) if design.window == "count" else 40
    for i in range(total):
        stream.slot((i * (number + 2) + number) % design.slots, 1, min(i, design.tau_us - 1))
    stream.end()


def _off_everything(stream: Stream) -> None:
    """Add events at the sensor's corners, beside selected pixels, and outside the sensor."""
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
    # selected pixels but for one bit of an address, or those that share a look-up entry with one
    for x, y in pixels[:3]:
        for bit in range(16):
            stream.at(x ^ 1 << bit, y)
        for bit in range(15):
            stream.at(x, y ^ 1 << bit)
        for column in (x + design.lookup_depth, 0xFFFF):
            stream.at(min(column, 0xFFFF), y)
        stream.at(x, (1 << 15) - 1)
    lookup = Memories(design, pixels, [[0] * design.slots] * design.places).lookup()
    shared = (
        (x, y)
        for y in range(design.height)
        for x in range(design.width)
        if lookup(x, y) is None and lookup.taken(x, y)
    )
    for _, pixel in zip(range(4), shared, strict=False):
        stream.at(*pixel)


def _case(name: str, stream: Stream) -> Case:
    """Make a case whose map holds windows of the stream at every other place."""
    design, seen = stream.design, stream.shown_codes()
    places = []
    for k in range(design.places):
        row = seen[(k * 3) % len(seen)]
        if k % 2:
            row = tuple(design.code_max - code for code in row)
        places.append(row)
    return stream.case(name, places)


def _many_windows(design: Design) -> Case:
    """Make a case of 260 windows with a few events each, more than eight bits can count."""
    design = replace(design, places=design.length + design.exclusion + 3)
    stream = Stream(design)
    for number in range(260):
        stream.slot(number % design.slots, 1 + number % 3)
        stream.slot((number * 7) % design.slots)
        stream.end()
    stream.close()
    return _case("many_windows", stream)


def _long_silence(design: Design) -> Case:
    """Make a case of more windows than 16 bits can number, with events in the first and the last.

    Nearly all are ended by one event, since a file should not have so many.
    """
    stream = Stream(replace(design, tau_us=1_000, timestamp_bits=32))
    for number in range(300):
        stream.slot(0, 1 + number % 3)
        stream.end()
    stream.skip(1 << 16)
    stream.slot(0)
    stream.end()
    stream.close()
    return stream.case("long_silence", [[1]])


def _near_ends(design: Design) -> Case:
    """Make a case with events a power of two before and behind ends of windows, some silent.

    So every carry of the difference between a time and the end of a window decides something.
    """
    stream, tau, slots = Stream(design), design.tau_us, design.slots
    silences = (0,) if _narrow(design) else (0, 1, 2, 3)
    for bit in range((tau - 1).bit_length()):
        for silent in silences:
            stream.slot(bit % slots, 1, tau - (1 << bit))
            stream.end()
            stream.skip(silent)
            stream.slot(silent % slots, 1, (1 << bit) - 1)
            stream.slot((bit + silent) % slots, 2, 1 << bit)
    stream.close()
    return _case("near_ends", stream)


def _half_a_period_late(design: Design) -> Case:
    """Make a case with events half a clock behind the end of a window, and nearly so before it."""
    half = 1 << 31
    design = replace(design, window="time", timestamp_bits=32, tau_us=half >> 1)
    stream = Stream(design)
    # seven of each, so that each is the first of a batch that the firmware takes
    stream.slot(0, 7)
    stream.slot(design.slots - 1, 7, design.tau_us + half)
    stream.skip(3)
    stream.slot(0, 7, design.tau_us - half + 1)
    for number in range(design.length + 1):
        _ramp(stream, number)
    stream.close()
    return _case("half_a_period_late", stream)


# Corner cases of distances, sequences and the search, with maps laid out by pattern.


def match_cases(design: Design) -> list[Case]:
    """Make the corner cases of matches.

    Returns
    -------
    list of Case
        For a design with a single code of one or two bits, only the cases that fit it.
    """
    cases = [_pattern_case(name, *pattern) for name, pattern in _patterns(design).items()]
    return [*(case for case in cases if case is not None), _sums_above_16_bits(design)]


def _sums_above_16_bits(design: Design) -> Case:
    """Make a case of sums above 16 bits, the second best on the left of the best and on its right.

    Windows are empty but for an event at one slot, and the map is of the largest codes. Reduced to
    16 bits, the sums would be in another order.
    """
    slots = design.slots
    bits = max(n for n in range(1, 9) if n == 1 or slots * ((1 << n) - 1) <= 0xFFFF)
    top = (1 << bits) - 1
    length = -(-0x18000 // (slots * top))
    zone = min(design.exclusion, length)
    wide = replace(
        design, code="counts", code_bits=bits, length=length, exclusion=zone,
        window_events=1, places=3 * length + 2 * zone + 2,
    )  # fmt: skip
    stream = Stream.showing(wide, [[1, *[0] * (slots - 1)]] * (length + 2))
    rows = [[top] * slots for _ in range(wide.places)]
    for place in (length, length + zone + 2, length + 2 * zone + 4, wide.places - 1):
        # a place that is nearer by some units in one slot is so in all sums with it
        rows[place][-1] = top // 2
    return stream.case("wide_sums_of_sequences", rows)


def _many_ties(design: Design) -> Case:
    """Make a case of a match at more places than 15 bits can count."""
    design = replace(design, places=33_000)
    stream = Stream.showing(design, [[1], [0]])
    return stream.case("many_ties", [[1]] * (design.places - 1) + [[0]])


def _patterns(design: Design) -> dict[str, tuple[Design, str]]:
    """Lay out maps by pattern; the query is the same in every window.

    A letter stands for a place: n is equal to the query's descriptor, at distance zero; 1 and 2
    differ from it by one and by two units of code; f is as far as a place can be.
    """
    length, zone = design.length, design.exclusion
    near, far = "n" * length, "f" * (length + zone + 1)
    limited = {limit: replace(design, largest_sum=limit) for limit in (0, 1)}
    one, two = near[:-1] + "1", near[:-1] + "2"
    single = replace(design, length=1)
    longer = replace(design, length=max(design.length, 8) + 4, places=design.places + 12)
    mixed = ("n1n2" * longer.length)[: longer.length - 1]
    return {
        "tie_of_two": (design, far + near + "n" + far),
        "tie_of_three": (design, near + "nn" + far + "f"),
        "tie_across_zone": (design, far + near + "f" * (zone + 1) + near + far),
        "all_places_equal": (design, "n" * (length + 2 * zone + 4)),
        "all_places_far": (design, "f" * (length + 2 * zone + 4)),
        "tie_of_seconds": (design, near + far + one + far + one),
        "tie_of_seconds_on_the_left": (design, far + one + far + one + far + near + far),
        "tie_of_seconds_on_both_sides": (design, far + one + far + near + far + one),
        "second_on_the_left": (design, far + one + far + near + far),
        "second_on_the_right": (design, near + far + one),
        "nearer_in_the_zone": (design, far + near + "1" + far + two + far),
        "sum_at_the_limit": (limited[1], one + far + two),
        "sum_above_the_limit": (limited[0], one + far + two),
        "place_0_on_the_left": (single, "1" + "f" * (zone + 1) + "n" + "f" * (zone + 2)),
        "long_sequence": (
            longer,
            "f" + mixed + "n" + "f" * (longer.length + zone + 1) + mixed + "1",
        ),
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
    stream = Stream(design)
    windows = design.length + 2
    if name in ("all_places_far", "tie_of_two") and design.window == "time":
        # All windows are empty, so that f differs by the largest code in every slot. Each window
        # has an event at an unselected pixel, since the clock may be too narrow for so long a
        # silence.
        for _ in range(windows):
            stream.unselected()
            stream.end()
    else:
        for _ in range(windows):
            stream.fill([1 + (slot % 3 == 0) for slot in range(design.slots)])
    stream.close()
    query = stream.shown_codes()[0]
    furthest = tuple(0 if 2 * code > design.code_max else design.code_max for code in query)
    row = {"n": query, "f": furthest}
    for steps in (1, 2):
        if str(steps) in rows:
            moved = moved_by(design, query, steps)
            if moved is None:
                return None
            row[str(steps)] = moved
    return stream.case(name, [row[kind] for kind in rows])


def moved_by(design: Design, codes: Codes, steps: int) -> Codes | None:
    """Move codes to a distance of `steps` units of code; None if there is no room."""
    moved = list(codes)
    for slot, code in enumerate(codes):
        up = design.code_max - code
        step = min(steps, max(up, code))
        moved[slot] += step if step <= up else -step
        steps -= step
    return None if steps else tuple(moved)
