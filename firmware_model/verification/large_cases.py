"""Cases of numbers above 16 bits that are too large for suites on disk."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import replace

from firmware_model.design import ACTIVITY_FRACTION_BITS, Design
from firmware_model.specification import ilog
from firmware_model.vectors.case import Case, Stream
from firmware_model.verification.images import LongWindow
from fixedpoint.activity import EVENTS_TOP


def large_cases(design: Design) -> list[Case]:
    """Make cases of numbers above 16 bits that are too large for suites on disk.

    Parameters
    ----------
    design : Design
        With the place filter.
    """
    design = replace(design, code="counts", gains=1)
    many_pixels = replace(design, pixels=80, lookup_depth=0)
    one = Design(width=4, height=4, pixels=1, places=1, length=1, code="counts", code_bits=8)
    # more than 65,536 distances are held, and the RAM is above 64 KiB
    held = replace(one, length=40, places=1_700, exclusion=1)
    # a second best place is searched for behind place 65,536
    zone = replace(one, matching="filter", length=1, places=32_800, exclusion=1 << 15)
    # rows of 32,768 bytes
    wide = Design(
        width=1 << 15, height=2, pixels=1 << 15, places=2, length=1,
        code="counts", code_bits=1, exclusion=0,
    )  # fmt: skip
    return [
        _long_window(replace(design, window="count", window_events=_LONG_WINDOW)),
        _wide_evidence(many_pixels),
        _wide_residual(many_pixels),
        _shown("held", held, [3 + i % 7 for i in range(42)], lambda k: [k * 7 % 97]),
        _shown("zone", zone, [9, 9, 9], lambda k: [9 if k > 32_795 else 30 + k % 50]),
        _shown("wide", wide, [1, 1], lambda k: [k] * wide.slots),
    ]


#: events of a window by number, more than 16 bits can count
_LONG_WINDOW = 65_540


def _long_window(design: Design) -> Case:
    """Show windows of more events than 16 bits can count."""
    design = replace(design, places=4, exclusion=1)
    slots = design.slots
    shown = [[_LONG_WINDOW - count * (slots - 1), *[count] * (slots - 1)] for count in (3, 1)]
    stream = Stream.showing(design, shown)
    places = stream.shown_codes()[-2:] * 2
    return stream.case("long_window", places, activity=100 << ACTIVITY_FRACTION_BITS)


def _wide_evidence(design: Design) -> Case:
    """Show the same distance to all places, then one that has evidence of 17 bits unsaturated.

    In 16 bits it would be 40.
    """
    wide = replace(design, code_bits=8, exclusion=1, restart=30)
    rest = wide.slots - 65
    near, far = [0] * wide.slots, [255] * 64 + [74] + [0] * rest
    between = [127] * 32 + [128] * 32 + [37] + [0] * rest
    # few events, but enough for evidence of full weight
    nothing = [0] * (wide.slots - 1) + [20]
    stream = Stream.showing(wide, [between, nothing, between])
    rows = [near if place == wide.places // 2 else far for place in range(wide.places)]
    return stream.case("evidence_above_16_bits", rows)


def _wide_residual(design: Design) -> Case:
    """Show a place, and then another, against which there was so much that the first still matches.

    The evidence against the first is 0x10000, before its limit.
    """
    design = replace(
        design, code="counts", code_bits=8, restart=30, exclusion=1,
    )  # fmt: skip
    near = [0] * 65
    far, between = [255] * 64 + [64], [127] * 32 + [128] * 32 + [32]
    rest = [0] * (design.slots - 66)

    def window(counts: list[int]) -> list[int]:
        # as many events in each, the others at a slot that is full
        return [*counts, *rest, 17_000 - sum(counts)]

    stream = Stream.showing(design, map(window, (between, near, between, near, between, far)))
    places = [[*codes, *rest, 255] for codes in [far] * (design.places - 1) + [near]]
    return stream.case("wide_residual", places, activity=17_000 << ACTIVITY_FRACTION_BITS)


def _shown(
    name: str, design: Design, counts: Sequence[int], codes_at: Callable[[int], list[int]]
) -> Case:
    """Show counts of the last slot, one in each window, to a map of these codes."""
    stream = Stream.showing(design, ([0] * (design.slots - 1) + [n] for n in counts))
    return stream.case(name, [codes_at(place) for place in range(design.places)])


def long_windows(design: Design) -> list[LongWindow]:
    """Make windows of more events than a file should have."""
    return [_saturated(design), *_logarithms(design)]


def _logarithms(design: Design) -> list[LongWindow]:
    """Make windows that show each sixteenth of the highest octave of event numbers, and its edge.

    The mean activity is the least of this logarithm, or less by one; or the window has more events
    than 23 bits can count. The metric of the only place is the cost of staying there.
    """
    design = replace(
        design, code="counts", code_bits=1, places=1, exclusion=0,
    )  # fmt: skip
    # from an empty window on, whose costs are those of the first one
    stream = Stream(design)
    stream.skip(1)
    stream.slot(0)
    stream.end()
    stream.close()
    least = [bisect_left(range(EVENTS_TOP), log, key=ilog) for log in range(352, 368)]
    shown = [(16_000, n - less, ilog(16_000) - ilog(n)) for n in least for less in (0, 1)]
    windows = []
    # one event less than the most of another logarithm, and more than 23 bits can count
    for events, mean_activity, edge in (
        *shown,
        (EVENTS_TOP - 2, least[1], 14),
        (EVENTS_TOP + 2, least[1], 14),
    ):
        # before the empty window, behind which it is less by 1/1024
        activity = -(-(mean_activity << ACTIVITY_FRACTION_BITS) * 1024 // 1023)
        # the row of this activity is the last that has its cost of staying
        case = stream.case("", [[0] * design.slots], activity=activity, place_activity=[edge + 21])
        windows.append(LongWindow(case, events))
    return windows


def _saturated(design: Design) -> LongWindow:
    """Make a window with more events than 23 bits can count, which saturates.

    The next window then has so little less than 1/8 of the mean activity that it would be a pause
    without the saturation.
    """
    design = replace(design, code="counts", places=4, exclusion=1)
    stream, rest = Stream(design), list(range(1, design.slots))
    stream.fill([1] + [0] * len(rest))
    for _ in range(2):
        stream.fill([17_400 - sum(rest), *rest])
    stream.close()
    places = [[slot * place % 8 for slot in range(design.slots)] for place in range(4)]
    return LongWindow(stream.case("", places), (1 << 23) + (1 << 20))
