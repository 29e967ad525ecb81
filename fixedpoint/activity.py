"""Activity of a window: the logarithm of its events, and the costs of steps that follow from it.

A camera that moves slowly sees fewer events. The activity of a window, less that of a place, is
therefore a measure of the speed there, relative to the reference drive.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

#: number of logarithms in an octave
PARTS = 16
#: largest number of events of a window: larger ones saturate
EVENTS_TOP = (1 << 23) - 1
#: largest logarithm: 9 bits
LOG_TOP = 23 * PARTS
#: activity of a place against the mean of the reference: 8 bits with sign
PLACE_LOW, PLACE_HIGH = -128, 127

#: a row of `BANK_COSTS` spans ``2**COST_ROW_SHIFT`` parts of an octave; row of equal activity
COST_ROW_SHIFT, SAME_ROW = 3, 12
#: a window with no event, or less than 1/8 of the mean number, is a pause: it has no evidence
PAUSE_SHIFT = 3
#: evidence has a weight of up to ``2**WEIGHT_BITS``
WEIGHT_BITS = 3


def least_events() -> npt.NDArray[np.int64]:
    """Return the least number of events whose logarithm is 1, 2 ... `LOG_TOP`.

    The logarithm of n events is ``floor(16 log2(1 + n))``, which is the number of entries that are
    n or less.
    """
    # ceil(2**(j / 16)) - 1: four square roots, each rounded up
    least = []
    for j in range(1, LOG_TOP + 1):
        root = 1 << j
        for _ in range(4):
            root = math.isqrt(root - 1) + 1
        least.append(root - 1)
    return np.array(least, dtype=np.int64)


# The bank of gains: hypotheses of how many events the camera sends against that of the reference.


#: log2 of each hypothesis' gain, in parts of an octave: multiples of a row, so that the rows of
#: costs of two hypotheses are neighbours
GAINS = (-32, -24, -16, -8, 0, 8, 16)
#: numbers of newest windows in the sums that a hypothesis may look at
SUMS = (1, 2, 4)
#: below these mean speeds, in parts of an octave, a hypothesis looks at the next longer sum
SUM_LIMITS = (-12, -28)
#: shares of the windows that are expected to move on by 0, 1, 2 ... places, and the part of a
#: window that a robot drives which stands, by the number of places per window
BANK_SHARES = {1: (0.2, 0.55, 0.19, 0.04, 0.015), 2: (0.1, 0.2, 0.25, 0.2, 0.12, 0.07, 0.05)}
BANK_STANDS = {1: 0.3, 2: 0.15}
#: standard deviation of the activity at each speed, in octaves
BANK_OCTAVES = 1.1
#: cost of a step of 0, 1, 2 ... places in units of 1/4: a row for each half octave of the activity
#: that remains for the speed, from -6 to 3 octaves; see `bank_costs`
BANK_COSTS = {
    1: (
        (4, 60, 85, 106, 120), (4, 50, 74, 93, 107), (4, 41, 64, 82, 95), (4, 33, 54, 72, 84),
        (4, 26, 46, 62, 74), (4, 20, 38, 53, 64), (4, 15, 31, 45, 56), (4, 10, 24, 38, 48),
        (4, 7, 19, 32, 41), (4, 4, 15, 26, 35), (5, 2, 11, 22, 29), (7, 0, 8, 18, 25),
        (9, 0, 6, 15, 21), (12, 0, 5, 12, 18), (16, 1, 4, 10, 15), (19, 1, 2, 8, 12),
        (22, 2, 1, 6, 10), (27, 3, 1, 5, 8), (31, 5, 1, 4, 6),
    ),
    2: (
        (4, 42, 60, 73, 84, 94, 102), (4, 34, 50, 62, 73, 82, 89), (4, 27, 41, 52, 62, 71, 78),
        (4, 21, 33, 44, 53, 61, 68), (4, 16, 26, 36, 44, 52, 58), (4, 11, 20, 28, 36, 44, 49),
        (4, 8, 15, 22, 29, 36, 41), (4, 5, 10, 17, 23, 29, 34), (5, 3, 7, 12, 18, 23, 28),
        (6, 1, 4, 8, 13, 18, 22), (9, 1, 2, 5, 10, 14, 17), (12, 1, 0, 3, 7, 11, 14),
        (16, 3, 0, 1, 5, 8, 11), (21, 5, 0, 1, 3, 6, 8), (27, 7, 1, 1, 3, 5, 7),
        (32, 10, 2, 1, 2, 4, 5), (38, 13, 3, 1, 1, 3, 4), (43, 15, 5, 1, 1, 2, 2),
        (50, 19, 6, 2, 1, 1, 1),
    ),
}  # fmt: skip


def bank_costs(places_per_window: int) -> npt.NDArray[np.int64]:
    """Compute `BANK_COSTS` from `BANK_SHARES`, and from the speed that each step stands for.

    A step costs ``-ln(share)``, and that of a normal distribution of the activity around that of
    its length in windows. Fewer events than those of standing are no surprise. The cheapest step of
    a row costs at most 3 below the speed of the reference, and at most 1/4 from there on.

    Parameters
    ----------
    places_per_window : {1, 2}
        Number of places that start in one window of the reference.

    Returns
    -------
    ndarray of int64, shape (19, steps)
    """
    share = np.array(BANK_SHARES[places_per_window])
    share /= share.sum()
    lengths = np.maximum(np.arange(share.size) / places_per_window, BANK_STANDS[places_per_window])
    octaves = (np.arange(len(BANK_COSTS[places_per_window])) - SAME_ROW) / 2
    off = octaves[:, None] - np.log2(lengths)
    off[:, 0] = np.maximum(off[:, 0], 0)
    cost = off**2 / (2 * BANK_OCTAVES**2) - np.log(share)
    least = cost.min(axis=1, keepdims=True)
    most = np.where(octaves[:, None] < 0, 3, 0.25)
    return np.rint(4 * (cost - least + np.minimum(least - least.min(), most))).astype(np.int64)
