"""What the core must do: claims about its units, its streams, windows and matches.

The core has small parameters. In claims about the whole core, its memories are replaced by ones
that return any word, so that a claim holds for all tables, places and contents, and its activity by
one that says anything. The files of ``rtl/formal`` state what must hold at the ports of the core or
of a unit, and ``vpr_core_inside.sv`` what must hold inside the core.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from firmware_model.hardware.sources import UNITS
from firmware_model.verification.formal import (
    SIMPLIFIED,
    Claim,
    broken_source,
    holds,
)

#: first clocks that claims with a bound are about; cores of sequences have two windows in fewer
CLOCKS, CLOCKS_OF_SEQUENCES = 120, 80
#: state of each define of ``vpr_core_properties.sv`` that a core must be able to reach
COVERS = {
    "THREE": "three matches are taken",
    "RESET": "a match follows after a reset that came after a match",
    "WAIT": "an event waits while a match does",
}
#: constants of the cores that are proved: 2 slots and 2 places, and numbers of few bits
_SMALL = {
    "PIXELS": 2, "TIMESTAMP_BITS": 4, "EVENT_TIME_BITS": 4, "TAU_US": 3, "WINDOW_EVENTS": 2,
    "PLACES": 2, "RESTART": 2, "TRUST": 1, "LARGEST_SUM": 1, "WINDOW_EVENTS_BITS": 2,
    "METRIC_BITS": 2, "SUM_BITS": 2, "RECIPROCAL_BITS": 5, "EVIDENCE_BITS": 2, "TRUST_BITS": 6,
}  # fmt: skip


#: claim that must refuse a broken version, its file, the replaced text, and its replacement
Broken = tuple[Claim, str, str, str]


class Kind(NamedTuple):
    """Clocks within which the core must get on, and its constants beside those of `_SMALL`."""

    progress: int
    constants: dict[str, int]


#: cores that are proved, by the kind of design
CORE_KINDS = {
    "sequences of 2": Kind(36, {"LENGTH": 2}),
    "place filter, contrast": Kind(90, {"FILTER": 1, "OWN_MEAN": 1, "CONTRAST": 1}),
}


#: units of the core, and what stands for its memories and its activity
_CORE = (
    "formal/vpr_free_memories.sv",
    "formal/vpr_free_activity.sv",
    *(unit for unit in UNITS if unit not in ("vpr_activity.sv", "vpr_logarithm.sv")),
)


def progress(kind: str) -> Claim:
    """Return the claim that the core of a kind of `CORE_KINDS` gets on."""
    bound = CLOCKS if "FILTER" in CORE_KINDS[kind].constants else CLOCKS_OF_SEQUENCES
    name = (
        f"in the first {bound} clocks, an event that is offered is taken, or a window or match is "
        f"complete, within so many clocks in which the core waits for nobody ({kind})"
    )
    return _of_core(name, "PROVE_PROGRESS", kind, bound)


def cover(define: str, kind: str) -> Claim:
    """Return the claim that a kind of `CORE_KINDS` never reaches a state of `COVERS`.

    `holds` must refuse it: then there are inputs that lead there in the first clocks.
    """
    return _of_core(f"never: {COVERS[define]} ({kind})", f"COVER_{define}", kind, CLOCKS)


def _of_core(name: str, define: str, kind: str, bound: int) -> Claim:
    clocks, constants = CORE_KINDS[kind]
    return Claim(
        name, "vpr_core_properties", _CORE, define, _SMALL | constants, {"PROGRESS": clocks},
        bound=bound,
    )  # fmt: skip


_REGISTERS_OF_SEARCH = (
    *("delay.delayed_q", "filled_q", "behind_q", "has_left_q", "left_q", "left_sum_q", "update_q"),
    *("sum_lower_q", "sum_equal_q", "sum_below_second_q", "oldest_lower_q", "oldest_place_q"),
)


class Size(NamedTuple):
    """Sizes of a search that is proved."""

    exclusion: int
    sum_bits: int
    place_bits: int


def search(size: Size, *, invariant: bool = True) -> Claim:
    """Return the claim that the search of one size finds the best and the second best.

    `invariant` adds assertions about its registers, with which pdr finds an invariant sooner.
    """
    return Claim(
        str(size),
        "vpr_search_properties",
        ("formal/vpr_shift_delay.sv", "vpr_search.sv"),
        constants={name.upper(): value for name, value in size._asdict().items()},
        parameters={"INVARIANT": int(invariant)},
        exposed=_REGISTERS_OF_SEARCH,
        method=SIMPLIFIED,
    )


#: the search of the broken versions, by its outputs alone
SMALL_SEARCH = search(Size(1, 2, 3), invariant=False)
#: each prediction is the cost of the cheapest path, and at most that of a restart; with steps of 0,
#: 1 and 2 places of any costs
PREDICTION = Claim(
    "prediction of the place filter",
    "vpr_prediction_properties",
    ("vpr_prediction.sv",),
    constants={"STEPS": 3, "COST_BITS": 4, "RESTART": 9, "METRIC_BITS": 4},
    exposed=("entries_q",),
)  # fmt: skip
#: a window by time ends when the time of an event requires it, of 6 bits
TIMER = Claim(
    "end of a window by time",
    "vpr_window_timer_properties",
    ("vpr_window_timer.sv",),
    constants={"TIMESTAMP_BITS": 6, "TAU_US": 11},
    exposed=("end_inverse_q", "behind_q", "due_q"),
)
COUNTERS = Claim(
    "each event raises the count of its slot by one, up to its maximum",
    "vpr_counters_properties",
    ("vpr_ram.sv", "vpr_counters.sv"),
    constants={"PIXELS": 3, "COUNT_MAX": 2},
)
DELAY = Claim(
    "a delay line returns each word so many pushes later",
    "vpr_delay_properties",
    ("vpr_ram.sv", "vpr_delay.sv"),
)
#: the delay line of pixels behind slow block memories
DELAY_OF_THREE = replace(DELAY, name=f"{DELAY.name}, of 3 words", parameters={"STEPS": 3})
CLAIMS = (
    *map(search, (Size(0, 4, 4), Size(1, 3, 3), Size(2, 3, 4), Size(3, 4, 4))),
    SMALL_SEARCH,
    PREDICTION,
    TIMER,
    COUNTERS,
    DELAY,
    DELAY_OF_THREE,
    *map(progress, CORE_KINDS),
)

_SEQUENCES, _FILTER = CORE_KINDS
REACHED = tuple(cover(define, kind) for kind in CORE_KINDS for define in COVERS)


def _broken(claim: Claim, texts: dict[str, tuple[str, str]]) -> dict[str, Broken]:
    """Return broken versions of the unit that a claim is about."""
    return {name: (claim, claim.files[-1], *text) for name, text in texts.items()}


#: broken versions
BROKEN: dict[str, Broken] = {
    **_broken(
        SMALL_SEARCH,
        {
            "of equal sums the highest place is best": (
                "below_best[SUM_BITS];",
                "below_best[SUM_BITS] || sum_i == best_sum_o;",
            ),
            "of equal seconds the highest place wins": (
                "below_second[SUM_BITS];",
                "below_second[SUM_BITS] || sum_i == second_sum_o;",
            ),
            "of equal sums on the left the highest wins": (
                "below_left[SUM_BITS];",
                "below_left[SUM_BITS] || oldest == left_sum_q;",
            ),
            "the second best may lie at the zone's edge": (
                "behind_q == ZONE_BITS'(EXCLUSION)",
                "behind_q == ZONE_BITS'(EXCLUSION - 1)",
            ),
            "the place on the left is off by one": (
                "place_i - PLACE_BITS'(DELAY)",
                "place_i - 1'b1",
            ),
            "a sum leaves the delay line too early": (
                "leaves   = filled_q == ZONE_BITS'(DELAY)",
                "leaves   = filled_q >= ZONE_BITS'(EXCLUSION)",
            ),
            "a new best forgets the place that leaves": (
                "second_o     <= left_d;",
                "second_o     <= left_q;",
            ),
            "a new best keeps the ties": (
                "ties_o       <= '0;\n                behind_q",
                "behind_q",
            ),
            "a match begins with the left of the last": (
                "has_left_q   <= 1'b0;\n            has_best_o",
                "has_best_o",
            ),
            "the best is never replaced": ("!has_best_o || sum_lower_q", "!has_best_o"),
        },
    ),
    **_broken(
        PREDICTION,
        {
            "the dearer of two ways is taken": ("right < left ?", "right > left ?"),
        },
    ),
    **_broken(
        TIMER,
        {
            "half a clock behind the end is before it": (" || low_zero_q;", ";"),
            "an end is added without its carry": ("^ added_q ^ end_carry_q", "^ added_q"),
            "an event keeps the carry of the one before": (
                "            behind_carry_q <= '0;\n",
                "",
            ),
            "a carry between the halves is lost": ("(due_q && passes_q)", "1'b0"),
        },
    ),
    "a core stops after its first match": (
        progress(_SEQUENCES),
        "vpr_core.sv",
        "match_taken || (finished && !has_best)",
        "match_taken && (finished && !has_best)",
    ),
    "a filter stops after its first match": (
        progress(_FILTER),
        "vpr_core.sv",
        "match_taken || (finished && !has_best)",
        "match_taken && (finished && !has_best)",
    ),
    **_broken(
        COUNTERS,
        {
            "the last count of a slot is not looked at": ("same_1_q ? raised_o : ", ""),
            "the count before the last is not looked at": ("same_2_q ? written_q : ", ""),
            "a drained count is kept": ("clears_q ? '0 : ", ""),
            "a count wraps": ("count == FULL ? FULL : count", "count"),
        },
    ),
    **_broken(
        DELAY,
        {
            "a delay line has a word more": ("STEPS - 1) ? '0", "STEPS) ? '0"),
        },
    ),
}


def reached(claim: Claim) -> bool:
    """Return whether the state of a `cover` is reached; raises as `holds`."""
    return not holds(claim)


def refused(name: str) -> bool:
    """Return whether a broken version, by its name in `BROKEN`, is refused; raises as `holds`."""
    claim, file, old, new = BROKEN[name]
    return not holds(claim, {file: broken_source(file, old, new)})
