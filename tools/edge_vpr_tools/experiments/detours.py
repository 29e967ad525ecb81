"""Drives that leave the map: pieces cut out of a map, a jump, and windows of another street."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.descriptors import Descriptors
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.matching.drive_matching import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap


@dataclass(frozen=True, eq=False)
class Case:
    """Map, counts of a query, and their truth.

    Parameters
    ----------
    reference : ReferenceMap
    counted : Descriptors
        Counts of the query at the map's pixels.
    truth : GroundTruth
    """

    reference: ReferenceMap
    counted: Descriptors
    truth: GroundTruth

    def match(self) -> Matches:
        """Match the query with the map's settings."""
        queries = self.reference.coded(self.counted)
        return match_descriptors(self.reference.places, queries, self.reference.settings)


def without_places(case: Case, first: int, last: int) -> Case:
    """Remove the places from `first` up to, but without, `last` from the map."""
    kept = np.ones(len(case.reference), dtype=np.bool_)
    kept[first:last] = False
    reference = replace(case.reference, places=case.reference.places.take(kept))
    truth = GroundTruth(case.truth.correct[kept], case.truth.known, "part of the map")
    return Case(reference, case.counted, truth)


def carried_off(case: Case, first: int, last: int) -> Case:
    """Reorder a drive: up to window `first`, then from `last` on, then the windows between."""
    windows = np.arange(len(case.counted))
    return _reordered(case, np.r_[windows[:first], windows[last:], windows[first:last]])


def with_detour(case: Case, elsewhere: Descriptors, at: int) -> Case:
    """Insert the windows of another drive before window `at`; no place is right for them."""
    n, more = len(case.counted), len(elsewhere)
    columns = {
        name: np.concatenate([column, elsewhere.to_arrays()[name]])
        for name, column in case.counted.to_arrays().items()
    }
    nowhere = np.zeros((len(case.reference), more), dtype=np.bool_)
    truth = GroundTruth(
        np.concatenate([case.truth.correct, nowhere], axis=1),
        np.concatenate([case.truth.known, np.ones(more, dtype=np.bool_)]),
        "with a detour",
    )
    joined = Case(case.reference, Descriptors(**columns), truth)
    return _reordered(joined, np.r_[0:at, n : n + more, at:n])


def _reordered(case: Case, windows: npt.NDArray[np.int64]) -> Case:
    truth = GroundTruth(case.truth.correct[:, windows], case.truth.known[windows], "spliced")
    counted = case.counted.take(windows)
    # the spliced windows follow one another without gaps
    step = int(np.median(counted.end_us - counted.start_us))
    start = np.arange(len(windows), dtype=np.int64) * step
    return Case(case.reference, replace(counted, start_us=start, end_us=start + step), truth)
