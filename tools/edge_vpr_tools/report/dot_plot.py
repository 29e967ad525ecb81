"""Means and spreads of trials, a row for each variant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from edge_vpr_tools.report.style import (
    CYCLE,
    MARKERS,
    legend_below,
    mean_and_spread,
    name_label,
    panels,
)

#: values of the trials by row
Rows = Mapping[str, Sequence[float]]
#: from none to all
SHARE = (-0.03, 1.03)
_LINE_HEIGHT = 0.32


def dot_plot(
    measures: Mapping[str, Mapping[str, Rows]], limits: tuple[float, float] | None = SHARE
) -> Figure:
    """Draw a panel for each measure: a dot for the mean of a row's trials, a bar for their spread.

    Parameters
    ----------
    measures : mapping of measure to mapping of series to mapping of row to sequence of float
        Values of the trials. A series has a colour; several are listed in a legend. All have the
        same rows, which are drawn from top to bottom.
    limits : (float, float), optional
        Of the horizontal axes; None chooses them by the values.

    Examples
    --------
    >>> drawing = dot_plot({"P@100R": {"": {"25 pixels": [0.7, 0.8], "all": [0.9, 0.9]}}})
    >>> [label.get_text() for label in drawing.axes[0].get_yticklabels()]
    ['25 pixels', 'all']
    """
    some = next(iter(measures.values()))
    names = list(next(iter(some.values())))
    lines = len(names) * (1 + len(some)) / 2
    size = 3.4 + 3.2 * len(measures), 1.4 + _LINE_HEIGHT * lines
    with panels(1, len(measures), *size, sharey=True) as (drawing, (row,)):
        for axes, (measure, series) in zip(row, measures.items(), strict=True):
            for i, (title, rows) in enumerate(series.items()):
                found = [mean_and_spread(rows[name]) for name in names]
                axes.errorbar(
                    [mean for mean, _ in found],
                    # several dots of a row stand below each other
                    [line + 0.5 * ((i + 0.5) / len(series) - 0.5) for line in range(len(names))],
                    xerr=[spread for _, spread in found],
                    color=CYCLE[i % len(CYCLE)],
                    marker=MARKERS[i % len(MARKERS)],
                    ms=5,
                    linestyle="none",
                    label=name_label(title),
                )
            axes.set(xlabel=measure, xlim=limits)
        row[0].set_yticks(range(len(names)), [name_label(name) for name in names], fontsize=9)
        row[0].set_ylim(len(names) - 0.5, -0.5)
        if len(some) > 1:
            legend_below(drawing, row, len(some))
    return drawing
