"""How soon a place is recognised after it was entered: event by event against window by window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edge_vpr.evaluation.tracks import Track
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.pipeline import EventSource, cleaned
from edge_vpr.reference_map import ReferenceMap


@dataclass(frozen=True, eq=False)
class Latency:
    """Times from entering a place to its first right match.

    Attributes
    ----------
    seconds : ndarray of float64, shape (m,)
        For the places that were recognised before the drive was `reach_m` past their end.
    places : int
        Number of places entered while matches were given.
    matches : int
    """

    seconds: npt.NDArray[np.float64]
    places: int
    matches: int

    @property
    def median_s(self) -> float:
        """Median over the recognised places in seconds; NaN if there are none."""
        return float(np.median(self.seconds)) if self.seconds.size else float("nan")


def measure_latency(
    reference: ReferenceMap,
    query: EventSource,
    reference_track: Track,
    query_track: Track,
    every: MatchSchedule,
    reach_m: float,
) -> Latency:
    """Run the query online, and measure the time to each place's first right match.

    A place is entered when the query reaches the position at which the reference's window began. It
    is recognised by the first later match with this place, or with a later place whose window began
    within `reach_m` of the query's position, while the query is not yet `reach_m` past the window's
    end.

    Parameters
    ----------
    reference : ReferenceMap
    query : EventSource
    reference_track, query_track : Track
        Metric, one coordinate: the distance along the route, which does not decrease.
    every : MatchSchedule
        Schedule of matches.
    reach_m : float
        Reach in metres.
    """
    localiser = Localiser(reference, every=every)
    given = [localiser.update(events) for events in cleaned(query, reference.settings)]
    matches = np.concatenate(given)
    begin_m = reference_track.at(reference.places.start_us)[:, 0]
    end_m = reference_track.at(reference.places.end_us)[:, 0]
    at_m = query_track.at(matches["t"])[:, 0]
    way = query_track.position[:, 0]
    entered_us = np.interp(begin_m, way, query_track.time_us, left=np.nan, right=np.nan)

    named = matches["place"]
    near = np.abs(begin_m[named] - at_m) <= reach_m
    seconds, places = [], 0
    for k in range(reference.settings.windows_per_match - 1, len(reference)):
        if not (np.isfinite(entered_us[k]) and matches["t"][0] <= entered_us[k]):
            continue
        places += 1
        first, last = np.searchsorted(matches["t"], [entered_us[k], np.inf])
        last = first + np.searchsorted(at_m[first:last], end_m[k] + reach_m)
        right = (named[first:last] == k) | ((named[first:last] > k) & near[first:last])
        if right.any():
            seconds.append((matches["t"][first + np.argmax(right)] - entered_us[k]) / 1e6)
    return Latency(np.array(seconds), places, len(matches))
