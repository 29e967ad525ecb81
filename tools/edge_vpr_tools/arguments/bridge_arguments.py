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
    parser.add_argument("recording", metavar="RECORDING", help="recording to replay")
    line = parser.add_argument_group("line")
    line.add_argument(
        "--port", default="virtual",
        help="where to send: virtual (a new pseudo-terminal, whose name is printed), "
        "tcp://[HOST]:PORT (waits for a client; without HOST, for one on this machine), "
        "udp://HOST:PORT, or the name of a serial port",
    )  # fmt: skip
    line.add_argument(
        "--protocol", default="evpr", metavar="P",
        help="protocol of the camera: evpr, edvs:format=E3, evt2, ...",
    )  # fmt: skip
    line.add_argument(
        "--baud", type=int, default=115_200, metavar="N", help="bits per second of a serial port"
    )
    line.add_argument(
        "--flow-control", action="store_true", help="use the RTS and CTS wires of a serial port"
    )
    line.add_argument(
        "--speed", type=float, default=1.0, metavar="F",
        help="speed as a multiple of real time; 0: as fast as possible",
    )  # fmt: skip
    faults = parser.add_argument_group("faults")
    faults.add_argument(
        "--faults", default="", metavar="LIST",
        help="faults of the line to imitate: drop=P, flip=P, insert=P (probability for each byte), "
        "garbage=BYTES, stall=SECONDS (default: none)",
    )  # fmt: skip
    faults.add_argument("--seed", type=int, default=0, help="seed of random faults")
    add_reading_arguments(parser)
