"""Figures of experiments: three kinds, each declared by the columns that it shows."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edge_vpr_tools.report.style import (
    CYCLE,
    GREY,
    MARKERS,
    dot_plot,
    legend_below,
    log_ticks,
    look,
    mean_and_spread,
    mean_line,
    name_label,
    panels,
)
from edge_vpr_tools.research.experiments.experiment import Rows

_COLUMNS = 4


def dots(rows: Rows, measures: Sequence[str], row: str, series: str | None = None) -> Figure:
    """Draw a panel per measure and pair of drives: means of trials as dots, a colour per series."""
    drives = list(_by(rows, "drives"))
    labels = list(dict.fromkeys(str(each[row]) for each in rows))

    def means(of: Rows, measure: str) -> dict[str, list[float]]:
        found = {str(label): _values(those, measure) for label, those in _by(of, row)}
        return {label: found.get(label) or [float("nan")] for label in labels}

    return dot_plot(
        {
            measure if len(drives) == 1 else f"{measure}\n{name}": {
                str(title): means(those, measure)
                for title, those in (_by(of, series) if series else [("", of)])
            }
            for measure in measures
            for name, of in drives
        }
    )


def lines(
    rows: Rows,
    x: str,
    y: str,
    line: str,
    *,
    panel: Sequence[str] = ("drives",),
    log: bool = False,
    label: str | None = None,
    columns: int = _COLUMNS,
    mark: float | None = None,
) -> Figure:
    """Draw the mean of the trials over a number: a panel each pair of drives, a line each variant.

    Parameters
    ----------
    x, y : str
        Columns of numbers.
    line : str
        Column that names the lines.
    panel : sequence of str
        Columns that have a panel for each of their values.
    log : bool
        Whether the horizontal axis is logarithmic.
    label : str, optional
        Of the horizontal axis; by default the name of its column.
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
                    mean_line(axes, *zip(*points, strict=True), label=_title(name), **style)
            if log:
                log_ticks(axes, sorted({row[x] for row in of if row.get(y) is not None}))
            if mark is not None:
                axes.axvline(mark, color=GREY, linewidth=1, zorder=0)
            axes.set_xlabel(label or x)
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
    marks = dict(zip(kinds, itertools.cycle(MARKERS), strict=False))
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
