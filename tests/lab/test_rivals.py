"""The experiments on rivals and on a moved mounting, on small drives."""

from __future__ import annotations

import csv
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from lab import nulls
from lab.__main__ import main
from lab.baselines import filter_distances
from lab.baselines.selected_pixels import SelectedPixels
from lab.experiments import mount_shift, pixel_number, place_filter, rivals, sensitivity
from lab.experiments.mount_shift import CountedWindows, shifted
from lab.loop import Draw, Drives
from lab.pairs import INNER, CountedDrive, CountedPair, Kept, Pair

from edge_vpr.confidence import Acceptance
from edge_vpr.descriptors.activity import activity_of_drive, place_activity
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.ground_truth import Alignment, from_alignment
from edge_vpr.events import Sensor
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.drive import match_by_filter
from edge_vpr.matching.place_filter import PATIENCE, PATIENCE_SMOOTHED, PlaceFilter
from edge_vpr.matching.prediction import TransitionCosts, Transitions
from edge_vpr.recordings import open_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from tests.lab.test_network_baselines import onnx_model

TAU = 1_000_000
SETTINGS = PRESETS["paper"].replaced({"sequence_length": 2, "sigma": 2.0, "pixels": 150}, "test")


def truth_of(places_us, queries_us):
    ends = Alignment([[0, 0], [100, 100]], "s")
    return from_alignment(ends, places_us, queries_us, 1.0)


TRUTHS = {"1 s": truth_of}


def drives(windows=20):
    """The same drive twice, the second with a tenth of its events gone."""
    rng = np.random.default_rng(0)
    rough = rng.gamma(0.6, 6.0, (windows, 24, 24))
    images = rng.poisson(rough.repeat(4, axis=1).repeat(4, axis=2)).astype(np.uint16)
    return images, rng.binomial(images, 0.9).astype(np.uint16)


def contest(laid_out=True, truths=TRUTHS, **changes):
    images = drives(40)
    centre_us = np.arange(40) * TAU + TAU // 2
    counted = [CountedDrive(each[:, ::2, ::2], centre_us) for each in images]
    settings = SETTINGS.replaced({"sequence_length": 5}, "test")
    return CountedPair("drives", *counted, settings, truths, laid_out, **changes)


def rows_of_contest(pair, systems=()):
    return list(rivals.measure(Draw(pair, 0, True, systems)))


@pytest.fixture(scope="module")
def contested():
    return rows_of_contest(contest())


def wrong_at_first(places_us, queries_us):
    """Truth of which the first window has no part."""
    truth = truth_of(places_us, queries_us)
    truth.correct[:, 0] = False
    return truth


def test_every_row_is_judged_on_all_its_windows_and_on_those_of_every_row():
    # one that is compared anyway has its rows once
    pair = contest(truths={"1 s": wrong_at_first})
    rows = rows_of_contest(pair, systems=("all-pixels@1,3", "all-pixels"))
    shares = {row["matching"]: (row["P@100R"], row[INNER]) for row in rows
              if row["system"] == rivals.OURS}  # fmt: skip
    # the filter matches all 40 windows, sequences of 20 those from 9 to 29
    assert shares["place filter, live"] == shares["place filter, recorded"] == (39 / 40, 1)
    assert shares["sequences of 20"] == (1, 1)
    assert len({tuple(row) for row in rows}) == 1
    systems = {row["system"] for row in rows}
    for name in (rivals.OURS, "all-pixels, SAD", "all-pixels, SAD, windows 1, 3"):
        ways = [row["matching"] for row in rows if row["system"] == name]
        assert ways == [
            "single windows", "sequences of 5", "sequences of 10", "sequences of 20",
            "place filter, live", "place filter, recorded",
        ]  # fmt: skip
    assert sum(name.startswith("null") for name in systems) == 5
    drawing = rivals.figure([{"drives": "d", **row} for row in rows])
    named = [label.get_text() for label in drawing.axes[0].get_yticklabels()]
    assert len(drawing.axes) == 1 and set(named) == {n for n in systems if n[:4] != "null"}


def test_the_same_drive_is_found_and_one_that_shows_nothing_is_not(contested):
    right = {(row["system"], row["matching"]): row["P@100R"] for row in contested}
    assert right[rivals.OURS, "place filter, live"] == 1
    assert right["all-pixels, SAD", "place filter, recorded"] == 1
    # the drives take equally long: a path at the usual pace is partly correct
    assert right["null: windows shuffled", "place filter, recorded"] < 0.6
    assert right["null: query reversed", "place filter, recorded"] < 0.3
    assert right[rivals.CONSTANT_SPEED, "none"] == 1


def test_the_first_right_match_is_given_with_the_last_window_that_it_needs(contested):
    rows = {row["matching"]: row for row in contested if row["system"] == "all-pixels, SAD"}
    for matching, seconds in (
        ("sequences of 5", 5),
        ("sequences of 10", 10),
        ("place filter, live", 1),
    ):
        assert rows[matching]["first right match (s)"] == seconds, matching
        assert rows[matching]["starts with a right match"] == 1
    assert rows["place filter, recorded"]["first right match (s)"] is None


def test_a_network_of_a_file_is_compared_by_the_command(tmp_path, capsys, monkeypatch):
    """A network of random weights: every row of a rival, in the file and printed."""
    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra lab)")
    weights = np.random.default_rng(5).normal(size=(256, 32)).astype(np.float32)
    path = onnx_model(tmp_path / "random.onnx", weights, ["n", 1, 16, 16])
    drives = Drives("the same drive", lambda seed: contest(), drawn=False)
    monkeypatch.setattr(
        rivals, "EXPERIMENT", replace(rivals.EXPERIMENT, drives=lambda data: [drives])
    )
    monkeypatch.setattr(rivals, "baseline_names", list)
    monkeypatch.setattr("lab.__main__.processes", lambda count: ThreadPoolExecutor(1))
    assert main(["rivals", "--with", f"model:{path}", "-o", str(tmp_path)]) == 0
    assert "| random, cosine | place filter, recorded | 1 s | its authors; filter:" in (
        capsys.readouterr().out
    )
    with (tmp_path / "rivals.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["system"] == "random, cosine"]
    assert [row["matching"] for row in rows] == list(rivals.decoders(5))
    for row in rows:
        assert row["bytes per place"] == "128" and float(row["time per query (us)"]) > 0
        assert float(row["P@100R"]) == 1, row["matching"]


def test_some_published_pixels_are_laid_out_for_systems_that_compare_neighbours():
    pair = contest(laid_out=False)
    rows = rows_of_contest(pair)
    systems = {row["system"] for row in rows}
    assert "seed-code: the given pixels, clipped at 10, SAD" in systems
    assert not any(name.startswith("paper") for name in systems)
    # in any order, and among pixels without events, if their places on the sensor are known
    size = pair.reference.images.shape[1:]
    order = np.random.default_rng(3).permutation(np.prod(size))
    y, x = np.unravel_index(order, size)
    published = PixelMap(Sensor(size[1] + 1, size[0]), x, y)
    listed = [replace(drive, images=drive.images[:, None, y, x], published=published)
              for drive in (pair.reference, pair.query)]  # fmt: skip
    padded = [replace(drive, images=np.pad(drive.images, ((0, 0), (0, 0), (0, 1))))
              for drive in (pair.reference, pair.query)]  # fmt: skip
    measured, expected = (
        {(row["system"], row["matching"]): (row["R@99P"], row["bytes per place"])
         for row in rows_of_contest(
             replace(pair, reference=first, query=second), systems=("patch-normalised@1,2",))
         if "patch" in row["system"] or "hog" in row["system"]}
        for first, second in (listed, padded)
    )  # fmt: skip
    # one that the user adds gets the same images as ours
    assert len(measured) == 3 * len(rivals.decoders(5)) and measured == expected


def test_the_default_among_rivals_is_the_default_of_a_map():
    """The row's matches are those of `ReferenceMap.match` on the same windows."""
    pair = contest()
    (ours, *_) = rivals.our_systems(pair, 0)
    windows = [CountedWindows(drive.images, TAU) for drive in (pair.reference, pair.query)]
    settings = PRESETS["default"].replaced({"seed": 0, "precision": 0.99}, "test")
    chosen = SelectedPixels("default", settings)
    chosen.prepare(pair.reference.images)
    mapped = ReferenceMap.build(windows[0], settings, pixel_map=chosen.pixel_map)
    for name, changes in (
        ("place filter, recorded", {}),
        ("place filter, live", {"smooth": False}),
    ):
        expected = mapped.match(windows[1], **changes).matches
        matches = ours.match(rivals.decoders(5)[name].settings, slice(None))
        assert np.array_equal(matches.place, expected.place), name
        assert np.array_equal(matches.trust, expected.trust), name
        assert np.array_equal(matches.lost, expected.lost), name


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
    for smooth in (True, False):
        changes = {"smooth": smooth, "precision": 0.99, "gains": 1}
        settings = PRESETS["default"].replaced(changes, "test")
        activity = places.selected_events, queries.selected_events
        transitions = Transitions(30, TransitionCosts.of(settings), place_activity(activity[0]))
        patience = PATIENCE_SMOOTHED if smooth else PATIENCE
        place_filter = PlaceFilter(transitions, activity_of_drive(activity[0]), patience)
        expected = match_by_filter(
            place_filter, ReferenceIndex(places.counts), queries, settings, Acceptance.of(settings)
        )
        matches = filter_distances(distances.astype(float), activity, queries.centre_us, settings)
        assert np.array_equal(matches.place, expected.place)
        assert np.array_equal(matches.trust, expected.trust)
        assert np.array_equal(matches.lost, expected.lost)


@pytest.mark.parametrize("published", [True, False])
def test_counts_at_a_few_pixels_are_kept_where_all_others_never_fire(published):
    """Next to pixels without events, every other pixel would look hot."""
    images = [drive[:, ::8, ::8].repeat(8, axis=1).repeat(8, axis=2) for drive in drives()]
    few = np.zeros(images[0].shape[1:], dtype=np.bool_)
    few[::8, ::8] = True
    counted = [CountedWindows(np.where(few, drive, 0), TAU) for drive in images]
    for drive in counted if published else ():
        drive.counted = few
    pair = Pair("drives", *counted, SETTINGS, TRUTHS).counted()
    for drive, image in zip((pair.reference, pair.query), images, strict=True):
        np.testing.assert_array_equal(drive.images, np.where(few, image, 0))
    assert pair.laid_out is not published


def test_an_image_is_shifted_and_what_leaves_is_lost():
    image = np.arange(12).reshape(1, 3, 4)
    moved = shifted(image, 1, -2)
    assert moved.tolist() == [[[0, 8, 9, 10], [0, 0, 0, 0], [0, 0, 0, 0]]]
    assert np.array_equal(shifted(image, 0, 0), image)


def test_the_mount_shift_is_undone(monkeypatch):
    reference, query = (CountedWindows(images, TAU) for images in drives())
    pair = Pair("drives", reference, query, SETTINGS, TRUTHS)
    monkeypatch.setattr(mount_shift, "SHIFTS", (0, 4))
    rows = list(mount_shift.measure(Draw(pair, 0, True)))
    right = {(row["way"], row["shift"]): row["P@100R"] for row in rows}
    assert right["counts, registered", 0] == right["counts, registered", 4] == 1
    # the places of the drives are patterns of 4 x 4 pixels: a shift by 4 shows other pixels
    assert right["all pixels, counts", 0] == 1 > right["all pixels, counts", 4]
    assert right["all pixels, 3-bit logarithms", 0] == 1
    assert {row["way"] for row in rows if mount_shift.OFF in row} == {
        method.name for method in mount_shift.METHODS if method.registered
    }


def counted(windows=40):
    """A drive at few pixels, and the same drive with a tenth of its events gone."""
    images = drives(windows)
    pair = Pair("walk, 25 px", *(CountedWindows(each, TAU) for each in images), SETTINGS, TRUTHS)
    few = replace(pair, settings=SETTINGS.replaced({"pixels": 25}, "test"))
    return few, few.mapped(few.settings)


def test_the_filter_with_the_default_constants_is_the_default():
    """Other constants match otherwise."""
    _, drive = counted()
    robot = place_filter.DEFAULTS[place_filter.ROBOT]
    # a query that is hard enough for the constants to matter
    rng = np.random.default_rng(2)
    noisy = replace(drive.counted, counts=rng.permuted(drive.counted.counts, axis=1))
    drive = replace(drive, counted=noisy)
    places = sensitivity.match_with(drive, sensitivity.Constants())
    assert np.array_equal(places, drive.coded(robot).match().place)
    for constant in sensitivity.VARIED:
        other = sensitivity.match_with(drive, sensitivity.Constants(**{constant: 0.25}))
        assert not np.array_equal(other, places), constant
    restart = sensitivity.match_with(drive, sensitivity.Constants(restart=0.5))
    assert np.array_equal(restart, drive.coded({**robot, "filter_restart": 8}).match().place)


RESTART, TYPICAL = (sensitivity.SHOWN[name] for name in ("restart", "typical"))


def test_each_constant_is_varied_and_a_pair_is_left_out_of_the_choice():
    pair, _ = counted()
    rows = [
        {"drives": name, **row, "seed": 0}
        for name in ("walk, 25 px", "street, 25 px")
        for row in sensitivity.measure(Draw(pair, 0, True))
        for row in [{**row, "drives": name}]
    ]
    assert len(rows) == 2 * sum(map(len, sensitivity.VARIED.values()))
    assert len(sensitivity.figure(rows).axes) == 2
    # on the streets half the cost of a restart is best, on the walk half of the typical distance
    for row in rows:
        street = row["drives"].startswith("street")
        best = (RESTART, 0.5) if street else (TYPICAL, 0.5)
        setting = row["constant"], row["times the default"]
        row["P@100R"] = 0.9 if setting == best else 0.4 if setting[1] == 1 else 0.3
    left = sensitivity.left_out(rows)
    assert [(row["drives"], row["constant"], row["P@100R"]) for row in left] == [
        ("walk, 25 px", RESTART, 0.3), ("street, 25 px", TYPICAL, 0.3),
    ]  # fmt: skip
    assert {row["P@100R of the default"] for row in left} == {0.4}
    assert sensitivity.left_out([row for row in rows if row["drives"] == "walk, 25 px"]) == []


def test_every_variant_of_the_filter_is_judged_on_all_its_windows_and_on_the_same():
    pair, _ = counted()
    pair = replace(pair, truths={"1 s": wrong_at_first})
    rows = list(place_filter.measure(Draw(pair, 0, True)))
    shares = {row["method"]: (row["P@100R"], row.get(INNER)) for row in rows}
    assert {*place_filter.VARIANTS, *place_filter.DEFAULTS, nulls.CONSTANT_SPEED} < shares.keys()
    assert shares[place_filter.BEST] == (39 / 40, 1)
    assert shares["sequences of 10, own mean"] == (1, 1)
    assert shares["null: windows shuffled"][0] < 0.6


def test_what_shows_nothing_of_the_route_is_what_it_says():
    _, drive = counted()
    shown = dict(nulls.null_queries(drive.counted, np.random.default_rng(0)))
    counts = drive.counted.counts
    assert np.array_equal(shown["null: query reversed"].counts, counts[::-1])
    rows = sorted(map(tuple, counts.tolist()))
    assert sorted(map(tuple, shown["null: windows shuffled"].counts.tolist())) == rows
    columns = sorted(map(tuple, counts.T.tolist()))
    assert sorted(map(tuple, shown["null: pixels shuffled once"].counts.T.tolist())) == columns
    each = shown["null: pixels shuffled in each window"].counts
    assert np.array_equal(np.sort(each, axis=1), np.sort(counts, axis=1))
    assert not np.array_equal(each, counts)
    for one in shown.values():
        assert np.array_equal(one.start_us, drive.counted.start_us)
    # places 0 to 39 at a constant pace, of which three in a row are correct
    assert nulls.constant_speed(drive.truth) == 1
    late = replace(drive.truth, correct=np.roll(drive.truth.correct, 3, axis=0))
    assert nulls.constant_speed(late) == pytest.approx(1 / 40, abs=1 / 20)


def test_the_number_of_pixels_is_varied_and_what_does_not_fit_is_left_out(monkeypatch):
    images = (CountedWindows(each, TAU) for each in drives())
    pair = Pair("drives", *images, SETTINGS, TRUTHS).counted()
    monkeypatch.setattr(pixel_number, "NUMBERS", (5, 150))
    rows = list(pixel_number.measure(Draw(pair, 0, True)))
    numbers = {
        name: {row["pixels"] for row in rows if row["pixels chosen by"] == name}
        for name in (*pixel_number.STRATEGIES, pixel_number.ALL)
    }
    assert numbers["variance"] == {5, 150} and numbers[pixel_number.ALL] == {96 * 96}
    assert numbers["seed-code"] == {5}  # 150 circles of 7 pixels do not fit
    assert len(pixel_number.EXPERIMENT.figure([{"drives": "d", **row} for row in rows]).axes) == 2


def test_a_kept_recording_has_the_faults_of_its_first_pass(tmp_path):
    (tmp_path / "drive.csv").write_text("t,x,y,p\n1,0,0,1\n2,9,0,1\n3,1,0,1\n")
    kept = Kept(open_recording(tmp_path / "drive.csv", sensor=Sensor(2, 2), on_fault="drop"))
    assert [events["t"].tolist() for _ in range(2) for events in kept] == [[0, 2], [0, 2]]
    assert kept.faults.off_sensor == 1
