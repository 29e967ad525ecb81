"""Record of one match of the localiser."""

from __future__ import annotations

import numpy as np

#: One match. Fields, in this order: time in microseconds; best place (ties: the lowest) and best
#: place outside the exclusion zone (-1: none); their distances, summed over the L windows of the
#: sequence; best divided by second-best distance; number of events at the selected pixels in the
#: newest window, and its start; trust, the higher the surer (with the place filter that of
#: `place_filter.FilterMatch`, with sequences the margin); probability of being right (NaN if not
#: known); whether the match is lost at the precision of the settings. With the place filter,
#: metrics replace distances, and one window replaces the sequence.
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
