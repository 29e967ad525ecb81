"""Two designs side by side in every layer: counts, bytes, instructions, time, modelled energy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from edge_vpr_tools.estimate import show
from edge_vpr_tools.estimate.counts import EveryPixel, sizes
from edge_vpr_tools.estimate.fit import memory_bytes
from edge_vpr_tools.estimate.model import Cost, Mission, cost, work
from edge_vpr_tools.estimate.targets import Constant, Target
from firmware_model.design import Design

#: a design, and what it has to keep up with
Side = tuple[Design, Mission]


def counted(design: Design, mission: Mission) -> dict[str, float]:
    """Count operations and bytes of a match and of a second, and memory."""
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


def _bytes(unit: Any) -> float:
    return float(unit.bytes_read + unit.bytes_written)


def on_targets(
    ours: Side, theirs: Side, targets: Sequence[Target], measured: Constant | None
) -> Iterator[tuple[Target, Cost, Cost]]:
    """Model both on each target."""
    for target in targets:
        a, b = (cost(design, target, mission, measured) for design, mission in (ours, theirs))
        yield target, a, b


def comparison(
    ours: Side, theirs: Side, name: str, targets: Sequence[Target], measured: Constant | None
) -> None:
    """Print both, and how many times the other one takes."""
    a, b = counted(*ours), counted(*theirs)
    rows = [
        [key, f"{a.get(key, 0):,.6g}", f"{value:,.6g}", show.times(value, a.get(key, 0.0))]
        for key, value in b.items()
    ]
    show.table(["exact counts", "this design", name, "times"], rows)
    for kind, unit in (("processor", "instructions"), ("fpga", "cycles"), ("datapath", "cycles")):
        those = [target for target in targets if target.kind == kind]
        if those:
            _modelled(ours, theirs, name, those, unit, measured)
    if isinstance(theirs[0], EveryPixel):
        show.say(
            "all pixels: no firmware or device of this kind holds as many counters; its "
            "instructions continue those of the emulated designs, an event's are taken as with a "
            "look-up, and memories are counted without one"
        )


def _modelled(
    ours: Side,
    theirs: Side,
    name: str,
    targets: Sequence[Target],
    unit: str,
    measured: Constant | None,
) -> None:
    rows = []
    for target, a, b in on_targets(ours, theirs, targets, measured):
        taken = [
            found.cycles["match"].central if found.instructions is None
            else found.instructions["match"]
            for found in (a, b)
        ]  # fmt: skip
        lines = [
            (f"{unit} a match", *(f"{n:,.0f}" for n in taken), show.times(taken[1], taken[0])),
            ("time of a match", *(show.spread(c.seconds["match"], "s") for c in (a, b)),
             show.times(b.seconds["match"].central, a.seconds["match"].central)),
            ("busy", *(show.busy(c.load) for c in (a, b)),
             show.times(b.load.central, a.load.central)),
            ("memory", *(show.size_text(memory_bytes(d, target)) for d, _ in (ours, theirs)),
             show.times(memory_bytes(theirs[0], target), memory_bytes(ours[0], target))),
        ]  # fmt: skip
        if a.energy_j and b.energy_j and a.marginal_w and b.marginal_w:
            for what, x, y, sign in (
                ("energy of a match, modelled", a.energy_j["match"], b.energy_j["match"], "J"),
                ("added power, modelled", a.marginal_w, b.marginal_w, "W"),
            ):
                lines.append(
                    (what, show.spread(x, sign), show.spread(y, sign),
                     show.times(y.central, x.central))
                )  # fmt: skip
        else:
            lines.append(("energy", show.UNKNOWN, show.UNKNOWN, "-"))
        rows += [[target.name if i == 0 else "", *line] for i, line in enumerate(lines)]
    show.table(["target", "", "this design", name, "times"], rows)


def as_dict(
    ours: Side, theirs: Side, targets: Sequence[Target], measured: Constant | None
) -> dict[str, Any]:
    """Both as plain values: ``[this design, the other]``."""
    a, b = counted(*ours), counted(*theirs)
    return {
        "counts": {name: [a.get(name, 0), value] for name, value in b.items()},
        "targets": {
            target.name: [asdict(one) | {"energy_is": "modelled"} for one in (x, y)]
            for target, x, y in on_targets(ours, theirs, targets, measured)
        },
    }
