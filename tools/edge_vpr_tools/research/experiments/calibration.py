"""The shipped tables of probabilities: learnt on simulated streets, judged on real drives.

Each street is mapped once and driven in three lights and speed profiles. Each drive has four
versions: as it was; with a quarter of the places cut out of the map; with a detour through another
street, as long as a quarter of the drive; and with the camera carried to another part of the street
and back. Two more streets judge the tables. Matches of a robot have the running mean of the query,
those of whole drives the drive's own mean.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr import __version__
from edge_vpr.confidence import DEFAULT_TABLES, LEARNT_DELAYS, SMOOTHED, Confidence
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.calibration import Reliability, learn_confidence, reliability
from edge_vpr.evaluation.ground_truth import GroundTruth, from_tracks
from edge_vpr.evaluation.metrics import judge_rejection
from edge_vpr.files import replacing
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.pipeline import count_windows
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import QUERY, REFERENCE, Drive, Light, SimulatedRecording, simulate_pair
from edge_vpr_tools.report.figures import reliability_diagram
from edge_vpr_tools.report.style import save
from edge_vpr_tools.report.tables import markdown_table

# Drives that leave the map: pieces cut out of a map, a jump, and windows of another street.


@dataclass(frozen=True, eq=False)
class Case:
    """Map, counts of a query, and their truth.

    Parameters
    ----------
    counted : Descriptors
        Counts of the query at the map's pixels.
    """

    reference: ReferenceMap
    counted: Descriptors
    truth: GroundTruth

    def match(self) -> Matches:
        """Match the query with the map's settings."""
        queries = self.reference.coded(self.counted)
        return match_descriptors(self.reference.places, queries, self.reference.settings)


def without_places(case: Case, first: int, last: int) -> Case:
    """Remove the places from `first` up to, but without, `last` from the map."""
    kept = np.ones(len(case.reference), dtype=np.bool_)
    kept[first:last] = False
    reference = replace(case.reference, places=case.reference.places.take(kept))
    truth = GroundTruth(case.truth.correct[kept], case.truth.known, "part of the map")
    return Case(reference, case.counted, truth)


def carried_off(case: Case, first: int, last: int) -> Case:
    """Reorder a drive: up to window `first`, then from `last` on, then the windows between."""
    windows = np.arange(len(case.counted))
    return _reordered(case, np.r_[windows[:first], windows[last:], windows[first:last]])


def with_detour(case: Case, elsewhere: Descriptors, at: int) -> Case:
    """Insert the windows of another drive before window `at`; no place is right for them."""
    n, more = len(case.counted), len(elsewhere)
    columns = {
        name: np.concatenate([column, elsewhere.to_arrays()[name]])
        for name, column in case.counted.to_arrays().items()
    }
    nowhere = np.zeros((len(case.reference), more), dtype=np.bool_)
    truth = GroundTruth(
        np.concatenate([case.truth.correct, nowhere], axis=1),
        np.concatenate([case.truth.known, np.ones(more, dtype=np.bool_)]),
        "with a detour",
    )
    joined = Case(case.reference, Descriptors(**columns), truth)
    return _reordered(joined, np.r_[0:at, n : n + more, at:n])


def _reordered(case: Case, windows: npt.NDArray[np.int64]) -> Case:
    truth = GroundTruth(case.truth.correct[:, windows], case.truth.known[windows], "spliced")
    counted = case.counted.take(windows)
    # the spliced windows follow one another without gaps
    step = int(np.median(counted.end_us - counted.start_us))
    start = np.arange(len(windows), dtype=np.int64) * step
    return Case(case.reference, replace(counted, start_us=start, end_us=start + step), truth)


# Simulated streets that the shipped table of probabilities is learnt and judged on.
#
# Each street is mapped once and driven in three lights and speed profiles.


#: these streets are not used by any other experiment
FIRST_SEED = 1_000
#: Trust compares the best place with those outside the exclusion zone of 3 places, so that it can
#: only indicate larger errors: a little over 3 places at 6 m/s and with windows of a second.
TOLERANCE_M = 20.0
PIXELS = (25, 150)
WINDOWS = ("time", "count")
QUERIES: dict[str, Drive] = {
    "half to double speed, other light": QUERY,
    "the same light": replace(
        REFERENCE, speed_range=1.3, traffic_per_km=8.0, lateral_m=-0.2, yaw_deg=-0.5
    ),
    "faster, with halts, at dusk": replace(
        QUERY,
        speed_mps=8.0,
        speed_range=1.5,
        stops=2,
        light=Light(sun=0.1, ambient=0.5, azimuth_deg=150.0, elevation_deg=15.0, glare=0.1),
    ),
}
_ELSEWHERE = "the same light"


class Street(NamedTuple):
    """Simulated street that is mapped, and one drive along it.

    Attributes
    ----------
    elsewhere : Descriptors or None
        Counts of a drive through the previous street, at the same pixels.
    """

    seed: int
    case: Case
    elsewhere: Descriptors | None


def streets(seeds: int, on_start: Callable[[str], None]) -> Iterator[Street]:
    """Simulate streets, and describe each drive with each number of pixels and kind of window."""
    before: SimulatedRecording | None = None
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        on_start(f"street {seed - FIRST_SEED + 1} of {seeds}")
        drives: dict[str, SimulatedRecording] = {}
        reference: SimulatedRecording | None = None
        for name, profile in QUERIES.items():
            first, second = simulate_pair(seed, query=profile)
            reference = first.keep() if reference is None else reference
            drives[name] = second.keep()
        assert reference is not None
        for pixels in PIXELS:
            for window in WINDOWS:
                changes = {
                    "pixels": pixels,
                    "window": window,
                    "events_per_pixel": None,
                    "seed": seed,
                }
                settings = PRESETS["default"].replaced(changes, "calibration")
                mapped = ReferenceMap.build(reference, settings)
                elsewhere = (
                    None
                    if before is None
                    else count_windows(before, mapped.pixel_map, mapped.settings)
                )
                for driven in drives.values():
                    counted = count_windows(driven, mapped.pixel_map, mapped.settings)
                    truth = from_tracks(
                        reference.track,
                        driven.track,
                        mapped.places.centre_us,
                        counted.centre_us,
                        TOLERANCE_M,
                    )
                    yield Street(seed, Case(mapped, counted, truth), elsewhere)
        before = drives[_ELSEWHERE]


# How long it takes from switching on in mid-route to the first match that is nearly sure.


#: windows between two starts in mid-route, and most windows after a start
START_EVERY, GIVEN = 10, 120
#: least number of windows from a start to the end of the drive
_LEFT = 20
HEADER = ("drives", "starts", "p >= 0.95 reached", "median time", "right then",
          "p >= 0.99 reached", "median time", "right then")  # fmt: skip


def first_row(name: str, table: Confidence, switched_on: Sequence[Case]) -> list[str]:
    """Start at many windows, and measure the time to the first match of each probability.

    Parameters
    ----------
    name : str
        Name of the row.
    switched_on : sequence of Case
        Drives with the running mean, in which matching starts at several windows.

    Returns
    -------
    list of str
        Row of the table of `HEADER`.
    """
    row = [name]
    waits: dict[float, list[tuple[float, bool]]] = {0.95: [], 0.99: []}
    starts = 0
    for case in switched_on:
        windows, late = len(case.counted), case.reference.settings.late
        for start in range(0, windows - _LEFT, START_EVERY):
            if not case.truth.known[start]:
                continue
            starts += 1
            stop = min(start + GIVEN, windows)
            rest = replace(case, counted=case.counted.take(np.arange(start, stop)))
            matches = rest.match()
            given = table.probability_of(matches.trust)
            for least, found in waits.items():
                sure = np.flatnonzero(given >= least)
                if sure.size:
                    j = int(sure[0])
                    given_at = min(j + late, len(matches) - 1)
                    lasted = rest.counted.end_us[given_at] - rest.counted.start_us[0]
                    right = bool(case.truth.correct[matches.place[j], start + j])
                    found.append((float(lasted) / 1e6, right))
    row.append(str(starts))
    for found in waits.values():
        if not found:
            row += ["0.000", "-", "-"]
            continue
        times, rights = zip(*found, strict=True)
        row += [f"{len(found) / starts:.3f}", f"{np.median(times):.0f} s"]
        row.append(f"{np.mean(rights):.3f}")
    return row


#: number of streets that judge the table, after those from which it is learnt
JUDGED = 2
PRECISION = 0.99
PAST_THE_EDGE = "still accepted after leaving the map: mean, most"
_CUTS = 7  # random stream that decides where drives are cut
#: settings of the matches that each table is for
MATCHINGS: dict[str, dict[str, object]] = {
    **{
        str(delay): {"smooth": False, "delay": delay, "query_mean": "running"}
        for delay in LEARNT_DELAYS
    },
    SMOOTHED: {"smooth": True, "query_mean": "own"},
}


class Sample(NamedTuple):
    """Matches of known truth: trust (n,) int64, correct (n,) and has_place (n,) bool."""

    trust: npt.NDArray[np.int64]
    correct: npt.NDArray[np.bool_]
    has_place: npt.NDArray[np.bool_]


def versions_of(street: Street, rng: np.random.Generator) -> Iterator[tuple[str, Sample]]:
    """Match the versions of a drive.

    Parameters
    ----------
    rng : Generator
        Decides where the map and the drive are cut.

    Yields
    ------
    version : str
    sample : Sample
    """
    case = street.case
    places, windows = len(case.reference), len(case.counted)
    first = int(rng.integers(0, 3 * places // 4))
    versions = {
        "whole drives": case,
        "a quarter of the map cut out": without_places(case, first, first + places // 4),
    }
    if street.elsewhere is not None:
        length = min(windows // 4, len(street.elsewhere))
        start = int(rng.integers(0, len(street.elsewhere) - length + 1))
        away = street.elsewhere.take(np.arange(start, start + length))
        versions["a detour"] = with_detour(case, away, int(rng.integers(1, windows)))
    versions["carried off twice"] = carried_off(case, windows // 3, 2 * windows // 3)
    for name, version in versions.items():
        yield name, sample(version)


def with_settings(case: Case, **changes: object) -> Case:
    """Return a case whose map has other settings for matching."""
    settings = case.reference.settings.replaced(changes, "calibration")
    return replace(case, reference=replace(case.reference, settings=settings))


def sample(case: Case) -> Sample:
    """Match a case, and return the matches whose truth is known."""
    matches = case.match()
    known = case.truth.known[matches.query]
    correct = case.truth.correct[matches.place, matches.query]
    has_place = case.truth.has_place[matches.query]
    return Sample(matches.trust[known], correct[known], has_place[known])


def joined(found: list[Sample]) -> Sample:
    """Concatenate samples."""
    return Sample(*(np.concatenate(column) for column in zip(*found, strict=True)))


def accepted_past_the_edge(found: Sequence[Sample], least: int) -> str:
    """Describe how long matches are still accepted after a drive has left the map.

    Parameters
    ----------
    found : sequence of Sample
        Each of one drive, in the order of time.
    least : int
        Least trust of an accepted match.

    Returns
    -------
    str
        Mean and largest number of accepted matches in a row, over the times that a drive leaves
        the map from an accepted match; "-" if none does.
    """
    lasted = []
    for trust, _, has_place in found:
        accepted = trust >= least
        for j in np.flatnonzero(has_place[:-1] & ~has_place[1:] & accepted[:-1]) + 1:
            last = accepted[j:] & ~has_place[j:]
            lasted.append(int(np.argmin(last)) if not last.all() else last.size)
    return f"{np.mean(lasted):.1f}, {max(lasted)}" if lasted else "-"


def write_tables(path: Path, learnt: Mapping[str, tuple[Confidence, Sample]], seeds: int) -> None:
    """Write the tables and their origin in the package's format, atomically.

    Parameters
    ----------
    learnt : mapping of str to (Confidence, Sample)
        Each table, and the matches that it was learnt from, by its name in `MATCHINGS`.
    seeds : int
        Number of streets.
    """
    tables = {
        name: {
            "right": round(float(found.correct.mean()), 4),
            "off_map": round(float(1 - found.has_place.mean()), 4),
            "trust": confidence.trust.tolist(),
            "probability": [round(p, 6) for p in confidence.probability.tolist()],
            "matches": confidence.matches.tolist(),
        }
        for name, (confidence, found) in learnt.items()
    }
    made = {
        "made_by": f"edge-vpr experiment calibration --seeds {seeds} --table DIR",
        "version": __version__,
        "street_seeds": [FIRST_SEED, FIRST_SEED + seeds - 1],
        "tables": tables,
    }
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(made, allow_nan=False) + "\n", encoding="utf-8")


def run(
    data: object,
    seeds: int,
    on_start: Callable[[str], None],
    *figures: Path,
    table: Path | None = None,
) -> str:
    """Learn the tables on simulated streets, and return a report as Markdown.

    Parameters
    ----------
    data : object
        Not used: the streets are simulated.
    seeds : int
        Number of streets.
    on_start : callable
        Called with the name of each street before it begins.
    *figures : path
        Path of the reliability diagram of the streets that judge the tables.
    table : path, optional
        Folder to which they are written, in one file.
    """
    lots = {name: _Lot(changes) for name, changes in MATCHINGS.items()}
    live: dict[str, list[Case]] = {}
    for street in streets(seeds + JUDGED, on_start):
        judging = street.seed >= FIRST_SEED + seeds
        if judging:
            settings = street.case.reference.settings
            name = f"{settings.pixels} px, windows of fixed {settings.window}"
            live.setdefault(name, []).append(with_settings(street.case, **MATCHINGS["0"]))
        for lot in lots.values():
            lot.take(street, judging)
    parts = []
    judged: dict[str, Reliability] = {}
    tables: dict[str, tuple[Confidence, Sample]] = {}
    for name, lot in lots.items():
        learnt = joined(lot.found)
        confidence = learn_confidence(learnt.trust, learnt.correct)
        tables[name] = confidence, learnt
        pooled = joined([some for version in lot.held.values() for some in version])
        given = confidence.probability_of(pooled.trust)
        how = described(name)
        judged[how] = reliability(given, pooled.correct)
        parts += [f"{how}:",
                  f"{learnt.trust.size:,} matches, {learnt.correct.mean():.3f} right, "
                  f"{1 - learnt.has_place.mean():.3f} off the map",
                  _steps(confidence), _judged(confidence, lot.held)]  # fmt: skip
        if name == "0":
            rows = [first_row(name, confidence, live[name]) for name in live]
            parts += ["Switched on in mid-route:", markdown_table(HEADER, rows)]
    if table is not None:
        write_tables(table / DEFAULT_TABLES, tables, seeds)
    if figures:
        save(draw(judged), *figures)
    return "\n\n".join(parts)


def described(name: str) -> str:
    """Return the name of one of `MATCHINGS` as the heading of a table."""
    if name == SMOOTHED:
        return "Smoothed"
    return "Window by window" if name == "0" else f"{name} windows late"


def draw(judged: Mapping[str, Reliability]) -> Figure:
    """Draw how often matches of each probability are right on streets that were not learnt from."""
    return reliability_diagram(judged)


class _Lot:
    """Matches of all streets by one of `MATCHINGS`: for learning, and by version for judging."""

    def __init__(self, changes: Mapping[str, object]) -> None:
        self._changes, self._rng = changes, np.random.default_rng(_CUTS)
        self.found: list[Sample] = []
        self.held: dict[str, list[Sample]] = {}

    def take(self, street: Street, judging: bool) -> None:
        street = street._replace(case=with_settings(street.case, **self._changes))
        for name, some in versions_of(street, self._rng):
            (self.held.setdefault(name, []) if judging else self.found).append(some)


def _steps(confidence: Confidence) -> str:
    probability, first = np.unique(confidence.probability, return_index=True)
    rows = [
        [f"{trust:,}", f"{p:.3f}", f"{precision:.3f}", f"{matches:,}"]
        for trust, p, precision, matches in zip(
            confidence.trust[first].tolist(),
            probability.tolist(),
            confidence.precision[first].tolist(),
            np.add.reduceat(confidence.matches, first).tolist(),
            strict=True,
        )
    ]
    return markdown_table(("trust from", "probability", "precision from here up", "matches"), rows)


def _judged(confidence: Confidence, held: dict[str, list[Sample]]) -> str:
    """Judge a table on streets from which it was not learnt, with a row for each version."""
    rows = []
    for name, some in held.items():
        pooled = joined(some)
        given = confidence.probability_of(pooled.trust)
        reached = confidence.precision[-1] >= PRECISION
        least = confidence.least_trust(PRECISION) if reached else np.iinfo(np.int64).max
        accepted = pooled.trust >= least
        counts = judge_rejection(*pooled, accepted)
        figures = (
            counts.right_on_map, reliability(given, pooled.correct).expected_calibration_error,
            counts.off_map_auroc, accepted.mean(), counts.precision, counts.recall,
        )  # fmt: skip
        told = ["-" if value is None else f"{value:.3f}" for value in figures]
        rows.append([name, *told, accepted_past_the_edge(some, int(least))])
    header = ("other streets", "right of those on the map", "calibration error",
              "AUROC off the map", "accepted at 0.99", "precision", "recall",
              PAST_THE_EDGE)  # fmt: skip
    return markdown_table(header, rows)
