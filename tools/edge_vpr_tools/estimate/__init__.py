"""`edge-vpr estimate`: what a design needs, before it is built.

Exact counts, instructions by tables that the emulated firmware wrote, and modelled energy.
"""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "say what a design needs in operations, memory, time and (modelled) energy"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    design = parser.add_argument_group("design", "of a map, of a file, or of these flags")
    design.add_argument("--map", metavar="MAP.npz", help="take design and event rates from a map")
    design.add_argument("--design", metavar="FILE.toml", help="design of a device")
    design.add_argument("--sensor", metavar="WxH", default="346x260", help="default: 346x260")
    design.add_argument("--pixels", type=int, metavar="J", default=150, help="default: 150")
    design.add_argument("--places", type=int, metavar="K", help="default: of the route, or 1000")
    design.add_argument("--sequence-length", "-L", type=int, metavar="L", default=5)
    design.add_argument("--counter-code", metavar="KIND", default="log", help="default: log")
    design.add_argument("--counter-bits", type=int, metavar="B", default=4, help="default: 4")
    design.add_argument("--polarity", action="store_true", help="count ON and OFF apart")
    design.add_argument("--tau", metavar="TIME", default="1s", help="window (default: 1s)")
    design.add_argument("--lanes", type=int, metavar="P", default=8, help="of an FPGA (default: 8)")
    mission = parser.add_argument_group("mission")
    mission.add_argument(
        "--event-rate", type=float, metavar="N", help="events a second of the sensor (1e5)"
    )
    mission.add_argument(
        "--selected-share", type=float, metavar="S",
        help="of them at selected pixels (default: as of any J pixels)",
    )  # fmt: skip
    mission.add_argument(
        "--match-rate", type=float, metavar="N", help="matches a second (default: one a window)"
    )
    mission.add_argument("--route-km", type=float, metavar="KM", help="length of the route")
    mission.add_argument(
        "--places-per-metre", type=float, metavar="N", default=0.1, help="default: 0.1"
    )
    asked = parser.add_argument_group("what is asked")
    asked.add_argument(
        "--target", action="append", metavar="NAME",
        help="a target, or a TOML file of your own; may be repeated (default: all)",
    )  # fmt: skip
    asked.add_argument(
        "--vs", metavar="DESIGN", help="compare with all-pixels, or with the design in a TOML file"
    )
    asked.add_argument(
        "--fit", action="append", metavar="LIMIT", default=[],
        help="the largest J and K within 64KiB, or 10mW; may be repeated, needs one --target",
    )  # fmt: skip
    asked.add_argument(
        "--calibrate", metavar="PROFILE.json", help="energy of a cycle from your board's profile"
    )
    asked.add_argument(
        "--pareto",
        metavar="DIR",
        help="accuracy of the evaluated runs below DIR against their cost; needs one --target",
    )
    asked.add_argument("--figure", metavar="FILE.png", help="with --pareto, draw it")
    asked.add_argument("--json", metavar="FILE", help="write everything as JSON too")


def run(args: argparse.Namespace) -> None:
    """Count, model, and print.

    Raises
    ------
    UsageError
        If an argument is wrong.
    """
    from edge_vpr.errors import UsageError
    from edge_vpr_tools.estimate import show
    from edge_vpr_tools.estimate.fit import Budget, fit
    from edge_vpr_tools.estimate.request import calibrated, compared, design_and_mission
    from edge_vpr_tools.estimate.targets import find, names
    from edge_vpr_tools.provenance import write_json
    from firmware_model.errors import DesignError

    targets = [find(name) for name in args.target or names()]
    if (args.fit or args.pareto) and len(targets) != 1:
        raise UsageError("--fit and --pareto are held against one target: name it by --target")
    measured = None if args.calibrate is None else calibrated(Path(args.calibrate))
    if measured is not None and (len(targets) != 1 or targets[0].kind != "processor"):
        raise UsageError("--calibrate is of one board: name its processor by --target")
    try:
        design, mission = design_and_mission(args)
        other = None if args.vs is None else compared(args.vs, design, mission)
    except DesignError as error:
        raise UsageError(str(error)) from error
    budgets = [Budget.parse(text) for text in args.fit]
    fits = fit(design, targets[0], mission, budgets, measured) if budgets else []
    show.design(design, mission, args.places_per_metre)
    show.work(design, mission)
    show.costs(design, targets, mission, measured)
    if other is not None:
        show.comparison(design, mission, args.vs, *other, targets)
    if fits:
        show.fits(fits, design, targets[0], budgets)
    if args.pareto is not None:
        from edge_vpr_tools.estimate import pareto

        places = None if args.route_km is None else design.places
        runs = pareto.candidates(
            Path(args.pareto), targets[0], budgets, places, args.match_rate, measured
        )
        show.candidates(runs, budgets)
        if args.figure is not None:
            from edge_vpr_tools.report.style import save

            save(pareto.draw(runs, targets[0]), Path(args.figure))
    show.basis(design, targets, mission, measured)
    if args.json is not None:
        values = show.as_dict(design, targets, mission, fits, measured)
        write_json(Path(args.json), values)
