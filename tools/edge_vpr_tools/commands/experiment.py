"""`edge-vpr experiment`: compute the results that the documentation shows."""

from __future__ import annotations

import argparse
import os
import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr_tools.console import note, number_of, status, summary, warning
from edge_vpr_tools.research.experiments import EXPERIMENTS

if TYPE_CHECKING:
    from edge_vpr_tools.research.experiments.experiment import ExperimentTrial
    from edge_vpr_tools.research.trials import ListedTrial

EXAMPLES = """\
  edge-vpr experiment simulated
  edge-vpr experiment rivals --data recordings -o rivals --seeds 3
  edge-vpr experiment rivals frames --data recordings
  edge-vpr experiment rivals --with model:netvlad.onnx@1,2,4
  edge-vpr experiment all --data recordings --dry-run"""
#: folder of the stored trials in that of the results
_STORE = ".trials"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "names", nargs="+", metavar="NAME", choices=(*EXPERIMENTS, "all"),
        help=f"experiments: {', '.join(EXPERIMENTS)}, or all",
    )  # fmt: skip
    group = parser.add_argument_group("experiment")
    group.add_argument(
        "--data",
        metavar="DIR",
        help="folder of recorded drives: Brisbane-Event-VPR or QCR-Event-VPR under their published "
        "names, or others (docs/datasets.md)",
    )
    group.add_argument(
        "--dry-run", action="store_true",
        help="run nothing: list the drives and trials, and all files of the data sets with their "
        "sizes and addresses; those in the folder of --data are checked by size and SHA-256",
    )  # fmt: skip
    group.add_argument(
        "--with",
        dest="baselines",
        action="append",
        default=[],
        metavar="SYSTEM",
        help="also compare this system (rivals, frames): lens:FILE.pth, model:FILE.onnx, "
        "NAME@1,2,4 for an ensemble of windows, NAME+NAME for one of systems; may be repeated",
    )
    group.add_argument(
        "--seeds", type=int, default=5, metavar="N", help="number of trials with different seeds"
    )
    group.add_argument(
        "--workers", type=int, metavar="N",
        help="number of processes (default: the number of cores)",
    )  # fmt: skip
    group = parser.add_argument_group("output")
    group.add_argument(
        "-o", "--output", metavar="DIR", default="results/experiments",
        help="folder to write NAME.csv to, and NAME.svg where a page shows a figure; trials that "
        "it has already are not run again (default: %(default)s; docs/results has those of the "
        "pages)",
    )  # fmt: skip
    group.add_argument(
        "--table", metavar="DIR",
        help="calibration only: learn new tables of probabilities on as many streets as --seeds "
        "says, and write them to this folder, instead of evaluating the shipped ones",
    )  # fmt: skip


def run(args: argparse.Namespace) -> None:
    """Run experiments, write their tables and figures, and print the tables as Markdown."""
    from edge_vpr_tools.research.datasets import damaged_files
    from edge_vpr_tools.research.experiments.drives import check_logs, downloads
    from edge_vpr_tools.research.experiments.experiment import open_experiment

    start = time.perf_counter()
    if args.seeds < 1:
        raise UsageError(f"{args.seeds} seeds: expected 1 or more")
    names = list(EXPERIMENTS) if "all" in args.names else list(dict.fromkeys(args.names))
    data = None if args.data is None else Path(args.data)
    if data is not None and not data.is_dir():
        raise UsageError(f"--data {data} is not a folder: name the one that holds the recordings")
    if data is not None and not any(open_experiment(name).reads_data for name in names):
        raise UsageError(f"experiment {', '.join(names)} reads no --data: leave it out")
    if args.dry_run:
        _list_files(names, args, data)
        return
    if args.table is not None:
        _learn(names, args)
        return
    trials = _trials(names, args, data)
    folder = Path(args.output)
    if data is not None:
        for problem in damaged_files(data, downloads(data)):
            warning(problem)
        check_logs(data)
    folder.mkdir(parents=True, exist_ok=True)
    pages = _run(trials, folder, args)
    for name, page in pages.items():
        shown = f"{name}:\n\n{page}\n" if len(pages) > 1 else page
        for line in shown.split("\n"):
            summary(line)
    took = f"{time.perf_counter() - start:,.0f} s"
    summary(f"{folder}: {number_of(len(pages), 'experiment')} in {took}")


def _list_files(names: list[str], args: argparse.Namespace, data: Path | None) -> None:
    """Print what would run, and the files of all data sets if any of it reads them."""
    from edge_vpr_tools.research.datasets import damaged_files, listing
    from edge_vpr_tools.research.experiments.drives import downloads
    from edge_vpr_tools.research.experiments.experiment import open_experiment, trials_of

    for name in names:
        try:
            trials = trials_of(name, data, args.seeds, tuple(args.baselines))
        except EdgeVprError as error:
            summary(f"{name}: cannot run: {error}")
            continue
        drives = "; ".join(dict.fromkeys(one.drives for one in trials))
        summary(f"{name}: {number_of(len(trials), 'trial')}, of {drives}")
    if not any(open_experiment(name).reads_data for name in names):
        return
    for line in listing(downloads(data), data):
        summary(line)
    damaged = [] if data is None else list(damaged_files(data, downloads(data), hashed=True))
    if damaged:
        raise UsageError("; ".join(damaged))


def _trials(
    names: list[str], args: argparse.Namespace, data: Path | None
) -> dict[ListedTrial, ExperimentTrial]:
    """Return the trials of experiments; of ``all``, those whose drives are not there are named."""
    from edge_vpr_tools.research.experiments.experiment import trials_of

    found: dict[ListedTrial, ExperimentTrial] = {}
    for name in names:
        try:
            found |= trials_of(name, data, args.seeds, tuple(args.baselines))
        except UsageError as error:
            if "all" not in args.names:
                raise UsageError(f"experiment {name}: {error}") from None
            warning(f"experiment {name} is left out: {error}")
    return found


def _run(
    trials: dict[ListedTrial, ExperimentTrial], folder: Path, args: argparse.Namespace
) -> dict[str, str]:
    """Run trials, write tables and figures of their experiments, and return the tables."""
    from edge_vpr_tools.report.style import save
    from edge_vpr_tools.research.experiments.experiment import run_experiments, store_of
    from edge_vpr_tools.research.trials import Inline, processes

    count, store = args.workers or os.cpu_count() or 1, store_of(folder / _STORE)
    started = nullcontext(Inline()) if count == 1 else processes(count)
    with store.opened(), started as workers, status("starting") as show:
        done, measured = run_experiments(
            trials, store, workers, lambda n, of, failed: show(f"{n} of {of} trials")
        )
    for each in measured:
        each.write(folder)
        if (drawing := each.figure()) is not None:
            save(drawing, folder / f"{each.name}.svg")
    for each in measured:
        note(f"{each.name}: {each.elapsed_s:,.0f} s of work")
    note(
        f"{number_of(done.trials, 'trial')}, {done.known} of them known; {done.computed} computed "
        f"by {number_of(done.workers, 'worker')} in {done.elapsed_s:,.0f} s"
    )
    return {each.name: each.markdown() for each in measured}


def _learn(names: list[str], args: argparse.Namespace) -> None:
    """Learn the tables of probabilities, and write them."""
    from edge_vpr.results import check_parent
    from edge_vpr_tools.research.experiments.calibration import learn

    if names != ["calibration"]:
        raise UsageError(f"experiment {', '.join(names)} writes no table: leave --table out")
    folder = Path(args.table)
    check_parent(folder / "tables")
    with status("starting") as show:
        learn(args.seeds, folder, show)
    summary(f"{folder}: tables of probabilities, learnt on {number_of(args.seeds, 'street')}")
