"""Maps of one drive and of several, in the same light and in others.

The map of a simulated street is made of a drive in the sun. One or two more drives in other light
are learnt, aligned by matching or by their tracks; a further drive in each light tests the map.
Nothing was chosen on these streets. In Brisbane, the map of half a drive by day learns a sunset,
and another sunset tests it where the map shows its places. Aligned by matching, that sunset is
refused: it shows too little of the route.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge_vpr.descriptors.counting import count_places
from edge_vpr.descriptors.published import PublishedWindows, WindowSource
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.evaluation.tracks import Track, with_positions
from edge_vpr.learning import learn_drive
from edge_vpr.recordings.reading import EventSource
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS, Settings
from edge_vpr.simulation import simulate_pair
from lab.drives import BRISBANE, BRISBANE_M, DAY, LENGTH_M, STREETS, second_drive
from lab.loop import Draw, Drives, Experiment, Row
from lab.pairs import TOLERANCE_M, MappedPair, truth_of_tracks
from lab.tables import TableView

FIRST_SEED = 80
PIXELS = (25, 150)
LIGHTS: Mapping[str, str] = {
    "in other light": "street",
    "in low sun": "street, low sun",
    "at noon": "street, noon",
}
MATCHING, TRACKS = "by matching", "by tracks"


class Logged(NamedTuple):
    """A drive and its track."""

    drive: EventSource | WindowSource
    track: Track


class Drive(NamedTuple):
    """The drives of a route: one that a map is made of, some to learn, and some to match.

    `maps` names the drives that each map learns, and `alignments` the ways to align them.
    """

    settings: tuple[Settings, ...]
    reference: Logged
    learnt: Mapping[str, Logged]
    queries: Mapping[str, Logged]
    maps: Mapping[str, tuple[str, ...]]
    alignments: tuple[str, ...]
    tolerance_m: float


def open_street(seed: int) -> Drive:
    """Simulate the drives of one street."""
    reference, query = simulate_pair(FIRST_SEED + seed, length_m=LENGTH_M)
    learnt, queries = (
        {
            light: Logged(one := second_drive(query, STREETS[name], offset + i), one.track)
            for i, (light, name) in enumerate(LIGHTS.items())
        }
        for offset in (1_000, 2_000)
    )
    maps: Mapping[str, tuple[str, ...]] = {
        "one drive": (),
        "and one at noon": ("at noon",),
        "and one at noon, one in low sun": ("at noon", "in low sun"),
    }
    settings = tuple(
        PRESETS["default"].replaced({"pixels": pixels, "seed": seed}, "street") for pixels in PIXELS
    )
    first = Logged(reference.keep(), reference.track)
    return Drive(settings, first, learnt, queries, maps, (MATCHING, TRACKS), TOLERANCE_M)


def open_brisbane(data: Path, seed: int) -> Drive:
    """Open the drives of Brisbane, the first half of one by day and two at sunset."""
    sunset, again, by_day = (
        Logged(PublishedWindows(data / f"{name}.npz"), load_track(data / f"{name}.nmea"))
        for name in (f"{BRISBANE}/sunset2", f"{BRISBANE}/sunset1", f"{DAY}/daytime_first_half")
    )
    changes = {"pixels": 49, "strategy": "top"}
    return Drive(
        (PRESETS["default"].replaced(changes, "Brisbane"),),
        by_day,
        {"at sunset": sunset},
        {"at sunset": again},
        {"half a drive by day": (), "and one at sunset": ("at sunset",)},
        (TRACKS,),
        BRISBANE_M[0],
    )


def drives(data: Path | None) -> list[Drives]:
    """Return the streets, and the drives of Brisbane if they are in a folder."""
    routes = [Drives(f"streets of {LENGTH_M:g} m", open_street, varied=True)]
    folders = [data / name for name in (BRISBANE, DAY)] if data is not None else []
    if data is not None and all(folder.is_dir() for folder in folders):
        opened = partial(open_brisbane, data)
        routes.append(Drives("Brisbane, 49 px", opened, drawn=False))
    return routes


def measure(draw: Draw) -> Iterator[Row]:
    """Learn the drives aligned in both ways, and match each map in each light."""
    drive: Drive = draw.pair
    for settings in drive.settings:
        first = ReferenceMap.build(drive.reference.drive, settings)
        learnt = {
            light: count_places(one.drive, first.pixel_map, first.settings)
            for light, one in drive.learnt.items()
        }

        truth_of = partial(truth_of_tracks, drive.reference.track, tolerance_m=drive.tolerance_m)
        queries = {
            light: _on_the_map(MappedPair.of(first, one.drive, truth_of(one.track)))
            for light, one in drive.queries.items()
        }
        for name, lights in drive.maps.items():
            for aligned in drive.alignments if lights else ("alone",):
                by_tracks = aligned == TRACKS
                route = with_positions(first, drive.reference.track) if by_tracks else first
                shares: Row = {}
                for light in lights:
                    track = drive.learnt[light].track if by_tracks else None
                    update = learn_drive(route, learnt[light], track=track, same_route=True)
                    truth = truth_of(drive.learnt[light].track)(
                        first.places.centre_us, learnt[light].centre_us
                    )
                    k = np.flatnonzero(update.aligned & truth.has_truth)
                    shares = {
                        "aligned of the last drive learnt": float(update.aligned.mean()),
                        "of these right": float(truth.correct[update.place[k], k].mean()),
                    }
                    route = update.reference
                for light, pair in queries.items():
                    for matched, by in (("live", route.causal()), ("recorded", route)):
                        yield {
                            "map": name,
                            "aligned": aligned,
                            "pixels": settings.pixels,
                            "query": light,
                            "matched": matched,
                            "P@100R": replace(pair, reference=by).correct(),
                            **shares,
                        }


def _on_the_map(pair: MappedPair) -> MappedPair:
    """Leave windows that the map shows no place of out of what is judged."""
    truth = pair.truth
    return replace(pair, truth=replace(truth, has_truth=truth.has_truth & truth.has_place))


EXPERIMENT = Experiment(
    drives=drives,
    names=("map", "aligned", "pixels", "query", "matched"),
    measure=measure,
    view=TableView({"matched": "live"}, ("map", "aligned", "query", "P@100R"), "query"),
)
