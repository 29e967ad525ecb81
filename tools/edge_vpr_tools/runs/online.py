"""Matching of a query drive event by event, as on a device."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.matching.matches import Matches
from edge_vpr.odometry import Odometry
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.odometry_feed import OdometryFeed
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.pipeline import EventSource, Removed, cleaned
from edge_vpr.recordings.faults import Faults
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.output.json_records import LEFT_OUT
from edge_vpr_tools.runs.registration import MountShift


@dataclass(frozen=True, kw_only=True)
class OnlineMetrics:
    """Sizes and times of a run, the first part of `metrics.json`.

    Attributes
    ----------
    matches, events : int
    every : str
        When a match was given, as the user wrote it.
    localising_s, times_real_time : float
    faults_dropped : Faults
    mount_shift : MountShift or None
        None where the query was not registered.
    """

    matches: int
    events: int
    every: str
    localising_s: float
    times_real_time: float
    faults_dropped: Faults
    mount_shift: MountShift | None = field(default=None, metadata=LEFT_OUT)


class OnlineRun(NamedTuple):
    """Matches in time order, and the numbers of the events.

    Attributes
    ----------
    matches : Matches
    removed : Removed
    events : int
    duration_s, busy_s : float
        Of the drive, and of the localiser.
    """

    matches: Matches
    removed: Removed
    events: int
    duration_s: float
    busy_s: float

    def metrics(self, every: str, faults: Faults, shift: MountShift | None = None) -> OnlineMetrics:
        """Return sizes and times, with the faults that were dropped and the camera's shift."""
        return OnlineMetrics(
            matches=len(self.matches),
            events=self.events,
            every=every,
            localising_s=self.busy_s,
            times_real_time=self.duration_s / self.busy_s,
            faults_dropped=faults,
            mount_shift=shift,
        )


def made_causal(reference: ReferenceMap) -> ReferenceMap:
    """Return a map whose settings need no later windows."""
    settings = replace(reference.settings, query_mean="running", smooth=False)
    return reference.matched_with(settings)


def localise(
    reference: ReferenceMap,
    recording: EventSource,
    every: MatchSchedule,
    odometry: Odometry | None = None,
) -> OnlineRun:
    """Feed a recording to a localiser.

    Parameters
    ----------
    reference : ReferenceMap
        With the settings to use, see `made_causal`.
    recording : EventSource
    every : MatchSchedule
    odometry : Odometry, optional
        Of the query drive.

    Raises
    ------
    EdgeVprError
        If there is no match, or the recording cannot be read.
    """
    settings = reference.settings
    localiser = Localiser(reference, every=every)
    found: list[npt.NDArray[np.void]] = []
    events_fed, busy_s = 0, 0.0
    removed, fed = Removed(), OdometryFeed(localiser, odometry)
    for events in cleaned(recording, settings, removed):
        if not found:  # compiled before the clock runs
            Localiser(reference, every=every).update(events[:1])
        start = time.perf_counter()
        found += fed.update(events)
        busy_s += time.perf_counter() - start
        events_fed += events.size
    rows = np.concatenate([*found, localiser.finish()])
    if rows.size == 0:
        raise UsageError(
            f"the recording ended before a sequence of {settings.windows_per_match} windows was "
            "complete: take shorter windows or a longer drive"
        )
    matches = Matches.of_rows(rows, settings, len(reference))
    return OnlineRun(matches, removed, events_fed, float(rows["t"][-1] / 1e6), busy_s)
