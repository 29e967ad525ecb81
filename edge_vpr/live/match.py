"""One match of a live session, as a program gets it."""

from __future__ import annotations

import math
import time
from typing import NamedTuple


class LiveMatch(NamedTuple):
    """One match of a live session, or a heartbeat.

    `time_s`, the position and the interval are of the same moment: the end of the newest window.
    What is not known is None, or NaN where the field is a number.

    A heartbeat says that no match came for the time that `heartbeat` names. Its `place` is -1, its
    `probability` 0, its `missing` 1, it has no position, and it is `lost`: a program that checks
    any one of these slows down without a special case.

    Attributes
    ----------
    time_s : float
        Time of the match by the camera's clock, in seconds; NaN in a heartbeat.
    query : int
        Matches of this session before this one; one that is given again counts once.
    place : int
        Best place of the map: that whose middle looks most like the newest window.
    distance : float
        With sequences, distance to it per window; with the place filter, its cost.
    second : int
        Best place outside the exclusion zone of `place`; -1: there is none.
    second_distance : float
        Distance to that; NaN if there is none.
    ratio : float
        `distance` / `second_distance`; NaN if it is not known.
    events : int
        In the newest window, at the selected pixels.
    start_s : float
        When this window began, by the camera's clock.
    trust : int
        Higher means more confident.
    misfit : int
        0 where views resemble the map's, `confidence.OFF_MAP_MISFIT` or more in another place or
        light; -1 for sequences.
    probability : float
        Probability that the match is correct; NaN if the map has no table of probabilities; 0 if
        the match is older than the session's `max_age`.
    lost : bool
        Whether the match is rejected: below the precision that the settings ask for, or too old.
    missing : float
        Share of the events of its windows that is known to be lost, 0 to 1; 1 also after a gap of
        unknown size.
    age_s : float
        How much time has passed since `time_s` when the match was given, by the clocks of camera
        and host, less the shortest time that events have taken to arrive; NaN of files and pipes,
        which wait for the host.
    host_us : int
        `time_s` by this machine's clock, in microseconds since 1970; of files and pipes, when the
        last bytes for this match were read.
    jumps : int
        How often the position has jumped until now. From one match to another with the same number,
        it has moved with the path.
    x_m, y_m, z_m, latitude, longitude : float or None
        Position of the robot.
    heading_deg : float or None
        Direction of the route there, in degrees clockwise from north (in metres: from y towards x).
    along_m : float or None
        Metres along the route, from the start of the drive that the map was made of.
    along_from_m, along_to_m : float or None
        Interval of the same: the probability is that of being in it.
    route_m : float or None
        Length of the route.
    """

    time_s: float
    query: int
    place: int
    distance: float
    second: int
    second_distance: float
    ratio: float
    events: int
    start_s: float
    trust: int
    misfit: int
    probability: float
    lost: bool
    missing: float
    age_s: float
    host_us: int
    jumps: int
    x_m: float | None = None
    y_m: float | None = None
    z_m: float | None = None
    latitude: float | None = None
    longitude: float | None = None
    heading_deg: float | None = None
    along_m: float | None = None
    along_from_m: float | None = None
    along_to_m: float | None = None
    route_m: float | None = None

    @property
    def incomplete(self) -> bool:
        """Whether events are missing."""
        return self.missing > 0


def at_age(match: LiveMatch, age_s: float, oldest_s: float) -> LiveMatch:
    """Return a match as it is given at an age: beyond `oldest_s`, it says nothing of now."""
    if age_s > oldest_s:
        return match._replace(age_s=age_s, lost=True, probability=0.0)
    return match._replace(age_s=age_s)


def heartbeat(given: int, jumps: int) -> LiveMatch:
    """Return the heartbeat after a number of matches, see `LiveMatch`."""
    return LiveMatch(
        time_s=math.nan, query=given, place=-1, distance=math.nan, second=-1,
        second_distance=math.nan, ratio=math.nan, events=0, start_s=math.nan, trust=0, misfit=-1,
        probability=0.0, lost=True, missing=1.0, age_s=math.nan, host_us=int(1e6 * time.time()),
        jumps=jumps,
    )  # fmt: skip
