"""Arguments of `edge-vpr simulate`."""

from __future__ import annotations

import argparse

SENSORS = ("default", "tiny", "davis346", "speck")
EXAMPLES = """\
  edge-vpr simulate -o street
  edge-vpr simulate -o short --length 200 --sensor tiny --seed 3 --stops 2"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    output = parser.add_argument_group("output")
    output.add_argument(
        "-o", "--output", metavar="DIR", required=True,
        help="folder to write the recordings reference.npz and query.npz to, each with its track "
        "and its wheel odometry as .csv",
    )  # fmt: skip
    output.add_argument("--overwrite", action="store_true", help="replace the folder if it exists")
    drives = parser.add_argument_group("the two drives")
    drives.add_argument(
        "--sensor", choices=SENSORS, default="default",
        help="camera: default and speck have 128 x 128 pixels, davis346 346 x 260, tiny 32 x 32 "
        "(default: %(default)s)",
    )  # fmt: skip
    drives.add_argument(
        "--seed", type=int, default=0, help="seed of the street, the camera and the drives"
    )
    drives.add_argument(
        "--length", type=float, default=900.0, metavar="M", help="length of the route in metres"
    )
    drives.add_argument(
        "--speed-range", type=float, default=2.0, metavar="F",
        help="the speed of the query varies between 1/F and F times that of the reference",
    )  # fmt: skip
    drives.add_argument(
        "--stops", type=int, default=0, metavar="N", help="number of stops of the query"
    )
