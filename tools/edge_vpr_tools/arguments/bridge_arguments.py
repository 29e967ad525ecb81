"""Arguments of `edge-vpr bridge`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.reading_flags import add_reading_arguments

EXAMPLES = """\
  edge-vpr bridge tuesday.raw
  edge-vpr bridge tuesday.raw --port tcp://:7000 --protocol evt3 --speed 2
  edge-vpr bridge tuesday.raw --faults drop=1e-4,stall=2"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recording", metavar="RECORDING", help="what the camera saw")
    line = parser.add_argument_group("line")
    line.add_argument(
        "--port", default="virtual",
        help="virtual (a pseudo-terminal, whose name is printed), tcp://[HOST]:PORT to listen "
        "(loopback unless a host is named), udp://HOST:PORT, or a serial port",
    )  # fmt: skip
    line.add_argument(
        "--protocol", default="evpr", metavar="P", help="evpr, edvs:format=E3, evt2, ..."
    )
    line.add_argument("--baud", type=int, default=115_200, metavar="N", help="of a serial port")
    line.add_argument("--flow-control", action="store_true", help="use RTS and CTS")
    line.add_argument(
        "--speed", type=float, default=1.0, metavar="F",
        help="times real time; 0: as fast as the line takes it",
    )  # fmt: skip
    faults = parser.add_argument_group("faults")
    faults.add_argument(
        "--faults", default="", metavar="LIST",
        help="drop=P, flip=P, insert=P (chance of each byte), garbage=BYTES, stall=SECONDS "
        "(default: none)",
    )  # fmt: skip
    faults.add_argument("--seed", type=int, default=0, help="of the faults")
    add_reading_arguments(parser)
