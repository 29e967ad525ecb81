"""One match: the fields that the kernels of the localiser write, and arrays of them."""

from __future__ import annotations

from typing import NamedTuple, get_type_hints

import numpy as np
import numpy.typing as npt


class MatchRow(NamedTuple):
    """One match, with the column names of ``matches.csv``.

    With the place filter, distances are metrics and L is 1.
    """

    time_us: int  #: Time of the match, by the clock of the events.
    #: Best place; the first one in a tie. Of a map ``route.along_m[place]`` are its metres.
    place: int
    distance: float  #: Of the best place: mean over the L windows of the sequence.
    second: int  #: Best place outside the exclusion zone; -1 if there is none.
    second_distance: float  #: Its distance; NaN if there is none.
    ratio: float  #: `distance` / `second_distance`; NaN if there is no second place.
    ties: int  #: Other places with the same distance.
    events: int  #: Number in the newest window, at the selected pixels.
    start_us: int  #: Start of the newest window.
    #: See `filter_match.FilterMatch`, with sequences the margin; higher means more confident.
    trust: int
    misfit: int  #: See `filter_match.FilterMatch`; -1 with sequences.
    probability: float  #: That the match is correct; NaN if unknown.
    lost: bool  #: Whether it is rejected at the precision of the settings.


#: Records with the fields of `MatchRow`.
MATCH_DTYPE = np.dtype(list(get_type_hints(MatchRow).items()))
#: arrays of MATCH_DTYPE
MatchRows = list[npt.NDArray[np.void]]
NO_MATCHES = np.empty(0, dtype=MATCH_DTYPE)


def join_matches(found: MatchRows) -> npt.NDArray[np.void]:
    """Concatenate arrays of matches; one alone is returned as it is."""
    if len(found) == 1:
        return found[0]
    return np.concatenate(found) if found else NO_MATCHES
