"""The matches of a query traverse, with best and second-best places, and their files."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import EqualByValue, archive_errors, read_archive, write_archive
from edge_vpr.confidence import net_trust
from edge_vpr.errors import expect, import_extra
from edge_vpr.files import replacing
from edge_vpr.route import ALONG
from edge_vpr.settings import Settings

if TYPE_CHECKING:
    import pandas


# The matches of a query traverse: best and second-best place of each query window.


KIND = "set of matches"


@dataclass(frozen=True, eq=False)
class Matches(EqualByValue):
    """Matches of n query windows.

    >>> from edge_vpr import ReferenceMap
    >>> from edge_vpr.simulation import simulate_pair
    >>> monday, tuesday = simulate_pair(0, "tiny", length_m=40)
    >>> matches = ReferenceMap.build(monday, pixels=50).match(tuesday).matches
    >>> matches.place[:3].tolist(), matches.time_s[:3].tolist()
    ([0, 1, 1], [0.5, 1.5, 2.5])

    With the place filter, the two distances are metrics of the filter, and L = 1.

    Attributes
    ----------
    places_in_map : int
        K.
    query : ndarray of int64, shape (n,)
        Index of the query window.
    time_us : ndarray of int64, shape (n,)
        Centre of the query window.
    place, second : ndarray of int64, shape (n,)
        Best place (the lowest in a tie), and the best one outside the exclusion zone (-1 if there
        is none).
    distance : ndarray of float64, shape (n,)
        D_seq of the best place (method.md section 5); with the place filter, its metric.
    second_distance : ndarray of float64, shape (n,)
        The same of the second-best place; NaN if there is none.
    ratio : ndarray of float64, shape (n,)
        Best divided by second-best distance, 0 to 1; lower means more confident. 1 if both are
        zero, NaN if there is no second.
    ties : ndarray of int64, shape (n,)
        Number of other places at the smallest distance.
    candidates : ndarray of int64, shape (n, 25)
        Nearest places, nearest first (ties: lowest first); -1 where the map has fewer. With the
        place filter they are those of the least metrics, and the match, the middle of the places
        near the least, may not be the first. For matches event by event only the match, shape (n,
        1).
    trust : ndarray of int64, shape (n,)
        Higher means more confident, see `Match`.
    misfit : ndarray of int64, shape (n,)
        0 where views resemble the map's, see `Match`; -1 for sequences.
    probability : ndarray of float64, shape (n,)
        Probability that the match is correct, see `confidence.Confidence`; NaN if unknown.
    lost : ndarray of bool, shape (n,)
        Whether the match is rejected at the required precision of the settings.
    """

    settings: Settings
    places_in_map: int
    query: npt.NDArray[np.int64]
    time_us: npt.NDArray[np.int64]
    place: npt.NDArray[np.int64]
    distance: npt.NDArray[np.float64]
    second: npt.NDArray[np.int64]
    second_distance: npt.NDArray[np.float64]
    ratio: npt.NDArray[np.float64]
    ties: npt.NDArray[np.int64]
    candidates: npt.NDArray[np.int64]
    trust: npt.NDArray[np.int64]
    misfit: npt.NDArray[np.int64]
    probability: npt.NDArray[np.float64]
    lost: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.query)

    def __repr__(self) -> str:
        by = "place filter"
        if self.settings.matching == "sequence":
            by = f"L = {self.settings.sequence_length}"
        return (
            f"Matches({len(self)} queries, {self.places_in_map} places, {by}, "
            f"{np.count_nonzero(self.ties)} tied)"
        )

    @property
    def time_s(self) -> npt.NDArray[np.float64]:
        """`time_us` in seconds."""
        return self.time_us / 1e6

    @property
    def net_trust(self) -> npt.NDArray[np.int64]:
        """Trust less misfit, see `confidence.net_trust`."""
        return net_trust(self.trust, self.misfit)

    @property
    def margin(self) -> npt.NDArray[np.float64]:
        """Second-best less best distance, NaN without a second; higher means more confident."""
        return self.second_distance - self.distance

    @classmethod
    def of_rows(
        cls,
        rows: npt.NDArray[np.void],
        settings: Settings,
        places_in_map: int,
        candidates: npt.NDArray[np.int64] | None = None,
    ) -> Matches:
        """Build from match records.

        Parameters
        ----------
        rows : ndarray of MATCH_DTYPE, shape (n,)
            Each is a query: the window that was newest at its time.
        candidates : ndarray of int64, shape (n, c), optional
            Nearest places; by default the best alone.
        """
        return cls(
            settings=settings,
            places_in_map=places_in_map,
            query=np.arange(len(rows), dtype=np.int64),
            time_us=rows["start_us"] + (rows["time_us"] - rows["start_us"]) // 2,
            candidates=rows["place"][:, None] if candidates is None else candidates,
            **{name: rows[name].copy() for name in _SHARED},
        )

    def take(self, rows: npt.NDArray[np.integer] | slice) -> Matches:
        """Return a selection of the matches, by a slice or by indices."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _COLUMNS})

    def every(self, stride: int) -> Matches:
        """Return every `stride`-th match, each as a query."""
        expect(stride, int, "stride", "a whole number from 1")
        taken = self.take(slice(None, None, stride))
        return replace(taken, query=np.arange(len(taken), dtype=np.int64))

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write to an ``.npz`` file, atomically.

        Parameters
        ----------
        path : path
            The file to write.
        overwrite : bool
            Replace an existing file.
        """
        arrays = {name: getattr(self, name) for name in _COLUMNS}
        meta = {"settings": self.settings.to_dict(), "places_in_map": self.places_in_map}
        write_archive(path, KIND, arrays, meta, overwrite=overwrite)

    @classmethod
    def load(cls, path: str | Path) -> Matches:
        """Read saved matches.

        Raises
        ------
        MapError
            If the file is missing, unreadable, damaged, not matches, or of another version.
        """
        arrays, meta = read_archive(path, KIND)
        with archive_errors(path, "match again"):
            return cls(
                Settings.from_dict(meta["settings"]),
                meta["places_in_map"],
                **{name: arrays[name] for name in _COLUMNS},
            )

    def to_frame(self) -> pandas.DataFrame:
        """Return a pandas table with one row for each match.

        Returns
        -------
        pandas.DataFrame
            The columns of ``matches.csv`` (see docs/outputs.md), ``margin`` and ``ties``; NaN
            where there is no second place or probability.

        Raises
        ------
        MissingExtraError
            If pandas is not installed.
        """
        library = import_extra("pandas", "a table of matches", "pandas", "pandas")
        columns = {name: getattr(self, name) for name in (*TABLE, "margin", "ties")}
        table: pandas.DataFrame = library.DataFrame(columns)
        return table


_COLUMNS = tuple(field.name for field in fields(Matches))[2:]  # all arrays
#: Columns of ``matches.csv``; `MATCH_DTYPE` and JSON rows use the same names, except that times in
#: arrays are `time_us`.
TABLE = (
    "query", "time_s", "place", "distance", "second", "second_distance", "ratio", "trust",
    "misfit", "probability", "lost",
)  # fmt: skip
#: Columns that are fields of a `Match`.
_SHARED = (
    "place", "distance", "second", "second_distance", "ratio", "ties", "trust", "misfit",
    "probability", "lost",
)  # fmt: skip


# The table of matches as CSV.


def write_csv(
    path: str | Path, matches: Matches, where: Mapping[str, npt.NDArray[np.float64]]
) -> None:
    """Write matches as CSV, one line per match, atomically.

    Parameters
    ----------
    matches : Matches
        A field is empty if there is no second place, if the misfit or probability is unknown, and
        in ``lost`` if no precision is required.
    where : mapping of str to ndarray
        Where the matched places are, see `ReferenceMap.where`; empty where that is not known.
    """
    rejects = matches.settings.precision is not None
    lost = matches.lost.astype(int).tolist() if rejects else [""] * len(matches)
    columns = [
        matches.query.tolist(), _texts(matches.time_s, "{:.6f}"), matches.place.tolist(),
        _texts(matches.distance, "{:.6g}"), _known(matches.second),
        _texts(matches.second_distance, "{:.6g}"), _texts(matches.ratio, "{:.6f}"),
        matches.trust.tolist(), _known(matches.misfit), _texts(matches.probability, "{:.4f}"),
        lost,
        *(_texts(each, "{:.2f}" if name in ALONG else "{:.7f}") for name, each in where.items()),
    ]  # fmt: skip
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow((*TABLE, *where))
        table.writerows(zip(*columns, strict=True))


def _texts(values: npt.NDArray[np.float64], form: str) -> list[str]:
    return ["" if math.isnan(value) else form.format(value) for value in values.tolist()]


def _known(values: npt.NDArray[np.int64]) -> list[object]:
    return ["" if value < 0 else value for value in values.tolist()]
