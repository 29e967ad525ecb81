"""The five things that always hold, as SECURITY.md says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from edge_vpr.errors import EdgeVprError
from edge_vpr.evaluation.ground_truth import from_tracks
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.evaluation.tracks import Track
from edge_vpr.events import Sensor
from edge_vpr.live.protocols import open_decoder, open_encoder
from edge_vpr.recordings import open_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair
from tests.streams import balanced, centres, random_events, split_events

S = 1_000_000
SENSOR = Sensor(64, 48)


def line(seconds, first=0, begin_m=0.0, metres=5.0):
    """A track of so many seconds, at 5 m/s."""
    at = np.arange(seconds + 1)
    return Track((first + at) * S, begin_m + metres * at[:, None].astype(float))


def test_security_lists_as_many_invariants_as_are_tested():
    text = (Path(__file__).parents[2] / "SECURITY.md").read_text()
    listed = re.findall(r"^(\d)\. ", text, re.MULTILINE)
    tested = [name[5] for name in globals() if re.match(r"test_\d_", name)]
    assert listed == tested == ["1", "2", "3", "4", "5"]


def test_1_a_time_never_runs_backwards_silently_and_events_off_the_sensor_are_never_used():
    events = random_events(np.random.default_rng(0), 2_000, SENSOR, 2 * S)
    events["t"][700] = events["t"][600]
    events["x"][900] = SENSOR.width
    with pytest.raises(EdgeVprError, match=r"event 700: .* backwards.*: sort the events by t, or"):
        list(open_recording(events, sensor=SENSOR))
    with pytest.raises(EdgeVprError, match="sensor"):
        list(open_recording(events[800:], sensor=SENSOR))
    recording = open_recording(events, sensor=SENSOR, on_fault="drop")
    used = np.concatenate(list(recording))
    assert (np.diff(used["t"].astype(np.int64)) >= 0).all() and used["x"].max() < SENSOR.width
    assert (recording.faults.backwards, recording.faults.off_sensor) == (1, 1)
    assert used.size == events.size - 2
    with pytest.raises(EdgeVprError, match="backwards"):
        load_track({"time_s": [0, 2, 1], "x_m": [0, 1, 2]})


@pytest.mark.parametrize("seed", range(5))
def test_2_lost_bytes_and_events_are_counted_and_the_sums_balance(seed):
    rng = np.random.default_rng(seed)
    events = random_events(rng, 20_000, SENSOR, 2 * S)
    encoder = open_encoder("evpr", SENSOR)
    frames = [encoder.encode(part) for part in split_events(events, 100)]
    for number in rng.choice(np.arange(1, 99), 5, replace=False):
        frames[number] = frames[number][: rng.integers(len(frames[number]))]
    decoder = open_decoder("evpr", SENSOR)
    came = decoder.feed(encoder.start() + b"".join(frames)).size + decoder.finish().size
    health = decoder.health
    assert balanced(health) and health.accounting == "exact" and health.lost > 0
    assert came + health.lost == events.size


def test_3_a_position_is_never_invented():
    # no position at a time means unknown, neither right nor wrong
    seconds = np.array([*range(6), *range(14, 21)])
    gap = Track(seconds * S, 5.0 * seconds[:, None])
    truth = from_tracks(gap, line(20), centres(20), centres(20), 4.0)
    right = np.arange(20)
    assert np.flatnonzero(~truth.placed).tolist() == [*range(5, 14)]
    assert np.array_equal(truth.judged(right, right), truth.placed)
    # a fix that needs more than 100 m/s is left out and counted, and 0 N 0 E with it
    time, east = np.arange(30), 1e-5 * np.arange(30)
    table = {"time_s": time, "latitude": np.full(30, 50.0), "longitude": 8.0 + east}
    table["latitude"][[4, 5]], table["longitude"][5] = (50.01, 0.0), 0.0
    track = load_track(table)
    assert dict(track.dropped) == {"0 N 0 E": 1, "more than 100 m/s": 1}
    assert track.time_us.size == 28
    # a log without time in common with its drive, tracks without a place in common within the
    # tolerance, and a truth that more than half of all pairs pass, are errors
    for reference, query, tolerance_m, says in (
        (line(20), line(20, first=60), 4.0, "query track covers 60 to 80 s .* and no window"),
        (line(20), line(20, begin_m=900.0), 4.0, "no query lies within 4 m of any place"),
        (line(20), line(20), 60.0, "of all pairs of place .* positions in the unit"),
    ):
        with pytest.raises(EdgeVprError, match=says):
            from_tracks(reference, query, centres(20), centres(20), tolerance_m)


@pytest.mark.parametrize(
    ("header", "scale"), [("time_s,x_m", 1), ("time_ms,x_m", 1e3), ("timestamp [ns],x", 1e9)]
)
def test_4_units_are_in_the_file_the_flag_or_the_convention_of_the_format(header, scale, tmp_path):
    path = tmp_path / "track.csv"
    path.write_text("\n".join([header, *(f"{t * scale:.0f},{5 * t}" for t in range(9))]))
    track = load_track(path)
    assert np.array_equal(track.time_us, line(8).time_us)
    assert np.array_equal(track.position, line(8).position)
    path.write_text("\n".join(["time_s,x_km", *(f"{t},{t}" for t in range(9))]))
    with pytest.raises(EdgeVprError, match="expected time_s,x_m"):
        load_track(path)
    events = random_events(np.random.default_rng(0), 2_000, SENSOR, 2 * S)
    np.savetxt(path, np.column_stack([events[name] for name in "txyp"]), fmt="%d", delimiter=",")
    for unit, factor in (("us", 1), ("ms", 1_000)):
        read = open_recording(path, sensor=SENSOR, time_unit=unit, columns="txyp")
        last_us = int(np.concatenate(list(read))["t"][-1])
        assert last_us == (int(events["t"][-1]) - int(events["t"][0])) * factor


@pytest.mark.parametrize("how", [{"smooth": True}, {"smooth": False}, {"every": "window"}])
def test_5_a_window_that_saw_nothing_is_never_a_confident_match(how):
    first, second = simulate_pair(0, "tiny", length_m=250)
    route = ReferenceMap.build(first, pixels=100)
    events = np.concatenate(list(second))
    unseen = (events["t"] >= 20 * S) & (events["t"] < 24 * S)
    matches = route.match(events[~unseen], precision=0.99, **how).matches
    inside = np.abs(matches.time_us - 22 * S) <= 1.5 * S
    assert not matches.lost[matches.time_us < 20 * S].all()
    assert inside.sum() > 2 and matches.lost[inside].all()
