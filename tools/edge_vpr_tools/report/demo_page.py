"""The report of the demo: a table, remarks on it, and figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from edge_vpr import results
from edge_vpr.evaluation.tracks import Track, with_positions
from edge_vpr.files import read_json
from edge_vpr.reference_map import write_matched
from edge_vpr_tools.report import figures
from edge_vpr_tools.report.figures import over_time
from edge_vpr_tools.report.page import Page, add_run
from edge_vpr_tools.report.style import save
from edge_vpr_tools.report.verdict import outcome_of
from edge_vpr_tools.research.experiments import simulated
from edge_vpr_tools.research.experiments.pairs import TOLERANCE_M
from edge_vpr_tools.research.experiments.variants import VariantResult


def rows(trials: dict[str, VariantResult]) -> list[tuple[str, ...]]:
    """Return a row of `HEADER` for each variant."""
    return [
        (
            name,
            f"{trial.evaluation.precision_at_100_recall:.3f}",
            f"{trial.evaluation.recall_at_99_precision:.3f}",
            f"{trial.reference.packed_bytes_per_window:,}",
            f"{trial.operations:,}",
            f"{trial.microseconds_per_match:,.1f} µs",
        )
        for name, trial in trials.items()
    ]


HEADER = (
    "variant", "P@100R", "R@99P", "bytes per window", "operations per match", "time per query",
)  # fmt: skip


def remarks(trials: dict[str, VariantResult]) -> list[str]:
    """Return remarks on the table, one line each."""
    share = {name: trial.evaluation.precision_at_100_recall for name, trial in trials.items()}

    def compare(claim: str, first: str, second: str) -> str:
        return f"{claim}: {share[first]:.0%} correct against {share[second]:.0%}."

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
    ]


def write_report(
    folder: Path, trials: dict[str, VariantResult], remarks: Sequence[str], track: Track
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
    for line in remarks:
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
        shown = outcome_of(trial.reference, trial.matches, trial.truth, trial.evaluation)
        route = with_positions(trial.reference, track).route
        drawing = figures.distance_matrix(trial.reference, trial.queries, shown, route)
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
