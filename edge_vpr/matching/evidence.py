"""Evidence: how much a window speaks against each place, by its distances to all of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.matching.prediction import FRACTION_BITS, LANES, UNUSED, Narrow
from fixedpoint.activity import SUM_LIMITS, WEIGHT_BITS

#: largest evidence: 8 bits
EVIDENCE_TOP = (1 << 8) - 1
#: fraction bits of the reciprocal of the spread
RECIPROCAL_FRACTION_BITS = 16
#: shift of the product of this reciprocal and a weight that leaves the fraction bits of evidence
FACTOR_SHIFT = RECIPROCAL_FRACTION_BITS - FRACTION_BITS + WEIGHT_BITS


@kernel
def reciprocal_of_spread(distances: npt.NDArray[np.integer]) -> int:
    """Return ``floor(2**16 / s)``, with s the mean absolute deviation of the distances.

    Parameters
    ----------
    distances : ndarray of int, shape (K,)
        From a window to each place.

    Returns
    -------
    int
        The mean of the distances is rounded down; s is rounded down and at least 1.
    """
    total = np.int64(0)
    for distance in distances:
        total += np.int64(distance)
    mean = total // distances.size
    spread = np.int64(0)
    for distance in distances:
        spread += abs(np.int64(distance) - mean)
    return (1 << RECIPROCAL_FRACTION_BITS) // max(int(spread) // distances.size, 1)


#: surplus of events, in 1/16 octave, from which the evidence has weight; below `-FEW`, a window has
#: few events
SEEN_FROM, FEW = 56, 48


@kernel(inline="always")
def weight_of(surplus: int) -> int:
    """Return the weight of the evidence of a window, in units of 1/8.

    A camera that hardly moves repeats its view, with fewer events.

    Parameters
    ----------
    surplus : int
        Activity of the window less that which the place before should have at this gain.
    """
    return min(max((surplus + SEEN_FROM) >> 1, 0), 1 << WEIGHT_BITS)


@kernel
def evidence_of(
    distances: npt.NDArray[np.integer],
    reciprocal: int,
    weight: int,
    out: npt.NDArray[np.uint8],
) -> None:
    """Compute the evidence ``min((D - min D) / s, 255) * weight``, with fraction bits.

    Parameters
    ----------
    distances : ndarray of int, shape (K,)
        D. Only differences matter: adding a constant changes nothing.
    reciprocal : int
        Reciprocal of s, see `reciprocal_of_spread`. It is 0 for a spread above 2**16, and so is all
        evidence then.
    weight : int
        See `weight_of`.
    out : ndarray of uint8, shape (K,)
        Evidence against each place.
    """
    shift = RECIPROCAL_FRACTION_BITS - FRACTION_BITS
    # larger differences saturate the evidence, and products up to this one fit into 32 bits
    most = np.int64((EVIDENCE_TOP << shift) // max(reciprocal, 1) + 1)
    least = np.int64(distances[0])
    for distance in distances:
        least = min(least, np.int64(distance))
    factor = np.int32(reciprocal)
    for k in range(out.size):
        difference = np.int32(min(np.int64(distances[k]) - least, most))
        unweighted = (difference * factor) >> shift
        out[k] = (min(unweighted, np.int32(EVIDENCE_TOP)) * weight) >> WEIGHT_BITS


#: the mean speed of a drive moves by 1/64 of the difference, and has 4 more fraction bits
SPEED_SHIFT, SPEED_BITS = 6, 4


@kernel(inline="always")
def speed_after(speed: int, moved: int, activity: int) -> int:
    """Return the mean activity of a drive after a window, in units of 1/256 octave.

    Parameters
    ----------
    moved : int
        Number of windows that have moved it: the mean of the first 64, then a running mean.
    """
    shift = 0
    while (1 + moved) >> (shift + 1) > 0 and shift < SPEED_SHIFT:
        shift += 1
    return speed + (((activity << SPEED_BITS) - speed) >> shift)


@kernel(inline="always")
def sum_of(speed: int, gain: int) -> int:
    """Return which sum of windows a hypothesis looks at: the slower the drive by it, the longer."""
    mean, which = (speed >> SPEED_BITS) - gain, 0
    for limit in SUM_LIMITS:
        which += mean < limit
    return which


@kernel(inline="always")
def sum_by_distance(eighths: int) -> int:
    """Return which sum of 1, 2 or 4 windows covers about the distance of a window of the map.

    Up to 5/8 and 2/8 of it in a window, twice as many windows come nearer, as a ratio.

    Parameters
    ----------
    eighths : int
        Distance driven in a window, see `Transitions.weight_by_distance`.
    """
    return int(eighths <= 5) + int(eighths <= 2)


@kernel(inner=True)
def evidence_of_sum(
    distances: npt.NDArray[np.integer],
    bias: npt.NDArray[np.int64],
    before: int,
    weight: int,
    out: npt.NDArray[np.uint8],
) -> tuple[int, int]:
    """Compute the evidence of a sum of windows, see `evidence_of`.

    Parameters
    ----------
    bias : ndarray of int64, shape (K,)
        Added to the distances, see `prediction.bias_of`.
    before : int
        Reciprocal of the spread in the window before; 0 takes that of this window.

    Returns
    -------
    scale, reciprocal : int
        Reciprocal that was used, and that of this window.
    """
    biased = np.empty(bias.size, dtype=np.int64)
    for k in range(bias.size):
        biased[k] = np.int64(distances[k]) + bias[k]
    own = reciprocal_of_spread(biased)
    scale = before if before > 0 else own
    evidence_of(biased, scale, weight, out)
    return scale, own


@kernel(inner=True)
def add(
    metric: Narrow,
    of_sums: npt.NDArray[np.uint8],
    sums: npt.NDArray[np.int64],
    hypotheses: int,
    most: int,
    out: Narrow,
) -> None:
    """Write the metrics with the evidence of the sum of each hypothesis, at most `most`.

    All sums fit into 16 bits, and those of hypotheses in use stay below `UNUSED`.

    Parameters
    ----------
    metric : ndarray of int16, shape (K, LANES)
        Without the evidence.
    of_sums : ndarray of uint8, shape (sums, K)
        Evidence against each place of each sum of windows.
    sums : ndarray of int64, shape (LANES,)
        Sum that each hypothesis looks at.
    out : ndarray of int16, shape (K, LANES)
        Hypotheses that are not in use become `most`, of at most `UNUSED`.
    """
    size, n_sums = metric.size, len(of_sums)
    lanes = np.zeros((n_sums + 1, LANES), dtype=np.int16)
    for h in range(hypotheses):
        lanes[sums[h], h] = 1
    for h in range(hypotheses, LANES):
        lanes[n_sums, h] = UNUSED
    # a word of four lanes, multiplied by the evidence, has it in those of its sum
    against = np.empty(metric.shape, dtype=np.int16)
    of_lanes, words = lanes.view(np.int64), against.view(np.int64)
    for k in range(len(metric)):
        words[k, 0], words[k, 1] = of_lanes[n_sums, 0], of_lanes[n_sums, 1]
    for s in range(n_sums):
        low, high = of_lanes[s, 0], of_lanes[s, 1]
        if low == high == 0:  # no hypothesis looks at this sum
            continue
        for k in range(len(metric)):
            words[k, 0] += of_sums[s, k] * low
            words[k, 1] += of_sums[s, k] * high
    before, after, added = metric.flat, out.flat, against.flat
    for j in range(size):
        after[j] = min(np.int16(before[j] + added[j]), np.int16(most))
