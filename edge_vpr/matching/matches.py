"""The matches of a query traverse: the best place for each query window, and the runner-up."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import read_archive, replacing, write_archive
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import MapError
from edge_vpr.matching.distances import ReferenceIndex, best_matches
from edge_vpr.matching.sequence import anchor_offset, check_length, sequence_sums
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
        Nearest places, nearest first (ties: lowest first); -1 where the map has fewer.
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

    def __len__(self) -> int:
        return len(self.query)

    def __repr__(self) -> str:
        return (
            f"Matches({len(self)} queries, {self.places_in_map} places, "
            f"L = {self.settings.sequence_length}, {np.count_nonzero(self.ties)} tied)"
        )

    @property
    def distance(self) -> npt.NDArray[np.float64]:
        """D_seq of the best place."""
        return self.distance_sum / self.settings.sequence_length

    @property
    def second_distance(self) -> npt.NDArray[np.float64]:
        """D_seq of the second best place; NaN where there is none."""
        return np.where(self.second < 0, np.nan, self.second_sum / self.settings.sequence_length)

    @property
    def ratio(self) -> npt.NDArray[np.float64]:
        """Best over second-best distance, 0 (sure) to 1 (in doubt).

        1 where both are zero, NaN where there is no second.
        """
        ratio = np.full(len(self), np.nan)
        np.divide(self.distance_sum, self.second_sum, out=ratio, where=self.second_sum > 0)
        ratio[self.second_sum == 0] = 1.0
        return ratio

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
        try:
            return cls(
                Settings.from_dict(meta["settings"], source=str(path)),
                meta["places_in_map"],
                **{name: arrays[name] for name in _COLUMNS},
            )
        except (KeyError, TypeError, ValueError) as error:
            raise MapError(f"{path} is damaged or lacks {error}: match again") from error

    def save_csv(self, path: str | Path) -> None:
        """Write as a table, one line a query, atomically; empty fields where there is no second."""
        with replacing(path) as temporary, temporary.open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(
                ["query", "time_s", "place", "distance", "second", "second_distance", "ratio"]
            )
            for i in range(len(self)):
                row = [int(self.query[i]), f"{self.time_us[i] / 1e6:.6f}", int(self.place[i])]
                row.append(f"{self.distance[i]:.6g}")
                if self.second[i] >= 0:
                    row += [int(self.second[i]), f"{self.second_distance[i]:.6g}"]
                    row.append(f"{self.ratio[i]:.6f}")
                else:
                    row += ["", "", ""]
                table.writerow(row)


_COLUMNS = (
    "query",
    "time_us",
    "place",
    "distance_sum",
    "second",
    "second_sum",
    "ties",
    "candidates",
)


def match_descriptors(places: Descriptors, queries: Descriptors, settings: Settings) -> Matches:
    """Match every query window by sequences of L windows (method.md sections 4 and 5).

    Parameters
    ----------
    places : Descriptors
        Reference, K of them.
    queries : Descriptors
        Q of them, counted at the same pixels.
    settings : Settings
        `sequence_length`, `anchor` and `exclusion` are used.

    Returns
    -------
    Matches
        Of Q - L + 1 windows: those that a whole sequence is centred on (or ends with).

    Raises
    ------
    MapError
        If the descriptors differ in length.
    UsageError
        If L is longer than a traverse.
    """
    if places.counts.shape[1] != queries.counts.shape[1]:
        raise MapError(
            f"reference descriptors have {places.counts.shape[1]} counts and the query's "
            f"{queries.counts.shape[1]}: describe both with the same map"
        )
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
