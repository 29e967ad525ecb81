"""The interface of the systems that the method is compared with, and their comparison."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import Acceptance
from edge_vpr.matching.matches import Matches
from edge_vpr.matching.sequences import BestSequences, sequence_matches, sequence_sums
from edge_vpr.settings import Settings

# Interface of the systems that the method is compared with.


Images = npt.NDArray[np.integer]
Described = npt.NDArray[Any]


class Baseline(Protocol):
    """A system that describes windows and compares descriptions.

    Images are either event counts of windows at all pixels, shape (n, height, width), of 16 bits or
    more, or intensities of 8 bits.
    """

    @property
    def title(self) -> str:
        """Name in tables."""
        ...

    def prepare(self, reference: Images) -> None:
        """Choose or learn parameters from the reference drive; called once, before all others."""
        ...

    def describe(self, images: Images) -> Described:
        """Return one description for each window, shape (n, D)."""
        ...

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return the distance of each query to each place, shape (K, Q), 0 or more."""
        ...

    def bits_per_place(self, places: Described) -> int:
        """Return the size of one stored description in bits."""
        ...

    def operations_per_place(self, places: Described) -> int:
        """Return the number of differences, products or words of bits of one comparison."""
        ...


class VectorBaseline:
    """Part of a baseline whose descriptions are vectors of numbers, without learned parameters."""

    def prepare(self, reference: Images) -> None:
        """Do nothing: no parameters are taken from the reference."""

    def bits_per_place(self, places: Described) -> int:
        """Return the size of one description in bits."""
        return 8 * int(places.itemsize) * int(places.shape[1])

    def operations_per_place(self, places: Described) -> int:
        """Return the number of differences or products to add, without those of describing."""
        return int(places.shape[1])


# Match one pair of drives with a baseline and sequences, and measure the cost of a match.


#: sequences add up integers; the largest distance is below 2 to this power
_BITS = 30
#: how often the same work is timed
_REPETITIONS = 3

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Compared:
    """Matches of a baseline, and their cost.

    Attributes
    ----------
    matches : Matches
    bytes_per_place : int
        Size of one stored description in bytes, rounded up.
    operations : int
        Number of differences, products or words of bits to compare one query with the whole map.
    describe_us, match_us : float
        Time of one query in microseconds, measured on this computer: to describe its counted
        window, and to compare it with the map. The shortest of three measurements.
    """

    matches: Matches
    bytes_per_place: int
    operations: int
    describe_us: float
    match_us: float

    @property
    def query_us(self) -> float:
        """Time to describe and to match one query, in microseconds."""
        return self.describe_us + self.match_us


def compare(
    baseline: Baseline,
    reference: Images,
    queries: Images,
    query_us: npt.NDArray[np.int64],
    settings: Settings,
) -> Compared:
    """Match every window of a query drive with a baseline.

    Parameters
    ----------
    baseline : Baseline
    reference, queries : ndarray of int, shape (K, height, width) and (Q, height, width)
        Event counts of windows at all pixels.
    query_us : ndarray of int64, shape (Q,)
        Centre of each query window.
    settings : Settings
        `sequence_length`, `anchor` and `exclusion` are used.

    Raises
    ------
    UsageError
        If the sequence is longer than a traverse.
    """
    baseline.prepare(reference)
    places = baseline.describe(reference)
    described, describe_s = fastest(lambda: baseline.describe(queries))
    distances, match_s = fastest(lambda: baseline.distances(places, described))
    return Compared(
        match_distances(distances, query_us, settings),
        -(-baseline.bits_per_place(places) // 8),
        baseline.operations_per_place(places) * len(places),
        1e6 * describe_s / len(queries),
        1e6 * match_s / len(queries),
    )


def fastest(work: Callable[[], T]) -> tuple[T, float]:
    """Do the same work three times, and return its result and the shortest time in seconds.

    What a first call compiles, and other programs on the computer, can only make it slower.

    Parameters
    ----------
    work : callable
        Returns the same each time.
    """
    shortest = math.inf
    for _ in range(_REPETITIONS):
        start = time.perf_counter()
        result = work()
        shortest = min(shortest, time.perf_counter() - start)
    return result, shortest


def match_distances(
    distances: npt.NDArray[np.floating], query_us: npt.NDArray[np.int64], settings: Settings
) -> Matches:
    """Match by sequences over a matrix of distances.

    Parameters
    ----------
    distances : ndarray of float, shape (K, Q)
        0 or more, finite. Rounding errors are at most 2**-29 of the largest distance.
    query_us : ndarray of int64, shape (Q,)
    settings : Settings
    """
    # scaled by a power of two, so that integers stay integers and ties stay ties
    _, exponent = math.frexp(float(distances.max()))
    whole = np.rint(np.ldexp(distances, _BITS - exponent)).astype(np.int64)
    sums = sequence_sums(whole, settings.sequence_length)
    found = BestSequences.of(sums, settings.exclusion)
    return sequence_matches([found], settings, len(distances), query_us, Acceptance(None, None))
