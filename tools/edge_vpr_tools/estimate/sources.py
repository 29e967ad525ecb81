"""Assumptions, sources and unknown values of an estimate."""

from __future__ import annotations

from dataclasses import asdict

from edge_vpr_tools.estimate import core_area
from edge_vpr_tools.estimate.estimation import Estimation
from edge_vpr_tools.estimate.model import firmware
from edge_vpr_tools.estimate.targets import Constant
from edge_vpr_tools.estimate.wording import three


def sources(found: Estimation) -> list[str]:
    """Return a sentence for each assumption, and for each cited constant."""
    said = []
    cited: dict[Constant, None] = {}
    for target in found.question.targets:
        if target.kind == "processor":
            told = firmware()[target.core]
            said.append(
                f"{target.name}: instructions of the reference firmware ({told.compiler}, "
                f"{target.core}); cycles an instruction {three(target.cpi)}: {target.cpi_source}"
            )
        if target.logic_cells:
            furthest = max(map(abs, core_area.errors().values()))
            said.append(
                f"{target.name}: logic cells are predicted from {len(core_area.FITTED_ON)} "
                f"netlists of the hardware core; of {len(core_area.JUDGED_ON)} others they were "
                f"{furthest:.1%} off at most"
            )
        if target.note:
            said.append(f"{target.name}: {target.note}")
        if target.unknown and found.question.measured is None:
            remedy = "; --calibrate takes a profile of your board"
            said.append(f"{target.name}: {target.unknown}" + remedy * (target.kind == "processor"))
        cited |= dict.fromkeys(found.costs[target.name].basis)
    said += [
        f"modelled, {constant.name}: {three(asdict(constant.value).values())} "
        f"{constant.unit} (year {constant.year}, {constant.node}): {constant.source}; "
        f"{constant.uncertainty}"
        for constant in cited
    ]
    return said
