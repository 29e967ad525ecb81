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
        help="two tracks, first that of the reference (NMEA, GPX, or CSV with time_s and metres or "
        "degrees); or one alignment (CSV with the columns query_s,reference_s or "
        "query_frame,reference_frame); or one matrix of 0 and 1 (.npz, .npy)",
    )
    group.add_argument(
        "--tolerance",
        type=float,
        metavar="T",
        help="largest error of a right match: in metres for tracks, in the unit of the file for an "
        "alignment; needed for both",
    )
    group.add_argument(
        "--rows", choices=("reference", "query"),
        help="whether the rows of a matrix are reference places or queries; needed for a matrix",
    )  # fmt: skip
    group.add_argument(
        "--offset",
        nargs=2,
        type=float,
        metavar=("REF_S", "QUERY_S"),
        help="time in each recording at which its track has its time 0, in seconds; negative if "
        "the track began earlier (default: 0 0)",
    )
    group.add_argument(
        "--frame-period", metavar="S",
        help="duration of a frame in seconds, for an alignment in frames, for example 1/30",
    )  # fmt: skip
