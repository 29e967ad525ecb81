"""Rejection: how well right matches are distinguished from wrong ones and from unmapped queries."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Rejection:
    """Result of rejecting matches by a threshold on the trust, for queries on and off the map.

    Attributes
    ----------
    on_map, off_map : int
        Queries that have a right place in the map, and those that have none.
    right_on_map : float or None
        Share of the queries on the map whose match is right; None if there is none.
    found_at_99_precision : float or None
        Most queries on the map that can be matched right, as a share of them, with 99 % of the
        accepted matches right, those of queries off the map included. The threshold is the best
        one in hindsight.
    off_map_auroc : float or None
        Probability that a query off the map has less trust than one on the map, ties by half;
        None unless there are both.
    accepted : int or None
        Matches not marked lost; None where no precision was wanted.
    precision, recall : float or None
        Of the accepted matches: the share that is right, and the right ones as a share of the
        queries on the map. None where nothing is accepted, or no query is on the map.
    """

    on_map: int
    off_map: int
    right_on_map: float | None
    found_at_99_precision: float | None
    off_map_auroc: float | None
    accepted: int | None = None
    precision: float | None = None
    recall: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


def judge_rejection(
    trust: npt.NDArray[np.integer],
    correct: npt.NDArray[np.bool_],
    has_place: npt.NDArray[np.bool_],
    accepted: npt.NDArray[np.bool_] | None = None,
) -> Rejection:
    """Compare trust and rejection with the ground truth.

    Parameters
    ----------
    trust : ndarray of int, shape (n,)
        More is surer.
    correct : ndarray of bool, shape (n,)
        Whether the match is right.
    has_place : ndarray of bool, shape (n,)
        Whether the query has a right place in the map.
    accepted : ndarray of bool, shape (n,), optional
        Which matches are not marked lost.
    """
    on_map = int(np.count_nonzero(has_place))
    right = int(np.count_nonzero(correct))
    levels, level = np.unique(trust, return_inverse=True)
    size = levels.size
    # from the highest trust down
    taken = np.cumsum(np.bincount(level, minlength=size)[::-1])
    right_taken = np.cumsum(np.bincount(level[correct], minlength=size)[::-1])
    precise = 100 * right_taken >= 99 * taken
    found = int(right_taken[precise].max()) if precise.any() else 0
    marked: dict[str, Any] = {}
    if accepted is not None:
        count, good = int(np.count_nonzero(accepted)), int(np.count_nonzero(correct & accepted))
        marked = {
            "accepted": count,
            "precision": good / count if count else None,
            "recall": good / on_map if on_map else None,
        }
    return Rejection(
        on_map,
        len(trust) - on_map,
        right / on_map if on_map else None,
        found / on_map if on_map else None,
        auroc(trust[has_place], trust[~has_place]),
        **marked,
    )


def auroc(higher: npt.NDArray[np.integer], lower: npt.NDArray[np.integer]) -> float | None:
    """Return the probability that one of `higher` is above one of `lower`, ties counting half.

    Parameters
    ----------
    higher, lower : ndarray of int, shapes (n,) and (m,)

    Returns
    -------
    float or None
        The area under the receiver operating characteristic; None if one is empty.
    """
    if higher.size == 0 or lower.size == 0:
        return None
    ordered = np.sort(lower)
    below = np.searchsorted(ordered, higher, side="left").sum(dtype=np.int64)
    not_above = np.searchsorted(ordered, higher, side="right").sum(dtype=np.int64)
    return float(below + not_above) / (2 * higher.size * lower.size)
