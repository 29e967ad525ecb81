"""Drives that leave the map: pieces cut out of a map, a jump, and windows of another street."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.windows import Descriptors, overlapping
from edge_vpr.evaluation.ground_truth import GroundTruth
from lab.pairs import MappedPair

#: names of the versions of a drive
WHOLE, CUT, DETOUR, CARRIED = "whole", "a piece cut out", "a detour", "carried off twice"
BACKWARDS, ANOTHER = "backwards", "another route"


@dataclass(frozen=True, eq=False)
class Spliced(MappedPair):
    """Map, and a drive that was put together from pieces."""

    #: Shape (n,): whether the drive changes within a window, which then shows both sides.
    changes: npt.NDArray[np.bool_]


def without_places(pair: MappedPair, first: int, last: int) -> MappedPair:
    """Remove the places from `first` up to, but without, `last` from the map."""
    kept = np.ones(len(pair.reference), dtype=np.bool_)
    kept[first:last] = False
    reference = replace(pair.reference, places=pair.reference.places.take(kept))
    truth = GroundTruth(pair.truth.correct[kept], pair.truth.has_truth, "part of the map")
    return MappedPair(reference, pair.counted, truth)


def carried_off(pair: MappedPair, first: int, last: int, parts: int = 1) -> Spliced:
    """Reorder a drive: up to part `first`, then from `last` on, then the parts between.

    Parameters
    ----------
    parts : int
        How many parts of the drive are a window, see `spliced`.
    """
    every = np.arange(len(pair.counted))
    return spliced(pair, np.r_[every[:first], every[last:], every[first:last]], parts)


def with_detour(pair: MappedPair, elsewhere: Descriptors, at: int, parts: int = 1) -> Spliced:
    """Insert the parts of another drive before part `at`; no place is correct for them."""
    n, more = len(pair.counted), len(elsewhere)
    columns = {
        name: np.concatenate([column, elsewhere.to_arrays()[name]])
        for name, column in pair.counted.to_arrays().items()
    }
    nowhere = np.zeros((len(pair.reference), more), dtype=np.bool_)
    truth = GroundTruth(
        np.concatenate([pair.truth.correct, nowhere], axis=1),
        np.concatenate([pair.truth.has_truth, np.ones(more, dtype=np.bool_)]),
        "with a detour",
    )
    joined = MappedPair(pair.reference, Descriptors(**columns), truth)
    return spliced(joined, np.r_[0:at, n : n + more, at:n], parts)


def spliced(pair: MappedPair, order: npt.NDArray[np.int64], parts: int = 1) -> Spliced:
    """Put a drive together from its parts, and make windows of them.

    Parameters
    ----------
    pair : MappedPair
        Map, and the parts of a drive, each with the truth of the window that ends with it.
    order : ndarray of int64, shape (n,)
        Part of the drive that comes at each time.
    parts : int
        How many parts are a window.

    Returns
    -------
    Spliced
        The truth of a window is that of its last part: where the robot is then.
    """
    order = order[: len(order) // parts * parts]
    last, has_place = order[parts - 1 :: parts], pair.truth.has_place[order]
    follows = (np.diff(order) == 1) & (has_place[1:] == has_place[:-1])
    changes = np.asarray(~np.append(False, follows).reshape(-1, parts)[:, 1:].all(axis=1))
    counted = overlapping(pair.counted.take(order), parts).take(slice(None, None, parts))
    if (np.diff(order) != 1).any():  # the windows follow one another without gaps
        step = counted.window_us
        start = np.arange(len(counted), dtype=np.int64) * step
        counted = replace(counted, start_us=start, end_us=start + step)
    truth = GroundTruth(pair.truth.correct[:, last], pair.truth.has_truth[last], "spliced")
    return Spliced(pair.reference, counted, truth, changes)
