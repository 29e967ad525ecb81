"""Learning the probability of a correct match from its trust, and checking probabilities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import Confidence
from edge_vpr.errors import UsageError

#: each step holds at least one in so many of all matches, unless its block holds fewer
ONE_IN = 256
#: bins of the reliability diagram and of the expected calibration error
BINS = 10


def isotonic(
    values: npt.NDArray[np.floating], weights: npt.NDArray[np.floating]
) -> npt.NDArray[np.int64]:
    """Return the blocks of the weighted least-squares non-decreasing fit (pool adjacent violators).

    Parameters
    ----------
    values, weights : ndarray of float, shape (n,)
        In order; the weights are positive.

    Returns
    -------
    ndarray of int64, shape (m,)
        Where each block begins; the fit is the weighted mean of each block, and rises strictly
        from block to block.
    """
    blocks: list[tuple[int, float, float]] = []  # start, weighted sum, weight
    for i, (value, weight) in enumerate(zip(values.tolist(), weights.tolist(), strict=True)):
        start, total = i, value * weight
        while blocks and blocks[-1][1] * weight >= total * blocks[-1][2]:
            start, more, heavier = blocks.pop()
            total, weight = more + total, heavier + weight
        blocks.append((start, total, weight))
    return np.array([start for start, _, _ in blocks], dtype=np.int64)


def learn_confidence(trust: npt.NDArray[np.integer], correct: npt.NDArray[np.bool_]) -> Confidence:
    """Fit a table of probabilities to matches that are known to be correct or wrong.

    Steps are the blocks of an isotonic regression, with Laplace's estimate
    ``(correct + 1) / (matches + 2)``. It draws blocks of few matches towards 1/2; they are joined
    until the estimates rise. A long block is divided into several steps of its probability.

    Parameters
    ----------
    trust : ndarray of int, shape (n,)
        Of each match.
    correct : ndarray of bool, shape (n,)
        Whether each match is correct.
    """
    if trust.size == 0 or trust.shape != correct.shape:
        raise UsageError(
            f"{trust.size} matches with {correct.size} truths: a table of probabilities is learnt "
            "from one match or more, each correct or wrong"
        )
    levels, level = np.unique(trust.astype(np.int64), return_inverse=True)
    matches = np.bincount(level)
    n_correct = np.bincount(level, weights=correct).astype(np.int64)
    starts = isotonic(n_correct / matches, matches.astype(np.float64))
    blocks: list[tuple[int, int, int]] = []
    for start, k, n in zip(
        levels[starts].tolist(),
        np.add.reduceat(n_correct, starts).tolist(),
        np.add.reduceat(matches, starts).tolist(),
        strict=True,
    ):
        block = (start, k, n)
        while blocks and _laplace(blocks[-1]) >= _laplace(block):
            low = blocks.pop()
            block = (low[0], low[1] + block[1], low[2] + block[2])
        blocks.append(block)
    first = np.array([block[0] for block in blocks], dtype=np.int64)
    probability = np.array([_laplace(block) for block in blocks], dtype=np.float64)
    kept = _finer(levels, matches, first)
    return Confidence(
        levels[kept],
        probability[np.searchsorted(first, levels[kept], side="right") - 1],
        np.add.reduceat(matches, kept),
    )


def _finer(
    levels: npt.NDArray[np.int64], matches: npt.NDArray[np.int64], first: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Return the levels at which steps start: those of blocks, and some within long blocks.

    A step within a block has the block's probability. It lets a threshold lie within the block.
    """
    least = max(int(matches.sum()) // ONE_IN, 1)
    kept, held = [], 0
    for i, starts in enumerate(np.isin(levels, first).tolist()):
        if starts or held >= least:
            kept.append(i)
            held = 0
        held += int(matches[i])
    return np.array(kept, dtype=np.int64)


def _laplace(block: tuple[int, int, int]) -> float:
    return (block[1] + 1) / (block[2] + 2)


@dataclass(frozen=True, eq=False)
class Reliability:
    """How often matches of each probability are correct."""

    #: Shape (m,): mean probability of each bin that holds matches.
    probability: npt.NDArray[np.float64]
    right: npt.NDArray[np.float64]  #: Shape (m,): share of correct matches in it.
    matches: npt.NDArray[np.int64]  #: Shape (m,): number of matches in it.

    @property
    def expected_calibration_error(self) -> float:
        """Mean of ``|right - probability|`` over all matches."""
        gap = np.abs(self.right - self.probability)
        return float((gap * self.matches).sum() / self.matches.sum())

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {
            "expected_calibration_error": self.expected_calibration_error,
            "probability": self.probability.tolist(),
            "right": self.right.tolist(),
            "matches": self.matches.tolist(),
        }


def reliability(
    probability: npt.NDArray[np.floating], correct: npt.NDArray[np.bool_]
) -> Reliability:
    """Compare probabilities with the share of correct matches, in bins of equal width.

    Parameters
    ----------
    probability : ndarray of float, shape (n,)
        From 0 to 1; n of at least 1.
    correct : ndarray of bool, shape (n,)
        Whether each match is correct.

    Returns
    -------
    Reliability
        Of the bins that hold matches.
    """
    bin_of = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
    matches = np.bincount(bin_of, minlength=BINS)
    held = matches > 0
    counted = matches[held]
    return Reliability(
        np.bincount(bin_of, weights=probability, minlength=BINS)[held] / counted,
        np.bincount(bin_of, weights=correct, minlength=BINS)[held] / counted,
        counted,
    )
