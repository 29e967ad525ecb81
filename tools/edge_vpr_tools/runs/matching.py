"""Matching of a drive with a map, recorded or event by event, and the folder of its results."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import read_archive, write_archive
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import UsageError
from edge_vpr.matching.matches import Matches, write_csv
from edge_vpr.online.localiser import Localiser, OdometryFeed
from edge_vpr.online.state import MatchSchedule
from edge_vpr.pipeline import (
    EventSource,
    Removed,
    WindowSource,
    cleaned,
    describe_query,
    match_query,
)
from edge_vpr.recordings.recording import Faults
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.registration import register
from edge_vpr.route import Odometry
from edge_vpr.settings import duration_us
from edge_vpr_tools import results
from edge_vpr_tools.console import summary, warning
from edge_vpr_tools.progress import removed_record
from edge_vpr_tools.results import LEFT_OUT, run_record, write_json

# Registration of a query's image with the map, before matching.


@dataclass(frozen=True, kw_only=True)
class MountShift:
    """Shift of a query's image, as in `metrics.json`.

    Attributes
    ----------
    dx, dy : int
        By which the map's pixels were moved, to the right and downwards.
    windows : int
        Of the query, that it was estimated from.
    likeness, likeness_unmoved : float
        Mean correlation of sequences with the most similar places, shifted and not.
    """

    dx: int
    dy: int
    windows: int
    likeness: float
    likeness_unmoved: float


def registered(
    reference: ReferenceMap, recording: EventSource | WindowSource, asked: bool
) -> tuple[ReferenceMap, MountShift | None]:
    """Move the pixels of a map by the shift of a query's image, if that is asked for, and say so.

    Parameters
    ----------
    reference : ReferenceMap
    recording : EventSource or WindowSource
        Is read from its start, and again by the matching.
    asked : bool

    Returns
    -------
    reference : ReferenceMap
        Moved, where a shift is clear.
    shift : MountShift or None
        None where none was asked for.

    Raises
    ------
    MapError, UsageError
        As `edge_vpr.pipeline.register` does.
    """
    if not asked:
        return reference, None
    found = register(reference, recording)
    if found.shifted:
        pixels = len(reference.pixel_map)
        warning(
            f"the camera's image is shifted by ({found.dx}, {found.dy}) pixels: the map's pixels "
            f"are moved, {pixels - len(found.reference.pixel_map)} of {pixels} are lost: fix the "
            "mounting, or make a new map"
        )
    else:
        summary(f"no shift of the camera is clear from {found.windows} windows")
    return found.reference, MountShift(
        dx=found.dx, dy=found.dy, windows=found.windows, likeness=found.likeness,
        likeness_unmoved=found.unmoved,
    )  # fmt: skip


# Matching of a query drive with a map, window by window.


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


# The flag ``--every``: when a localiser gives a match.


def every_of(given: str | None, default: str, reference: ReferenceMap) -> str:
    """Return the given ``--every``; without one, the default, or ``window`` if matches are late."""
    return given or ("window" if reference.settings.late else default)


def parse_every(text: str, reference: ReferenceMap) -> MatchSchedule:
    """Return the schedule of matches with a map, see `read_every`.

    Raises
    ------
    UsageError
        If it is none, or matches come late and are wanted at other times than the ends of windows.
    """
    schedule = read_every(text)
    if schedule is not None and reference.settings.late:
        raise UsageError(
            f"--every {text} with a delay of {reference.settings.late} windows, which gives a "
            "match at the end of each window: leave --every out, or set --delay 0"
        )
    return schedule or MatchSchedule.window(reference.settings)


def read_every(text: str) -> MatchSchedule | None:
    """Read ``event``, a number of events, a time such as ``10ms``, ``window``, or ``change``.

    Returns
    -------
    MatchSchedule or None
        None for ``window``, whose length a map or a design knows.

    Raises
    ------
    UsageError
        If it is none of these.
    """
    if text == "window":
        return None
    if text in ("event", "change"):
        return MatchSchedule(events=1, change=text == "change")
    if text.isascii() and text.isdigit() and int(text) > 0:
        return MatchSchedule(events=int(text))
    try:
        return MatchSchedule(interval_us=duration_us(text))
    except UsageError:
        raise UsageError(
            f"--every {text!r}: expected event, a number of events, a time such as 10ms, window, "
            "or change"
        ) from None


# Matching of a query drive event by event, as on a device.


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


# The folder of a match, which `edge-vpr evaluate` and `calibrate` read.


def write_match_folder(
    folder: Path,
    reference: ReferenceMap,
    matches: Matches,
    removed: Removed,
    metrics: MatchMetrics | OnlineMetrics,
    inputs: Sequence[str | Path],
    queries: Descriptors | None = None,
) -> None:
    """Write map, matches, run and metrics.

    Parameters
    ----------
    folder : path
    reference : ReferenceMap
        As saved; the settings of the run are those of `matches`.
    matches : Matches
    removed : Removed
        By cleaning.
    metrics : MatchMetrics or OnlineMetrics
    inputs : sequence of path
        Files that were read.
    queries : Descriptors, optional
        Of the windows; there are none of matches event by event.
    """
    reference.save(folder / results.MAP)
    matches.save(folder / results.MATCHES)
    write_csv(folder / results.MATCHES_CSV, matches, reference.route)
    if queries is not None:
        write_archive(folder / results.QUERIES, results.QUERIES_KIND, queries.to_arrays(), {})
    left_out = removed_record(removed, int(reference.hot.sum()))
    write_json(folder / results.RUN, run_record(matches.settings.to_dict(), inputs, left_out))
    write_json(folder / results.METRICS, metrics)


def read_queries(folder: Path) -> Descriptors | None:
    """Read the windows of a match; None of a match event by event."""
    if not (folder / results.QUERIES).is_file():
        return None
    arrays, _ = read_archive(folder / results.QUERIES, results.QUERIES_KIND)
    return Descriptors.from_arrays(arrays)
