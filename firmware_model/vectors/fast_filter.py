"""The place filter by NumPy, with which cases are drawn; the specification writes them.

A test holds it to the specification.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from firmware_model.specification import (
    GAIN_STEP,
    Advanced,
    Filter,
    FilterMap,
    Rows,
    Seen,
    decide,
    evidence,
    see,
)
from fixedpoint.activity import BANK_COSTS, SAME_ROW

_Array = npt.NDArray[np.int64]


def changed(metrics: Rows, no_change: Callable[[int, int], bool] | None = None) -> _Array:
    """Return what `change_gain` returns, without some of the changes."""
    rows = np.array(metrics)
    rows -= rows.min()
    gains = range(len(rows))
    costs = [
        [1 << 20 if no_change and no_change(g, h) else GAIN_STEP * abs(h - g) for g in gains]
        for h in gains
    ]
    return np.asarray((rows + np.array(costs)[:, :, None]).min(axis=1))


def predictions(
    filter_map: FilterMap, state: Filter, seen: Seen, rows: _Array, best: _Array
) -> list[list[int]]:
    """Return what `predict` returns, with restarts from metrics of `best` of each gain."""
    if state.place is None:
        return [[0] * rows.shape[1] for _ in rows]
    left = seen.activity - np.add.outer(filter_map.gains, filter_map.activity)
    at = np.clip((left + 4) >> 3, -SAME_ROW, len(BANK_COSTS[1]) - 1 - SAME_ROW) + SAME_ROW
    costs = np.array(filter_map.costs)[at * (not seen.stands)]
    reached = np.repeat(best[:, None] + filter_map.restart, rows.shape[1], axis=1)
    for step in range(min(costs.shape[2], rows.shape[1])):
        moved = rows[:, : rows.shape[1] - step] + costs[:, step:, step]
        reached[:, step:] = np.minimum(reached[:, step:], moved)
    return [list(map(int, row)) for row in reached]


def advanced_by(
    filter_map: FilterMap, state: Filter, activity: int, paused: bool, distances: Rows
) -> Advanced:
    """Return what `advance` returns."""
    seen, rows = see(filter_map, state, activity, paused), changed(state.metrics)
    predicted = predictions(filter_map, state, seen, rows, rows.min(axis=1))
    return decide(filter_map, state, seen, predicted, evidence(filter_map, state, seen, distances))
