"""What a few bits a counter are worth: right matches against bytes a place, on real data.

Each map is made once. Its counts and those of the query are then converted to every code, so that
all codes are compared at the same pixels and events.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.pipeline import coded_map, describe
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.report.style import legend_below, log_ticks, look, mean_line, panels, save
from edge_vpr_tools.research.experiments.drives import Pair, check_data, pairs
from edge_vpr_tools.research.experiments.trial import Summary, markdown_table
from fixedpoint.codes import packed_bytes

__all__ = ["check_data", "run"]

BITS = (1, 2, 3, 4, 6, 8)
FULL_SCALES = (15, 31, 63, 127, 255, 511)
CODES: Mapping[str, Mapping[str, Any]] = {
    "saturating": {"counter_code": "linear"},
    "square root": {"counter_code": "sqrt"},
    "logarithm": {"counter_code": "log"},
    "linear, per pixel": {"counter_code": "linear", "counter_scaling": "per-pixel"},
    "square root, per pixel": {"counter_code": "sqrt", "counter_scaling": "per-pixel"},
    "logarithm, per pixel": {"counter_code": "log", "counter_scaling": "per-pixel"},
}
#: reference code for the comparison: counts of 8 bits
RAW = ("saturating", 8)

#: P@100R of each draw, by code and bits (or full scale)
Scores = dict[tuple[str, int], list[float]]


def score(pair: Pair, seeds: int, variants: Mapping[tuple[str, int], Mapping[str, Any]]) -> Scores:
    """Match a pair with every code.

    Parameters
    ----------
    pair : Pair
    seeds : int
        Number of draws of pixels.
    variants : mapping of (name, number) to settings of a code

    Returns
    -------
    dict of (name, number) to list of float
        P@100R of each draw.
    """
    found: Scores = {variant: [] for variant in variants}
    for seed in range(seeds if pair.drawn else 1):
        settings = pair.settings.replaced({"seed": seed}, "seed")
        mapped = ReferenceMap.build(pair.reference, settings)
        queries = describe(pair.query, mapped.pixel_map, settings)
        truth = pair.truth_of(mapped.places.centre_us, queries.centre_us)
        for variant, changes in variants.items():
            coded = settings.replaced(changes, str(variant))
            in_code = coded_map(mapped, coded)
            matches = match_descriptors(in_code.places, in_code.coded(queries), coded)
            found[variant].append(evaluate(matches, truth).precision_at_100_recall)
    return found


def run(data: Path, seeds: int, on_start: Callable[[str], None], *figures: Path) -> str:
    """Compare every code on every pair of drives, and return Markdown tables."""
    by_width = {
        (name, bits): {**code, "counter_bits": bits}
        for name, code in CODES.items()
        for bits in BITS
    }
    by_scale = {
        (name, scale): {**CODES[name], "counter_bits": 3, "counter_full_scale": scale}
        for name in ("square root", "logarithm")
        for scale in FULL_SCALES
    }
    widths: dict[str, Scores] = {}
    scales: dict[str, Scores] = {}
    pixels: dict[str, int] = {}
    for pair in pairs(data):
        on_start(pair.name)
        widths[pair.name] = score(pair, seeds, by_width)
        scales[pair.name] = score(pair, seeds, by_scale)
        pixels[pair.name] = pair.settings.pixels
    if figures:
        save(draw(widths, pixels), *figures)
    return "\n\n".join(
        [
            "P@100R by code and bits a counter:",
            _table(widths, lambda name, bits: f"{name}, {bits} bit{'s' * (bits > 1)}"),
            "Bytes a place, packed:",
            _bytes_table(sorted(set(pixels.values()))),
            "P@100R of codes of 3 bits by full scale:",
            _table(scales, lambda name, scale: f"{name} up to {scale}"),
        ]
    )


def draw(found: Mapping[str, Scores], pixels: Mapping[str, int]) -> Figure:
    """Draw P@100R against packed bytes a place, with a panel for each pair of drives."""
    columns = (len(found) + 1) // 2
    with panels(2, columns, max(11.5, 3.8 * columns), 8.0) as (drawing, grid):
        for empty in grid.T.flat[len(found) :]:
            empty.remove()
        for axes, (pair, scores) in zip(grid.T.flat, found.items(), strict=False):
            for i, name in enumerate(CODES):
                values = [scores[name, bits] for bits in BITS]
                mean_line(
                    axes,
                    # shifted a little, so that the spreads can be distinguished
                    [packed_bytes(pixels[pair], bits) * 1.015 ** (i - 2.5) for bits in BITS],
                    values,
                    lw=1.6,
                    elinewidth=0.8,
                    label=name,
                    **look(i),
                )
            raw = float(np.mean(scores[RAW]))
            axes.axhline(raw, color="gray", lw=0.9)
            log_ticks(axes, [packed_bytes(pixels[pair], bits) for bits in BITS], base=2)
            axes.set(title=pair, xlabel=f"bytes a place ({', '.join(map(str, BITS))} bits)")
            lowest = min(float(np.mean(values)) for values in scores.values())
            axes.set_ylim(max(0.2, lowest - 0.07), 1.01)
        for axes in grid[:, 0]:
            axes.set_ylabel("P@100R (grey: counts of 8 bits)")
        legend_below(drawing, grid[0], 3)
        drawing.suptitle("Right matches against memory, for each code of the event counts")
    return drawing


def _table(found: Mapping[str, Scores], title: Callable[[str, int], str]) -> str:
    rows = []
    for variant in next(iter(found.values())):
        values = [scores[variant] for scores in found.values()]
        mean = float(np.mean([np.mean(v) for v in values]))
        rows.append([title(*variant), *(str(Summary(v)) for v in values), f"{mean:.3f}"])
    return markdown_table(("code", *found, "mean"), rows)


def _bytes_table(pixels: Sequence[int]) -> str:
    rows = [[str(bits), *(str(packed_bytes(j, bits)) for j in pixels)] for bits in BITS]
    return markdown_table(("bits", *(f"{j} pixels" for j in pixels)), rows)
