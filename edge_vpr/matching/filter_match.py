"""A match of the place filter, and the columns in which kernels write it."""

from __future__ import annotations

from typing import NamedTuple


class FilterMatch(NamedTuple):
    """Match of the place filter in a window.

    Attributes
    ----------
    place : int
        Place of the least metric; the first one in a tie.
    metric : int
        Its metric.
    second, second_metric : int
        Place of the least metric outside the exclusion zone and its metric; -1 if there is none.
    ties : int
        Number of other places with the least metric.
    trust : int
        Confidence in the match, 0 to 368; higher means more confident. It is the support, a running
        mean of the margins (second metric less the least) up to this window, less the largest
        residual (evidence against the matched place) of this window and the two before. See
        `support_after` and `trust_of`.
    misfit : int
        How much worse than in a drive along the map in the same light, which is 0, about the last
        sixteen windows fit the matched places. See `window_misfit`.
    """

    place: int
    metric: int
    second: int
    second_metric: int
    ties: int
    trust: int
    misfit: int


#: Number of the column of each field where matches are rows of an array.
PLACE, METRIC, SECOND, SECOND_METRIC, TIES, TRUST, MISFIT = range(len(FilterMatch._fields))
