"""Arguments of `edge-vpr bridge`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.reading_flags import add_reading_arguments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recording", metavar="RECORDING", help="what the camera saw")
    parser.add_argument(
        "--port", default="virtual",
        help="virtual (a pseudo-terminal, whose name is printed), tcp://[HOST]:PORT to listen "
        "(loopback unless a host is named), udp://HOST:PORT, or a serial port",
    )  # fmt: skip
    parser.add_argument(
        "--protocol", default="evpr", metavar="P", help="evpr, edvs:format=E3, evt2, ..."
    )
    parser.add_argument("--baud", type=int, default=115_200, help="of a serial port")
    parser.add_argument("--flow-control", action="store_true", help="use RTS and CTS")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="times real time; 0: as fast as the line takes it"
    )
    parser.add_argument(
        "--faults", default="", metavar="LIST",
        help="drop=P, flip=P, insert=P (chance of each byte), garbage=BYTES, stall=SECONDS",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="of the faults")
    add_reading_arguments(parser)
