"""Comparison of runs: sweeps, and folders of `edge-vpr match` that were evaluated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from edge_vpr import results
from edge_vpr.errors import UsageError, printable
from edge_vpr.files import read_json, understood
from edge_vpr_tools.report.style import CYCLE, figure, name_label
from edge_vpr_tools.research.sweep.plan import sweep_store
from edge_vpr_tools.research.trials import SWEEP, ListedTrial

# Comparison of runs: sweeps, and folders of `edge-vpr match` that were evaluated.


#: figures of merit by their name in a file, with the heading of their column
MEASURES = {
    "precision_at_100_recall": "P@100R",
    "recall_at_99_precision": "R@99P",
    "average_precision": "AP",
    "recall_at_1": "Recall@1",
    "packed_bytes_per_place": "bytes per place",
    "operations_per_match": "operations per match",
    "microseconds_per_match": "µs per match",
}
#: shown with thousands and without decimals
_WHOLE = ("operations_per_match",)
#: more rows than this are illegible in one figure
MOST_DRAWN = 60
_REMEDY = "evaluate it again"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One variant on one pair of drives.

    Attributes
    ----------
    run : str
        Name of the run's folder; its path if two folders have the same name.
    variant, drives : str
        Empty for a single match.
    values : mapping of str to tuple of float
        Values of `MEASURES`, one for each seed.
    failed : int
        Number of seeds without a result.
    seeds : tuple of int
        Seed of each value.
    settings : mapping of str to object
        By the names of `edge_vpr.settings.Settings`; empty if there is no result.
    system : str
        Name of a baseline, which uses some of the settings; empty for the method itself.
    """

    run: str
    variant: str
    drives: str
    values: Mapping[str, tuple[float, ...]]
    failed: int = 0
    seeds: tuple[int, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    system: str = ""

    @property
    def name(self) -> str:
        """Name of the row in a figure."""
        return ", ".join(part for part in (self.run, self.variant, self.drives) if part)

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

    Parameters
    ----------
    runs : sequence of Path
        Folders of `edge-vpr sweep`, or of `edge-vpr match` after `edge-vpr evaluate`.

    Raises
    ------
    UsageError
        If a folder is neither, or a file in it is damaged.
    """
    found: list[Row] = []
    last = [run.resolve().name for run in runs]
    for run, short in zip(runs, last, strict=True):
        name = short if last.count(short) == 1 else str(run)
        if (run / SWEEP).is_file():
            found += _of_sweep(run, name)
        elif (run / results.METRICS).is_file():
            found.append(_of_match(run, name))
        else:
            raise UsageError(f"{run} is no run: name a folder of edge-vpr sweep or edge-vpr match")
    return found


def table_of(rows: Iterable[Row]) -> tuple[list[str], list[list[str]]]:
    """Return heading and cells of a table: means, and their spread if there are several seeds."""
    head = ["run", "variant", "drives", "seeds", *MEASURES.values()]
    lines = []
    for row in rows:
        seeds = len(next(iter(row.values.values())))
        counted = f"{seeds}" + (f" ({row.failed} failed)" if row.failed else "")
        lines.append([row.run, row.variant, row.drives, counted, *_cells(row)])
    return head, lines


def spreadsheet_of(rows: Iterable[Row]) -> tuple[list[str], list[list[str | float | None]]]:
    """Return heading and cells of a spreadsheet, with mean and spread in separate columns."""
    head = ["run", "variant", "drives", "seeds", "failed"]
    head += [f"{name}_{what}" for name in MEASURES for what in ("mean", "std")]
    lines: list[list[str | float | None]] = []
    for row in rows:
        numbers = [value for name in MEASURES for value in (row.mean(name), row.spread(name))]
        seeds = len(next(iter(row.values.values())))
        lines.append(
            [row.run, row.variant, row.drives, seeds, row.failed,
             *(None if np.isnan(value) else value for value in numbers)]
        )  # fmt: skip
    return head, lines


def draw(rows: Sequence[Row], measure: str = "precision_at_100_recall") -> Figure:
    """Draw a measure of each row: a dot for each seed, and the mean.

    Parameters
    ----------
    rows : sequence of Row
        If there are more than `MOST_DRAWN`, only the best are drawn.
    measure : str
        One of `MEASURES`.
    """
    known = [row for row in rows if row.values[measure]]
    shown = sorted(known, key=lambda row: -row.mean(measure))[:MOST_DRAWN]
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
        left_out = f"\n(the best {len(shown)} of {len(known)})" if len(shown) < len(known) else ""
        axes.set_yticks(range(len(shown)), labels, fontsize=8)
        axes.invert_yaxis()
        axes.set_title(
            f"{MEASURES[measure]}: a dot a seed, a bar their mean{left_out}", fontsize=10
        )
        axes.set(xlabel=MEASURES[measure])
    return drawing


def _of_sweep(run: Path, name: str) -> list[Row]:
    store = sweep_store(run)
    groups: dict[tuple[str, str], list[ListedTrial]] = {}
    for trial in store.listed():
        groups.setdefault((trial.variant, trial.drives), []).append(trial)
    rows = []
    for (variant, drives), listed in groups.items():
        known = [(one.seed, kept) for one in listed if (kept := store.kept(one.key)) is not None]
        measured = []
        for _, (trial, found) in known:
            operations = found.operations
            if operations is None:
                operations = _operations(found.pixels, found.places, trial.settings)
            measured.append({**asdict(found), "operations_per_match": operations})
        last = known[-1][1][0] if known else None
        rows.append(
            Row(
                run=name,
                variant=variant,
                drives=drives,
                values={each: tuple(float(one[each]) for one in measured) for each in MEASURES},
                failed=len(listed) - len(known),
                seeds=tuple(seed for seed, _ in known),
                settings={} if last is None else last.settings,
                system=(last and last.system) or "",
            )
        )
    return rows


def _of_match(run: Path, name: str) -> Row:
    path = run / results.METRICS
    metrics = read_json(path, "metrics", _REMEDY)
    if "evaluation" not in metrics:
        raise UsageError(f"{run} is not evaluated: run edge-vpr evaluate {run} first")
    made = run / results.RUN
    record = read_json(made, "run", "match again")
    with understood(made, "run", "match again"):
        settings = dict(record["settings"])
    with understood(path, "metrics", _REMEDY):
        evaluation = metrics["evaluation"]
        values = {name: evaluation[name] for name in list(MEASURES)[:3]}
        values["recall_at_1"] = evaluation["recall_at"]["1"]
        if "packed_bytes_per_place" in metrics:  # absent for matches event by event
            values["packed_bytes_per_place"] = metrics["packed_bytes_per_place"]
            values["microseconds_per_match"] = 1e6 * metrics["matching_s"] / metrics["queries"]
            values["operations_per_match"] = _operations(
                metrics["pixels"], metrics["places"], settings
            )
        numbers = {name: (float(values[name]),) if name in values else () for name in MEASURES}
    seeds = (int(settings.get("seed", 0)),)
    return Row(run=name, variant="", drives="", values=numbers, seeds=seeds, settings=settings)


def _operations(pixels: int, places: int, settings: Mapping[str, Any]) -> int:
    """Return the number of differences of counters between one query window and all places."""
    return (2 if settings.get("polarity") else 1) * pixels * places


def digits_of(measure: str) -> int:
    """Return the number of decimals that a measure is shown with."""
    return 0 if measure in _WHOLE else 3 if measure in list(MEASURES)[:4] else 1


def _cells(row: Row) -> list[str]:
    cells = []
    for name in MEASURES:
        mean, spread = row.mean(name), row.spread(name)
        digits = digits_of(name)
        if np.isnan(mean):
            cells.append("-")
        elif np.isnan(spread):
            cells.append(f"{mean:,.{digits}f}")
        else:
            cells.append(f"{mean:,.{digits}f} ± {spread:,.{digits}f}")
    return cells


def markdown(rows: Sequence[Row]) -> str:
    """Return the table as Markdown."""
    head, lines = table_of(rows)
    # names come from files: a bar would end a cell, and an escape sequence would reach the terminal
    cells = [[printable(cell, 200).replace("|", "\\|") for cell in line] for line in [head, *lines]]
    cells.insert(1, ["---"] * len(head))
    return "".join(f"| {' | '.join(line)} |\n" for line in cells)
