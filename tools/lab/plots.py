"""Figures of experiments: two kinds, each declared by the columns that it shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from edge_vpr_tools.report.style import CYCLE, GREY, legend_below, name_label, panels
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lab.loop import Rows

#: most panels beside each other, so that a page shows them in a legible size
_COLUMNS, _COLUMNS_OF_DOTS = 3, 4
#: least space between labelled ticks, as a share of the axis
_APART = 0.08
_MARKERS = "osD^vP"
#: 7 colours and 5 dashes make 35 different curves, which are distinguishable where they overlap
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1)))


def dots(rows: Rows, measure: str, row: str, series: str) -> Figure:
    """Draw a panel for each pair of drives: means of trials as dots, a colour for each series.

    Rows are drawn from top to bottom; a bar is the spread of the trials. Panels beside each other
    share their rows.

    Parameters
    ----------
    measure : str
        Column of numbers.
    row, series : str
        Columns that name the rows, and the dots of each.
    """
    shown = list(_by(rows, "drives"))
    kinds = list(dict.fromkeys(each[series] for each in rows))
    columns = min(len(shown), _COLUMNS_OF_DOTS)
    beside = [shown[i : i + columns] for i in range(0, len(shown), columns)]
    labels = [
        list(dict.fromkeys(str(each[row]) for _, of in line for each in of)) for line in beside
    ]
    heights = [1.4 + 0.12 * (1 + len(kinds)) * len(each) for each in labels]
    size = 3.4 + 2.2 * columns, sum(heights)
    shared: dict[str, Any] = {"sharey": "row", "height_ratios": heights}
    with panels(len(beside), columns, *size, **shared) as (drawing, grid):
        for empty in grid.flat[len(shown) :]:
            empty.remove()
        for across, line, names in zip(grid, beside, labels, strict=True):
            across[0].set_yticks(range(len(names)), map(_title, names), fontsize=9)
            across[0].set_ylim(len(names) - 0.5, -0.5)
            for axes, (drives, of) in zip(across, line, strict=False):
                for i, kind in enumerate(kinds):
                    those = [each for each in of if each[series] == kind]
                    trials = {str(name): _values(each, measure) for name, each in _by(those, row)}
                    # several dots of a row stand below each other
                    below = 0.5 * ((i + 0.5) / len(kinds) - 0.5)
                    spreads = [mean_and_spread(trials.get(name) or [np.nan]) for name in names]
                    _dots(axes, spreads, below, i, _title(kind))
                title = "" if len(shown) == 1 else str(drives).replace(", ", "\n")
                axes.set(xlabel=measure, title=title, xlim=(-0.03, 1.03))
                axes.locator_params(axis="x", nbins=4)
                axes.tick_params(axis="x", labelsize=9)
        if len(kinds) > 1:
            legend_below(drawing, grid.flat[:1], len(kinds))
    return drawing


def _dots(
    axes: Axes, points: Sequence[tuple[float, float]], below: float, i: int, label: str
) -> None:
    """Draw the means and spreads of the i-th series, one each row."""
    means, spreads = zip(*points, strict=True)
    axes.errorbar(
        means, np.arange(len(points)) + below, xerr=spreads, color=CYCLE[i % len(CYCLE)],
        marker=_MARKERS[i % len(_MARKERS)], ms=5, linestyle="none", label=label,
    )  # fmt: skip


def lines(
    rows: Rows,
    x: str,
    y: str,
    line: str,
    *,
    panel: Sequence[str] = ("drives",),
    mark: float | None = None,
) -> Figure:
    """Draw the mean of the trials over a number: a panel each pair of drives, a line each variant.

    The horizontal axis is logarithmic.

    Parameters
    ----------
    x, y : str
        Columns of numbers.
    line : str
        Column that names the lines.
    panel : sequence of str
        Columns that have a panel for each of their values.
    mark : float, optional
        Where a vertical line is drawn, as at the default.
    """
    titled = [{**row, "": "\n".join(_title(row[each]) for each in panel)} for row in rows]
    shown, names = list(_by(titled, "")), list(dict.fromkeys(row[line] for row in rows))
    columns = min(len(shown), _COLUMNS)
    below = -(-len(shown) // columns)
    size = 3.4 * columns + 0.6, 3.1 * below + 0.8
    with panels(below, columns, *size, sharey=True) as (drawing, grid):
        for empty in grid.flat[len(shown) :]:
            empty.remove()
        for left in grid[:, 0]:
            left.set_ylabel(y)
        for axes, (title, of) in zip(grid.flat, shown, strict=False):
            axes.set_title(title)
            for name, those in _by(of, line):
                points = [(at, _values(each, y)) for at, each in _by(those, x)]
                points = [(at, values) for at, values in points if values]
                if points:
                    i = names.index(name)
                    _mean_line(
                        axes, *zip(*points, strict=True), label=_title(name),
                        color=CYCLE[i % len(CYCLE)], linestyle=_DASHES[i % len(_DASHES)],
                    )  # fmt: skip
            _log_ticks(axes, sorted({row[x] for row in of if row.get(y) is not None}))
            if mark is not None:
                axes.axvline(mark, color=GREY, linewidth=1, zorder=0)
            axes.set_xlabel(x)
        legend_below(drawing, grid.flat[: len(shown)], 3)
    return drawing


def _log_ticks(axes: Axes, values: Sequence[float]) -> None:
    """Make the horizontal axis logarithmic, with a tick at each of these values and at no other."""
    labels, labelled = [], 0.0
    for value in values:
        # a label that would touch the last one is left out
        apart = not labelled or value / labelled > (values[-1] / values[0]) ** _APART
        # small values as fractions, whose labels are shorter
        text = f"1/{1 / value:g}" if value < 1 and 1 / value % 1 == 0 else f"{value:g}"
        labels.append(text if apart else "")
        labelled = value if apart else labelled
    axes.set_xscale("log")
    axes.set_xticks(values, labels, fontsize=9)
    axes.minorticks_off()


def _mean_line(
    axes: Axes, across: Sequence[float], trials: Sequence[Sequence[float]], **curve: Any
) -> None:
    """Draw the mean of the trials at each point, with their standard deviation as a bar."""
    points = [mean_and_spread(values) for values in trials]
    means, spreads = ([pair[i] for pair in points] for i in (0, 1))
    axes.errorbar(across, means, spreads, marker="o", ms=3.5, **curve)


def mean_and_spread(trials: Sequence[float]) -> tuple[float, float]:
    """Return the mean of some trials, and their sample standard deviation; 0 for a single trial.

    Examples
    --------
    >>> mean_and_spread([1.0, 2.0, 3.0]), mean_and_spread([2.0])
    ((2.0, 1.0), (2.0, 0.0))
    """
    return float(np.mean(trials)), float(np.std(trials, ddof=1)) if len(trials) > 1 else 0.0


def _by(rows: Rows, column: str) -> Iterable[tuple[Any, Rows]]:
    """Group rows by the value of a column, in the order in which the values appear."""
    groups: dict[Any, list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row[column], []).append(row)
    return groups.items()


def _values(rows: Rows, column: str) -> list[float]:
    return [float(row[column]) for row in rows if row.get(column) is not None]


def _title(name: object) -> str:
    return name_label(str(name))
