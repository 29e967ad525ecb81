"""Short windows in long sequences against long windows in short ones, at equal time a match."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from matplotlib.figure import Figure

from edge_vpr.settings import PRESETS
from edge_vpr_tools.report.tables import TableView
from edge_vpr_tools.research.experiments.drives import event_drives
from edge_vpr_tools.research.experiments.experiment import Draw, Experiment, Row, Rows
from edge_vpr_tools.research.experiments.pairs import Pair
from edge_vpr_tools.research.experiments.plots import lines

#: duration of one window in seconds
WINDOWS_S = (0.25, 0.5, 1.0, 2.0, 4.0)
#: duration of all windows of a match together in seconds
SPANS_S = (4.0, 8.0, 16.0)
#: seconds on each side of the best place in which no second best is searched
_EXCLUSION_S = 3.0


def changes(window_s: float, span_s: float) -> dict[str, Any]:
    """Return settings of the paper's method: windows of this length, and sequences of the span."""
    return {
        "tau_us": round(window_s * 1e6),
        "sequence_length": round(span_s / window_s),
        "exclusion": max(1, round(_EXCLUSION_S / window_s)),
    }


def measure(draw: Draw) -> Iterator[Row]:
    """Match with windows of every length and sequences of every span.

    Both drives are counted once for each length of a window, since the length of sequences matters
    only to the matching.
    """
    pair: Pair = draw.pair
    settings = PRESETS["paper"].replaced({"seed": draw.seed}, "seed")
    for window_s in WINDOWS_S:
        mapped = pair.mapped(settings.replaced(changes(window_s, SPANS_S[0]), "windows"))
        for span_s in SPANS_S:
            row = {"window (s)": f"{window_s:g}", "match (s)": f"{span_s:g}"}
            longer = mapped.with_settings(changes(window_s, span_s))
            yield {**row, "P@100R": longer.correct()}


def figure(rows: Rows) -> Figure:
    """Draw correct matches against the length of a window."""
    return lines(
        [{**row, "window (s)": float(row["window (s)"])} for row in rows],
        x="window (s)", y="P@100R", line="match (s)", log=True,
    )  # fmt: skip


EXPERIMENT = Experiment(
    drives=event_drives,
    names=("window (s)", "match (s)"),
    measure=measure,
    figure=figure,
    view=TableView({}, across="match (s)"),
)
