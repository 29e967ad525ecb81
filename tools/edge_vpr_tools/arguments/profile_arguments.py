"""Arguments of `edge-vpr profile`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.reading_flags import add_reading_arguments


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
