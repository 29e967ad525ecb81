"""Arguments of `edge-vpr profile`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.reading_flags import add_reading_arguments

EXAMPLES = """\
  edge-vpr profile --quick
  edge-vpr profile --map monday.npz --recording tuesday.raw -o results/board
  edge-vpr profile compare results/board/profile.json results/laptop/profile.json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    output = parser.add_argument_group("output")
    output.add_argument(
        "-o", "--output", metavar="DIR", default="results/profile", help="folder to write"
    )
    output.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    output.add_argument("--no-figures", action="store_true", help="write no report")
    load = parser.add_argument_group("load", "a simulated street, or a map and a recording")
    load.add_argument("--map", metavar="MAP.npz", help="reference map from edge-vpr map")
    load.add_argument("--recording", metavar="QUERY", help="recording of the query drive")
    load.add_argument("--seed", type=int, default=0, help="seed of the simulated street")
    load.add_argument(
        "--every", metavar="WHEN", default="window",
        help="when to match: window, event, change, a number of events, or a time such as 10ms",
    )  # fmt: skip
    load.add_argument(
        "--ground-truth", nargs="+", metavar="FILE",
        help="same as in edge-vpr evaluate; with it, the accuracy of the map, and of smaller ones, "
        "is measured too",
    )  # fmt: skip
    load.add_argument("--tolerance", type=float, metavar="T", help="same as in edge-vpr evaluate")
    load.add_argument("--rows", choices=("reference", "query"), help="same as in edge-vpr evaluate")
    load.add_argument(
        "--packet", type=int, default=512, metavar="N", help="number of events in one call"
    )
    how = parser.add_argument_group("measuring")
    how.add_argument(
        "--pairs", type=int, default=5, metavar="N",
        help="number of pairs of an idle period and a period under load",
    )  # fmt: skip
    how.add_argument(
        "--window-s", type=float, metavar="S",
        help="length of each period in seconds (default: 10, or 1 with --quick)",
    )  # fmt: skip
    how.add_argument(
        "--quick", action="store_true",
        help="use periods shorter than 10 s; the result is marked as quick",
    )  # fmt: skip
    how.add_argument("--no-designs", action="store_true", help="do not compare other designs")
    how.add_argument(
        "--mission-rate", type=float, default=1.0, metavar="N",
        help="matches per second of the mission that the energy is stated for",
    )  # fmt: skip
    sensor = parser.add_argument_group("power sensor")
    sensor.add_argument(
        "--sensor-name", metavar="NAME", help="power sensor to use (default: the best one found)"
    )
    sensor.add_argument(
        "--meter-port", metavar="PORT",
        help="serial port of a USB meter UM24C, UM25C or UM34C, for example /dev/rfcomm0",
    )  # fmt: skip
    sensor.add_argument(
        "--shunt-mohm", type=float, metavar="R",
        help="resistance of the power monitor's shunt in milliohms, if its driver assumes another "
        "(default: the driver's)",
    )  # fmt: skip
    sensor.add_argument(
        "--meter", action="store_true",
        help="measure with an external meter, whose recording edge-vpr profile trace reads",
    )  # fmt: skip
    sensor.add_argument(
        "--sysroot", metavar="DIR", default="/", help="folder that holds /sys, for tests"
    )
    add_reading_arguments(parser)
