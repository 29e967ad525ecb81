"""`edge-vpr sweep`: run variants x drives x seeds, each only once."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr_tools.output.messages import summary, warning
from edge_vpr_tools.output.progress import status
from edge_vpr_tools.sweep.comparison import rows_of
from edge_vpr_tools.sweep.comparison_files import markdown
from edge_vpr_tools.sweep.plan import read_plan
from edge_vpr_tools.sweep.store import Store
from edge_vpr_tools.sweep.sweeping import failures, run_sweep
from edge_vpr_tools.sweep.workers import cluster, processes

_MOST_SHOWN = 5


def run(args: argparse.Namespace) -> None:
    """Run the missing trials, and print the table of all."""
    if args.workers is not None and args.scheduler is not None:
        raise UsageError("--workers are of this machine, --scheduler of a cluster: leave one out")
    plan, store = read_plan(Path(args.plan)), Store(Path(args.output))
    if args.scheduler is not None:
        started = cluster(args.scheduler)
    else:
        started = processes(os.cpu_count() or 1 if args.workers is None else args.workers)
    with store.opened(), started as workers, status("hashing the inputs") as show:
        done = run_sweep(
            plan,
            store,
            workers,
            retry_failed=args.retry_failed,
            progress=lambda n, of, failed: show(
                f"{n} of {of} trials" + (f", {failed} failed" if failed else "")
            ),
        )
    print(markdown(rows_of([store.folder])), end="")
    summary(
        f"{store.folder}: {done.trials} trials, {done.different} of them different; {done.known} "
        f"were known, {done.computed} computed now, {done.failed} failed now"
    )
    if done.computed:
        summary(f"{done.workers} workers, busy {done.busy_share:.0%} of the time")
    lost = failures(store)
    for trial, error in lost[:_MOST_SHOWN]:
        warning(f"{trial.variant}, {trial.drives}, seed {trial.seed} ({trial.key}): {error}")
    if lost:
        raise EdgeVprError(
            f"{len(lost)} of {done.trials} trials failed: {store.folder}/failures says why, and "
            "--retry-failed computes them again"
        )
