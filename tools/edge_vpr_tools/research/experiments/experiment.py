"""An experiment is a declaration: drives, what is measured on them, and how rows are shown.

Each pair of drives with each seed is a trial, which runs on a worker and is stored
(`research.trials`). The rows of all trials are a table with a row per variant and seed.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from matplotlib.figure import Figure

import edge_vpr
import fixedpoint
from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr_tools import research
from edge_vpr_tools.report.tables import SEED, TableView, table_of, write_spreadsheet
from edge_vpr_tools.research.trials import (
    ListedTrial,
    Progress,
    Store,
    TrialsRun,
    Workers,
    compute,
    failures,
    key_of,
)

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
    files: Sequence[Path] = ()  #: Files and folders that are read.
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


def module_of(name: str) -> ModuleType:
    """Import the module of an experiment by its name on the command line."""
    return import_module(f"{__package__}.{name.replace('-', '_')}")


def open_experiment(name: str) -> Experiment:
    """Return an experiment by its name on the command line."""
    found: Experiment = module_of(name).EXPERIMENT
    return found


# Trials of experiments.


@dataclass(frozen=True, kw_only=True)
class ExperimentTrial:
    """Everything that determines the rows of one pair of drives and one seed."""

    experiment: str
    drives: str
    seed: int
    systems: tuple[str, ...]
    data: str | None
    inputs: str
    version: str = edge_vpr.__version__

    @property
    def key(self) -> str:
        """Key of the result; the folder's name has no effect on it."""
        names = self.experiment, self.drives, self.seed, *self.systems
        return key_of(self.version, *names, self.inputs)


@dataclass(frozen=True, kw_only=True)
class ExperimentResult:
    """Rows of a trial, and the time that it took on its worker."""

    rows: tuple[Mapping[str, Any], ...]
    elapsed_s: float


def run_trial(trial: ExperimentTrial) -> ExperimentResult:
    """Measure one pair of drives with one seed."""
    start = time.perf_counter()
    experiment = open_experiment(trial.experiment)
    data = None if trial.data is None else Path(trial.data)
    (drives,) = (each for each in experiment.drives(data) if each.name == trial.drives)
    is_new = drives.varied or trial.seed == 0
    draw = Draw(drives.open(trial.seed), trial.seed, is_new, trial.systems)
    rows = [
        {**{name: row[name] for name in experiment.names}, **row}
        for row in experiment.measure(draw)
    ]
    return ExperimentResult(rows=tuple(rows), elapsed_s=time.perf_counter() - start)


def trials_of(
    name: str, data: Path | None, seeds: int, systems: tuple[str, ...] = ()
) -> dict[ListedTrial, ExperimentTrial]:
    """Return the trials of an experiment by their names: its drives times seeds."""
    experiment = open_experiment(name)
    if systems and not experiment.takes_systems:
        raise UsageError(f"experiment {name} compares no systems: leave --with out")
    weights = [Path(one.partition(":")[2]) for one in systems if ":" in one]
    found = {}
    for drives in experiment.drives(data if experiment.reads_data else None):
        for seed in range(seeds if drives.drawn else 1):
            trial = ExperimentTrial(
                experiment=name,
                drives=drives.name,
                seed=seed,
                systems=systems,
                data=None if data is None else str(data.absolute()),
                inputs=_fingerprint([*drives.files, *weights]),
            )
            found[ListedTrial(variant=name, drives=drives.name, seed=seed, key=trial.key)] = trial
    return found


def store_of(folder: Path) -> Store[ExperimentTrial, ExperimentResult]:
    """Return the store of the trials of experiments in a folder."""
    return Store(folder, ExperimentTrial, ExperimentResult)


@dataclass(frozen=True, eq=False)
class Measured:
    """Rows of an experiment, and the work in them."""

    name: str
    #: With the columns `DRIVES`, those of the experiment's names, `SEED`, and what was measured.
    rows: list[dict[str, Any]]
    elapsed_s: float  #: Time of all trials on their workers.

    def write(self, folder: Path) -> None:
        """Write the rows as a CSV file."""
        cells = ([_short(row.get(name)) for name in self.columns] for row in self.rows)
        write_spreadsheet(folder / f"{self.name}.csv", self.columns, cells)

    @property
    def columns(self) -> list[str]:
        """Columns of all rows."""
        named = [DRIVES, *open_experiment(self.name).names, SEED]
        return list(dict.fromkeys([*named, *(name for row in self.rows for name in row)]))

    def figure(self) -> Figure | None:
        """Draw the figure, if the experiment has one."""
        draw = open_experiment(self.name).figure
        return None if draw is None else draw(self.rows)

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


def run_experiments(
    named: Mapping[ListedTrial, ExperimentTrial],
    store: Store[ExperimentTrial, ExperimentResult],
    workers: Workers,
    progress: Progress = lambda done, of, failed: None,
) -> tuple[TrialsRun, list[Measured]]:
    """Compute the trials that are not stored, and return all rows of each experiment.

    Raises
    ------
    EdgeVprError
        If a trial failed.
    """
    run = compute(named, run_trial, store, workers, retry_failed=True, progress=progress)
    lost = failures(store)
    if lost:
        (trial, error), *more = lost
        raise EdgeVprError(
            f"{trial.variant}, {trial.drives}, seed {trial.seed}: {error} ({len(more)} more trials "
            f"failed; {store.folder}/failures says where)"
        )
    measured = []
    for name in dict.fromkeys(one.variant for one in named):
        rows: list[dict[str, Any]] = []
        elapsed_s = 0.0
        for one in named:
            if one.variant != name:
                continue
            found = store.result(one.key)
            assert found is not None
            elapsed_s += found.elapsed_s
            rows += [{DRIVES: one.drives, **row, SEED: one.seed} for row in found.rows]
        conclude = open_experiment(name).conclude
        rows += [] if conclude is None else map(dict, conclude(rows))
        measured.append(Measured(name, rows, elapsed_s))
    return run, measured


def _cell(value: Any) -> str:
    """Return a value of a row as in a CSV file; a point tells a measured 1.0 from a number."""
    return "" if value is None else str(_short(value))


def _short(value: Any) -> Any:
    """Return a value with as many digits as can matter."""
    return float(f"{value:.9g}") if isinstance(value, float) else value


def _fingerprint(files: Sequence[Path]) -> str:
    """Return a hash of the code, and of the names, sizes and times of change of files."""
    whole = hashlib.sha256(_code_hash().encode())
    for file in sorted(files):
        inner = sorted(file.rglob("*")) if file.is_dir() else [file]
        for one in inner:
            if one.is_file():
                found = one.stat()
                whole.update(f"{one.name}\0{found.st_size}\0{found.st_mtime_ns}\n".encode())
    return whole.hexdigest()


@cache
def _code_hash() -> str:
    """Return a hash of the code that can have an effect on the rows."""
    whole = hashlib.sha256()
    for package in (edge_vpr, fixedpoint, research):
        for folder in package.__path__:
            for file in sorted(Path(folder).rglob("*.py")):
                whole.update(file.read_bytes())
    return whole.hexdigest()
