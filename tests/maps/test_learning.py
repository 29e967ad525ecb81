"""Maps that learn other drives: alignment, mean codes, ageing, warnings, and the command."""

from __future__ import annotations

import operator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from edge_vpr import ReferenceMap, UsageError
from edge_vpr.descriptors.activity import activity_of_drive, find_pauses
from edge_vpr.descriptors.counting import count_places
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.tracks import Track
from edge_vpr.learning import MOST_DRIVES, align, learn_drive
from edge_vpr.simulation import REFERENCE, SimulatedRecording, simulate_pair

Places = npt.NDArray[np.int64]
Drives = tuple[SimulatedRecording, SimulatedRecording]


@pytest.fixture(scope="module")
def drives() -> Drives:
    reference, query = simulate_pair(3, "tiny", length_m=150)
    return reference.keep(), query.keep()


def _nearest(reference: ReferenceMap, track: Track, query: Track, times: Places) -> Places:
    places = track.at(reference.places.centre_us)[:, 0]
    return np.abs(query.at(times)[:, 0][:, None] - places).argmin(axis=1)


@pytest.mark.parametrize("number", [1, 2])
def test_the_new_codes_are_the_rounded_mean_of_both_drives(drives: Drives, number: int) -> None:
    reference, query = drives
    changes = {"pixels": 20, "places_per_window": number}
    route = ReferenceMap.build(reference, track=reference.track, **changes)
    update = route.update(query, track=query.track)
    counted = count_places(query, route.pixel_map, route.settings)
    expected_place = _nearest(route, reference.track, query.track, counted.centre_us)
    assert (update.place[update.aligned] == expected_place[update.aligned]).all()
    assert update.aligned.mean() > 0.9

    # in plain Python and exact fractions
    code = route.settings.contrast_code
    assert code is not None and route.mean is not None
    levels = code.level(counted.counts).tolist()
    n, counters = counted.counts.shape
    top = 2**code.bits - 1
    activity = activity_of_drive(route.places.selected_events[::number])
    paused = find_pauses(counted.selected_events[::number], activity)
    moving = [row for row, pause in zip(levels[::number], paused, strict=True) if not pause]
    m = len(moving)
    means = [(2 * sum(row[j] for row in moving) + m) // (2 * m) for j in range(counters)]
    of_window = [
        _round_half_up(Fraction(sum(map(operator.sub, row, means)), counters)) for row in levels
    ]
    for k in range(len(route)):
        windows = [i for i in range(n) if update.place[i] == k]
        for j in range(counters):
            old = 256 * int(route.places.counts[k, j])
            if windows:
                fine = [
                    min(max(levels[i][j] - means[j] - of_window[i] + 128 * (top + 1), 0), 256 * top)
                    for i in windows
                ]
                seen = _round_half_up(Fraction(sum(fine), len(fine)))
                old = _round_half_up(Fraction(old + seen, 2))
            assert update.reference.places.counts[k, j] == _round_half_up(Fraction(old, 256))


def _round_half_up(value: Fraction) -> int:
    return (2 * value.numerator + value.denominator) // (2 * value.denominator)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"counter_code": "linear"},
        {"counter_code": "none"},
        {"matching": "sequence", "smooth": False},
        {"places_per_window": 2},
    ],
)
def test_a_map_that_learns_its_own_drive_stays_as_it_is(
    drives: Drives, changes: dict[str, Any]
) -> None:
    reference, _ = drives
    route = ReferenceMap.build(reference, pixels=20, track=reference.track, **changes)
    update = route.update(reference, track=reference.track)
    assert update.aligned.all() and update.learnt.all()
    assert (update.reference.places.counts == route.places.counts).all()
    assert (update.reference.places.selected_events == route.places.selected_events).all()
    assert update.reference.drives is not None and (update.reference.drives == 2).all()
    assert update.reference.packed_bytes_per_place == route.packed_bytes_per_place


def test_a_map_of_two_drives_is_saved_loaded_and_matched(drives: Drives, tmp_path: Path) -> None:
    reference, query = drives
    update = ReferenceMap.build(reference, pixels=50).update(query)
    update.reference.save(tmp_path / "two.npz")
    loaded = ReferenceMap.load(tmp_path / "two.npz")
    assert loaded == update.reference
    result = loaded.match(query)
    right = result.evaluate((reference.track, query.track), 10).precision_at_100_recall
    assert right > 0.9


def test_the_newest_drive_weighs_a_fifth_in_the_end(drives: Drives) -> None:
    reference, _ = drives
    route = ReferenceMap.build(reference, pixels=20, counter_code="none", track=reference.track)
    counted = route.places
    for _ in range(MOST_DRIVES + 2):
        route = learn_drive(route, counted, track=None).reference
    assert route.drives is not None and (route.drives == MOST_DRIVES).all()
    brighter = replace(counted, counts=(counted.counts.astype(np.int64) + 50).astype(np.uint8))
    after = learn_drive(route, brighter, track=reference.track)  # bright places match all of it
    assert after.learnt.all()
    grown = after.reference.places.counts.astype(int) - route.places.counts
    assert (grown[after.learnt].mean(axis=1) >= 9).all()


def test_a_drive_of_another_route_is_refused(drives: Drives) -> None:
    elsewhere, _ = simulate_pair(5, "tiny", length_m=150)
    with pytest.raises(UsageError, match="of the same route"):
        ReferenceMap.build(drives[0], pixels=50).update(elsewhere)


@pytest.mark.parametrize("order", ["reversed", "shuffled"])
def test_a_drive_that_is_not_of_the_route_is_refused_unless_it_is_said_to_be(
    drives: Drives, order: str
) -> None:
    reference, query = drives
    route = ReferenceMap.build(reference, pixels=50)
    counted = count_places(query, route.pixel_map, route.settings)
    n = len(counted)
    rng = np.random.default_rng(0)
    chosen = np.arange(n)[::-1] if order == "reversed" else rng.permutation(n)
    other = replace(counted.take(chosen), start_us=counted.start_us, end_us=counted.end_us)
    with pytest.raises(UsageError, match="same_route="):
        learn_drive(route, other)
    update = learn_drive(route, counted, same_route=True)
    assert update.aligned.mean() > 0.9


def test_windows_between_anchors_are_aligned_with_the_places_between_them(drives: Drives) -> None:
    """Where a glare hides half of the pixels, the windows around it say where the robot is."""
    reference, query = drives
    route = ReferenceMap.build(reference, pixels=50, places_per_window=1)
    counted = count_places(query, route.pixel_map, route.settings)
    expected = _nearest(route, reference.track, query.track, counted.centre_us)
    middle, counts = slice(len(counted) // 2, len(counted) // 2 + 4), counted.counts.copy()
    counts[middle, ::2] = counts[middle, ::2].max()
    update = learn_drive(route, replace(counted, counts=counts))
    assert update.aligned[middle].all()
    assert (np.abs(update.place[middle] - expected[middle]) <= 3).all()


def test_windows_away_from_the_route_are_not_learnt() -> None:
    """A detour: on another street the robot sees other things, and comes back where it left."""
    reference, query = (drive.keep() for drive in simulate_pair(3, "tiny", length_m=300))
    elsewhere, _ = simulate_pair(5, "tiny", length_m=150)
    route = ReferenceMap.build(reference, pixels=50, places_per_window=1)
    on, off = (count_places(one, route.pixel_map, route.settings) for one in (query, elsewhere))
    half, away = len(on) // 2, min(12, len(off))
    parts = (on.take(slice(0, half)), off.take(slice(0, away)), on.take(slice(half, None)))
    counts = np.concatenate([part.counts for part in parts])
    events = np.concatenate([part.events for part in parts])
    start = np.arange(len(counts), dtype=np.int64) * 1_000_000
    aligned = align(route, Descriptors(counts, start, start + 1_000_000, events)).place >= 0
    assert aligned[:half].mean() > 0.7 and aligned[half + away :].mean() > 0.7
    assert aligned[half : half + away].mean() <= 0.5


def test_a_drive_that_leaves_the_route_is_learnt(drives: Drives) -> None:
    reference, query = drives
    route = ReferenceMap.build(reference, pixels=50, track=reference.track)
    counted = count_places(query, route.pixel_map, route.settings)
    far = Track(query.track.time_us, query.track.position + 10_000)
    n, last = len(counted), int(query.track.time_us[-1])
    later = replace(counted, start_us=counted.start_us + last, end_us=counted.end_us + last)
    names = ("counts", "start_us", "end_us", "events")
    both = (np.concatenate([getattr(one, name) for one in (counted, later)]) for name in names)
    track = Track(
        np.concatenate([query.track.time_us[:-1], far.time_us + last]),
        np.concatenate([query.track.position[:-1], far.position]),
    )
    update = learn_drive(route, Descriptors(*both), track=track)
    assert not update.aligned[n:].any()
    assert f"{update.aligned.sum()} of {update.aligned.size} windows aligned" in str(update)


@pytest.mark.parametrize(("share", "refused"), [(0.95, False), (0.85, True)])
def test_a_drive_that_shows_less_than_nine_tenths_of_the_route_is_refused(
    drives: Drives, share: float, refused: bool
) -> None:
    reference, query = drives
    route = ReferenceMap.build(reference, pixels=50, track=reference.track)
    counted = count_places(query, route.pixel_map, route.settings)
    place = _nearest(route, reference.track, query.track, counted.centre_us)
    part = counted.take(np.flatnonzero(place < share * len(route) - 6))  # of the exclusion zone
    if not refused:
        assert len(part) < len(counted)
        assert learn_drive(route, part, track=query.track).aligned.all()
        return
    with pytest.raises(UsageError, match=r"shows 8\d% .* at least 90% .*whole route$"):
        learn_drive(route, part, track=query.track)
    with pytest.raises(UsageError, match=r"route; if this is one, .* of this drive \(track=\)"):
        learn_drive(route, part)


@pytest.mark.parametrize("by_track", [False, True])
def test_a_halt_of_the_first_drive_is_no_part_of_the_route(by_track: bool) -> None:
    """Its places look alike, and a drive that does not halt there shows one of them."""
    halting = replace(REFERENCE, stops=1, stop_s=15.0)
    monday, tuesday = simulate_pair(3, "tiny", length_m=400, reference=halting)
    track, other = (monday.track, tuesday.track) if by_track else (None, None)
    route = ReferenceMap.build(monday, pixels=50, track=track)
    assert route.update(tuesday, track=other).aligned.all()


def test_the_command_maps_two_drives_and_updates_a_map(tmp_path, run, refused, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(*["simulate", "-o", "street", "--sensor", "tiny", "--length", "150", "--seed", "3"])
    build = "map street/reference.npz street/query.npz -o two.npz --pixels 50"
    assert "windows aligned" in run(*build.split()).out
    both = ReferenceMap.load("two.npz")
    assert both.drives is not None and both.drives.max() == 2

    run(*["map", "street/reference.npz", "-o", "one.npz", "--pixels", "50"])
    run(*["map", "one.npz", "street/query.npz", "-o", "one.npz", "--overwrite"])
    assert ReferenceMap.load("one.npz") == both

    for wrong, sentence in (
        ("map one.npz -o new.npz", "is a map already"),
        ("map one.npz street/query.npz -o new.npz --pixels 20", "--pixels is for making a map"),
        (
            "map street/reference.npz -o new.npz --track street/reference_track.csv "
            "--track street/query_track.csv",
            "2 tracks for 1 drives",
        ),
        ("map one.npz street/query.npz -o street/query.npz --overwrite", "street/query.npz"),
    ):
        assert sentence in refused(*wrong.split())
    assert not Path("new.npz").exists()
