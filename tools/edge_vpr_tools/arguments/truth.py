"""The results and the ground truth that the flags name."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.archive import read_archive
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import MapError
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.output import results
from edge_vpr_tools.output.messages import note
from edge_vpr_tools.runs.truth_files import load_truth

#: places times queries of the ground truth: 64 MB
_MOST_CELLS = 1 << 26


def load_evaluated(args: argparse.Namespace) -> tuple[ReferenceMap, Matches, GroundTruth]:
    """Read a folder of results and the truth of its matches, and note what is doubtful.

    Parameters
    ----------
    args : argparse.Namespace
        With ``results`` and what `add_truth_flags` adds.

    Raises
    ------
    EdgeVprError
        If the folder or the ground truth cannot be used.
    """
    folder = Path(args.results)
    if not folder.is_dir():
        raise MapError(f"{folder} is not a folder of results: run edge-vpr match first")
    reference = ReferenceMap.load(folder / results.MAP)
    matches = Matches.load(folder / results.MATCHES)
    if (folder / results.QUERIES).is_file():
        arrays, _ = read_archive(folder / results.QUERIES, results.QUERIES_KIND)
        queries_us = Descriptors.from_arrays(arrays).centre_us
    else:  # matched event by event: each match is a query of its own
        matches = matches.every(1 + len(matches) * len(reference) // _MOST_CELLS)
        queries_us = matches.time_us
    truth = load_truth(
        args.ground_truth,
        reference.places.centre_us,
        queries_us,
        tolerance=args.tolerance,
        rows=args.rows,
        frame_period=args.frame_period,
        offset_s=args.offset,
    )
    for line in truth.notes:
        note(line)
    return reference, matches, truth
