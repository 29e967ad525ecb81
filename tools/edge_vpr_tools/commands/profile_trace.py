"""`edge-vpr profile trace`: add the energy that an external meter measured."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr_tools.console import summary

EXAMPLES = """\
  edge-vpr profile --meter -o results/board
  edge-vpr profile trace results/board meter.csv
  edge-vpr profile trace results/board ppk2.csv --voltage 5 --first-load 12400"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "profile", metavar="PROFILE",
        help="profile that edge-vpr profile --meter wrote, by its folder or file",
    )  # fmt: skip
    parser.add_argument(
        "trace", metavar="METER.csv",
        help="recording of the meter: a CSV with a header, whose columns end with their units, "
        "such as time_s and power_w, or Timestamp(ms), Current(uA) and Voltage(V)",
    )  # fmt: skip
    group = parser.add_argument_group(
        "meter", "columns, each with its unit where the header does not state it"
    )
    for quantity, units in (
        ("time", "s, ms, us, ns, or iso"), ("power", "w, mw or uw"), ("current", "a, ma, ua or na"),
    ):  # fmt: skip
        group.add_argument(
            f"--{quantity}", metavar="NAME[:UNIT]",
            help=f"column of {quantity}: {units} (default: the only one of such a unit)",
        )  # fmt: skip
    group.add_argument(
        "--voltage", metavar="V",
        help="supply in volts, or its column as NAME[:UNIT]: v, mv or uv (default: the only one of "
        "such a unit)",
    )  # fmt: skip
    group.add_argument(
        "--first-load", metavar="TIME",
        help="time, as the file writes it, at which the power first rises to that of the load "
        "(default: by the machine's clock, if the file's times have a zone)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> None:
    """Add the energy of a trace to a profile file."""
    from edge_vpr import results
    from edge_vpr_tools.profile.meter_trace import Stated
    from edge_vpr_tools.profile.profiling import PROFILE, with_meter
    from edge_vpr_tools.profile.show import check_shown, show, write_profile

    path = Path(args.profile)
    path = path / PROFILE if path.is_dir() else path
    stated = Stated(args.time, args.power, args.current, args.voltage, args.first_load)
    measured = with_meter(path, Path(args.trace), stated)
    check_shown(measured, path)
    write_profile(measured, path.parent, name=path.name)
    show(measured)
    summary(f"see {path.parent / results.REPORT}")
