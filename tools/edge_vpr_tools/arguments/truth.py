"""Which kind of ground truth the files on the command line are."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import read_archive
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import MapError, UsageError
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.evaluation.truth_from_alignment import from_alignment, load_alignment
from edge_vpr.evaluation.truth_from_matrix import from_matrix, load_matrix
from edge_vpr.evaluation.truth_from_tracks import from_tracks
from edge_vpr.matching.matches import Matches
from edge_vpr.recordings import parse_period
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.output import results
from edge_vpr_tools.output.messages import note

#: places times queries of the ground truth: 64 MB
_MOST_CELLS = 1 << 26
Times = npt.NDArray[np.int64]


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


def load_truth(
    files: Sequence[str],
    places_us: Times,
    queries_us: Times,
    *,
    tolerance: float | None,
    rows: str | None,
    frame_period: str | None,
    offset_s: Sequence[float] | None = None,
) -> GroundTruth:
    """Read two tracks, one matrix (by suffix), or else one alignment.

    Parameters
    ----------
    files : sequence of str
        Two tracks, reference first; or one file.
    places_us : ndarray of int64, shape (K,)
    queries_us : ndarray of int64, shape (Q,)
        Centres of the windows.
    tolerance : float, optional
        Needed for tracks (metres) and alignments (their unit).
    rows : {"reference", "query"}, optional
        Needed for a matrix.
    offset_s : sequence of two floats, optional
        Where time 0 of each track is in its recording, in seconds.
    frame_period : str, optional
        Needed for an alignment in frames, in seconds, for example ``1/30``.

    Returns
    -------
    GroundTruth

    Raises
    ------
    UsageError
        If what is needed is missing.
    GroundTruthError
        If a file is wrong.
    """
    if len(files) > 2:
        raise UsageError(f"{len(files)} ground-truth files: give two tracks, or one other file")
    if offset_s is not None and len(files) != 2:
        raise UsageError("--offset sets the clocks of two tracks right: give two tracks")
    if len(files) == 1 and Path(files[0]).suffix in (".npz", ".npy"):
        if rows is None:
            raise UsageError(
                f"the orientation of {files[0]} is not given: say --rows reference or --rows query"
            )
        matrix = load_matrix(files[0])
        return from_matrix(matrix, places_us.size, queries_us.size, rows=rows)  # type: ignore[arg-type]
    if tolerance is None:
        raise UsageError("the tolerance is not given: say for example --tolerance 70")
    if len(files) == 2:
        offsets = (0.0, 0.0) if offset_s is None else offset_s
        reference, query = (
            load_track(file).shifted(offset) for file, offset in zip(files, offsets, strict=True)
        )
        return from_tracks(reference, query, places_us, queries_us, tolerance)
    alignment = load_alignment(files[0])
    if alignment.unit == "frame" and frame_period is None:
        raise UsageError(
            f"{files[0]} is in frames, and how long a frame lasts is not given: say for example "
            "--frame-period 1/30"
        )
    period = None if frame_period is None else float(parse_period(frame_period) * 1_000_000)
    return from_alignment(
        alignment.pairs,
        alignment.coordinate(queries_us, period),
        alignment.coordinate(places_us, period),
        tolerance,
        alignment.unit,
    )
