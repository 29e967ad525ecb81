"""The one loop of all experiments; each is a declaration of drives, measurements and a figure.

Each pair of drives with each seed is a trial, which runs on a worker. The rows of all trials are a
table with a row per variant and seed, ``NAME.csv``. Until all are there, ``NAME.jsonl`` has those
of the finished trials, one trial a line, so that an interrupted experiment goes on.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from edge_vpr_tools.report.spreadsheets import write_spreadsheet
from edge_vpr_tools.report.style import save
from edge_vpr_tools.workers import error_text, mapped, trial_line
from matplotlib.figure import Figure

from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr.records import json_text
from lab.tables import SEED, TableView, table_of

#: what a row is named by, and what was measured
Row = Mapping[str, Any]
Rows = Sequence[Row]
DRIVES = "drives"
#: column that names the data which chose the parameters of a row
CHOSEN_ON = "parameters chosen on"


@dataclass(frozen=True)
class Drives:
    """Drives of an experiment, which a worker opens when it needs them."""

    name: str
    open: Callable[[int], Any]  #: Maps a seed to what the experiment measures: a pair of drives.
    #: Whether a seed makes other drives, as of simulated streets. Else it draws other pixels.
    varied: bool = False
    drawn: bool = True  #: Whether seeds differ at all.


class Draw(NamedTuple):
    """What one trial measures."""

    pair: Any  #: As `Drives.open` returns it.
    seed: int
    #: Whether no earlier seed has these drives. Else variants that draw nothing are left out.
    is_new: bool
    systems: tuple[str, ...] = ()  #: Baselines that the user added.


@dataclass(frozen=True, eq=False)
class Experiment:
    """Declaration of an experiment."""

    #: Maps the folder of recorded drives, or None, to the drives. Raises UsageError if it needs
    #: drives that are not there.
    drives: Callable[[Path | None], Sequence[Drives]]
    names: Sequence[str]  #: Columns that name a row, in addition to the drives.
    #: Maps a `Draw` to its rows, each with all columns of `names`. What was not measured may be
    #: left out. A row of several pairs that are opened together names its own drives.
    measure: Callable[[Draw], Iterator[Row]]
    #: Maps the rows of all trials to the figure, if a page shows one.
    figure: Callable[[Rows], Figure] | None = None
    #: Maps the rows of all trials to further rows, which follow from several pairs of drives.
    conclude: Callable[[Rows], Sequence[Row]] | None = None
    #: How the table of each pair of drives is printed.
    view: TableView = field(default_factory=lambda: TableView({}))
    takes_systems: bool = False  #: Whether the user can add baselines.
    reads_data: bool = True  #: Whether a folder of recorded drives makes a difference.


def open_experiment(name: str) -> Experiment:
    """Return an experiment by its name on the command line."""
    module = import_module(f"lab.experiments.{name.replace('-', '_')}")
    experiment: Experiment = module.EXPERIMENT
    return experiment


# Trials, and the loop over them.


class Trial(NamedTuple):
    """One pair of drives of an experiment with one seed."""

    experiment: str
    drives: str
    seed: int
    systems: tuple[str, ...]
    data: Path | None


def trials_of(
    name: str, data: Path | None, seeds: int, systems: tuple[str, ...] = ()
) -> list[Trial]:
    """Return the trials of an experiment: its drives times seeds."""
    experiment = open_experiment(name)
    if systems and not experiment.takes_systems:
        raise UsageError(f"experiment {name} compares no systems: leave --with out")
    return [
        Trial(name, drives.name, seed, systems, None if data is None else data.absolute())
        for drives in experiment.drives(data if experiment.reads_data else None)
        for seed in range(seeds if drives.drawn else 1)
    ]


def run_trial(trial: Trial) -> list[Row]:
    """Measure one pair of drives with one seed."""
    experiment = open_experiment(trial.experiment)
    (drives,) = (each for each in experiment.drives(trial.data) if each.name == trial.drives)
    is_new = drives.varied or trial.seed == 0
    draw = Draw(drives.open(trial.seed), trial.seed, is_new, trial.systems)
    return [
        {**{name: row[name] for name in experiment.names}, **row}
        for row in experiment.measure(draw)
    ]


def run_experiments(
    trials: Sequence[Trial],
    folder: Path,
    workers: Executor,
    *,
    resume: bool,
    progress: Callable[[str], None],
) -> list[Measured]:
    """Run trials, and write the table, and the figure if there is one, of each experiment.

    Parameters
    ----------
    folder : path
        Where ``NAME.csv`` and ``NAME.svg`` are written.
    resume : bool
        Leave out the trials that ``NAME.jsonl`` of an interrupted run has.
    progress : callable
        Called after each trial with its name, its number, and the seconds since the first began.

    Raises
    ------
    EdgeVprError
        If a trial failed. Experiments without a failure are written before.
    """
    paths = {name: folder / f"{name}.jsonl" for name in dict.fromkeys(each[0] for each in trials)}
    finished: dict[Trial, Sequence[Row]] = {}
    for path in paths.values():
        if resume and path.exists():
            finished |= _read(path, trials)
        else:
            path.unlink(missing_ok=True)
    left = [trial for trial in trials if trial not in finished]
    failed: dict[Trial, str] = {}
    begin_s = time.monotonic()
    for number, (trial, of_trial) in enumerate(mapped(workers, run_trial, left), 1):
        if isinstance(of_trial, Exception):
            failed[trial] = error_text(of_trial)
        else:
            line = json_text([*_key(trial), of_trial])
            with paths[trial.experiment].open("a", encoding="utf-8") as file:
                file.write(line + "\n")
            finished[trial] = json.loads(line)[-1]
        progress(trial_line(_name(trial), number, len(left), begin_s, len(failed)))
    measured = []
    for name, path in paths.items():
        mine = [trial for trial in trials if trial.experiment == name]
        if failed.keys().isdisjoint(mine):
            measured.append(
                Measured(name, table_rows(name, {each: finished[each] for each in mine}))
            )
            measured[-1].write(folder)
            path.unlink(missing_ok=True)
    for trial, error in failed.items():
        raise EdgeVprError(
            f"{_name(trial)}: {error} ({len(failed) - 1} more trials failed; --resume tries them "
            "again)"
        )
    return measured


def _name(trial: Trial) -> str:
    return f"{trial.experiment}, {trial.drives}, seed {trial.seed}"


def _key(trial: Trial) -> tuple[str, int, tuple[str, ...]]:
    """Return what names a trial in the file of its experiment."""
    return trial.drives, trial.seed, trial.systems


def _read(path: Path, trials: Sequence[Trial]) -> dict[Trial, Sequence[Row]]:
    """Read the rows of finished trials; those that are not among `trials` are left out."""
    named = {_key(trial): trial for trial in trials if trial.experiment == path.stem}
    rows: dict[Trial, Sequence[Row]] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            drives, seed, systems, of = json.loads(line)
        except ValueError:
            raise UsageError(f"{path}, line {number} is cut off: delete the line") from None
        trial = named.get((drives, seed, tuple(systems)))
        if trial is not None:
            rows[trial] = of
    return rows


def table_rows(name: str, finished: Mapping[Trial, Sequence[Row]]) -> list[Row]:
    """Return all rows of an experiment, with those that follow from several pairs of drives."""
    rows: list[Row] = [
        {DRIVES: trial.drives, **row, SEED: trial.seed}
        for trial, of in finished.items()
        for row in of
    ]
    conclude = open_experiment(name).conclude
    return rows if conclude is None else [*rows, *conclude(rows)]


@dataclass(frozen=True, eq=False)
class Measured:
    """Rows of an experiment."""

    name: str
    #: With the columns `DRIVES`, those of the experiment's names, `SEED`, and what was measured.
    rows: Sequence[Row]

    def write(self, folder: Path) -> None:
        """Write the rows as a CSV file, and the figure if the experiment has one."""
        cells = ([_short(row.get(name)) for name in self.columns] for row in self.rows)
        write_spreadsheet(folder / f"{self.name}.csv", self.columns, cells)
        draw = open_experiment(self.name).figure
        if draw is not None:
            save(draw(self.rows), folder / f"{self.name}.svg")

    @cached_property
    def columns(self) -> list[str]:
        """Columns of all rows."""
        named = [DRIVES, *open_experiment(self.name).names, SEED]
        return list(dict.fromkeys([*named, *(name for row in self.rows for name in row)]))

    def markdown(self) -> str:
        """Return a table for each pair of drives, which says over how many seeds a ± is."""
        view = open_experiment(self.name).view
        cells = [{name: _cell(row.get(name)) for name in self.columns} for row in self.rows]
        drives = dict.fromkeys(row[DRIVES] for row in cells)
        views = {name: replace(view, only={**view.only, DRIVES: name}) for name in drives}
        seeds = {name: {row[SEED] for row in cells if row[DRIVES] == name} for name in views}
        over = {name: f", ± over {len(of)} seeds" * (len(of) > 1) for name, of in seeds.items()}
        return "\n\n".join(
            f"{name}{over[name]}:\n\n{table_of(cells, one)}" for name, one in views.items()
        )


def _cell(value: Any) -> str:
    """Return a value of a row as in a CSV file; a point tells a measured 1.0 from a number."""
    return "" if value is None else str(_short(value))


def _short(value: Any) -> Any:
    """Return a value with as many digits as can matter."""
    return float(f"{value:.9g}") if isinstance(value, float) else value
