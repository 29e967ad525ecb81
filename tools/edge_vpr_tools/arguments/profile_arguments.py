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
    load.add_argument("--seed", type=int, default=0, help="of the simulated street")
    load.add_argument(
        "--every", metavar="WHEN", default="window",
        help="when to match: window, event, change, a number of events, or a time such as 10ms",
    )  # fmt: skip
    load.add_argument(
        "--ground-truth", nargs="+", metavar="FILE",
        help="as of edge-vpr evaluate: how right the map, and smaller ones, are",
    )  # fmt: skip
    load.add_argument("--tolerance", type=float, metavar="T", help="as of edge-vpr evaluate")
    load.add_argument("--rows", choices=("reference", "query"), help="as of edge-vpr evaluate")
    load.add_argument("--packet", type=int, default=512, metavar="N", help="events a call")
    how = parser.add_argument_group("measuring")
    how.add_argument("--pairs", type=int, default=5, metavar="N", help="idle and load windows")
    how.add_argument(
        "--window-s", type=float, metavar="S",
        help="length of each in seconds (default: 10, or 1 with --quick)",
    )  # fmt: skip
    how.add_argument(
        "--quick", action="store_true", help="windows shorter than 10 s, in a result marked so"
    )
    how.add_argument("--no-designs", action="store_true", help="compare no other designs")
    how.add_argument(
        "--mission-rate", type=float, default=1.0, metavar="N", help="matches a second of a mission"
    )
    sensor = parser.add_argument_group("power sensor")
    sensor.add_argument(
        "--sensor-name", metavar="NAME", help="which power sensor (default: the best found)"
    )
    sensor.add_argument(
        "--meter-port", metavar="PORT",
        help="serial port of a UM24C, UM25C or UM34C, for example /dev/rfcomm0",
    )  # fmt: skip
    sensor.add_argument(
        "--shunt-mohm", type=float, metavar="R",
        help="the shunt that the monitor really has (default: the driver's)",
    )  # fmt: skip
    sensor.add_argument(
        "--meter", action="store_true",
        help="alternate idle and load for an external meter; add its trace by profile trace",
    )  # fmt: skip
    sensor.add_argument("--sysroot", metavar="DIR", default="/", help="where /sys is, for tests")
    add_reading_arguments(parser)
