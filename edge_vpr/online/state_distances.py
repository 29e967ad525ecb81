"""Computation of all distances of the windows to the places, and the layout of the map by pixel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.windows import Window
from edge_vpr.errors import UsageError
from edge_vpr.matching.distances import ReferenceIndex, aligned_zeros
from edge_vpr.online.state import TOTALS, Sliding, empty_windows
from edge_vpr.online.vector_kernels import BLOCK, LANES
from fixedpoint.codes import PixelCodes


def start(
    places: npt.NDArray[np.unsignedinteger], window: Window, length: int, codes: PixelCodes | None
) -> Sliding:
    """Build the state before the first event.

    Parameters
    ----------
    places : ndarray of unsigned int, shape (K, J)
        Map, in codes if there are any.
    window : FixedTime or FixedCount
    length : int
        L.
    codes : PixelCodes, optional
        What the counts of a window become before they are compared.
    """
    state = empty_windows(window, length, places.shape[1])
    if codes is not None:
        state.counters["table"] = codes.row
        state = state._replace(code=codes.tables)
    return with_distances(state, places)


def with_distances(s: Sliding, places: npt.NDArray[np.unsignedinteger]) -> Sliding:
    """Lay a map out by pixel, and compute all distances of the present counters."""
    length = len(s.counts)
    # an odd number of whole vectors: with a power of two, all columns of a place would share the
    # same lines of the cache
    count, stride = len(places) - length + 1, (len(places) // LANES + 2 | 1) * LANES
    columns = aligned_zeros(places.shape[1] * stride + LANES, places.dtype)
    columns[: places.shape[1] * stride].reshape(-1, stride)[:, : len(places)] = places.T
    low, high = places.min(axis=0).astype(np.int64), places.max(axis=0).astype(np.int64)

    coded = _coded(s)
    # places with the smallest counts fill the last vector
    spare = np.broadcast_to(low.astype(places.dtype), (LANES, len(low)))
    index = ReferenceIndex(np.concatenate([places, spare]))
    distances = np.zeros(count + LANES, dtype=np.int64)
    for lag in range(length):
        end = length - 1 - lag
        distances += index.distances(coded[lag])[end : end + count + LANES]
    base = int(np.abs(coded - np.clip(coded, low, high)).sum())
    # without the base, no distance is larger than this; those of filling places always are, so that
    # a search can include them
    largest = length * int((high - low).sum())
    if 2 * largest + 1 > np.iinfo(np.uint32).max:
        raise UsageError(
            f"distances of up to {largest} do not fit 32 bits: take fewer pixels, a shorter "
            "sequence, or a counter code"
        )
    distances[count:] += largest + 1
    dtype = np.uint16 if 2 * largest + 1 <= np.iinfo(np.uint16).max else np.uint32
    sums = aligned_zeros(count + LANES + -(-count // BLOCK), dtype)
    sums[: count + LANES] = distances - base
    _find_least(sums, count)
    counters = s.counters.copy()
    counters["low"], counters["high"] = low, high
    return s._replace(
        columns=columns,
        counters=counters,
        sums=sums,
        totals=np.array([(base, 0, stride, count)], dtype=TOTALS).view(np.recarray),
    )


def compared(s: Sliding, index: ReferenceIndex) -> Sliding:
    """Compute all distances again after the codes of the counters have changed.

    Parameters
    ----------
    s : Sliding
        Of one window, with all moves taken.
    index : ReferenceIndex
        The map.
    """
    coded, count = _coded(s)[0], index.places
    base = int(np.abs(coded - np.clip(coded, s.counters["low"], s.counters["high"])).sum())
    s.sums[:count] = index.distances(coded) - base
    s.totals["common"] = base
    _find_least(s.sums, count)
    return s


def _find_least(sums: npt.NDArray[np.unsignedinteger], count: int) -> None:
    """Write the smallest sum of each block after the sums, see `vector_kernels.least_in`."""
    sums[count + LANES :] = np.minimum.reduceat(sums[:count], np.arange(0, count, BLOCK))


def _coded(s: Sliding) -> npt.NDArray[np.int64]:
    """Return the codes of the counters of each lag, shape (L, J)."""
    if s.code.size == 0:
        return s.counts
    return s.code[s.counters["table"], np.minimum(s.counts, s.code.shape[1] - 1)].astype(np.int64)
