"""Prove units of the core with yosys-smtbmc: the search, the filter's prediction, and the timer.

The proofs are by induction, for any number of sums, metrics or windows at any times. Each
deliberately broken version must be refused.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from firmware_model.hardware.formal import broken_source, solve, translate

#: registers of the search to which the induction refers
REGISTERS = (
    *("delay.delayed", "filled", "behind", "has_left", "left", "left_sum", "update"),
    *("sum_lower", "sum_equal", "sum_below_second", "oldest_lower", "oldest_place"),
)
#: clocks of an induction step, and clocks within which a broken version must fail
INDUCTION, BOUND = 4, 24


class Size(NamedTuple):
    """Parameters of a search that is proved."""

    exclusion: int
    sum_bits: int
    place_bits: int


SIZES = (Size(0, 4, 4), Size(1, 3, 3), Size(2, 3, 4), Size(3, 4, 4))
#: size of the broken versions
SMALL = Size(1, 2, 3)

#: broken versions: text of ``vpr_search.sv`` and its replacement
BROKEN = {
    "of equal sums the highest place is best": (
        "below_best[SUM_BITS];",
        "below_best[SUM_BITS] || sum == best_sum;",
    ),
    "of equal seconds the highest place wins": (
        "below_second[SUM_BITS];",
        "below_second[SUM_BITS] || sum == second_sum;",
    ),
    "of equal sums on the left the highest wins": (
        "below_left[SUM_BITS];",
        "below_left[SUM_BITS] || oldest == left_sum;",
    ),
    "the second best may lie at the zone's edge": (
        "behind == ZONE_BITS'(EXCLUSION)",
        "behind == ZONE_BITS'(EXCLUSION - 1)",
    ),
    "the place on the left is off by one": ("place - PLACE_BITS'(DELAY)", "place - 1'b1"),
    "a sum leaves the delay line too early": (
        "leaves   = filled == ZONE_BITS'(DELAY)",
        "leaves   = filled >= ZONE_BITS'(EXCLUSION)",
    ),
    "a new best forgets the place that leaves": (
        "second     <= next_left;",
        "second     <= left;",
    ),
    "a new best keeps the ties": ("ties       <= '0;\n                behind", "behind"),
    "a match begins with the left of the last": (
        "has_left   <= 1'b0;\n            has_best",
        "has_best",
    ),
    "the best is never replaced": ("!has_best || sum_lower", "!has_best"),
}


def prove(size: Size, source: str | None = None, *, seconds: int = 300) -> bool:
    """Prove the search without a bound on the number of sums.

    Parameters
    ----------
    size : Size
    source : str, optional
        Text of ``vpr_search.sv``; by default the original.
    seconds : int
        Time limit of the solver.

    Returns
    -------
    bool
        Whether base case and induction hold.

    Raises
    ------
    ToolError
        If a tool is missing, refuses the source, or takes too long.
    """
    with tempfile.TemporaryDirectory() as folder:
        model = _search_model(Path(folder), size, source, induction=True)
        base = solve(model, ["-t", str(INDUCTION)], seconds)
        return base and solve(model, ["-i", "-t", str(INDUCTION)], seconds)


def refuted(size: Size, source: str, *, seconds: int = 300) -> bool:
    """Return whether a search gives a wrong result for some sums within `BOUND` clocks.

    Parameters
    ----------
    size : Size
    source : str
        Text of ``vpr_search.sv``.
    seconds : int
        Time limit of the solver.

    Returns
    -------
    bool

    Raises
    ------
    ToolError
        Same as for `prove`.
    """
    with tempfile.TemporaryDirectory() as folder:
        model = _search_model(Path(folder), size, source, induction=False)
        return not solve(model, ["-t", str(BOUND)], seconds)


#: parameters of the prediction that is proved: steps of 0, 1 and 2 places, and one back
_PREDICTION = {
    "STEPS": "3",
    "BACK": "1",
    "STEP_PRICES": f"160'h{2 | 1 << 2 * 10:040x}",
    "BACK_PRICES": "160'h3",
    "RESTART": "9",
    "METRIC_BITS": "4",
}
#: broken versions of the prediction: text of ``vpr_prediction.sv`` and its replacement
BROKEN_PREDICTIONS = {
    "the dearer of two ways is taken": ("right < left ?", "right > left ?"),
    "a place off the map is one to come from": ("shifts_off || !below", "!below"),
}


def prove_prediction(source: str | None = None, *, seconds: int = 600) -> bool:
    """Prove that each prediction is the price of the cheapest way, and at most that of a restart.

    Parameters
    ----------
    source : str, optional
        Text of ``vpr_prediction.sv``; by default the original.
    seconds : int
        Time limit of the solver.

    Returns
    -------
    bool
        Whether base case and induction hold. If `source` is given, only the base case is checked,
        in which a broken version must fail.

    Raises
    ------
    ToolError
        Same as for `prove`.
    """
    with tempfile.TemporaryDirectory() as folder:
        model = translate(
            Path(folder), "vpr_prediction", source, _parameters(_PREDICTION), ("entries",)
        )
        base = solve(model, ["-t", "8"], seconds)
        return base and (source is not None or solve(model, ["-i", "-t", "8"], seconds))


#: parameters of the timer that is proved
_TIMER = {"TIMESTAMP_BITS": "6", "TAU_US": "11"}


def prove_timer(source: str | None = None, *, seconds: int = 300) -> bool:
    """Prove that a window by time ends when the time of an event requires it, for 6 bits.

    Parameters
    ----------
    source : str, optional
        Text of ``vpr_window_timer.sv``; by default the original.
    seconds : int
        Time limit of the solver.

    Returns
    -------
    bool
        Same as for `prove_prediction`.

    Raises
    ------
    ToolError
        Same as for `prove`.
    """
    with tempfile.TemporaryDirectory() as folder:
        model = translate(
            Path(folder), "vpr_window_timer", source, _parameters(_TIMER),
            ("end_inverse", "behind"),
        )  # fmt: skip
        base = solve(model, ["-t", "20"], seconds)
        return base and (source is not None or solve(model, ["-i", "-t", "12"], seconds))


#: broken versions of the timer: text of ``vpr_window_timer.sv`` and its replacement
BROKEN_TIMERS = {
    "half a clock behind the end is before it": (
        " || low_zero;",
        ";",
    ),
    "an end is added without its carry": ("^ added ^ end_carry", "^ added"),
    "an event keeps the carry of the one before": ("            behind_carry <= 1'b0;\n", ""),
}


def broken_timer(name: str) -> str:
    """Return the source of a broken version, by its name in `BROKEN_TIMERS`; raises as `broken`."""
    return broken_source("vpr_window_timer.sv", *BROKEN_TIMERS[name])


def broken_prediction(name: str) -> str:
    """Return the source of a broken version, by its name in `BROKEN_PREDICTIONS`.

    Raises
    ------
    ToolError
        If the text to be replaced does not occur exactly once.
    """
    return broken_source("vpr_prediction.sv", *BROKEN_PREDICTIONS[name])


def broken(name: str) -> str:
    """Return the source of a broken version, by its name in `BROKEN`.

    Raises
    ------
    ToolError
        If the text to be replaced does not occur exactly once.
    """
    return broken_source("vpr_search.sv", *BROKEN[name])


def _search_model(folder: Path, size: Size, source: str | None, *, induction: bool) -> Path:
    chosen = {name.upper(): str(value) for name, value in size._asdict().items()}
    claimed = _parameters(chosen | {"INDUCTION": str(int(induction))})
    return translate(
        folder,
        "vpr_search",
        source,
        _parameters(chosen),
        REGISTERS,
        claimed,
        ("vpr_shift_delay.sv",),
    )


def _parameters(values: Mapping[str, str]) -> str:
    return " ".join(f"-set {name} {value}" for name, value in values.items())
