"""Position of the robot now: at the end of the newest window, and steady from match to match.

A match gives the place of the window that the filter has predicted: a place is at the middle of its
window, so that the robot is half a window further on when the window ends, and half a window behind
when it begins. `PathPosition` turns the places of matches into the place where the robot is, in
fractions of a place; `Locator` turns that into metres and coordinates.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import length_m
from edge_vpr.settings import Settings

#: Windows over which the speed along the path is measured: at most, and at least.
MOST_WINDOWS, LEAST_WINDOWS = 8, 4
#: Share of the difference to the newest match that is corrected within `STEADY_US`.
GAIN, STEADY_US = 0.25, 50_000
#: A match so many windows of the map away from the path is a jump.
JUMP_WINDOWS = 3


class PathPosition:
    """Place where the robot is at the end of the newest window.

    Parameters
    ----------
    settings : Settings
        Of the map.

    Attributes
    ----------
    jumps : int
        How often the position has jumped. While it stays the same, the position has moved without a
        jump.
    """

    def __init__(self, settings: Settings) -> None:
        self.jumps = 0
        places_per_window = settings.window_parts
        self._by_filter = settings.matching == "filter"
        self._tau_us = settings.tau_us if settings.window == "time" else 0
        self._map_advance, self._jump = places_per_window, JUMP_WINDOWS * places_per_window
        self._ends: deque[tuple[int, int]] = deque(maxlen=MOST_WINDOWS + 1)  # time, place
        self._at = math.nan
        self._time_us = 0

    def to_values(self) -> dict[str, Any]:
        """Return the values that `resume` needs, of JSON."""
        at = None if math.isnan(self._at) else self._at
        return {
            "jumps": self.jumps, "at": at, "time_us": self._time_us, "ends": list(self._ends)
        }  # fmt: skip

    def resume(self, values: dict[str, Any]) -> None:
        """Restore the values of `to_values`."""
        self.jumps, self._time_us = values["jumps"], values["time_us"]
        self._at = math.nan if values["at"] is None else values["at"]
        self._ends.extend((time_us, place) for time_us, place in values["ends"])

    def update(self, time_us: int, window_us: int, place: int) -> float:
        """Return the place where the robot is at the time of a match.

        Parameters
        ----------
        time_us : int
            End of the newest window; rising from match to match.
        window_us : int
            Length of this window.
        place : int
            That is matched.

        Returns
        -------
        float
            Number of the place, in fractions of a place; 0.5 is between the middles of the first
            two.
        """
        window_us = max(window_us, 1)
        advance = self._advance(time_us, window_us, place)
        seen = place + self._lead(time_us) * advance
        if abs(seen - self._at) <= self._jump:
            passed_us = time_us - self._time_us
            self._at += advance * passed_us / window_us
            self._at += (seen - self._at) * (1 - (1 - GAIN) ** (passed_us / STEADY_US))
        else:
            self.jumps += not math.isnan(self._at)
            self._at = seen
        self._time_us = time_us
        return self._at

    def _lead(self, time_us: int) -> float:
        """Return how far the robot is ahead of a match, in windows.

        Sequences match the windows that end now. The filter's windows follow one another from time
        zero; of windows by number, the time within one is not known, and the mean is taken.
        """
        if not self._by_filter:
            return 0.5
        if not self._tau_us:
            return 0.0
        return 0.5 - (-time_us % self._tau_us) / self._tau_us

    def _advance(self, time_us: int, window_us: int, place: int) -> float:
        """Return the advance in a window, in places: that of the path, or at first of the map."""
        ends = self._ends
        if not ends or time_us - ends[-1][0] >= window_us:
            if ends and abs(place - ends[-1][1]) > self._jump:
                ends.clear()
            ends.append((time_us, place))
        if len(ends) <= LEAST_WINDOWS:
            return self._map_advance
        (first_us, first), (last_us, last) = ends[0], ends[-1]
        return (last - first) * window_us / (last_us - first_us)


class Locator:
    """Positions along the route of a map, between its places too.

    Parameters
    ----------
    reference : ReferenceMap
        Without a track, only metres by its odometry are known; without odometry, nothing.

    Attributes
    ----------
    names : tuple of str
        Names of the coordinates: ``x_m``, ``y_m``, ... or ``latitude`` and ``longitude``; none
        without a track.
    route_m : float or None
        Length of the route, to the end of its last window.
    """

    def __init__(self, reference: ReferenceMap) -> None:
        route, along = reference.route, reference.along_m
        self.names: tuple[str, ...] = () if route is None else route.coordinates
        self.route_m: float | None = None
        self._within = reference.settings.exclusion_places
        self._along = self._filled = self._heading = None
        self._columns: dict[str, list[float]] = {}
        self._wraps = route is not None and route.kind == "geographic"
        # windows of the map reach half a window beyond the middles of its places
        self._beyond = reference.settings.window_parts / 2
        if along is None:
            return
        placed = np.flatnonzero(np.isfinite(along))
        self._along = along.tolist()
        self._filled = np.interp(np.arange(len(along)), placed, along[placed]).tolist()
        self._first, self._last = int(placed[0]), int(placed[-1])
        self.route_m = length_m(along, reference.settings.window_parts)
        if route is not None:
            columns = route.position.T.copy()
            if self._wraps:  # so that no step between two places goes round the earth
                columns[1, placed] = np.unwrap(columns[1, placed], period=360)
            self._columns = dict(zip(self.names, columns.tolist(), strict=True))
            self._heading = headings(along, columns, geographic=self._wraps)

    def locate(self, at: float) -> dict[str, float | None]:
        """Return the position at a number of a place, which may be a fraction.

        Parameters
        ----------
        at : float
            See `PathPosition.update`.

        Returns
        -------
        dict of str to (float or None)
            Fields of `Match` that this map can fill; None where it does not know them.
        """
        if self._along is None or self._filled is None:
            return {}
        last = len(self._along) - 1
        lowest, highest = -self._beyond, last + self._beyond
        at = min(max(at, lowest), highest)
        along_m = _between(self._along, at)
        position = {name: _between(column, at) for name, column in self._columns.items()}
        if self._wraps and (longitude := position["longitude"]) is not None:
            position["longitude"] = (longitude + 180) % 360 - 180
        position["heading_deg"] = position["along_from_m"] = position["along_to_m"] = None
        if self._heading is not None and along_m is not None:
            position["heading_deg"] = self._heading[min(max(round(at), 0), last)]
        position["along_m"], position["route_m"] = along_m, self.route_m
        from_at, to_at = max(at - self._within, lowest), min(at + self._within, highest)
        if from_at <= self._last + self._beyond and to_at >= self._first - self._beyond:
            position["along_from_m"] = _between(self._filled, from_at)
            position["along_to_m"] = _between(self._filled, to_at)
        return position


def _between(values: list[float], at: float) -> float | None:
    """Interpolate between the values of places, and extrapolate beyond the first and last.

    Returns
    -------
    float or None
        None if a value is not known (NaN).
    """
    if len(values) == 1:
        return None if math.isnan(values[0]) else values[0]
    before = min(max(math.floor(at), 0), len(values) - 2)
    share = at - before
    if share in (0, 1):
        value = values[before + int(share)]
    else:
        value = values[before] + share * (values[before + 1] - values[before])
    return None if math.isnan(value) else value


def headings(
    along_m: npt.NDArray[np.float64], columns: npt.NDArray[np.float64], *, geographic: bool
) -> list[float | None] | None:
    """Return the direction of a route at each of its places.

    Parameters
    ----------
    along_m : ndarray of float64, shape (K,)
        Rising; NaN where the position is not known.
    columns : ndarray of float64, shape (d, K)
        Latitude and longitude, which do not wrap, or metres east, north (and up).
    geographic : bool
        Whether they are latitude and longitude.

    Returns
    -------
    list of (float or None)
        Degrees clockwise from north (from y towards x in metres), 0 to 360, of the way from a metre
        before the place to a metre after it, or from the place before to the one after. None where
        it is not known; for a track without directions (d = 1) no list.
    """
    if len(columns) == 1:
        return None
    placed = np.isfinite(along_m)
    along, first = np.unique(along_m[placed], return_index=True)
    east, north = columns[:2]
    if geographic:
        latitude = columns[0]
        north, east = latitude, columns[1] * np.cos(np.radians(latitude))
    reach = max(1.0, float(np.median(np.diff(along)))) if along.size > 1 else 1.0
    ways = [
        np.interp(along_m + reach, along, axis[placed][first])
        - np.interp(along_m - reach, along, axis[placed][first])
        for axis in (east, north)
    ]
    degrees = np.degrees(np.arctan2(ways[0], ways[1])) % 360
    stands = ~placed | (np.hypot(*ways) == 0)
    return [None if no else each for no, each in zip(stands, degrees.tolist(), strict=True)]
