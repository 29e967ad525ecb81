"""Positions of a map's places, and where matches are along the route."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.errors import GroundTruthError, MapError
from edge_vpr.evaluation.tracks import Track, with_positions
from edge_vpr.events import Sensor
from edge_vpr.live.position import Locator
from edge_vpr.recordings import write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import ALONG, Route, along_columns
from edge_vpr.settings import Settings
from tests.streams import map_of_counts, random_events

SENSOR = Sensor(16, 12)


def a_map(places):
    pixels = PixelMap(SENSOR, np.array([0, 5]), np.array([0, 4]))
    made = map_of_counts(pixels, np.ones((places, 2)), Settings(pixels=2))
    seconds = np.arange(places, dtype=np.int64) * 1_000_000
    timed = replace(made.places, start_us=seconds, end_us=seconds + 1_000_000)
    return replace(made, places=timed)


def test_a_place_is_where_the_drive_was_in_the_middle_of_its_window(tmp_path):
    track = Track([1_000_000, 3_000_000, 4_000_000], [[0.0, 0.0], [6.0, 8.0], [6.0, 8.0]])
    reference = with_positions(a_map(5), track)
    reference.save(tmp_path / "map.npz")
    route = ReferenceMap.load(tmp_path / "map.npz").route
    assert route is not None and route.coordinates == ("x_m", "y_m")
    assert np.isnan(route.position[[0, 4]]).all() and np.isnan(route.along_m[[0, 4]]).all()
    assert route.position[1:4].tolist() == [[1.5, 2.0], [4.5, 6.0], [6.0, 8.0]]
    assert route.along_m[1:4].tolist() == [2.5, 7.5, 10.0]


def test_a_track_of_another_drive_is_refused():
    with pytest.raises(GroundTruthError, match=r"covers 9 to 12 s .* and no window of"):
        with_positions(a_map(3), Track([9_000_000, 12_000_000], [[0.0], [1.0]]))


@given(
    along=st.lists(st.one_of(st.none(), st.integers(0, 50)), min_size=1, max_size=12).filter(
        lambda along: any(value is not None for value in along)
    ),
    within=st.integers(0, 3),
)
def test_the_interval_spans_the_known_places_around_the_match(along, within):
    ascending = sorted(value for value in along if value is not None)
    metres = [np.nan if value is None else float(ascending.pop(0)) for value in along]
    columns = along_columns(np.array(metres), np.arange(len(metres)), within)
    for k in range(len(metres)):
        around = [m for m in metres[max(0, k - within) : k + within + 1] if m == m]
        expected = [min(around), max(around)] if around else [np.nan, np.nan]
        assert np.array_equal([columns[name][k] for name in ALONG[1:]], expected, equal_nan=True)
    assert np.array_equal(columns["along_m"], metres, equal_nan=True)


ARRAYS = {"position": np.array([[0.0], [2.0]]), "along_m": np.array([0.0, 2.0])}


@pytest.mark.parametrize(
    ("arrays", "kind", "says"),
    [
        ({"along_m": np.array([2.0, 0.0])}, "metric", "runs backwards"),
        ({"along_m": np.array([0.0, np.inf])}, "metric", "not known at the same places"),
        ({"along_m": np.array([0.0, np.nan])}, "metric", "not known at the same places"),
        ({"along_m": np.array([0.0])}, "metric", "along_m is"),
        ({"along_m": np.array([0, 2])}, "metric", "along_m is int64"),
        ({"position": np.zeros((2, 4))}, "metric", "4 columns"),
        ({}, "geographic", "1 columns"),
        ({}, None, "position_kind"),
    ],
)
def test_damaged_positions_are_refused(arrays, kind, says):
    with pytest.raises(MapError, match=says):
        Route.from_arrays({**ARRAYS, **arrays}, {"position_kind": kind})


def test_positions_of_another_map_are_refused():
    with pytest.raises(MapError, match="position has 2 rows for 3 places"):
        replace(a_map(3), route=Route(**ARRAYS))


def test_matches_on_a_map_with_a_track_say_where_they_are(tmp_path, run, refused):
    drive = random_events(np.random.default_rng(0), 4_000, SENSOR, 4_000_000)
    write_recording(tmp_path / "drive.npz", [drive], sensor=SENSOR)
    recording, path = tmp_path / "drive.npz", tmp_path / "map.npz"
    track = tmp_path / "track.csv"
    track.write_text("time_s,latitude,longitude\n0,-27.5,152.9\n3,-27.5003,152.9\n")
    small = ["--pixels", "5", "--sigma", "1", "--tau", "100ms"]
    with_track = ["--track", track, "--track-offset", "0.5"]
    said = run("map", recording, "-o", path, *small, *with_track).out
    assert "61 of 78 places have positions, along 33 m" in said
    made = ReferenceMap.load(path)
    assert made.info().route_m == Locator(made).route_m
    for extra in ([], ["--online", "--every", "window"]):
        output = tmp_path / f"results{len(extra)}"
        run("match", path, recording, "-o", output, "--no-figures", *extra)
        with (output / "matches.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        route = ReferenceMap.load(path).route
        assert route is not None
        for row in rows:
            along = route.along_m[int(row["place"])]
            if np.isnan(along):
                assert row["latitude"] == row["along_m"] == ""
                continue
            assert float(row["along_m"]) == pytest.approx(along, abs=0.01)
            assert float(row["along_from_m"]) <= along + 0.01
            assert along - 0.01 <= float(row["along_to_m"])
            assert float(row["latitude"]) == pytest.approx(-27.5 - along / 111_195, abs=1e-6)
        assert any(row["along_m"] for row in rows)
    again = ["map", recording, "-o", tmp_path / "b.npz", "--track-offset", "1"]
    assert "add --track" in refused(*again)
