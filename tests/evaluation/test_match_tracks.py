"""Matches as tracks: other programs read the positions that the map gave."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from edge_vpr_tools.cli import main

from edge_vpr.evaluation.track_files import load_track
from edge_vpr.evaluation.tracks import distances
from edge_vpr.events import Sensor
from edge_vpr.match_result import MatchResult
from edge_vpr.matching.matches import Matches
from edge_vpr.recordings import open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from tests.streams import random_events

SENSOR = Sensor(16, 12)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A folder with a recording, and maps of it with a GPS log, with metres and with odometry."""
    folder = tmp_path_factory.mktemp("drive")
    events = random_events(np.random.default_rng(0), 6_000, SENSOR, 3_000_000)
    write_recording(folder / "drive.npz", [events], sensor=SENSOR)
    noise = random_events(np.random.default_rng(1), 6_000, SENSOR, 3_000_000)
    parts = [events[events["t"] < 1_500_000], noise[noise["t"] >= 1_500_000]]
    write_recording(folder / "strayed.npz", parts, sensor=SENSOR)
    (folder / "gps.csv").write_text(
        "time_s,latitude,longitude\n0,-27.5,152.9\n2.2,-27.501,152.9015\n"
    )
    (folder / "flat.csv").write_text("time_s,x_m,y_m\n0,10,20\n3,40,-10\n")
    (folder / "wheel.csv").write_text("time_s,distance_m\n0,0\n3,30\n")
    small = ["--pixels", "20", "--sigma", "1", "--tau", "100ms"]
    for name, flag in (("gps", "--track"), ("flat", "--track"), ("wheel", "--odometry")):
        words = ["map", folder / "drive.npz", "-o", folder / f"{name}.npz", *small]
        assert main([*map(str, words), flag, str(folder / f"{name}.csv")]) == 0
    return folder


def matched(drive, name, folder, *exports, more=(), query="drive"):
    words = ["match", drive / f"{name}.npz", drive / f"{query}.npz", "-o", folder, "--no-figures"]
    words += [word for path in exports for word in ("--export", path)]
    assert main([*map(str, words), *more]) == 0
    return ReferenceMap.load(drive / f"{name}.npz"), Matches.load(folder / "matches.npz")


def test_gpx_and_geojson_hold_the_positions_of_the_matched_places(drive, tmp_path):
    gpx, points, tum = (tmp_path / f"track.{kind}" for kind in ("gpx", "geojson", "tum"))
    reference, matches = matched(drive, "gps", tmp_path / "out", gpx, points, tum)
    expected = reference.route.position[matches.place]
    placed = np.isfinite(expected[:, 0])
    assert 0 < placed.sum() < len(matches)  # the log ends before the drive
    written = np.array([(one.get("lat"), one.get("lon")) for one in points_of(gpx)], float)
    assert written == pytest.approx(expected[placed], abs=1e-7)

    features = json.loads(points.read_text())["features"]
    written = np.array([one["geometry"]["coordinates"] for one in features])
    assert written[:, ::-1] == pytest.approx(expected[placed], abs=1e-7)
    values = [one["properties"] for one in features]
    assert [one["place"] for one in values] == matches.place[placed].tolist()
    assert [one["time_s"] for one in values] == (matches.time_us[placed] / 1e6).tolist()
    assert [one["probability"] for one in values] == matches.probability[placed].round(4).tolist()
    assert {one["lost"] for one in values} == {None}

    rows = np.loadtxt(tum)
    assert rows.shape == (placed.sum(), 8)
    along = distances("geographic", expected[placed], expected[placed][0])
    from_first = np.hypot(*(rows[:, 1:3] - rows[0, 1:3]).T)
    assert from_first == pytest.approx(along, abs=0.05)
    assert np.all(np.diff(rows[[0, -1], 1]) > 0) and np.all(np.diff(rows[[0, -1], 2]) < 0)
    metres = MatchResult(reference, matches).position_m
    assert np.isnan(metres[~placed]).all()
    assert metres[placed] == pytest.approx(rows[:, 1:3], abs=1e-3)


def points_of(gpx):
    return [one for one in ElementTree.parse(gpx).iter() if one.tag.endswith("}trkpt")]


def test_a_gpx_has_dates_where_the_recordings_clock_counts_from_1970_and_else_no_time(
    drive, tmp_path
):
    recording = open_recording(drive / "drive.npz")
    write_recording(tmp_path / "dated.npz", recording, start_us=1_587_452_582_350_000)
    for query, part, start in (
        ("drive", (), None),
        ("dated", (), "2020-04-21T07:03:02.400000+00:00"),
        ("dated", ("--start", "1"), "2020-04-21T07:03:03.400000+00:00"),
    ):
        folder = drive if query == "drive" else tmp_path
        words = ["match", drive / "gps.npz", folder / f"{query}.npz", "-o", tmp_path / "out"]
        words += ["--export", tmp_path / "track.gpx", "--overwrite", "--no-figures", *part]
        assert main([*map(str, words)]) == 0
        assert len(points_of(tmp_path / "track.gpx")) > 5
        if start is None:
            assert "<time>" not in (tmp_path / "track.gpx").read_text()
        else:
            assert load_track(tmp_path / "track.gpx").start_utc.isoformat() == start


def test_tum_holds_metres_as_they_are_and_no_rotation(drive, tmp_path):
    reference, matches = matched(drive, "flat", tmp_path / "out", tmp_path / "track.tum")
    rows = np.loadtxt(tmp_path / "track.tum")
    assert rows[:, 0] == pytest.approx(matches.time_us / 1e6)
    assert rows[:, 1:3] == pytest.approx(reference.route.position[matches.place], abs=1e-3)
    assert rows[:, 3:].tolist() == [[0, 0, 0, 0, 1]] * len(matches)
    result = MatchResult(reference, matches)
    assert np.array_equal(result.position_m, result.position)
    reference, matches = matched(drive, "wheel", tmp_path / "odo", tmp_path / "odo.tum")
    rows = np.loadtxt(tmp_path / "odo.tum")
    assert rows[:, 1] == pytest.approx(reference.odometer_mm[matches.place] / 1e3, abs=1e-3)
    assert MatchResult(reference, matches).position_m is None


def test_lost_matches_are_left_out_of_a_track_and_marked_on_a_map(drive, tmp_path):
    files = [tmp_path / "track.gpx", tmp_path / "track.geojson"]
    more = ("--online", "--every", "window", "--precision", "0.99")
    reference, matches = matched(drive, "gps", tmp_path / "out", *files, more=more, query="strayed")
    placed = np.isfinite(reference.route.along_m[matches.place])
    assert (matches.lost & placed).any() and (~matches.lost & placed).any()
    assert len(points_of(files[0])) == np.count_nonzero(~matches.lost & placed)
    features = json.loads(files[1].read_text())["features"]
    assert [one["properties"]["lost"] for one in features] == matches.lost[placed].tolist()


@pytest.mark.parametrize(
    ("name", "file", "says"),
    [
        ("gps", "track.kml", "is no format of tracks: name it for example track.gpx"),
        ("flat", "track.gpx", "needs latitudes and longitudes, and the map has metres"),
        ("wheel", "track.geojson", "make it with edge-vpr map --track"),
        ("gps", "drive.npz.tum/track.tum", "is not a folder: make it first"),
        ("gps", "there.tum", "exists: name another, or replace it with --overwrite"),
    ],
)
def test_what_cannot_be_written_is_refused_before_any_work(
    drive, tmp_path, refused, name, file, says
):
    (tmp_path / "there.tum").write_text("mine")
    words = ["match", drive / f"{name}.npz", drive / "drive.npz", "-o", tmp_path / "out"]
    assert says in refused(*words, "--export", tmp_path / file)
    assert not (tmp_path / "out").exists()
    assert (tmp_path / "there.tum").read_text() == "mine"
