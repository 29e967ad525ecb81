"""Ground truth read from two tracks, a matrix, or an alignment, for times or for results."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr import results
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.ground_truth import (
    Alignment,
    GroundTruth,
    from_alignment,
    from_matrix,
    from_tracks,
    load_alignment,
    load_matrix,
)
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.evaluation.tracks import MAX_GAP_US, Track
from edge_vpr.match_result import MatchResult
from edge_vpr.recordings import parse_period
from edge_vpr.records import from_json, parse_errors, read_json
from edge_vpr.results import RunRecord
from edge_vpr_tools.cli import VerbParser, find_verb
from edge_vpr_tools.console import note

#: Suffixes of files that hold a track and not an alignment.
_TRACKS = (".nmea", ".gpx", ".tum", ".log")

Times = npt.NDArray[np.int64]


@dataclass(frozen=True)
class TruthFiles:
    """Files of a ground truth, and how they are read; a call with times gives their truth."""

    #: Two tracks, reference first; or one matrix (with `rows`), or else one alignment.
    files: tuple[str, ...]
    #: Needed for tracks (metres) and alignments (their unit, or seconds).
    tolerance: float | None = None
    rows: str | None = None  #: {"reference", "query"}: needed for a matrix.
    #: Needed for an alignment in frames, in seconds, for example ``1/30``.
    frame_period: str | None = None
    #: Where time 0 of each track is in its recording, in seconds.
    offset_s: tuple[float, float] | None = None
    #: Longest time between points of a track that is interpolated, in seconds.
    longest_gap_s: float = MAX_GAP_US / 1e6
    in_seconds: bool = (
        False  #: Whether the tolerance is in seconds, of an alignment also in frames.
    )

    def tracks(self) -> tuple[Track, Track]:
        """Read two tracks, the reference's and the query's, with their offsets.

        Raises
        ------
        UsageError
            If both are the same, and no offset says that this is meant.
        """
        if self.in_seconds:
            raise UsageError(
                f"--tolerance {self.tolerance:g}s is of an alignment: give metres for two tracks"
            )
        reference, query = (
            load_track(file, max_gap_s=self.longest_gap_s).shifted(at)
            for file, at in zip(self.files, self.offset_s or (0.0, 0.0), strict=True)
        )
        if reference == query and self.offset_s is None:
            raise UsageError(
                f"--ground-truth {' '.join(self.files)}: both are the same log: name that of the "
                "reference and that of the query; of one log of both drives, say with --offset "
                "where its time 0 is in each recording (--offset 0 0: they are one drive)"
            )
        return reference, query

    def __call__(self, places_us: Times, queries_us: Times) -> GroundTruth:
        """Read the truth for windows with these centres, of shapes (K,) and (Q,).

        Raises
        ------
        GroundTruthError
            If a file is wrong.
        """
        files, offset_s = self.files, self.offset_s
        if len(files) > 2:
            raise UsageError(f"{len(files)} ground-truth files: give two tracks, or one other file")
        if offset_s is not None and len(files) != 2:
            raise UsageError("--offset sets the clocks of two tracks right: give two tracks")
        if len(files) == 1 and self.rows is not None:
            matrix = load_matrix(files[0])
            return from_matrix(matrix, places_us.size, queries_us.size, rows=self.rows)  # type: ignore[arg-type]
        if len(files) == 1 and Path(files[0]).suffix.lower() in (".npz", ".npy"):
            raise UsageError(
                f"{files[0]} is a matrix: say with --rows whether its rows are reference or query"
            )
        if self.tolerance is None:
            raise UsageError(
                "a tolerance is missing: say for example --tolerance 25, or of a matrix --rows"
            )
        if len(files) == 2:
            return from_tracks(*self.tracks(), places_us, queries_us, self.tolerance)
        if Path(files[0]).suffix.lower() in _TRACKS:
            raise UsageError(
                f"{files[0]} is one track: give two, the reference's and then the query's"
            )
        alignment = load_alignment(files[0])
        period = None if self.frame_period is None else parse_period(self.frame_period)
        if alignment.unit == "frame":
            if period is None:
                raise UsageError(
                    f"{files[0]} is in frames: say how long one lasts, for example with "
                    "--frame-period 1/30"
                )
            if self.in_seconds:
                pairs = np.asarray(alignment.pairs) * float(period)
                alignment = Alignment(pairs, "s")
        return from_alignment(alignment, places_us, queries_us, self.tolerance, frame_period=period)


def parse_tolerances(texts: Sequence[str]) -> tuple[list[float], bool]:
    """Return the tolerances of ``--tolerance``, and whether they are in seconds, as ``2s`` is."""
    ending = "s" * all(text.endswith("s") for text in texts)
    tolerances = []
    with suppress(ValueError):
        tolerances = [float(text.removesuffix(ending)) for text in texts]
    if len(tolerances) < len(texts) or not np.isfinite(tolerances).all():
        raise UsageError(
            f"--tolerance {' '.join(texts)}: give numbers such as 70, several of them separated by "
            "spaces, as 25 70, or all in seconds, as 2s"
        )
    return tolerances, bool(texts and ending)


#: places times queries of the ground truth: 64 MB
_MOST_CELLS = 1 << 26


def load_evaluated(
    folder: str | Path, files: TruthFiles
) -> tuple[MatchResult, GroundTruth, TruthFiles]:
    """Read a folder of results and its ground truth.

    Returns
    -------
    result : MatchResult
    truth : GroundTruth
    files : TruthFiles
        Of the truth, with the frame period that was used.

    Raises
    ------
    EdgeVprError
        If the folder or the ground truth cannot be used.
    """
    result = MatchResult.load(folder)
    reference, matches = result.reference, result.matches
    stride = 1 + len(matches) * len(reference) // _MOST_CELLS
    if result.queries is None and stride > 1:  # matched online: each match is a query
        some = matches.every(stride)
        note(f"one match in {stride} is evaluated: {len(some):,} of {len(matches):,}")
        matches, result = some, replace(result, matches=some)
    if files.frame_period is None and reference.frame_period is not None:
        files = replace(files, frame_period=str(reference.frame_period))
    return result, truth_of(result, files), files


def read_there(folder: Path, named: str, path: str) -> Path:
    """Return a file that a command named, which is perhaps not run in the present folder.

    Parameters
    ----------
    folder : path
        Of results, where it is now.
    named : str
        The same folder, as the command named it: the end of its path says where the command ran.
    path : str
        The file, as the command named it.
    """
    there = folder.resolve()
    for part in reversed(Path(os.path.normpath(named)).parts):
        if part != there.name or part == os.sep:
            return Path(path)
        there = there.parent
    return there / path if (there / path).exists() else Path(path)


def evaluated_truth(folder: Path) -> TruthFiles | None:
    """Return the ground truth of the last `edge-vpr evaluate` of a folder; None if there was none.

    Raises
    ------
    UsageError
        If one of its files has moved or changed.
    """
    metrics = read_json(folder / results.METRICS, "metrics", "match again")
    if "truth" not in metrics:
        return None
    with parse_errors(folder / results.METRICS, "metrics", "evaluate again"):
        files = from_json(TruthFiles, metrics["truth"])
        record = from_json(RunRecord, metrics["evaluated_by"])
    verb, words = find_verb(list(record.command[1:]))
    named = VerbParser(verb).parse(words).results if verb == "evaluate" else ""
    for file in record.inputs:
        there = read_there(folder, named, file.path)
        if not there.exists() or replace(results.hash_input(there), path=file.path) != file:
            raise UsageError(
                f"{file.path} has moved or changed since the evaluation: run edge-vpr evaluate "
                "again"
            )
    where = (str(read_there(folder, named, path)) for path in files.files)
    return replace(files, files=tuple(where))


def truth_of(result: MatchResult, files: TruthFiles) -> GroundTruth:
    """Read the truth of the matches."""
    return files(result.reference.place_time_us, result.query_time_us)
