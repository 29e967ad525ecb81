"""The shipped tables of probabilities on simulated streets that they were not learnt from.

Each street is mapped once and driven in ten ways: in other lights, at other speeds, with other
thresholds of the camera, and with stops. Each drive has six
versions: as it was; with a quarter of the places cut out of the map; with a detour through another
street, as long as a quarter of the drive; with the camera carried to another part of the street and
back; backwards; and of another street altogether. Matches of a robot have the running mean of the
query, those of whole drives the drive's own mean. `learn` learns the tables on other streets, in
the same way, but with drives that change between two windows, each from the versions of
`LEARNT_FROM`. Queries of `nulls`, whose windows or pixels are shuffled, are used only for testing.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr import __version__
from edge_vpr.confidence import (
    DEFAULT_TABLES,
    LIVE,
    LIVE_ON_MAP,
    SMOOTHED,
    TABLES,
    Confidence,
    default_confidence,
)
from edge_vpr.descriptors.counting import count_windows
from edge_vpr.descriptors.windows import Descriptors, overlapping
from edge_vpr.evaluation.calibration import learn_confidence, reliability
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import evaluate_rejection
from edge_vpr.files import replacing
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import QUERY, REFERENCE, Light, SimulatedRecording, simulate_pair
from lab.drives import STREETS, Second, second_drive
from lab.loop import Draw, Drives, Experiment, Row
from lab.nulls import null_queries
from lab.pairs import MappedPair, truth_of_tracks
from lab.tables import TableView

# Drives that leave the map: pieces cut out of a map, a jump, and windows of another street.


@dataclass(frozen=True, eq=False)
class Spliced(MappedPair):
    """Map, and a drive that was put together from pieces."""

    #: Shape (n,): whether the drive changes within a window, which then shows both sides.
    changes: npt.NDArray[np.bool_]


def without_places(pair: MappedPair, first: int, last: int) -> MappedPair:
    """Remove the places from `first` up to, but without, `last` from the map."""
    kept = np.ones(len(pair.reference), dtype=np.bool_)
    kept[first:last] = False
    reference = replace(pair.reference, places=pair.reference.places.take(kept))
    truth = GroundTruth(pair.truth.correct[kept], pair.truth.has_truth, "part of the map")
    return MappedPair(reference, pair.counted, truth)


def carried_off(pair: MappedPair, first: int, last: int, parts: int = 1) -> Spliced:
    """Reorder a drive: up to part `first`, then from `last` on, then the parts between.

    Parameters
    ----------
    parts : int
        How many parts of the drive are a window, see `spliced`.
    """
    every = np.arange(len(pair.counted))
    return spliced(pair, np.r_[every[:first], every[last:], every[first:last]], parts)


def with_detour(pair: MappedPair, elsewhere: Descriptors, at: int, parts: int = 1) -> Spliced:
    """Insert the parts of another drive before part `at`; no place is correct for them."""
    n, more = len(pair.counted), len(elsewhere)
    columns = {
        name: np.concatenate([column, elsewhere.to_arrays()[name]])
        for name, column in pair.counted.to_arrays().items()
    }
    nowhere = np.zeros((len(pair.reference), more), dtype=np.bool_)
    truth = GroundTruth(
        np.concatenate([pair.truth.correct, nowhere], axis=1),
        np.concatenate([pair.truth.has_truth, np.ones(more, dtype=np.bool_)]),
        "with a detour",
    )
    joined = MappedPair(pair.reference, Descriptors(**columns), truth)
    return spliced(joined, np.r_[0:at, n : n + more, at:n], parts)


def spliced(pair: MappedPair, order: npt.NDArray[np.int64], parts: int = 1) -> Spliced:
    """Put a drive together from its parts, and make windows of them.

    Parameters
    ----------
    pair : MappedPair
        Map, and the parts of a drive, each with the truth of the window that ends with it.
    order : ndarray of int64, shape (n,)
        Part of the drive that comes at each time.
    parts : int
        How many parts are a window.

    Returns
    -------
    Spliced
        The truth of a window is that of its last part: where the robot is then.
    """
    order = order[: len(order) // parts * parts]
    last, has_place = order[parts - 1 :: parts], pair.truth.has_place[order]
    follows = (np.diff(order) == 1) & (has_place[1:] == has_place[:-1])
    changes = np.asarray(~np.append(False, follows).reshape(-1, parts)[:, 1:].all(axis=1))
    counted = overlapping(pair.counted.take(order), parts).take(slice(None, None, parts))
    if (np.diff(order) != 1).any():  # the windows follow one another without gaps
        step = counted.window_us
        start = np.arange(len(counted), dtype=np.int64) * step
        counted = replace(counted, start_us=start, end_us=start + step)
    truth = GroundTruth(pair.truth.correct[:, last], pair.truth.has_truth[last], "spliced")
    return Spliced(pair.reference, counted, truth, changes)


# Streets, their drives, and the versions of each drive.


#: streets from here on are those on which the rules of the filter were chosen, too; those of the
#: evaluation chose nothing
FIRST_SEED, FIRST_UNSEEN = 20, 1_000
#: Trust compares the best place with those outside the exclusion zone of 3 windows, so that it
#: can only indicate larger errors: a little over 3 windows of a second at 6 m/s.
TOLERANCE_M = 20.0
PIXELS = (25, 150)
WINDOWS = ("time", "count")
QUERIES: dict[str, Second] = {
    "half to double speed, other light": Second(QUERY),
    "the same light": Second(
        replace(REFERENCE, speed_range=1.3, traffic_per_km=8.0, lateral_m=-0.2, yaw_deg=-0.5)
    ),
    "faster, with halts, at dusk": Second(
        replace(
            QUERY,
            speed_mps=8.0,
            speed_range=1.5,
            stops=2,
            light=Light(sun=0.1, ambient=0.5, azimuth_deg=150.0, elevation_deg=15.0, glare=0.1),
        )
    ),
    **{
        kind: STREETS[f"street, {kind}"]
        for kind in ("low sun", "half speed", "quarter speed", "double speed", "thresholds x 2",
                     "thresholds x 0.5", "3 stops of 2 min")
    },
}  # fmt: skip
_ELSEWHERE = "the same light"
_CUTS = 7  # random stream that decides where drives are cut
#: parts of a window between which drives are spliced where the tables are judged: a robot may be
#: carried off, or leave the map, at any time
PARTS = 4


class Street(NamedTuple):
    """Reference drive of a simulated street, and drives by the names of `QUERIES`."""

    seed: int
    reference: SimulatedRecording
    drives: Mapping[str, SimulatedRecording]


def open_street(seed: int) -> Street:
    """Simulate the drives of a street."""
    reference, query = simulate_pair(seed)
    drives = {name: second_drive(query, second) for name, second in QUERIES.items()}
    return Street(seed, reference.keep(), drives)


def driven(
    street: Street, elsewhere: SimulatedRecording, parts: int = 1, **changes: Any
) -> Iterator[tuple[MappedPair, Descriptors]]:
    """Map a street and count its drives, with each number of pixels and kind of window.

    Drives are counted in parts of windows, so many in a window, each with the truth of the window
    that ends with it. With each drive come the counts of a drive of another street at the same
    pixels. `changes` are settings that differ from the default.
    """
    for pixels in PIXELS:
        for window in WINDOWS:
            chosen = {
                "pixels": pixels,
                "window": window,
                "events_per_pixel": None,
                "seed": street.seed,
                **changes,
            }
            settings = PRESETS["default"].replaced(chosen, "calibration")
            mapped = ReferenceMap.build(street.reference, settings)
            counted = partial(_in_parts, mapped, parts)
            away = counted(elsewhere)
            for drive in street.drives.values():
                some = counted(drive)
                first_us = some.start_us[np.maximum(np.arange(len(some)) - parts + 1, 0)]
                centre_us = first_us + (some.end_us - first_us) // 2
                truth_of = truth_of_tracks(street.reference.track, drive.track, TOLERANCE_M)
                truth = truth_of(mapped.places.centre_us, centre_us)
                yield MappedPair(mapped, some, truth), away


def _in_parts(mapped: ReferenceMap, parts: int, drive: SimulatedRecording) -> Descriptors:
    """Count a drive in parts of windows, so many in a window."""
    settings = mapped.settings
    part: dict[str, Any] = {"places_per_window": 1, "tau_us": settings.tau_us // parts}
    if settings.events_per_pixel is not None:
        part["events_per_pixel"] = settings.events_per_pixel / parts
    return count_windows(drive, mapped.pixel_map, settings.replaced(part, "parts of a window"))


WHOLE, CUT, DETOUR, CARRIED = "whole", "a piece cut out", "a detour", "carried off twice"
BACKWARDS, ANOTHER = "backwards", "another route"
#: row of all of these together, and of those with each kind of windows
POOLED = "all six"
POOLED_BY = {
    "time": "all six, windows of a fixed time", "count": "all six, windows of a fixed number",
}  # fmt: skip


def versions_of(
    pair: MappedPair, elsewhere: Descriptors, rng: np.random.Generator, parts: int = 1
) -> dict[str, MappedPair]:
    """Return the versions of a drive by name, in whole windows.

    Parameters
    ----------
    pair : MappedPair
        Map, and the drive in parts of windows, see `driven`.
    elsewhere : Descriptors
        Parts of a drive of another street.
    rng : Generator
        Decides where the map and the drive are cut.
    parts : int
        How many parts are a window.
    """
    places, n = len(pair.reference), len(pair.counted)
    in_order = np.arange(n)
    first = int(rng.integers(0, 3 * places // 4))
    part_of_map = without_places(pair, first, first + places // 4)
    whole = spliced(pair, in_order, parts)
    cut = spliced(part_of_map, in_order, parts)
    length = min(n // 4, len(elsewhere))
    start = int(rng.integers(0, len(elsewhere) - length + 1))
    away = elsewhere.take(np.arange(start, start + length))
    return {
        WHOLE: whole,
        CUT: cut,
        DETOUR: with_detour(pair, away, int(rng.integers(parts, n)), parts),
        CARRIED: carried_off(pair, n // 3, 2 * n // 3, parts),
        BACKWARDS: spliced(whole, np.arange(len(whole.counted))[::-1]),
        ANOTHER: of_another_route(pair, elsewhere, parts),
    }


def of_another_route(pair: MappedPair, elsewhere: Descriptors, parts: int = 1) -> MappedPair:
    """Return the map of a pair with a drive of another route, of so many parts in a window."""
    nowhere = np.zeros((len(pair.reference), len(elsewhere)), dtype=np.bool_)
    judged = np.ones(len(elsewhere), dtype=np.bool_)
    away = MappedPair(pair.reference, elsewhere, GroundTruth(nowhere, judged, ANOTHER))
    return spliced(away, np.arange(len(elsewhere)), parts)


def scrambled(pair: MappedPair, rng: np.random.Generator) -> dict[str, MappedPair]:
    """Return the null queries of a pair by name; what is correct of them, is by chance."""
    queries = null_queries(pair.counted, rng)
    return {name: replace(pair, counted=shown) for name, shown in queries}


# Matches of known truth, by the settings that each table is for.


#: settings of the matches that each table is for
MATCHINGS: Mapping[str, Mapping[str, Any]] = {
    LIVE: {"smooth": False},
    SMOOTHED: {"smooth": True},
}
#: Versions that each table is learnt from. Smoothing continues a path over the edge of the map, and
#: is hardly ever wrong on a drive along it: with such drives, the promise of a precision would fail
#: for those that leave the map.
LEARNT_FROM: Mapping[str, tuple[str, ...]] = {
    LIVE: (WHOLE, CUT, DETOUR, CARRIED, BACKWARDS, ANOTHER),
    SMOOTHED: (CUT, DETOUR, BACKWARDS, ANOTHER),
    LIVE_ON_MAP: (WHOLE,),
}


class Sample(NamedTuple):
    """Matches of known truth: net trust (n,) int64, correct (n,) and has_place (n,) bool.

    `changes` (n,) bool is of windows in which the drive changes; see `Spliced`.
    """

    trust: npt.NDArray[np.int64]
    correct: npt.NDArray[np.bool_]
    has_place: npt.NDArray[np.bool_]
    changes: npt.NDArray[np.bool_]


def sample(pair: MappedPair, first: int = 0, last: int | None = None) -> Sample:
    """Match a pair, and return the matches whose truth is known, of windows `first` to `last`."""
    matches = pair.match()
    judged = pair.truth.judged(matches.place, matches.query) & (matches.query >= first)
    if last is not None:
        judged &= matches.query < last
    correct = pair.truth.correct[matches.place, matches.query]
    has_place = pair.truth.has_place[matches.query]
    changes = np.zeros(judged.size, dtype=np.bool_)
    if isinstance(pair, Spliced):
        changes = pair.changes[matches.query]
    return Sample(matches.net_trust[judged], correct[judged], has_place[judged], changes[judged])


def joined(samples: Sequence[Sample]) -> Sample:
    """Concatenate samples."""
    return Sample(*(np.concatenate(column) for column in zip(*samples, strict=True)))


# Learn the tables.


def learn(seeds: int, folder: Path, on_start: Callable[[str], None]) -> None:
    """Learn the tables on simulated streets, and write them in the package's format, atomically.

    Places are at whole windows: these tables hold for places at half windows too, and not the other
    way round.
    """
    streets = []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        on_start(f"street {seed - FIRST_SEED + 1} of {seeds}")
        streets.append(samples_of(seed))
    write_tables(streets, folder)


def samples_of(seed: int) -> dict[str, Sample]:
    """Return the matches of all drives of a street, for each table."""
    rng = np.random.default_rng((_CUTS, seed))
    samples: dict[str, list[Sample]] = {name: [] for name in LEARNT_FROM}
    for pair, elsewhere in driven(open_street(seed), drive_elsewhere(seed), places_per_window=1):
        for version, changed in versions_of(pair, elsewhere, rng).items():
            matched = {
                matching: sample(changed.with_settings(changes))
                for matching, changes in MATCHINGS.items()
            }
            matched[LIVE_ON_MAP] = matched[LIVE]
            for name, versions in LEARNT_FROM.items():
                if version in versions:
                    samples[name].append(matched[name])
    return {name: joined(some) for name, some in samples.items()}


def drive_elsewhere(seed: int) -> SimulatedRecording:
    """Simulate a drive of the street before, which is another one."""
    _, query = simulate_pair(seed - 1)
    return second_drive(query, QUERIES[_ELSEWHERE])


def write_tables(streets: Sequence[dict[str, Sample]], folder: Path) -> None:
    """Write the tables that are learnt from the matches of some streets."""
    seeds = len(streets)
    samples = {name: joined([street[name] for street in streets]) for name in streets[0]}
    made = {
        "made_by": f"python -m lab calibration --seeds {seeds} --table DIR",
        "version": __version__,
        "street_seeds": [FIRST_SEED, FIRST_SEED + seeds - 1],
        TABLES: {name: _table(samples[name]) for name in MATCHINGS},
        LIVE_ON_MAP: _table(samples[LIVE_ON_MAP]),
    }
    with replacing(folder / DEFAULT_TABLES) as temporary:
        temporary.write_text(json.dumps(made, allow_nan=False) + "\n", encoding="utf-8")


def _table(learnt: Sample) -> dict[str, object]:
    """Return what the file holds of the table that is learnt from these matches."""
    confidence = learn_confidence(learnt.trust, learnt.correct)
    return {
        "right": round(float(learnt.correct.mean()), 4),
        "off_map": round(float(1 - learnt.has_place.mean()), 4),
        "trust": confidence.trust.tolist(),
        "probability": [round(p, 6) for p in confidence.probability.tolist()],
        "matches": confidence.matches.tolist(),
    }


def learnt_seeds() -> tuple[int, int]:
    """Return the seeds of the first and of the last street that the shipped tables are from."""
    text = files("edge_vpr").joinpath(DEFAULT_TABLES).read_text(encoding="utf-8")
    first, last = json.loads(text)["street_seeds"]
    return int(first), int(last)


# Evaluate the shipped tables.


PRECISION = 0.99
#: column of the share of accepted matches that are correct, without those of windows in which the
#: drive leaves the map, comes back or jumps
PRECISION_SEEN = "precision from one window after a change on"
LEARNT_ON = "table learnt on"
SWITCHED_ON = "switched on in mid-route"
#: ends the names of columns of the tables for robots that stay on the map
STAYS_ON_MAP = " (stays on map)"
#: columns that the table has no effect on
_OF_MATCHES = (
    "windows", "correct", "correct of those on the map", "found at 99 % precision",
    "AUROC off the map", "starts", "starts with a match correct",
    "median time to the first correct (s)",
)  # fmt: skip
#: columns that name a row of the tables of this experiment and of `trust`
NAMES = ("map", "matching", LEARNT_ON)
#: windows between two starts in mid-route, and most windows after a start
START_EVERY, MOST = 10, 120
#: least number of windows from a start to the end of the drive
_LEFT = 20


def evaluate_tables(
    versions: Mapping[str, Sequence[MappedPair]],
    matchings: Sequence[str],
    switched_on: Sequence[str],
    pooled: Sequence[str] = (),
) -> Iterator[Row]:
    """Evaluate the shipped tables on drives whose truth is known.

    Parameters
    ----------
    versions : mapping of str to sequence of MappedPair
        Drives by version; those of one version are evaluated together.
    matchings : sequence of str
        Of `MATCHINGS`.
    switched_on : sequence of str
        Those by which whole drives are also matched from the middle of the route on.
    pooled : sequence of str
        Versions that are evaluated together too, in further rows: all, and by kind of windows.
    """
    learnt_on = "streets of seeds {} to {}".format(*learnt_seeds())
    for name in matchings:
        table, on_map = (default_confidence(name == SMOOTHED, stays) for stays in (False, True))
        together: dict[str, list[Sample]] = {POOLED: []}
        for version, pairs in versions.items():
            changed = [pair.with_settings(MATCHINGS[name]) for pair in pairs]
            row = {"map": version, "matching": name, LEARNT_ON: learnt_on}
            samples = [sample(pair) for pair in changed]
            if version in pooled:
                together[POOLED] += samples
                for pair, one in zip(pairs, samples, strict=True):
                    together.setdefault(POOLED_BY[pair.reference.settings.window], []).append(one)
            stays = _if_on_map(figures_of_table(on_map, samples)) if name == LIVE else {}
            yield {**row, **figures_of_table(table, samples), **stays}
            if version == WHOLE and name in switched_on:
                row["map"] = SWITCHED_ON
                first = partial(first_matches, changed)
                stays = _if_on_map(first(partial(_accepted, on_map))) if name == LIVE else {}
                yield {**row, **first(partial(_accepted, table)), **stays}
        for kind, samples in together.items() if pooled else ():
            row = {"map": kind, "matching": name, LEARNT_ON: learnt_on}
            yield {**row, **figures_of_table(table, samples)}


def _accepted(table: Confidence, matches: Matches) -> npt.NDArray[np.bool_]:
    return np.asarray(matches.net_trust >= table.least_trust(PRECISION))


def _if_on_map(measured: Row) -> Row:
    """Return what the table has an effect on, in columns for robots that stay on the map."""
    return {
        name + STAYS_ON_MAP: value for name, value in measured.items() if name not in _OF_MATCHES
    }


def figures_of_table(table: Confidence, samples: Sequence[Sample]) -> dict[str, float | int | None]:
    """Return what a table says of some drives, each in the order of time, and what is true."""
    pooled = joined(samples)
    probability = table.probability_of(pooled.trust)
    least = table.least_trust(PRECISION)
    accepted = pooled.trust >= least
    counts = evaluate_rejection(pooled.trust, pooled.correct, pooled.has_place, accepted)
    seen: dict[str, float | None] = {}
    if pooled.changes.any():
        late = accepted & ~pooled.changes
        seen[PRECISION_SEEN] = float(pooled.correct[late].mean()) if late.any() else None
    left = windows_past_the_edge(samples, least)
    off_map = accepted[~pooled.has_place]
    return {
        "windows": pooled.trust.size,
        "correct": float(pooled.correct.mean()),
        "correct of those on the map": counts.right_on_map,
        "mean probability": float(probability.mean()),
        "calibration error": reliability(probability, pooled.correct).expected_calibration_error,
        "accepted at 0.99": float(accepted.mean()),
        "precision": counts.precision,
        **seen,
        "recall": counts.recall,
        "found at 99 % precision": counts.found_at_99_precision,
        "AUROC off the map": counts.off_map_auroc,
        "accepted off the map": float(off_map.mean()) if off_map.size else None,
        "windows accepted after leaving the map": float(np.mean(left)) if left else None,
        "most windows accepted after leaving": max(left, default=None),
    }


def windows_past_the_edge(samples: Sequence[Sample], least: int) -> list[int]:
    """Return how long matches are still accepted after a drive has left the map.

    Returns
    -------
    list of int
        Number of accepted matches in a row, each time that a drive leaves the map from an accepted
        match.
    """
    lasted = []
    for trust, _, has_place, _ in samples:
        accepted = trust >= least
        for j in np.flatnonzero(has_place[:-1] & ~has_place[1:] & accepted[:-1]) + 1:
            last = accepted[j:] & ~has_place[j:]
            lasted.append(int(np.argmin(last)) if not last.all() else last.size)
    return lasted


def first_matches(
    pairs: Sequence[MappedPair], accepted: Callable[[Matches], npt.NDArray[np.bool_]]
) -> dict[str, float | int | None]:
    """Switch on at many windows, and measure the time to the first correct and accepted matches.

    The time to the first correct match is the measure of Flash [1]_. Both times end with the window
    of the match, and their medians are over all starts: None, if fewer than half of them have such
    a match within `MOST` windows and before the end of the drive.

    Parameters
    ----------
    accepted : callable
        Which matches are accepted.

    References
    ----------
    .. [1] V. Ramanathan, M. Milford, T. Fischer, "Prepare for Warp Speed: Sub-millisecond Visual
       Place Recognition Using Event Cameras", arXiv:2509.24094.
    """
    correct_s: list[float] = []
    accepted_s: list[float] = []
    accepted_rightly: list[bool] = []
    for pair in pairs:
        windows = len(pair.counted)
        for start in range(0, windows - _LEFT, START_EVERY):
            if not pair.truth.has_truth[start]:
                continue
            part = slice(start, min(start + MOST, windows))
            rest = replace(pair, counted=pair.counted.take(part))
            matches = rest.match()
            seconds = (rest.counted.end_us - rest.counted.start_us[0]) / 1e6
            correct = pair.truth.correct[matches.place, start + matches.query]
            shown = accepted(matches)
            for times, reached in ((correct_s, correct), (accepted_s, shown)):
                times.append(float(seconds[np.argmax(reached)]) if reached.any() else np.inf)
            if shown.any():
                accepted_rightly.append(bool(correct[np.argmax(shown)]))
    return {
        "starts": len(correct_s),
        **_time_to("correct", correct_s),
        **_time_to("accepted", accepted_s),
        "correct of the first accepted": mean_of(accepted_rightly),
    }


def _time_to(name: str, seconds: Sequence[float]) -> dict[str, float | None]:
    """Return the share of the starts that have such a match, and the median time to it."""
    reached = mean_of(np.isfinite(seconds))
    late = reached is None or reached <= 0.5
    return {
        f"starts with a match {name}": reached,
        f"median time to the first {name} (s)": None if late else float(np.median(seconds)),
    }


def mean_of(values: Sequence[bool] | npt.NDArray[np.bool_]) -> float | None:
    """Return the share of true values; None of none."""
    return float(np.mean(values)) if len(values) else None


def unseen_street(seed: int) -> dict[str, list[MappedPair]]:
    """Open the versions of all drives of a street that no table was learnt from."""
    street_seed = FIRST_UNSEEN + seed
    rng = np.random.default_rng((_CUTS, street_seed))
    versions_by_name: dict[str, list[MappedPair]] = {}
    for pair, elsewhere in driven(open_street(street_seed), drive_elsewhere(street_seed), PARTS):
        versions = versions_of(pair, elsewhere, rng, PARTS)
        for name, version in (versions | scrambled(versions[WHOLE], rng)).items():
            versions_by_name.setdefault(name, []).append(version)
    return versions_by_name


def measure(draw: Draw) -> Iterator[Row]:
    """Evaluate every table on all drives of one street."""
    yield from evaluate_tables(draw.pair, list(MATCHINGS), (LIVE,), LEARNT_FROM[LIVE])


EXPERIMENT = Experiment(
    drives=lambda data: [Drives("simulated streets", unseen_street, varied=True)],
    names=NAMES,
    measure=measure,
    view=TableView({}, ("map", "matching", "correct of those on the map", "accepted at 0.99",
                        "precision", "calibration error", "accepted at 0.99" + STAYS_ON_MAP,
                        "precision" + STAYS_ON_MAP)),
    reads_data=False,
)  # fmt: skip
