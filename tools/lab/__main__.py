"""The command of the laboratory: ``python -m lab NAME`` computes what the documentation shows."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from edge_vpr_tools.console import error_line, note, number_of, status, summary, warning
from edge_vpr_tools.workers import processes

from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr.files import check_parent
from lab.datasets import damaged_files, listing
from lab.drives import check_logs, downloads
from lab.experiments import EXPERIMENTS
from lab.experiments.calibration import learn
from lab.loop import Trial, open_experiment, run_experiments, trials_of

EXAMPLES = """\
examples:
  python -m lab simulated
  python -m lab rivals --data recordings -o rivals --seeds 3
  python -m lab rivals frames --data recordings
  python -m lab rivals --with model:netvlad.onnx@1,2,4
  python -m lab all --data recordings --dry-run"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    made = argparse.ArgumentParser(
        prog="python -m lab", description=__doc__, epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    made.add_argument(
        "names", nargs="+", metavar="NAME", choices=(*EXPERIMENTS, "all"),
        help=f"experiments: {', '.join(EXPERIMENTS)}, or all",
    )  # fmt: skip
    made.add_argument(
        "--data",
        metavar="DIR",
        help="folder of the published drives, under their names: --dry-run lists them",
    )
    made.add_argument(
        "--dry-run", action="store_true",
        help="run nothing: list the drives and trials, and all files of the data sets with their "
        "sizes and addresses; those in the folder of --data are checked by size and SHA-256",
    )  # fmt: skip
    made.add_argument(
        "--with",
        dest="systems",
        action="append",
        default=[],
        metavar="SYSTEM",
        help="also compare this system (rivals, frames): lens:FILE.pth, model:FILE.onnx, "
        "NAME@1,2,4 for an ensemble of windows, NAME+NAME for one of systems; may be repeated",
    )
    made.add_argument(
        "--seeds", type=int, default=5, metavar="N", help="number of trials with different seeds"
    )
    made.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, metavar="N",
        help="number of processes (default: the number of cores)",
    )  # fmt: skip
    made.add_argument(
        "-o", "--output", metavar="DIR", default="results/experiments",
        help="folder to write NAME.csv to, and NAME.svg where a page shows a figure (default: "
        "%(default)s; docs/results has those of the pages)",
    )  # fmt: skip
    made.add_argument(
        "--resume", action="store_true",
        help="leave out the trials that an interrupted run has finished",
    )  # fmt: skip
    made.add_argument(
        "--table", metavar="DIR",
        help="calibration only: learn new tables of probabilities on as many streets as --seeds "
        "says, and write them to this folder, instead of evaluating the shipped ones",
    )  # fmt: skip
    return made


def main(words: Sequence[str] | None = None) -> int:
    """Run the command, and return its exit code."""
    try:
        run(parser().parse_args(words))
    except EdgeVprError as error:
        error_line(f"error: {error}")
        return error.exit_code
    except KeyboardInterrupt:
        error_line("interrupted: --resume goes on")
        return 130
    return 0


def run(args: argparse.Namespace) -> None:
    """Run experiments, write their tables and figures, and print the tables as Markdown."""
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
    with processes(args.workers) as workers, status("running"):
        measured = run_experiments(trials, folder, workers, resume=args.resume, progress=note)
    for each in measured:
        for line in f"{each.name}:\n\n{each.markdown()}\n".split("\n"):
            summary(line)
    summary(f"{folder}: {number_of(len(measured), 'experiment')}")


def _list_files(names: list[str], args: argparse.Namespace, data: Path | None) -> None:
    """Print what would run, and the files of all data sets if any of it reads them."""
    for name in names:
        try:
            trials = trials_of(name, data, args.seeds, tuple(args.systems))
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


def _trials(names: list[str], args: argparse.Namespace, data: Path | None) -> list[Trial]:
    """Return the trials of experiments; of ``all``, those whose drives are not there are named."""
    trials: list[Trial] = []
    for name in names:
        try:
            trials += trials_of(name, data, args.seeds, tuple(args.systems))
        except UsageError as error:
            if "all" not in args.names:
                raise UsageError(f"experiment {name}: {error}") from None
            warning(f"experiment {name} is left out: {error}")
    return trials


def _learn(names: list[str], args: argparse.Namespace) -> None:
    """Learn the tables of probabilities, and write them."""
    if names != ["calibration"]:
        raise UsageError(f"experiment {', '.join(names)} writes no table: leave --table out")
    folder = Path(args.table)
    check_parent(folder / "tables")
    learn(args.seeds, folder, note)
    summary(f"{folder}: tables of probabilities, learnt on {number_of(args.seeds, 'street')}")


if __name__ == "__main__":
    sys.exit(main())
