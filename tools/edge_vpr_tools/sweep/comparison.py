"""Comparison of sweeps: rows of variants on pairs of drives, with means and spreads over seeds.

Over drives, variants have means, and paired bootstrap intervals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr.records import write_json
from edge_vpr.results import RUN, run_record
from edge_vpr_tools.console import table
from edge_vpr_tools.report.spreadsheets import write_spreadsheet
from edge_vpr_tools.report.style import CYCLE, figure, name_label, save
from edge_vpr_tools.sweep import MEASURES
from edge_vpr_tools.sweep.table import SETTINGS, Line, read_lines

#: columns of a row's names
_HEAD = ("run", "variant", "drives", "tolerance", "seeds")
#: measures that a terminal has room for
_SHOWN = (
    *("precision_at_100_recall", "recall_at_99_precision", "average_precision"),
    *("queries", "packed_bytes_per_window", "microseconds_per_match"),
)
#: decimals of the measures that are no shares, which have three
_DECIMALS = {
    "queries": 0, "packed_bytes_per_window": 0, "differences_per_match": 0,
    "microseconds_per_match": 1,
}  # fmt: skip
#: more rows than this are illegible in one figure
MOST_DRAWN = 60

Floats = npt.NDArray[np.float64]


class Row(NamedTuple):
    """One variant on one pair of drives."""

    run: str  #: Name of the sweep's file; its path if two have the same name.
    variant: str
    drives: str
    tolerance: str  #: By which the shares are, with its unit.
    seeds: tuple[int, ...]
    values: Mapping[str, Floats]  #: Values of `MEASURES`, one for each seed.
    settings: Mapping[str, str]  #: Words of the settings by their keys.


def rows_of(runs: Sequence[Path]) -> list[Row]:
    """Read the rows of sweeps.

    Raises
    ------
    UsageError
        If a file is no sweep's, or is damaged.
    """
    names = [run.name for run in runs]
    groups: dict[tuple[str, str, str, str], list[Line]] = {}
    for run, short in zip(runs, names, strict=True):
        name = short if names.count(short) == 1 else str(run)
        for line in read_lines(run):
            key = name, line["variant"], line["drives"], line["tolerance"]
            groups.setdefault(key, []).append(line)
    return [
        Row(
            *key,
            seeds=tuple(int(line["seed"]) for line in lines),
            values={each: np.array([float(line[each]) for line in lines]) for each in MEASURES},
            settings={each: lines[0][each] for each in SETTINGS},
        )
        for key, lines in groups.items()
    ]


def draw(rows: Sequence[Row], measure: str = "precision_at_100_recall") -> Figure:
    """Draw a measure of the best rows: a dot for each seed, and the mean."""
    shown = sorted(rows, key=lambda row: -row.values[measure].mean())[:MOST_DRAWN]
    pairs = list(dict.fromkeys(row.drives for row in shown))
    labels = [name_label(", ".join(filter(None, row[:4]))) for row in shown]
    # five inches for the axes and their title, whatever the length of the labels
    width = 5.5 + 0.065 * max(map(len, labels), default=0)
    with figure(width, 1.7 + 0.28 * max(1, len(shown))) as (drawing, axes):
        for i, row in enumerate(shown):
            colour = CYCLE[pairs.index(row.drives) % len(CYCLE)]
            values = row.values[measure]
            axes.plot(values, [i] * len(values), ".", color=colour, ms=5, alpha=0.6)
            axes.plot(values.mean(), i, "|", color=colour, ms=14, mew=2)
        left_out = f"\n(the best {len(shown)} of {len(rows)})" if len(shown) < len(rows) else ""
        axes.set_yticks(range(len(shown)), labels, fontsize=8)
        axes.invert_yaxis()
        axes.set_title(
            f"{MEASURES[measure]}: a dot a seed, a bar their mean{left_out}", fontsize=10
        )
        axes.set(xlabel=MEASURES[measure])
    return drawing


def _cell(values: Floats, measure: str) -> str:
    """Return the mean over seeds, and the sample's standard deviation if there are several."""
    mean = values.mean()
    if np.isnan(mean):
        return "-"
    digits = _DECIMALS.get(measure, 3)
    spread = values.std(ddof=1) if values.size > 1 else 0.0
    if values.size < 2 or (spread == 0 and digits == 0):
        return f"{mean:,.{digits}f}"
    return f"{mean:,.{digits}f} ± {spread:,.{digits}f}"


def show(rows: Sequence[Row]) -> None:
    """Print the main measures as a table; a name that all rows share stands in its title."""
    names = ((*row[:4], str(len(row.seeds))) for row in rows)
    columns = dict(zip(_HEAD, zip(*names, strict=True), strict=True))
    shared = [name for name, cells in columns.items() if name != "variant" and len({*cells}) == 1]
    apart = [name for name in columns if name not in shared]
    named = zip(*(columns[name] for name in apart), strict=True)
    table(
        [*apart, *(MEASURES[name] for name in _SHOWN)],
        [
            [*names, *(_cell(row.values[name], name) for name in _SHOWN)]
            for names, row in zip(named, rows, strict=True)
        ],
        title=", ".join(f"{name} {columns[name][0]}" for name in shared if columns[name][0]),
    )


# Over drives: means, differences from the first variant, and their intervals.


#: resamples of a bootstrap, the share of them that its interval holds, and fewest pairs of drives,
#: or seeds of a single pair, that have one: resamples of fewer are too much alike
RESAMPLES, SHARE, LEAST = 10_000, 0.95, 5


class Interval(NamedTuple):
    """A mean, with the bootstrap interval of 95 %; the bounds are NaN of fewer than `LEAST`."""

    mean: float
    low: float
    high: float


class Average(NamedTuple):
    """One variant over all its drives, by one tolerance."""

    run: str
    variant: str
    tolerance: str
    #: Words of the settings that differ between the variants, by their key.
    settings: Mapping[str, str]
    drives: int  #: Number of pairs of drives.
    #: Means over drives of `MEASURES`. Each drive counts alike.
    means: Mapping[str, float]
    #: Mean of the measure less that of the first variant, over the drives and seeds that both have;
    #: None of the first itself, and without any such.
    difference: Interval | None = None


def differing_settings(rows: Sequence[Row]) -> list[str]:
    """Return the keys of the settings that are not the same in all rows, in their order."""
    return [key for key in SETTINGS if len({row.settings[key] for row in rows}) > 1]


def averages(rows: Sequence[Row], measure: str) -> list[Average]:
    """Return the mean of each variant over its drives, and its difference from the first."""
    names = differing_settings(rows)
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.run, row.variant, row.tolerance), []).append(row)
    firsts: dict[str, list[Row]] = {}
    means = []
    for (run, variant, tolerance), group in groups.items():
        first = firsts.setdefault(tolerance, group)
        means.append(
            Average(
                run=run,
                variant=variant,
                tolerance=tolerance,
                settings={name: group[0].settings[name] for name in names},
                drives=len(group),
                means={name: _mean([row.values[name] for row in group]) for name in MEASURES},
                difference=None if group is first else _difference(group, first, measure),
            )
        )
    return means


def lacks_intervals(means: Sequence[Average]) -> bool:
    """Return whether there is a difference from the first variant, and none has an interval."""
    apart = [one.difference for one in means if one.difference is not None]
    return bool(apart) and all(np.isnan(one.low) for one in apart)


def _difference(rows: Sequence[Row], first: Sequence[Row], measure: str) -> Interval | None:
    of_first = {row.drives: row for row in first}
    differences = []
    for row in rows:
        other = of_first.get(row.drives)
        if other is None:
            continue
        here, there = (
            dict(zip(each.seeds, each.values[measure], strict=True)) for each in (row, other)
        )
        shared = [here[seed] - there[seed] for seed in here if seed in there]
        if shared:
            differences.append(np.array(shared))
    return bootstrap(differences) if differences else None


def bootstrap(groups: Sequence[Floats]) -> Interval:
    """Return the mean of the means of groups, with its bootstrap interval.

    Parameters
    ----------
    groups : sequence of ndarray of float64
        Values of each pair of drives, one a seed. Drives are drawn with replacement, and seeds
        within each. A single drive stays: the interval is then over its seeds alone. With fewer
        than `LEAST` of either there is none.

    Examples
    --------
    >>> found = bootstrap([np.array([0.1, 0.2, 0.3, 0.4, 0.5])])
    >>> round(found.mean, 3), round(found.low, 3), round(found.high, 3)
    (0.3, 0.18, 0.42)
    """
    mean = _mean(groups)
    if (len(groups) if len(groups) > 1 else groups[0].size) < LEAST:
        return Interval(mean=mean, low=float("nan"), high=float("nan"))
    rng = np.random.default_rng(0)
    total = np.zeros(RESAMPLES)
    for _ in groups:
        drawn = rng.integers(len(groups), size=RESAMPLES)
        for i, group in enumerate(groups):
            times = np.flatnonzero(drawn == i)
            total[times] += group[rng.integers(group.size, size=(times.size, group.size))].mean(1)
    low, high = np.quantile(total / len(groups), [(1 - SHARE) / 2, (1 + SHARE) / 2])
    return Interval(mean=mean, low=float(low), high=float(high))


def _mean(groups: Sequence[Floats]) -> float:
    return float(np.mean([group.mean() for group in groups]))


# Files of a comparison.


NAME = "compare"


def write_comparison(
    folder: Path, rows: Sequence[Row], formats: Sequence[str], measure: str
) -> list[Average]:
    """Write ``compare.csv``, with a line for each variant, and the figure in each format.

    Parameters
    ----------
    formats : sequence of str
        Names from `report.FORMATS`.
    measure : str
        Measure of the figure and of the differences, one of `MEASURES`.

    Returns
    -------
    list of Average
        Of the variants.
    """
    head = ["run", "variant", *differing_settings(rows), "tolerance", "drive_pairs", *MEASURES]
    head += [f"{measure}_difference", "difference_low", "difference_high"]
    means = averages(rows, measure)
    lines: list[list[str | float | None]] = []
    for one in means:
        numbers = [*one.means.values(), *(one.difference or [np.nan] * 3)]
        cells = [None if np.isnan(value) else value for value in numbers]
        named = [one.run, one.variant, *one.settings.values(), one.tolerance]
        lines.append([*named, one.drives, *cells])
    write_spreadsheet(folder / f"{NAME}.csv", head, lines)
    write_json(folder / RUN, run_record({}, []))
    save(draw(rows, measure), *(folder / f"{NAME}.{kind}" for kind in formats))
    return means
