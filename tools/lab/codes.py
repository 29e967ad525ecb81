"""Codes of counts that no profile has: what their tables in the documentation rest on.

A code is of a pair that holds counts: its map and the query are coded, and matched as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.activity import activity_of_drive
from edge_vpr.descriptors.codes import counted_events, drive_mean, encode, limits_of
from edge_vpr.descriptors.windows import Descriptors, narrow
from edge_vpr.reference_map import ReferenceMap
from fixedpoint.own_mean import ContrastCode

Whole = npt.NDArray[np.int64]
Kind = Literal["linear", "sqrt", "log"]


class Code(Protocol):
    """What a pair of counts is coded by."""

    @property
    def bits(self) -> int:
        """Bits of a code."""
        ...

    def coded(
        self, reference: ReferenceMap, counted: Descriptors
    ) -> tuple[Descriptors, Descriptors]:
        """Return the places of a map of counts, and the windows of a query, in this code."""
        ...


@dataclass(frozen=True)
class TableCode:
    """A table from count to code, which does not depend on the drive.

    A count c up to the full scale F has this code, rounded to the nearest (halves up), where top is
    ``min(2**bits - 1, F)``; any larger count has the code top:

    - linear: ``top c / F``, where F is ``2**bits - 1``
    - sqrt: ``top sqrt(c / F)``, where F is 63
    - log: ``top log(1 + c) / log(1 + F)``, where F is 127

    Parameters
    ----------
    per_pixel : bool
        Whether each pixel has its own F, of its counts in the reference; see `usual_scales`.
    """

    kind: Kind
    bits: int = 3
    per_pixel: bool = False

    def coded(
        self, reference: ReferenceMap, counted: Descriptors
    ) -> tuple[Descriptors, Descriptors]:
        """Return the places of a map of counts, and the windows of a query, in this code."""
        scales = self._scales(reference)
        places, windows = (
            replace(each, counts=self._encode(each.counts, scales), selected=each.selected_events)
            for each in (reference.places, counted)
        )
        return places, windows

    def blurred(self, reference: ReferenceMap) -> ReferenceMap:
        """Return a map of counts with those in the middle of the counts that have the same code."""
        places, scales = reference.places, self._scales(reference)
        codes, counts = self._encode(places.counts, scales), np.empty(places.counts.shape, np.int64)
        for scale, columns in _of_scale(scales):
            table = self.table(scale)
            every = np.arange(int(table[-1]) + 1)
            first = np.searchsorted(table, every, side="left")
            middle = (first + np.searchsorted(table, every, side="right") - 1) // 2
            middle[-1] = scale
            counts[:, columns] = middle[codes[:, columns]]
        coarse = replace(places, counts=narrow(counts), selected=places.selected_events)
        return replace(reference, places=coarse)

    def table(self, scale: int) -> Whole:
        """Return the code of each count up to a full scale; exact, the same on every machine."""
        of_kind: Callable[[Whole, int, int], Whole] = {
            "linear": _linear, "sqrt": _square_root, "log": _logarithm,
        }[self.kind]  # fmt: skip
        return of_kind(np.arange(scale + 1), min((1 << self.bits) - 1, scale), scale)

    def _scales(self, reference: ReferenceMap) -> Whole:
        if self.per_pixel:
            return usual_scales(reference.windows.counts)
        scale = {"linear": (1 << self.bits) - 1, "sqrt": 63, "log": 127}[self.kind]
        return np.full(len(reference.pixel_map), scale)

    def _encode(
        self, counts: npt.NDArray[np.integer], scales: Whole
    ) -> npt.NDArray[np.unsignedinteger]:
        codes = np.empty(counts.shape, np.int64)
        for scale, columns in _of_scale(scales):
            some = np.minimum(counts[:, columns].astype(np.int64), scale)
            codes[:, columns] = self.table(scale)[some]
        return narrow(codes)


def usual_scales(counts: npt.NDArray[np.integer]) -> Whole:
    """Return the least ``2**n - 1``, n from 1 to 16, that holds nine of ten counts of a pixel.

    Parameters
    ----------
    counts : ndarray of int, shape (K, J)

    Returns
    -------
    ndarray of int64, shape (J,)
    """
    usual = np.sort(counts, axis=0)[-(-9 * len(counts) // 10) - 1].tolist()
    return np.array([(1 << min(max(c.bit_length(), 1), 16)) - 1 for c in usual])


def _of_scale(scales: Whole) -> Iterator[tuple[int, npt.NDArray[np.intp]]]:
    """Yield each full scale, and the counters that have it."""
    for scale in np.unique(scales).tolist():
        yield scale, np.flatnonzero(scales == scale)


def _linear(counts: Whole, top: int, scale: int) -> Whole:
    return (2 * top * counts + scale) // (2 * scale)


def _square_root(counts: Whole, top: int, scale: int) -> Whole:
    # floor(y + 1/2) = (floor(2 y) + 1) // 2; below 2**52, floor and root are exact in float64
    return (np.sqrt(4 * top * top * counts // scale).astype(np.int64) + 1) // 2


def _logarithm(counts: Whole, top: int, scale: int) -> Whole:
    code = top * np.log(1 + counts) / math.log(1 + scale) + 0.5
    nearest = np.rint(code)
    codes = np.floor(code).astype(np.int64)
    # 1e-6 is larger than the error of any machine
    for i in np.flatnonzero(abs(code - nearest) <= 1e-6).tolist():
        count, near = int(counts[i]), int(nearest[i])
        # code >= n holds where (1 + count)**(2 top) >= (1 + scale)**(2 n - 1), in integers
        reached = near > 0 and (1 + count) ** (2 * top) >= (1 + scale) ** (2 * near - 1)
        codes[i] = near if reached else near - 1
    return codes


class OwnMean(ContrastCode):
    """The contrast code without the mean of a window: it changes with the speed of the camera."""

    def window_mean(self, deviations: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
        """Return 0 for each window."""
        return np.zeros(deviations.shape[:-1], np.int64)

    def coded(
        self, reference: ReferenceMap, counted: Descriptors
    ) -> tuple[Descriptors, Descriptors]:
        """Return the places of a map of counts, and the windows of a query, in this code."""
        limits = limits_of(reference.windows.counts)
        places, windows, query = (
            replace(each, counted=counted_events(each.counts, limits))
            for each in (reference.places, reference.windows, counted)
        )
        activity = activity_of_drive(windows.counted_events)
        codes = self.encode(places.counts, drive_mean(windows, self, activity))
        places = replace(places, counts=codes, selected=places.selected_events)
        return places, encode(query, self, activity, 1)
