"""The interface of the systems that the method is compared with, and their comparison."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol, cast

import numpy as np
import numpy.typing as npt
from edge_vpr_tools.sweep.trial import fastest

from edge_vpr.confidence import Acceptance
from edge_vpr.descriptors.activity import activity_of_drive, place_activity
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import UsageError
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.drive import match_by_filter
from edge_vpr.matching.matches import Matches
from edge_vpr.matching.place_filter import PATIENCE, PATIENCE_SMOOTHED, PlaceFilter
from edge_vpr.matching.prediction import TransitionCosts, Transitions
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
    """Part of a baseline whose descriptions are vectors of numbers, without learned parameters.

    It draws no random numbers, so the seed that every baseline is made with is not used.
    """

    def __init__(self, seed: int = 0) -> None: ...

    def prepare(self, reference: Images) -> None:
        """Do nothing: no parameters are taken from the reference."""

    def bits_per_place(self, places: Described) -> int:
        """Return the size of one description in bits."""
        return 8 * int(places.itemsize) * int(places.shape[1])

    def operations_per_place(self, places: Described) -> int:
        """Return the number of differences or products to add, without those of describing."""
        return int(places.shape[1])


# Compare the windows of two drives by a baseline, and match by sequences or the place filter.


#: sequences add up integers; the largest distance is below 2 to this power
_BITS = 30
#: the same for the place filter, whose spread of distances must stay below 2 to the power of 16
_FILTER_BITS = 12


@dataclass(frozen=True, eq=False)
class Compared:
    """Distances of a baseline, and their cost."""

    distances: npt.NDArray[np.float64]  #: Shape (K, Q): of every place to every query window.
    bytes_per_place: int  #: Size of one stored description in bytes, rounded up.
    #: Number of differences, products or words of bits to compare one query with the whole map.
    operations: int
    #: Time to describe a counted window and to compare it with the map, in microseconds on this
    #: computer: of each the shortest of three measurements.
    query_us: float


def compare(baseline: Baseline, reference: Images, queries: Images) -> Compared:
    """Compare every window of a query drive with every place by a baseline.

    Parameters
    ----------
    reference, queries : ndarray of int, shape (K, height, width) and (Q, height, width)
        Event counts of windows at all pixels.
    """
    baseline.prepare(reference)
    places = baseline.describe(reference)
    described, describe_s = fastest(lambda: baseline.describe(queries))
    distances, compare_s = fastest(lambda: baseline.distances(places, described))
    return Compared(
        distances,
        -(-baseline.bits_per_place(places) // 8),
        baseline.operations_per_place(places) * len(places),
        1e6 * (describe_s + compare_s) / len(queries),
    )


def match_distances(
    distances: npt.NDArray[np.floating], query_us: npt.NDArray[np.int64], settings: Settings
) -> Matches:
    """Match by sequences over a matrix of distances.

    Parameters
    ----------
    distances : ndarray of float, shape (K, Q)
        0 or more, finite. Rounding errors are at most 2**-29 of the largest distance.
    query_us : ndarray of int64, shape (Q,)
        Centres of the queries.
    settings : Settings
        Only `sequence_length` and `exclusion` are used.
    """
    sums = sequence_sums(_whole(distances, _BITS), settings.sequence_length)
    best = BestSequences.of(sums, settings.exclusion)
    return sequence_matches([best], settings, len(distances), query_us, Acceptance(None, None))


def filter_distances(
    distances: npt.NDArray[np.floating],
    activity: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]],
    query_us: npt.NDArray[np.int64],
    settings: Settings,
) -> Matches:
    """Match by the place filter over a matrix of distances, with its shipped probabilities.

    It has one gain and no typical distances, since there are no distances of sums of windows, and
    none from place to place.

    Parameters
    ----------
    distances : ndarray of float, shape (K, Q)
        0 or more, finite; rounded to 12 bits.
    activity : (ndarray of int64, ndarray of int64), shapes (K,) and (Q,)
        Events of each place and of each query window.
    query_us : ndarray of int64, shape (Q,)
        Middle of each query window, in microseconds.
    settings : Settings
        Of the filter, `precision` among them.
    """
    settings = settings.replaced({"gains": 1}, "distances")
    matrix = _GivenDistances(_whole(distances, _FILTER_BITS))
    # the only counter of a window says which column of the matrix it is
    of_places, of_queries = activity
    transitions = Transitions(
        len(of_places), TransitionCosts.of(settings), place_activity(of_places),
        exclusion=settings.exclusion_places,
    )  # fmt: skip
    patience = PATIENCE_SMOOTHED if settings.smooth else PATIENCE
    place_filter = PlaceFilter(transitions, activity_of_drive(of_places), patience)
    accepted = Acceptance.of(settings)
    queries = _numbered(of_queries, query_us)
    return match_by_filter(place_filter, cast(ReferenceIndex, matrix), queries, settings, accepted)


class _GivenDistances:
    """Distances in place of those that `ReferenceIndex` would compute."""

    def __init__(self, whole: npt.NDArray[np.int64]) -> None:
        self._rows = np.ascontiguousarray(whole.T, dtype=np.int32)
        self.places = len(whole)

    def rows(self, windows: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
        """Return the distances of windows, shape (n, K)."""
        return self._rows[windows[:, 0]]


def _numbered(events: npt.NDArray[np.int64], time_us: npt.NDArray[np.int64]) -> Descriptors:
    """Return windows that count their own number."""
    numbers = np.arange(len(events), dtype=np.uint32)
    return Descriptors(numbers[:, None], time_us, time_us, events, events)


def _whole(distances: npt.NDArray[np.floating], bits: int) -> npt.NDArray[np.int64]:
    """Return distances as integers below 2 to the power of `bits`."""
    if not (np.isfinite(distances).all() and (distances >= 0).all()):
        raise UsageError("a distance is negative or not finite: give 0 or more at all places")
    # scaled by a power of two, so that integers stay integers and ties stay ties
    _, exponent = math.frexp(float(distances.max()))
    return np.minimum(
        np.rint(np.ldexp(distances, bits - exponent)).astype(np.int64), (1 << bits) - 1
    )
