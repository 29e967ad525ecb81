"""Arguments of `edge-vpr simulate`."""

from __future__ import annotations

import argparse

SENSORS = ("default", "tiny", "davis346", "speck")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "-o", "--output", metavar="DIR", required=True,
        help="folder to write: reference.npz, query.npz, and their tracks as .csv",
    )  # fmt: skip
    parser.add_argument("--overwrite", action="store_true", help="replace the folder if it exists")
    parser.add_argument(
        "--sensor", choices=SENSORS, default="default",
        help="camera: default and speck have 128 x 128 pixels, davis346 346 x 260, tiny 32 x 32",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=int, default=0, help="another seed, another world, camera and drives"
    )
    parser.add_argument(
        "--length", type=float, default=900.0, metavar="M", help="length of the route (900 m)"
    )
    parser.add_argument(
        "--speed-range", type=float, default=2.0, metavar="F",
        help="the query's speed wanders from 1/F to F times the reference's (2)",
    )  # fmt: skip
    parser.add_argument(
        "--stops", type=int, default=0, metavar="N", help="how often the query halts (0)"
    )
