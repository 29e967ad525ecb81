"""Odometry: its files, what a window has of them, and what it brings."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from edge_vpr_tools.commands.replay import RecordedInputs
from edge_vpr_tools.estimate.of_map import design_of
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.errors import EdgeVprWarning, GroundTruthError, MapError, UsageError
from edge_vpr.evaluation.tables import load_odometry
from edge_vpr.evaluation.tracks import Track
from edge_vpr.events import Sensor
from edge_vpr.match_result import MatchResult
from edge_vpr.matching.drive import match_descriptors, query_distances
from edge_vpr.matching.place_filter import PlaceFilter
from edge_vpr.matching.prediction import TransitionCosts, Transitions
from edge_vpr.odometry import MOST_MM, Odometry
from edge_vpr.recordings import write_recording
from edge_vpr.results import read_run
from edge_vpr.route import Route
from edge_vpr.settings import Settings
from edge_vpr.simulation.drive import wheel_odometry
from firmware_model.specification_drive import anchored
from tests.online.test_localiser import PIXEL_MAP, PIXELS
from tests.streams import descriptors, map_of_counts, random_events


def write(folder, text, name="file.csv"):
    (folder / name).write_text(text)
    return folder / name


def test_a_table_in_memory_is_the_odometry_of_its_file(tmp_path):
    table = {"time_s": [0, 0.1, 2], "distance_m": [1, 1.0015, -3]}
    odometry = load_odometry(table)
    expected = load_odometry(write(tmp_path, "time_s,distance_m\n0,1\n0.1,1.0015\n2,-3\n"))
    assert odometry.time_us.tolist() == expected.time_us.tolist() == [0, 100_000, 2_000_000]
    assert odometry.distance_mm.tolist() == expected.distance_mm.tolist() == [1000, 1002, -3000]
    with pytest.raises(GroundTruthError, match=r"^the odometry data has the header 'time_s,x_m'"):
        load_odometry({"time_s": [0, 1], "x_m": [0, 1]})


def test_a_table_of_speed_is_integrated_by_the_mean_of_two_rows(tmp_path):
    odometry = load_odometry(write(tmp_path, "time_s,speed_mps\n0,0\n1,2\n3,2\n4,-2\n"))
    assert odometry.distance_mm.tolist() == [0, 1000, 5000, 5000]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,way\n0,1\n", "expected time_s,distance_m, time_s,position_m or time_s,speed_mps"),
        ("time_s,distance_m\n0,1\n0,2\n", "reading 2 is not later than the one before"),
        ("time_s,distance_m\n1e20,1\n", "give seconds from the recording's start"),
        ("time_s,distance_m\n0,1e12\n", "distances up to 1e\\+12 m"),
        ("time_s,distance_m\n0,1e308\n", "distances up to 1e\\+308 m"),
        ("time_s,distance_m\n1e308,1\n", "times up to 1e\\+308 s"),
        ("time_s,speed_mps\n0,1e300\n1e9,1e300\n", "has distances up to"),
        ("time_s,speed_mps\n0,x\n", "row 1 has 'x' in speed_mps"),
    ],
)
def test_a_table_that_is_no_odometry_is_refused(tmp_path, text, message):
    with pytest.raises(GroundTruthError, match=message):
        load_odometry(write(tmp_path, text))
    with pytest.raises(GroundTruthError, match="is not odometry"):
        load_odometry(write(tmp_path, text, "file.txt"))


def test_a_log_of_a_stream_has_the_readings_of_its_drive(tmp_path):
    rows = [
        {"kind": "route", "places": 3},
        {"kind": "odometry", "time_s": 0.0, "distance_m": 7.0},
        {"kind": "odometry", "time_s": 0.0, "distance_m": 7.5},  # before the first event
        {"kind": "odometer", "text": 'no "odometry"'},
        {"kind": "odometry", "time_s": 0.25, "distance_m": 8.125},
    ]
    log = write(tmp_path, "".join(f"{json.dumps(row)}\n" for row in rows), "run.jsonl")
    odometry = load_odometry(log)
    assert odometry.time_us.tolist() == [0, 250_000]
    assert odometry.distance_mm.tolist() == [7500, 8125]
    with pytest.raises(GroundTruthError, match=r"has no readings .* stream --odometry$"):
        load_odometry(write(tmp_path, '{"kind": "health"}\n', "run.jsonl"))
    for text in ('{"kind": "odometry", "time_s"', '{"kind": "odometry"}', '["odometry"]'):
        with pytest.raises(GroundTruthError, match=r"line 1 is not a line of .* --log: leave it"):
            load_odometry(write(tmp_path, f"{text}\n", "run.jsonl"))
    with pytest.raises(GroundTruthError, match="times up to nan s"):
        text = '{"kind": "odometry", "time_s": NaN, "distance_m": 1}\n'
        load_odometry(write(tmp_path, text, "run.jsonl"))


def test_leaps_of_an_odometer_that_starts_again_add_nothing_and_are_named(tmp_path):
    rows = [f"{t},{t * 7 % 300 + 5}" for t in range(100)]
    path = write(tmp_path, "\n".join(["time_s,distance_m", *rows]) + "\n")
    with pytest.warns(
        EdgeVprWarning, match=r"leaps by -293\.0 m at 43 s and 1 times more, as an od"
    ):
        odometry = load_odometry(path)
    steps = np.diff(odometry.distance_mm)
    assert odometry.distance_mm[0] == 5000
    assert np.flatnonzero(steps != 7000).tolist() == [42, 85]
    assert steps[[42, 85]].tolist() == [0, 0]


def test_an_odometer_that_says_more_than_any_robot_drives_is_refused(tmp_path):
    rows = [f"{t / 10},{t * 633}" for t in range(100)]  # millimetres
    path = write(tmp_path, "\n".join(["time_s,distance_m", *rows]) + "\n")
    with pytest.raises(GroundTruthError, match=r"says 6,330 m/s in the median: give metres, not"):
        load_odometry(path)


def test_the_way_of_a_window_lies_between_its_last_reading_and_that_of_the_window_before():
    odometry = Odometry(np.array([5, 9, 10, 25, 41, 52]), np.array([1, 2, 4, 8, 16, 32]))
    travelled, driven = odometry.of_windows(np.array([10, 20, 30, 40, 50, 60]))
    # a reading at 10 is in the window that begins there; the fourth window has none
    assert travelled == [None, 2, 4, None, None, 16]
    assert driven == [0, 2, 4, 0, 0, 16]


@given(seed=st.integers(0, 2**32), spacing=st.integers(1, 20))
def test_what_counts_of_a_drive_is_what_the_oracle_says(seed, spacing):
    rng = np.random.default_rng(seed)
    read = np.flatnonzero(rng.random(30) < 0.9)
    odometry = Odometry(read * 10 + 5, np.cumsum(rng.integers(-6, 13, read.size)))
    travelled, every = odometry.of_windows(np.arange(10, 310, 10), spacing)
    shown = dict(zip(read.tolist(), odometry.distance_mm.tolist(), strict=True))
    both = [j in shown and j - 1 in shown for j in range(30)]
    driven = [shown[j] - shown[j - 1] if both[j] else None for j in range(30)]
    assert travelled == anchored(driven, spacing)
    assert every == [mm or 0 for mm in driven]


@pytest.mark.parametrize(
    ("time_us", "distance_mm", "message"),
    [
        ([], [], "without a reading"),
        ([1, 1], [0, 0], "reading 2 is not later"),
        ([1], [1 << 50], "distance_mm reaches"),
        ([1, 2], [0], "one value a reading"),
    ],
)
def test_readings_that_cannot_be_are_refused(time_us, distance_mm, message):
    with pytest.raises(UsageError, match=message):
        Odometry(np.array(time_us, dtype=np.int64), np.array(distance_mm, dtype=np.int64))


def map_of_places(counts, **changes):
    settings = Settings(pixels=len(PIXELS), matching="filter", **changes)
    return map_of_counts(PIXEL_MAP, counts, settings)


def test_places_that_look_alike_are_told_apart_by_the_way():
    """A corridor of equal doors: one view in five is of its own, all others are the same."""
    rng = np.random.default_rng(0)
    counts = np.full((40, len(PIXELS)), 20)
    counts[::8] = rng.integers(0, 60, (5, len(PIXELS)))
    path = np.array([8, 8, 8, 9, 11, 13, 15, 15, 15, 15, 14, 13, 12])
    queries, along = descriptors(counts[path]), np.arange(40, dtype=np.int64) * 2_000
    settings = Settings(pixels=len(PIXELS), matching="filter")
    places = descriptors(counts)
    # read in the middle of each window of a millisecond
    times = np.arange(len(path), dtype=np.int64) * 1_000 + 500
    odometry = Odometry(times, path * 2_000)
    matched = match_descriptors(places, queries, settings, along_mm=along, odometry=odometry)
    assert matched.place.tolist() == path.tolist()
    assert match_descriptors(places, queries, settings).place.tolist() != path.tolist()


def test_a_robot_at_a_quarter_of_the_speed_of_the_map_moves_on_among_places_that_look_alike():
    rng = np.random.default_rng(0)
    counts = np.full((40, len(PIXELS)), 20)
    counts[8] = rng.integers(0, 60, len(PIXELS))
    path = np.repeat(np.arange(8, 30), 4)
    settings = Settings(pixels=len(PIXELS), matching="filter", smooth=False)
    times = np.arange(path.size, dtype=np.int64) * 1_000 + 500
    matched = match_descriptors(
        descriptors(counts), descriptors(counts[path]), settings,
        along_mm=np.arange(40, dtype=np.int64) * 2_000,
        odometry=Odometry(times, np.arange(path.size, dtype=np.int64) * 500),
    )  # fmt: skip
    assert (np.abs(matched.place - path) <= 1).mean() > 0.9


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"odometer_mm": np.arange(4)[::-1].copy()}, "falls from place to place"),
        ({"odometer_mm": np.arange(3)}, "the distance driven is int64 of shape"),
        ({"odometer_mm": np.array([0, 1, 2, 1 << 60])}, "the distance driven holds 0 to"),
    ],
)
def test_ways_that_the_map_cannot_have_are_refused(changes, message):
    reference = map_of_places(np.ones((4, len(PIXELS)), dtype=np.int64))
    with pytest.raises(MapError, match=message):
        replace(reference, **changes)


def test_without_odometry_the_way_is_that_of_the_track():
    reference = map_of_places(np.ones((5, len(PIXELS)), dtype=np.int64))
    assert reference.along_mm is None
    along = np.array([np.nan, 0.0, np.nan, 4.0, np.nan])
    routed = replace(reference, route=Route(along[:, None], along))
    assert routed.along_mm.tolist() == [0, 0, 2000, 4000, 4000]
    metered = replace(routed, odometer_mm=np.arange(5) * 7)
    assert metered.along_mm.tolist() == [0, 7, 14, 21, 28]


def test_a_map_without_distances_refuses_odometry():
    with pytest.raises(UsageError, match="make it with the reference drive's odometry="):
        Transitions(3, TransitionCosts()).by_distance(np.zeros(3, dtype=np.int32), 5)
    with pytest.raises(MapError, match=r"the distance driven is int64 of shape \(2,\)"):
        Transitions(3, TransitionCosts(), along_mm=np.arange(2))


def test_a_device_has_places_at_half_windows(tmp_path, run):
    counts = np.ones((8, len(PIXELS)), dtype=np.int64)
    half = map_of_places(counts, places_per_window=2, counter_code="contrast")
    design = design_of(half)
    assert (design.places, design.exclusion, design.places_per_window) == (8, 6, 2)
    half.save(tmp_path / "half.npz")
    shown = run("estimate", "--map", tmp_path / "half.npz", "--target", "cortex-m4").out
    assert "place filter, places at half windows" in " ".join(shown.split())


def test_a_simulated_wheel_is_a_few_percent_off():
    times = np.arange(0, 100_000_001, 20_000, dtype=np.int64)
    track = Track(times, (times / 1e6 * 6)[:, None])
    lengths = [
        wheel_odometry(track, np.random.default_rng(seed)).distance_mm[-1] / 600_000
        for seed in range(30)
    ]
    assert 0.005 < np.std(lengths) < 0.04 and abs(np.mean(lengths) - 1) < 0.02


def test_sequences_take_no_odometry():
    places = descriptors(np.ones((4, len(PIXELS)), dtype=np.int64))
    by_sequence = Settings(pixels=len(PIXELS), sequence_length=1)
    odometry = Odometry(np.array([1]), np.array([1]))
    with pytest.raises(UsageError, match="odometry is for the place filter"):
        match_descriptors(places, places, by_sequence, odometry=odometry)


@pytest.mark.parametrize("online", [(), ("--online", "--every", "window")])
def test_readings_at_other_times_than_the_drive_are_refused(tmp_path, run, online):
    """Such as times since 1970, which no place and no window would meet.

    Of the others, metres beside those of the route show the unit and the sign, also where no match
    is accepted.
    """
    events = random_events(np.random.default_rng(0), 6_000, Sensor(16, 12), 3_000_000)
    write_recording(tmp_path / "drive.npz", [events], sensor=Sensor(16, 12))
    small = ["--pixels", "20", "--sigma", "1", "--tau", "100ms"]

    def said(*words, fails=False):
        return "".join(run(*words, "--overwrite", code=2 if fails else 0))

    drive, route = tmp_path / "drive.npz", tmp_path / "map.npz"
    rows = {"good": "0,0\n3,30", "half": "0,0\n1.6,30", "short": "0,0\n1.4,30"}
    rows |= {"unix": "1795559873,0\n1795559876,30", "backwards": "0,30\n3,0", "feet": "0,0\n3,98"}
    files = {
        name: write(tmp_path, f"time_s,distance_m\n{each}\n", f"{name}.csv")
        for name, each in rows.items()
    }
    for name in ("unix", "backwards", "half", "feet", "good"):
        text = said("map", drive, "-o", route, *small, "--odometry", files[name])
        assert ("does not move forward by" in text) == (name in ("unix", "backwards"))
    command = ["match", route, drive, "-o", tmp_path / "out", "--no-figures", *online, "--odometry"]
    ratios = {"good": 1.0, "half": 1.0, "short": 1.0, "backwards": -1.0, "feet": 3.3}
    for name in files:
        text = said(*command, files[name], "--precision", "0.99", fails=name == "unix")
        assert ("give times in seconds from the recording's" in text) == (name == "unix")
        shown = re.search(
            r"odometry: readings at \d+ of \d+ matches; -?\d+\.\d m by the odometer, "
            r"route length \d\d\.\d m \(ratio (.+)\)\n", text,
        )  # fmt: skip
        assert name == "unix" or float(shown[1]) == pytest.approx(ratios[name], rel=0.1)
    # times count from where the part begins: this log ends before
    text = said(*command, files["short"], "--start", 2, fails=True)
    assert "the drive has no match there" in text


def test_distances_of_a_part_are_those_that_it_was_matched_by(tmp_path, run):
    """Of ``--matrix`` and of a film, by the odometry from where the part begins."""
    drive, query, route, out = (tmp_path / name for name in ("a.npz", "b.npz", "map.npz", "out"))
    for seed, path in enumerate((drive, query)):  # unlike each other, so that all places are near
        events = random_events(np.random.default_rng(seed), 6_000, Sensor(16, 12), 3_000_000)
        write_recording(path, [events], sensor=Sensor(16, 12))
    rows = "".join(f"{n / 20},{n * n / 100}\n" for n in range(61))
    log = write(tmp_path, f"time_s,distance_m\n{rows}", "log.csv")
    small = ["--pixels", "20", "--sigma", "1", "--tau", "100ms"]
    run("map", drive, "-o", route, *small, "--odometry", log)
    words = ["--odometry", log, "--start", 1, "--no-figures", "--matrix", tmp_path / "part.npy"]
    run("match", route, query, "-o", out, *words)
    result, inputs = MatchResult.load(out), RecordedInputs(out, read_run(out))
    matched = result.reference.matched_with(result.matches.settings)
    shown = query_distances(matched, result.queries, inputs.odometry())
    assert np.array_equal(shown, np.load(tmp_path / "part.npy"))
    assert np.array_equal(shown.min(axis=0), result.matches.distance)


def test_evidence_counts_by_the_distance_driven():
    """A robot that stands by its odometer sees again what it saw, and learns nothing from it."""
    along = np.arange(6, dtype=np.int64) * 1_000
    for per_window in (1, 2):
        costs = TransitionCosts(places_per_window=per_window)
        transitions = Transitions(6, costs, along_mm=along)
        window = 1_000 * per_window
        weights = [
            transitions.weight_by_distance(mm) for mm in (0, 1, -window // 4, window, MOST_MM)
        ]
        assert weights == [0, 1, 2, 8, 8]
    place_filter = PlaceFilter(transitions)
    rng = np.random.default_rng(0)
    place_filter.update(rng.integers(0, 99, 6), 50)
    before = place_filter.state.metric - place_filter.state.metric.min()
    for _ in range(9):
        place_filter.predict_travelled(0, 0)
        place_filter.update(rng.integers(0, 99, 6), 50)
    # places that are cheap may still be moved from, to others
    assert (place_filter.state.metric <= before).all()
    assert place_filter.state.metric.argmin() == before.argmin()
