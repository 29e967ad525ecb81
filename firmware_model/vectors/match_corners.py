"""Corner cases of distances, sequences and the search, with maps laid out by pattern."""

from __future__ import annotations

from dataclasses import replace

from firmware_model.design import Design
from firmware_model.memories import Codes, Memories
from firmware_model.vectors.case import Case
from firmware_model.vectors.stimulus import Stream, choose_pixels, shown_codes, unselected_pixel


def match_cases(design: Design) -> list[Case]:
    """Make the corner cases of matches.

    Returns
    -------
    list of Case
        For a design with a single code of one or two bits, only the cases that fit it.
    """
    cases = [_pattern_case(name, *pattern) for name, pattern in _patterns(design).items()]
    return [case for case in cases if case is not None]


def _patterns(design: Design) -> dict[str, tuple[Design, str]]:
    """Lay out maps by pattern; the query is the same in every window.

    A letter stands for a place: n is equal to the query's descriptor, at distance zero; 1 and 2
    differ from it by one and by two units of code; f is as far as a place can be.
    """
    length, zone = design.length, design.exclusion
    near, far = "n" * length, "f" * (length + zone + 1)
    ratio = replace(design, accept="ratio", ratio=(1, 2))
    below = replace(design, accept="ratio", ratio=(1, 3))
    margin = {t: replace(design, accept="margin", margin=t) for t in (1, 2)}
    one, two = near[:-1] + "1", near[:-1] + "2"
    # products above 16 bits, whose lower 16 bits are in another order
    wide = replace(design, accept="ratio", ratio=(65_534, 65_535))
    single = replace(margin[1], length=1)
    longer = replace(design, length=max(design.length, 8) + 4, places=design.places + 12)
    mixed = ("n1n2" * longer.length)[: longer.length - 1]
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
        "ratio_of_16_bits": (wide, one + far + two),
        "margin_at_threshold": (margin[1], one + far + two),
        "margin_below_threshold": (margin[2], one + far + two),
        "margin_of_17_bits": (replace(margin[1], margin=1 << 16), one + far + two),
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
    pixels = choose_pixels(design)
    stream = Stream(design, pixels)
    windows = design.length + 2
    if name in ("all_places_far", "tie_of_two") and design.window == "time":
        # All windows are empty, so that f differs by the largest code in every slot. Each window
        # has an event at an unselected pixel, since the clock may be too narrow for so long a
        # silence.
        for _ in range(windows):
            stream.at(*unselected_pixel(design, pixels))
            stream.end()
    else:
        for _ in range(windows):
            stream.fill([1 + (slot % 3 == 0) for slot in range(design.slots)])
    stream.close()
    query = shown_codes(stream)[0]
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
    """Move codes to a distance of `steps` units of code; None if there is no room."""
    moved = list(codes)
    for slot, code in enumerate(codes):
        up = design.code_max - code
        step = min(steps, max(up, code))
        moved[slot] += step if step <= up else -step
        steps -= step
    return None if steps else tuple(moved)
