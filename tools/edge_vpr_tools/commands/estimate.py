"""`edge-vpr estimate`: estimate the cost of a design before it is built."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edge_vpr.errors import UsageError
from edge_vpr.settings import duration_us
from edge_vpr_tools.console import say, status

if TYPE_CHECKING:
    from edge_vpr_tools.estimate.estimation import Question, Tried
    from edge_vpr_tools.estimate.model import Mission
    from edge_vpr_tools.estimate.targets import Constant
    from edge_vpr_tools.research.experiments.experiment import Drives
    from firmware_model.design import Design


#: rough number of events per second of a DAVIS346 on a street; printed with every estimate
EVENTS_PER_S = 1e5
PLACES = 1_000
#: a window of 1 s at 10 m/s
PLACES_PER_METRE = 0.1
#: defaults of the flags that make a design; not used with --map or --design
DESIGN_FLAGS = {
    "sensor": "346x260",
    "pixels": 150,
    "matching": "filter",
    "sequence_length": 0,
    "counter_code": "contrast",
    "counter_bits": 3,
    "polarity": False,
    "tau": "1s",
    "window_events": None,
    "places_per_window": None,
}
EXAMPLES = """\
  edge-vpr estimate --pixels 83 --places 2000 --target cortex-m4
  edge-vpr estimate --map monday.npz --vs all-pixels
  edge-vpr estimate --target cortex-m0plus --fit 20KiB --fit 5mW"""
MAIN_FLAGS = ("--map", "--design", "--places", "--event-rate", "--target", "--fit", "--json")


def _default(name: str) -> str:
    return f"(default: {DESIGN_FLAGS[name]})"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    design = parser.add_argument_group("design", "given by a map, by a file, or by the other flags")
    design.add_argument("--map", metavar="MAP.npz", help="take design and event rates from a map")
    design.add_argument("--design", metavar="FILE.toml", help="read the design from a file")
    design.add_argument("--sensor", metavar="WxH", help=f"size of the sensor {_default('sensor')}")
    design.add_argument(
        "--pixels", type=int, metavar="J", help=f"number of selected pixels {_default('pixels')}"
    )
    design.add_argument(
        "--places", type=int, metavar="K",
        help=f"number of places (default: that of the route or of the map, else {PLACES})",
    )  # fmt: skip
    design.add_argument(
        "--sequence-length", "-L", type=int, metavar="L",
        help="windows in a sequence; the design then matches by sequences (default: 5)",
    )  # fmt: skip
    design.add_argument(
        "--matching", metavar="KIND",
        help="method: filter or sequence (default: filter, with sequences shown beside it)",
    )  # fmt: skip
    design.add_argument(
        "--counter-code", metavar="KIND",
        help="code of the counters: linear, sqrt, log, own-mean or contrast (default: contrast, or "
        "log with sequences)",
    )  # fmt: skip
    design.add_argument(
        "--counter-bits", type=int, metavar="B", help=f"bits per code {_default('counter_bits')}"
    )
    design.add_argument(
        "--polarity", action="store_true", default=None, help="count ON and OFF events separately"
    )
    design.add_argument("--tau", metavar="TIME", help=f"length of a window {_default('tau')}")
    design.add_argument(
        "--places-per-window", type=int, choices=(1, 2), metavar="N",
        help="1 or 2 places per window length (default: 2 where a map has them by default: with "
        "the filter and windows of a fixed time)",
    )  # fmt: skip
    design.add_argument(
        "--window-events", type=int, metavar="N",
        help="number of events at the selected pixels in a window, instead of a fixed time "
        "(default: none)",
    )  # fmt: skip
    design.add_argument(
        "--lanes", type=int, metavar="P", default=8, help="parallel lanes of an FPGA"
    )
    mission = parser.add_argument_group("mission")
    mission.add_argument(
        "--event-rate", type=float, metavar="N",
        help=f"events per second of the sensor (default: the map's, or {EVENTS_PER_S:g})",
    )  # fmt: skip
    mission.add_argument(
        "--selected-share", type=float, metavar="S",
        help="share of these events at the selected pixels, 0 to 1 (default: the map's, or their "
        "share of all pixels)",
    )  # fmt: skip
    mission.add_argument(
        "--match-rate", type=float, metavar="N",
        help="matches per second (default: one in each window)",
    )  # fmt: skip
    mission.add_argument(
        "--every", metavar="WHEN", default="window",
        help="when to match, as in edge-vpr match: window, event, a number of events, or a time "
        "such as 100ms",
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
        "--vs", metavar="DESIGN", help="compare with all-pixels, or with the design in a TOML file"
    )
    asked.add_argument(
        "--fit", action="append", metavar="LIMIT", default=[],
        help="limit on memory or power, such as 64KiB or 10mW; may be repeated; with one --target, "
        "print the largest numbers of pixels, places and bits that fit; with --accuracy-on or "
        "--pareto, recommend a design for each target",
    )  # fmt: skip
    asked.add_argument(
        "--calibrate", metavar="PROFILE.json",
        help="take the energy per clock cycle from a profile of your board",
    )  # fmt: skip
    asked.add_argument(
        "--pareto", metavar="DIR",
        help="recommend one of the evaluated runs below DIR, and with one --target draw their "
        "accuracy against energy and bytes",
    )  # fmt: skip
    asked.add_argument(
        "--accuracy-on", nargs="+", metavar="DRIVE",
        help="try designs of many sizes on two drives and recommend one: REFERENCE QUERY together "
        "with --ground-truth, or `simulated`",
    )  # fmt: skip
    asked.add_argument(
        "--ground-truth", nargs="+", metavar="FILE",
        help="two tracks, or one alignment in seconds, as for edge-vpr evaluate; not a matrix, "
        "because each design has windows of its own",
    )  # fmt: skip
    asked.add_argument(
        "--tolerance", type=float, metavar="T",
        help="largest error of a correct match, as for edge-vpr evaluate",
    )  # fmt: skip
    asked.add_argument(
        "--figure", metavar="FILE.png",
        help="file for the figure of accuracy against cost (default: DIR/pareto.png); needs one "
        "--target",
    )  # fmt: skip
    asked.add_argument(
        "--sources", action="store_true",
        help="print all assumptions, and the source of each constant",
    )  # fmt: skip
    asked.add_argument("--json", metavar="FILE", help="also write all results as JSON")


# The drives or evaluated runs on which `edge-vpr estimate` takes the accuracy of designs.


def tried_designs(args: argparse.Namespace, designs: Sequence[Design]) -> Tried | None:
    """Read evaluated runs, or run designs on two drives; None without flags for either."""
    from edge_vpr_tools.estimate import accuracy
    from edge_vpr_tools.estimate.estimation import Tried
    from edge_vpr_tools.estimate.search import evaluated_runs

    if args.pareto is not None:
        if args.accuracy_on is not None:
            raise UsageError(
                "--pareto takes finished runs and --accuracy-on makes new ones: give only one"
            )
        return Tried("its own drives", evaluated_runs(Path(args.pareto)), same_queries=False)
    if args.accuracy_on is None:
        return None
    with status("opening the drives") as show_stage:
        drives = _drives(args)
        tried = accuracy.try_designs(drives, designs, show_stage)
        return Tried(drives.name, tried, same_queries=True)


def _drives(args: argparse.Namespace) -> Drives:
    from edge_vpr.recordings import open_recording
    from edge_vpr.settings import PRESETS
    from edge_vpr_tools.estimate import accuracy
    from edge_vpr_tools.research.experiments.experiment import Drives
    from edge_vpr_tools.research.experiments.pairs import Kept, Pair
    from edge_vpr_tools.truth_files import TruthFiles

    if args.accuracy_on == ["simulated"]:
        return accuracy.simulated()
    if len(args.accuracy_on) != 2 or args.ground_truth is None:
        raise UsageError(
            f"--accuracy-on {' '.join(args.accuracy_on)}: expected `simulated`, or a reference and "
            "a query recording with --ground-truth"
        )
    for file in args.ground_truth:
        if Path(file).suffix in (".npz", ".npy"):
            raise UsageError(
                f"--ground-truth {file}: a matrix has rows for the windows of one design, and "
                "several are tried: give two tracks, or an alignment in seconds"
            )
    reference, query = (Kept(open_recording(path)) for path in args.accuracy_on)
    name = " and ".join(args.accuracy_on)
    truths = {name: TruthFiles(args.ground_truth, args.tolerance)}
    pair = Pair(name, reference, query, PRESETS["default"], truths)
    return Drives(name, lambda draw: pair)


# Conversion of the flags of `edge-vpr estimate` to a `Question`.


def question_of(args: argparse.Namespace) -> Question:
    """Build the question from the flags; runs designs on drives if the flags ask for it."""
    from edge_vpr_tools.estimate.estimation import Other, Question
    from edge_vpr_tools.estimate.search import Budget
    from edge_vpr_tools.estimate.targets import find, names
    from firmware_model.design import Design
    from firmware_model.errors import DesignError

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
        design, mission, density = design_and_mission(args)
        other = None
        if args.vs is not None:
            other = Other(args.vs, None if args.vs == "all-pixels" else Design.load(args.vs))
    except DesignError as error:
        raise UsageError(str(error)) from error
    whole, beside = _beside(args, design)
    tried = [each for each in (whole, design, beside) if each]
    return Question(
        design=design,
        beside=beside,
        choose_distances=args.design is None,
        mission=mission,
        places_per_metre=density,
        targets=targets,
        budgets=tuple(Budget.parse(text) for text in args.fit),
        measured=measured,
        other=other,
        tried=tried_designs(args, tried),
        route_places=_at_whole_windows(args, design),
        events_per_s=args.event_rate,
        matches_per_s=args.match_rate,
    )


def design_and_mission(args: argparse.Namespace) -> tuple[Design, Mission, float]:
    """Build the design, the mission and the density of its route from the flags, a file or a map.

    The density is in places at whole windows per metre. The number of places of ``--places`` or
    ``--route-km`` overrides that of the map or the file.
    """
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr_tools.estimate.model import Mission
    from edge_vpr_tools.estimate.of_map import design_of, event_rates, places_per_metre
    from firmware_model.design import Design

    if args.map is not None and args.design is not None:
        raise UsageError("--map and --design both give a design: give only one")
    rate, share, density = EVENTS_PER_S, None, args.places_per_metre
    if args.map is None and args.design is None:
        design = _of_flags(args)
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
            density = places_per_metre(reference) if density is None else density
        else:
            design = Design.load(args.design)
    density = PLACES_PER_METRE if density is None else density
    places = _places(args, density, design)
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
    return design, Mission(rate, share, matches), density


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


def _at_whole_windows(args: argparse.Namespace, design: Design) -> int | None:
    """Return the places at whole windows of the route that the flags give; None without one."""
    given = args.route_km is not None or args.places is not None
    return math.ceil(design.places / design.places_per_window) if given else None


def _of_flags(args: argparse.Namespace) -> Design:
    from edge_vpr.events import Sensor
    from edge_vpr.map_record import with_places
    from edge_vpr.settings import PRESETS
    from edge_vpr_tools.estimate.of_map import design_by

    flags: dict[str, Any] = {}
    for name, default in DESIGN_FLAGS.items():
        given = getattr(args, name)
        flags[name] = default if given is None else given
    by_sequences = flags["matching"] == "sequence" or args.sequence_length is not None
    if args.matching is None and by_sequences:
        flags["matching"] = "sequence"
    if args.counter_code is None and by_sequences:
        flags["counter_code"] = "log"
    sensor, number = Sensor.parse(flags["sensor"]), flags["places_per_window"]
    by_count = {} if flags["window_events"] is None else {"window_events": flags["window_events"]}
    changes = {
        "matching": "filter" if flags["matching"] == "filter" else "sequence",
        "window": "count" if by_count else "time",
        "tau_us": duration_us(flags["tau"]),
    }
    settings = with_places(PRESETS["default"].replaced(changes, "the command line"), None)
    if number is not None and number > settings.window_parts:
        raise UsageError(
            "--places-per-window 2: expected the filter and windows of an even number of "
            "microseconds"
        )
    return design_by(
        settings if number is None else replace(settings, places_per_window=number),
        width=sensor.width,
        height=sensor.height,
        pixels=flags["pixels"],
        places=PLACES,
        matching=flags["matching"],  # which may be no method
        length=flags["sequence_length"],
        code=flags["counter_code"],
        code_bits=flags["counter_bits"],
        polarity=flags["polarity"],
        lanes=args.lanes,
        **by_count,
    )


def _beside(args: argparse.Namespace, design: Design) -> tuple[Design | None, Design | None]:
    """Return the design with one place per window, and with sequences, on the same route.

    Both are None where the user chose how designs match, and the first one where it is no other.
    Sequences have what suits them best: plain logarithms, and windows of a number of events where
    designs are tried on drives.
    """
    chosen = (args.map, args.design, args.matching, args.sequence_length, args.counter_code)
    if args.pareto is not None or any(one is not None for one in chosen):
        return None, None
    whole, number = design, design.places_per_window
    if number > 1:
        whole = replace(
            design, activity_costs=1, exclusion=design.exclusion // number,
            places=math.ceil(design.places / number),
        )  # fmt: skip
    sequences = replace(
        whole, matching="sequence", length=0, code="log", full_scales=(0,), accept="ratio",
        window="count" if args.accuracy_on is not None else design.window, activity_costs=False,
    )  # fmt: skip
    is_other = whole is not design and args.places_per_window is None
    return whole if is_other else None, sequences


def _matches_per_s(every: str, design: Design, selected_per_s: float) -> float:
    """Return the number of matches per second for a value of ``--every``."""
    from edge_vpr.online.localiser import read_every

    schedule = read_every(every)
    if schedule is None:
        by_count = design.window == "count"
        return selected_per_s / design.window_events if by_count else 1e6 / design.tau_us
    if schedule.events:
        return selected_per_s / schedule.events
    return 1e6 / schedule.interval_us


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
    a_joule = None if energy.figures is None else energy.figures.bounded("matches_per_joule")
    if (
        energy.figures is None or a_joule is None or a_joule.value is None
        or a_joule.low is None or a_joule.high is None or not clock
    ):  # fmt: skip
        raise UsageError(
            f"{path}: energy was not measured or not resolved, or the clock is not known: "
            "profile a board with a power sensor, for longer"
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
    from edge_vpr.results import check_parent, write_json
    from edge_vpr_tools.estimate.estimation import estimate
    from edge_vpr_tools.estimate.show import show

    question = question_of(args)
    figure = _figure(args, question)
    for written in (figure, args.json and Path(args.json)):
        if written is not None:
            check_parent(written)
    found = estimate(question)
    show(found, with_sources=args.sources)
    if figure is not None and question.alone is not None and found.answers is not None:
        from edge_vpr_tools.estimate.figure import draw
        from edge_vpr_tools.report.style import save

        save(draw(found.answers.candidates[question.alone.name], question.alone), figure)
        say(f"drawn: {figure}")
    if args.json is not None:
        write_json(Path(args.json), found)


def _figure(args: argparse.Namespace, question: Question) -> Path | None:
    """Return the file for the figure of accuracy against cost; None without a figure."""
    if args.figure is not None:
        return Path(args.figure)
    alone = args.pareto is not None and question.alone is not None
    return Path(args.pareto) / "pareto.png" if alone else None
