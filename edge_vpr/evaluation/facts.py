"""Facts of drives and their tracks, which a person judges at a glance."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.ground_truth import GroundTruth, nearest
from edge_vpr.evaluation.tracks import Track, distances
from edge_vpr.events import UNIX_US, Sensor
from edge_vpr.reference_map import ReferenceMap

_UNIX_ZERO = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)


class Drive(NamedTuple):
    """A recording of a drive, or a part of one, and its track."""

    events: int
    #: start_us, end_us: of the part, from the recording's start.
    start_us: int
    end_us: int
    sensor: Sensor | str  #: Or why its size is not known.
    clock_us: int = 0  #: Start of the recording on its own clock.
    track: Track | None = None
    silent_us: tuple[int, int] = (0, 0)  #: Longest time of whole windows without an event.

    @classmethod
    def of_windows(
        cls,
        windows: Descriptors,
        sensor: Sensor,
        start_us: int = 0,
        clock_us: int = 0,
        track: Track | None = None,
    ) -> Drive:
        """Return the drive whose windows, counted from `start_us`, do not overlap."""
        end_us = start_us + int(windows.end_us[-1])
        silent = np.concatenate([[False], windows.events == 0, [False]])
        edges = np.flatnonzero(silent[1:] != silent[:-1])
        begins, ends = windows.start_us[edges[::2]], windows.end_us[edges[1::2] - 1]
        longest = int(np.argmax(ends - begins)) if begins.size else None
        return cls(
            int(windows.events.sum()), start_us, end_us, sensor, clock_us, track,
            (0, 0) if longest is None
            else (start_us + int(begins[longest]), start_us + int(ends[longest])),
        )  # fmt: skip

    @classmethod
    def of_map(cls, reference: ReferenceMap, track: Track | None = None) -> Drive:
        """Return the drive that a map was made of."""
        return cls.of_windows(
            reference.windows, reference.pixel_map.sensor, reference.start_us, reference.clock_us,
            track,
        )  # fmt: skip


def facts(drives: Mapping[str, Drive], truth: GroundTruth | None = None) -> dict[str, str]:
    """Return a line of text for each drive and each track, and for the distance of two routes.

    Parameters
    ----------
    drives : mapping of str to Drive
        By their headings, such as ``reference``.
    truth : GroundTruth, optional
        Of two drives; gives the distance of their routes.
    """
    lines = {heading: _of_recording(drive) for heading, drive in drives.items()}
    for heading, drive in drives.items():
        if drive.track is not None:
            lines[f"{heading} track"] = _of_track(drive.track, drive.start_us, drive.end_us)
    if truth is not None and truth.positions is not None:
        away, unit = nearest(truth.positions), truth.error_unit
        lines["routes"] = (
            f"{_short(np.median(away))} {unit} apart in the median, {_short(away.max())} {unit} at "
            "most (from a window of the query to the nearest place)"
        )
    return lines


def _of_recording(drive: Drive) -> str:
    seconds = (drive.end_us - drive.start_us) / 1e6
    rate = f", {drive.events / seconds:,.0f} events/s" if seconds else ""
    begins, silent = "", ""
    if drive.silent_us[1]:
        first_s, last_s = (time_us / 1e6 for time_us in drive.silent_us)
        silent = f", none from {first_s:,.1f} to {last_s:,.1f} s"
    if drive.clock_us >= UNIX_US:
        begins = _begins(_UNIX_ZERO + dt.timedelta(microseconds=drive.clock_us))
    return (
        f"{drive.events:,} events in {seconds:,.1f} s{rate}{silent}, of {drive.sensor} pixels"
        f"{begins}"
    )


def _of_track(track: Track, start_us: int, end_us: int) -> str:
    time_s = track.time_us / 1e6
    step_m = distances(track.kind, track.position[1:], track.position[:-1])
    passed_s = np.diff(time_s)
    length_m = step_m.sum()
    inside = np.clip(track.time_us, start_us, end_us)
    covered = float(np.diff(inside)[track.bridged].sum()) / max(end_us - start_us, 1)
    moves = ""
    if passed_s.size:
        moves = (
            f", {_short(length_m / passed_s.sum())} m/s in the mean and "
            f"{_short((step_m / passed_s).max())} m/s at most, longest gap "
            f"{_short(passed_s.max())} s"
        )
    left_out = sum(track.dropped.values())
    reasons = ", ".join(f"{count:,} with {why}" for why, count in track.dropped.items())
    return (
        f"{_short(length_m)} m from {time_s[0]:,.1f} to {time_s[-1]:,.1f} s{moves}; covers "
        f"{covered:.1%} of the drive"
        + (f"; {left_out:,} of {track.entries:,} entries left out: {reasons}" if left_out else "")
        + ("" if track.start_utc is None else _begins(track.start_utc))
    )


def _short(value: float | np.floating[Any]) -> str:
    return f"{value:,.0f}" if value >= 1_000 else f"{value:.3g}"


def _begins(instant: dt.datetime) -> str:
    return f"; time 0 is {instant:%Y-%m-%d %H:%M:%S} UTC"
