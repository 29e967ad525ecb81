"""The report of the demo: how soon places are recognised, table, remarks on it, and figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr import results
from edge_vpr.descriptors.counting import EventSource, cleaned
from edge_vpr.evaluation.tracks import Track, with_positions
from edge_vpr.files import read_json
from edge_vpr.online.localiser import Localiser, MatchSchedule
from edge_vpr.reference_map import ReferenceMap, write_matched
from edge_vpr_tools.report import figures
from edge_vpr_tools.report.figures import over_time
from edge_vpr_tools.report.page import Page, add_run
from edge_vpr_tools.report.style import along_route, save, seconds
from edge_vpr_tools.report.traverse import shown_distances
from edge_vpr_tools.report.verdict import outcome_of
from edge_vpr_tools.research.experiments import simulated
from edge_vpr_tools.research.experiments.pairs import TOLERANCE_M
from edge_vpr_tools.research.experiments.variants import VariantResult

# How soon a place is recognised after it was entered: event by event against window by window.


@dataclass(frozen=True, eq=False)
class Latency:
    """Times from entering a place to its first correct match.

    Attributes
    ----------
    seconds : ndarray of float64, shape (m,)
        For the places that were recognised before the drive was `reach_m` past their end.
    places : int
        Number of places entered while matches were given.
    """

    seconds: npt.NDArray[np.float64]
    places: int
    matches: int

    @property
    def median_s(self) -> float:
        """Median over the recognised places in seconds; NaN if there are none."""
        return float(np.median(self.seconds)) if self.seconds.size else float("nan")


def measure_latency(
    reference: ReferenceMap,
    query: EventSource,
    reference_track: Track,
    query_track: Track,
    every: MatchSchedule,
    reach_m: float,
) -> Latency:
    """Run the query online, and measure the time to each place's first correct match.

    A place is entered when the query reaches the position at which the reference's window began. It
    is recognised by the first later match with this place, or with a later place whose window began
    within `reach_m` of the query's position, while the query is not yet `reach_m` past the window's
    end.

    Parameters
    ----------
    reference_track, query_track : Track
        Metric, one coordinate: the distance along the route, which does not decrease.
    every : MatchSchedule
        Schedule of matches.
    reach_m : float
        Reach in metres.
    """
    localiser = Localiser(reference, every=every)
    given = [localiser.update(events) for events in cleaned(query, reference.settings)]
    matches = np.concatenate(given)
    start_m = reference_track.at(reference.places.start_us)[:, 0]
    end_m = reference_track.at(reference.places.end_us)[:, 0]
    at_m = query_track.at(matches["time_us"])[:, 0]
    along_m = query_track.position[:, 0]
    entered_us = np.interp(start_m, along_m, query_track.time_us, left=np.nan, right=np.nan)

    named = matches["place"]
    near = np.abs(start_m[named] - at_m) <= reach_m
    seconds, places = [], 0
    for k in range(reference.settings.windows_per_match - 1, len(reference)):
        if not (np.isfinite(entered_us[k]) and matches["time_us"][0] <= entered_us[k]):
            continue
        places += 1
        first, last = np.searchsorted(matches["time_us"], [entered_us[k], np.inf])
        last = first + np.searchsorted(at_m[first:last], end_m[k] + reach_m)
        correct = (named[first:last] == k) | ((named[first:last] > k) & near[first:last])
        if correct.any():
            seconds.append((matches["time_us"][first + np.argmax(correct)] - entered_us[k]) / 1e6)
    return Latency(np.array(seconds), places, len(matches))


def compare_latencies(
    trial: VariantResult, query: EventSource, tracks: tuple[Track, Track]
) -> dict[str, Latency]:
    """Time the recognition of places with a match after every event, and after every window.

    Parameters
    ----------
    tracks : (Track, Track)
        Of the reference and of the query.
    """
    policies = {
        "event by event": MatchSchedule(events=1),
        "window by window": MatchSchedule.window(trial.reference.settings),
    }
    return {
        name: measure_latency(trial.reference, query, *tracks, every, TOLERANCE_M)
        for name, every in policies.items()
    }


# The table, remarks on it, and the report.


def rows(trials: dict[str, VariantResult]) -> list[tuple[str, ...]]:
    """Return a row of `HEADER` for each variant."""
    return [
        (
            name,
            f"{trial.evaluation.precision_at_100_recall:.3f}",
            f"{trial.evaluation.recall_at_99_precision:.3f}",
            f"{trial.reference.packed_bytes_per_place:,}",
            f"{trial.operations:,}",
            f"{trial.microseconds_per_match:,.1f} µs",
        )
        for name, trial in trials.items()
    ]


HEADER = (
    "variant", "P@100R", "R@99P", "bytes per place", "operations per match", "time per query",
)  # fmt: skip


def remarks(trials: dict[str, VariantResult], latencies: dict[str, Latency]) -> list[str]:
    """Return remarks on the table, one line each, and the latencies."""
    share = {name: trial.evaluation.precision_at_100_recall for name, trial in trials.items()}

    def compare(claim: str, first: str, second: str) -> str:
        return f"{claim}: {share[first]:.0%} correct against {share[second]:.0%}."

    found = [
        f"{name} {one.median_s:.2f} s ({one.seconds.size} of {one.places} places recognised)"
        for name, one in latencies.items()
    ]
    return [
        compare(
            "The place filter against the paper's method in windows of fixed time",
            simulated.DEFAULT,
            simulated.BY_TIME,
        ),
        compare("The place filter with 25 pixels", simulated.DEFAULT_25, simulated.BY_TIME),
        compare("Fixed N against fixed tau, by sequences", simulated.BEST, simulated.BY_TIME),
        compare("150 pixels against all 16,384", simulated.BEST, simulated.DENSE),
        compare("Counts as 3-bit logarithms against counts", simulated.CODED, simulated.BEST),
        compare(
            "25 varying pixels against 25 random ones", simulated.FIXED_N_25, simulated.RANDOM_25
        ),
        "One street of one seed; `edge-vpr experiment simulated` gives five, with their spread.",
        "P@100R: share of correct matches when every window is matched; R@99P: recall at 99 % "
        f"precision; correct is within {TOLERANCE_M:g} m.",
        f"From entering a place to its first correct match, median: {'; '.join(found)}.",
    ]


def write_report(
    folder: Path, trials: dict[str, VariantResult], latencies: dict[str, Latency], track: Track
) -> None:
    """Write ``report.html`` and its figures, and map and matches of the default."""
    best, by_time = trials[simulated.BEST], trials[simulated.BY_TIME]
    page = Page("edge-vpr: one street, driven twice")
    default = trials[simulated.DEFAULT]
    outcome = outcome_of(default.reference, default.matches, default.truth, default.evaluation)
    page.verdict(outcome.sentence())
    page.text(
        "A simulated street of 900 m, seen by an event camera of 128 x 128 pixels. The second "
        "drive goes at half to double the first one's speed, in another light, with other traffic."
    )
    page.table(HEADER, rows(trials))
    for line in remarks(trials, latencies):
        page.text(line)
    curves = {name: trial.evaluation for name, trial in trials.items()}
    write_matched(
        folder, with_positions(default.reference, track), default.matches, default.queries
    )
    drawings = [
        ("matches.png", over_time(outcome),
         "The default: how far each match is from the true place, and how probable it is."),
        ("precision_recall.png", figures.precision_recall(curves),
         "Precision against recall of every variant."),
    ]  # fmt: skip
    for name, trial, caption in (
        (
            "place_filter.png",
            default,
            "The default: the place filter, with codes that other light does not move.",
        ),
        ("fixed_n.png", best, "Fixed N: equal motion makes equal windows."),
        ("fixed_tau.png", by_time, "Fixed tau: the same place looks different at another speed."),
    ):
        shown = shown_distances(trial.reference.places, trial.queries, trial.matches)
        route = with_positions(trial.reference, track).route
        drawing = figures.distance_matrix(
            *shown, trial.matches, trial.truth, trial.evaluation,
            seconds(trial.queries.centre_us, "query"), along_route(trial.reference, route),
        )  # fmt: skip
        drawings.append((name, drawing, caption))
    drives = [("reference", best.reference.places), ("query", best.queries)]
    drawings += [
        ("pixels.png", figures.selected_pixels(best.reference),
         "The selected pixels lie where the counts vary from place to place."),
        ("event_rate.png", figures.event_rate(drives), "Events per second."),
        ("window_lengths.png", figures.window_lengths(drives),
         "A window of fixed N is short where the camera moves fast."),
    ]  # fmt: skip
    for name, drawing, caption in drawings:
        page.picture(save(drawing, folder / name), caption)
    add_run(page, read_json(folder / results.RUN, "the run", "run the demo again"))
    page.write(folder / results.REPORT)
