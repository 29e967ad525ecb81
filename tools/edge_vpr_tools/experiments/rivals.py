"""Systems side by side on the same windows: how often each is right, and what a match costs.

All systems get the same counted and cleaned windows, sequence length and ground truth (see
`counted_pairs`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from edge_vpr.baselines import baseline_names, open_baseline
from edge_vpr_tools.experiments.counted_pairs import CountedPair, draws
from edge_vpr_tools.experiments.drive_pairs import absent_data
from edge_vpr_tools.experiments.systems import (
    Result,
    Results,
    compare_systems,
    draw_curves,
    draw_memory,
    draw_time,
    systems_table,
)
from edge_vpr_tools.report.style import save

#: baselines that draw pixels, so that several draws differ
DRAWN = ("paper", "seed-code")


def compare_all(pair: CountedPair, seed: int, names: Sequence[str]) -> dict[str, Result]:
    """Match a pair with every baseline of these names that can be used on its sensor."""
    return compare_systems(pair, ((name, open_baseline(name, seed)) for name in names))


def run(
    data: Path | None,
    seeds: int,
    on_start: Callable[[str], None],
    *figures: Path,
    baselines: Sequence[str] = (),
) -> str:
    """Compare systems on simulated pairs, and on recorded ones if a folder is given.

    The figure is that of `draw`. Right matches against the time of a query, and the curves of
    precision and recall, are written beside it, with ``_time`` and ``_curves`` in their names.
    """
    titles = {name: open_baseline(name).title for name in [*baseline_names(), *baselines]}
    found: dict[str, dict[str, list[Result]]] = {}
    for each in draws(data, seeds, on_start):
        drawn = [n for n in titles if each.is_new or n in DRAWN]
        results = found.setdefault(each.name, {})
        for name, result in compare_all(each.pair, each.seed, drawn).items():
            results.setdefault(name, []).append(result)
    if figures:
        save(draw(found, titles), *figures)
        save(draw_time(found, titles), *(p.with_stem(f"{p.stem}_time") for p in figures))
        save(draw_curves(found, titles), *(p.with_stem(f"{p.stem}_curves") for p in figures))
    tables = "\n\n".join(
        f"{pair}:\n\n{systems_table(results, titles)}" for pair, results in found.items()
    )
    return tables + absent_data(data, found)


def draw(found: Mapping[str, Results], titles: Mapping[str, str]) -> Figure:
    """Draw right matches against bytes a place, with a panel for each pair of drives."""
    return draw_memory(found, titles)
