"""Matches per joule: this project's designs on each device as modelled, and published figures.

Modelled is the work alone, of one match per second on a route of 1,000 places, with the cited
constants of ``estimate/energy.toml``; low and high bound their spread. Published figures were
measured by their authors; what they include differs, and is stated. A measurement on a board of
your own is `edge-vpr profile`, whose result has the same name, matches per joule.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from edge_vpr_tools.estimate.model import Mission
from edge_vpr_tools.estimate.search import Limits, on_target
from edge_vpr_tools.estimate.targets import find, names
from edge_vpr_tools.report.style import CYCLE, panels
from edge_vpr_tools.report.tables import TableView
from edge_vpr_tools.research.experiments.experiment import Draw, Drives, Experiment, Row, Rows
from firmware_model.design import Design

PLACES, EVENTS_PER_S = 1_000, 100_000
PIXELS = (150, 25)


class Published(NamedTuple):
    """Power of another system at one match per second, in watts, as its authors measured it."""

    system: str
    device: str
    includes: str
    source: str
    low: float
    central: float
    high: float


_LENS = "Hines, Milford and Fischer, Science Robotics 2025, doi 10.1126/scirobotics.ads3968"
PUBLISHED = (
    Published("LENS", "Speck", "sensor and processor", _LENS, 2.43e-3, 2.67e-3, 3.02e-3),
    Published("LENS", "Jetson Nano", "what the work adds", _LENS, 0.667, 0.706, 0.748),
    Published("LENS", "Jetson Nano", "the whole board", _LENS, 4.59, 4.59, 4.59),
)


def measure(draw: Draw) -> Iterator[Row]:
    """Model the designs on every target whose energy is known, and list what was published."""
    for pixels in PIXELS:
        design = Design(
            width=346, height=260, pixels=pixels, places=PLACES, matching="filter",
            code="contrast", activity_costs=2, accept="margin",
        )  # fmt: skip
        mission = Mission(EVENTS_PER_S, pixels / (346 * 260), 1.0)
        for name in names():
            target = find(name)
            of = on_target(design, mission, Limits(target, choose_distances=True))
            found = of.cost.matches_per_joule
            if found is None or of.limited_by or target.kind == "datapath":
                continue
            yield {
                "system": f"place filter, {pixels} pixels", "device": target.name,
                "includes": "what the work adds", "basis": "modelled",
                "matches per joule": found.central, "low": found.low, "high": found.high,
                "source": "edge-vpr estimate --sources",
            }  # fmt: skip
    for one in PUBLISHED:
        yield {
            "system": one.system, "device": one.device, "includes": one.includes,
            "basis": "published", "matches per joule": 1 / one.central, "low": 1 / one.high,
            "high": 1 / one.low, "source": one.source,
        }  # fmt: skip


def draw(rows: Rows) -> Figure:
    """Draw each system with its range, modelled and published in two colours."""
    with panels(1, 1, 8.0, 1.2 + 0.42 * len(rows)) as (drawing, ((axes,),)):
        kinds = list(dict.fromkeys(row["basis"] for row in rows))
        for kind in kinds:
            at = [i for i, row in enumerate(rows) if row["basis"] == kind]
            value = np.array([float(rows[i]["matches per joule"]) for i in at])
            ends = np.array([[float(rows[i]["low"]), float(rows[i]["high"])] for i in at]).T
            axes.errorbar(
                value, at, xerr=np.abs(ends - value), marker="o", linestyle="none", capsize=3,
                color=CYCLE[kinds.index(kind)], label=kind,
            )  # fmt: skip
        axes.set_yticks(
            range(len(rows)),
            [f"{row['system']}\n{row['device']}, {row['includes']}" for row in rows],
            fontsize=7,
        )
        axes.set(xscale="log", xlabel="matches per joule (higher is better)")
        axes.invert_yaxis()
        axes.legend(loc="upper left")
    return drawing


EXPERIMENT = Experiment(
    drives=lambda data: [Drives(f"{PLACES:,} places", lambda seed: None, drawn=False)],
    names=("system", "device", "includes", "basis"),
    measure=measure,
    figure=draw,
    view=TableView(
        {}, ("system", "device", "includes", "basis", "matches per joule", "low", "high")
    ),
    reads_data=False,
)
