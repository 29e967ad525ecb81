"""Ground truth read from two tracks, a matrix, or an alignment, for times or for results."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import GroundTruthError, UsageError
from edge_vpr.evaluation.ground_truth import (
    GroundTruth,
    from_alignment,
    from_matrix,
    from_tracks,
    load_alignment,
    load_matrix,
)
from edge_vpr.evaluation.tracks import load_track
from edge_vpr.matching.matches import Matches
from edge_vpr.recordings import parse_period
from edge_vpr.reference_map import MatchResult
from edge_vpr_tools.console import note, warning

#: Suffixes of files that hold a track and not an alignment.
_TRACKS = (".nmea", ".gpx", ".tum")

Times = npt.NDArray[np.int64]


@dataclass(frozen=True)
class TruthFiles:
    """Files of a ground truth, and how they are read; a call with times gives their truth."""

    #: Two tracks, reference first; or one matrix (by suffix), or else one alignment.
    files: Sequence[str]
    tolerance: float | None = None  #: Needed for tracks (metres) and alignments (their unit).
    rows: str | None = None  #: {"reference", "query"}: needed for a matrix.
    #: Needed for an alignment in frames, in seconds, for example ``1/30``.
    frame_period: str | None = None
    #: Where time 0 of each track is in its recording, in seconds.
    offset_s: Sequence[float] | None = None

    def __call__(self, places_us: Times, queries_us: Times) -> GroundTruth:
        """Read the truth for windows with these centres, of shapes (K,) and (Q,).

        Raises
        ------
        UsageError
            If what is needed is missing.
        GroundTruthError
            If a file is wrong.
        """
        files, offset_s = self.files, self.offset_s
        if len(files) > 2:
            raise UsageError(f"{len(files)} ground-truth files: give two tracks, or one other file")
        if offset_s is not None and len(files) != 2:
            raise UsageError("--offset sets the clocks of two tracks right: give two tracks")
        if len(files) == 1 and Path(files[0]).suffix in (".npz", ".npy"):
            if self.rows is None:
                raise UsageError(
                    f"the orientation of {files[0]} is not given: say --rows reference or --rows "
                    "query"
                )
            matrix = load_matrix(files[0])
            return from_matrix(matrix, places_us.size, queries_us.size, rows=self.rows)  # type: ignore[arg-type]
        if self.tolerance is None:
            raise UsageError("the tolerance is not given: say for example --tolerance 70")
        if len(files) == 2:
            reference, query = (
                load_track(file).shifted(at)
                for file, at in zip(files, offset_s or (0.0, 0.0), strict=True)
            )
            return from_tracks(reference, query, places_us, queries_us, self.tolerance)
        if Path(files[0]).suffix.lower() in _TRACKS:
            raise UsageError(
                f"{files[0]} is one track: give two, the reference's and then the query's"
            )
        alignment = load_alignment(files[0])
        if alignment.unit == "frame" and self.frame_period is None:
            raise UsageError(
                f"{files[0]} is in frames, and how long a frame lasts is not given: say for "
                "example --frame-period 1/30"
            )
        given = self.frame_period
        period = None if given is None else float(parse_period(given) * 1_000_000)
        return from_alignment(
            alignment.pairs,
            alignment.coordinate(queries_us, period),
            alignment.coordinate(places_us, period),
            self.tolerance,
            alignment.unit,
        )

    def swapped(self) -> TruthFiles:
        """Return the two tracks in the other order."""
        offsets = None if self.offset_s is None else self.offset_s[::-1]
        return replace(self, files=self.files[::-1], offset_s=offsets)


#: places times queries of the ground truth: 64 MB
_MOST_CELLS = 1 << 26
#: swapped logs are reported if this share of the matches becomes correct by it; chosen by judgement
_SWAPPED_BY = 0.3


def _share_correct(matches: Matches, truth: GroundTruth) -> float:
    return float(truth.correct[matches.place, matches.query].mean())


def load_evaluated(results: str, files: TruthFiles) -> tuple[MatchResult, GroundTruth]:
    """Read a folder of results and its ground truth, and print warnings about doubtful inputs.

    Raises
    ------
    EdgeVprError
        If the folder or the ground truth cannot be used.
    """
    result = MatchResult.load(results)
    reference, matches = result.reference, result.matches
    stride = 1 + len(matches) * len(reference) // _MOST_CELLS
    if result.queries is None and stride > 1:  # matched online: each match is a query
        some = matches.every(stride)
        note(f"one match in {stride} is evaluated: {len(some):,} of {len(matches):,}")
        matches, result = some, replace(result, matches=some)
    if files.frame_period is None and reference.frame_period is not None:
        files = replace(files, frame_period=str(reference.frame_period))
    times = reference.places.centre_us, result.query_time_us
    truth = files(*times)
    for line in truth.notes:
        warning(line)
    share = _share_correct(matches, truth)
    if len(files.files) == 2 and share < 1 - _SWAPPED_BY:
        with suppress(GroundTruthError):  # the tracks fit these drives in one order only
            swapped = _share_correct(matches, files.swapped()(*times))
            if swapped > share + _SWAPPED_BY:
                warning(
                    f"with the two logs in the other order, {swapped:.0%} of the matches would be "
                    f"correct instead of {share:.0%}: name the log of the reference first"
                )
    return result, truth
