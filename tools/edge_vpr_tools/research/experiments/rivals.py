"""Systems side by side on the same windows: how often each is right, and what a match costs.

All systems get the same counted and cleaned windows, sequence length and ground truth (see
`counted_pairs`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.metrics import Evaluation, evaluate, mean_precision
from edge_vpr_tools.report.style import (
    CYCLE,
    MARKERS,
    legend_below,
    look,
    mean_and_spread,
    name_label,
    panels,
    save,
)
from edge_vpr_tools.research.baselines import (
    Baseline,
    Compared,
    baseline_names,
    compare,
    open_baseline,
)
from edge_vpr_tools.research.experiments.drives import CountedPair, absent_data, draws
from edge_vpr_tools.research.experiments.trial import Summary, markdown_table

# What systems did on pairs of drives: a table, right matches against cost, and their curves.


Result = tuple[Compared, Evaluation]
#: trials by the name of the system
Results = Mapping[str, Sequence[Result]]
#: recall of the points of a curve, from 0 to 1
_RECALL = np.linspace(0.0, 1.0, 501)
_HEADER = (
    "system", "P@100R", "R@99P", "bytes a place", "operations a match", "describing",
    "matching", "time a query",
)  # fmt: skip
#: of a `Compared`: the last columns
_TIMES = tuple(map(attrgetter, ("describe_us", "match_us", "query_us")))


def compare_systems(
    pair: CountedPair, systems: Iterable[tuple[str, Baseline]]
) -> dict[str, Result]:
    """Match a pair with every system that can be used on its sensor.

    Returns
    -------
    dict of name to (Compared, Evaluation)
        Without the systems that do not fit: pixels with large surrounds do not fit every sensor.
    """
    reference, query = pair.reference, pair.query
    truth = pair.truth_of(reference.centre_us, query.centre_us)
    found = {}
    for name, system in systems:
        try:
            compared = compare(
                system, reference.images, query.images, query.centre_us, pair.settings
            )
        except UsageError:
            continue
        found[name] = compared, evaluate(compared.matches, truth)
    return found


def systems_table(results: Results, titles: Mapping[str, str]) -> str:
    """Return a Markdown table with a row for each system, and the spread of its trials.

    Times are medians over the trials.

    Parameters
    ----------
    results : mapping of name to sequence of (Compared, Evaluation)
    titles : mapping of name to str
        Titles of all systems, in the order of the rows. A system without results did not fit the
        sensor.
    """
    rows = []
    for name, title in titles.items():
        if name not in results:
            rows.append([title, "does not fit", *["-"] * (len(_HEADER) - 2)])
            continue
        trials = results[name]
        rows.append(
            [
                title,
                str(Summary([e.precision_at_100_recall for _, e in trials])),
                str(Summary([e.recall_at_99_precision for _, e in trials])),
                f"{max(c.bytes_per_place for c, _ in trials):,}",
                f"{trials[0][0].operations:,}",
                *(_time([time_us(c) for c, _ in trials]) for time_us in _TIMES),
            ]
        )
    return markdown_table(_HEADER, rows)


def _time(trials_us: Sequence[float]) -> str:
    """Return the median of some times, in microseconds."""
    median = float(np.median(trials_us))
    return f"{median:,.{0 if median >= 10 else 1}f} us"


def draw_memory(found: Mapping[str, Results], titles: Mapping[str, str]) -> Figure:
    """Draw right matches against bytes a place, with a panel for each pair of drives."""
    return _draw_costs(found, titles, "bytes a place", attrgetter("bytes_per_place"))


def draw_time(found: Mapping[str, Results], titles: Mapping[str, str]) -> Figure:
    """Draw right matches against the time of a query, with a panel for each pair of drives."""
    return _draw_costs(found, titles, "time a query, us", attrgetter("query_us"))


def _draw_costs(
    found: Mapping[str, Results],
    titles: Mapping[str, str],
    label: str,
    cost_of: Callable[[Compared], float],
) -> Figure:
    with panels(1, len(found), 4.2 * len(found) + 1.5, 4.8) as (drawing, (row,)):
        for axes, (pair, results) in zip(row, found.items(), strict=True):
            for i, (name, title) in enumerate(titles.items()):
                if name not in results:
                    continue
                mean, spread = mean_and_spread(
                    [e.precision_at_100_recall for _, e in results[name]]
                )
                axes.errorbar(
                    float(np.median([cost_of(compared) for compared, _ in results[name]])),
                    mean,
                    spread,
                    color=CYCLE[i % len(CYCLE)],
                    marker=MARKERS[i % len(MARKERS)],
                    ms=7,
                    linestyle="none",
                    label=name_label(title),
                )
            axes.set_xscale("log")
            axes.set(title=pair, xlabel=label, ylim=(0, 1.03))
        row[0].set_ylabel("P@100R")
        legend_below(drawing, row, 2)
    return drawing


def draw_curves(
    found: Mapping[str, Results],
    titles: Mapping[str, str],
    looks: Mapping[str, Mapping[str, Any]] | None = None,
) -> Figure:
    """Draw precision against recall of every system, with a panel for each pair of drives.

    A curve is the mean of the trials' precision at each recall.

    Parameters
    ----------
    found : mapping of pair to mapping of name to sequence of (Compared, Evaluation)
    titles : mapping of name to str
        Titles of the systems that are drawn.
    looks : mapping of name to colour and dashes, optional
        See `edge_vpr_tools.report.style.look`.
    """
    width = 4.2 * max(len(found), 2) + 1.5
    with panels(1, len(found), width, 5.4, sharey=True) as (drawing, (row,)):
        lowest = 1.0
        for axes, (pair, results) in zip(row, found.items(), strict=True):
            for i, (name, title) in enumerate(titles.items()):
                if name not in results:
                    continue
                drawn = look(i) if looks is None else looks[name]
                curves = [evaluation.curve for _, evaluation in results[name]]
                precision = mean_precision(curves, _RECALL)
                # at low recall, a curve of few matches has jumps
                lowest = min(lowest, float(precision[_RECALL > 0.05].min()))
                axes.plot(_RECALL, precision, lw=1.8, label=name_label(title), **drawn)
            axes.axhline(0.99, color="gray", lw=0.8)
            axes.set(title=pair, xlabel="recall", xlim=(0, 1.01))
        row[0].set(ylabel="precision", ylim=(max(0.0, np.floor(10 * lowest) / 10), 1.01))
        legend_below(drawing, row, 2)
    return drawing


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
