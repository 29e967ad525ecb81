"""Record of one match of the localiser."""

from __future__ import annotations

import numpy as np

#: One match. With the place filter, metrics replace distances, and one window the sequence.
MATCH_DTYPE = np.dtype(
    [
        ("t", "<i8"),  # time, in microseconds
        ("place", "<i8"),  # the best; of equal ones the first
        ("distance_sum", "<i8"),  # its distance, summed over the L windows of the sequence
        ("second", "<i8"),  # the best place outside the exclusion zone; -1: there is none
        ("second_sum", "<i8"),  # its distance
        ("ratio", "<f8"),  # best distance / second-best distance
        ("events", "<i8"),  # in the newest window, at the selected pixels
        ("start", "<i8"),  # of the newest window, in microseconds
        # the higher the surer: of `place_filter.FilterMatch`, or with sequences the margin
        ("trust", "<i8"),
        ("probability", "<f8"),  # of being right; NaN: not known
        ("lost", "?"),  # below the precision of the settings
    ]
)
