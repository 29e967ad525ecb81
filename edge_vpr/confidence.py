"""The probability that a match is correct, as a monotone table over its trust and misfit.

Tables are stored with maps. `evaluation.calibration` learns them from evaluated drives.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import EqualByValue, archive_errors, check_array, check_range
from edge_vpr.compiling import kernel
from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.settings import Settings

#: Tables learnt on simulated streets by `python -m lab calibration --table`, see docs/method.md:
#: for live matches, and for smoothed drives.
DEFAULT_TABLES = "default_confidence.json"
LIVE, SMOOTHED = "live", "smoothed"
#: Keys of that file: tables for robots that may leave the map, and one for live matches of robots
#: that never do.
TABLES, LIVE_ON_MAP = "tables", "live_on_map"
MOST_STEPS = 4_096
#: Largest trust of the place filter (9 bits); a unit of misfit counts as 4 units of trust.
TRUST_TOP, MISFIT_SHIFT = 368, 2
#: misfit of matches by sequences, for which it is unknown
NO_MISFIT = -1
#: A misfit of this or more indicates a place or a light that is not in the map. On the streets of
#: the calibration, 0.1 % of the correct matches reach it, and about half of the matches of drives
#: through other streets.
OFF_MAP_MISFIT = 64
OFF_MAP_TEXT = "this place or light is not the map's"


def net_trust(trust: npt.NDArray[np.int64], misfit: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the trust of matches less their misfit, which determines their probability.

    Parameters
    ----------
    trust, misfit : ndarray of int64, shape (n,)
        Trust and misfit of each match; the misfit is `NO_MISFIT` if unknown.

    Examples
    --------
    >>> net_trust(np.array([300, 2_000, 2_000]), np.array([10, 100, NO_MISFIT])).tolist()
    [260, -32, 2000]
    """
    limited = np.minimum(trust, TRUST_TOP) - (misfit << MISFIT_SHIFT)
    return np.where(misfit < 0, trust, limited)


@kernel(inner=True)
def accept_match(row, trust, probability, least_trust):  # type: ignore[no-untyped-def]
    """Write the probability of one match, and whether it is lost, as `Acceptance.accept` does.

    Parameters
    ----------
    row : record of MATCH_DTYPE
        Trust and misfit are read; `probability` and `lost` are written.
    trust, probability : ndarray of int64 and float64, shape (m,)
        See `Confidence`; m is 0 if the probability is unknown.
    least_trust : int
        Least `net_trust` of a match that is not lost.
    """
    net = row["trust"]
    if row["misfit"] >= 0:  # as `net_trust`
        net = min(net, TRUST_TOP) - (row["misfit"] << MISFIT_SHIFT)
    row["probability"], row["lost"] = np.nan, net < least_trust
    first, last = 0, trust.size - 1  # binary search of the step
    if last >= 0:
        while first < last:
            middle = (first + last + 1) // 2
            if trust[middle] <= net:
                first = middle
            else:
                last = middle - 1
        row["probability"] = probability[first]


@dataclass(frozen=True, eq=False)
class Confidence(EqualByValue):
    """Step function from the net trust of a match to the probability that it is correct."""

    #: Shape (m,): least `net_trust` of each step, increasing; the first step includes lower trust.
    trust: npt.NDArray[np.int64]
    #: Shape (m,): probability of each step, above 0 and below 1, never decreasing.
    probability: npt.NDArray[np.float64]
    #: Shape (m,): number of matches from which each step was learnt, at least 1.
    matches: npt.NDArray[np.int64]

    def __post_init__(self) -> None:
        check_array(self.trust, "confidence_trust", (np.int64,), (None,))
        steps = len(self.trust)
        if not 1 <= steps <= MOST_STEPS:
            raise MapError(f"confidence_trust has {steps} steps: expected 1 to {MOST_STEPS}")
        check_array(self.probability, "confidence_probability", (np.float64,), (steps,))
        check_array(self.matches, "confidence_matches", (np.int64,), (steps,))
        check_range(self.trust, "confidence_trust", -TIME_LIMIT_US, TIME_LIMIT_US)
        # the sum fits into 64 bits
        check_range(self.matches, "confidence_matches", 1, TIME_LIMIT_US // MOST_STEPS)
        p = self.probability
        if not ((p > 0) & (p < 1)).all() or (np.diff(p) < 0).any():
            raise MapError("confidence_probability is not rising from above 0 to below 1")
        if (np.diff(self.trust) <= 0).any():
            raise MapError("confidence_trust does not increase")

    def __repr__(self) -> str:
        low, high = self.probability[0], self.probability[-1]
        return f"Confidence({len(self.trust)} steps, {low:.2f} to {high:.2f})"

    @property
    def precision(self) -> npt.NDArray[np.float64]:
        """Share of correct matches at each step and above, shape (m,)."""
        n_correct = np.cumsum((self.probability * self.matches)[::-1])[::-1]
        return np.asarray(n_correct / np.cumsum(self.matches[::-1])[::-1])

    def probability_of(self, trust: npt.NDArray[np.integer]) -> npt.NDArray[np.float64]:
        """Return the probability that each match is correct.

        Parameters
        ----------
        trust : ndarray of int, shape (n,)
            `net_trust` of each match.

        Returns
        -------
        ndarray of float64, shape (n,)

        Examples
        --------
        >>> steps = np.array([0, 100]), np.array([0.25, 0.75]), np.array([8, 8])
        >>> Confidence(*steps).probability_of(np.array([-1, 99, 100])).tolist()
        [0.25, 0.25, 0.75]
        """
        step = np.searchsorted(self.trust, trust, side="right") - 1
        return np.asarray(self.probability[np.maximum(step, 0)])

    def least_trust(self, precision: float) -> int:
        """Return the least net trust at and above which matches reach a precision.

        Parameters
        ----------
        precision : float
            Share of correct matches among the accepted ones, above 0 and below 1.

        Raises
        ------
        UsageError
            If the table was learnt from too few matches, or too many wrong ones, to reach it.
        """
        enough = np.flatnonzero(self.precision >= precision)
        if enough.size == 0:
            raise UsageError(
                f"precision {precision} was not reached where trust was calibrated, "
                f"{np.floor(1e4 * self.precision[-1]) / 1e4} was: ask for that or less, or "
                "calibrate with more matches (edge-vpr calibrate)"
            )
        return int(self.trust[enough[0]]) if enough[0] else -TIME_LIMIT_US

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return named arrays for an archive; the inverse of `from_arrays`."""
        return {f"confidence_{name}": getattr(self, name) for name in _NAMES}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, npt.NDArray[Any]]) -> Confidence | None:
        """Build from the arrays of `to_arrays`; None if all are missing."""
        columns = {name: arrays.get(f"confidence_{name}") for name in _NAMES}
        if all(array is None for array in columns.values()):
            return None
        return cls(**columns)  # type: ignore[arg-type]  # a missing array fails its check


@dataclass(frozen=True, eq=False)
class Acceptance:
    """Assign probabilities to matches, and mark those below the required precision as lost."""

    #: None if the probability is unknown, as for sequences without a calibration.
    confidence: Confidence | None
    #: Required share of correct matches among the accepted ones; None accepts all.
    precision: float | None = None

    def __post_init__(self) -> None:
        if self.precision is not None and self.confidence is None:
            raise UsageError(
                f"precision {self.precision}: matches by sequences have no probabilities here: "
                "calibrate the map (edge-vpr calibrate), or match by the filter"
            )
        if self.precision is not None and self.confidence is not None:
            self.confidence.least_trust(self.precision)

    @classmethod
    def of(cls, settings: Settings, own: Confidence | None = None) -> Acceptance:
        """Return the acceptance of matches with these settings.

        Parameters
        ----------
        own : Confidence, optional
            Table of the map; by default a shipped table for the place filter, none for sequences.
        """
        if own is None and settings.matching == "filter":
            own = default_confidence(settings.smooth, settings.stays_on_map)
        return cls(own, settings.precision)

    def accept(
        self, trust: npt.NDArray[np.int64], misfit: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """Return the probability of each match (NaN if unknown), and whether it is lost.

        Parameters
        ----------
        trust, misfit : ndarray of int64, shape (n,)
            See `net_trust`.

        Returns
        -------
        probability : ndarray of float64, shape (n,)
        lost : ndarray of bool, shape (n,)
            All False if no precision is required.
        """
        if self.confidence is None:
            return np.full(trust.shape, np.nan), np.zeros(trust.shape, dtype=np.bool_)
        net = net_trust(trust, misfit)
        probability = self.confidence.probability_of(net)
        if self.precision is None:
            return probability, np.zeros(trust.shape, dtype=np.bool_)
        return probability, net < self.confidence.least_trust(self.precision)


_NAMES = ("trust", "probability", "matches")


@cache
def default_confidence(smoothed: bool = False, stays_on_map: bool = False) -> Confidence:
    """Return a shipped table of the place filter, learnt on simulated streets.

    Parameters
    ----------
    smoothed : bool
        For drives that were smoothed as a whole.
    stays_on_map : bool
        For robots that never leave the map. Smoothed matches have one table for all robots, because
        a table learnt on the map alone would be overconfident on other drives.

    Raises
    ------
    MapError
        If the package's file is damaged.
    """
    with archive_errors(DEFAULT_TABLES, "install edge-vpr again"):
        text = files("edge_vpr").joinpath(DEFAULT_TABLES).read_text(encoding="utf-8")
        shipped = json.loads(text)
        table = shipped[TABLES][SMOOTHED if smoothed else LIVE]
        if stays_on_map and not smoothed:
            table = shipped[LIVE_ON_MAP]
        return Confidence(
            np.array(table["trust"], dtype=np.int64),
            np.array(table["probability"], dtype=np.float64),
            np.array(table["matches"], dtype=np.int64),
        )
