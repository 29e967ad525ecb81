"""One look for every figure: colour-blind safe (Okabe and Ito, 2008), legible in print."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from edge_vpr.errors import UsageError, printable
from edge_vpr.files import replacing
from edge_vpr_tools.report import FORMATS

BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#56B4E9",
    "#000000",
)
#: less important elements, on white and on black background
GREY = "#808080"
CYCLE = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK)

#: dots per inch, in a vector format those of images
_DPI = 130

#: Settings of Matplotlib for all figures.
STYLE: dict[Any, Any] = {
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
    with panels(1, 1, width, height) as (drawing, ((axes,),)):
        yield drawing, axes


@contextmanager
def panels(
    rows: int, columns: int, width: float, height: float, **shared: Any
) -> Iterator[tuple[Figure, npt.NDArray[Any]]]:
    """Return a figure in the common style, and its axes by row and column; see `figure`."""
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(width, height))
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


def save(drawing: Figure, *paths: Path) -> bytes:
    """Write a figure to files, each atomically, in the format of its suffix (PNG, PDF or SVG).

    The files of one figure are the same whenever they are written: they hold no date, and all have
    the layout of the SVG.

    Returns
    -------
    bytes
        The figure as SVG, with text as text, for `Page.picture`.
    """
    for path in paths:
        if _format_of(path) not in FORMATS:
            raise UsageError(
                f"figure {path} does not end in .{', .'.join(FORMATS)}: name it for example "
                f"{path.stem}.pdf"
            )
    target = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "edge-vpr", "svg.fonttype": "none"}):
        drawing.set_dpi(_DPI)
        # `savefig` would draw everything once more, to lay it out
        canvas: Any = FigureCanvasSVG(drawing)
        canvas.print_svg(target, metadata={"Date": None})
    drawing.set_layout_engine("none")  # the layout stays
    svg = target.getvalue()
    for path in paths:
        kind = _format_of(path)
        with replacing(path) as temporary:
            temporary.write_bytes(svg if kind == "svg" else _drawn(drawing, kind))
    return svg


def _format_of(path: Path) -> str:
    return path.suffix.lower().removeprefix(".")


def _drawn(drawing: Figure, kind: str) -> bytes:
    """Return a figure as the bytes of a PNG or PDF file."""
    target = io.BytesIO()
    undated = {"CreationDate": None} if kind == "pdf" else None
    with mpl.rc_context({"pdf.fonttype": 42}):
        drawing.savefig(target, format=kind, dpi=_DPI, metadata=undated)
    return target.getvalue()
