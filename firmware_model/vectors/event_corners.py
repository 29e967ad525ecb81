"""Corner cases of events and windows: streams with every kind of event and window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from firmware_model.design import Design
from firmware_model.memories import Codes, Memories
from firmware_model.vectors.case import Case
from firmware_model.vectors.stimulus import Stream, choose_pixels, shown_codes, unselected_pixel


def event_cases(design: Design) -> list[Case]:
    """Make the corner cases of events and windows."""
    cases = [_event_case(name, variant) for name, variant in _event_designs(design).items()]
    by_time = _event_designs(design)["events_by_time"]
    # finds a device that assumes code 0 for a count of 0 instead of looking the code up
    turned = [tuple(by_time.code_max - code for code in table) for table in by_time.tables]
    return [*cases, _event_case("codes_turned_round", by_time, turned), _many_windows(by_time)]


def adaptive_event_cases(design: Design) -> list[Case]:
    """Make the corner cases of events and windows that a filter or own-mean codes change."""
    names = ("events_by_time", "events_by_count", "both_polarities", "one_place", "narrow_clock")
    designs = _event_designs(design)
    return [_event_case(f"adaptive_{name}", designs[name]) for name in names]


def _event_designs(design: Design) -> dict[str, Design]:
    by_time = replace(design, window="time", tau_us=max(design.tau_us, 4))
    # a window with more events than a counter can hold
    by_count = replace(
        design, window="count", window_events=max(design.window_events, design.count_max + 9)
    )
    wider = 4 * (design.exclusion // 4 + 1)
    several = replace(by_time, full_scales=_scales(design)) if not design.own_mean else by_time
    longer = by_time
    if not design.filters:
        longer = replace(by_time, length=design.length + 9, places=design.places + 9)
    odd = next(p for p in range(2, design.slots + 3) if design.slots % p)
    return {
        "events_by_time": by_time,
        "events_by_count": by_count,
        "both_polarities": replace(by_time, polarity=not design.polarity),
        "both_polarities_by_count": replace(by_count, polarity=not design.polarity),
        "unfilled_lanes": replace(by_time, lanes=odd),
        **({} if design.own_mean else {"several_code_tables": several}),
        "counts_above_255": replace(by_time, full_scales=(300,)),
        "columns_above_511": replace(by_time, width=max(design.width, 1000), lookup_depth=0),
        **({} if design.filters else {"sequence_longer_than_seen": longer}),
        "one_place": replace(by_time, places=1, length=1),
        "no_zone": replace(by_time, exclusion=0),
        "wider_zone": replace(by_time, exclusion=wider, places=design.places + 3 * wider),
        "narrowest_clock": replace(by_time, timestamp_bits=by_time.tau_us.bit_length() + 1),
        "narrow_clock": replace(by_time, timestamp_bits=by_time.tau_us.bit_length() + 2),
    }


def _scales(design: Design) -> tuple[int, ...]:
    scale = design.full_scales[0]
    return scale, scale // 2 or 2, 3, scale // 3 or 1, 1


def _event_case(name: str, design: Design, codes: Sequence[Codes] | None = None) -> Case:
    """Make a case whose stream has every kind of event and window."""
    pixels = choose_pixels(design)
    tables = [slot % len(design.full_scales) for slot in range(design.slots)]
    period = 1 << design.timestamp_bits
    # the clock wraps within the third window
    start = (period - 5 * design.tau_us // 2) % period if design.window == "time" else 0
    stream = Stream(design, pixels, start)
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
    stream.at(*unselected_pixel(design, pixels))
    stream.slot(last)
    _off_everything(stream)
    stream.end()
    for polarity in (True, False):
        for x, y in pixels[:5]:
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
    stream.fill([1] * design.slots)
    stream.fill([2 if design.slots > 1 else 1] * design.slots)
    windows = 1 if design.length > design.exclusion + 9 else design.length + 3
    for number in range(min(windows, 12)):
        _ramp(stream, number)
    stream.close()
    return _case(name, stream, tables, codes)


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
    # pixels that share some address bits with a selected one, or its entry in the look-up
    for x, y in pixels[:3]:
        for column, row in ((x + 256, y), (x + design.lookup_depth, y), (0xFFFF, y)):
            stream.at(min(column, 0xFFFF), row)
        for row in (y + 256, (1 << 15) - 1):
            stream.at(x, min(row, (1 << 15) - 1))
    lookup = Memories(design, pixels, [[0] * design.slots] * design.places).lookup()
    shared = (
        (x, y)
        for y in range(design.height)
        for x in range(design.width)
        if lookup(x, y) is None and lookup.taken(x, y)
    )
    for _, pixel in zip(range(4), shared, strict=False):
        stream.at(*pixel)


def _case(
    name: str, stream: Stream, tables: Sequence[int], codes: Sequence[Codes] | None = None
) -> Case:
    """Make a case whose map holds windows of the stream at every other place."""
    design, pixels = stream.design, stream.pixels
    seen = shown_codes(stream, tables, codes)
    places = []
    for k in range(design.places):
        row = seen[(k * 3) % len(seen)]
        if k % 2:
            row = tuple(design.code_max - code for code in row)
        places.append(row)
    memories = Memories(design, pixels, places, tables, codes)
    return Case(name, memories, tuple(stream.events), stream.start)


def _many_windows(design: Design) -> Case:
    """Make a case of 260 windows with a few events each, more than eight bits can count."""
    design = replace(design, places=design.length + design.exclusion + 3)
    stream = Stream(design, choose_pixels(design))
    for number in range(260):
        stream.slot(number % design.slots, 1 + number % 3)
        stream.slot((number * 7) % design.slots)
        stream.end()
    stream.close()
    return _case("many_windows", stream, [0] * design.slots)
