"""Arguments of `edge-vpr map`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.reading_flags import add_reading_arguments, add_window_argument
from edge_vpr_tools.arguments.setting_flags import add_map_flags

EXAMPLES = """\
  edge-vpr map monday.raw -o monday.npz
  edge-vpr map monday.raw -o small.npz --preset tiny --counter-code log --counter-bits 3
  edge-vpr map monday.raw -o monday.npz --track monday.nmea
  edge-vpr map frames/ -o map.npz --frame-period 1/30 --frames-as-windows"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recording", metavar="REFERENCE", help="recording of the reference drive")
    output = parser.add_argument_group("output")
    output.add_argument("-o", "--output", metavar="MAP.npz", required=True, help="file to write")
    output.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    track = parser.add_argument_group("positions")
    track.add_argument(
        "--track",
        metavar="FILE",
        help="track of this drive (NMEA, GPX, or CSV with time_s and metres or degrees), from "
        "which each match gets a position and an interval along the route",
    )
    track.add_argument(
        "--track-offset",
        type=float,
        metavar="S",
        help="time in the recording at which the track has its time 0, in seconds; negative if the "
        "track began earlier (default: 0)",
    )
    track.add_argument(
        "--odometry",
        metavar="FILE",
        help="odometry of this drive (CSV with time_s and distance_m or speed_mps); with it, match "
        "--odometry needs no track",
    )
    track.add_argument(
        "--jumps",
        metavar="FILE",
        help="pairs of places (CSV with from,to) between which a vehicle can go in one step, for "
        "example where a loop closes",
    )
    add_window_argument(add_reading_arguments(parser))
    add_map_flags(parser)
