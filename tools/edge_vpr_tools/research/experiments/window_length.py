"""Short windows in long sequences against long windows in short ones, at equal time a match."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure

from edge_vpr.pipeline import EventSource
from edge_vpr.settings import PRESETS, Settings
from edge_vpr.simulation import simulate_pair
from edge_vpr_tools.report.style import log_ticks, look, mean_line, panels, save
from edge_vpr_tools.research.experiments.drives import absent_events, event_pairs
from edge_vpr_tools.research.experiments.simulated import SIMULATED, truth_of_pair
from edge_vpr_tools.research.experiments.trial import (
    Summary,
    TruthOf,
    Variant,
    map_and_describe,
    markdown_table,
    match_trial,
)

#: duration of one window in seconds
WINDOWS_S = (0.25, 0.5, 1.0, 2.0, 4.0)
#: duration of all windows of a match together in seconds
SPANS_S = (4.0, 8.0, 16.0)
#: seconds on each side of the best place in which no second best is searched
_EXCLUSION_S = 3.0

#: P@100R of each trial, by the seconds of a window and of a match
Found = dict[tuple[float, float], list[float]]


def variant(window_s: float, span_s: float) -> Variant:
    """Return the paper's method with windows of this length, and sequences that fill the span."""
    length = round(span_s / window_s)
    return Variant(
        f"{length} windows of {window_s:g} s",
        {
            "tau_us": round(window_s * 1e6),
            "sequence_length": length,
            "exclusion": max(1, round(_EXCLUSION_S / window_s)),
        },
    )


def run(
    data: Path | None,
    seeds: int,
    on_start: Callable[[str], None],
    *figures: Path,
) -> str:
    """Vary windows and sequences on simulated pairs, and on recorded ones if a folder is given."""
    results: dict[str, Found] = {}
    for name, seed, reference, query, truth_of in _trials(data, seeds):
        found = results.setdefault(name, {})
        settings = PRESETS["paper"].replaced({"seed": seed}, "seed")
        for window_s in WINDOWS_S:
            on_start(f"{name}, seed {seed}: windows of {window_s:g} s")
            score(reference, query, truth_of, settings, window_s, found)
    if figures:
        save(draw(results), *figures)
    tables = "\n\n".join(f"{name}, P@100R:\n\n{_table(found)}" for name, found in results.items())
    return tables + absent_events(data, results)


def score(
    reference: EventSource,
    query: EventSource,
    truth_of: TruthOf,
    settings: Settings,
    window_s: float,
    found: Found,
) -> None:
    """Match with windows of one length and sequences of every span, and add the figures.

    Both drives are counted once, since the length of sequences matters only to the matching.
    """
    tried = variant(window_s, SPANS_S[0])
    mapped, queries = map_and_describe(reference, query, settings, tried)
    for span_s in SPANS_S:
        longer = variant(window_s, span_s)
        spanning = replace(mapped, settings=mapped.settings.replaced(longer.changes, longer.name))
        trial = match_trial(spanning, queries, truth_of)
        right = trial.evaluation.precision_at_100_recall
        found.setdefault((window_s, span_s), []).append(right)


def _trials(
    data: Path | None, seeds: int
) -> Iterator[tuple[str, int, EventSource, EventSource, TruthOf]]:
    for seed in range(seeds):
        reference, query = (drive.keep() for drive in simulate_pair(seed))
        yield SIMULATED, seed, reference, query, truth_of_pair(reference, query)
    for pair in event_pairs(data):
        for seed in range(seeds):
            yield pair.name, seed, pair.reference, pair.query, pair.truth_of


def _table(found: Found) -> str:
    rows = [
        [f"{window:g} s", *(str(Summary(found[window, span])) for span in SPANS_S)]
        for window in WINDOWS_S
    ]
    return markdown_table(("window", *(f"{span:g} s a match" for span in SPANS_S)), rows)


def draw(results: Mapping[str, Found]) -> Figure:
    """Draw right matches against the length of a window, with a panel for each pair."""
    with panels(1, len(results), 4.6 * len(results) + 1.5, 4.2) as (drawing, (row,)):
        for axes, (name, found) in zip(row, results.items(), strict=True):
            for i, span in enumerate(SPANS_S):
                values = [found[window, span] for window in WINDOWS_S]
                mean_line(axes, WINDOWS_S, values, label=f"{span:g} s a match", **look(i))
            log_ticks(axes, WINDOWS_S)
            axes.set(title=name, xlabel="length of a window, s", ylim=(0, 1.03))
        row[0].set_ylabel("P@100R")
        row[0].legend()
    return drawing
