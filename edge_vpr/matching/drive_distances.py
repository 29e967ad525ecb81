"""Matrix of the distances of all query windows of a drive to all places."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.descriptors import Descriptors
from edge_vpr.errors import UsageError
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.drive_matching import check_counts, check_no_ways, filter_of
from edge_vpr.matching.filtered_drive import filter_drive
from edge_vpr.matching.sequence import anchor_offset, check_length
from edge_vpr.odometry import Odometry
from edge_vpr.settings import Settings

#: largest size of a matrix, in bytes
MOST_BYTES = 2 << 30


def drive_distances(
    places: Descriptors,
    queries: Descriptors,
    settings: Settings,
    *,
    jumps: npt.NDArray[np.int32] | None = None,
    along_mm: npt.NDArray[np.int64] | None = None,
    odometry: Odometry | None = None,
) -> npt.NDArray[np.float64]:
    """Return the distance of every place to every query window, as matching compares them.

    Parameters
    ----------
    places, queries : Descriptors
        K and Q of them.
    settings : Settings
    jumps, along_mm, odometry
        As `match_descriptors` takes them.

    Returns
    -------
    ndarray of float64, shape (K, Q)
        All finite. By sequences, D_seq (method.md section 5): the mean distance of L windows
        along the diagonal; where a sequence would leave the matrix, the mean of those inside it.
        By the place filter, its metric at each place.

    Raises
    ------
    MapError
        If the descriptors differ in length.
    UsageError
        If the matrix is larger than 2 GiB, or as `match_descriptors` raises.
    """
    check_counts(places, queries)
    size = len(places) * len(queries) * 8
    if size > MOST_BYTES:
        raise UsageError(
            f"the distances of {len(queries):,} queries to {len(places):,} places take "
            f"{size / 1e9:.1f} GB: read a part (--end), or take longer windows (--tau)"
        )
    index = ReferenceIndex(places.counts)
    out = np.zeros((len(places), len(queries)), dtype=np.float64)
    if settings.matching == "filter":
        place_filter = filter_of(places, settings, jumps, along_mm)
        filter_drive(
            place_filter, index, queries, odometry,
            smooth=settings.smooth, delay=settings.late, metrics=out,
        )  # fmt: skip
        return out
    check_no_ways(jumps, odometry is not None)
    length = settings.sequence_length
    check_length(length, len(places), len(queries))
    distances = index.matrix(queries.counts)
    inside = np.zeros(out.shape, dtype=np.int32)
    before = anchor_offset(length, settings.anchor)
    for step in range(-before, length - before):
        # D[k + step, q + step] at [k, q], where both are in the matrix
        k, q = (slice(max(0, -step), n - max(0, step)) for n in out.shape)
        k_on, q_on = (slice(max(0, step), n - max(0, -step)) for n in out.shape)
        out[k, q] += distances[k_on, q_on]
        inside[k, q] += 1
    return out / inside
