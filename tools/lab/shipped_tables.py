"""The shipped tables of probabilities, evaluated on drives whose truth is known."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import DEFAULT_TABLES, LIVE, SMOOTHED, Confidence, default_confidence
from edge_vpr.evaluation.calibration import reliability
from edge_vpr.evaluation.metrics import evaluate_rejection
from edge_vpr.matching.matches import Matches
from lab.first_matches import first_matches
from lab.loop import Row
from lab.pairs import MappedPair
from lab.spliced import WHOLE, Spliced
from lab.tables import TableView

#: settings of the matches that each table is for
MATCHINGS: Mapping[str, Mapping[str, Any]] = {
    LIVE: {"smooth": False},
    SMOOTHED: {"smooth": True},
}


class Sample(NamedTuple):
    """Matches of known truth: net trust (n,) int64, correct (n,) and has_place (n,) bool.

    `changes` (n,) bool is of windows in which the drive changes; see `Spliced`.
    """

    trust: npt.NDArray[np.int64]
    correct: npt.NDArray[np.bool_]
    has_place: npt.NDArray[np.bool_]
    changes: npt.NDArray[np.bool_]


def sample(pair: MappedPair, first: int = 0, last: int | None = None) -> Sample:
    """Match a pair, and return the matches whose truth is known, of windows `first` to `last`."""
    matches = pair.match()
    judged = pair.truth.judged(matches.place, matches.query) & (matches.query >= first)
    if last is not None:
        judged &= matches.query < last
    correct = pair.truth.correct[matches.place, matches.query]
    has_place = pair.truth.has_place[matches.query]
    changes = np.zeros(judged.size, dtype=np.bool_)
    if isinstance(pair, Spliced):
        changes = pair.changes[matches.query]
    return Sample(matches.net_trust[judged], correct[judged], has_place[judged], changes[judged])


def joined(samples: Sequence[Sample]) -> Sample:
    """Concatenate samples."""
    return Sample(*(np.concatenate(column) for column in zip(*samples, strict=True)))


def learnt_seeds() -> tuple[int, int]:
    """Return the seeds of the first and of the last street that the shipped tables are from."""
    text = files("edge_vpr").joinpath(DEFAULT_TABLES).read_text(encoding="utf-8")
    first, last = json.loads(text)["street_seeds"]
    return int(first), int(last)


#: rows of all pooled versions, and of those with each kind of windows
POOLED = "all six"
POOLED_BY = {
    "time": "all six, windows of a fixed time", "count": "all six, windows of a fixed number",
}  # fmt: skip
PRECISION = 0.99
#: column of the share of accepted matches that are correct, without those of windows in which the
#: drive leaves the map, comes back or jumps
PRECISION_SEEN = "precision from one window after a change on"
LEARNT_ON = "table learnt on"
SWITCHED_ON = "switched on in mid-route"
#: ends the names of columns of the tables for robots that stay on the map
STAYS_ON_MAP = " (stays on map)"
#: columns that the table has no effect on
_OF_MATCHES = (
    "windows", "correct", "correct of those on the map", "found at 99 % precision",
    "AUROC off the map", "starts", "starts with a match correct",
    "median time to the first correct (s)",
)  # fmt: skip
#: columns that name a row of the tables of this experiment and of `trust`
NAMES = ("map", "matching", LEARNT_ON)
#: how these tables are printed
VIEW = TableView(
    {},
    (
        "map", "matching", "correct of those on the map", "accepted at 0.99", "precision",
        "calibration error", "accepted at 0.99" + STAYS_ON_MAP, "precision" + STAYS_ON_MAP,
    ),
)  # fmt: skip


def evaluate_tables(
    versions: Mapping[str, Sequence[MappedPair]],
    matchings: Sequence[str],
    switched_on: Sequence[str],
    pooled: Sequence[str] = (),
) -> Iterator[Row]:
    """Evaluate the shipped tables on drives whose truth is known.

    Parameters
    ----------
    versions : mapping of str to sequence of MappedPair
        Drives by version; those of one version are evaluated together.
    matchings : sequence of str
        Of `MATCHINGS`.
    switched_on : sequence of str
        Those by which whole drives are also matched from the middle of the route on.
    pooled : sequence of str
        Versions that are evaluated together too, in further rows: all, and by kind of windows.
    """
    learnt_on = "streets of seeds {} to {}".format(*learnt_seeds())
    for name in matchings:
        table, on_map = (default_confidence(name == SMOOTHED, stays) for stays in (False, True))
        together: dict[str, list[Sample]] = {POOLED: []}
        for version, pairs in versions.items():
            changed = [pair.with_settings(MATCHINGS[name]) for pair in pairs]
            row = {"map": version, "matching": name, LEARNT_ON: learnt_on}
            samples = [sample(pair) for pair in changed]
            if version in pooled:
                together[POOLED] += samples
                for pair, one in zip(pairs, samples, strict=True):
                    together.setdefault(POOLED_BY[pair.reference.settings.window], []).append(one)
            stays = _if_on_map(figures_of_table(on_map, samples)) if name == LIVE else {}
            yield {**row, **figures_of_table(table, samples), **stays}
            if version == WHOLE and name in switched_on:
                row["map"] = SWITCHED_ON
                first = partial(first_matches, changed)
                stays = _if_on_map(first(partial(_accepted, on_map))) if name == LIVE else {}
                yield {**row, **first(partial(_accepted, table)), **stays}
        for kind, samples in together.items() if pooled else ():
            row = {"map": kind, "matching": name, LEARNT_ON: learnt_on}
            yield {**row, **figures_of_table(table, samples)}


def _accepted(table: Confidence, matches: Matches) -> npt.NDArray[np.bool_]:
    return np.asarray(matches.net_trust >= table.least_trust(PRECISION))


def _if_on_map(measured: Row) -> Row:
    """Return what the table has an effect on, in columns for robots that stay on the map."""
    return {
        name + STAYS_ON_MAP: value for name, value in measured.items() if name not in _OF_MATCHES
    }


def figures_of_table(table: Confidence, samples: Sequence[Sample]) -> dict[str, float | int | None]:
    """Return what a table says of some drives, each in the order of time, and what is true."""
    pooled = joined(samples)
    probability = table.probability_of(pooled.trust)
    least = table.least_trust(PRECISION)
    accepted = pooled.trust >= least
    counts = evaluate_rejection(pooled.trust, pooled.correct, pooled.has_place, accepted)
    seen: dict[str, float | None] = {}
    if pooled.changes.any():
        late = accepted & ~pooled.changes
        seen[PRECISION_SEEN] = float(pooled.correct[late].mean()) if late.any() else None
    left = windows_past_the_edge(samples, least)
    off_map = accepted[~pooled.has_place]
    return {
        "windows": pooled.trust.size,
        "correct": float(pooled.correct.mean()),
        "correct of those on the map": counts.right_on_map,
        "mean probability": float(probability.mean()),
        "calibration error": reliability(probability, pooled.correct).expected_calibration_error,
        "accepted at 0.99": float(accepted.mean()),
        "precision": counts.precision,
        **seen,
        "recall": counts.recall,
        "found at 99 % precision": counts.found_at_99_precision,
        "AUROC off the map": counts.off_map_auroc,
        "accepted off the map": float(off_map.mean()) if off_map.size else None,
        "windows accepted after leaving the map": float(np.mean(left)) if left else None,
        "most windows accepted after leaving": max(left, default=None),
    }


def windows_past_the_edge(samples: Sequence[Sample], least: int) -> list[int]:
    """Return how long matches are still accepted after a drive has left the map.

    Returns
    -------
    list of int
        Number of accepted matches in a row, each time that a drive leaves the map from an accepted
        match.
    """
    lasted = []
    for trust, _, has_place, _ in samples:
        accepted = trust >= least
        for j in np.flatnonzero(has_place[:-1] & ~has_place[1:] & accepted[:-1]) + 1:
            last = accepted[j:] & ~has_place[j:]
            lasted.append(int(np.argmin(last)) if not last.all() else last.size)
    return lasted
