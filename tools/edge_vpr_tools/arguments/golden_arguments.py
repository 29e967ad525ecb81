"""Arguments of `edge-vpr golden`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.reading_flags import add_reading_arguments

EXAMPLES = """\
  edge-vpr golden --design design.toml -o vectors
  edge-vpr golden --map monday.npz --recording tuesday.raw -o vectors
  edge-vpr golden verify vectors --results device.jsonl"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    design = parser.add_argument_group("design", "--design or --map is needed")
    design.add_argument("--design", metavar="FILE.toml", help="read the design from a file")
    design.add_argument("--map", metavar="MAP.npz", help="take the design and the places of a map")
    design.add_argument(
        "--lanes", type=int, default=8, metavar="P", help="with --map, number of parallel lanes"
    )
    vectors = parser.add_argument_group("vectors")
    vectors.add_argument(
        "--recording", metavar="QUERY",
        help="with --map, also write vectors of a recorded drive, as suite `recording`",
    )  # fmt: skip
    vectors.add_argument(
        "--max-events", metavar="N", type=int, default=20_000,
        help="number of events to take from the start of the recording",
    )  # fmt: skip
    vectors.add_argument(
        "--suite",
        action="append",
        choices=("corners", "random", "filter", "recording"),
        default=[],
        help="make this suite only; may be given several times (default: all)",
    )
    vectors.add_argument("--seed", type=int, default=0, help="seed of the random vectors")
    vectors.add_argument(
        "--rtl", action="store_true",
        help="also write the hardware core, its parameters for each case, and a testbench",
    )  # fmt: skip
    output = parser.add_argument_group("output")
    output.add_argument("-o", "--output", metavar="DIR", required=True, help="folder to write")
    output.add_argument(
        "--overwrite", action="store_true", help="replace a folder of vectors that exists"
    )
    add_reading_arguments(parser)
