"""What a speed, a camera, a light or a fault does to the matches: a trouble is a row.

Each street is mapped once at 150 pixels, with places at half windows, and driven again under each
trouble: simulated with the events of a whole camera, or put into the counts of its windows. No
parameter was chosen on these streets. Each map is also tried on drives through other streets, the
same for all maps. A match is correct within 10 m; trust promises 20 m, and so accepted matches are
judged by both where a window is some 6 m.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.counting import count_windows
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import narrow
from edge_vpr.drive_inputs import opened
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.events import Events, join_events
from edge_vpr.map_making import fitting_window
from edge_vpr.matching.matches import Matches
from edge_vpr.odometry import Odometry
from edge_vpr.recordings.reading import EventSource
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS, Settings
from edge_vpr.simulation import simulate_pair
from edge_vpr.simulation.drive import QUERY, REFERENCE, wheel_odometry
from lab.drives import STREETS, second_drive
from lab.first_matches import first_matches
from lab.loop import Draw, Drives, Experiment, Row
from lab.pairs import TOLERANCE_M, TRUSTED_M, MappedPair, Tracks, rates, truth_of_tracks
from lab.tables import TableView

FIRST_SEED = 10
PRECISION = 0.99
#: seeds of the streets that are on no map
ELSEWHERE = range(200, 240)
TROUBLE, GAINS, MATCHING = "trouble", "gains", "matching"
TRUSTED = "right of accepted"
#: changes of the counts (n, J) of a drive at the pixels of a map
Counts = npt.NDArray[np.int64]
Change = Callable[[Counts, PixelMap, np.random.Generator], Counts]


def _hot(pixels: int) -> Change:
    def change(counts: Counts, at: PixelMap, rng: np.random.Generator) -> Counts:
        changed, hot = counts.copy(), rng.choice(counts.shape[1], pixels, replace=False)
        changed[:, hot] += rng.poisson(200, (len(counts), pixels))
        return changed

    return change


def _noise(counts: Counts, at: PixelMap, rng: np.random.Generator) -> Counts:
    return counts + rng.poisson(2, counts.shape)


def _lamp(counts: Counts, at: PixelMap, rng: np.random.Generator) -> Counts:
    upper = at.y < 0.15 * (at.y.max() + 1)
    return counts + upper * rng.poisson(20, counts.shape)


def _lost(counts: Counts, at: PixelMap, rng: np.random.Generator) -> Counts:
    return rng.binomial(counts, 0.5)


def _dead(counts: Counts, at: PixelMap, rng: np.random.Generator) -> Counts:
    changed = counts.copy()
    changed[:, rng.choice(counts.shape[1], counts.shape[1] * 3 // 10, replace=False)] = 0
    return changed


def _crossing(width: int, height: int) -> Change:
    """Return what something of this size does that crosses the image in 4 of every 10 windows.

    It hides what is behind it, and each pixel that it passes has some 40 events of its own.
    """

    def change(counts: Counts, at: PixelMap, rng: np.random.Generator) -> Counts:
        changed, per_window = counts.copy(), (at.sensor.width + width) / 4
        middle = 0.6 * at.sensor.height
        seen = max(1 - width / per_window, 0.0)
        for i in range(len(counts)):
            left = per_window * (i % 10) - width
            passed = (at.x >= left) & (at.x < left + per_window + width) & (i % 10 < 4)
            passed &= np.abs(at.y - middle) <= height / 2
            changed[i, passed] = rng.binomial(counts[i, passed], seen) + rng.poisson(
                40, passed.sum()
            )
        return changed

    return change


def _turned(pixels: PixelMap, by: int) -> PixelMap:
    """Return where the pixels of a map fall in a camera that is turned to the left.

    Those that leave the image come in on its other side, where they show something else.
    """
    turned = (pixels.x.astype(np.int64) + by) % pixels.sensor.width
    return replace(pixels, x=turned.astype(pixels.x.dtype))


def _jittered(events: Events, by_us: int, rng: np.random.Generator) -> Events:
    """Return events that come early or late, in the order of their new times."""
    times = np.maximum(events.t + rng.normal(0, by_us, events.size).astype(np.int64), 0)
    order = np.argsort(times, kind="stable")
    return Events(times[order], events.x[order], events.y[order], events.p[order])


def _with_gaps(events: Events) -> Events:
    """Return events without those of 2 s of every 10, which the stream itself shows as a gap."""
    return events[events.t // 1_000_000 % 10 >= 2]


FAULTS: Mapping[str, Change] = {
    "5 of 150 pixels are hot, 200 events/s": _hot(5),
    "20 of 150 pixels are hot, 200 events/s": _hot(20),
    "noise of 2 events/s at each pixel": _noise,
    "a lamp flickers in the upper 15 %, 20 events/s": _lamp,
    "half of the events are lost at random": _lost,
    "30 % of the pixels are dead": _dead,
    "a vehicle of 60 x 50 pixels crosses in 4 s of every 10": _crossing(60, 50),
    "a pedestrian of 12 x 40 pixels crosses in 4 s of every 10": _crossing(12, 40),
}


class Trouble(NamedTuple):
    """A second drive under one trouble, or several drives through other streets."""

    name: str
    pairs: list[MappedPair]
    tracks: Tracks | None = None  #: Where a window is some 6 m.
    odometry: Odometry | None = None


def troubled(seed: int) -> Iterator[Trouble]:
    """Map a street; yield its second drive under each trouble, and drives through other streets."""
    reference, query = simulate_pair(seed)
    route = ReferenceMap.build(reference.keep(), _settings(seed))
    for name, second in STREETS.items():
        drive = second_drive(query, second)
        tracks = Tracks(reference.track, drive.track)
        truth_of = truth_of_tracks(*tracks, TOLERANCE_M)
        pair = MappedPair.of(route, drive, truth_of)
        yield Trouble(name.removeprefix("street, "), [pair], tracks)
        if name == "street":
            counts = pair.counted.counts.astype(np.int64)
            for fault, change in FAULTS.items():
                rng = np.random.default_rng((seed, len(fault)))
                changed = change(counts, route.pixel_map, rng)
                counted = replace(
                    pair.counted, counts=narrow(changed), selected=changed.sum(axis=1)
                )
                yield Trouble(fault, [replace(pair, counted=counted)], tracks)
            turned = count_windows(drive, _turned(route.pixel_map, 2), route.settings)
            faulty = replace(pair, counted=turned)
            yield Trouble("the camera is turned by 2 pixels", [faulty], tracks)
            events = join_events(list(drive))
            late = _jittered(events, 20_000, np.random.default_rng(seed))
            for fault, sent in {
                "the events of 2 s of every 10 are lost": _with_gaps(events),
                "times of events are off by 20 ms": late,
            }.items():
                source = opened(sent, sensor=drive.sensor)
                assert isinstance(source, EventSource)
                yield Trouble(fault, [MappedPair.of(route, source, truth_of)], tracks)
    yield from _slowly(seed)
    away = [MappedPair.of(route, simulate_pair(other)[1], _nowhere) for other in ELSEWHERE]
    yield Trouble(f"{len(away)} other streets", away)


def _settings(seed: int) -> Settings:
    return PRESETS["default"].replaced({"seed": seed, "precision": PRECISION}, "robustness")


def _slowly(seed: int) -> Iterator[Trouble]:
    """Map a street at 1 m/s and drive it again as slowly, with stops; with two windows."""
    stops = replace(QUERY, speed_mps=1.0, stops=3, stop_s=10.0)
    reference, query = simulate_pair(
        seed, length_m=300.0, reference=replace(REFERENCE, speed_mps=1.0), query=stops
    )
    wheel = wheel_odometry(query.track, np.random.default_rng(seed))
    settings = _settings(seed)
    for name in ("walking pace", "walking pace, --tau auto"):
        route = ReferenceMap.build(reference.keep(), settings, track=reference.track)
        truth_of = truth_of_tracks(reference.track, query.track, TOLERANCE_M)
        pair = MappedPair.of(route, query.keep(), truth_of)
        yield Trouble(name, [pair])
        yield Trouble(f"{name}, odometry", [pair], odometry=wheel)
        settings = settings.replaced({"tau_us": fitting_window(route).tau_us}, "robustness")


def _nowhere(places: Counts, windows: Counts) -> GroundTruth:
    """Return the truth of a drive through another street: no place is correct."""
    correct = np.zeros((len(places), len(windows)), dtype=np.bool_)
    return GroundTruth(correct, np.ones(len(windows), dtype=np.bool_), "another street")


def measure(draw: Draw) -> Iterator[Row]:
    """Match live and smoothed, with seven gains, and live with one; live also in mid-route."""
    for trouble, pairs, tracks, odometry in draw.pair:
        for matching, gains in (("live", 7), ("smoothed", 7), ("live", 1)):
            changes = {"smooth": matching == "smoothed", "gains": gains}
            shown = [pair.with_settings(changes) for pair in pairs]
            matches = [pair.match(odometry) for pair in shown]
            row = {TROUBLE: trouble, MATCHING: matching, GAINS: gains}
            if len(pairs) > 1:
                row |= _accepted([~drive.lost for drive in matches])
            else:
                row |= rates(matches[0], pairs[0].truth)
                if tracks is not None:
                    row[TRUSTED] = _trusted(pairs[0], matches[0], tracks)
                if matching == "live" and odometry is None:
                    row |= first_matches(shown, lambda matches: ~matches.lost)
            yield row


def _trusted(pair: MappedPair, matches: Matches, tracks: Tracks) -> float | None:
    """Return how many of the accepted matches are within the error that trust can indicate."""
    truth_of = truth_of_tracks(*tracks, TRUSTED_M)
    truth = truth_of(pair.reference.places.centre_us, pair.counted.centre_us)
    return evaluate(matches, truth).rejection.precision


def _accepted(drives: list[npt.NDArray[np.bool_]]) -> Row:
    """Return how many matches of drives off the map are accepted: in all, and of single drives."""
    shares = [accepted.mean() for accepted in drives]
    return {
        "accepted at 0.99": np.concatenate(drives).mean(),
        "drives with a match accepted": np.mean([share > 0 for share in shares]),
        "most of a drive accepted": max(shares),
    }


EXPERIMENT = Experiment(
    drives=lambda data: [
        Drives("simulated streets", lambda seed: troubled(FIRST_SEED + seed), varied=True)
    ],
    names=(TROUBLE, MATCHING, GAINS),
    measure=measure,
    view=TableView({}, (TROUBLE, MATCHING, GAINS, "P@100R", "accepted at 0.99",
                        "correct of accepted", TRUSTED)),
    reads_data=False,
)  # fmt: skip
