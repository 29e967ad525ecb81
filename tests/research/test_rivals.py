"""The experiments on rivals and on a moved mounting, on small drives."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from edge_vpr_tools.research.baselines import filter_distances, open_baseline
from edge_vpr_tools.research.baselines.selected_pixels import SelectedPixels
from edge_vpr_tools.research.experiments import (
    agreement,
    event_speed,
    mount_shift,
    pixel_number,
    rivals,
    window_length,
)
from edge_vpr_tools.research.experiments import (
    drives as counted_pairs,
)
from edge_vpr_tools.research.experiments.drives import Contest, CountedDrive, Pair
from edge_vpr_tools.research.experiments.experiment import Draw, rows_of
from edge_vpr_tools.research.experiments.mount_shift import ShiftedWindows, shifted

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.ground_truth import from_alignment
from edge_vpr.evaluation.metrics import mean_precision, precision_recall
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import CAMERAS, simulate_pair

TAU = 1_000_000
SETTINGS = PRESETS["paper"].replaced({"sequence_length": 2, "sigma": 2.0, "pixels": 150}, "test")


def truth_of(places_us, queries_us):
    ends = np.array([[0.0, 0.0], [100.0, 100.0]])
    return from_alignment(ends, queries_us / TAU, places_us / TAU, 1.0, "s")


def drives(windows=20):
    """The same drive twice, the second with a tenth of its events gone."""
    rng = np.random.default_rng(0)
    rough = rng.gamma(0.6, 6.0, (windows, 24, 24))
    images = rng.poisson(rough.repeat(4, axis=1).repeat(4, axis=2)).astype(np.uint16)
    return images, rng.binomial(images, 0.9).astype(np.uint16)


def contest(laid_out=True, **changes):
    images = drives(40)
    centre_us = np.arange(40) * TAU + TAU // 2
    counted = [CountedDrive(each[:, ::2, ::2], centre_us) for each in images]
    return Contest(*counted, {"1 s": truth_of}, 5, laid_out, **changes)


def rows_of_contest(pair, seed=0, systems=()):
    return list(rivals.measure(Draw(pair, seed, seed == 0, systems)))


def test_every_row_is_judged_on_the_same_windows_and_has_all_columns(monkeypatch):
    judged = []
    evaluate = rivals.evaluate
    monkeypatch.setattr(
        rivals, "evaluate", lambda m, t: judged.append(evaluate(m, t)) or judged[-1]
    )
    rows = rows_of_contest(contest(), systems=("all-pixels@1,3",))
    # sequences of 20 match the windows from 9 to 29
    assert {found.queries for found in judged} == {40 - rivals.LONGEST + 1}
    assert len({tuple(row) for row in rows}) == 1
    systems = {row["system"] for row in rows}
    for name in (rivals.OURS, "all pixels, SAD", "all pixels, SAD, windows 1, 3"):
        ways = [row["matching"] for row in rows if row["system"] == name]
        assert ways == [
            "sequences of 5", "sequences of 10", "sequences of 20", "place filter, live",
            "place filter, 4 windows late", "place filter, recorded",
        ]  # fmt: skip
    assert sum(name.startswith("null") for name in systems) == 5
    assert rivals.figure([{"drives": "d", **row} for row in rows]).axes[0].get_title() == "d"


def test_the_same_drive_is_found_and_one_that_shows_nothing_is_not():
    rows = rows_of_contest(contest())
    right = {(row["system"], row["matching"]): row["P@100R"] for row in rows}
    assert right[rivals.OURS, "place filter, live"] == 1
    assert right["all pixels, SAD", "place filter, recorded"] == 1
    # the drives take equally long: a path at the usual pace is partly correct
    assert right["null: windows shuffled", "place filter, recorded"] < 0.6
    assert right["null: query reversed", "place filter, recorded"] < 0.3
    assert right[rivals.CONSTANT_SPEED, "none"] == 1


def test_the_first_right_match_is_given_with_the_last_window_that_it_needs():
    rows = {
        row["matching"]: row
        for row in rows_of_contest(contest())
        if row["system"] == "all pixels, SAD"
    }
    for matching, seconds in (
        ("sequences of 5", 5), ("sequences of 10", 10), ("place filter, live", 1),
        ("place filter, 4 windows late", 5),
    ):  # fmt: skip
        assert rows[matching]["first right match (s)"] == seconds, matching
        assert rows[matching]["starts with a right match"] == 1
    assert rows["place filter, recorded"]["first right match (s)"] is None


def test_later_draws_leave_out_what_draws_nothing():
    systems = {row["system"] for row in rows_of_contest(contest(), seed=1)}
    assert "all pixels, SAD" not in systems and rivals.OURS in systems


def test_of_some_published_pixels_no_images_are_made():
    systems = {row["system"] for row in rows_of_contest(contest(laid_out=False))}
    assert not any("HOG" in name or "patch" in name for name in systems)
    assert "released code: the given pixels, clipped at 10, SAD" in systems


def test_the_default_among_rivals_is_the_default_of_a_map():
    """The row's matches are those of `ReferenceMap.match` on the same windows."""
    pair = contest()
    (ours, *_) = rivals.our_systems(pair, 0)
    windows = [ShiftedWindows(drive.images, TAU) for drive in (pair.reference, pair.query)]
    settings = PRESETS["default"].replaced({"seed": 0, "precision": 0.99}, "test")
    chosen = SelectedPixels("default", settings)
    chosen.prepare(pair.reference.images)
    mapped = ReferenceMap.build(windows[0], settings, pixel_map=chosen.pixel_map)
    for name, changes in (
        ("place filter, recorded", {}), ("place filter, live", {"smooth": False}),
        ("place filter, 4 windows late", {"smooth": False, "delay": 4}),
    ):  # fmt: skip
        live = {"query_mean": "running"} if changes else {}
        expected = mapped.match(windows[1], **changes, **live).matches
        found = ours.match(rivals.decoders(5)[name].settings, 0, 40)
        assert np.array_equal(found.place, expected.place), name
        assert np.array_equal(found.trust, expected.trust), name
        assert np.array_equal(found.lost, expected.lost), name


def test_the_filter_takes_given_distances_as_it_takes_those_of_codes():
    """The largest distance has 12 bits, so that all are taken as they are."""
    rng = np.random.default_rng(4)
    counts = rng.integers(0, 256, (2, 30, 12), dtype=np.uint8)
    counts[0, 3], counts[1, 5] = 255, 0
    places, queries = (
        Descriptors(each, start, start + TAU, each.sum(axis=1, dtype=np.int64))
        for each in counts
        for start in [np.arange(30) * TAU]
    )
    distances = ReferenceIndex(places.counts).matrix(queries.counts)
    assert distances.max() == 12 * 255
    for smooth, delay in ((True, 0), (False, 0), (False, 4)):
        changes = {"smooth": smooth, "delay": delay, "precision": 0.99}
        settings = PRESETS["default"].replaced(changes, "test")
        expected = match_descriptors(places, queries, settings)
        activity = places.activity, queries.activity
        found = filter_distances(distances.astype(float), activity, queries.centre_us, settings)
        assert np.array_equal(found.place, expected.place)
        assert np.array_equal(found.trust, expected.trust)
        assert np.array_equal(found.lost, expected.lost)


def test_a_simulated_street_is_counted_by_events():
    pair = counted_pairs.simulated_pair(1, length_m=20, sensor="tiny")
    totals = pair.reference.images.sum(axis=(1, 2))
    assert len(pair.reference.images) >= 2 and len(pair.query.images) >= 2
    # hot pixels were taken out after the windows were counted
    assert totals.min() > 0.5 * totals.max()
    settings = pair.settings.replaced({"sequence_length": 1}, "test")
    names = ("all-pixels", "active-pixels")
    systems = [(name, open_baseline(name)) for name in names]
    found = rivals.compare_systems(replace(pair, settings=settings), systems)
    assert [row["system"] for row in found] == list(names)


def test_a_curve_of_trials_is_the_mean_of_their_precision():
    """One trial is right in all matches, the other's surest of two is wrong; one finds nothing."""
    right = np.array([True, True])
    curves = [
        precision_recall(np.array([0.1, 0.2]), correct, right)
        for correct in (right, np.array([False, True]), ~right)
    ]
    found = mean_precision(curves, np.array([0.0, 0.5, 1.0]))
    # at recall 0 the strictest threshold: 1, 0 and 0; then 1, 1/2 and never
    assert found == pytest.approx([1 / 3, 0.5, 0.5])


def test_a_system_that_does_not_fit_a_sensor_is_left_out():
    """The released code draws 100 pixels, each 7 pixels apart."""
    images = [ShiftedWindows(drive[:, :32, :32], TAU) for drive in drives()]
    pair = counted_pairs.count_pair("drives", *images, SETTINGS, truth_of)
    names = ("seed-code", "all-pixels")
    systems = [(name, open_baseline(name)) for name in names]
    (row,) = rivals.compare_systems(pair, systems)
    assert row["system"] == "all-pixels" and row["P@100R"] == 1
    assert row["bytes per place"] == 32 * 32 and row["operations per query"] == 20 * 32 * 32


def test_an_image_is_shifted_and_what_leaves_is_lost():
    image = np.arange(12).reshape(3, 4)
    moved = shifted(image, 1, -2)
    assert moved.tolist() == [[0, 8, 9, 10], [0, 0, 0, 0], [0, 0, 0, 0]]
    assert np.array_equal(shifted(image, 0, 0), image)


def test_the_mount_shift_is_undone(monkeypatch):
    reference, query = (ShiftedWindows(images, TAU) for images in drives())
    pair = Pair("drives", reference, query, SETTINGS, truth_of)
    monkeypatch.setattr(mount_shift, "SHIFTS", (0, 4))
    rows = list(mount_shift.measure(Draw(pair, 0, True)))
    right = {(row["way"], row["shift"]): row["P@100R"] for row in rows}
    assert right["counts, registered", 0] == right["counts, registered", 4] == 1
    # the places of the drives are patterns of 4 x 4 pixels: a shift by 4 shows other pixels
    assert right["all pixels, counts", 0] == 1 > right["all pixels, counts", 4]
    assert right["all pixels, 3-bit logarithms", 0] == 1
    assert {row["way"] for row in rows if mount_shift.OFF in row} == {
        way.name for way in mount_shift.WAYS if way.registered
    }


def test_the_number_of_pixels_is_varied_and_what_does_not_fit_is_left_out(monkeypatch):
    pair = counted_pairs.count_pair(
        "drives", *(ShiftedWindows(images, TAU) for images in drives()), SETTINGS, truth_of
    )
    monkeypatch.setattr(pixel_number, "NUMBERS", (5, 150))
    rows = list(pixel_number.measure(Draw(pair, 0, True)))
    numbers = {
        name: {row["pixels"] for row in rows if row["pixels chosen by"] == name}
        for name in (*pixel_number.STRATEGIES, pixel_number.ALL)
    }
    assert numbers["variance"] == {5, 150} and numbers[pixel_number.ALL] == {96 * 96}
    assert numbers["mean (released code)"] == {5}  # 150 circles of 7 pixels do not fit
    assert len(pixel_number.EXPERIMENT.figure([{"drives": "d", **row} for row in rows]).axes) == 2


def test_few_pixels_are_compared_with_all(monkeypatch):
    pair = counted_pairs.count_pair(
        "drives", *(ShiftedWindows(images, TAU) for images in drives()), SETTINGS, truth_of
    )
    monkeypatch.setattr(agreement, "NUMBERS", (25, 150))
    rows = list(agreement.measure(Draw(pair, 0, True)))
    # the pixels stand for blocks of 4 x 4, so that every match is the same
    assert [row[agreement.PLACES] for row in rows] == [1.0] * 4
    assert all(0 < row[agreement.DISTANCES] < 1 for row in rows)
    street = list(agreement.measure(Draw(agreement.street(0, 40, "tiny"), 0, True)))
    assert all(-1 <= row[agreement.PROFILE] <= 1 for row in street)
    figure = agreement.figure([{"drives": "d", **row} for row in rows])
    assert len(figure.axes[0].containers) == 2 * len(agreement.MEASURES)


def test_all_pixels_agree_with_themselves_and_not_with_noise():
    images, _ = drives(12)
    rng = np.random.default_rng(1)
    noise = rng.permutation(images.ravel()).reshape(images.shape)
    every = images.mean(axis=(1, 2))
    assert agreement.correlation(every, 3 * every + 1) == pytest.approx(1)
    assert agreement.correlation(every, -every) == pytest.approx(-1)
    assert agreement.correlation(every, np.ones(12)) == 0
    found = agreement.correlation(images.astype(float), noise.astype(float))
    assert found == pytest.approx(np.corrcoef(images.ravel(), noise.ravel())[0, 1])


def test_what_fires_by_the_clock_makes_fewer_events_in_a_faster_drive():
    """With much noise, four times the speed makes fewer events; without any, it does not."""
    noisy = replace(CAMERAS["tiny"], noise_hz=20.0)
    quiet = replace(noisy, noise_hz=0.0, hot_pixels=0, bursts_per_minute=0.0)
    still = {"traffic_per_km": 0.0, "shake_px": 0.0}
    slow, fast = (event_speed.events_of(noisy, still, v, 1, 20.0) for v in (3.0, 12.0))
    assert fast < 0.6 * slow
    slow, fast = (event_speed.events_of(quiet, still, v, 1, 20.0) for v in (3.0, 12.0))
    assert fast > 0.9 * slow


def test_windows_and_sequences_of_equal_time_are_compared(monkeypatch):
    tried = window_length.variant(0.5, 8.0).changes
    assert tried == {"tau_us": 500_000, "sequence_length": 16, "exclusion": 6}
    short = partial(simulate_pair, sensor="tiny", length_m=80.0)
    monkeypatch.setattr(counted_pairs, "simulate_pair", short)
    monkeypatch.setattr(window_length, "WINDOWS_S", (0.5, 1.0))
    monkeypatch.setattr(window_length, "SPANS_S", (2.0,))
    few = PRESETS["paper"].replaced({"pixels": 25}, "test")
    monkeypatch.setattr(window_length, "PRESETS", {"paper": few})
    rows = rows_of(window_length.EXPERIMENT, None, 1)
    assert [(row["window (s)"], row["match (s)"]) for row in rows] == [("0.5", "2"), ("1", "2")]
    assert window_length.figure(rows).axes[0].get_xticks().tolist() == [0.5, 1.0]
