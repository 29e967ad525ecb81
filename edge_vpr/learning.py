"""Update of a map: another drive of the route is aligned with it and averaged into its codes.

A map of one drive shows the route in one light. Each further drive is aligned with the map (by its
track, or by matching both ways), and the logarithm of the counts of its windows is averaged into
the places that they show. The descriptors stay as large as they were.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import plain
from edge_vpr.descriptors.activity import activity_of_drive, find_pauses
from edge_vpr.descriptors.codes import drive_mean
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.facts import Drive
from edge_vpr.evaluation.tracks import Track, distances
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.drive import match_by_filter, match_descriptors
from edge_vpr.matching.place_filter import PlaceFilter
from edge_vpr.matching.search import exclusion_zone
from edge_vpr.odometry import Odometry
from edge_vpr.reference_map import ReferenceMap

#: a window agrees if its place, matched with the windows of the drive, is that many windows from it
AGREE = 3
#: a window is an anchor if at least this share of those around it agrees, and if on average at most
#: this share of all places looks more like each of them than the matched place does
AROUND, LEAST_AGREEING, ANCHOR_RANK = 12, 0.6, 46 / 256
#: windows between two anchors are aligned with the places between these, if there are not more of
#: them, and not more places a window than `MOST_PACE` times as many as in the reference, and if at
#: most this share of all places looks more like them
LONGEST_GAP, MOST_PACE, GAP_RANK = 80, 3, 64 / 256
#: the newest drive weighs at least 1/5 in the mean, so that a map follows a route that changes
MOST_DRIVES = 4
#: a drive of which fewer windows can be aligned is refused
LEAST_ALIGNED = 0.5
#: a drive is refused too unless this share of its smoothed matches has this probability: a short
#: drive of another route agrees with the map by chance
LEAST_CERTAIN, CERTAIN = 0.1, 0.8
#: A drive that shows less of the places at which the map's drive moved is refused: its light would
#: be that of the learnt places alone, and draw matches of the others to them. A place is shown if
#: one in its exclusion zone is.
LEAST_SHOWN = 0.9
#: fraction bits of the mean code of several drives
FRACTION_BITS = 8


@dataclass(frozen=True)
class MapUpdate:
    """A map that was updated with another drive, and the effect of that drive.

    Attributes
    ----------
    reference : ReferenceMap
        The map with the new codes.
    aligned : ndarray of bool, shape (n,)
        Which windows of the drive could be aligned with a place.
    place : ndarray of int64, shape (n,)
        That place; -1 where a window was not aligned.
    learnt : ndarray of bool, shape (K,)
        Places with at least one aligned window.
    drive : Drive
        The other drive, for `facts`.
    """

    reference: ReferenceMap
    aligned: npt.NDArray[np.bool_]
    place: npt.NDArray[np.int64]
    learnt: npt.NDArray[np.bool_]
    drive: Drive

    def __str__(self) -> str:
        return (
            f"{self.aligned.sum()} of {self.aligned.size} windows aligned, "
            f"{self.learnt.sum()} of {self.learnt.size} places learnt"
        )


def learn_drive(
    reference: ReferenceMap,
    counted: Descriptors,
    *,
    track: Track | None = None,
    odometry: Odometry | None = None,
    same_route: bool = False,
) -> MapUpdate:
    """Average another drive into the codes of a map.

    Parameters
    ----------
    counted : Descriptors
        Counts of the drive at the pixels of the map, n windows of `count_places`.
    track : Track, optional
        Of the drive. Where the map has positions too, its windows are aligned by them.
    odometry : Odometry, optional
        Of the drive, for its alignment by matching.
    same_route : bool
        The drive is known to be of the route: it may leave it for most of its windows.

    Raises
    ------
    UsageError
        If the drive may not be of the route or shows too little of it, or the map takes no
        odometry.
    """
    place, matched = align(reference, counted, track, odometry)
    aligned, certain = place >= 0, float(matched.mean())
    of_route = same_route or (aligned.mean() >= LEAST_ALIGNED and certain >= LEAST_CERTAIN)
    if not (of_route and aligned.any()):
        raise UsageError(
            f"{aligned.sum()} of {aligned.size} windows could be aligned with the map, and "
            f"{certain:.0%} of them matched with a probability of {CERTAIN}: name a drive of the "
            "same route, give the tracks of both drives, or say that it is of the route "
            "(same_route=True)"
        )
    learnt = np.bincount(place[aligned], minlength=len(reference)) > 0
    # places of a halt look alike, and a drive that does not halt there shows one of them
    moved = ~find_pauses(reference.places.counted_events, reference.mean_activity)
    near = _mean_near(learnt, reference.settings.exclusion_places) > 0
    shown = float(near[moved].mean()) if moved.any() else 1.0
    if shown < LEAST_SHOWN:
        by_track = track is not None and reference.route is not None
        raise UsageError(
            f"the drive shows {shown:.0%} of the route, and at least {LEAST_SHOWN:.0%} is needed, "
            "since the rest would be found less often in its light: learn a recording of the whole "
            "route"
            + "; if this is one, windows could not be aligned by matching: make the map with the "
            "track of its drive, and give that of this drive (track=) too" * (not by_track)
        )
    windows = counted.take(slice(None, None, reference.settings.window_parts))
    drive = Drive.of_windows(windows, reference.pixel_map.sensor, track=track)
    return MapUpdate(_averaged(reference, counted, place, learnt), aligned, place, learnt, drive)


def _averaged(
    reference: ReferenceMap,
    counted: Descriptors,
    place: npt.NDArray[np.int64],
    learnt: npt.NDArray[np.bool_],
) -> ReferenceMap:
    """Return a map with the codes of a drive averaged into those of the places that it shows."""
    places = reference.places
    # mean code of each place over its drives, and their number
    before, drives = reference.learnt_mean, reference.drives
    if before is None or drives is None:
        before = places.counts.astype(np.int32) << FRACTION_BITS
        drives = np.ones(len(places), dtype=np.uint8)
    weight = np.minimum(drives, MOST_DRIVES).astype(np.int64)
    code, initial = reference.settings.contrast_code, reference.mean
    if code is None or initial is None:
        fine = reference.coded(counted).counts.astype(np.int64) << FRACTION_BITS
    else:
        windows = counted.take(slice(None, None, reference.settings.window_parts))
        windows = replace(windows, counted=reference.counted_events(windows))
        own = drive_mean(windows, code, reference.mean_activity)
        fine = code.fine(counted.counts, own)
        most = int(weight.max())
        both = initial.astype(np.int64) * most + own
        initial = _rounded(both, most + 1).astype(np.int32)
    seen = _mean_by_place(fine, place, len(reference))
    total = before.astype(np.int64) * weight[:, None] + seen
    averaged = _rounded(total, weight[:, None] + 1)
    mean = np.where(learnt[:, None], averaged, before).astype(np.int32)
    # as many events as in a drive that is as bright and as fast as the reference
    events = reference.counted_events(counted)
    of_map, of_drive = activity_of_drive(places.counted_events), activity_of_drive(events)
    scaled = events * of_map // max(of_drive, 1)
    events = _mean_by_place(scaled, place, len(places))
    activity = _rounded(places.counted_events * weight + events, weight + 1)
    codes = (mean + (1 << (FRACTION_BITS - 1))) >> FRACTION_BITS
    return replace(
        reference,
        places=replace(
            places,
            counts=codes.astype(places.counts.dtype),
            counted=np.where(learnt, activity, places.counted_events),
        ),
        mean=initial,
        learnt_mean=mean,
        drives=np.minimum(drives + learnt, MOST_DRIVES).astype(np.uint8),
        confidence=None,
    )


class Aligned(NamedTuple):
    """Place of each window, -1 where it was not aligned, and whether it is certain by itself."""

    place: npt.NDArray[np.int64]
    certain: npt.NDArray[np.bool_]


def align(
    reference: ReferenceMap,
    counted: Descriptors,
    track: Track | None = None,
    odometry: Odometry | None = None,
) -> Aligned:
    """Align the windows of a drive with the places that they show; see `learn_drive`."""
    place = _aligned_by_track(reference, counted, track) if track is not None else None
    if place is None:
        return _aligned_by_matching(reference, counted, odometry)
    return Aligned(place, np.ones(place.size, dtype=np.bool_))


def _aligned_by_matching(
    reference: ReferenceMap, counted: Descriptors, odometry: Odometry | None
) -> Aligned:
    """Align the windows of a drive with the places that they show, in any light.

    Windows that overlap are aligned as several drives, each of windows that do not.
    """
    changes = {
        "matching": "filter", "smooth": True, "precision": None,
        "stays_on_map": False,  # a drive to be learnt may leave the route
    }  # fmt: skip
    matching = reference.matched_with(reference.settings.replaced(changes, "alignment"))
    number = reference.settings.window_parts
    n = len(counted)
    aligned = Aligned(np.full(n, -1, dtype=np.int64), np.zeros(n, dtype=np.bool_))
    for first in range(min(number, n)):
        windows = matching.coded(counted.take(slice(first, None, number)))
        for whole, part in zip(
            aligned, _aligned_both_ways(matching, windows, odometry), strict=True
        ):
            whole[first::number] = part
    return aligned


def _aligned_both_ways(
    matching: ReferenceMap, windows: Descriptors, odometry: Odometry | None
) -> Aligned:
    """Align windows where the best path over the places and that over the windows agree.

    A probability says little in light that the map does not know. But a window whose smoothed match
    is a place, which matched with the windows of the drive leads back to that window, is right in
    any light; and what lies between two such anchors is between them on the route.
    """
    settings, index = matching.settings, ReferenceIndex(matching.places.counts)
    number = settings.window_parts
    place_filter = PlaceFilter.of(matching.places, settings, matching.along_mm)
    transitions = place_filter.transitions  # the best places, not the middle of those near them
    transitions.table = transitions.table._replace(reach=0)
    acceptance = matching.acceptance
    matches = match_by_filter(place_filter, index, windows, settings, acceptance, odometry)
    place = matches.place
    better = _better_places(index, windows, place, settings.exclusion_places)
    one_gain = settings.replaced({"gains": 1}, "alignment")
    by_window = settings.replaced({"places_per_window": 1, "gains": 1}, "alignment")
    window = match_descriptors(windows, matching.windows, by_window).place
    nearest = np.minimum((place + number // 2) // number, len(window) - 1)
    agrees = np.abs(window[nearest] - np.arange(len(windows))) <= AGREE
    anchor = (
        agrees
        & (_mean_near(agrees, AROUND) >= LEAST_AGREEING)
        & (_mean_near(better, AROUND) <= ANCHOR_RANK)
    )
    aligned, anchors = np.where(anchor, place, -1), np.flatnonzero(anchor)
    for first, last in zip(anchors[:-1].tolist(), anchors[1:].tolist(), strict=True):
        begin, end = int(place[first]), int(place[last])
        if not 1 < last - first <= LONGEST_GAP:
            continue
        if not 0 <= end - begin <= MOST_PACE * number * (last - first):
            continue
        gap, between = windows.take(slice(first, last + 1)), place[first : last + 1]
        stretch = matching.places.take(slice(begin, end + 1))
        bound = begin + match_descriptors(stretch, gap, one_gain).place
        ranks = [
            _better_places(index, gap, path, settings.exclusion_places).mean()
            for path in (between, bound)
        ]
        if max(ranks) <= GAP_RANK:
            aligned[first : last + 1] = bound
    return Aligned(aligned, matches.probability >= CERTAIN)


def _better_places(
    index: ReferenceIndex, windows: Descriptors, place: npt.NDArray[np.int64], exclusion: int
) -> npt.NDArray[np.float64]:
    """Return the share of all places, but for those next to it, that beat the place of a window."""
    k, share = np.arange(index.places), np.empty(len(windows))
    for first in range(0, len(windows), 64):
        part = slice(first, first + 64)
        rows, own = index.rows(windows.counts[part]), place[part, None]
        begin, end = plain(exclusion_zone)(own, exclusion)
        beats = rows < np.take_along_axis(rows, own, axis=1)
        share[part] = (beats & ((k < begin) | (k >= end))).mean(axis=1)
    return share


def _mean_near(values: npt.NDArray[Any], reach: int) -> npt.NDArray[np.float64]:
    """Return the mean of each value and of up to `reach` on either side."""
    total, at = np.concatenate([[0], np.cumsum(values)]), np.arange(len(values))
    first, last = np.maximum(at - reach, 0), np.minimum(at + reach + 1, len(values))
    return np.asarray((total[last] - total[first]) / (last - first))


def _aligned_by_track(
    reference: ReferenceMap, counted: Descriptors, track: Track
) -> npt.NDArray[np.int64] | None:
    """Return the place nearest to the position of each window; -1 where none is as near as places.

    None if the map has no positions of this kind.
    """
    route = reference.route
    if route is None or (route.kind, route.position.shape[1]) != (
        track.kind, track.position.shape[1],
    ):  # fmt: skip
        return None
    placed = np.flatnonzero(np.isfinite(route.along_m))
    spacing = float(np.ptp(route.along_m[placed[[0, -1]]])) / max(placed.size - 1, 1)
    place = np.full(len(counted), -1, dtype=np.int64)
    for i, position in enumerate(track.at(counted.centre_us)):
        if np.isfinite(position).all():
            away = distances(route.kind, route.position[placed], position[None])
            nearest = int(away.argmin())
            if away[nearest] <= spacing:
                place[i] = placed[nearest]
    return place


def _mean_by_place(
    values: npt.NDArray[np.int64], place: npt.NDArray[np.int64], places: int
) -> npt.NDArray[np.int64]:
    """Return the rounded mean of the rows of each place, 0 without one."""
    total = np.zeros((places, *values.shape[1:]), dtype=np.int64)
    np.add.at(total, place[place >= 0], values[place >= 0])
    windows = np.bincount(place[place >= 0], minlength=places)
    at_least_one = np.maximum(windows, 1).reshape(-1, *(1,) * (values.ndim - 1))
    return _rounded(total, at_least_one)


def _rounded(
    total: npt.NDArray[np.int64], number: npt.NDArray[np.int64] | int
) -> npt.NDArray[np.int64]:
    """Divide whole numbers, rounded to the nearest."""
    return (2 * total + number) // (2 * number)
