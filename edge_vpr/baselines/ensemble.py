"""Ensembles: the mean distance of several systems with different descriptors or windows.

Ensemble-Event-VPR (Fischer and Milford, 2020) averages the distances of one descriptor over windows
of several lengths. Here any descriptors can be joined. The distances of each member are therefore
first divided by their mean between places of the reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.baselines.baseline import Baseline, Described, Images
from edge_vpr.baselines.dense import all_pixels, patch_normalised
from edge_vpr.baselines.hog import hog
from edge_vpr.errors import UsageError


class Member(NamedTuple):
    """One system of an ensemble.

    Attributes
    ----------
    baseline : Baseline
    windows : int
        Number of neighbouring windows whose sum the system gets, at each window.
    """

    baseline: Baseline
    windows: int = 1


class Ensemble:
    """Mean of the members' distances; each is divided by its mean between different places.

    Raises
    ------
    UsageError
        If there is no member, or a member sums no windows.
    """

    def __init__(self, title: str, members: Sequence[Member]) -> None:
        if not members or any(member.windows < 1 for member in members):
            raise UsageError(
                f"an ensemble of {[member.windows for member in members]} windows: give one member "
                "or more, each with 1 window or more"
            )
        self.title = title
        self._members = list(members)
        self._scales = np.ones(len(members))

    def prepare(self, reference: Images) -> None:
        """Prepare each member, and measure the mean distance between its places."""
        for i, member in enumerate(self._members):
            images = summed(reference, member.windows)
            member.baseline.prepare(images)
            places = member.baseline.describe(images)
            distances = member.baseline.distances(places, places)
            between = distances[~np.eye(len(distances), dtype=np.bool_)]
            mean = float(between.mean()) if between.size else 0.0
            self._scales[i] = mean if mean > 0 else 1.0

    def describe(self, images: Images) -> Described:
        """Return a record for each window, with the description by each member as a field."""
        parts = [
            member.baseline.describe(summed(images, member.windows)) for member in self._members
        ]
        kind = np.dtype([(str(i), part.dtype, part.shape[1:]) for i, part in enumerate(parts)])
        described = np.empty(len(images), kind)
        for i, part in enumerate(parts):
            described[str(i)] = part
        return described

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return the mean distances, shape (K, Q)."""
        total = np.zeros((len(places), len(queries)))
        for i, (member, scale) in enumerate(zip(self._members, self._scales, strict=True)):
            a, b = (np.ascontiguousarray(rows[str(i)]) for rows in (places, queries))
            total += member.baseline.distances(a, b) / scale
        return np.asarray(total / len(self._members))

    def bits_per_place(self, places: Described) -> int:
        """Return the total bits of all members' descriptions."""
        return sum(
            member.baseline.bits_per_place(places[str(i)]) for i, member in enumerate(self._members)
        )

    def operations_per_place(self, places: Described) -> int:
        """Return the total operations of all members."""
        return sum(
            member.baseline.operations_per_place(places[str(i)])
            for i, member in enumerate(self._members)
        )


def summed(images: Images, windows: int) -> Images:
    """Return for each window the sum of `windows` neighbours around it.

    If the number is even, one more neighbour lies after the window than before it. The first and
    the last window are repeated beyond the ends.

    Parameters
    ----------
    images : ndarray of int, shape (n, height, width)
    windows : int

    Returns
    -------
    ndarray of int, shape (n, height, width)
        `images` itself for 1 window, else of 64 bits.

    Examples
    --------
    >>> summed(np.array([1, 2, 4, 8]).reshape(4, 1, 1), 2).ravel()
    array([ 3,  6, 12, 16])
    """
    if windows == 1:
        return images
    before = (windows - 1) // 2
    padded = np.pad(images, ((before, windows - 1 - before), (0, 0), (0, 0)), mode="edge")
    total = np.zeros(images.shape, np.int64)
    for shift in range(windows):
        total += padded[shift : shift + len(images)]
    return total


def windows_ensemble(seed: int) -> Ensemble:
    """Make the ensemble of patch-normalised 1, 2 and 4 windows; it draws no random numbers."""
    members = [Member(patch_normalised(seed), windows) for windows in (1, 2, 4)]
    return Ensemble("ensemble of 1, 2 and 4 windows, patch-normalised", members)


def descriptors_ensemble(seed: int) -> Ensemble:
    """Make the ensemble of all pixels, patch-normalised and HOG; it draws no random numbers."""
    members = [Member(make(seed)) for make in (all_pixels, patch_normalised, hog)]
    return Ensemble("ensemble of all pixels, patch-normalised and HOG", members)
