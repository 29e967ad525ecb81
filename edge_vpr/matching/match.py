"""One match: its fields from the kernels to Python, CSV, JSON and ROS, and arrays of them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Self, get_type_hints

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel


class Match(NamedTuple):
    """One match, or a heartbeat of a live session.

    Kernels write the fields up to `lost` (`MATCH_DTYPE`), live sessions the others. With the place
    filter, distances are its metrics and L is 1. What is not known is None, or NaN where the field
    is a number.

    The time, the position and the interval are of the same moment: the end of the newest window.

    A heartbeat says that no match came for the time that `heartbeat` names. Its `place` is -1, its
    `probability` 0, its `missing` 1, it has no time and no position, and it is `lost`: a program
    that checks any one of these slows down without a special case.
    """

    #: Time of the match, by the clock of the events; -1 in a heartbeat.
    time_us: int
    #: Best place, that whose middle looks most like the newest window; the first one in a tie. Of a
    #: map ``route.along_m[place]`` are its metres.
    place: int
    distance: float  #: Of the best place: mean over the L windows of the sequence.
    second: int  #: Best place outside the exclusion zone of `place`; -1 if there is none.
    second_distance: float  #: Its distance; NaN if there is none.
    ratio: float  #: `distance` / `second_distance`; NaN if there is no second place.
    ties: int  #: Other places with the same distance.
    events: int  #: Number in the newest window, at the selected pixels.
    start_us: int  #: Start of the newest window; -1 in a heartbeat.
    #: Confidence in the match; higher means more confident. Of the place filter 0 to 368: the
    #: support, a running mean of the margins up to this window, less the largest residual (evidence
    #: against the matched place) of this window and the two before, see `trust.support_after` and
    #: `trust.trust_of`. With sequences, the margin.
    trust: int
    #: How much worse than in a drive along the map in the same light, which is 0, about the last
    #: sixteen windows fit the matched places, see `trust.window_misfit`; in another place or light
    #: `confidence.OFF_MAP_MISFIT` or more. -1 with sequences.
    misfit: int
    #: That the match is correct; NaN if the map has no table of probabilities; 0 if the match is
    #: older than the session's `max_age`.
    probability: float
    #: Whether it is rejected: below the precision that the settings ask for, or too old.
    lost: bool
    #: Matches of the session before this one; one that is given again counts once.
    query: int = 0
    #: Share of the events of its windows that is known to be lost, 0 to 1; 1 also after a gap of
    #: unknown size.
    missing: float = math.nan
    #: How much time had passed since `time_us` when the match was given, by the clocks of camera
    #: and host, less the shortest time that events have taken to arrive; NaN of files and pipes,
    #: which wait for the host.
    age_s: float = math.nan
    #: `time_us` by this machine's clock, in microseconds since 1970; of files and pipes, when the
    #: last bytes for this match were read.
    host_us: int = 0
    #: How often the position has jumped until now. From one match to another with the same number,
    #: it has moved with the path.
    jumps: int = 0
    x_m: float | None = None  #: Position of the robot.
    y_m: float | None = None
    z_m: float | None = None
    latitude: float | None = None
    longitude: float | None = None
    #: Direction of the route there, in degrees clockwise from north (in metres: from y towards x).
    heading_deg: float | None = None
    #: Metres along the route, from the start of the drive that the map was made of.
    along_m: float | None = None
    #: Interval of the same: the probability is that of being in it.
    along_from_m: float | None = None
    along_to_m: float | None = None
    route_m: float | None = None  #: Length of the route.

    @property
    def time_s(self) -> float:
        """`time_us` in seconds; NaN in a heartbeat."""
        return self.time_us / 1e6 if self.time_us >= 0 else math.nan

    @property
    def start_s(self) -> float:
        """`start_us` in seconds; NaN in a heartbeat."""
        return self.start_us / 1e6 if self.time_us >= 0 else math.nan

    def at_age(self, age_s: float, oldest_s: float, **more: Any) -> Self:
        """Return the match as it is given at an age: beyond `oldest_s`, it says nothing of now."""
        if age_s > oldest_s:
            return self._replace(age_s=age_s, lost=True, probability=0.0, **more)
        return self._replace(age_s=age_s, **more)


def heartbeat(query: int, jumps: int, host_us: int) -> Match:
    """Return the heartbeat after a number of matches."""
    return Match(
        time_us=-1, place=-1, distance=math.nan, second=-1, second_distance=math.nan,
        ratio=math.nan, ties=0, events=0, start_us=-1, trust=0, misfit=-1, probability=0.0,
        lost=True, query=query, missing=1.0, host_us=host_us, jumps=jumps,
    )  # fmt: skip


#: Records of the fields that kernels write.
MATCH_DTYPE = np.dtype(
    [each for each in get_type_hints(Match).items() if each[0] not in Match._field_defaults]
)


@kernel(inline="always")
def write_distances(row, best_sum, second_sum, length):  # type: ignore[no-untyped-def]
    """Write the distances of a match and their ratio.

    Parameters
    ----------
    row : record of MATCH_DTYPE
        Output.
    best_sum, second_sum : int
        Sums over the L windows; the second is negative if there is no second place.
    length : int
        L.
    """
    row["distance"] = best_sum / length
    row["second_distance"] = np.nan if second_sum < 0 else second_sum / length
    row["ratio"] = np.nan if second_sum < 0 else 1.0
    if second_sum > 0:
        row["ratio"] = best_sum / second_sum


#: arrays of MATCH_DTYPE
MatchRows = list[npt.NDArray[np.void]]
NO_MATCHES = np.empty(0, dtype=MATCH_DTYPE)


def join_matches(parts: MatchRows) -> npt.NDArray[np.void]:
    """Concatenate arrays of matches; one alone is returned as it is."""
    if len(parts) == 1:
        return parts[0]
    return np.concatenate(parts) if parts else NO_MATCHES
