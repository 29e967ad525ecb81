"""Arguments of `edge-vpr match`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.figure_flags import FIGURES_HELP
from edge_vpr_tools.arguments.reading_flags import add_reading_arguments, add_window_argument
from edge_vpr_tools.arguments.setting_flags import add_match_flags

EXAMPLES = """\
  edge-vpr match monday.npz tuesday.raw -o results/tuesday
  edge-vpr match monday.npz tuesday.raw -o results/online --online --every 50ms
  edge-vpr match monday.npz tuesday.raw -o results/long -L 20 --overwrite"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("map", metavar="MAP.npz", help="reference map from edge-vpr map")
    parser.add_argument("recording", metavar="QUERY", help="recording of the query drive")
    output = parser.add_argument_group("output")
    output.add_argument("-o", "--output", metavar="DIR", required=True, help="folder to write")
    output.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    output.add_argument("--no-figures", action="store_true", help="write no figures and no report")
    output.add_argument("--figures", metavar="FORMATS", default="png", help=FIGURES_HELP)
    output.add_argument(
        "--matrix", metavar="FILE.npy",
        help="also write the distance of every place (row) to every query window (column)",
    )  # fmt: skip
    online = parser.add_argument_group("online matching")
    online.add_argument(
        "--online", action="store_true",
        help="match as the events come, like a device, without using later events",
    )  # fmt: skip
    online.add_argument(
        "--every",
        metavar="WHEN",
        help="with --online, when to give a match: event (after each one at a selected pixel), "
        "after N events, after a time such as 10ms, window (after each one), or change (when the "
        "place changes) (default: event; window with --delay)",
    )
    parser.add_argument_group("mounting").add_argument(
        "--register",
        action="store_true",
        help="estimate from the first 128 windows of the query by how many pixels the image is "
        "shifted against the map, and move the pixels of the map by it",
    )
    parser.add_argument_group("odometry").add_argument(
        "--odometry",
        metavar="FILE",
        help="odometry of the query drive (CSV with time_s and distance_m or speed_mps), for a map "
        "made with --odometry or --track",
    )
    add_match_flags(parser.add_argument_group("matching (over the map's settings)"), "the map's")
    add_window_argument(add_reading_arguments(parser))
