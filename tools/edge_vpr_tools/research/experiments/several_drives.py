"""Maps of one drive and of several, in the same light and in others, on simulated streets.

The map is made of a drive in the sun. One or two more drives of the street in other light are
learnt, aligned by matching or by their tracks; a further drive in each light tests the map.
Nothing was chosen on these streets.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from edge_vpr.descriptors.counting import count_places
from edge_vpr.evaluation.tracks import with_positions
from edge_vpr.learning import learn_drive
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import SimulatedRecording, simulate_pair
from edge_vpr_tools.report.tables import TableView
from edge_vpr_tools.research.experiments.drives import second_drive
from edge_vpr_tools.research.experiments.experiment import Draw, Drives, Experiment, Row
from edge_vpr_tools.research.experiments.pairs import MappedPair, truth_of_pair
from edge_vpr_tools.research.experiments.plots import dots

LENGTH_M = 450.0
FIRST_SEED = 80
PIXELS = (25, 150)
LIGHTS: Mapping[str, str] = {
    "in other light": "street",
    "in low sun": "street, low sun",
    "at noon": "street, noon",
}
#: further drives of a map, by what it is called
LEARNT: Mapping[str, tuple[str, ...]] = {
    "one drive": (),
    "and one at noon": ("at noon",),
    "and one at noon, one in low sun": ("at noon", "in low sun"),
}


class Street(NamedTuple):
    """The drive that a map is made of, one per light to learn, and one per light to match."""

    reference: SimulatedRecording
    learnt: Mapping[str, SimulatedRecording]
    queries: Mapping[str, SimulatedRecording]


def open_street(seed: int) -> Street:
    """Simulate the drives of one street."""
    reference, query = simulate_pair(FIRST_SEED + seed, length_m=LENGTH_M)
    learnt, queries = (
        {
            light: second_drive(query, name, offset + i)
            for i, (light, name) in enumerate(LIGHTS.items())
        }
        for offset in (1_000, 2_000)
    )
    return Street(reference.keep(), learnt, queries)


def measure(draw: Draw) -> Iterator[Row]:
    """Learn the drives aligned in both ways, and match each map in each light."""
    street: Street = draw.pair
    for pixels in PIXELS:
        settings = PRESETS["default"].replaced({"pixels": pixels, "seed": draw.seed}, "street")
        first = ReferenceMap.build(street.reference, settings)
        learnt = {
            light: count_places(one, first.pixel_map, first.settings)
            for light, one in street.learnt.items()
        }
        queries = {
            light: MappedPair.of(first, one, truth_of_pair(street.reference, one))
            for light, one in street.queries.items()
        }
        for name, lights in LEARNT.items():
            for aligned in ("by matching", "by tracks") if lights else ("alone",):
                by_tracks = aligned == "by tracks"
                route = with_positions(first, street.reference.track) if by_tracks else first
                for light in lights:
                    track = street.learnt[light].track if by_tracks else None
                    route = learn_drive(route, learnt[light], track=track).reference
                for light, pair in queries.items():
                    for matched, by in (("live", route.causal()), ("recorded", route)):
                        yield {
                            "map": name,
                            "aligned": aligned,
                            "pixels": pixels,
                            "query": light,
                            "matched": matched,
                            "P@100R": replace(pair, reference=by).correct(),
                        }


EXPERIMENT = Experiment(
    drives=lambda data: [Drives(f"streets of {LENGTH_M:g} m", open_street, varied=True)],
    names=("map", "aligned", "pixels", "query", "matched"),
    measure=measure,
    figure=partial(dots, measures=("P@100R",), row="map", series="aligned"),
    view=TableView({"matched": "live"}, ("map", "aligned", "query", "P@100R"), "query"),
    reads_data=False,
)
