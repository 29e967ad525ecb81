"""Comparison of runs: sweeps, and folders of `edge-vpr match` that were evaluated.

Rows are variants on pairs of drives. Over drives, variants have means, paired bootstrap intervals,
curves over a setting, and a table in LaTeX.
"""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr import results
from edge_vpr.errors import UsageError, did_you_mean, printable
from edge_vpr.files import replacing
from edge_vpr.results import RUN, read_record, run_record, write_json
from edge_vpr.settings import SETTING_FIELDS, Settings
from edge_vpr_tools.console import shell_word, table
from edge_vpr_tools.report.style import CYCLE, figure, legend_below, look, name_label, save
from edge_vpr_tools.report.tables import markdown_table, write_spreadsheet
from edge_vpr_tools.sweep import MEASURES, SHARES
from edge_vpr_tools.sweep.table import SETTINGS, Line, read_lines

#: columns of a row's names
_HEAD = ("run", "variant", "drives", "tolerance", "seeds")
#: measures that a terminal has room for
_SHOWN = (
    *("precision_at_100_recall", "recall_at_99_precision", "average_precision"),
    *("queries", "packed_bytes_per_window", "microseconds_per_match"),
)
#: shown with thousands and without decimals
_WHOLE = ("queries", "packed_bytes_per_window", "differences_per_match")
#: more rows than this are illegible in one figure
MOST_DRAWN = 60
_REMEDY = "evaluate it again"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One variant on one pair of drives."""

    run: str  #: Name of the run's folder or file; its path if two have the same name.
    #: variant, drives: empty for a single match.
    variant: str
    drives: str
    tolerance: str = ""  #: By which the shares are, with its unit, where it is known.
    values: Mapping[str, tuple[float, ...]]  #: Values of `MEASURES`, one for each seed.
    seeds: tuple[int, ...] = ()  #: Seed of each value.
    #: By the names of `edge_vpr.settings.Settings`; empty if there is no result.
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the row in a figure."""
        named = (self.run, self.variant, self.drives, self.tolerance)
        return ", ".join(part for part in named if part)

    @property
    def number(self) -> int:
        """Number of results."""
        return len(next(iter(self.values.values())))

    def mean(self, measure: str) -> float:
        """Return the mean over seeds; NaN without a result."""
        values = self.values[measure]
        return float(np.mean(values)) if values else float("nan")

    def spread(self, measure: str) -> float:
        """Return the sample's standard deviation over seeds; NaN with fewer than two."""
        values = self.values[measure]
        return float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")


def rows_of(runs: Sequence[Path]) -> list[Row]:
    """Read the rows of runs.

    Raises
    ------
    UsageError
        If one is neither, or a file is damaged.
    """
    rows: list[Row] = []
    last = [run.resolve().name for run in runs]
    for run, short in zip(runs, last, strict=True):
        name = short if last.count(short) == 1 else str(run)
        if run.is_file():
            rows += _of_sweep(run, name)
        elif (run / results.METRICS).is_file():
            rows += _of_match(run, name)
        else:
            raise UsageError(
                f"{run} is no run: name a file of edge-vpr sweep, or a folder of edge-vpr match"
            )
    return rows


def draw(rows: Sequence[Row], measure: str = "precision_at_100_recall") -> Figure:
    """Draw a measure of the best rows: a dot for each seed, and the mean."""
    drawn = [row for row in rows if row.values[measure]]
    shown = sorted(drawn, key=lambda row: -row.mean(measure))[:MOST_DRAWN]
    pairs = list(dict.fromkeys(row.drives for row in shown))
    labels = [name_label(row.name) for row in shown]
    # five inches for the axes and their title, whatever the length of the labels
    width = 5.5 + 0.065 * max(map(len, labels), default=0)
    with figure(width, 1.7 + 0.28 * max(1, len(shown))) as (drawing, axes):
        for i, row in enumerate(shown):
            colour = CYCLE[pairs.index(row.drives) % len(CYCLE)]
            values = row.values[measure]
            axes.plot(values, [i] * len(values), ".", color=colour, ms=5, alpha=0.6)
            axes.plot(row.mean(measure), i, "|", color=colour, ms=14, mew=2)
        left_out = f"\n(the best {len(shown)} of {len(drawn)})" if len(shown) < len(drawn) else ""
        axes.set_yticks(range(len(shown)), labels, fontsize=8)
        axes.invert_yaxis()
        axes.set_title(
            f"{MEASURES[measure]}: a dot a seed, a bar their mean{left_out}", fontsize=10
        )
        axes.set(xlabel=MEASURES[measure])
    return drawing


@dataclass(frozen=True, kw_only=True)
class _Evaluation:
    """What `edge-vpr evaluate` wrote that is compared; None is a value that is not finite."""

    precision_at_100_recall: float | None
    recall_at_99_precision: float | None
    average_precision: float | None
    recall_at: Mapping[str, float | None]
    queries: int


@dataclass(frozen=True, kw_only=True)
class _OfTolerance(_Evaluation):
    """The same for one tolerance."""

    tolerance: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class _Metrics:
    """What is compared of ``metrics.json``; a match event by event has the evaluation alone."""

    evaluation: _Evaluation | None = None
    tolerances: tuple[_OfTolerance, ...] = ()
    packed_bytes_per_place: int | None = None
    matching_s: float = 0.0
    queries: int = 0
    pixels: int = 0
    places: int = 0


def _of_sweep(run: Path, name: str) -> list[Row]:
    groups: dict[tuple[str, str, str], list[Line]] = {}
    for line in read_lines(run):
        key = line["variant"], line["drives"], line["tolerance"]
        groups.setdefault(key, []).append(line)
    return [
        Row(
            run=name,
            variant=variant,
            drives=drives,
            tolerance=tolerance,
            values={each: tuple(float(line[each]) for line in lines) for each in MEASURES},
            seeds=tuple(int(line["seed"]) for line in lines),
            settings=Settings.from_dict(
                {key: _value(lines[0][key]) for key in SETTINGS}, f"{run}: {variant}"
            ).to_dict(),
        )
        for (variant, drives, tolerance), lines in groups.items()
    ]


def _value(word: str) -> object:
    """Return the number or truth value that a word of a setting stands for, or the word."""
    try:
        return json.loads(word)
    except ValueError:
        return word


def _of_match(run: Path, name: str) -> list[Row]:
    metrics = read_record(_Metrics, run / results.METRICS, "metrics", _REMEDY)
    evaluation = metrics.evaluation
    if evaluation is None:
        raise UsageError(f"{run} is not evaluated: run edge-vpr evaluate {shell_word(run)} first")
    made = results.read_run(run)
    settings = Settings.from_dict(made.settings, str(run / results.RUN))
    values: dict[str, float | None] = {}
    if metrics.packed_bytes_per_place is not None and metrics.queries > 0:
        size = metrics.packed_bytes_per_place * settings.window_parts
        values["packed_bytes_per_window"] = size
        values["microseconds_per_match"] = 1e6 * metrics.matching_s / metrics.queries
        codes = metrics.pixels
        values["differences_per_match"] = codes * metrics.places
    rows = []
    for one in metrics.tolerances or (evaluation,):
        shares = {
            "precision_at_100_recall": one.precision_at_100_recall,
            "recall_at_99_precision": one.recall_at_99_precision,
            "average_precision": one.average_precision,
            "queries": one.queries,
            **{f"recall_at_{n}": one.recall_at.get(f"{n}") for n in (1, 5, 10)},
        }
        measured = values | shares
        rows.append(
            Row(
                run=name,
                variant="",
                drives="",
                tolerance=f"{one.tolerance:g} {one.unit}" if isinstance(one, _OfTolerance) else "",
                values={
                    each: () if (value := measured.get(each)) is None else (float(value),)
                    for each in MEASURES
                },
                seeds=(settings.seed,),
                settings=settings.to_dict(),
            )
        )
    return rows


def digits_of(measure: str) -> int:
    """Return the number of decimals that a measure is shown with."""
    return 0 if measure in _WHOLE else 3 if measure in list(MEASURES)[:SHARES] else 1


def _cells(row: Row, measures: Sequence[str] = tuple(MEASURES)) -> list[str]:
    cells = []
    for name in measures:
        mean, spread = row.mean(name), row.spread(name)
        digits = digits_of(name)
        if np.isnan(mean):
            cells.append("-")
        elif np.isnan(spread) or (spread == 0 and name in _WHOLE):
            cells.append(f"{mean:,.{digits}f}")
        else:
            cells.append(f"{mean:,.{digits}f} ± {spread:,.{digits}f}")
    return cells


#: characters of Markdown and HTML; an underscore within a word is none
_MARKUP = re.compile(r"[\\`*<>&|\[\]~]|(?<!\w)_|_(?!\w)")


def markdown(rows: Sequence[Row]) -> str:
    """Return a table as Markdown: means, and their spread if there are several seeds."""
    lines = [[*_names(row), *_cells(row)] for row in rows]
    # names come from files: they are text, neither Markdown, HTML nor escape sequences
    cells = [[_MARKUP.sub(r"\\\g<0>", printable(cell, 200)) for cell in line] for line in lines]
    return markdown_table([*_HEAD, *MEASURES.values()], cells) + "\n"


def show(rows: Sequence[Row]) -> None:
    """Print the main measures as a table; a name that all rows share stands in its title."""
    columns = dict(zip(_HEAD, zip(*map(_names, rows), strict=True), strict=True))
    first = "variant" if any(columns["variant"]) else "run"
    shared = [name for name, cells in columns.items() if name != first and len(set(cells)) == 1]
    apart = [name for name in columns if name not in shared]
    named = zip(*(columns[name] for name in apart), strict=True)
    table(
        [*apart, *(MEASURES[name] for name in _SHOWN)],
        [[*names, *_cells(row, _SHOWN)] for names, row in zip(named, rows, strict=True)],
        title=", ".join(f"{name} {columns[name][0]}" for name in shared if columns[name][0]),
    )


def _names(row: Row) -> list[str]:
    return [row.run, row.variant, row.drives, row.tolerance, f"{row.number}"]


# Over drives: means, differences from the first variant, and their intervals.


#: resamples of a bootstrap, the share of them that its interval holds, and fewest pairs of drives,
#: or seeds of a single pair, that have one: resamples of fewer are too much alike
RESAMPLES, SHARE, LEAST = 10_000, 0.95, 5

Floats = npt.NDArray[np.float64]


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
    drives: int  #: Number of pairs of drives with a result.
    #: Means over drives of `MEASURES`; NaN without a result. Each drive counts alike.
    means: Mapping[str, float]
    #: Mean of the measure less that of the first variant, over the drives and seeds that both have;
    #: None of the first itself, and without any such.
    difference: Interval | None = None


def differing_settings(rows: Sequence[Row]) -> list[str]:
    """Return the names of the settings that are not the same in all rows, in their order."""
    settings_of_rows = [row.settings for row in rows if row.settings]
    return [
        name for name in SETTING_FIELDS
        if len({_word(settings, name) for settings in settings_of_rows}) > 1
    ]  # fmt: skip


def spreadsheet_of(rows: Sequence[Row]) -> tuple[list[str], list[list[str | float | None]]]:
    """Return heading and cells of a spreadsheet: a line for each result, a column a setting."""
    head = ["run", "variant", "drives", "tolerance", "seed", *SETTINGS, *MEASURES]
    lines: list[list[str | float | None]] = []
    for row in rows:
        words = [_word(row.settings, name) for name in SETTING_FIELDS if name != "seed"]
        for i, seed in enumerate(row.seeds):
            values = [row.values[name] for name in MEASURES]
            measured = [of[i] if i < len(of) else None for of in values]
            named = [row.run, row.variant, row.drives, row.tolerance]
            lines.append([*named, seed, *words, *measured])
    return head, lines


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
        measured = [row for row in group if any(row.values.values())]
        settings = next((row.settings for row in group if row.settings), {})
        means.append(
            Average(
                run=run,
                variant=variant,
                tolerance=tolerance,
                settings={SETTING_FIELDS[name].key: _word(settings, name) for name in names},
                drives=len(measured),
                means={
                    name: _mean([np.array(row.values[name]) for row in group]) for name in MEASURES
                },
                difference=None if group is first else _difference(group, first, measure),
            )
        )
    return means


def lacks_intervals(rows: Sequence[Row], measure: str) -> bool:
    """Return whether there is a difference from the first variant, and none has an interval."""
    apart = [one.difference for one in averages(rows, measure) if one.difference is not None]
    return bool(apart) and all(np.isnan(one.low) for one in apart)


def _difference(rows: Sequence[Row], first: Sequence[Row], measure: str) -> Interval | None:
    of_first = {row.drives: row for row in first}
    differences = []
    for row in rows:
        other = of_first.get(row.drives)
        if other is None:
            continue
        here, there = (
            dict(zip(each.seeds, each.values[measure], strict=False)) for each in (row, other)
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
    means = [float(group.mean()) for group in groups if group.size]
    return float(np.mean(means)) if means else float("nan")


def _word(settings: Mapping[str, object], name: str) -> str:
    return SETTING_FIELDS[name].word(settings[name]) if name in settings else ""


# Tables: CSV of the averages, and LaTeX.


def averages_table(
    means: Sequence[Average], measure: str
) -> tuple[list[str], list[list[str | float | None]]]:
    """Return heading and cells of the averages, for a spreadsheet."""
    keys = list(means[0].settings) if means else []
    head = ["run", "variant", *keys, "tolerance", "drive_pairs", *MEASURES]
    head += [f"{measure}_difference", "difference_low", "difference_high"]
    lines: list[list[str | float | None]] = []
    for one in means:
        apart = one.difference
        numbers = [*one.means.values()]
        numbers += [np.nan] * 3 if apart is None else [apart.mean, apart.low, apart.high]
        cells = [None if np.isnan(value) else value for value in numbers]
        named = [one.run, one.variant, *one.settings.values(), one.tolerance]
        lines.append([*named, one.drives, *cells])
    return head, lines


_LATEX = str.maketrans(
    {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    | {sign: f"\\{sign}" for sign in "&%$#_{}"}
)


def latex(means: Sequence[Average], measure: str) -> str:
    """Return a table of the averages for the package booktabs.

    A column for each setting that differs, or for the names of runs and variants if none does; one
    for each measure that is known; and the difference from the first row with its interval.
    """
    keys = list(means[0].settings) if means else []
    measures = [name for name in MEASURES if any(not np.isnan(one.means[name]) for one in means)]
    named = len({one.run for one in means}) > 1
    several = len({one.tolerance for one in means}) > 1
    head = ["run"] * named + (keys or ["variant"]) + ["tolerance"] * several + ["drives"]
    head += [*(MEASURES[name] for name in measures), f"difference of {MEASURES[measure]}"]
    lines = []
    for one in means:
        names = [one.run] * named + (list(one.settings.values()) if keys else [one.variant])
        names += [one.tolerance] * several
        cells = [printable(name, 200).translate(_LATEX) for name in [*names, f"{one.drives}"]]
        cells += ["--" if np.isnan(one.means[name]) else _number(one.means[name], name)
                  for name in measures]  # fmt: skip
        cells.append("--" if one.difference is None else _interval(one.difference, measure))
        lines.append(" & ".join(cells) + r" \\")
    form = "l" * (named + max(1, len(keys)) + several) + "r" * (2 + len(measures))
    heading = " & ".join(text.translate(_LATEX) for text in head) + r" \\"
    body = [r"\toprule", heading, r"\midrule", *lines, r"\bottomrule"]
    return "\n".join([rf"\begin{{tabular}}{{{form}}}", *body, r"\end{tabular}"]) + "\n"


def _number(value: float, measure: str, sign: str = "") -> str:
    return f"${value:{sign}.{digits_of(measure)}f}$"


def _interval(interval: Interval, measure: str) -> str:
    shown = _number(interval.mean, measure, "+")
    if np.isnan(interval.low):
        return shown
    return (
        f"{shown} [{_number(interval.low, measure, '+')}, {_number(interval.high, measure, '+')}]"
    )


# The figure of a measure over a setting.


def draw_over(rows: Sequence[Row], measure: str, over: str) -> Figure:
    """Draw a measure over a setting: the mean over drives, and its bootstrap interval.

    Parameters
    ----------
    measure : str
        One of `MEASURES`.
    over : str
        Key or name of a setting that differs between the rows. There is a line for each
        combination of the others that differ.
    """
    names = differing_settings(rows)
    keys = {SETTING_FIELDS[name].key: name for name in names}
    name = keys.get(over, over)
    if name not in names:
        raise UsageError(
            f"the runs do not differ in {over}{did_you_mean(over, keys)}: they differ in "
            f"{', '.join(keys) or 'no setting'}"
        )
    others = [other for other in names if other != name]
    measured = [row for row in rows if row.settings and row.values[measure]]
    values = [row.settings[name] for row in measured]
    numeric = all(isinstance(value, int | float) for value in values)
    words = list(dict.fromkeys(_word(row.settings, name) for row in measured))
    at = (
        [float(value) for value in values]
        if numeric
        else [float(words.index(_word(row.settings, name))) for row in measured]
    )
    several = len({row.tolerance for row in measured}) > 1
    lines: dict[tuple[str, ...], dict[float, list[Floats]]] = {}
    for row, x in zip(measured, at, strict=True):
        fixed = [f"{SETTING_FIELDS[each].key} {_word(row.settings, each)}" for each in others]
        fixed += [f"tolerance {row.tolerance}"] * several
        line = lines.setdefault((row.run, *fixed), {})
        line.setdefault(x, []).append(np.array(row.values[measure]))
    labels = _apart(list(lines))
    any_interval = False
    height = 4.5 + 0.2 * sum(1 + label.count("\n") for label in labels)
    with figure(7.5, height) as (drawing, axes):
        for i, (label, line) in enumerate(zip(labels, lines.values(), strict=True)):
            points = sorted(line)
            intervals = [bootstrap(line[x]) for x in points]
            style = look(i)
            any_interval = any_interval or not np.isnan(intervals[0].low)
            axes.plot(points, [one.mean for one in intervals], **style, marker="o", label=label)
            axes.fill_between(
                points, [one.low for one in intervals], [one.high for one in intervals],
                color=style["color"], alpha=0.15, linewidth=0,
            )  # fmt: skip
        if not numeric:
            axes.set_xticks(range(len(words)), [name_label(word) for word in words])
        bounded = ", and its bootstrap interval of 95 %" * any_interval
        axes.set_title(f"Mean over drives{bounded}", fontsize=10)
        axes.set(xlabel=SETTING_FIELDS[name].key, ylabel=MEASURES[measure])
        legend_below(drawing, [axes], 1, fontsize=9)
    return drawing


def _apart(names: Sequence[tuple[str, ...]]) -> list[str]:
    """Return labels of curves without the parts that all share, in lines of whole words."""
    shared = set(names[0]).intersection(*names[1:]) if len(names) > 1 else set()
    return [
        "\n".join(
            name_label(line)
            for line in textwrap.wrap(", ".join(part for part in name if part not in shared), 90)
        )
        for name in names
    ]


# Files of a comparison, for papers and programs.


NAME = "compare"


def comparison_record(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the contents of ``compare.json``."""
    return {"schema": 1, "measures": MEASURES, "rows": list(rows)}


def write_comparison(
    folder: Path,
    rows: Sequence[Row],
    formats: Sequence[str],
    measure: str,
    over: str | None = None,
) -> None:
    """Write ``compare.csv``, ``.json``, ``.md``, ``.tex``, and the figure in each format.

    ``compare.csv`` has a line for each result with all its settings; ``compare_means.csv`` and the
    table in LaTeX have a line for each variant, with means over drives.

    Parameters
    ----------
    formats : sequence of str
        Names from `report.FORMATS`.
    measure : str
        Measure of the figure and of the differences, one of `MEASURES`.
    over : str, optional
        Setting over which the figure shows the measure; see `draw_over`.
    """
    drawing = draw(rows, measure) if over is None else draw_over(rows, measure, over)
    means = averages(rows, measure)
    write_spreadsheet(folder / f"{NAME}.csv", *spreadsheet_of(rows))
    write_spreadsheet(folder / f"{NAME}_means.csv", *averages_table(means, measure))
    with replacing(folder / f"{NAME}.tex") as temporary:
        temporary.write_text(latex(means, measure), encoding="utf-8")
    with replacing(folder / f"{NAME}.md") as temporary:
        temporary.write_text(markdown(rows), encoding="utf-8")
    write_json(folder / f"{NAME}.json", comparison_record(rows))
    write_json(folder / RUN, run_record({}, []))
    save(drawing, *(folder / f"{NAME}.{kind}" for kind in formats))
