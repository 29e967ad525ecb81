"""Arguments of `edge-vpr golden`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.reading_flags import add_reading_arguments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "words",
        nargs="*",
        metavar="verify VECTORS",
        help="check the files of a folder of vectors, and the results of a device (--results)",
    )
    making = parser.add_argument_group("making vectors")
    making.add_argument("--design", metavar="FILE.toml", help="design of the device")
    making.add_argument("--map", metavar="MAP.npz", help="take the design and the places from it")
    making.add_argument(
        "--recording", metavar="QUERY", help="with --map, a drive for the suite `recording`"
    )
    making.add_argument(
        "--max-events",
        metavar="N",
        type=int,
        default=20_000,
        help="events of the recording to take, from its start (default: 20000)",
    )
    making.add_argument("--lanes", type=int, default=8, help="with --map, P (default: 8)")
    making.add_argument("--seed", type=int, default=0, help="of the random suite (default: 0)")
    making.add_argument("-o", "--output", metavar="DIR", help="folder to write")
    verifying = parser.add_argument_group("verifying")
    verifying.add_argument("--results", metavar="FILE", help="what the device returned")
    verifying.add_argument(
        "--case", metavar="SUITE/NAME", help="the case of results that name none"
    )
    verifying.add_argument(
        "--only",
        metavar="KINDS",
        default="event,window,match",
        help="what the device returns: some of event,window,match (default: all)",
    )
    add_reading_arguments(parser)
