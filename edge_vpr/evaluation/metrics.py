"""Metrics of matches, with named definitions (method.md section 6)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import GroundTruthError, UsageError, expect
from edge_vpr.evaluation.calibration import Reliability, reliability
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.matching.matches import Matches
from edge_vpr.settings import Score

# Rejection: how well correct matches are distinguished from wrong ones and from unmapped queries.


@dataclass(frozen=True)
class Rejection:
    """Result of rejecting matches by a threshold on the trust, for queries on and off the map."""

    #: on_map, off_map: queries that have a correct place in the map, and those that have none.
    on_map: int
    off_map: int
    #: Share of the queries on the map whose match is correct; None if there is none.
    right_on_map: float | None
    #: Largest share of the queries on the map that is matched correctly while 99 % of all accepted
    #: matches, of queries off the map too, are correct. The threshold is chosen in hindsight.
    found_at_99_precision: float | None
    #: Probability that a query off the map has less trust than one on the map, ties counting half;
    #: None unless there are both.
    off_map_auroc: float | None
    accepted: int | None = None  #: Matches not marked lost; None where no precision was wanted.
    #: precision: share of correct matches among the accepted ones; None if none is accepted.
    #: recall: accepted correct matches as a share of the queries on the map; None without such.
    precision: float | None = None
    recall: float | None = None


def evaluate_rejection(
    trust: npt.NDArray[np.integer],
    correct: npt.NDArray[np.bool_],
    has_place: npt.NDArray[np.bool_],
    accepted: npt.NDArray[np.bool_] | None = None,
) -> Rejection:
    """Compare trust and rejection with the ground truth.

    Parameters
    ----------
    trust : ndarray of int, shape (n,)
        Higher is more confident.
    correct : ndarray of bool, shape (n,)
        Whether the match is correct.
    has_place : ndarray of bool, shape (n,)
        Whether the query has a correct place in the map.
    accepted : ndarray of bool, shape (n,), optional
        Which matches are not marked lost.
    """
    on_map = int(np.count_nonzero(has_place))
    n_correct = int(np.count_nonzero(correct))
    levels, level = np.unique(trust, return_inverse=True)
    size = levels.size
    # from the highest trust down
    taken = np.cumsum(np.bincount(level, minlength=size)[::-1])
    right_taken = np.cumsum(np.bincount(level[correct], minlength=size)[::-1])
    precise = 100 * right_taken >= 99 * taken
    precise_correct = int(right_taken[precise].max()) if precise.any() else 0
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
        n_correct / on_map if on_map else None,
        precise_correct / on_map if on_map else None,
        auroc(trust[has_place], trust[~has_place]),
        **marked,
    )


def auroc(higher: npt.NDArray[np.integer], lower: npt.NDArray[np.integer]) -> float | None:
    """Return the probability that one of `higher` is above one of `lower`, ties counting half.

    Parameters
    ----------
    higher, lower : ndarray of int, shapes (n,) and (m,)
        Scores of the two groups, for example of correct and of wrong matches.

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


RecallDenominator = Literal["rejected-correct", "all-with-place"]
#: scores of which a higher one means more confident
_RISING = ("margin", "trust")
RECALL_AT = (1, 5, 10, 25)


@dataclass(frozen=True, eq=False)
class PrecisionRecall:
    """Precision and recall at each threshold, from the strictest to accepting every match."""

    #: Shape (m,): a match is accepted if its score is at most this.
    threshold: npt.NDArray[np.float64]
    #: tp, fp, fn, shape (m,): correct matches accepted, wrong matches accepted, and queries missed
    #: by the denominator's definition.
    tp: npt.NDArray[np.int64]
    fp: npt.NDArray[np.int64]
    fn: npt.NDArray[np.int64]

    def __repr__(self) -> str:
        return f"PrecisionRecall({len(self.threshold)} thresholds)"

    @property
    def precision(self) -> npt.NDArray[np.float64]:
        """``tp / (tp + fp)``, shape (m,); 1 where nothing is accepted."""
        accepted = self.tp + self.fp
        return np.where(accepted == 0, 1.0, self.tp / np.maximum(accepted, 1))

    @property
    def recall(self) -> npt.NDArray[np.float64]:
        """``tp / (tp + fn)``, shape (m,); 0 where there is nothing to find."""
        return self.tp / np.maximum(self.tp + self.fn, 1)

    def recall_at_precision(self, percent: int) -> float:
        """Return the largest recall at a precision of `percent` or more; 0 if there is none."""
        # in integers, because 99 of 100 must count as 99 %
        enough = (100 * self.tp >= percent * (self.tp + self.fp)) & (self.tp > 0)
        return float(self.recall[enough].max()) if enough.any() else 0.0

    @property
    def average_precision(self) -> float:
        """Area under the curve as a sum of steps, ``sum (R_i - R_{i-1}) P_i``."""
        return float(np.sum(np.diff(self.recall, prepend=0.0) * self.precision))


def precision_recall(
    scores: npt.NDArray[np.floating],
    correct: npt.NDArray[np.bool_],
    has_place: npt.NDArray[np.bool_],
    *,
    recall_denominator: RecallDenominator = "rejected-correct",
) -> PrecisionRecall:
    """Sweep a threshold over the scores of the best matches, one step per distinct score.

    Parameters
    ----------
    scores : ndarray of float, shape (n,)
        Lower is more confident; NaN is taken as the least confident.
    correct : ndarray of bool, shape (n,)
        Whether the best match is correct.
    has_place : ndarray of bool, shape (n,)
        Whether the query has a true place in the map.
    recall_denominator
        What counts as missed (fn): see `evaluate`.
    """
    if recall_denominator not in get_args(RecallDenominator):
        raise UsageError(
            f"recall denominator {recall_denominator!r} is unknown: choose from "
            f"{', '.join(get_args(RecallDenominator))}"
        )
    scores = np.where(np.isnan(scores), np.inf, scores)
    order = np.argsort(scores, kind="stable")
    ascending = scores[order]
    cuts = np.unique(ascending)
    accepted = np.searchsorted(ascending, cuts, side="right")
    tp = np.concatenate([[0], np.cumsum(correct[order])])[accepted]
    missable = correct if recall_denominator == "rejected-correct" else has_place
    return PrecisionRecall(cuts, tp, accepted - tp, int(np.count_nonzero(missable)) - tp)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Result of `evaluate`.

    >>> from edge_vpr import ReferenceMap
    >>> from edge_vpr.simulation import simulate_pair
    >>> monday, tuesday = simulate_pair(0, "tiny", length_m=40)
    >>> result = ReferenceMap.build(monday, pixels=50).match(tuesday)
    >>> result.evaluate((monday.track, tuesday.track), tolerance_m=10)
    Evaluation(8 queries within 10 m, P@100R 1.000, R@99P 1.000)

    Attributes
    ----------
    queries : int
        Evaluated: matched, and it is known whether the match is correct.
    queries_unknown : int
        Matched, but it is not known whether the match is correct; left out of every figure.
    queries_without_place : int
        Evaluated, but no place of the map is correct for them, so that any match is wrong.
    queries_tied : int
        Evaluated, with other places at the same smallest distance.
    chance : float
        Share of correct matches that guessing would reach.
    correct : ndarray of bool, shape (n,)
        For each row of the matches; False where not evaluated.
    evaluated : ndarray of bool, shape (n,)
        Whether it is known if each match is correct.
    error : ndarray of float64, shape (n,)
        How far each match is from the true position, in `truth.error_unit`; NaN where not known.
    matches : Matches
        That were compared.
    truth : GroundTruth
        With which they were compared.
    recall_at : dict of int to float
        Recall@N: share of the evaluated queries with a true place that have one among the first N
        of `Matches.candidates`. A place whose position is not known is none.
    score, recall_denominator : str
        Score that the threshold applies to, and denominator of recall; see `evaluate`.
    rejection : Rejection
        How well a threshold on the trust rejects wrong matches.
    reliability : Reliability or None
        Of the probabilities; None where no evaluated match has one.
    """

    queries: int
    queries_unknown: int
    queries_without_place: int
    queries_tied: int
    chance: float
    correct: npt.NDArray[np.bool_]
    evaluated: npt.NDArray[np.bool_]
    error: npt.NDArray[np.float64]
    matches: Matches
    truth: GroundTruth
    curve: PrecisionRecall
    recall_at: dict[int, float]
    score: str
    recall_denominator: RecallDenominator
    rejection: Rejection
    reliability: Reliability | None

    def __repr__(self) -> str:
        return (
            f"Evaluation({self.queries} queries"
            + (f" and {self.queries_unknown} unknown" if self.queries_unknown else "")
            + (f" within {at.tolerance:g} {at.unit}" if (at := self.truth.positions) else "")
            + f", P@100R {self.precision_at_100_recall:.3f}, "
            f"R@99P {self.recall_at_99_precision:.3f})"
        )

    @property
    def average_precision(self) -> float:
        """Area under the precision-recall curve, as `curve` has it."""
        return self.curve.average_precision

    @property
    def precision_at_100_recall(self) -> float:
        """P@100R: share of correct matches when every query is matched."""
        return float(np.count_nonzero(self.correct) / self.queries)

    @property
    def recall_at_99_precision(self) -> float:
        """R@99P: largest recall at a precision of at least 99 %."""
        return self.curve.recall_at_precision(99)

    @property
    def findable(self) -> int:
        """Denominator of recall: the number of queries to find, by ``recall_denominator``."""
        return int(self.curve.tp[0] + self.curve.fn[0]) if len(self.curve.tp) else 0

    def curve_columns(self) -> dict[str, npt.NDArray[Any]]:
        """Return the points of the precision-recall curve as columns, from the strictest on.

        Returns
        -------
        dict of str to ndarray, each of shape (m,)
            ``threshold``: the worst `score` that is accepted, infinite if matches without a score
            are accepted too; ``tp``, ``fp``, ``fn``, ``precision``, ``recall``.
        """
        curve = self.curve
        threshold = -curve.threshold if self.score in _RISING else curve.threshold
        counts = {"tp": curve.tp, "fp": curve.fp, "fn": curve.fn}
        shares = {"precision": curve.precision, "recall": curve.recall}
        return {"threshold": threshold, **counts, **shares}

    def shares(self) -> dict[str, Any]:
        """Return the figures that depend most on the tolerance, as plain values for JSON."""
        return {
            "precision_at_100_recall": self.precision_at_100_recall,
            "recall_at_99_precision": self.recall_at_99_precision,
            "average_precision": self.curve.average_precision,
            "recall_at": {str(n): recall for n, recall in self.recall_at.items()},
            "queries": self.queries,
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {
            **self.shares(),
            "queries_unknown": self.queries_unknown,
            "queries_without_place": self.queries_without_place,
            "queries_tied": self.queries_tied,
            "chance": self.chance,
            "score": self.score,
            "recall_denominator": self.recall_denominator,
            "rejection": asdict(self.rejection),
            "reliability": None if self.reliability is None else self.reliability.to_dict(),
        }


def evaluate(
    matches: Matches,
    truth: GroundTruth,
    *,
    score: Score | None = None,
    recall_denominator: RecallDenominator = "rejected-correct",
) -> Evaluation:
    """Compare matches with the ground truth.

    Parameters
    ----------
    truth : GroundTruth
        Over all K places of the map and all query windows.
    score : {"distance", "ratio", "margin", "trust"}, optional
        Score of the thresholds of the precision-recall curve. By default the trust of the place
        filter, and of sequences the distance, or the ratio with codes other than linear ones.
    recall_denominator : {"rejected-correct", "all-with-place"}
        What counts as missed. ``rejected-correct``: a rejected query whose best match was correct,
        as in the released code; recall reaches 1 when everything is accepted. ``all-with-place``: a
        query that has a true place in the map and did not get it.
    """
    expect(matches, Matches, "matches", "Matches, as result.matches of ReferenceMap.match")
    expect(truth, GroundTruth, "truth", "a GroundTruth, as of from_tracks")
    places, queries = truth.correct.shape
    if places != matches.places_in_map or queries <= int(matches.query.max()):
        raise GroundTruthError(
            f"ground truth covers {places} places and {queries} queries, the matches "
            f"{matches.places_in_map} places and queries up to {matches.query.max()}: "
            + (
                "map with places_per_window=1 if it is for whole windows"
                if places == (matches.places_in_map + 1) // 2
                else "give the ground truth of these two traverses"
            )
        )
    evaluated = truth.judged(matches.place, matches.query)
    if not evaluated.any():
        raise GroundTruthError(
            "the truth is known for none of the matched queries: check that it covers their time"
        )
    score = score or matches.settings.score
    if score not in get_args(Score):
        raise UsageError(f"score {score!r} is unknown: choose from {', '.join(get_args(Score))}")
    correct = truth.correct[matches.place, matches.query] & evaluated
    has_place = truth.has_place[matches.query]
    values = np.asarray(getattr(matches, score), dtype=np.float64)
    curve = precision_recall(
        (-values if score in _RISING else values)[evaluated],
        correct[evaluated],
        has_place[evaluated],
        recall_denominator=recall_denominator,
    )
    findable = evaluated & has_place
    some = matches.candidates >= 0
    hit = truth.correct[matches.candidates, matches.query[:, None]] & some
    rated = evaluated & ~np.isnan(matches.probability)
    return Evaluation(
        queries=int(np.count_nonzero(evaluated)),
        queries_unknown=int(np.count_nonzero(~evaluated)),
        queries_without_place=int(np.count_nonzero(evaluated & ~has_place)),
        queries_tied=int(np.count_nonzero(matches.ties[evaluated])),
        chance=truth.chance,
        correct=correct,
        evaluated=evaluated,
        error=truth.errors(matches.place, matches.query),
        matches=matches,
        truth=truth,
        curve=curve,
        recall_at={
            n: int(np.count_nonzero(hit[findable, :n].any(axis=1))) / max(findable.sum(), 1)
            for n in RECALL_AT
            if n <= matches.candidates.shape[1]
        },
        score=score,
        recall_denominator=recall_denominator,
        rejection=evaluate_rejection(
            matches.trust[evaluated],
            correct[evaluated],
            has_place[evaluated],
            ~matches.lost[evaluated] if matches.settings.precision is not None else None,
        ),
        reliability=reliability(matches.probability[rated], correct[rated])
        if rated.any()
        else None,
    )
