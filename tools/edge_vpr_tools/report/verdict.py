"""Summary of the matches of a drive: how many are correct, and which are wrong."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import Acceptance
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import Evaluation
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap

#: precision of the verdict where the run asked for none
USUAL_PRECISION = 0.99
#: times of wrong matches that a verdict names
MOST_NAMED = 5
#: wrong matches that are no further apart than this share of the drive are named together
_TOGETHER = 0.02

Bools = npt.NDArray[np.bool_]


class Outcome:
    """Whether each of n matches is accepted and, after an evaluation, correct.

    Parameters
    ----------
    precision : float or None
        At which matches are accepted; None where no probability is known.
    accepted : ndarray of bool, shape (n,)
        Whether each match is accepted.
    evaluation : Evaluation, optional
        None before an evaluation.

    Attributes
    ----------
    truth : GroundTruth or None
    correct, wrong : ndarray of bool, shape (n,)
        False where it is not known.
    errors : ndarray of float64, shape (n,), or None
        In `truth.error_unit`.
    kind : str
        What the matches are, such as ``live matches``; sequences are neither live nor smoothed.
    title : str
        What a figure shows: what the matches are, and at which precision they are accepted.
    sentence : str
        The verdict.
    """

    def __init__(
        self,
        matches: Matches,
        precision: float | None,
        accepted: Bools,
        evaluation: Evaluation | None = None,
    ) -> None:
        self.matches, self.precision, self.accepted = matches, precision, accepted
        self.evaluation, self.time_s = evaluation, matches.time_us / 1e6
        self.truth: GroundTruth | None = None
        self.errors: npt.NDArray[np.float64] | None = None
        self.correct = self.wrong = np.zeros(len(matches), np.bool_)
        if evaluation is not None:
            self.truth, self.errors, self.correct = (
                evaluation.truth, evaluation.error, evaluation.correct
            )  # fmt: skip
            self.wrong = evaluation.evaluated & ~evaluation.correct
        settings = matches.settings
        self.kind = "matches"
        if settings.matching == "filter":
            self.kind = f"{'smoothed' if settings.smooth else 'live'} matches"
        self.title = self.kind.capitalize()
        if precision is not None:
            as_if = "as " * (settings.precision is None)
            self.title += f", accepted {as_if}at precision {precision:g}"
        self.sentence = f"{'; '.join(filter(None, self._parts()))}."

    def wrong_runs(self) -> list[npt.NDArray[np.intp]]:
        """Return the indices of wrong matches that lie close together in time."""
        wrong = np.flatnonzero(self.wrong)
        if not wrong.size:
            return []
        time = self.time_s
        steps = np.diff(time)
        apart = max(1.5 * float(np.median(steps)), _TOGETHER * float(time[-1] - time[0]))
        return np.split(wrong, 1 + np.flatnonzero(np.diff(time[wrong]) > apart))

    def _parts(self) -> list[str]:
        n = len(self.matches)
        if self.evaluation is None:
            return [f"{n:,} {self.kind}", self._accepted_before_evaluation()]
        n, correct = self.evaluation.queries, int(np.count_nonzero(self.correct))
        parts = [f"{correct:,} of {n:,} {self.kind} {'is' if n == 1 else 'are'} correct"]
        if correct < n:
            parts.append(self._where_wrong())
        unknown = self.evaluation.queries_unknown
        if unknown:
            parts.append(f"{unknown:,} more cannot be judged, without a known position")
        off = self.evaluation.queries_without_place
        if off:
            parts.append(f"{off:,} {'has' if off == 1 else 'have'} no correct place on the map")
        return [*parts, self._accepted()]

    def _where_wrong(self) -> str:
        runs, time = self.wrong_runs(), self.time_s
        if int(np.count_nonzero(self.wrong)) == self.evaluation.queries:  # type: ignore[union-attr]
            return ""
        named = sorted(sorted(runs, key=len, reverse=True)[:MOST_NAMED], key=lambda run: run[0])
        texts = [_span(float(time[run[0]]), float(time[run[-1]])) for run in named]
        others = len(runs) - len(named)
        if others:
            texts.append(f"{others} other time{'s' * (others > 1)}")
        *first, last = (text if "other" in text else f"{text} s" for text in texts)
        listed = f"{', '.join(first)} and {last}" if first else last
        single = int(np.count_nonzero(self.wrong)) == 1
        return f"the wrong one lies at {listed}" if single else f"the wrong ones lie at {listed}"

    def _accepted_before_evaluation(self) -> str:
        if self.precision is None:
            return ""
        share = percent(int(np.count_nonzero(self.accepted)), len(self.matches))
        if self.matches.settings.precision is None:
            return f"{share} of them would be accepted at precision {self.precision:g}"
        near = self.matches.settings.exclusion
        return (
            f"{share} of them are accepted at precision {self.precision:g}, which is promised "
            f"within {near} windows of the true place"
        )

    def _accepted(self) -> str:
        if self.precision is None or self.evaluation is None:
            return ""
        taken = self.accepted & self.evaluation.evaluated
        accepted, correct = (
            int(np.count_nonzero(taken)),
            int(np.count_nonzero(taken & self.correct)),
        )
        has_precision = self.matches.settings.precision is not None
        text = f"{percent(accepted, self.evaluation.queries)} "
        text += f"{'are' if has_precision else 'would be'} accepted at precision {self.precision:g}"
        if not accepted:
            return text.replace("0 %", "none", 1)
        if correct == accepted:
            return text if not self.wrong.any() else f"{text}, all correct"
        text += f", {percent(correct, accepted)} of them correct"
        if correct < self.precision * accepted:
            near = self.matches.settings.exclusion
            text += f" ({self.precision:g} is promised within {near} windows of the true place)"
        return text


def outcome_of(
    reference: ReferenceMap, matches: Matches, evaluation: Evaluation | None = None
) -> Outcome:
    """Find which matches are accepted, at the precision of the run or else the usual one."""
    settings = matches.settings
    everything = np.ones(len(matches), dtype=np.bool_)
    if settings.precision is not None:
        return Outcome(matches, settings.precision, ~matches.lost, evaluation)
    confidence = reference.matched_with(settings).acceptance.confidence
    try:
        if confidence is None:
            return Outcome(matches, None, everything, evaluation)
        _, lost = Acceptance(confidence, USUAL_PRECISION).accept(matches.trust, matches.misfit)
    except UsageError:  # a map's own table, which was calibrated with too few matches
        return Outcome(matches, None, everything, evaluation)
    return Outcome(matches, USUAL_PRECISION, ~lost, evaluation)


def percent(part: int, whole: int) -> str:
    """Return a share in per cent, never rounded to all or nothing.

    Examples
    --------
    >>> percent(61, 100), percent(723, 724), percent(1, 1000), percent(5, 5)
    ('61 %', '99.9 %', '0.1 %', '100 %')
    """
    share = 100 * part / max(whole, 1)
    for digits in range(4):
        text = f"{share:.{digits}f}"
        if part in (0, whole) or float(text) not in (0.0, 100.0):
            return f"{text} %"
    return f"{share:g} %"


def _span(first_s: float, last_s: float) -> str:
    """Return a time, or a range of times to the second."""
    first, last = math.floor(first_s), math.ceil(last_s)
    return f"{first_s:g}" if first_s == last_s else f"{first} to {last}"
