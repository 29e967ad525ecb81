"""Accuracy of codes of a few bits: correct matches against bytes per place, on real data.

Each map is made once. Its counts and those of the query are then converted to every code, so that
all codes are compared at the same pixels and events.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from matplotlib.figure import Figure

from fixedpoint.codes import packed_bytes
from lab.drives import recorded_drives
from lab.loop import Draw, Experiment, Row, Rows
from lab.pairs import Pair
from lab.plots import lines

BITS = (1, 2, 3, 4, 6, 8)
CODES: Mapping[str, Mapping[str, Any]] = {
    "linear": {"counter_code": "linear"},
    "sqrt": {"counter_code": "sqrt"},
    "log": {"counter_code": "log"},
    "linear, per-pixel": {"counter_code": "linear", "counter_scaling": "per-pixel"},
    "sqrt, per-pixel": {"counter_code": "sqrt", "counter_scaling": "per-pixel"},
    "log, per-pixel": {"counter_code": "log", "counter_scaling": "per-pixel"},
}


def variants() -> dict[tuple[str, int], Mapping[str, Any]]:
    """Return every code with every number of bits."""
    return {
        (name, bits): {**code, "counter_bits": bits}
        for name, code in CODES.items()
        for bits in BITS
    }


def measure(draw: Draw) -> Iterator[Row]:
    """Match a pair with every code."""
    pair: Pair = draw.pair
    mapped = pair.mapped(pair.drawn_with(draw.seed))
    for (code, bits), changes in variants().items():
        yield {
            "code": code,
            "bits": bits,
            "P@100R": mapped.coded(changes).correct(),
            "bytes per place": packed_bytes(pair.settings.pixels, bits),
        }


def figure(rows: Rows) -> Figure:
    """Draw correct matches against bits, for every code."""
    return lines(rows, x="bits", y="P@100R", line="code")


EXPERIMENT = Experiment(
    drives=recorded_drives, names=("code", "bits"), measure=measure, figure=figure
)
