"""Matching of a query drive with a map, window by window."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import NamedTuple

from edge_vpr.descriptors.descriptors import Descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.odometry import Odometry
from edge_vpr.pipeline import EventSource, Removed, WindowSource, describe_query, match_query
from edge_vpr.recordings.faults import Faults
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.output.json_records import LEFT_OUT
from edge_vpr_tools.runs.registration import MountShift


@dataclass(frozen=True, kw_only=True)
class MatchMetrics:
    """Sizes and times of a run, the first part of `metrics.json`.

    Attributes
    ----------
    queries, places, pixels, bytes_per_place, packed_bytes_per_place, events : int
    counting_s, matching_s : float
    tied_queries : int
    faults_dropped : Faults
    mount_shift : MountShift or None
        None where the query was not registered.
    """

    queries: int
    places: int
    pixels: int
    bytes_per_place: int
    packed_bytes_per_place: int
    events: int
    counting_s: float
    matching_s: float
    tied_queries: int
    faults_dropped: Faults
    mount_shift: MountShift | None = field(default=None, metadata=LEFT_OUT)


class MatchRun(NamedTuple):
    """Matches, their queries, and the events that cleaning removed."""

    matches: Matches
    queries: Descriptors
    removed: Removed
    counting_s: float
    matching_s: float

    def metrics(
        self, reference: ReferenceMap, faults: Faults, shift: MountShift | None = None
    ) -> MatchMetrics:
        """Return sizes and times, with the faults that were dropped and the camera's shift."""
        return MatchMetrics(
            queries=len(self.matches),
            places=len(reference),
            pixels=len(reference.pixel_map),
            bytes_per_place=reference.bytes_per_place,
            packed_bytes_per_place=reference.packed_bytes_per_place,
            events=int(self.queries.events.sum()),
            counting_s=self.counting_s,
            matching_s=self.matching_s,
            tied_queries=int((self.matches.ties > 0).sum()),
            faults_dropped=faults,
            mount_shift=shift,
        )


def match_recording(
    reference: ReferenceMap, recording: EventSource | WindowSource, odometry: Odometry | None = None
) -> MatchRun:
    """Describe a query drive and match it.

    Parameters
    ----------
    reference : ReferenceMap
        With the settings to use.
    recording : EventSource or WindowSource
    odometry : Odometry, optional
        Of the query drive.

    Raises
    ------
    EdgeVprError
        If it cannot be matched.
    """
    removed = Removed()
    start = time.perf_counter()
    queries = describe_query(reference, recording, removed=removed)
    # compiled before timing
    match_query(reference, queries.take(slice(reference.settings.windows_per_match)))
    described = time.perf_counter()
    matches = match_query(reference, queries, odometry)
    matched = time.perf_counter()
    return MatchRun(matches, queries, removed, described - start, matched - described)
