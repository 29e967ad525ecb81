"""Matching by sequences event by event."""

from __future__ import annotations

from edge_vpr.online.followed import Followed
from edge_vpr.online.followed_windows import FollowedWindows
from edge_vpr.online.match_run import MatchRun
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap


class SequenceRun(MatchRun):
    """Feeds events to the sequence of the newest L windows.

    Parameters
    ----------
    reference : ReferenceMap
    windows : FollowedWindows
        Of this map.
    schedule : MatchSchedule
        When to give a match.
    recent : int
        So many of the newest places are not searched.
    """

    def __init__(
        self,
        reference: ReferenceMap,
        windows: FollowedWindows,
        schedule: MatchSchedule,
        recent: int,
    ) -> None:
        super().__init__(windows, Followed.begin(reference, windows.s, schedule))
        self._recent = recent

    def _rebound(self) -> None:
        self._control.places = self.windows.s.totals["sums"][0] - self._recent
