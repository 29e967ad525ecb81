"""The route of the reference drive: the positions of the places of a map along it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import EqualByValue, check_array
from edge_vpr.errors import MapError

#: what positions are: metres, or latitude and longitude
Kind = Literal["metric", "geographic"]
#: names of the coordinates, by their kind and number
_COORDINATES = {
    ("geographic", 2): ("latitude", "longitude"),
    ("metric", 1): ("x_m",),
    ("metric", 2): ("x_m", "y_m"),
    ("metric", 3): ("x_m", "y_m", "z_m"),
}
_FARTHEST_M = 1e12
#: mean radius of the Earth in metres (IUGG, R1)
EARTH_RADIUS_M = 6_371_008.8
#: columns of a table of matches after the coordinates
ALONG = ("along_m", "along_from_m", "along_to_m")


def length_m(along_m: npt.NDArray[np.float64], window_parts: int) -> float:
    """Return the length of a route, to the end of its last window.

    Parameters
    ----------
    along_m : ndarray of float64, shape (K,)
        Metres to the middle of each place, rising; NaN where not known, but not at all of them.
    window_parts : int
        Places that start in a window.
    """
    placed = np.flatnonzero(np.isfinite(along_m))
    last = np.interp([len(along_m) - 2, len(along_m) - 1], placed, along_m[placed])
    return float(last[0] + (1 + window_parts / 2) * (last[1] - last[0]))


def along_columns(
    along_m: npt.NDArray[np.float64], place: npt.NDArray[np.integer], within: int
) -> dict[str, npt.NDArray[np.float64]]:
    """Return the metres to matched places, and to the ends of the interval around each.

    Parameters
    ----------
    along_m : ndarray of float64, shape (K,)
        Metres to the middle of each place, rising; NaN where not known.
    place : ndarray of int, shape (n,)
        Index of the matched place, for each match.
    within : int
        The interval reaches from this many places before the matched one to as many after it. With
        the exclusion zone's, the probability of a match is that of the true position lying in the
        interval: the trust compares the place with those outside it.

    Returns
    -------
    dict of str to ndarray, each of shape (n,)
        Columns `ALONG` of a table of matches, in order; NaN where nothing is known.
    """
    before = np.fmin.accumulate(along_m[::-1])[::-1]  # at or after each place
    after = np.fmax.accumulate(along_m)
    first = np.maximum(place - within, 0)
    last = np.minimum(place + within, len(along_m) - 1)
    placed_before = np.concatenate([[0], np.cumsum(np.isfinite(along_m))])
    nothing = placed_before[last + 1] == placed_before[first]
    ends = (np.where(nothing, np.nan, end) for end in (before[first], after[last]))
    return dict(zip(ALONG, (along_m[place], *ends), strict=True))


@dataclass(frozen=True, eq=False)
class Route(EqualByValue):
    """Positions of the K places of a map."""

    #: Shape (K, d): latitude and longitude in degrees (`kind` "geographic", d = 2), or metres (d =
    #: 1, 2 or 3); rows of NaN where the position is not known.
    position: npt.NDArray[np.float64]
    #: Shape (K,): metres that the reference had driven to the middle of the place, since the drive
    #: or its track began; NaN where the position is not known.
    along_m: npt.NDArray[np.float64]
    kind: Kind = "metric"  #: {"metric", "geographic"}: what the positions are.

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise MapError(f"position_kind is {self.kind!r}: expected metric or geographic")
        check_array(self.position, "position", (np.float64,), (None, None))
        places, width = self.position.shape
        if (self.kind, width) not in _COORDINATES:
            raise MapError(f"position has {width} columns, which no {self.kind} position has")
        check_array(self.along_m, "along_m", (np.float64,), (places,))
        placed = np.isfinite(self.along_m)
        same = (np.isfinite(self.position) == placed[:, None]).all()
        if not placed.any() or not same or np.isinf(self.position).any():
            raise MapError("position and along_m are not known at the same places, at one or more")
        at = self.along_m[placed]
        if at[0] < 0 or at[-1] > _FARTHEST_M or (np.diff(at) < 0).any():
            raise MapError("along_m runs backwards, or is not a length: expected rising metres")

    def __repr__(self) -> str:
        placed = int(np.isfinite(self.along_m).sum())
        return f"Route({placed} of {len(self.along_m)} places known, {self.kind})"

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the columns of `position`, with the unit if it is metres."""
        return _COORDINATES[self.kind, self.position.shape[1]]

    @property
    def origin(self) -> npt.NDArray[np.float64]:
        """First known position, shape (d,)."""
        first: npt.NDArray[np.float64] = self.position[np.isfinite(self.along_m)][0]
        return first

    def metres(self, position: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return positions of the route's kind in metres, shape (n, d).

        Latitude and longitude become metres east and north of `origin`; lengths are exact along its
        parallel and its meridian, and wrong by less than 1 % within 50 km up to 50 degrees of
        latitude. Metric positions are returned as they are.

        Parameters
        ----------
        position : ndarray of float64, shape (n, d)

        Examples
        --------
        >>> route = Route(np.zeros((1, 2)), np.zeros(1), "geographic")
        >>> route.metres(np.array([[0.0, 0.001]])).round(1).tolist()
        [[111.2, 0.0]]
        """
        if self.kind == "metric":
            return position
        origin = self.origin
        north, east = np.radians(position - origin).T
        east = (east + np.pi) % (2 * np.pi) - np.pi  # the short way round across the 180th meridian
        return EARTH_RADIUS_M * np.column_stack([east * np.cos(np.radians(origin[0])), north])

    def columns(
        self, place: npt.NDArray[np.integer], within: int
    ) -> dict[str, npt.NDArray[np.float64]]:
        """Return positions and `along_columns` of matched places, by name, in order.

        Parameters
        ----------
        place : ndarray of int, shape (n,)
            Index of the matched place, for each match.
        within : int
            See `along_columns`.
        """
        position = dict(zip(self.coordinates, self.position[place].T, strict=True))
        return position | along_columns(self.along_m, place, within)

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays by name, for an archive; the inverse of `from_arrays`."""
        return {"position": self.position, "along_m": self.along_m}

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, npt.NDArray[Any]], meta: Mapping[str, Any]
    ) -> Route | None:
        """Build from named arrays and the kind in the header; None without arrays."""
        if "position" not in arrays and "along_m" not in arrays:
            return None
        position, along_m = (arrays.get(name) for name in ("position", "along_m"))
        return cls(position, along_m, meta.get("position_kind"))  # type: ignore[arg-type]
