"""`edge-vpr profile`: what a match costs on this machine, measured."""

from __future__ import annotations

import argparse
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from edge_vpr_tools.reading import add_reading_arguments

_LEAST_QUICK_S = 0.1
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
    load.add_argument(
        "--ground-truth", nargs="+", metavar="FILE",
        help="as of edge-vpr evaluate: how right the map, and smaller ones, are",
    )  # fmt: skip
    load.add_argument("--tolerance", type=float, metavar="T", help="as of edge-vpr evaluate")
    load.add_argument("--rows", choices=("reference", "query"), help="as of edge-vpr evaluate")
    load.add_argument("--packet", type=int, default=512, metavar="N", help="events a call (512)")
    how = parser.add_argument_group("measuring")
    how.add_argument("--pairs", type=int, default=5, help="idle and load windows (default: 5)")
    how.add_argument(
        "--window-s", type=float, metavar="S", help="length of each (10, or 1 with --quick)"
    )
    how.add_argument(
        "--quick", action="store_true", help="windows shorter than 10 s, in a result marked so"
    )
    how.add_argument("--sensor-name", metavar="NAME", help="which power sensor, if several")
    how.add_argument(
        "--meter-port", metavar="PORT",
        help="serial port of a UM24C, UM25C or UM34C, for example /dev/rfcomm0",
    )  # fmt: skip
    how.add_argument(
        "--shunt-mohm", type=float, metavar="R", help="the shunt that the monitor really has"
    )
    how.add_argument(
        "--no-designs", action="store_true", help="measure one design, compare no others"
    )
    how.add_argument(
        "--meter", action="store_true", help="take turns for an external meter, see `trace`"
    )
    how.add_argument("--mission-rate", type=float, default=1.0, metavar="N", help="matches/s (1)")
    how.add_argument("--sysroot", metavar="DIR", default="/", help="where /sys is, for tests")
    parser.add_argument("-o", "--output", metavar="DIR", default="results/profile")
    parser.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    parser.add_argument("--no-figures", action="store_true", help="write no report")
    parser.add_argument("--csv", metavar="FILE", help="write a comparison for a spreadsheet too")
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

        compare(Path(words[1]), Path(words[2]), None if args.csv is None else Path(args.csv))
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
    from edge_vpr_tools.power.protocol import LEAST_S, Plan
    from edge_vpr_tools.power.statistics import LEAST_PAIRS

    if (args.map is None) != (args.recording is None):
        raise UsageError("--map and --recording belong together: name both, or neither")
    if args.ground_truth is not None and args.map is None:
        raise UsageError("--ground-truth is of a recording: name --map and --recording too")
    if args.meter and args.meter_port is not None:
        raise UsageError("--meter is for a CSV that comes later, --meter-port for now: name one")
    least_s = _LEAST_QUICK_S if args.quick else LEAST_S
    window_s = args.window_s
    if window_s is None:
        window_s = 1.0 if args.quick else LEAST_S
    if not (args.mission_rate > 0 and window_s >= least_s and args.pairs >= LEAST_PAIRS):
        raise UsageError(
            f"{args.pairs} pairs of {window_s:g} s at {args.mission_rate:g} matches a second: "
            f"expected {LEAST_PAIRS} pairs or more, {least_s:g} s or more (shorter: --quick), and "
            "a positive rate"
        )
    output = Path(args.output)
    output.absolute().parent.mkdir(parents=True, exist_ok=True)
    inputs = [args.map, args.recording, *(args.ground_truth or ())]
    results.check_output_folder(output, args.overwrite, inputs)
    plan = Plan(args.pairs, window_s, args.quick)
    with terminated_as_interrupted():
        found = profiling.profile(args, plan)
        _write(args, output, found)
    show.table(found)
    print(f"see {output / (profiling.PROFILE if args.no_figures else results.REPORT)}")


def _write(args: argparse.Namespace, output: Path, found: dict[str, Any]) -> None:
    from edge_vpr_tools import results
    from edge_vpr_tools.power import profiling, show
    from edge_vpr_tools.provenance import write_json

    with results.results_folder(output, args.overwrite) as folder:
        write_json(folder / profiling.PROFILE, found)
        write_json(folder / results.RUN, found["run"])
        show.write_csv(found, folder / "profile.csv")
        if not args.no_figures:
            show.write_report(found, folder)


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Let SIGTERM end the block as Ctrl-C does, so that nothing half written is left."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


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
