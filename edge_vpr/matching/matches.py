"""The matches of a query traverse: the best place for each query window, and the runner-up."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import damaged, read_archive, write_archive
from edge_vpr.array_checks import check_array, check_range, whole_number
from edge_vpr.confidence import Confidence, Judge, default_confidence
from edge_vpr.descriptors.pauses import mean_activity
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import MapError
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.matching.distances import ReferenceIndex, best_matches
from edge_vpr.matching.matches_csv import write_csv
from edge_vpr.matching.place_filter import FilterMatch, PlaceFilter, StepPrices
from edge_vpr.matching.sequence import anchor_offset, check_length, sequence_sums
from edge_vpr.route import Route
from edge_vpr.settings import Settings

KIND = "set of matches"
#: so many of the nearest places are kept for Recall@N
CANDIDATES = 25
#: distances held at once while matching, so that memory does not grow with the traverse
_BLOCK_DISTANCES = 4_000_000


@dataclass(frozen=True, eq=False)
class Matches:
    """One row for each matched query window, n in all.

    Attributes
    ----------
    settings : Settings
    places_in_map : int
        K.
    query : ndarray of int64, shape (n,)
        Index of the query window.
    time_us : ndarray of int64, shape (n,)
        Centre of the query window.
    place, second : ndarray of int64, shape (n,)
        Best place (ties: the lowest), and the best one outside the exclusion zone (-1: there is
        none).
    distance_sum, second_sum : ndarray of int64, shape (n,)
        Sum of the L distances along the sequence, L times D_seq (method.md section 5); -1 for no
        second.
    ties : ndarray of int64, shape (n,)
        Other places at the same smallest distance.
    candidates : ndarray of int64, shape (n, 25)
        Nearest places, nearest first (ties: lowest first); -1 where the map has fewer. Of matches
        that were given event by event only the best one, shape (n, 1).
    trust : ndarray of int64, shape (n,)
        Higher is surer: of the place filter, see `place_filter.FilterMatch`; of sequences, the
        margin.
    probability : ndarray of float64, shape (n,)
        That the match is right, see `confidence.Confidence`; NaN where it is not known.
    lost : ndarray of bool, shape (n,)
        Not to be relied on at the precision that the settings want.

    Of matches by the place filter the two distances are metrics of the filter, with L = 1.
    """

    settings: Settings
    places_in_map: int
    query: npt.NDArray[np.int64]
    time_us: npt.NDArray[np.int64]
    place: npt.NDArray[np.int64]
    distance_sum: npt.NDArray[np.int64]
    second: npt.NDArray[np.int64]
    second_sum: npt.NDArray[np.int64]
    ties: npt.NDArray[np.int64]
    candidates: npt.NDArray[np.int64]
    trust: npt.NDArray[np.int64]
    probability: npt.NDArray[np.float64]
    lost: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.query)

    def __repr__(self) -> str:
        by = f"L = {self.settings.sequence_length}"
        if self.settings.matching == "filter":
            by = "by the place filter"
        return (
            f"Matches({len(self)} queries, {self.places_in_map} places, {by}, "
            f"{np.count_nonzero(self.ties)} tied)"
        )

    @property
    def distance(self) -> npt.NDArray[np.float64]:
        """D_seq of the best place."""
        return self.distance_sum / self.settings.windows_per_match

    @property
    def second_distance(self) -> npt.NDArray[np.float64]:
        """D_seq of the second best place; NaN where there is none."""
        return np.where(self.second < 0, np.nan, self.second_sum / self.settings.windows_per_match)

    @property
    def margin(self) -> npt.NDArray[np.float64]:
        """Second-best distance less the best, higher is surer; NaN where there is no second."""
        return self.second_distance - self.distance

    @property
    def ratio(self) -> npt.NDArray[np.float64]:
        """Best over second-best distance, 0 (sure) to 1 (in doubt).

        1 where both are zero, NaN where there is no second.
        """
        ratio = np.full(len(self), np.nan)
        np.divide(self.distance_sum, self.second_sum, out=ratio, where=self.second_sum > 0)
        ratio[self.second_sum == 0] = 1.0
        return ratio

    @classmethod
    def of_rows(cls, rows: npt.NDArray[np.void], settings: Settings, places_in_map: int) -> Matches:
        """Build from the matches that a localiser gave event by event.

        Parameters
        ----------
        rows : ndarray of MATCH_DTYPE, shape (n,)
            Each is a query, of the window that was newest at its time. Ties are not counted.
        settings : Settings
        places_in_map : int
        """
        n = len(rows)
        return cls(
            settings=settings,
            places_in_map=places_in_map,
            query=np.arange(n, dtype=np.int64),
            time_us=rows["start"] + (rows["t"] - rows["start"]) // 2,
            place=rows["place"],
            distance_sum=rows["distance_sum"],
            second=rows["second"],
            second_sum=rows["second_sum"],
            ties=np.zeros(n, dtype=np.int64),
            candidates=rows["place"][:, None],
            trust=rows["trust"],
            probability=rows["probability"],
            lost=rows["lost"],
        )

    def every(self, stride: int) -> Matches:
        """Return every `stride`-th match, as queries of their own."""
        columns = {name: getattr(self, name)[::stride] for name in _COLUMNS}
        columns["query"] = np.arange(len(columns["query"]), dtype=np.int64)
        return replace(self, **columns)

    def save(self, path: str | Path) -> None:
        """Write as ``.npz``, atomically."""
        arrays = {name: getattr(self, name) for name in _COLUMNS}
        # for those who open the file with NumPy alone
        arrays |= {name: getattr(self, name) for name in ("distance", "second_distance", "ratio")}
        meta = {"settings": self.settings.to_dict(), "places_in_map": self.places_in_map}
        write_archive(path, KIND, arrays, meta)

    @classmethod
    def load(cls, path: str | Path) -> Matches:
        """Read saved matches.

        Raises
        ------
        MapError
            If the file is missing, unreadable, not matches, or from a newer version.
        """
        arrays, meta = read_archive(path, KIND)
        with damaged(path, "match again"):
            found = cls(
                Settings.from_dict(meta["settings"]),
                whole_number(meta, "places_in_map", 1, TIME_LIMIT_US),
                **{name: arrays[name] for name in _COLUMNS if name not in _LATER},
                trust=arrays.get("trust", arrays["second_sum"] - arrays["distance_sum"]),
                probability=arrays.get("probability", np.full(arrays["query"].shape, np.nan)),
                lost=arrays.get("lost", np.zeros(arrays["query"].shape, dtype=np.bool_)),
            )
            check_matches(found)
        return found

    def save_csv(self, path: str | Path, route: Route | None = None) -> None:
        """Write as a table, see `matches_csv.write_csv`."""
        write_csv(path, self, route)


_COLUMNS = (
    "query",
    "time_us",
    "place",
    "distance_sum",
    "second",
    "second_sum",
    "ties",
    "candidates",
    "trust",
    "probability",
    "lost",
)
#: columns that the first files did not have
_LATER = ("trust", "probability", "lost")


def check_matches(matches: Matches) -> None:
    """Raise unless every column is of its dtype and length, and every place is one of the map.

    Parameters
    ----------
    matches : Matches
        For example of a file.

    Raises
    ------
    MapError
        If they are not what `match_descriptors` gives.
    """
    n, last = len(matches.query), matches.places_in_map - 1
    limits = {
        "query": (0, TIME_LIMIT_US), "time_us": (-TIME_LIMIT_US, TIME_LIMIT_US), "place": (0, last),
        "distance_sum": (0, TIME_LIMIT_US), "second": (-1, last), "second_sum": (-1, TIME_LIMIT_US),
        "ties": (0, last), "candidates": (-1, last), "trust": (-TIME_LIMIT_US, TIME_LIMIT_US),
    }  # fmt: skip
    for name, (least, most) in limits.items():
        column = getattr(matches, name)
        width = 1 if matches.candidates.shape[1:] == (1,) else CANDIDATES
        check_array(column, name, (np.int64,), (n, width) if name == "candidates" else (n,))
        check_range(column, name, least, most)
    check_array(matches.probability, "probability", (np.float64,), (n,))
    if ((matches.probability < 0) | (matches.probability > 1)).any():
        raise MapError("probability of a match is not between 0 and 1")
    check_array(matches.lost, "lost", (np.bool_,), (n,))
    if n == 0 or (np.diff(matches.query) <= 0).any():
        raise MapError(f"query of {n} matches: expected one match or more, in order")
    if ((matches.second < 0) != (matches.second_sum < 0)).any():
        raise MapError("second and second_sum differ on where there is a second best place")


def match_descriptors(
    places: Descriptors,
    queries: Descriptors,
    settings: Settings,
    confidence: Confidence | None = None,
) -> Matches:
    """Match every query window, by sequences of L windows or by the place filter.

    Parameters
    ----------
    places : Descriptors
        Reference, K of them.
    queries : Descriptors
        Q of them, counted at the same pixels.
    settings : Settings
        `matching` and its settings, `exclusion` and `precision` are used.
    confidence : Confidence, optional
        Table of probabilities; by default the shipped one for the place filter, and none for
        sequences.

    Returns
    -------
    Matches
        Of all Q windows by the filter. By sequences, of Q - L + 1: those that a whole sequence is
        centred on (or ends with).

    Raises
    ------
    MapError
        If the descriptors differ in length.
    UsageError
        If L is longer than a traverse, or the table does not promise the wanted precision.
    """
    if confidence is None and settings.matching == "filter":
        confidence = default_confidence()
    judge = Judge(confidence, settings.precision)
    if places.counts.shape[1] != queries.counts.shape[1]:
        raise MapError(
            f"reference descriptors have {places.counts.shape[1]} counts and the query's "
            f"{queries.counts.shape[1]}: describe both with the same map"
        )
    if settings.matching == "filter":
        return _match_by_filter(places, queries, settings, judge)
    length, exclusion = settings.sequence_length, settings.exclusion
    check_length(length, len(places), len(queries))
    offset = anchor_offset(length, settings.anchor)
    index = ReferenceIndex(places.counts)
    n = len(queries) - length + 1
    block = max(1, _BLOCK_DISTANCES // len(places))
    parts = [
        _match_block(index, queries.counts[j : min(j + block, n) + length - 1], length, exclusion)
        for j in range(0, n, block)
    ]
    best, best_sum, second, second_sum, ties, candidates = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    query = np.arange(n, dtype=np.int64) + offset
    trust = np.where(second < 0, 0, second_sum - best_sum)
    probability, lost = judge.judge(trust)
    return Matches(
        settings=settings,
        places_in_map=len(places),
        query=query,
        time_us=queries.centre_us[query],
        place=best + offset,
        distance_sum=best_sum,
        second=np.where(second < 0, -1, second + offset),
        second_sum=second_sum,
        ties=ties,
        candidates=np.where(candidates < 0, -1, candidates + offset),
        trust=trust,
        probability=probability,
        lost=lost,
    )


def _match_by_filter(
    places: Descriptors, queries: Descriptors, settings: Settings, judge: Judge
) -> Matches:
    index, n = ReferenceIndex(places.counts), len(queries)
    place_filter = PlaceFilter(
        len(places),
        StepPrices.of(settings),
        settings.exclusion,
        mean_activity(places.activity),
    )
    columns = np.empty((n, len(FilterMatch._fields)), dtype=np.int64)
    events = queries.activity.tolist()
    block = max(1, _BLOCK_DISTANCES // len(places))
    nearest = []
    for first in range(0, n, block):
        distances = np.ascontiguousarray(index.matrix(queries.counts[first : first + block]).T)
        metrics = np.empty(distances.shape, dtype=np.int32)
        for i, row in enumerate(distances):
            columns[first + i] = place_filter.advance(row, events[first + i])
            metrics[i] = place_filter.metric
        nearest.append(_nearest(metrics.T))
    candidates = np.concatenate(nearest)
    place, metric, second, second_metric, ties, trust = columns.T
    probability, lost = judge.judge(trust)
    return Matches(
        settings=settings,
        places_in_map=len(places),
        query=np.arange(n, dtype=np.int64),
        time_us=queries.centre_us,
        place=place,
        distance_sum=metric,
        second=second,
        second_sum=second_metric,
        ties=ties,
        candidates=candidates,
        trust=trust,
        probability=probability,
        lost=lost,
    )


def _match_block(
    index: ReferenceIndex, counts: npt.NDArray[np.unsignedinteger], length: int, exclusion: int
) -> tuple[npt.NDArray[np.int64], ...]:
    sums = sequence_sums(index.matrix(counts), length)
    best, second, ties = best_matches(sums, exclusion)
    column = np.arange(sums.shape[1])
    best_sum = sums[best, column].astype(np.int64)
    second_sum = np.where(second < 0, -1, sums[second, column]).astype(np.int64)
    return best, best_sum, second, second_sum, ties, _nearest(sums)


def _nearest(sums: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """Nearest places of each column, shape (columns, CANDIDATES)."""
    places = sums.shape[0]
    # distance and place in one integer: its order is by distance, then by the lower place
    keys = sums.astype(np.int64) * places + np.arange(places)[:, None]
    if places > CANDIDATES:
        keys = np.partition(keys, CANDIDATES - 1, axis=0)[:CANDIDATES]
    nearest = np.full((sums.shape[1], CANDIDATES), -1, dtype=np.int64)
    nearest[:, : len(keys)] = np.sort(keys, axis=0).T % places
    return nearest
