"""Prove units of the core with yosys-smtbmc: the search, the filter's prediction, and the timer.

The proofs are by induction, for any number of sums, metrics or windows at any times. Each
deliberately broken version must fail in the clocks of the base case.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from firmware_model.errors import ToolError
from firmware_model.hardware.sources import text_of
from firmware_model.verification.formal import (
    PROPERTIES,
    broken_source,
    chparam,
    run,
    run_yosys,
    write_package,
)


@dataclass(frozen=True)
class Unit:
    """Unit of the core, and how it is proved.

    Attributes
    ----------
    name : str
        Name of the module, and of its file.
    constants : mapping of str to int
        Of the package of sizes and widths.
    exposed : tuple of str
        Registers to which the induction refers.
    base, induction : int
        Clocks of the base case, and of an induction step.
    broken : mapping of str to (str, str)
        Broken versions: text of the file, and its replacement.
    claimed : mapping of str to int
        Parameters of the properties.
    beside : tuple of str
        Files of properties with the units that this one uses.
    """

    name: str
    constants: Mapping[str, int]
    exposed: tuple[str, ...]
    base: int
    induction: int
    broken: Mapping[str, tuple[str, str]]
    claimed: Mapping[str, int] = field(default_factory=dict)
    beside: tuple[str, ...] = ()

    def proved(self) -> bool:
        """Return whether base case and induction hold.

        Raises
        ------
        ToolError
            If a tool is missing, refuses the source, or takes too long.
        """
        return self._solved(text_of(f"{self.name}.sv"), self.induction)

    def refused(self, name: str) -> bool:
        """Return whether a broken version, by its name in `broken`, fails.

        Raises
        ------
        ToolError
            Same as for `proved`; or if the text to be replaced does not occur exactly once.
        """
        return not self._solved(broken_source(f"{self.name}.sv", *self.broken[name]))

    def _solved(self, source: str, induction: int | None = None) -> bool:
        with tempfile.TemporaryDirectory() as folder:
            model = self._model(Path(folder), source)
            base = _holds(model, "-t", str(self.base))
            if induction is None:
                return base
            return base and _holds(model, "-i", "-t", str(induction))

    def _model(self, folder: Path, source: str) -> Path:
        """Write the SMT2 model of the unit, whose file has this text, and of its properties."""
        file, model = folder / f"{self.name}.sv", folder / f"{self.name}.smt2"
        file.write_text(source, encoding="ascii")
        properties = f"{self.name}_properties"
        files = [write_package(folder, self.constants), file]
        files += [PROPERTIES / name for name in self.beside]
        # wires of an inner unit get names that ports can have
        outer = [name.rpartition(".")[2] for name in self.exposed]
        run_yosys(
            [
                f"read_verilog -formal -sv {' '.join(map(str, files))}",
                f"hierarchy -top {self.name}; proc; flatten; cd {self.name}",
                *(
                    f"rename {inner} {name}"
                    for inner, name in zip(self.exposed, outer, strict=True)
                    if inner != name
                ),
                "cd",
                f"expose {' '.join(f'{self.name}/w:{name}' for name in outer)}",
                f"read_verilog -formal -sv {PROPERTIES / f'{properties}.sv'}",
                chparam(self.claimed, properties),
                f"hierarchy -top {properties}; proc; flatten; opt_clean",
                f"write_smt2 -wires {model}",
            ],
            self.name,
        )
        return model


#: time limit of the solver
_SECONDS = 600


def _holds(model: Path, *options: str) -> bool:
    """Return whether the assertions of an SMT2 model hold, by yosys-smtbmc and z3."""
    done = run(["yosys-smtbmc", "-s", "z3", *options, str(model)], _SECONDS)
    if "Status: PASSED" in done.stdout:
        return True
    if "Status: FAILED" in done.stdout:
        return False
    raise ToolError(f"yosys-smtbmc gives no answer: {(done.stderr + done.stdout).strip()}")


_REGISTERS_OF_SEARCH = (
    *("delay.delayed_q", "filled_q", "behind_q", "has_left_q", "left_q", "left_sum_q", "update_q"),
    *("sum_lower_q", "sum_equal_q", "sum_below_second_q", "oldest_lower_q", "oldest_place_q"),
)


class Size(NamedTuple):
    """Sizes of a search that is proved."""

    exclusion: int
    sum_bits: int
    place_bits: int


_SIZES = (Size(0, 4, 4), Size(1, 3, 3), Size(2, 3, 4), Size(3, 4, 4))
_SMALL = Size(1, 2, 3)
_BROKEN_SEARCHES = {
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
    "the place on the left is off by one": ("place_i - PLACE_BITS'(DELAY)", "place_i - 1'b1"),
    "a sum leaves the delay line too early": (
        "leaves   = filled_q == ZONE_BITS'(DELAY)",
        "leaves   = filled_q >= ZONE_BITS'(EXCLUSION)",
    ),
    "a new best forgets the place that leaves": (
        "second_o     <= left_d;",
        "second_o     <= left_q;",
    ),
    "a new best keeps the ties": ("ties_o       <= '0;\n                behind_q", "behind_q"),
    "a match begins with the left of the last": (
        "has_left_q   <= 1'b0;\n            has_best_o",
        "has_best_o",
    ),
    "the best is never replaced": ("!has_best_o || sum_lower_q", "!has_best_o"),
}


def search(size: Size, *, induction: bool = True) -> Unit:
    """Return the search of one size, for a proof by induction or for a bounded check."""
    return Unit(
        "vpr_search",
        {name.upper(): value for name, value in size._asdict().items()},
        _REGISTERS_OF_SEARCH,
        base=4 if induction else 24,
        induction=4,
        broken=_BROKEN_SEARCHES,
        claimed={"INDUCTION": int(induction)},
        beside=("vpr_shift_delay.sv",),
    )


#: the search of the broken versions
SMALL_SEARCH = search(_SMALL, induction=False)
#: each prediction is the cost of the cheapest path, and at most that of a restart; with steps of 0,
#: 1 and 2 places of any costs, and one back
PREDICTION = Unit(
    "vpr_prediction",
    {
        "STEPS": 3,
        "BACK": 1,
        "COST_BITS": 4,
        "BACK_COSTS": 3,
        "RESTART": 9,
        "METRIC_BITS": 4,
    },
    ("entries_q",),
    base=8,
    induction=8,
    broken={
        "the dearer of two ways is taken": ("right < left ?", "right > left ?"),
        "a place off the map is one to come from": ("shifts_off_q || !below", "!below"),
    },
)
#: a window by time ends when the time of an event requires it, of 6 bits
TIMER = Unit(
    "vpr_window_timer",
    {"TIMESTAMP_BITS": 6, "TAU_US": 11},
    ("end_inverse_q", "behind_q", "due_q"),
    base=20,
    induction=12,
    broken={
        "half a clock behind the end is before it": (" || low_zero_q;", ";"),
        "an end is added without its carry": ("^ added_q ^ end_carry_q", "^ added_q"),
        "an event keeps the carry of the one before": ("            behind_carry_q <= '0;\n", ""),
        "a carry between the halves is lost": ("(due_q && passes_q)", "1'b0"),
    },
)
#: what is proved, by its name
PROVED = {
    **{str(size): search(size) for size in _SIZES},
    "prediction of the place filter": PREDICTION,
    "end of a window by time": TIMER,
}
