"""Flags of the ground truth, shared by the commands that compare matches with it."""

from __future__ import annotations

import argparse


def add_truth_flags(group: argparse._ActionsContainer) -> None:
    """Add the flags that `truth.load_truth` reads."""
    group.add_argument(
        "--ground-truth",
        nargs="+",
        required=True,
        metavar="FILE",
        help="two tracks, reference then query (NMEA, GPX, or CSV with time_s and metres or "
        "degrees); or one alignment (CSV with the columns query_s,reference_s or "
        "query_frame,reference_frame); or one 0/1 matrix (.npz, .npy)",
    )
    group.add_argument(
        "--tolerance",
        type=float,
        metavar="T",
        help="largest error of a right match: metres for tracks, the unit of an alignment; needed "
        "for both",
    )
    group.add_argument(
        "--rows",
        choices=("reference", "query"),
        help="what a row of a matrix stands for; needed for a matrix",
    )
    group.add_argument(
        "--offset",
        nargs=2,
        type=float,
        metavar=("REF_S", "QUERY_S"),
        help="where time 0 of each track is in its recording, in seconds; negative if the log "
        "began earlier (default: 0 0)",
    )
    group.add_argument(
        "--frame-period", metavar="S", help="of an alignment in frames, in seconds: 1/30"
    )
