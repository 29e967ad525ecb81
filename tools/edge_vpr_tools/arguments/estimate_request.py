"""What the command line of `edge-vpr estimate` asks for."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.plain_values import read_json, understood
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.arguments.estimate_arguments import DESIGN_FLAGS, EVENTS_PER_S, PLACES
from edge_vpr_tools.arguments.setting_flags import duration_us
from edge_vpr_tools.estimate.counts import EveryPixel
from edge_vpr_tools.estimate.model import Mission
from edge_vpr_tools.estimate.of_map import design_of, event_rates
from edge_vpr_tools.estimate.targets import Constant, Spread
from firmware_model.design import Design


def design_and_mission(args: argparse.Namespace) -> tuple[Design, Mission]:
    """Build them of the flags, a file or a map; a route, or its places, goes before the map's.

    Raises
    ------
    EdgeVprError, DesignError
        If a file cannot be read or a value is wrong.
    """
    if args.map is not None and args.design is not None:
        raise UsageError("--map and --design are two designs: name one")
    rate, share, places = EVENTS_PER_S, None, _places(args)
    if args.map is None and args.design is None:
        design = _of_flags(args, PLACES if places is None else places)
    else:
        for name in DESIGN_FLAGS:
            if getattr(args, name) is not None:
                raise UsageError(
                    f"--{name.replace('_', '-')} makes a design, and --map and --design have one: "
                    "leave it out"
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
        raise UsageError("--match-rate and --every both say how often to match: name one")
    return design, Mission(rate, share, matches)


def _places(args: argparse.Namespace) -> int | None:
    """Tell K of the route, if one is named."""
    km, density = args.route_km, args.places_per_metre
    if not density > 0 or not (km is None or km > 0):
        raise UsageError(
            f"--places-per-metre {density}, --route-km {km}: expected positive numbers"
        )
    if km is None:
        places: int | None = args.places
        return places
    if args.places is not None:
        raise UsageError("--route-km and --places both say how many places: name one")
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


def compared(name: str, design: Design, mission: Mission) -> tuple[Design, Mission]:
    """Give what a design is compared with, and its mission: the share of events that it counts."""
    if name == "all-pixels":
        return EveryPixel.beside(design), replace(mission, selected_share=1.0)
    other = Design.load(name)
    share = min(1.0, mission.selected_share * other.pixels / design.pixels)
    return other, replace(mission, selected_share=share)


def _matches_per_s(every: str, design: Design, selected_per_s: float) -> float:
    """Tell how often a match is given, as `edge-vpr match --every` reads it."""
    if every == "window":
        if design.window == "count":
            return selected_per_s / design.window_events
        return 1e6 / design.tau_us
    if every in ("event", "change"):
        return selected_per_s
    if every.isascii() and every.isdigit() and int(every) > 0:
        return selected_per_s / int(every)
    try:
        return 1e6 / duration_us(every)
    except UsageError:
        raise UsageError(
            f"--every {every!r}: expected event, a number of events, a time such as 10ms, or window"
        ) from None


def calibrated(profile: Path) -> Constant:
    """Energy of a processor's cycle, of the profile of a board with a power sensor.

    One point: marginal joules for each second of processor time, over the clock.

    Raises
    ------
    UsageError
        If the file is no profile, or its energy was not measured or not resolved.
    """
    what, remedy = "energy and clock", "name the JSON of a profile that edge-vpr profile made"
    values = read_json(profile, what, remedy)
    with understood(profile, what, remedy):
        return _cycle_energy(profile, values)


def _cycle_energy(profile: Path, values: dict[str, Any]) -> Constant:
    energy, clock = values["energy"], values["conditions"]["loaded"]["frequency_hz"]
    if not energy.get("resolved") or not clock:
        raise UsageError(
            f"{profile}: energy was not measured or not resolved, or the clock is not known: "
            "profile a board with a power sensor, for longer"
        )
    # an external meter's windows do not tell the processor time: the throughput does
    seconds = energy.get("cpu_s_per_match") or values["throughput"]["cpu_s_per_match"]
    low, high = energy["marginal_j_per_match_interval"]
    picojoules = [
        1e12 * joules / (seconds * clock) for joules in (low, energy["marginal_j_per_match"], high)
    ]
    if not all(map(math.isfinite, picojoules)) or picojoules != sorted(picojoules):
        raise UsageError(f"{profile}: {picojoules} pJ a cycle are no interval: profile again")
    return Constant(
        "a cycle of this board",
        "pJ/cycle",
        Spread(*picojoules),
        int(values["run"]["finished_utc"][:4]),
        values["run"]["machine"]["processor"],
        f"calibrated on the profile {profile}",
        "interval of the measurement; one point: another load may cost another energy a cycle",
    )
