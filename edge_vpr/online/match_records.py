"""One match of the localiser as a record."""

from __future__ import annotations

import numpy as np

#: One match: time in microseconds; best place (ties: the lowest) and the best one outside the
#: exclusion zone (-1: none); their distances, summed over the L windows of the sequence; best over
#: second; events at the selected pixels in the newest window, and its start; trust, higher is
#: surer (of the place filter as `place_filter.FilterMatch` has it, of sequences the margin);
#: probability of being right (NaN: not known), and whether the match is lost at the precision that
#: the settings want. The place filter has metrics in place of distances, and windows in place of
#: sequences.
MATCH_DTYPE = np.dtype(
    [
        ("t", "<i8"),
        ("place", "<i8"),
        ("distance_sum", "<i8"),
        ("second", "<i8"),
        ("second_sum", "<i8"),
        ("ratio", "<f8"),
        ("events", "<i8"),
        ("start", "<i8"),
        ("trust", "<i8"),
        ("probability", "<f8"),
        ("lost", "?"),
    ]
)
