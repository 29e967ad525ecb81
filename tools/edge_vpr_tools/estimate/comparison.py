"""Two designs side by side in every layer: counts, bytes, instructions, time, modelled energy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from edge_vpr_tools.estimate.counts import Work, sizes
from edge_vpr_tools.estimate.model import Cost, Mission, cost, work
from edge_vpr_tools.estimate.targets import Constant, Target
from edge_vpr_tools.output.json_records import to_json
from firmware_model.design import Design


class Side(NamedTuple):
    """A design, and what it has to keep up with."""

    design: Design
    mission: Mission


class Pair(NamedTuple):
    """A number of this design, and of the other one."""

    ours: float
    theirs: float


class Costs(NamedTuple):
    """Costs of this design on a target, and of the other one."""

    target: Target
    ours: Cost
    theirs: Cost


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two designs in every layer.

    Attributes
    ----------
    ours, theirs : Side
    counts : dict of str to Pair
        Exact counts, by name.
    costs : tuple of Costs
        On each target.
    """

    ours: Side
    theirs: Side
    counts: dict[str, Pair]
    costs: tuple[Costs, ...]

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold: ``[this design, the other]``."""
        return {
            "counts": {name: list(pair) for name, pair in self.counts.items()},
            "targets": {
                target.name: [to_json(one) | {"energy_is": "modelled"} for one in (ours, theirs)]
                for target, ours, theirs in self.costs
            },
        }


def compare(
    ours: Side, theirs: Side, targets: Iterable[Target], measured: Constant | None = None
) -> Comparison:
    """Count and model two designs.

    Parameters
    ----------
    ours, theirs : Side
    targets : iterable of Target
    measured : Constant, optional
        See `cost`.
    """
    a, b = counted(*ours), counted(*theirs)
    return Comparison(
        ours,
        theirs,
        {name: Pair(a.get(name, 0), value) for name, value in b.items()},
        tuple(
            Costs(
                target,
                *(cost(side.design, target, side.mission, measured) for side in (ours, theirs)),
            )
            for target in targets
        ),
    )


def counted(design: Design, mission: Mission) -> dict[str, float]:
    """Return operations and bytes of a match and of a second, and memory."""
    units, rates, size = work(design), mission.rates, sizes(design)
    match = units["match"]
    found: dict[str, float] = {"counters": design.slots}
    found |= {f"{name}, a match": n for name, n in match.operations.items() if n}
    found |= {
        "bytes read, a match": match.bytes_read,
        "bytes written, a match": match.bytes_written,
    }
    found |= {"bytes read and written, a window's end": _bytes(units["window"])}
    for name in match.operations:
        total = sum(units[unit].operations[name] * rate for unit, rate in rates.items())
        if total:
            found[f"{name}, a second"] = total
    found["bytes read and written, a second"] = sum(
        _bytes(units[unit]) * rate for unit, rate in rates.items()
    )
    return found | {
        "bytes a place": size.place_bytes,
        "bytes of all places": design.places * size.place_bytes,
        "bytes of all memories, packed": size.packed_bytes,
        "flash of the firmware in C": size.flash_bytes,
        "RAM of the firmware in C": size.ram_bytes,
    }


def _bytes(unit: Work) -> float:
    return unit.bytes_read + unit.bytes_written
