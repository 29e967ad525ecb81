"""Reading of ground truth from two tracks, a matrix, or an alignment."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.ground_truth import (
    GroundTruth,
    from_alignment,
    from_matrix,
    from_tracks,
    load_alignment,
    load_matrix,
)
from edge_vpr.evaluation.tracks import load_track
from edge_vpr.recordings import parse_period

#: Suffixes of files that hold a track and not an alignment.
_TRACKS = (".nmea", ".gpx", ".tum")

Times = npt.NDArray[np.int64]


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
    places_us, queries_us : ndarray of int64, shapes (K,) and (Q,)
        Centres of the windows.
    tolerance : float, optional
        Needed for tracks (metres) and alignments (their unit).
    rows : {"reference", "query"}, optional
        Needed for a matrix.
    offset_s : sequence of two floats, optional
        Where time 0 of each track is in its recording, in seconds.
    frame_period : str, optional
        Needed for an alignment in frames, in seconds, for example ``1/30``.

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
            load_track(file).shifted(at) for file, at in zip(files, offsets, strict=True)
        )
        return from_tracks(reference, query, places_us, queries_us, tolerance)
    if Path(files[0]).suffix.lower() in _TRACKS:
        raise UsageError(f"{files[0]} is one track: give two, the reference's and then the query's")
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
