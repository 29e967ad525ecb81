"""`edge-vpr profile`: what a match costs on this machine, measured."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr_tools.reading import add_reading_arguments

HELP = "measure events and matches a second, latency, memory and, with a power sensor, joules"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "words",
        nargs="*",
        metavar="compare A.json B.json | trace PROFILE.json METER.csv",
        help="compare two profiles; or add the joules of an external meter's trace to one",
    )
    load = parser.add_argument_group("load (default: a simulated street)")
    load.add_argument("--map", metavar="MAP.npz", help="reference map from edge-vpr map")
    load.add_argument("--recording", metavar="QUERY", help="recording of the query drive")
    load.add_argument("--seed", type=int, default=0, help="of the simulated street")
    load.add_argument("--every", metavar="WHEN", default="window", help="as of edge-vpr match")
    load.add_argument("--packet", type=int, default=512, metavar="N", help="events a call (512)")
    how = parser.add_argument_group("measuring")
    how.add_argument("--pairs", type=int, default=5, help="idle and load windows (default: 5)")
    how.add_argument("--window-s", type=float, default=10.0, metavar="S", help="each (10)")
    how.add_argument("--quick", action="store_true", help="windows of 1 s; marked so")
    how.add_argument("--sensor-name", metavar="NAME", help="which power sensor, if several")
    how.add_argument(
        "--meter", action="store_true", help="take turns for an external meter, see `trace`"
    )
    how.add_argument("--mission-rate", type=float, default=1.0, metavar="N", help="matches/s (1)")
    how.add_argument("--sysroot", metavar="DIR", default="/", help="where /sys is, for tests")
    parser.add_argument("-o", "--output", metavar="DIR", default="results/profile")
    parser.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    parser.add_argument("--no-figures", action="store_true", help="write no report")
    add_reading_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Profile, compare, or add an external meter's trace.

    Raises
    ------
    EdgeVprError
        If an argument is wrong, or a sensor fails.
    """
    from edge_vpr.errors import UsageError

    words = args.words
    if not words:
        _profile(args)
    elif words[0] == "compare" and len(words) == 3:
        from edge_vpr_tools.power.show import compare

        compare(Path(words[1]), Path(words[2]))
    elif words[0] == "trace" and len(words) == 3:
        _add_trace(args, Path(words[1]), Path(words[2]))
    else:
        raise UsageError(
            f"profile {' '.join(words)}: expected `profile`, `profile compare A.json B.json`, or "
            "`profile trace PROFILE.json METER.csv`"
        )


def _profile(args: argparse.Namespace) -> None:
    from edge_vpr.errors import UsageError
    from edge_vpr_tools import results
    from edge_vpr_tools.power import profiling, show
    from edge_vpr_tools.power.protocol import Plan
    from edge_vpr_tools.provenance import write_json

    if (args.map is None) != (args.recording is None):
        raise UsageError("--map and --recording belong together: name both, or neither")
    if not (args.mission_rate > 0 and args.window_s > 0 and args.pairs >= 5):
        raise UsageError(
            f"{args.pairs} pairs of {args.window_s} s at {args.mission_rate} matches a second: "
            "expected 5 pairs or more, and positive numbers"
        )
    output = Path(args.output)
    output.absolute().parent.mkdir(parents=True, exist_ok=True)
    results.check_output_folder(output, args.overwrite)
    plan = Plan(args.pairs, 1.0 if args.quick else args.window_s, args.quick)
    found = profiling.profile(args, plan)
    with results.results_folder(output, args.overwrite) as folder:
        write_json(folder / profiling.PROFILE, found)
        write_json(folder / results.RUN, found["run"])
        show.write_csv(found, folder / "profile.csv")
        if not args.no_figures:
            show.write_report(found, folder)
    show.table(found)
    print(f"see {output / (profiling.PROFILE if args.no_figures else results.REPORT)}")


def _add_trace(args: argparse.Namespace, profile: Path, meter: Path) -> None:
    from edge_vpr_tools import results
    from edge_vpr_tools.power import profiling, show
    from edge_vpr_tools.provenance import write_json

    found = profiling.with_meter(profile, meter, args.mission_rate)
    write_json(profile, found)
    show.write_csv(found, profile.with_name("profile.csv"))
    if not args.no_figures:
        show.write_report(found, profile.parent)
    show.table(found)
    print(f"see {profile.parent / results.REPORT}")
