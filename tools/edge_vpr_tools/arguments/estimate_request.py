"""Conversion of the flags of `edge-vpr estimate` to a `Question`."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import duration_us
from edge_vpr_tools.arguments.estimate_arguments import DESIGN_FLAGS, EVENTS_PER_S, PLACES
from edge_vpr_tools.arguments.estimate_drives import tried_designs
from edge_vpr_tools.estimate.calibration import calibrated
from edge_vpr_tools.estimate.comparison import Side
from edge_vpr_tools.estimate.counts import EveryPixel
from edge_vpr_tools.estimate.estimation import Other, Question
from edge_vpr_tools.estimate.fit import Budget
from edge_vpr_tools.estimate.model import Mission
from edge_vpr_tools.estimate.of_map import design_of, event_rates
from edge_vpr_tools.estimate.targets import find, names
from edge_vpr_tools.runs.schedule import read_every
from firmware_model.design import Design
from firmware_model.errors import DesignError


def question_of(args: argparse.Namespace) -> Question:
    """Build the question from the flags; runs designs on drives if the flags ask for it.

    Raises
    ------
    EdgeVprError
        If an argument is wrong, or a file cannot be used.
    """
    targets = tuple(find(name) for name in args.target or names())
    evaluated = args.pareto is not None or args.accuracy_on is not None
    alone = len(targets) == 1
    if not evaluated and args.figure is not None:
        raise UsageError("--figure draws evaluated designs: give --pareto or --accuracy-on too")
    if args.accuracy_on is None and args.ground_truth is not None:
        raise UsageError("--ground-truth needs two drives: name them with --accuracy-on")
    if not alone and (args.figure is not None or (args.fit and not evaluated)):
        raise UsageError("--fit and --figure need one target: name it with --target")
    measured = None if args.calibrate is None else calibrated(Path(args.calibrate))
    if measured is not None and (not alone or targets[0].kind != "processor"):
        raise UsageError("--calibrate is for one board: name its processor with --target")
    try:
        design, mission = design_and_mission(args)
        other = None if args.vs is None else Other(args.vs, compared(args.vs, design, mission))
    except DesignError as error:
        raise UsageError(str(error)) from error
    return Question(
        design=design,
        mission=mission,
        places_per_metre=args.places_per_metre,
        targets=targets,
        budgets=tuple(Budget.parse(text) for text in args.fit),
        measured=measured,
        other=other,
        tried=tried_designs(args, design),
        route_places=None if args.route_km is None and args.places is None else design.places,
        events_per_s=args.event_rate,
        matches_per_s=args.match_rate,
    )


def design_and_mission(args: argparse.Namespace) -> tuple[Design, Mission]:
    """Build the design and the mission from the flags, a file or a map.

    The number of places of ``--places`` or ``--route-km`` overrides that of the map or the file.

    Raises
    ------
    EdgeVprError, DesignError
        If a file cannot be read or a value is wrong.
    """
    if args.map is not None and args.design is not None:
        raise UsageError("--map and --design both give a design: give only one")
    rate, share, places = EVENTS_PER_S, None, _places(args)
    if args.map is None and args.design is None:
        design = _of_flags(args, PLACES if places is None else places)
    else:
        for name in DESIGN_FLAGS:
            if getattr(args, name) is not None:
                raise UsageError(
                    f"--{name.replace('_', '-')} describes a design, which --map and --design give "
                    "already: leave it out"
                )
        if args.map is not None:
            reference = ReferenceMap.load(args.map)
            design = design_of(reference, args.lanes)
            rate, share = event_rates(reference)
        else:
            design = Design.load(args.design)
        if places is not None:
            design = replace(design, places=places)
    rate = rate if args.event_rate is None else args.event_rate
    share = share if args.selected_share is None else args.selected_share
    if share is None:
        share = design.pixels / (design.width * design.height)
    matches = args.match_rate
    if matches is None:
        matches = _matches_per_s(args.every, design, rate * share)
    elif args.every != "window":
        raise UsageError("--match-rate and --every both say how often to match: give only one")
    return design, Mission(rate, share, matches)


def _places(args: argparse.Namespace) -> int | None:
    """Return the number of places that the flags give; None if they give none."""
    km, density = args.route_km, args.places_per_metre
    if not density > 0 or not (km is None or km > 0):
        raise UsageError(
            f"--places-per-metre {density}, --route-km {km}: expected positive numbers"
        )
    if km is None:
        places: int | None = args.places
        return places
    if args.places is not None:
        raise UsageError("--route-km and --places both give the number of places: give only one")
    return math.ceil(km * 1_000 * density)


def _of_flags(args: argparse.Namespace, places: int) -> Design:
    flags: dict[str, Any] = {}
    for name, default in DESIGN_FLAGS.items():
        given = getattr(args, name)
        flags[name] = default if given is None else given
    sensor = Sensor.parse(flags["sensor"])
    by_count = {}
    if flags["window_events"] is not None:
        by_count = {"window": "count", "window_events": flags["window_events"]}
    return Design.from_dict(
        {
            "width": sensor.width,
            "height": sensor.height,
            "pixels": flags["pixels"],
            "places": places,
            "matching": flags["matching"],
            "length": flags["sequence_length"],
            "code": flags["counter_code"],
            "code_bits": flags["counter_bits"],
            "polarity": flags["polarity"],
            "tau_us": duration_us(flags["tau"]),
            "lanes": args.lanes,
            **by_count,
        },
        "the command line",
    )


def compared(name: str, design: Design, mission: Mission) -> Side:
    """Return the design to compare with, and its mission, which has its own share of events."""
    if name == "all-pixels":
        return Side(EveryPixel.beside(design), replace(mission, selected_share=1.0))
    other = Design.load(name)
    share = min(1.0, mission.selected_share * other.pixels / design.pixels)
    return Side(other, replace(mission, selected_share=share))


def _matches_per_s(every: str, design: Design, selected_per_s: float) -> float:
    """Return the number of matches per second for a value of ``--every``."""
    schedule = read_every(every)
    if schedule is None:
        by_count = design.window == "count"
        return selected_per_s / design.window_events if by_count else 1e6 / design.tau_us
    if schedule.events:
        return selected_per_s / schedule.events
    return 1e6 / schedule.interval_us
