"""Accuracy of codes of a few bits: correct matches against bytes per place, on real data.

Each map is made once. Its counts and those of the query are then converted to every code, so that
all codes are compared at the same pixels and events.
"""

from __future__ import annotations

from collections.abc import Iterator

from matplotlib.figure import Figure

from fixedpoint.formats import packed_bytes
from lab.codes import Code, Kind, TableCode
from lab.drives import recorded_drives
from lab.loop import Draw, Experiment, Row, Rows
from lab.pairs import Pair
from lab.plots import lines

BITS = (1, 2, 3, 4, 6, 8)
KINDS: tuple[Kind, ...] = ("linear", "sqrt", "log")


def variants() -> dict[tuple[str, int], Code]:
    """Return every code with every number of bits."""
    return {
        (kind + ", per-pixel" * scaled, bits): TableCode(kind, bits, scaled)
        for scaled in (False, True)
        for kind in KINDS
        for bits in BITS
    }


def measure(draw: Draw) -> Iterator[Row]:
    """Match a pair with every code."""
    pair: Pair = draw.pair
    mapped = pair.mapped(pair.drawn_with(draw.seed))
    for (name, bits), code in variants().items():
        yield {
            "code": name,
            "bits": bits,
            "P@100R": mapped.coded({}, code).correct(),
            "bytes per place": packed_bytes(pair.settings.pixels, bits),
        }


def figure(rows: Rows) -> Figure:
    """Draw correct matches against bits, for every code."""
    return lines(rows, x="bits", y="P@100R", line="code")


EXPERIMENT = Experiment(
    drives=recorded_drives, names=("code", "bits"), measure=measure, figure=figure
)
