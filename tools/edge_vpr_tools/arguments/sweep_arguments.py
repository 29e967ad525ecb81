"""Arguments of `edge-vpr sweep`."""

from __future__ import annotations

import argparse

EXAMPLES = """\
  edge-vpr sweep sweep.toml -o sweeps/pixels --workers 4
  edge-vpr sweep sweep.toml -o sweeps/pixels --scheduler tcp://10.0.0.1:8786
  edge-vpr sweep sweep.toml -o sweeps/pixels --retry-failed"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("plan", metavar="SWEEP.toml", help="plan with variants, drives and seeds")
    parser.add_argument_group("output").add_argument(
        "-o", "--output", metavar="DIR", required=True,
        help="folder of the results; results that it has already are not computed again",
    )  # fmt: skip
    group = parser.add_argument_group("workers")
    group.add_argument(
        "--workers", type=int, metavar="N",
        help="number of processes on this machine (default: its number of cores)",
    )  # fmt: skip
    group.add_argument(
        "--scheduler", metavar="ADDRESS",
        help="run on the Dask cluster of this scheduler instead, for example tcp://10.0.0.1:8786",
    )  # fmt: skip
    group.add_argument("--retry-failed", action="store_true", help="try again what failed before")
