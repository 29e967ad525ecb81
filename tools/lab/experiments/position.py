"""Where a live session says that the robot is, against where it is.

Positions are those of the accepted matches: of the matched place, and as a live session reports
them (`PathPosition`). Streets are matched every 50 ms; of the drives of Brisbane, whose windows
were published, at the end of each window, against the GPS. The constants of the position were
chosen on streets of seeds below 200.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.counting import cleaned
from edge_vpr.descriptors.published import WindowSource
from edge_vpr.evaluation.tracks import Track, distances, with_positions
from edge_vpr.live.position import Locator, PathPosition
from edge_vpr.recordings.reading import EventSource
from edge_vpr.reference_map import ReferenceMap
from lab.drives import fullest_drives, street_pairs
from lab.loop import Draw, Drives, Experiment, Row
from lab.pairs import Pair
from lab.tables import TableView

LENGTH_M = 600.0
FIRST_SEED = 300
PIXELS = (25, 150)
LIGHTS: Mapping[str, str] = {"in other light": "street", "in low sun": "street, low sun"}
PRECISION = 0.99
EVERY = "50ms"
OF_PLACE, REPORTED = "middle of the matched place", "reported"


class Live(NamedTuple):
    """Live matches, shape (n,): the window of each, its place, and whether it is accepted."""

    start_us: npt.NDArray[np.int64]
    end_us: npt.NDArray[np.int64]
    place: npt.NDArray[np.int64]
    accepted: npt.NDArray[np.bool_]


def open_street(seed: int) -> list[Pair]:
    """Simulate the drives of one street, each matched at some numbers of pixels."""
    return [
        replace(pair, settings=pair.settings.replaced({"pixels": pixels}, "street"))
        for pair in street_pairs(FIRST_SEED + seed, LIGHTS, length_m=LENGTH_M)
        for pixels in PIXELS
    ]


def measure(draw: Draw) -> Iterator[Row]:
    """Match each drive live, and compare the positions of accepted matches with the track."""
    pairs: list[Pair] = draw.pair
    for pair in pairs:
        assert pair.tracks is not None
        built = ReferenceMap.build(pair.reference, pair.default(draw.seed, precision=PRECISION))
        mapped = with_positions(built, pair.tracks.reference)
        live = live_matches(mapped, pair.query)
        for name, row in positions_of(mapped, live, pair.tracks.query).items():
            named = {"pixels": pair.settings.pixels, "query": pair.drives, "position": name}
            yield {**named, **row}


def live_matches(mapped: ReferenceMap, drive: EventSource | WindowSource) -> Live:
    """Match a drive live: every 50 ms, or its published windows."""
    if isinstance(drive, WindowSource):
        causal = mapped.causal()
        matches = causal.match(drive).matches
        window = np.full(len(matches), drive.window_us, dtype=np.int64)
        end_us = matches.time_us + window // 2
        return Live(end_us - window, end_us, matches.place, ~matches.lost)
    localiser = mapped.localiser(EVERY)
    rows = np.concatenate([localiser.update(events) for events in cleaned(drive, mapped.settings)])
    start_us, end_us, place = (
        rows[name].astype(np.int64) for name in ("start_us", "time_us", "place")
    )
    return Live(start_us, end_us, place, ~rows["lost"].astype(np.bool_))


def positions_of(mapped: ReferenceMap, live: Live, track: Track) -> dict[str, Row]:
    """Return the errors of positions by name, of the accepted matches."""
    path, locator = PathPosition(mapped.settings), Locator(mapped)
    at: dict[str, list[float]] = {OF_PLACE: live.place.astype(np.float64).tolist(), REPORTED: []}
    jumps = []
    windows = zip(live.end_us.tolist(), (live.end_us - live.start_us).tolist(), strict=True)
    for (end_us, window_us), place in zip(windows, live.place.tolist(), strict=True):
        at[REPORTED].append(path.update(end_us, window_us, place))
        jumps.append(path.jumps)
    true = track.at(live.end_us)
    judged = live.accepted & np.isfinite(true).all(axis=1)
    follows = judged[1:] & judged[:-1] & (np.diff(jumps) == 0)
    km = _length_m(track, true[judged]) / 1e3
    rows: dict[str, Row] = {}
    for name, places in at.items():
        located = np.array([_coordinates(locator.locate(one), track) for one in places])
        error = distances(track.kind, located, true)[judged]
        back = int((follows & (np.diff(places) <= -1)).sum())
        rows[name] = {
            "matches": live.accepted.size,
            "accepted at 0.99": float(live.accepted.mean()),
            "median error (m)": float(np.nanmedian(error)) if error.size else None,
            "95 % of the errors (m)": float(np.nanquantile(error, 0.95)) if error.size else None,
            "steps back": back,
            "kilometres": km,
            "steps back per km": back / km if km else None,
        }
    return rows


def _coordinates(located: dict[str, float | None], track: Track) -> list[float]:
    """Return a position as the track has it; NaN where it is not known."""
    names = ("latitude", "longitude") if track.kind == "geographic" else ("x_m", "y_m", "z_m")
    values = [located[name] for name in names[: track.position.shape[1]]]
    return [np.nan if value is None else value for value in values]


def _length_m(track: Track, positions: npt.NDArray[np.float64]) -> float:
    """Return the length of the way from position to position, in metres."""
    return float(distances(track.kind, positions[1:], positions[:-1]).sum())


def drives(data: Path | None) -> list[Drives]:
    """Return streets, and the recorded drives of a folder whose tracks are known."""
    declared = [Drives(f"streets of {LENGTH_M:g} m", open_street, varied=True)]
    for each in fullest_drives(data) if data is not None else []:
        if each.name.startswith("Brisbane"):
            declared.append(Drives(each.name, partial(_opened, each), drawn=each.drawn))
    return declared


def _opened(each: Drives, seed: int) -> list[Pair]:
    return [replace(each.open(seed), drives="as recorded")]


EXPERIMENT = Experiment(
    drives=drives,
    names=("pixels", "query", "position"),
    measure=measure,
    view=TableView(
        {}, ("pixels", "query", "position", "median error (m)", "95 % of the errors (m)",
             "steps back per km"),
    ),
)  # fmt: skip
