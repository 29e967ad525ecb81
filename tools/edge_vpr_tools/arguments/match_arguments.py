"""Arguments of `edge-vpr match`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.reading_flags import add_reading_arguments, add_window_argument
from edge_vpr_tools.arguments.setting_flags import add_match_flags


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("map", metavar="MAP.npz", help="reference map from edge-vpr map")
    parser.add_argument("recording", metavar="QUERY", help="recording of the query drive")
    parser.add_argument("-o", "--output", metavar="DIR", required=True, help="folder to write")
    parser.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    parser.add_argument("--no-figures", action="store_true", help="write no figures and no report")
    parser.add_argument(
        "--online", action="store_true", help="match event by event, as on the board"
    )
    parser.add_argument(
        "--every",
        metavar="WHEN",
        help="with --online, when to give a match: event (at a selected pixel; the default), N "
        "events, a time such as 10ms, window, or change (of the best place)",
    )
    add_window_argument(add_reading_arguments(parser))
    add_match_flags(parser.add_argument_group("settings (over the map's)"))
