"""Arguments of `edge-vpr evaluate`."""

from __future__ import annotations

import argparse

EXAMPLES = """\
  edge-vpr evaluate results/tuesday --ground-truth monday.nmea tuesday.nmea --tolerance 70
  edge-vpr evaluate results/tuesday --ground-truth matrix.npz --rows reference
  edge-vpr evaluate results/tuesday --ground-truth pairs.csv --tolerance 3 --score ratio"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("results", metavar="RESULTS", help="folder that edge-vpr match wrote")
    truth = parser.add_argument_group("ground truth")
    truth.add_argument(
        "--ground-truth",
        nargs="+",
        required=True,
        metavar="FILE",
        help="two tracks, reference then query (NMEA, GPX, or CSV with time_s and metres or "
        "degrees); or one alignment (CSV with the columns query_s,reference_s or "
        "query_frame,reference_frame); or one 0/1 matrix (.npz, .npy)",
    )
    truth.add_argument(
        "--tolerance",
        type=float,
        metavar="T",
        help="largest error of a right match: metres for tracks, the unit of an alignment; needed "
        "for both",
    )
    truth.add_argument(
        "--rows",
        choices=("reference", "query"),
        help="what a row of a matrix stands for; needed for a matrix",
    )
    truth.add_argument(
        "--offset",
        nargs=2,
        type=float,
        metavar=("REF_S", "QUERY_S"),
        help="where time 0 of each track is in its recording, in seconds; negative if the log "
        "began earlier (default: 0 0)",
    )
    truth.add_argument(
        "--frame-period", metavar="S", help="of an alignment in frames, in seconds: 1/30"
    )
    metrics = parser.add_argument_group("metrics")
    metrics.add_argument(
        "--score", choices=("distance", "ratio", "margin", "trust"),
        help="what the threshold of the precision-recall curve is on (default: trust of the place "
        "filter, distance of sequences)",
    )  # fmt: skip
    metrics.add_argument(
        "--recall-denominator",
        choices=("rejected-correct", "all-with-place"),
        default="rejected-correct",
        help="what counts as missed: rejected queries whose best match was right (the released "
        "code), or every query with a true place that did not get it",
    )
    metrics.add_argument(
        "--thresholds", type=int, metavar="N", help="N even thresholds (default: all)"
    )
