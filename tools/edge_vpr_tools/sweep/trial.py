"""A trial of a sweep: one setting of the method on one pair of drives."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import edge_vpr
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.matching.drive import match_query
from edge_vpr.recordings import Recording, open_recording
from edge_vpr.recordings.reading import OnFault, TimeUnit, crop_of
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from edge_vpr_tools.truth_files import TruthFiles

#: measures of `sweep.MEASURES` by name, and ``tolerance`` and ``version``
Measured = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class PairOfDrives:
    """Two recordings, the options for reading them, and the ground truth of the second."""

    #: reference, query: paths of the recordings.
    reference: str
    query: str
    ground_truth: tuple[str, ...]  #: Files, as for `edge-vpr evaluate --ground-truth`.
    #: tolerance, rows, frame_period, offset: as the flags of `evaluate` with these names.
    tolerance: tuple[float, ...] = ()
    rows: str | None = None
    frame_period: str | None = None
    offset: tuple[float, float] | None = None
    #: sensor, format, time_unit, topic, columns, on_fault: as the flags of `map` with these names,
    #: for both drives.
    sensor: str | None = None
    format: str | None = None
    time_unit: TimeUnit | None = None
    topic: str | None = None
    columns: str | None = None
    on_fault: OnFault = "error"
    #: start, end, start_offset: for the reference and for the query: seconds at which to start, at
    #: which to end, and from which these count, as the flags with these names.
    start: tuple[str, str] | None = None
    end: tuple[str, str] | None = None
    start_offset: tuple[str, str] | None = None

    @property
    def truths(self) -> list[TruthFiles]:
        """Ground truth by each tolerance, which is read when it is called with window centres."""
        return [
            TruthFiles(self.ground_truth, each, self.rows, self.frame_period, self.offset)
            for each in self.tolerance or (None,)
        ]

    def open(self, which: int) -> Recording:
        """Open the reference (0) or the query (1).

        Raises
        ------
        EdgeVprError
            If it cannot be read.
        """
        recording = open_recording(
            (self.reference, self.query)[which], format=self.format, sensor=self.sensor,
            on_fault=self.on_fault, frame_period=self.frame_period, topic=self.topic,
            time_unit=self.time_unit, columns=self.columns,
        )  # fmt: skip
        seconds = (self.start, self.end, self.start_offset)
        crop = crop_of(*(None if pair is None else pair[which] for pair in seconds))
        return recording if crop is None else recording.cropped(crop)


class Trial(NamedTuple):
    """A variant on a pair of drives with a seed; can be sent to another process or machine."""

    variant: str
    drives: str
    settings: Settings  #: With the seed.
    pair: PairOfDrives


def run_trial(trial: Trial) -> list[Measured]:
    """Map, match and evaluate; return what was measured by each tolerance of the pair.

    Raises
    ------
    EdgeVprError
        If an input cannot be used.
    """
    pair = trial.pair
    for file in (pair.reference, pair.query, *pair.ground_truth):
        if not Path(file).exists():
            raise UsageError(
                f"{file} is not there: name one that is, on a cluster by a path that all workers "
                "share"
            )
    reference = ReferenceMap.build(pair.open(0), trial.settings)
    matched = reference.match(pair.open(1))
    queries = matched.queries
    assert queries is not None
    # the first match of a new worker would add the time of compiling and loading
    matches, matching_s = fastest(partial(match_query, reference, queries))
    rows: list[Measured] = []
    for truth in pair.truths:
        evaluation = evaluate(matches, truth(reference.place_time_us, matched.query_time_us))
        rows.append(
            {
                "tolerance": evaluation.truth.tolerance_text,
                "precision_at_100_recall": evaluation.precision_at_100_recall,
                "recall_at_99_precision": evaluation.recall_at_99_precision,
                "average_precision": evaluation.average_precision,
                **{f"recall_at_{n}": evaluation.recall_at[n] for n in (1, 5, 10)},
                "queries": evaluation.queries,
                "packed_bytes_per_window": reference.packed_bytes_per_window,
                "differences_per_match": reference.places.counts.size,
                "microseconds_per_match": 1e6 * matching_s / len(matches),
                "version": edge_vpr.__version__,
            }
        )
    return rows


T = TypeVar("T")
#: how often work is timed, and the time from which it is timed one time less
_REPETITIONS, _LONG_S = 3, 1.0


def fastest(work: Callable[[], T]) -> tuple[T, float]:
    """Do the same work three times, and return its result and the shortest time in seconds.

    What a first call compiles, and other programs on the computer, can only make it slower. Work of
    more than a second is done twice.
    """
    shortest = math.inf
    for repetition in range(_REPETITIONS):
        start = time.perf_counter()
        result = work()
        shortest = min(shortest, time.perf_counter() - start)
        if repetition == _REPETITIONS - 2 and shortest > _LONG_S:
            break
    return result, shortest
