"""`edge-vpr estimate`: estimate the cost of a design before it is built."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from edge_vpr.errors import UsageError
from edge_vpr_tools.flags import add_json_flag

if TYPE_CHECKING:
    from edge_vpr_tools.estimate.model import Mission
    from firmware_model.design import Design


#: events per second of the sensor for which matches per joule are printed; the middle one is that
#: of a DAVIS346 on a street, roughly
EVENT_RATES = (1e4, 1e5, 1e6)
PLACES = 1_000
EXAMPLES = """\
  edge-vpr estimate --pixels 83 --places 2000 --target cortex-m4
  edge-vpr estimate --map monday.npz
  edge-vpr estimate --places 1600 --fit flash=256KiB --fit ram=32KiB"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    design = parser.add_argument_group("design", "given by a map, by a file, or by the other flags")
    one = design.add_mutually_exclusive_group()
    one.add_argument("--map", metavar="MAP.npz", help="take design and event rates from a map")
    one.add_argument("--design", metavar="FILE.toml", help="read the design from a file")
    design.add_argument(
        "--pixels", type=int, metavar="J", help="number of selected pixels (default: 150)"
    )
    design.add_argument("--counter-bits", type=int, metavar="B", help="bits per code (default: 3)")
    design.add_argument(
        "--places", type=int, metavar="K",
        help=f"number of places (default: that of the map, else {PLACES})",
    )  # fmt: skip
    design.add_argument(
        "--places-per-window", type=int, choices=(1, 2), metavar="N",
        help="1 or 2 places per window length (default: 2, as in a map)",
    )  # fmt: skip
    design.add_argument(
        "--lanes", type=int, metavar="P", default=8, help="parallel lanes of an FPGA"
    )
    mission = parser.add_argument_group("mission")
    mission.add_argument(
        "--event-rate", type=float, metavar="N",
        help=f"events per second of the sensor (default: the map's, or {EVENT_RATES[1]:g})",
    )  # fmt: skip
    answers = parser.add_argument_group("answers")
    answers.add_argument(
        "--target", action="append", metavar="NAME",
        help="processor or FPGA to estimate for, or a TOML file that describes one; may be "
        "repeated (default: all)",
    )  # fmt: skip
    answers.add_argument(
        "--fit", action="append", metavar="LIMIT", default=[],
        help="limit such as flash=256KiB, ram=32KiB, or 64KiB (both together); may be "
        "repeated; recommends pixels, bits and places per window for each target, or says whether "
        "the design of --map or --design fits",
    )  # fmt: skip
    answers.add_argument(
        "--sources", action="store_true",
        help="print all assumptions, and the source of each constant",
    )  # fmt: skip
    add_json_flag(answers, "all results, with low and high values")


class Workload(NamedTuple):
    """A design, its mission, and the source of the mission's rate of events."""

    design: Design
    mission: Mission
    rate_is: str


def workload_of(args: argparse.Namespace) -> Workload:
    """Build the design and the mission from the flags, a file or a map.

    ``--places`` overrides the number of the map or the file.
    """
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr_tools.estimate.model import Mission
    from edge_vpr_tools.estimate.of_map import design_of, event_rates
    from firmware_model.design import Design

    rate, share = EVENT_RATES[1], None
    rate_is = "an assumption"
    if args.map is None and args.design is None:
        design = _of_flags(args)
    else:
        for name in ("pixels", "counter_bits", "places_per_window"):
            if getattr(args, name) is not None:
                raise UsageError(
                    f"--{name.replace('_', '-')} describes a design, which --map and --design give "
                    "already: leave it out"
                )
        if args.map is not None:
            reference = ReferenceMap.load(args.map)
            design = design_of(reference, args.lanes)
            own = event_rates(reference)
            if own is None:
                rate_is = "an assumption: the map counts events at its pixels alone"
            else:
                (rate, share), rate_is = own, "as in the map's drive"
        else:
            design = Design.load(args.design)
    if args.places is not None:
        design = replace(design, places=args.places)
    if args.event_rate is not None:
        rate, rate_is = args.event_rate, "as given"
    if share is None:
        share = design.pixels / (design.width * design.height)
    return Workload(design, Mission.of(design, rate, share), rate_is)


def _of_flags(args: argparse.Namespace) -> Design:
    """Return the design of a map with the default settings, of a DAVIS346."""
    from edge_vpr.map_making import with_places
    from edge_vpr.settings import PRESETS
    from edge_vpr_tools.estimate.of_map import design_by

    settings = with_places(PRESETS["default"], None)
    if args.places_per_window is not None:
        settings = replace(settings, places_per_window=args.places_per_window)
    return design_by(
        settings,
        width=346,
        height=260,
        pixels=settings.pixels if args.pixels is None else args.pixels,
        places=PLACES,
        code="contrast",
        code_bits=settings.counter_bits if args.counter_bits is None else args.counter_bits,
        lanes=args.lanes,
    )


def run(args: argparse.Namespace) -> None:
    """Count, model, and print."""
    from edge_vpr.records import json_text, to_json
    from edge_vpr_tools.estimate import fitting, show
    from edge_vpr_tools.estimate.model import Mission, cost, search_work, sizes
    from edge_vpr_tools.estimate.targets import find, names
    from firmware_model.errors import DesignError

    targets = list(dict.fromkeys(find(name) for name in args.target or names()))
    budgets = [fitting.Budget.parse(text) for text in args.fit]
    if len({budget.quantity for budget in budgets}) < len(budgets):
        raise UsageError(
            f"--fit {' --fit '.join(args.fit)}: give one limit each of flash, RAM, and both "
            "together"
        )
    try:
        design, mission, rate_is = workload_of(args)
    except DesignError as error:
        raise UsageError(str(error)) from error
    values = {"schema": 6, "mission": mission}
    if budgets and args.map is None and args.design is None:
        recommended = {of: fitting.recommend(design, mission, of, budgets) for of in targets}
        show.show_recommended(recommended, budgets, mission)
        values["recommended"] = {of.name: one for of, one in recommended.items()}
    else:
        estimates = {of: fitting.on_target(design, mission, of, budgets) for of in targets}
        missions = [Mission.of(design, rate, mission.selected_share) for rate in EVENT_RATES]
        at_rates = {
            of: {each.events_per_s: cost(design, of, each) for each in missions} for of in targets
        }
        show.show_design(estimates, at_rates, rate_is, budgets)
        values |= {
            "design": design,
            "sizes": sizes(design),
            "search": search_work(design),
            "targets": {
                of.name: {
                    "memory": one.memory,
                    "limited_by": one.limited_by,
                    **to_json(one.cost),
                    "matches_per_joule_at_events_per_s": {
                        f"{rate:.0f}": each.matches_per_joule for rate, each in at_rates[of].items()
                    },
                }
                for of, one in estimates.items()
            },
        }
    if args.sources:
        show.show_sources(targets)
    if args.json:
        print(json_text(values))
