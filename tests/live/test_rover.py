"""`examples/rover.py` on a street: where it stops, and that it does not drive on unseen."""

from __future__ import annotations

import math
import runpy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from edge_vpr.events import Sensor, join_events
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair
from tests.live.devices import TimedCamera, sent_by

SENSOR = Sensor(128, 128)
ROVER = Path(__file__).parents[2] / "examples/rover.py"
SLOW, FAST = 0.2, 1.0
#: Further than it drives on the map's street until it knows a place.
KNOWS_M = 2.5


@pytest.fixture
def rover(monkeypatch, clock):
    """Names of the program."""
    follow = runpy.run_path(str(ROVER))["follow"]
    monkeypatch.setitem(follow.__globals__, "time", clock)
    return follow.__globals__


@pytest.fixture
def driven(monkeypatch, rover, street):
    """Drive to a goal; return where that was reached, and each new speed with its time."""

    def driven(camera, goal_m):
        speeds = []

        def drive(speed):
            if not speeds or speeds[-1][0] != speed:
                speeds.append((speed, camera.now_s))

        monkeypatch.setattr("edge_vpr.live.session.LinkReader", lambda *_, **__: camera)
        try:
            return rover["follow"]("camera", "evpr", street[0], goal_m, drive), speeds
        except SystemExit as ended:
            return str(ended), speeds

    return driven


@pytest.mark.parametrize(
    ("faults", "back_m", "places"), [("", 0, 2), ("flip=1e-4", 0, 3), ("", 70, 3)]
)
def test_a_rover_stops_near_its_goal(faults, back_m, places, driven, clock, street):
    """On a damaged line too, and carried back to drive a part twice."""
    map_path, events, track = street
    off_s, goal_m = 0.0, 140 if back_m else 120
    if back_m:
        metres = track.at(events["t"])[:, 0]
        first, again = events[metres < 100], events[metres > 100 - back_m].copy()
        off_us = int(again["t"][0]) - int(first["t"][-1]) - 1
        again.t -= off_us
        events, off_s = join_events([first, again]), off_us / 1e6
    camera = TimedCamera(clock, events, SENSOR, faults)
    reached_m, speeds = driven(camera, goal_m)
    assert reached_m >= goal_m
    assert speeds[-1] == (0.0, camera.now_s)
    stopped_m = track.at(np.array([round(1e6 * (camera.now_s + off_s))]))[0, 0]
    along_m = ReferenceMap.load(map_path).route.along_m
    assert abs(stopped_m - goal_m) <= places * np.diff(along_m).max()


def test_a_rover_relies_on_sure_matches_without_losses_until_the_path_jumps(rover):
    """The session's matches are made by hand: metre, lost, missing, jumps."""
    given = [
        (90, False, 0, 0),
        (105, True, 0, 0),  # beyond the goal, and beyond the reach of the sure match
        (101, False, 0.5, 0),  # half of its events are lost
        (102, False, 0.25, 0),
        (105, True, 0, 1),  # on another path, and further than the goal
        (103, False, 0, 1),
        (105, True, 0.5, 1),  # on the path of the last sure match, within its reach
    ]

    class Given:
        reference = SimpleNamespace(along_mm=[0])

        def __enter__(self):
            return self

        def __exit__(self, *error):
            pass

        def __iter__(self):
            for along_m, lost, missing, jumps in given:
                yield SimpleNamespace(
                    along_m=along_m, lost=lost, missing=missing, jumps=jumps, place=7,
                    age_s=math.nan,
                )  # fmt: skip

    rover["LiveSession"], speeds = lambda *_, **__: Given(), []
    assert rover["follow"]("camera", "evpr", "map.npz", 104, speeds.append) == 105
    assert speeds == [FAST, SLOW, SLOW, FAST, SLOW, FAST, SLOW, 0.0]


def test_a_rover_whose_camera_falls_silent_stops_at_once(driven, rover, clock, street):
    """The port stays, as where a firmware hangs."""
    rover["BLIND_M"] = KNOWS_M
    reached, speeds = driven(TimedCamera(clock, street[1], SENSOR, silent_s=15), 1_000)
    assert reached is None
    assert speeds[-2][0] == FAST and speeds[-2][1] < 15
    assert speeds[-1][0] == 0.0 and 15 < speeds[-1][1] < 16


def test_a_rover_that_knows_no_place_does_not_drive_on(driven, rover, clock):
    """As on a street that is not the map's; it has not heard all of it when it ends."""
    rover["BLIND_M"] = KNOWS_M
    other, _ = simulate_pair(seed=5, length_m=200.0)
    camera = TimedCamera(clock, join_events(list(other)), SENSOR)
    ended, speeds = driven(camera, 1_000)
    assert "this may not be the route" in ended
    assert not camera.ended
    assert [speed for speed, _ in speeds] == [0.0, SLOW, 0.0]


def test_a_rover_stands_while_matches_come_late(driven, clock, street):
    """Here since its host stood for 3 s; it drives on with the matches of now."""
    _, speeds = driven(TimedCamera(clock, street[1], SENSOR, held_up_s=15), 1_000)
    (at,) = (i for i, (_, at_s) in enumerate(speeds) if 18 < at_s < 18.1)
    assert [speed for speed, _ in speeds[at : at + 3]] == [0.0, SLOW, FAST]


def test_a_rover_whose_goal_never_comes_stops_where_the_line_ends(rover, street, tmp_path):
    """Also of a file, whose matches have no age."""
    sent, speeds = tmp_path / "sent.bin", []
    sent.write_bytes(sent_by(street[1], SENSOR))
    assert rover["follow"](str(sent), "evpr", street[0], 1_000, speeds.append) is None
    assert FAST in speeds and speeds[-1] == 0.0


def test_a_rover_whose_map_has_no_positions_does_not_move(rover, street, tmp_path):
    replace(ReferenceMap.load(street[0]), route=None).save(tmp_path / "map.npz")
    (tmp_path / "sent.bin").touch()
    words, speeds = [str(tmp_path / name) for name in ("sent.bin", "map.npz")], []
    with pytest.raises(SystemExit, match="has no positions"):
        rover["follow"](words[0], "evpr", words[1], 30, speeds.append)
    assert speeds == [0.0]


@pytest.mark.parametrize(
    ("port", "goal", "says"),
    [("/dev/none", "30", "/dev/none: there is no such"), ("/dev/none", "far", "'far'")],
)
def test_the_rover_says_in_one_line_what_is_not_there(port, goal, says, street, monkeypatch):
    monkeypatch.setattr("sys.argv", ["rover.py", port, "evpr", str(street[0]), goal])
    with pytest.raises(SystemExit, match=says):
        runpy.run_path(str(ROVER), run_name="__main__")


def test_the_rover_says_what_it_takes(monkeypatch):
    monkeypatch.setattr("sys.argv", ["rover.py", "--help"])
    with pytest.raises(SystemExit, match="PORT PROTOCOL"):
        runpy.run_path(str(ROVER), run_name="__main__")
