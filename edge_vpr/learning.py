"""Update of a map: another drive of the route is aligned with it and averaged into its codes.

A map of one drive shows the route in one light. Each further drive is matched with the map (or
aligned by its track), and the logarithm of the counts of its windows is averaged into the places
that they show. The descriptors stay as large as they were.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.codes import drive_mean
from edge_vpr.descriptors.windows import Descriptors, activity_of_drive
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.tracks import Track, distances
from edge_vpr.map_record import AnyMap, MapRecord
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.drive import match_query
from edge_vpr.route import Odometry

#: a window is aligned by matching if its match is correct with this probability
LEAST_PROBABILITY = 0.9
#: the newest drive weighs at least 1/5 in the mean, so that a map follows a route that changes
MOST_DRIVES = 4
#: a drive of which fewer windows can be aligned is refused, or learnt with a warning
LEAST_ALIGNED, FEW_ALIGNED = 0.5, 0.75
#: places that are looked at for confusion, spread over the route
SAMPLE = 2_000
#: share of places that may newly be confused with others before there is a warning
MORE_CONFUSED = 0.1
#: deviations from the median change of a place, above which it counts as changed
CHANGED = 5.0
#: fraction bits of the mean code of several drives
FRACTION_BITS = 8


@dataclass(frozen=True)
class MapUpdate(Generic[AnyMap]):
    """A map that was updated with another drive, and the effect of that drive.

    Attributes
    ----------
    reference : MapRecord
        The map with the new codes.
    aligned : ndarray of bool, shape (n,)
        Which windows of the drive could be aligned with a place.
    place : ndarray of int64, shape (n,)
        That place; -1 where a window was not aligned.
    learnt : ndarray of bool, shape (K,)
        Places with at least one aligned window.
    changed : ndarray of int64
        Places that look different from the map, much more than most do.
    confused_before, confused : float
        Share of the places whose descriptor of before is nearest to another part of the route, in
        the map of before and in this one.
    """

    reference: AnyMap
    aligned: npt.NDArray[np.bool_]
    place: npt.NDArray[np.int64]
    learnt: npt.NDArray[np.bool_]
    changed: npt.NDArray[np.int64]
    confused_before: float
    confused: float

    @property
    def warnings(self) -> list[str]:
        """Warnings that the new map may be worse than the old one; empty if there are none."""
        found = []
        share = float(self.aligned.mean())
        if share < FEW_ALIGNED:
            found.append(
                f"only {self.aligned.sum()} of {self.aligned.size} windows could be aligned with "
                "the map: check that the drive is of the same route"
            )
        if self.confused > self.confused_before + MORE_CONFUSED:
            found.append(
                f"the new map confuses {self.confused:.0%} of its places with others in the light "
                f"of before ({self.confused_before:.0%} with the old map): keep the old map too"
            )
        return found

    def __str__(self) -> str:
        text = (
            f"{self.aligned.sum()} of {self.aligned.size} windows aligned, "
            f"{self.learnt.sum()} of {self.learnt.size} places learnt"
        )
        if not self.changed.size:
            return text
        runs = _runs(self.changed)
        where = ", ".join(runs[:8]) + (" ..." if len(runs) > 8 else "")
        return f"{text}; {self.changed.size} places look different: {where}"


def _runs(places: npt.NDArray[np.int64]) -> list[str]:
    """Return rising places as text, with runs of successive ones as first-last."""
    parts = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
    return [f"{part[0]}-{part[-1]}" if len(part) > 1 else str(part[0]) for part in parts]


class _Learnt(NamedTuple):
    """Mean code of each place over its drives in units of 1/256, and the number of those drives."""

    mean: npt.NDArray[np.int32]
    drives: npt.NDArray[np.uint8]


def learn_drive(
    reference: AnyMap,
    counted: Descriptors,
    *,
    track: Track | None = None,
    odometry: Odometry | None = None,
) -> MapUpdate[AnyMap]:
    """Average another drive into the codes of a map.

    Parameters
    ----------
    counted : Descriptors
        Counts of the drive at the pixels of the map, n windows of `count_places`.
    track : Track, optional
        Of the drive. Where the map has positions too, its windows are aligned by them.
    odometry : Odometry, optional
        Of the drive, for its alignment by matching.

    Raises
    ------
    UsageError
        If hardly any window can be aligned, or the map takes no odometry.
    """
    place = _aligned_by_track(reference, counted, track) if track is not None else None
    if place is None:
        place = _aligned_by_matching(reference, counted, odometry)
    aligned = place >= 0
    if aligned.mean() < LEAST_ALIGNED:
        raise UsageError(
            f"{aligned.sum()} of {aligned.size} windows could be aligned with the map: name a "
            "drive of the same route, or give the tracks of both drives"
        )
    code, initial = reference.own_mean_code, reference.mean
    if code is None or initial is None:
        fine = reference.coded(counted).counts.astype(np.int64) << FRACTION_BITS
    else:
        windows = counted.take(slice(None, None, reference.settings.window_parts))
        own = drive_mean(windows, code, reference.mean_activity)
        fine = code.fine(counted.counts, own)
    seen, shown = _mean_by_place(fine, place, len(reference))
    learnt = shown > 0
    before = _learnt_before(reference)
    weight = np.minimum(before.drives, MOST_DRIVES).astype(np.int64)
    total = before.mean.astype(np.int64) * weight[:, None] + seen
    averaged = _rounded(total, weight[:, None] + 1)
    mean = np.where(learnt[:, None], averaged, before.mean).astype(np.int32)
    if code is not None and initial is not None:
        most = int(weight.max())
        both = initial.astype(np.int64) * most + own
        initial = _rounded(both, most + 1).astype(np.int32)
    places = reference.places
    # as many events as in a drive that is as bright and as fast as the reference
    of_map, of_drive = (activity_of_drive(each.selected_events) for each in (places, counted))
    scaled = counted.selected_events * of_map // max(of_drive, 1)
    events, _ = _mean_by_place(scaled, place, len(places))
    activity = _rounded(places.selected_events * weight + events, weight + 1)
    codes = (mean + (1 << (FRACTION_BITS - 1))) >> FRACTION_BITS
    updated = replace(
        reference,
        places=replace(
            places,
            counts=codes.astype(places.counts.dtype),
            selected=np.where(learnt, activity, places.selected_events),
        ),
        mean=initial,
        learnt_mean=mean,
        drives=np.minimum(before.drives + learnt, MOST_DRIVES).astype(np.uint8),
        confidence=None,
    )
    change = np.abs(seen - before.mean).sum(axis=1)
    return MapUpdate(
        updated,
        aligned,
        place,
        learnt,
        _outliers(change, learnt),
        _confused(reference, reference),
        _confused(reference, updated),
    )


def _aligned_by_matching(
    reference: MapRecord, counted: Descriptors, odometry: Odometry | None
) -> npt.NDArray[np.int64]:
    """Return the place that each window shows, by its smoothed match; -1 if the match is uncertain.

    Windows that overlap are matched as several drives, each of windows that do not.
    """
    asked = {
        "matching": "filter", "smooth": True, "query_mean": "own", "precision": None,
        "stays_on_map": False,  # a drive to be learnt may leave the route
    }  # fmt: skip
    matching = reference.matched_with(reference.settings.replaced(asked, "alignment"))
    place = np.full(len(counted), -1, dtype=np.int64)
    number = reference.settings.window_parts
    for first in range(min(number, len(counted))):
        windows = matching.coded(counted.take(slice(first, None, number)))
        matches = match_query(matching, windows, odometry)
        place[first::number] = np.where(matches.probability >= LEAST_PROBABILITY, matches.place, -1)
    return place


def _aligned_by_track(
    reference: MapRecord, counted: Descriptors, track: Track
) -> npt.NDArray[np.int64] | None:
    """Return the place nearest to the position of each window; -1 where none is as near as places.

    None if the map has no positions of this kind.
    """
    route = reference.route
    if route is None or (route.kind, route.position.shape[1]) != (
        track.kind, track.position.shape[1],
    ):  # fmt: skip
        return None
    known = np.flatnonzero(np.isfinite(route.along_m))
    spacing = float(np.ptp(route.along_m[known[[0, -1]]])) / max(known.size - 1, 1)
    place = np.full(len(counted), -1, dtype=np.int64)
    for i, position in enumerate(track.at(counted.centre_us)):
        if np.isfinite(position).all():
            away = distances(route.kind, route.position[known], position[None])
            nearest = int(away.argmin())
            if away[nearest] <= spacing:
                place[i] = known[nearest]
    return place


def _mean_by_place(
    values: npt.NDArray[np.int64], place: npt.NDArray[np.int64], places: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the rounded mean of the rows of each place, 0 without one, and how many it has."""
    total = np.zeros((places, *values.shape[1:]), dtype=np.int64)
    np.add.at(total, place[place >= 0], values[place >= 0])
    windows = np.bincount(place[place >= 0], minlength=places)
    at_least_one = np.maximum(windows, 1).reshape(-1, *(1,) * (values.ndim - 1))
    return _rounded(total, at_least_one), windows


def _rounded(
    total: npt.NDArray[np.int64], number: npt.NDArray[np.int64] | int
) -> npt.NDArray[np.int64]:
    """Divide whole numbers, rounded to the nearest."""
    return (2 * total + number) // (2 * number)


def _learnt_before(reference: MapRecord) -> _Learnt:
    if reference.learnt_mean is not None and reference.drives is not None:
        return _Learnt(reference.learnt_mean, reference.drives)
    mean = reference.places.counts.astype(np.int32) << FRACTION_BITS
    return _Learnt(mean, np.ones(len(reference), dtype=np.uint8))


def _outliers(
    change: npt.NDArray[np.int64], learnt: npt.NDArray[np.bool_]
) -> npt.NDArray[np.int64]:
    """Return the places that changed much more than most."""
    median = np.median(change[learnt])
    deviation = 1.4826 * np.median(np.abs(change[learnt] - median))
    return np.flatnonzero(learnt & (change > median + CHANGED * max(deviation, 1.0)))


def _confused(before: MapRecord, after: MapRecord) -> float:
    """Return the share of places of one map that resemble another part of the other map most."""
    places = len(before)
    some = np.unique(np.linspace(0, places - 1, min(places, SAMPLE)).astype(np.int64))
    index, exclusion = ReferenceIndex(after.places.counts), before.settings.exclusion_places
    confused = 0
    for first in range(0, len(some), 64):
        part = some[first : first + 64]
        nearest = index.rows(before.places.counts[part]).argmin(axis=1)
        confused += int((np.abs(nearest - part) > exclusion).sum())
    return confused / len(some)
