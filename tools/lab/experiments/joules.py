"""Matches per joule by the rate of events: designs of this project, and published figures.

Modelled is the work alone, of one match per second on a route of 1,000 places, with the cited
constants of ``estimate/energy.toml``; low and high bound their spread. Published figures were
measured by their authors; what they include differs, and is stated. A measurement on a board of
your own is `edge-vpr profile`, whose result has the same name, matches per joule.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

from edge_vpr_tools.estimate.fitting import on_target
from edge_vpr_tools.estimate.model import Mission
from edge_vpr_tools.estimate.targets import find, names

from firmware_model.design import Design
from lab.loop import Draw, Drives, Experiment, Row
from lab.tables import TableView

PLACES = 1_000
EVENTS_PER_S = (10_000, 100_000, 1_000_000)
PIXELS = (150, 25)
#: of a measurement: at the rate of events, or of inputs, that its authors had
OWN_RATE = "its own"


class Published(NamedTuple):
    """Energy of a result of another system in joules, as its authors measured it."""

    system: str
    device: str
    includes: str
    source: str
    low: float
    central: float
    high: float


_LENS = "Hines, Milford and Fischer, Science Robotics 2025, doi 10.1126/scirobotics.ads3968"
_TINY = "MLPerf Tiny v1.3, mlcommons.org, single results without a spread"
_KEYWORDS = "keyword spotting (another task)"
PUBLISHED = (
    # at one match per second
    Published("LENS", "Speck", "sensor and processor", _LENS, 2.43e-3, 2.674e-3, 3.02e-3),
    Published("LENS", "Jetson Nano", "what the work adds", _LENS, 0.667, 0.706, 0.748),
    Published("LENS", "Jetson Nano", "the whole board", _LENS, 4.59, 4.59, 4.59),
    Published(_KEYWORDS, "Cortex-M4 (STM32L4R5)", "processor", _TINY, 1.431e-3, 1.431e-3, 1.431e-3),
    Published(_KEYWORDS, "Cortex-M33 (STM32U385)", "processor", _TINY, 2.45e-4, 2.45e-4, 2.45e-4),
)


def measure(draw: Draw) -> Iterator[Row]:
    """Model the designs on every target whose energy is known, and list what was published."""
    for pixels in PIXELS:
        design = Design(
            width=346, height=260, pixels=pixels, places=PLACES, matching="filter",
            code="contrast", places_per_window=2, gains=7,
        )  # fmt: skip
        for name, rate in product(names(), EVENTS_PER_S):
            target, mission = find(name), Mission(rate, pixels / (346 * 260), 1.0)
            of = on_target(design, mission, target)
            per_joule = of.cost.matches_per_joule
            if per_joule is None or of.cost.load.high >= 1:
                continue
            by_spi = of.cost.spi_events_per_s
            device = target.name
            if by_spi is not None and rate > by_spi:
                device += ", by its stream"  # its SPI line does not carry as many events
            yield {
                "system": f"place filter, {pixels} pixels", "device": device,
                "includes": "what the work adds", "basis": "modelled", "events/s": rate,
                "matches per joule": per_joule.central,
                "low": per_joule.low, "high": per_joule.high,
                "time (ms)": 1e3 * of.cost.load.central / mission.matches_per_s,
                "memory (KiB)": of.memory.total / 1024,
                "of it RAM (KiB)": of.memory.ram_bytes / 1024
                if target.kind == "processor" else None,
                "source": "edge-vpr estimate --sources",
            }  # fmt: skip
    for one in PUBLISHED:
        yield {
            "system": one.system, "device": one.device, "includes": one.includes,
            "basis": "measured", "events/s": OWN_RATE, "matches per joule": 1 / one.central,
            "low": 1 / one.high, "high": 1 / one.low, "time (ms)": None, "memory (KiB)": None,
            "of it RAM (KiB)": None, "source": one.source,
        }  # fmt: skip


EXPERIMENT = Experiment(
    drives=lambda data: [Drives(f"{PLACES:,} places", lambda seed: None, drawn=False)],
    names=("system", "device", "includes", "basis", "events/s"),
    measure=measure,
    view=TableView(
        {},
        ("system", "device", "includes", "basis", "events/s", "matches per joule", "low", "high"),
    ),
    reads_data=False,
)
