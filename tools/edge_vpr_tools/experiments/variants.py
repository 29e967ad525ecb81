"""Variants of the method side by side: how often each is right, and what a match costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from edge_vpr_tools.experiments.trial import Summary, Trial, markdown_table
from edge_vpr_tools.report.dot_plot import dot_plot

#: trials by the name of the variant
Trials = Mapping[str, Sequence[Trial]]
_HEADER = (
    "variant", "P@100R", "R@99P", "Recall@5", "bytes a place", "operations a match",
    "time a query",
)  # fmt: skip


def variants_table(found: Trials) -> str:
    """Return a Markdown table with a row for each variant, and the spread of its trials.

    Operations are differences of two counters. The time of a query is the median over the trials of
    what it takes to match one described window with all places.
    """
    rows = []
    for name, trials in found.items():
        measures = (str(Summary(values)) for values in _measures(trials).values())
        rows.append(
            [
                name,
                *measures,
                f"{max(t.reference.packed_bytes_per_place for t in trials):,}",
                f"{max(t.operations for t in trials):,}",
                f"{np.median([t.microseconds_per_match for t in trials]):,.0f} us",
            ]
        )
    return markdown_table(_HEADER, rows)


def draw_variants(found: Trials) -> Figure:
    """Draw each measure of every variant, with the spread of its trials."""
    by_variant = {name: _measures(trials) for name, trials in found.items()}
    return dot_plot(
        {
            measure: {"": {name: values[measure] for name, values in by_variant.items()}}
            for measure in next(iter(by_variant.values()))
        }
    )


def _measures(trials: Sequence[Trial]) -> dict[str, list[float]]:
    found = [trial.evaluation for trial in trials]
    return {
        "P@100R": [each.precision_at_100_recall for each in found],
        "R@99P": [each.recall_at_99_precision for each in found],
        "Recall@5": [each.recall_at[5] for each in found],
    }
