"""`edge-vpr demo`: the whole job on a simulated street, in half a minute."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from edge_vpr.simulate import simulate_pair
from edge_vpr_tools.experiments import simulated
from edge_vpr_tools.experiments.latency import Latency
from edge_vpr_tools.experiments.trial import Trial
from edge_vpr_tools.output import results
from edge_vpr_tools.output.messages import is_quiet
from edge_vpr_tools.output.progress import keep_shown, status
from edge_vpr_tools.output.provenance import run_record, write_json
from edge_vpr_tools.report import figures
from edge_vpr_tools.report.page import Page
from edge_vpr_tools.report.style import save
from edge_vpr_tools.report.traverse import shown_distances


def run(args: argparse.Namespace) -> None:
    """Simulate, try every variant, print the table and write the report.

    Raises
    ------
    UsageError
        If the seed is negative or the folder cannot be written.
    """
    output = Path(args.output)
    output.absolute().parent.mkdir(parents=True, exist_ok=True)
    results.check_output_folder(output, args.overwrite)
    reference, query = simulate_pair(args.seed)
    keep_shown(reference, "simulating the reference drive")
    keep_shown(query, "simulating the query drive: other speed, other light, other traffic")
    with status("mapping and matching") as show:
        trials = simulated.run_variants(reference, query, args.seed, show)
        show("matching event by event")
        latencies = simulated.compare_latencies(reference, query, trials[simulated.DEFAULT])
        show("drawing the report")
        with results.results_folder(output, args.overwrite) as folder:
            metrics = {
                "variants": {name: _metrics(trial) for name, trial in trials.items()},
                "latency_median_s": {name: found.median_s for name, found in latencies.items()},
            }
            settings = simulated.SETTINGS.replaced({"seed": args.seed}, "seed")
            write_json(folder / results.RUN, run_record(settings.to_dict(), []))
            write_json(folder / results.METRICS, metrics)
            _write_report(folder, trials, latencies)
    _print(trials, latencies, output / results.REPORT)


def _metrics(trial: Trial) -> dict[str, Any]:
    return {
        **trial.evaluation.to_dict(),
        "bytes_per_place": trial.reference.packed_bytes_per_place,
        "microseconds_per_match": trial.microseconds_per_match,
        "places": len(trial.reference),
    }


def _rows(trials: dict[str, Trial]) -> list[tuple[str, ...]]:
    return [
        (
            name,
            f"{trial.evaluation.precision_at_100_recall:.3f}",
            f"{trial.evaluation.recall_at_99_precision:.3f}",
            f"{trial.microseconds_per_match:,.1f}",
            f"{trial.reference.packed_bytes_per_place:,}",
        )
        for name, trial in trials.items()
    ]


_HEADER = ("variant", "P@100R", "R@99P", "us per match", "bytes per place")


def _reading(trials: dict[str, Trial]) -> list[str]:
    """Say in one line each what the table shows, whatever it shows."""
    share = {name: trial.evaluation.precision_at_100_recall for name, trial in trials.items()}

    def compare(claim: str, first: str, second: str) -> str:
        return f"{claim}: {share[first]:.0%} right against {share[second]:.0%}."

    return [
        compare(
            "The place filter against the paper's method", simulated.DEFAULT, simulated.BY_TIME
        ),
        compare("The place filter with 25 pixels", simulated.DEFAULT_FEW, simulated.BY_TIME),
        compare("Fixed N against fixed tau, by sequences", simulated.BEST, simulated.BY_TIME),
        compare("150 pixels against all 16,384", simulated.BEST, simulated.DENSE),
        compare("Counts as 3-bit logarithms against counts", simulated.CODED, simulated.BEST),
        compare("25 varying pixels against 25 random ones", simulated.FEW, simulated.FEW_RANDOM),
        "One street of one seed; `edge-vpr experiment simulated` gives five, with their spread.",
        "P@100R: share of right matches when every window is matched; R@99P: recall at 99 % "
        f"precision; right is within {simulated.TOLERANCE_M:g} m.",
    ]


def _latency_line(latencies: dict[str, Latency]) -> str:
    parts = [
        f"{name} {found.median_s:.2f} s ({found.seconds.size} of {found.places} places recognised)"
        for name, found in latencies.items()
    ]
    return "From entering a place to its first right match, median: " + "; ".join(parts) + "."


def _print(trials: dict[str, Trial], latencies: dict[str, Latency], report: Path) -> None:

    table = Table(title="One street, driven twice, the second time at half to double the speed")
    for i, title in enumerate(_HEADER):
        table.add_column(title, justify="left" if i == 0 else "right")
    for row in _rows(trials):
        table.add_row(*row)
    console = Console(width=None if Console().is_terminal else 100, quiet=is_quiet())
    console.print(table)
    for line in [*_reading(trials), _latency_line(latencies)]:
        console.print(line, highlight=False)
    console.print(f"See {report}", highlight=False)


def _write_report(folder: Path, trials: dict[str, Trial], latencies: dict[str, Latency]) -> None:

    best, by_time = trials[simulated.BEST], trials[simulated.BY_TIME]
    page = Page("edge-vpr: one street, driven twice")
    page.text(
        "A simulated street of 900 m, seen by an event camera of 128 x 128 pixels. The second "
        "drive goes at half to double the first one's speed, in another light, with other traffic."
    )
    page.table(_HEADER, _rows(trials))
    for line in [*_reading(trials), _latency_line(latencies)]:
        page.text(line)
    curves = {name: trial.evaluation for name, trial in trials.items()}
    drawings = [
        ("precision_recall.png", figures.precision_recall(curves),
         "Precision against recall of every variant."),
    ]  # fmt: skip
    for name, trial, caption in (
        (
            "place_filter.png",
            trials[simulated.DEFAULT],
            "The default: the place filter, with codes that other light does not move.",
        ),
        ("fixed_n.png", best, "Fixed N: equal motion makes equal windows."),
        ("fixed_tau.png", by_time, "Fixed tau: the same place looks different at another speed."),
    ):
        shown = shown_distances(trial.reference.places, trial.queries, trial.matches)
        drawing = figures.distance_matrix(*shown, trial.matches, trial.truth, trial.evaluation)
        drawings.append((name, drawing, caption))
    drives = [("reference", best.reference.places), ("query", best.queries)]
    drawings += [
        ("pixels.png", figures.selected_pixels(best.reference),
         "The selected pixels lie where the counts vary from place to place."),
        ("event_rate.png", figures.event_rate(drives), "Events a second."),
        ("window_lengths.png", figures.window_lengths(drives),
         "A window of fixed N is short where the camera moves fast."),
    ]  # fmt: skip
    for name, drawing, caption in drawings:
        save(drawing, folder / name)
        page.picture(folder / name, caption)
    page.write(folder / results.REPORT)
