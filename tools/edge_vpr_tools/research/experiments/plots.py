"""Figures of experiments: three kinds, each declared by the columns that it shows."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edge_vpr_tools.report.style import CYCLE, GREY, legend_below, look, name_label, panels
from edge_vpr_tools.research.experiments.experiment import Rows

_COLUMNS = 4
_MARKERS = "osD^vP"
_LINE_HEIGHT = 0.32


def dots(
    rows: Rows,
    measures: Sequence[str],
    row: str,
    series: str | None = None,
    *,
    promised: Mapping[str, float] | None = None,
) -> Figure:
    """Draw a panel per measure and pair of drives: means of trials as dots, a colour per series.

    Rows are drawn from top to bottom; a bar is the spread of the trials.

    Parameters
    ----------
    promised : mapping of str to float, optional
        Value of a measure that its panel marks; it shows the upper tenth alone.
    """
    drives = list(_by(rows, "drives"))
    labels = list(dict.fromkeys(str(each[row]) for each in rows))
    shown = [
        (
            measure,
            measure if len(drives) == 1 else f"{measure}\n{name}",
            list(_by(of, series)) if series else [("", of)],
        )
        for measure in measures
        for name, of in drives
    ]
    several = len(shown[0][-1])
    stacked = len(labels) * (1 + several) / 2
    size = 3.4 + 3.2 * len(shown), 1.4 + _LINE_HEIGHT * stacked
    with panels(1, len(shown), *size, sharey=True) as (drawing, (grid,)):
        for axes, (measure, title, parts) in zip(grid, shown, strict=True):
            for i, (name, those) in enumerate(parts):
                trials = {str(label): _values(each, measure) for label, each in _by(those, row)}
                found = [mean_and_spread(trials.get(label) or [np.nan]) for label in labels]
                axes.errorbar(
                    [mean for mean, _ in found],
                    # several dots of a row stand below each other
                    [line + 0.5 * ((i + 0.5) / len(parts) - 0.5) for line in range(len(labels))],
                    xerr=[spread for _, spread in found],
                    color=CYCLE[i % len(CYCLE)],
                    marker=_MARKERS[i % len(_MARKERS)],
                    ms=5,
                    linestyle="none",
                    label=_title(name),
                )
            axes.set(xlabel=title, xlim=(-0.03, 1.03))
            if promised and measure in promised:
                axes.axvline(promised[measure], color=GREY, linewidth=1.0, zorder=1)
                axes.set_xlim(0.897, 1.003)
        grid[0].set_yticks(range(len(labels)), [name_label(label) for label in labels], fontsize=9)
        grid[0].set_ylim(len(labels) - 0.5, -0.5)
        if several > 1:
            legend_below(drawing, grid, several)
    return drawing


def lines(
    rows: Rows,
    x: str,
    y: str,
    line: str,
    *,
    panel: Sequence[str] = ("drives",),
    columns: int = _COLUMNS,
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
    columns : int
        Most panels beside each other.
    mark : float, optional
        Where a vertical line is drawn, as at the default.
    """
    shown = [{**row, "": "\n".join(str(row[each]) for each in panel)} for row in rows]
    names = list(dict.fromkeys(row[line] for row in rows))
    with _grid(shown, "", y, (4.0, 3.6), 1.2, columns) as (drawing, grid):
        for axes, of in grid:
            for name, those in _by(of, line):
                points = [(at, _values(each, y)) for at, each in _by(those, x)]
                points = [(at, values) for at, values in points if values]
                if points:
                    style = look(names.index(name))
                    _mean_line(axes, *zip(*points, strict=True), label=_title(name), **style)
            _log_ticks(axes, sorted({row[x] for row in of if row.get(y) is not None}))
            if mark is not None:
                axes.axvline(mark, color=GREY, linewidth=1, zorder=0)
            axes.set_xlabel(x)
        legend_below(drawing, [axes for axes, _ in grid], 3)
    return drawing


def costs(rows: Rows, x: str, y: str, label: str, series: str) -> Figure:
    """Draw a measure against a cost: a panel each pair of drives, a mark each system."""
    names = list(dict.fromkeys(row[label] for row in rows))
    colours: dict[str, dict[str, Any]] = {
        # those that have the colour of another are hollow
        name: {
            "color": CYCLE[i % len(CYCLE)],
            "markerfacecolor": "none" if i >= len(CYCLE) else None,
        }
        for i, name in enumerate(names)
    }
    kinds = dict.fromkeys(row[series] for row in rows)
    marks = dict(zip(kinds, itertools.cycle(_MARKERS), strict=False))
    with _grid(rows, "drives", y, (4.2, 3.9), 2.2) as (drawing, grid):
        for axes, of in grid:
            for name, those in _by(of, label):
                for kind, each in _by(those, series):
                    mean, spread = mean_and_spread(_values(each, y))
                    axes.errorbar(
                        float(np.median(_values(each, x))), mean, spread, ms=7, linestyle="none",
                        marker=marks[kind], **colours[name],
                    )  # fmt: skip
            axes.set_xscale("log")
            axes.set(xlabel=x, ylim=(0, 1.03))
        first, _ = grid[0]
        for name, colour in colours.items():
            first.plot([], [], linestyle="none", marker="o", label=_title(name), **colour)
        for kind, mark in marks.items():
            first.plot([], [], linestyle="none", marker=mark, color=GREY, label=_title(kind))
        legend_below(drawing, [first], 3, fontsize=9)
    return drawing


def _log_ticks(axes: Axes, values: Sequence[float]) -> None:
    """Make the horizontal axis logarithmic, with a tick at each of these values and at no other."""
    # small values as fractions, whose labels are shorter
    labels = [f"1/{1 / v:g}" if v < 0.1 and 1 / v % 1 == 0 else f"{v:g}" for v in values]
    axes.set_xscale("log")
    axes.set_xticks(values, labels)
    axes.minorticks_off()


def _mean_line(
    axes: Axes, across: Sequence[float], trials: Sequence[Sequence[float]], **curve: Any
) -> None:
    """Draw the mean of the trials at each point, with their standard deviation as a bar."""
    found = [mean_and_spread(values) for values in trials]
    means, spreads = ([pair[i] for pair in found] for i in (0, 1))
    axes.errorbar(across, means, spreads, marker="o", ms=3.5, **curve)


def mean_and_spread(trials: Sequence[float]) -> tuple[float, float]:
    """Return the mean of some trials, and their sample standard deviation; 0 for a single trial.

    Examples
    --------
    >>> mean_and_spread([1.0, 2.0, 3.0]), mean_and_spread([2.0])
    ((2.0, 1.0), (2.0, 0.0))
    """
    return float(np.mean(trials)), float(np.std(trials, ddof=1)) if len(trials) > 1 else 0.0


@contextmanager
def _grid(
    rows: Rows,
    column: str,
    y: str,
    size: tuple[float, float],
    below: float,
    columns: int = _COLUMNS,
) -> Iterator[tuple[Figure, list[tuple[Axes, Rows]]]]:
    """Lay out a panel for each value of a column, and yield each with its rows; sizes in inches."""
    found = list(_by(rows, column))
    columns = min(len(found), columns)
    across = -(-len(found) // columns)
    whole = size[0] * columns + 1.5, size[1] * across + below
    with panels(across, columns, *whole, sharey=True) as (drawing, grid):
        for empty in grid.flat[len(found) :]:
            empty.remove()
        for left in grid[:, 0]:
            left.set_ylabel(y)
        shown = []
        for axes, (value, of) in zip(grid.flat, found, strict=False):
            axes.set_title("\n".join(map(_title, str(value).split("\n"))))
            shown.append((axes, of))
        yield drawing, shown


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
