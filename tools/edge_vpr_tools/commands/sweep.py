"""`edge-vpr sweep`: run variants x drives x seeds, each only once."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr_tools.console import number_of, status, summary, warning

EXAMPLES = """\
  edge-vpr sweep sweep.toml -o pixels --workers 4
  edge-vpr sweep sweep.toml -o pixels --scheduler tcp://10.0.0.1:8786
  edge-vpr sweep sweep.toml -o pixels --retry-failed"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("plan", metavar="SWEEP.toml", help="plan with variants, drives and seeds")
    parser.add_argument_group("output").add_argument(
        "-o", "--output", metavar="DIR", required=True,
        help="folder of the results; results that it has already are not computed again",
    )  # fmt: skip
    group = parser.add_argument_group("workers")
    group.add_argument(
        "--workers", type=int, metavar="N",
        help="number of processes on this machine (default: its number of cores)",
    )  # fmt: skip
    group.add_argument(
        "--scheduler", metavar="ADDRESS",
        help="run on the Dask cluster of this scheduler instead, for example tcp://10.0.0.1:8786",
    )  # fmt: skip
    group.add_argument("--retry-failed", action="store_true", help="try again what failed before")


_MOST_SHOWN = 5


def run(args: argparse.Namespace) -> None:
    """Run the missing trials, and print the table of all."""
    from edge_vpr_tools.research.sweep.comparison import markdown, rows_of
    from edge_vpr_tools.research.sweep.plan import read_plan, run_trial, sweep_store
    from edge_vpr_tools.research.trials import cluster, compute, failures, processes

    if args.workers is not None and args.scheduler is not None:
        raise UsageError("--workers are of this machine, --scheduler of a cluster: leave one out")
    plan, store = read_plan(Path(args.plan)), sweep_store(Path(args.output))
    if args.scheduler is not None:
        started = cluster(args.scheduler)
    else:
        started = processes(os.cpu_count() or 1 if args.workers is None else args.workers)
    with store.opened(), started as workers, status("hashing the inputs") as show:
        done = compute(
            plan.trials(),
            run_trial,
            store,
            workers,
            retry_failed=args.retry_failed,
            progress=lambda n, of, failed: show(
                f"{n} of {of} trials" + (f", {failed} failed" if failed else "")
            ),
        )
    for line in markdown(rows_of([store.folder])).splitlines():
        summary(line)
    trials = number_of(done.trials, "trial")
    summary(
        f"{store.folder}: {trials}, {done.different} of them different; {done.known} were known, "
        f"{done.computed} computed now, {done.failed} failed now, by "
        f"{number_of(done.workers, 'worker')}"
    )
    lost = failures(store)
    for trial, error in lost[:_MOST_SHOWN]:
        warning(f"{trial.variant}, {trial.drives}, seed {trial.seed} ({trial.key}): {error}")
    if lost:
        raise EdgeVprError(
            f"{len(lost)} of {trials} failed: {store.folder}/failures says why, and --retry-failed "
            "computes them again"
        )
