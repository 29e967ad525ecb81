"""`edge-vpr profile trace`: add the energy that an external meter measured."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr_tools.console import is_quiet, summary

EXAMPLES = """\
  edge-vpr profile --meter -o results/board
  edge-vpr profile trace results/board meter.csv
  edge-vpr profile trace results/board ppk2.csv --voltage 5"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "profile", metavar="PROFILE",
        help="profile that edge-vpr profile --meter wrote, by its folder or file",
    )  # fmt: skip
    parser.add_argument(
        "trace", metavar="METER.csv",
        help="recording of the meter: a header that names time, and power or voltage and current, "
        "with their units",
    )  # fmt: skip
    group = parser.add_argument_group("energy")
    group.add_argument(
        "--voltage", type=float, metavar="V",
        help="supply in volts, for a meter that writes current alone, such as a PPK2",
    )  # fmt: skip
    group.add_argument(
        "--column", action="append", metavar="NAME", default=[],
        help="column to read where the file has several of one quantity; may be repeated",
    )  # fmt: skip


_MOST_VOLTS = 60.0


def run(args: argparse.Namespace) -> None:
    """Add the energy of a trace to a profile file."""
    from edge_vpr import results
    from edge_vpr_tools.profile.profiling import PROFILE, with_meter
    from edge_vpr_tools.profile.show import check_shown, show, write_profile

    path = Path(args.profile)
    path = path / PROFILE if path.is_dir() else path
    if args.voltage is not None and not 0 < args.voltage <= _MOST_VOLTS:
        raise UsageError(f"--voltage {args.voltage:g}: expected volts, such as 5")
    found = with_meter(path, Path(args.trace), args.voltage, args.column)
    check_shown(found, path)
    write_profile(found, path.parent, name=path.name)
    if not is_quiet():
        show(found)
    summary(f"see {path.parent / results.REPORT}")
