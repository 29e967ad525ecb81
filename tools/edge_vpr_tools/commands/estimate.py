"""`edge-vpr estimate`: what a design needs, before it is built.

Exact counts, instructions by tables that the emulated firmware wrote, and modelled energy.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.recordings import open_recording
from edge_vpr_tools.arguments.estimate_request import compared, design_and_mission
from edge_vpr_tools.arguments.truth import load_truth
from edge_vpr_tools.estimate import accuracy, compare, pareto, show
from edge_vpr_tools.estimate.accuracy import Drives
from edge_vpr_tools.estimate.calibration import calibrated
from edge_vpr_tools.estimate.fit import Budget, fit
from edge_vpr_tools.estimate.pareto import Evaluated
from edge_vpr_tools.estimate.targets import Constant, Target, find, names
from edge_vpr_tools.experiments.trial import Kept, Times
from edge_vpr_tools.output.progress import status
from edge_vpr_tools.output.provenance import write_json
from edge_vpr_tools.report.style import save
from firmware_model.design import Design
from firmware_model.errors import DesignError


def run(args: argparse.Namespace) -> None:
    """Count, model, and print.

    Raises
    ------
    UsageError
        If an argument is wrong.
    """
    targets = [find(name) for name in args.target or names()]
    evaluated = args.pareto is not None or args.accuracy_on is not None
    alone = len(targets) == 1
    if not evaluated and args.figure is not None:
        raise UsageError("--figure draws evaluated designs: name --pareto or --accuracy-on too")
    if args.accuracy_on is None and args.ground_truth is not None:
        raise UsageError("--ground-truth is of two drives: name them by --accuracy-on")
    if not alone and (args.figure is not None or (args.fit and not evaluated)):
        raise UsageError("--fit and --figure are held against one target: name it by --target")
    measured = None if args.calibrate is None else calibrated(Path(args.calibrate))
    if measured is not None and (not alone or targets[0].kind != "processor"):
        raise UsageError("--calibrate is of one board: name its processor by --target")
    try:
        design, mission = design_and_mission(args)
        other = None if args.vs is None else compared(args.vs, design, mission)
    except DesignError as error:
        raise UsageError(str(error)) from error
    budgets = [Budget.parse(text) for text in args.fit]
    fits = fit(design, targets[0], mission, budgets, measured) if budgets and alone else []
    tried = _evaluated(args, design) if evaluated else None
    show.design(design, mission, args.places_per_metre)
    show.work(design, mission)
    show.costs(design, targets, mission, measured)
    if alone:
        show.units(design, targets[0], mission, measured)
    if other is not None:
        compare.comparison((design, mission), other, args.vs, targets, measured)
    if fits:
        show.fits(fits, design, targets[0], budgets)
    show.basis(design, targets, mission, measured)
    values = show.as_dict(design, targets, mission, fits, measured)
    if other is not None:
        values["vs"] = compare.as_dict((design, mission), other, targets, measured)
    if tried is not None:
        values["answers"] = _answer(args, tried, targets, budgets, design, measured)
    if args.json is not None:
        write_json(Path(args.json), values)


def _evaluated(args: argparse.Namespace, design: Design) -> tuple[str, list[Evaluated]]:
    """Find evaluated runs, or try designs on two drives; give the name of the drives too."""
    if args.pareto is not None:
        if args.accuracy_on is not None:
            raise UsageError(
                "--pareto takes runs that are there, --accuracy-on makes some: name one"
            )
        return "its own drives", pareto.evaluated_runs(Path(args.pareto))

    with status("opening the drives") as show_stage:
        drives = _drives(args)
        found = accuracy.try_designs(drives, design, show_stage)
    return drives.name, found


def _drives(args: argparse.Namespace) -> Drives:

    if args.accuracy_on == ["simulated"]:
        return accuracy.simulated()
    if len(args.accuracy_on) != 2 or args.ground_truth is None:
        raise UsageError(
            f"--accuracy-on {' '.join(args.accuracy_on)}: expected `simulated`, or a reference and "
            "a query recording with --ground-truth"
        )
    reference, query = (Kept(open_recording(path)) for path in args.accuracy_on)

    def truth_of(places_us: Times, queries_us: Times) -> GroundTruth:
        return load_truth(
            args.ground_truth, places_us, queries_us,
            tolerance=args.tolerance, rows=None, frame_period=None,
        )  # fmt: skip

    return accuracy.Drives(" and ".join(args.accuracy_on), reference, query, truth_of)


def _answer(
    args: argparse.Namespace,
    tried: tuple[str, list[Evaluated]],
    targets: Sequence[Target],
    budgets: Sequence[Budget],
    design: Design,
    measured: Constant | None,
) -> dict[str, Any]:
    """Print what one can have on each target, and draw it for one."""
    drives, runs = tried
    places = None if args.route_km is None and args.places is None else design.places
    said, told = {}, {}
    for target in targets:
        asked = pareto.Asked(target, budgets, places, args.match_rate, args.event_rate, measured)
        try:
            found = pareto.candidates(runs, asked)
        except UsageError as error:
            if len(targets) == 1:
                raise
            said[target.name] = str(error)
            continue
        said[target.name] = pareto.answer(found, asked, drives)
        told[target.name] = [
            asdict(one) | {"design": one.design.to_dict(), "energy_is": "modelled"} for one in found
        ]
        if len(targets) == 1:
            show.candidates(found)
            path = args.figure or (args.pareto and str(Path(args.pareto) / "pareto.png"))
            if path:
                save(pareto.draw(found, target), Path(path))
                show.say(f"drawn: {path}")
    for text in said.values():
        show.say(text)
    show.say(
        "an accuracy is of those drives: a longer route has more places to be mistaken for one "
        "another"
    )
    return {"text": said, "candidates": told}
