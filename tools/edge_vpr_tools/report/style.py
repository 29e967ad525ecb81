"""One look for every figure: colour-blind safe (Okabe and Ito, 2008), legible in print."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

from edge_vpr.archive import replacing
from edge_vpr.errors import UsageError, printable
from edge_vpr_tools.report.formats import FORMATS

BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#56B4E9",
    "#000000",
)
CYCLE = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK)
#: 7 colours and 5 dashes make 35 different curves, which are distinguishable where they overlap
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1)))
MARKERS = "osD^vP"

_RC: dict[Any, Any] = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}


@contextmanager
def figure(width: float = 7.5, height: float = 4.5) -> Iterator[tuple[Figure, Axes]]:
    """Return a figure with one pair of axes in the common style; sizes in inches."""
    with mpl.rc_context(_RC):
        drawing = Figure(figsize=(width, height))
        FigureCanvasAgg(drawing)
        yield drawing, drawing.add_subplot()


@contextmanager
def panels(
    rows: int, columns: int, width: float, height: float, **shared: Any
) -> Iterator[tuple[Figure, npt.NDArray[Any]]]:
    """Return a figure in the common style, and its axes by row and column; see `figure`."""
    with figure(width, height) as (drawing, only):
        only.remove()
        yield drawing, drawing.subplots(rows, columns, squeeze=False, **shared)


def legend_below(drawing: Figure, shown: Iterable[Axes], columns: int, **options: Any) -> None:
    """Put one legend of some panels below all, with each of their labels once."""
    entries: dict[str, Artist] = {}
    for axes in shown:
        handles, labels = axes.get_legend_handles_labels()
        entries.update((str(label), each) for label, each in zip(labels, handles, strict=True))
    drawing.legend(
        list(entries.values()), list(entries), loc="outside lower center", ncols=columns, **options
    )


def log_ticks(axes: Axes, values: Sequence[float], base: int = 10) -> None:
    """Make the horizontal axis logarithmic, with a tick at each of these values and at no other."""
    axes.set_xscale("log", base=base)
    axes.set_xticks(values, [f"{value:g}" for value in values])
    axes.minorticks_off()


def look(i: int) -> dict[str, Any]:
    """Return colour and dashes of the i-th curve of a figure."""
    return {"color": CYCLE[i % len(CYCLE)], "linestyle": DASHES[i % len(DASHES)]}


def mean_line(
    axes: Axes, across: Sequence[float], trials: Sequence[Sequence[float]], **curve: Any
) -> None:
    """Draw the mean of the trials at each point, with their standard deviation as a bar.

    Parameters
    ----------
    axes : Axes
    across : sequence of float
        Points of the horizontal axis.
    trials : sequence of sequence of float
        Figures of each point's trials.
    **curve
        Of the line; see `matplotlib.axes.Axes.errorbar`.
    """
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


def name_label(name: str) -> str:
    r"""Return a name as a label for a figure, with dollar signs escaped.

    Examples
    --------
    >>> name_label("a$1$\x1b[2J")
    'a\\$1\\$\\x1b[2J'
    """
    # a label that begins with an underscore would be left out of a legend
    shown = printable(name, 100).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown


def quantity_axis(axis: Axis, unit: str) -> None:
    """Write the unit at each tick of an axis, 2 mJ and not 0.002; logarithmic from a decade on.

    Call it when everything is drawn.
    """
    low, high = axis.get_data_interval()
    decades = math.log10(high / low) if 0 < low < high else 0.0
    if decades >= 1:
        which = "xscale" if axis is axis.axes.xaxis else "yscale"
        axis.axes.set(**{which: "log"})
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 1.5 else (1.0,)))
        axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(EngFormatter(unit))


def save(drawing: Figure, *paths: Path) -> dict[str, bytes]:
    """Write a figure to files, each atomically, in the format of its suffix (PNG, PDF or SVG).

    The files of one figure are the same whenever they are written: they hold no date.

    Returns
    -------
    dict of str to bytes
        What was written, by format: drawing takes longer than anything else in a report.
    """
    found: dict[str, bytes] = {}
    for path in paths:
        kind = path.suffix.lower().removeprefix(".")
        if kind not in FORMATS:
            raise UsageError(
                f"figure {path} does not end in .{', .'.join(FORMATS)}: name it for example "
                f"{path.stem}.pdf"
            )
        if kind not in found:
            found[kind] = drawn(drawing, kind)
        with replacing(path) as temporary:
            temporary.write_bytes(found[kind])
    return found


def drawn(drawing: Figure, kind: str) -> bytes:
    """Return a figure as the bytes of a file.

    Parameters
    ----------
    drawing : Figure
    kind : str
        One of `FORMATS`.
    """
    date = {"pdf": "CreationDate", "svg": "Date"}.get(kind)
    target = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "edge-vpr", "pdf.fonttype": 42}):
        drawing.savefig(
            target, format=kind, dpi=130, metadata=None if date is None else {date: None}
        )
    return target.getvalue()
