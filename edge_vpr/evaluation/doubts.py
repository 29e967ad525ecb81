"""Checks whether two tracks are of one route, belong to their drives, and suit the tolerance."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeGuard

import numpy as np
import numpy.typing as npt

from edge_vpr.evaluation.tracks import (
    APART_M,
    SHORT_GAP_US,
    UNIX_US,
    USUAL_GAPS,
    Bools,
    Floats,
    Track,
    distances,
    unit_doubts,
)
from edge_vpr.route import Kind

Times = npt.NDArray[np.int64]

#: number of points of the query's track that are compared, evenly spread along it
QUERY_POINTS = 200
#: largest number of points of the reference's track; else two for each tolerance
REFERENCE_POINTS = 2_000
#: A note is given if a log and its drive have less than this share of their time in common: loggers
#: usually start and stop within seconds of the camera. Chosen by judgement.
LEAST_COMMON = 0.8
#: Least difference, chosen by judgement, for the notes that swapped logs would fit better, and that
#: two drives with the same log differ in length.
SWAPPED_BY = 0.05
#: Tracks of odometry begin this near to 0; in frames of their own, two of them part.
_ORIGIN_M, _OWN_FRAMES_SHARE = 1.0, 0.5
#: Two clocks are the same if they differ by less. Chosen by judgement.
_OTHER_CLOCK_US = 1_000_000
#: A camera's clock that is set over a network is wrong by less. Chosen by judgement.
_OTHER_START_US = 2_000_000
_UNIX_ZERO = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
#: Reasons for which a log is doubtful even if few of its entries are left out.
_SERIOUS = ("0 N 0 E", "a frozen position", "a position that cannot be reached")


class Overlap(NamedTuple):
    """Overlap of two tracks."""

    #: Share of the length of the query's track that lies within the tolerance of the reference's.
    share: float
    nearest_m: float  #: Least distance between the two.


def overlap(reference: Track, query: Track, tolerance_m: float) -> Overlap:
    """Compare the paths of two tracks, without their times.

    Parameters
    ----------
    reference, query : Track
        Of one kind and dimension.
    """
    places, spacing_m = _spread(reference, REFERENCE_POINTS, tolerance_m / 2)
    queries, _ = _spread(query, QUERY_POINTS, 0.0)
    nearest = distances(reference.kind, places, queries[:, None]).min(axis=1)
    return Overlap(float((nearest <= tolerance_m + spacing_m / 2).mean()), float(nearest.min()))


def notes(
    reference: Track,
    query: Track,
    reference_us: npt.NDArray[np.float64],
    query_us: npt.NDArray[np.float64],
    tolerance_m: float,
) -> tuple[str, ...]:
    """Return notes on logs that probably do not belong to these drives, or are not good enough.

    Parameters
    ----------
    reference_us, query_us : ndarray of float64
        Times of the windows' centres.

    Returns
    -------
    tuple of str
        Empty where both logs fit.
    """
    given = (_common(reference, reference_us), _common(query, query_us))
    swapped = (_common(query, reference_us), _common(reference, query_us))
    found = []
    ends = (float(reference_us.max()), float(query_us.max()))
    if _same(reference, query) and min(ends) < (1 - SWAPPED_BY) * max(ends):
        found.append("both logs are the same, of drives that are not as long: give one of each")
    if sum(swapped) > sum(given) + 2 * SWAPPED_BY:
        found.append(
            "the two logs fit the drives better the other way round: the reference's comes first"
        )
    for name, track, times, common in zip(
        ("reference", "query"), (reference, query), (reference_us, query_us), given, strict=True
    ):
        if common < LEAST_COMMON:
            found.append(_covers(f"{name} log", track, times))
        found += [f"{name} log: {note}" for note in track_notes(track)]
        found += _against_tolerance(name, track, times, tolerance_m)
    return tuple(found)


def drive_notes(track: Track, times_us: Times, clock_us: int) -> tuple[str, ...]:
    """Return notes on a log alone, and on whether its times suit the drive that it is given for.

    Parameters
    ----------
    times_us : ndarray of int64
        Times of the windows' centres.
    clock_us : int
        The recording's start on its own clock.
    """
    found = [*track_notes(track), *clock_notes(track, times_us, clock_us)]
    first, last = int(track.time_us[0]), int(track.time_us[-1])
    off, off_by_clock = (
        abs(first - times_us[0] - clock) + abs(last - times_us[-1] - clock)
        for clock in (0, clock_us)
    )
    # one that has been shifted begins before the recording
    if clock_us >= _OTHER_CLOCK_US <= off and off_by_clock <= off and first >= 0:
        found.append(
            f"time 0 is the recording's start, at {clock_us / 1e6:g} s on its own clock, and the "
            f"log covers {first / 1e6:g} to {last / 1e6:g} s: if these are on that clock too, "
            f"shift it by {-clock_us / 1e6:g} s (Track.shifted)"
        )
    elif _common(track, times_us) < LEAST_COMMON:
        found.append(_covers("log", track, times_us))
    return tuple(found)


def clock_notes(track: Track, times_us: npt.NDArray[Any], clock_us: int) -> Iterator[str]:
    """Yield a note if the dates of a log and of its recording say that they began at two instants.

    See `drive_notes`. Where one of the two clocks is wrong by more than the drive lasts, nothing is
    said: not even moved would the log be the drive's.
    """
    if track.start_utc is None or clock_us < UNIX_US:
        return
    apart_us = (track.start_utc - _UNIX_ZERO) // dt.timedelta(microseconds=1) - clock_us
    if abs(apart_us) < _OTHER_START_US or not _common(track.shifted(apart_us / 1e6), times_us):
        return
    yield (
        f"by the dates of both, the log is laid {abs(apart_us) / 1e6:,.1f} s too "
        f"{'early' if apart_us > 0 else 'late'} on the recording: if the camera's clock is right, "
        f"shift it by {apart_us / 1e6:.6g} s (Track.shifted)"
    )


def _covers(log: str, track: Track, times_us: npt.NDArray[Any]) -> str:
    longer = float(np.ptp(track.time_us)) / float(times_us.max())
    units = (("ms", 1e3), ("us", 1e6), ("ns", 1e9))
    unit = next((u for u, n in units if LEAST_COMMON < longer / n < 1 / LEAST_COMMON), None)
    return (
        f"the {log} covers {track.time_us[0] / 1e6:.0f} to {track.time_us[-1] / 1e6:.0f} s and "
        f"its drive lasts until {times_us.max() / 1e6:.0f} s: "
    ) + (
        "is it the log of this drive, and its clock right (Track.shifted)?"
        if unit is None
        else f"are its times in {unit}? Name the unit in the header, as in time_{unit}"
    )


def track_notes(track: Track) -> tuple[str, ...]:
    """Return notes on a log alone: what its file says, and whether much of it was left out."""
    # of a file, it has those on units
    found = tuple(
        dict.fromkeys([*track.notes, *unit_doubts(track), *_two_receivers(track), *_jumps(track)])
    )
    total = sum(track.dropped.values())
    if total * 10 > track.entries or any(why in track.dropped for why in _SERIOUS):
        return (*found, track.describe_dropped())
    return found


#: In a longer step, a vehicle can brake or turn by as much.
_STEP_OF_JUMP_S = 1.5
#: Reasons are found in logs of at least so many points.
_FEWEST = 8


def _off_line(track: Track, k: int) -> Floats:
    """Return how far each point is from the line between the k-th before and after it, in metres.

    Of points in time, so that a steady drive is 0; shape (n - 2 k,).
    """
    time_us, points = track.time_us, track.continuous
    before, after = slice(None, -2 * k), slice(2 * k, None)
    weight = (time_us[k:-k] - time_us[before]) / (time_us[after] - time_us[before])
    line = points[before] + weight[:, None] * (points[after] - points[before])
    return distances(track.kind, line, points[k:-k])


def _two_receivers(track: Track) -> Iterator[str]:
    """Yield a note if the points lie on two tracks in turn, as of two receivers in one log."""
    if track.time_us.size < _FEWEST:
        return
    apart_m, same_m = (float(np.median(_off_line(track, k))) for k in (1, 2))
    if apart_m > max(APART_M, 3 * same_m):
        yield (
            f"its positions change between two tracks {apart_m:.0f} m apart, as of two receivers: "
            "keep those of one"
        )


def _jumps(track: Track) -> Iterator[str]:
    """Yield a note if a position jumps and stays there, as where an odometer closes a loop.

    Each step is compared with what the two steps before and after it say of the velocity.
    """
    if track.time_us.size < _FEWEST:
        return
    points, seconds = track.continuous, np.diff(track.time_us)[:, None] / 1e6
    velocity = np.pad(np.diff(points, axis=0) / seconds, ((2, 2), (0, 0)), mode="edge")
    off_m = np.minimum.reduce([
        distances(track.kind, points[:-1] + velocity[k : k + len(seconds)] * seconds, points[1:])
        for k in (0, 1, 3, 4)
    ])  # fmt: skip
    large = off_m > max(APART_M, 10 * float(np.median(_off_line(track, 1))))
    # a single wrong position makes two large steps
    jumps = large & ~np.roll(large, 1) & ~np.roll(large, -1) & (seconds[:, 0] <= _STEP_OF_JUMP_S)
    if jumps.any():
        worst = int(np.argmax(np.where(jumps, off_m, 0.0)))
        number = int(jumps.sum())
        yield (
            f"its position jumps by {off_m[worst]:.0f} m at {track.time_us[worst + 1] / 1e6:.0f} s"
            + (f" and {number - 1} times more" if number > 1 else "")
            + ": positions before and after are of two frames, as where an odometer closes a loop; "
            "give corrected poses"
        )


def _against_tolerance(
    name: str, track: Track, times_us: Floats, tolerance_m: float
) -> Iterator[str]:
    """Yield notes on a tolerance that is too large or too small to tell matches apart."""
    points = track.position
    extent_m = float(distances(track.kind, points, points[:1]).max())
    if extent_m < tolerance_m:
        yield (
            f"the {name} track reaches {extent_m:,.3g} m from its start, less than the tolerance "
            f"of {tolerance_m:g} m, so that a match proves nothing: are its positions in metres, "
            "and did the receiver move?"
        )
    off_m = interpolation_error(track)
    if off_m > tolerance_m:
        gap_s = float(np.median(np.diff(track.time_us))) / 1e6
        yield (
            f"the {name} track has a point in {gap_s:.0f} s, between which it may be off by about "
            f"{off_m:,.0f} m, more than the tolerance of {tolerance_m:g} m: right matches count as "
            "wrong; give a larger tolerance, or a log with more points"
        )


def spacing_note(step: Floats, tolerance: float, unit: str) -> tuple[str, ...]:
    """Return a note if the tolerance is below the distance of neighbouring places.

    Parameters
    ----------
    step : ndarray of float64, shape (K - 1,)
        Distances from each place to the next; NaN where they are not known.
    """
    moved = step[step > 0]
    usual = float(np.median(moved)) if moved.size else 0.0
    if usual <= tolerance:
        return ()
    return (
        f"the tolerance of {tolerance:g} {unit} is below the distance of neighbouring places, "
        f"{usual:.3g} in the median: a match that is one place off counts as wrong; give a larger "
        "tolerance",
    )


def two_frames_note(reference: Track, query: Track, shared: Overlap) -> tuple[str, ...]:
    """Return a note if two tracks seem to be odometry, whose origin is where each drive began."""
    begin_at_0 = all(np.linalg.norm(track.position[0]) < _ORIGIN_M for track in (reference, query))
    flat = reference.kind == "geographic" or reference.position.shape[1] == 1
    if flat or not begin_at_0 or shared.share >= _OWN_FRAMES_SHARE:
        return ()
    return (
        f"both tracks begin at 0, and only {100 * shared.share:.0f} % of the query's runs along "
        "the reference's: odometry has another origin and heading in each drive, and cannot be "
        "compared; give positions in one frame, such as GPS, or poses in one map",
    )


def beyond_drive_notes(pairs: Floats, queries: Floats, places: Floats) -> tuple[str, ...]:
    """Return a note on an alignment of which many moments lie beyond the end of a drive.

    Parameters
    ----------
    pairs : ndarray of float64, shape (n, 2)
        Moments in the query and in the reference.
    queries, places : ndarray of float64
        Those of the windows.
    """
    beyond = [
        f"in the {name} reach {moments.max():g}, and its windows {windows.max():g}"
        for name, moments, windows in (
            ("query", pairs[:, 0], queries), ("reference", pairs[:, 1], places)
        )
        if LEAST_COMMON * moments.max() > windows.max()
    ]  # fmt: skip
    if not beyond:
        return ()
    return (
        f"the alignment's moments {', '.join(beyond)}: is the alignment of this drive, and the "
        "unit or frame_period= right?",
    )


def alignment_gap_notes(moments_s: Floats, queries_s: Floats) -> tuple[str, ...]:
    """Return a note on windows in gaps of an alignment, where the truth is a straight line.

    Parameters
    ----------
    moments_s, queries_s : ndarray of float64
        Of the alignment's points in the query, and of the windows, in seconds.
    """
    gaps = np.diff(moments_s)
    if not gaps.size:
        return ()
    long = gaps > max(SHORT_GAP_US / 1e6, USUAL_GAPS * float(np.median(gaps)))
    after = np.searchsorted(moments_s, queries_s)
    inside = (after > 0) & (after < moments_s.size)
    within = int(long[after[inside] - 1].sum())
    if not within:
        return ()
    at = int(np.argmax(gaps))
    return (
        f"the alignment has no point from {moments_s[at]:.0f} to {moments_s[at + 1]:.0f} s of the "
        f"query, and {within:,} windows lie in such gaps, where it is interpolated: give points "
        "there, or do not trust their judgement",
    )


def interpolation_error(track: Track) -> float:
    """Return how far positions between the points of a sparse track are off, in metres.

    Each point is left out and interpolated from its neighbours. The result is a third of the error
    that 9 of 10 of them stay below, since the gaps of the track itself are half as long. The third
    was measured on logs of a car, of which every 7th to 49th fix was kept.

    Returns
    -------
    float
        0 of a track with points at most 5 s apart, as most are.
    """
    if track.time_us.size < 4 or float(np.median(np.diff(track.time_us))) <= SHORT_GAP_US:
        return 0.0
    return float(np.quantile(_off_line(track, 1), 0.9)) / 3


# Positions of a GPS receiver that stopped updating while the camera moved.

#: A position that repeats exactly for this long was frozen if the camera moved meanwhile: windows
#: have at least half as many events then as in the rest of the drive.
_FROZEN_US = 5_000_000


def without_frozen(
    track: Track, times_us: Floats, events: npt.NDArray[np.integer]
) -> tuple[Track, tuple[str, ...]]:
    """Return a track without positions that repeat although the camera moved, and a note.

    Parameters
    ----------
    times_us, events : ndarray, shape (n,)
        Centres of the windows, and their numbers of events.
    """
    same = (track.position[1:] == track.position[:-1]).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    kept = np.ones(track.time_us.size, dtype=np.bool_)
    spans = []
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        begin, end = int(track.time_us[first]), int(track.time_us[last])
        inside = (times_us > begin) & (times_us <= end)
        if end - begin < _FROZEN_US or not inside.any() or inside.all():
            continue
        if 2 * np.median(events[inside]) >= np.median(events[~inside]):
            kept[first + 1 : last + 1] = False
            spans.append(f"{begin / 1e6:.0f} to {end / 1e6:.0f} s")
    if kept.all():
        return track, ()
    found = replace(track, time_us=track.time_us[kept], position=track.position[kept])
    # positions between frozen fixes become unknown, also between the fixes around them
    found = replace(found, max_gap_us=track.longest_gap_us)
    return found, (
        f"repeats one position from {', '.join(spans)}, while the camera counts events as before: "
        "the receiver was frozen, and positions are unknown there",
    )


# The offset between the clocks of camera and log, found by the matches.

#: Offsets that are tried, in seconds, and their steps.
MOST_OFFSET_S, _STEP_S = 120.0, 0.5
#: Most matches that an offset is found by.
_MOST_MATCHES = 2_000


class Offset(NamedTuple):
    """An offset of one of two logs, and the number of matches that are correct with it."""

    log: str  #: {"reference", "query"}: whose time 0 lies elsewhere; the other is as given.
    seconds: float  #: Where its time 0 lies, in addition to the offset that it has.
    within_s: float  #: Offsets up to this far from it fit nearly as well.
    correct: int
    judged: int
    #: correct_before, judged_before: without the offset.
    correct_before: int
    judged_before: int

    @property
    def pair(self) -> tuple[float, float]:
        """Offsets of the reference's and the query's log."""
        return (self.seconds, 0.0) if self.log == "reference" else (0.0, self.seconds)

    def __str__(self) -> str:
        return (
            f"with the {self.log} log {abs(self.seconds):.1f} s "
            f"{'later' if self.seconds > 0 else 'earlier'} (give or take {self.within_s:.1f} s), "
            f"{self.correct:,} of {self.judged:,} matches would be correct "
            f"instead of {self.correct_before:,} of {self.judged_before:,}"
        )


def best_offset(
    reference: Track, query: Track, place_us: Times, query_us: Times, tolerance_m: float
) -> Offset | None:
    """Find the offset of one log with which matches fit the tracks best; None if no offset helps.

    Parameters
    ----------
    place_us, query_us : ndarray of int64, shape (n,)
        For each match, centre of the matched place's window and of the query's.
    """
    some = slice(None, None, 1 + len(place_us) // _MOST_MATCHES)
    place_us, query_us = place_us[some], query_us[some]

    def errors(log: str, seconds: float) -> Floats:
        shift = seconds * 1e6
        at = reference.at(place_us - shift * (log == "reference"))
        true = query.at(query_us - shift * (log == "query"))
        return distances(reference.kind, at, true)

    before = errors("query", 0.0)
    tried = np.arange(-MOST_OFFSET_S, MOST_OFFSET_S + _STEP_S / 2, _STEP_S)
    found = []
    for log in ("query", "reference"):
        off = np.array([errors(log, seconds) for seconds in tried]) / tolerance_m
        # smoother than the number of correct matches, and highest in its middle
        fit = np.nansum(np.maximum(1.0 - off**2, 0.0), axis=1)
        best = int(np.argmax(fit))
        good = np.flatnonzero(fit >= 0.98 * fit[best])
        found.append((float(fit[best]), log, best, good, off[best]))
    _, log, best, good, off = max(found, key=lambda one: one[0])
    judged, judged_before = (int(np.isfinite(one).sum()) for one in (off, before))
    correct, correct_before = (int((one <= 1.0).sum()) for one in (off, before / tolerance_m))
    seconds = float(tried[best])
    if seconds == 0.0:
        return None
    return Offset(
        log, seconds, max(_STEP_S, float(np.abs(tried[good] - seconds).max())),
        correct, judged, correct_before, judged_before,
    )  # fmt: skip


#: Another offset or order is offered if the share of correct matches rises by at least the first
#: number, to at least the second, and the mean probability of the matches, where it is known, is
#: not below the second either. Chosen on simulated streets.
MORE_CORRECT, _MOST = 0.15, 0.5


def fits_far_better(
    correct: int,
    judged: int,
    correct_before: int,
    judged_before: int,
    probability: npt.NDArray[np.float64],
) -> bool:
    """Return whether far more of the matches, and most of them, would be correct than before.

    Parameters
    ----------
    probability : ndarray of float64, shape (n,)
        Of the matches. Those in another street fit some offset by chance, but are improbable.
    """
    # an offset at which few matches can be judged is no better for those few
    share = correct / max(judged, judged_before, 1)
    before = correct_before / max(judged_before, 1)
    known = probability[~np.isnan(probability)]
    probable = not known.size or float(known.mean()) >= _MOST
    return probable and share >= max(before + MORE_CORRECT, _MOST)


def is_clear(
    offset: Offset | None, window_s: float, probability: npt.NDArray[np.float64]
) -> TypeGuard[Offset]:
    """Return whether an offset of at least a window fits far better; see `best_offset`."""
    return (
        offset is not None
        and abs(offset.seconds) >= window_s
        and fits_far_better(
            offset.correct, offset.judged, offset.correct_before, offset.judged_before, probability
        )
    )


def _same(reference: Track, query: Track) -> bool:
    """Return whether two tracks have the same points, whatever their clocks' offsets."""
    return np.array_equal(reference.position, query.position) and np.array_equal(
        np.diff(reference.time_us), np.diff(query.time_us)
    )


def _common(track: Track, times_us: npt.NDArray[Any]) -> float:
    """Return the time shared by track and windows, divided by the time that they span together."""
    first, last = float(track.time_us[0]), float(track.time_us[-1])
    start, end = float(times_us.min()), float(times_us.max())
    # the first and the last window reach half a window beyond their centres
    half = (end - start) / max(1, 2 * (times_us.size - 1))
    start, end = start - half, end + half
    whole = max(last, end) - min(first, start)
    return max(0.0, min(last, end) - max(first, start)) / whole if whole > 0 else 1.0


def _spread(track: Track, most: int, least_m: float) -> tuple[Floats, float]:
    """Return points evenly spread along a track, without those in gaps, and their spacing."""
    points = track.position
    steps = distances(track.kind, points[1:], points[:-1])
    steps = np.where(track.bridged, steps, 0.0)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    if not along[-1] > 0:
        return points[:1], 0.0
    n = most if least_m * most <= along[-1] else math.ceil(along[-1] / least_m) + 1
    at = np.linspace(0.0, along[-1], n)
    rising = np.flatnonzero(np.diff(along, prepend=-1.0) > 0)
    found = [np.interp(at, along[rising], column[rising]) for column in track.continuous.T]
    return np.column_stack(found), float(along[-1] / (n - 1))


# Where places without a position may be.


@dataclass(frozen=True, eq=False)
class Whereabouts:
    """Where each place may be: not further from two points of the log than the drive could come.

    In a gap of its log, the reference drive can have been wherever it could come to from the point
    before and still reach the point after, at the highest speed of the rest of the log.
    """

    kind: Kind
    point: Floats  #: Shape (K, 2, d): points of the log before and after each place.
    reach_m: Floats  #: Shape (K, 2): infinite where the log has no such point.

    @classmethod
    def of(cls, reference: Track, places_us: Floats) -> Whereabouts:
        """Return where the places at some times, shape (K,), may be."""
        time_s, n = reference.time_us / 1e6, reference.time_us.size
        steps = distances(reference.kind, reference.position[1:], reference.position[:-1])
        speed = float(np.quantile(steps / np.diff(time_s), 0.95)) if n > 1 else 0.0
        at_s = places_us / 1e6
        after = np.searchsorted(time_s, at_s)
        beside = np.stack([after - 1, after], axis=1)
        some = np.clip(beside, 0, n - 1)
        reach = speed * np.abs(time_s[some] - at_s[:, None])
        return cls(
            reference.kind, reference.position[some], np.where(some == beside, reach, np.inf)
        )

    def may_be_within(
        self, place: npt.NDArray[np.integer] | np.intp, positions: Floats, tolerance_m: float
    ) -> Bools:
        """Return whether places, shape (n,) or (), may be within a tolerance of positions."""
        near = np.ones(len(positions), dtype=np.bool_)
        for side in (0, 1):
            off = distances(self.kind, self.point[place, side], positions)
            near &= off <= tolerance_m + self.reach_m[place, side]
        return near
