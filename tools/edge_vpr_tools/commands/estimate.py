"""`edge-vpr estimate`: estimate the cost of a design before it is built."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from edge_vpr.errors import UsageError

if TYPE_CHECKING:
    from edge_vpr_tools.estimate.model import Mission
    from edge_vpr_tools.estimate.targets import Constant
    from firmware_model.design import Design


#: events per second of the sensor for which matches per joule are printed; the middle one is that
#: of a DAVIS346 on a street, roughly
EVENT_RATES = (1e4, 1e5, 1e6)
PLACES = 1_000
#: a window of 1 s at 10 m/s
PLACES_PER_METRE = 0.1
EXAMPLES = """\
  edge-vpr estimate --pixels 83 --places 2000 --target cortex-m4
  edge-vpr estimate --map monday.npz
  edge-vpr estimate --route-km 8 --fit 64KiB --fit 5mW"""
MAIN_FLAGS = ("--map", "--design", "--places", "--event-rate", "--target", "--fit", "--json")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    design = parser.add_argument_group("design", "given by a map, by a file, or by the other flags")
    design.add_argument("--map", metavar="MAP.npz", help="take design and event rates from a map")
    design.add_argument("--design", metavar="FILE.toml", help="read the design from a file")
    design.add_argument(
        "--pixels", type=int, metavar="J", help="number of selected pixels (default: 150)"
    )
    design.add_argument("--counter-bits", type=int, metavar="B", help="bits per code (default: 3)")
    design.add_argument(
        "--places", type=int, metavar="K",
        help=f"number of places (default: that of the route or of the map, else {PLACES})",
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
    mission.add_argument(
        "--route-km", type=float, metavar="KM",
        help="length of the route in kilometres, instead of --places",
    )  # fmt: skip
    mission.add_argument(
        "--places-per-metre", type=float, metavar="N",
        help="places at whole windows per metre of the route; at half windows there are twice as "
        f"many (default: those of the map, if it has positions, or {PLACES_PER_METRE})",
    )  # fmt: skip
    asked = parser.add_argument_group("answers")
    asked.add_argument(
        "--target", action="append", metavar="NAME",
        help="processor or FPGA to estimate for, or a TOML file that describes one; may be "
        "repeated (default: all)",
    )  # fmt: skip
    asked.add_argument(
        "--fit", action="append", metavar="LIMIT", default=[],
        help="limit on memory or power, such as 64KiB or 10mW; may be repeated; recommends pixels, "
        "bits and places per window for each target, or says whether the design of --map or "
        "--design fits",
    )  # fmt: skip
    asked.add_argument(
        "--calibrate", metavar="PROFILE.json",
        help="take the energy per clock cycle from a profile of your board",
    )  # fmt: skip
    asked.add_argument(
        "--sources", action="store_true",
        help="print all assumptions, and the source of each constant",
    )  # fmt: skip
    asked.add_argument("--json", metavar="FILE", help="also write all results as JSON")


class Asked(NamedTuple):
    """A design, its mission, and the source of the mission's rate of events."""

    design: Design
    mission: Mission
    rate_is: str


def asked_for(args: argparse.Namespace) -> Asked:
    """Build the design and the mission from the flags, a file or a map.

    The number of places of ``--places`` or ``--route-km`` overrides that of the map or the file.
    """
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr_tools.estimate.model import Mission
    from edge_vpr_tools.estimate.of_map import design_of, event_rates, places_per_metre
    from firmware_model.design import Design

    if args.map is not None and args.design is not None:
        raise UsageError("--map and --design both give a design: give only one")
    rate, share, density = EVENT_RATES[1], None, args.places_per_metre
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
            density = places_per_metre(reference) if density is None else density
        else:
            design = Design.load(args.design)
    density = PLACES_PER_METRE if density is None else density
    places = _places(args, density, design)
    if places is not None:
        design = replace(design, places=places)
    if args.event_rate is not None:
        rate, rate_is = args.event_rate, "as given"
    if share is None:
        share = design.pixels / (design.width * design.height)
    by_count = design.window == "count"
    matches = rate * share / design.window_events if by_count else 1e6 / design.tau_us
    return Asked(design, Mission(rate, share, matches), rate_is)


def _places(args: argparse.Namespace, density: float, design: Design) -> int | None:
    """Return the number of places that the flags give; None if they give none."""
    km = args.route_km
    if not density > 0 or not (km is None or km > 0):
        raise UsageError(
            f"--places-per-metre {density}, --route-km {km}: expected positive numbers"
        )
    if km is None:
        places: int | None = args.places
        return places
    if args.places is not None:
        raise UsageError("--route-km and --places both give the number of places: give only one")
    return math.ceil(km * 1_000 * density) * design.places_per_window


def _of_flags(args: argparse.Namespace) -> Design:
    """Return the design of a map with the default settings, of a DAVIS346."""
    from edge_vpr.map_record import with_places
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


def calibrated(path: Path) -> Constant:
    """Return the energy of a cycle in picojoules, as a profile measured it.

    It is a single point: one over the matches per joule (`matches_per_joule` of the profile), per
    second of processor time, divided by the clock.

    Raises
    ------
    UsageError
        If the file is no profile, or its energy was not measured or not resolved.
    """
    from edge_vpr.files import parse_errors
    from edge_vpr_tools.estimate.targets import Constant, Spread
    from edge_vpr_tools.profile.profiling import Profile

    profile = Profile.load_file(path)
    energy, clock = profile.energy, profile.conditions.loaded.frequency_hz
    if profile.void:
        raise UsageError(
            f"{path}: the board was throttled, so that its energy is void: cool it, or give it a "
            "stronger supply, and profile again"
        )
    if energy.figures is None:
        raise UsageError(
            f"{path}: energy was not measured: profile a board with a power sensor, or with a "
            "meter (profile --meter, then profile trace)"
        )
    a_joule = energy.figures.bounded("matches_per_joule")
    if a_joule.value is None or a_joule.low is None or a_joule.high is None:
        raise UsageError(
            f"{path}: energy was not resolved: profile the board for longer, by more --pairs"
        )
    if not clock:
        raise UsageError(
            f"{path}: the processor's clock is not known, since the system has no cpufreq: profile "
            "under a kernel that has it (virtual machines have none)"
        )
    # periods of an external meter have no processor time, which is taken from the throughput
    seconds = energy.cpu_s_per_match or profile.throughput.cpu_s_per_match
    most_first = (a_joule.high, a_joule.value, a_joule.low)
    with parse_errors(path, "energy and clock", "profile the board again"):
        picojoules = [1e12 / (matches * seconds * clock) for matches in most_first]
        if not all(map(math.isfinite, picojoules)) or picojoules != sorted(picojoules):
            raise ValueError(f"{picojoules} pJ a cycle are no interval")
        year = int(profile.run.finished_utc[:4])
    return Constant(
        "a cycle of this board",
        "pJ/cycle",
        Spread(*picojoules),
        year,
        profile.run.machine.processor,
        f"calibrated on the profile {path}",
        "interval of the measurement; one point: another load may cost another energy a cycle",
    )


def run(args: argparse.Namespace) -> None:
    """Count, model, and print."""
    from edge_vpr.results import check_parent, to_json, write_json
    from edge_vpr_tools.estimate import search, show
    from edge_vpr_tools.estimate.model import cost, sizes, work
    from edge_vpr_tools.estimate.targets import find, names
    from firmware_model.errors import DesignError

    targets = list(dict.fromkeys(find(name) for name in args.target or names()))
    measured = None if args.calibrate is None else calibrated(Path(args.calibrate))
    if measured is not None and (len(targets) > 1 or targets[0].kind != "processor"):
        raise UsageError("--calibrate is for one board: name its processor with --target")
    budgets = [search.Budget.parse(text) for text in args.fit]
    try:
        design, mission, rate_is = asked_for(args)
    except DesignError as error:
        raise UsageError(str(error)) from error
    if args.json is not None:
        check_parent(Path(args.json))
    limits = {of: search.Limits(of, (), measured) for of in targets}
    values = {"schema": 3, "energy_is": "modelled", "includes": show.WORK, "mission": mission}
    if budgets and args.map is None and args.design is None:
        recommended, unknown = {}, []
        for target in targets:
            within = replace(limits[target], budgets=budgets)
            try:
                recommended[target] = search.recommend(design, mission, within)
            except UsageError:
                if len(targets) == 1:
                    raise
                unknown.append(target)
        show.show_recommended(recommended, unknown, budgets, mission)
        costs = {of: one.best.device.cost for of, one in recommended.items() if one.best}
        values["recommended"] = {of.name: one for of, one in recommended.items()}
    else:
        found, at_rates, unknown = {}, {}, []
        for target in targets:
            try:
                found[target] = search.on_target(
                    design, mission, replace(limits[target], budgets=budgets)
                )
            except UsageError:
                if len(targets) == 1:
                    raise
                unknown.append(target)
                continue
            at_rates[target] = {
                rate: cost(found[target].design, target, mission.at_rate(rate, design), measured)
                for rate in EVENT_RATES
            }
        show.show_design(found, at_rates, rate_is, unknown, limited=bool(budgets))
        costs = {of: one.cost for of, one in found.items()}
        values |= {
            "design": design,
            "sizes": sizes(design),
            "counts": work(design),
            "targets": {
                of.name: {
                    "design": one.design,
                    "memory_bytes": one.memory_bytes,
                    "limited_by": one.limited_by,
                    **to_json(one.cost),
                    "matches_per_joule_at_events_per_s": {
                        f"{rate:g}": each.matches_per_joule for rate, each in at_rates[of].items()
                    },
                }
                for of, one in found.items()
            },
        }
    if args.sources:
        show.show_sources(targets, costs, measured)
    if args.json is not None:
        write_json(Path(args.json), values)
