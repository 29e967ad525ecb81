"""The drives or evaluated runs on which `edge-vpr estimate` takes the accuracy of designs."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.recordings import open_recording
from edge_vpr_tools.estimate import accuracy
from edge_vpr_tools.estimate.accuracy import Drives
from edge_vpr_tools.estimate.candidates import evaluated_runs
from edge_vpr_tools.estimate.estimation import Tried
from edge_vpr_tools.experiments.trial import Kept
from edge_vpr_tools.output.progress import status
from edge_vpr_tools.runs.truth_files import load_truth
from firmware_model.design import Design


def tried_designs(args: argparse.Namespace, design: Design) -> Tried | None:
    """Read evaluated runs, or run designs on two drives; None without flags for either.

    Raises
    ------
    EdgeVprError
        If runs or drives cannot be used.
    """
    if args.pareto is not None:
        if args.accuracy_on is not None:
            raise UsageError(
                "--pareto takes finished runs and --accuracy-on makes new ones: give only one"
            )
        return Tried("its own drives", evaluated_runs(Path(args.pareto)))
    if args.accuracy_on is None:
        return None
    with status("opening the drives") as show_stage:
        drives = _drives(args)
        return Tried(drives.name, accuracy.try_designs(drives, design, show_stage))


def _drives(args: argparse.Namespace) -> Drives:
    if args.accuracy_on == ["simulated"]:
        return accuracy.simulated()
    if len(args.accuracy_on) != 2 or args.ground_truth is None:
        raise UsageError(
            f"--accuracy-on {' '.join(args.accuracy_on)}: expected `simulated`, or a reference and "
            "a query recording with --ground-truth"
        )
    reference, query = (Kept(open_recording(path)) for path in args.accuracy_on)
    truth_of = partial(
        load_truth, args.ground_truth, tolerance=args.tolerance, rows=None, frame_period=None
    )
    return Drives(" and ".join(args.accuracy_on), reference, query, truth_of)
