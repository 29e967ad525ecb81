"""`edge-vpr sweep`: run variants x drives x seeds."""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr_tools.console import note, number_of, status, summary, warning
from edge_vpr_tools.flags import add_output_flags

EXAMPLES = """\
  edge-vpr sweep sweep.toml -o pixels.csv --workers 4
  edge-vpr sweep sweep.toml -o pixels.csv --scheduler tcp://10.0.0.1:8786
  edge-vpr sweep sweep.toml -o pixels.csv --resume"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("plan", metavar="SWEEP.toml", help="plan with variants, drives and seeds")
    output = add_output_flags(
        parser, "FILE.csv", "table of results, to which each trial adds its rows when it ends"
    )
    output.add_argument(
        "--resume", action="store_true",
        help="continue FILE.csv: run only the trials (variant, drives, seed) that it lacks",
    )  # fmt: skip
    group = parser.add_argument_group("workers").add_mutually_exclusive_group()
    group.add_argument(
        "--workers", type=int, metavar="N",
        help="number of processes on this machine (default: its number of cores)",
    )  # fmt: skip
    group.add_argument(
        "--scheduler", metavar="ADDRESS",
        help="run on the Dask cluster of this scheduler instead, for example tcp://10.0.0.1:8786",
    )  # fmt: skip


_MOST_SHOWN = 5


def run(args: argparse.Namespace) -> None:
    """Run the trials, append the rows of each to the file as it ends, and print all."""
    import edge_vpr
    from edge_vpr.files import check_new_file
    from edge_vpr_tools.sweep.comparison import rows_of, show
    from edge_vpr_tools.sweep.plan import read_plan
    from edge_vpr_tools.sweep.table import appending, put_in_order, remaining
    from edge_vpr_tools.sweep.trial import run_trial
    from edge_vpr_tools.workers import cluster, error_text, mapped, processes, trial_line

    if args.resume and args.overwrite:
        raise UsageError("--resume goes on with the file, --overwrite replaces it: leave one out")
    plan, output = Path(args.plan), Path(args.output)
    if output.suffix != ".csv":
        raise UsageError(f"output {output} does not end in .csv: name it for example pixels.csv")
    trials = read_plan(plan)
    check_new_file(output, [plan], args.overwrite or args.resume)
    if args.overwrite:
        output.unlink(missing_ok=True)
    left = remaining(trials, output) if output.exists() else trials
    if args.scheduler is not None:
        started = cluster(args.scheduler)
    else:
        started = processes(os.cpu_count() or 1 if args.workers is None else args.workers)
    lost: list[str] = []
    with appending(output) as append, started as workers, status("running"):
        begin_s = time.monotonic()
        for number, (trial, result) in enumerate(mapped(workers, run_trial, left), 1):
            name = f"{trial.variant}, {trial.drives}, seed {trial.settings.seed}"
            if isinstance(result, Exception):
                lost.append(f"{name}: {error_text(result)}")
            elif (version := result[0]["version"]) != edge_vpr.__version__:
                raise UsageError(
                    f"a worker has edge-vpr {version}, and this machine {edge_vpr.__version__}: "
                    "install one version everywhere"
                )
            else:
                append(trial, result)
            note(trial_line(name, number, len(left), begin_s, len(lost)))
    put_in_order(output, trials)
    if rows := rows_of([output]):
        show(rows)
    for line in lost[:_MOST_SHOWN]:
        warning(line)
    counted = f"{number_of(len(trials), 'trial')}, {len(left) - len(lost)} of them computed now"
    if lost:
        raise EdgeVprError(f"{output}: {counted}, {len(lost)} failed: --resume tries these again")
    summary(f"{output}: {counted}")
