"""Two designs side by side on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from edge_vpr_tools.estimate.comparison import Comparison, Costs
from edge_vpr_tools.estimate.counts import EveryPixel
from edge_vpr_tools.estimate.fit import memory_bytes
from edge_vpr_tools.estimate.model import Cost
from edge_vpr_tools.estimate.wording import UNKNOWN, busy, size_text, spread, times
from edge_vpr_tools.output.tables import say, table


def show_comparison(found: Comparison, name: str) -> None:
    """Print both, and how many times the other one takes.

    Parameters
    ----------
    found : Comparison
    name : str
        Of the other design.
    """
    rows = [
        [key, f"{pair.ours:,.6g}", f"{pair.theirs:,.6g}", times(pair.theirs, pair.ours)]
        for key, pair in found.counts.items()
    ]
    table(["exact counts", "this design", name, "times"], rows)
    for kind, unit in (("processor", "instructions"), ("fpga", "cycles"), ("datapath", "cycles")):
        those = [one for one in found.costs if one.target.kind == kind]
        if those:
            _modelled(found, name, those, unit)
    if isinstance(found.theirs.design, EveryPixel):
        say(
            "all pixels: no firmware or device of this kind holds as many counters; its "
            "instructions continue those of the emulated designs, an event's are taken as with a "
            "look-up, and memories are counted without one"
        )


def _modelled(found: Comparison, name: str, costs: Sequence[Costs], unit: str) -> None:
    rows = []
    for target, a, b in costs:
        taken = [_taken(one) for one in (a, b)]
        memory = [memory_bytes(side.design, target) for side in (found.ours, found.theirs)]
        lines = [
            (f"{unit} a match", *(f"{n:,.0f}" for n in taken), times(taken[1], taken[0])),
            ("time of a match", *(spread(c.seconds["match"], "s") for c in (a, b)),
             times(b.seconds["match"].central, a.seconds["match"].central)),
            ("busy", *(busy(c.load) for c in (a, b)), times(b.load.central, a.load.central)),
            ("memory", *map(size_text, memory), times(memory[1], memory[0])),
        ]  # fmt: skip
        if a.energy_j and b.energy_j and a.marginal_w and b.marginal_w:
            for what, x, y, sign in (
                ("energy of a match, modelled", a.energy_j["match"], b.energy_j["match"], "J"),
                ("added power, modelled", a.marginal_w, b.marginal_w, "W"),
            ):
                lines.append((what, spread(x, sign), spread(y, sign), times(y.central, x.central)))
        else:
            lines.append(("energy", UNKNOWN, UNKNOWN, "-"))
        rows += [[target.name if i == 0 else "", *line] for i, line in enumerate(lines)]
    table(["target", "", "this design", name, "times"], rows)


def _taken(found: Cost) -> float:
    """Return the instructions of a match, or its cycles where there is no program."""
    if found.instructions is None:
        return found.cycles["match"].central
    return found.instructions["match"]
