"""Null baselines: matches of a query without information about the route.

The place filter assumes that a drive continues along the route. Correct matches of shuffled windows
or pixels come from this assumption alone; those of a constant speed from start to end, which does
not use the query at all, come from the similarity of the two drives.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import evaluate
from lab.loop import CHOSEN_ON, Row
from lab.pairs import MappedPair

#: data that chose the parameters of the default, of methods of others, and of no parameters
BY_US, BY_AUTHORS, BY_NOBODY = "streets and the real drives", "its authors", "none"
CONSTANT_SPEED = "null: constant speed from start to end"


def null_queries(
    counted: Descriptors, rng: np.random.Generator
) -> Iterator[tuple[str, Descriptors]]:
    """Yield queries that show nothing of the route, by name, with the times of the query."""
    windows = len(counted)
    for name, shown in (
        ("windows shuffled", counted.take(rng.permutation(windows))),
        ("query reversed", counted.take(np.arange(windows)[::-1])),
        # independent permutations, and one: the latter keeps how many events each window has
        (
            "pixels shuffled in each window",
            replace(counted, counts=rng.permuted(counted.counts, axis=1)),
        ),
        ("pixels shuffled once", replace(counted, counts=rng.permutation(counted.counts, axis=1))),
    ):
        # at the times of the query, so that only what is seen differs
        timed = replace(shown, start_us=counted.start_us, end_us=counted.end_us)
        yield f"null: {name}", timed


def scrambled(pair: MappedPair, rng: np.random.Generator) -> dict[str, MappedPair]:
    """Return the null queries of a pair by name; what is correct of them, is by chance."""
    queries = null_queries(pair.counted, rng)
    return {name: replace(pair, counted=shown) for name, shown in queries}


def constant_speed(truth: GroundTruth) -> float:
    """Return the share of windows with known truth that a constant speed matches correctly."""
    places, windows = truth.correct.shape
    along = np.rint(np.arange(windows) * (places - 1) / max(windows - 1, 1)).astype(np.int64)
    return float(truth.correct[along, np.arange(windows)][truth.has_truth].mean())


def null_rows(
    pair: MappedPair, rng: np.random.Generator, column: str, ending: str = ""
) -> Iterator[Row]:
    """Yield a row for each null baseline of a pair, with the settings of its map.

    Parameters
    ----------
    column : str
        Column of the name.
    ending : str
        Of the names of all but the constant speed, which has no settings and no row if this is not
        empty.
    """
    for name, shown in scrambled(pair, rng).items():
        evaluation = evaluate(shown.match(), pair.truth)
        yield {
            column: name + ending,
            CHOSEN_ON: BY_US,
            "P@100R": evaluation.precision_at_100_recall,
            "R@99P": evaluation.recall_at_99_precision,
        }
    if not ending:
        yield {column: CONSTANT_SPEED, CHOSEN_ON: BY_NOBODY, "P@100R": constant_speed(pair.truth)}
