"""A replay shows the matches of a folder, frame by frame, and names what it lacks."""

from __future__ import annotations

import csv
import shutil
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from edge_vpr_tools.cli import main
from edge_vpr_tools.commands.replay import RecordedInputs
from edge_vpr_tools.report.replay import _Film, replay_of
from edge_vpr_tools.report.style import panels
from edge_vpr_tools.truth_files import evaluated_truth
from PIL import Image

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.match_result import MatchResult
from edge_vpr.matching.matches import Matches
from edge_vpr.recordings import write_recording
from edge_vpr.results import read_run
from edge_vpr.simulation import simulate_pair
from tests.streams import random_events

SENSOR = Sensor(16, 12)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A folder with a recording, a map of it with positions, and matches of each kind."""
    folder = tmp_path_factory.mktemp("drive")
    events = random_events(np.random.default_rng(0), 6_000, SENSOR, 3_000_000)
    noise = random_events(np.random.default_rng(1), 6_000, SENSOR, 3_000_000)
    write_recording(folder / "drive.npz", [events], sensor=SENSOR)
    parts = [events[events["t"] < 1_500_000], noise[noise["t"] >= 1_500_000]]
    write_recording(folder / "query.npz", parts, sensor=SENSOR)
    (folder / "track.csv").write_text("time_s,x_m,y_m\n0,10,20\n3,40,-10\n")
    (folder / "wheel.csv").write_text("time_s,distance_m\n0,0\n3,42\n")
    words = ["map", "drive.npz", "-o", "map.npz", "--track", "track.csv", "--tau", "100ms"]
    words += ["--places-per-window", "1"]  # which sequences need
    words += ["--pixels", "20", "--sigma", "1"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(words) == 0
        match = ["match", "map.npz", "query.npz", "--no-figures", "-o"]
        assert main([*match, "whole"]) == 0
        assert main([*match, "sequences", "--matching", "sequence", "-L", "3"]) == 0
        assert main([*match, "live", "--online", "--every", "window"]) == 0
        assert main([*match, "wheels", "--odometry", "wheel.csv"]) == 0
    return folder


@pytest.fixture
def there(drive, monkeypatch):
    monkeypatch.chdir(drive)
    return drive


def load(folder, most, **more):
    inputs = RecordedInputs(folder, read_run(folder))
    result = MatchResult.load(folder)
    needed = result.queries is None or more.get("all_events")
    recording = inputs.recording("a test", result.reference.camera) if needed else None
    return replay_of(result, recording, inputs.odometry(), most, **more)


@pytest.mark.parametrize("name", ["whole", "sequences", "live", "wheels"])
def test_the_match_is_the_place_of_least_cost_in_every_frame(there, name):
    replay = load(there / name, 1_000)
    matches = Matches.load(there / name / "matches.npz")
    n = len(replay)
    assert n == (len(matches) if name != "live" else n) > 20
    assert np.array_equal(np.nanargmin(replay.cost, axis=0), replay.outcome.matches.place)
    assert replay.cost.shape == (matches.places_in_map, n)


def test_a_gif_has_a_frame_for_each_window_and_plays_ten_a_second(there, tmp_path, run):
    film = tmp_path / "match.gif"
    run("replay", "whole", "-o", film)
    with Image.open(film) as picture:
        assert picture.n_frames == len(Matches.load("whole/matches.npz"))
        assert picture.info["loop"] == 0
        shown = []
        for i in range(picture.n_frames):
            picture.seek(i)
            assert picture.info["duration"] == 100
            shown.append(np.asarray(picture.convert("RGB")))
    assert all((a != b).any() for a, b in pairwise(shown))
    corner = {tuple(frame[0, 0]) for frame in shown}
    assert corner == {(255, 255, 255)}


def test_each_frame_says_what_the_table_says(there):
    rows = list(csv.DictReader((there / "whole/matches.csv").read_text().splitlines()))
    texts = load(there / "whole", 1_000).captions()
    assert [text.partition(", acc")[0].partition(", not")[0] for text in texts] == [
        f"{float(row['time_s']):.1f} s: place {row['place']} of 29, "
        f"at {float(row['along_m']):.0f} m, probability {float(row['probability']):.2f}"
        for row in rows
    ]


@pytest.mark.parametrize("name", ["whole", "live"])
def test_a_film_of_an_evaluated_drive_shows_the_truth(there, tmp_path, name, run):
    copy, truth = shutil.copytree(there / name, tmp_path / "results"), tmp_path / "track.csv"
    truth.write_text("time_s,x_m,y_m\n0,10,20\n3,55,-25\n")  # ever farther from the map's
    run("evaluate", copy, "--ground-truth", "track.csv", truth, "--tolerance", 5)
    film = load(copy, 1_000, truth=evaluated_truth(copy))
    time_us = film.outcome.matches.time_us
    expected = np.column_stack([10 + 15e-6 * time_us, 20 - 15e-6 * time_us])
    place = film.reference.route.position[film.outcome.matches.place]
    correct = np.hypot(*(place - expected).T) <= 5
    assert 0 < correct.sum() < correct.size
    assert np.allclose(film.true.query, expected, atol=1e-6)
    for text, right in zip(film.captions(), correct, strict=True):
        assert text.endswith(", correct" if right else ", wrong")
    said = run("replay", copy, "-o", tmp_path / "silent.gif", "--frames", 2).err
    assert "warning" not in said  # as the evaluation has given them
    truth.write_text(truth.read_text() + "4,70,-40\n")
    with pytest.raises(UsageError, match="has moved or changed since the evaluation"):
        evaluated_truth(copy)
    said = run("replay", copy, "-o", tmp_path / "match.gif", "--frames", 2).err
    assert "the film is without the truth" in said


def test_a_film_of_a_map_without_positions_shows_the_truth_of_an_alignment(there, tmp_path, run):
    folder, pairs, mapped = (tmp_path / name for name in ("results", "pairs.csv", "map.npz"))
    run("map", "drive.npz", "-o", mapped, "--tau", "100ms", "--pixels", 20, "--sigma", 1)
    run("match", mapped, "query.npz", "-o", folder)
    pairs.write_text("query_s,reference_s\n0,0\n2,1\n")
    run("evaluate", folder, "--ground-truth", pairs, "--tolerance", 0.3)
    film = replay_of(MatchResult.load(folder), None, None, 1_000, truth=evaluated_truth(folder))
    with panels(2, 3, 7.2, 4.5) as (drawing, axes):
        shown = _Film(film, drawing, axes)
    time_s, at_s = shown._true.T
    placed = time_s <= 2
    assert np.allclose(at_s[placed], time_s[placed] / 2, atol=0.05)  # of the nearest place
    assert placed.any() and np.isnan(at_s[~placed]).all() and (~placed).any()
    for i in (int(np.argmax(film.outcome.wrong)), int(np.argmax(film.outcome.correct))):
        shown.frame(i)
        marked = [len(mark.get_offsets()) for mark in (shown._now, shown._wrong)]
        assert marked == [film.outcome.correct[i], film.outcome.wrong[i]]


def test_a_part_and_fewer_frames_can_be_asked_for(there, tmp_path, run):
    film = tmp_path / "match.gif"
    words = ["replay", "whole", "-o", film, "--start", 0.5, "--end", 2, "--frames"]
    run(*words, 4)
    with Image.open(film) as picture:
        assert picture.n_frames == 4
    texts = load(there / "whole", 4, start_s=0.5, end_s=2.0).captions()
    times = [float(text.split(" s:")[0]) for text in texts]
    assert len(times) == 4 and times == sorted(times)
    assert times[0] >= 0.5 and times[-1] <= 2.0
    run(*words, 1, "--overwrite")


def test_the_events_of_all_pixels_are_those_of_the_recording(there):
    replay = load(there / "whole", 7, all_events=True)
    assert np.array_equal(replay.images.sum(axis=(1, 2)), replay.queries.events)
    seen = replay.images[:, replay.reference.pixel_map.y, replay.reference.pixel_map.x]
    assert np.array_equal(seen.sum(axis=1), replay.queries.selected_events)


@pytest.mark.parametrize(
    ("name", "needed", "what", "more"),
    [
        ("live", "query.npz", "a match --online", ()),
        ("wheels", "wheel.csv", "a match with --odometry", ()),
        ("whole", "query.npz", "the events of all pixels", ("--all-events",)),
    ],
)
def test_a_file_that_has_moved_or_changed_is_named(
    there, tmp_path, monkeypatch, run, refused, name, needed, what, more
):
    shutil.copytree(there / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    words = ["replay", name, "-o", "match.gif", "--frames", 2, *more]
    assert f"{needed}, which {what} needs, is not there: run edge" in refused(*words)
    (tmp_path / needed).write_bytes((there / needed).read_bytes() + b"\n")
    assert f"{needed}, which {what} needs, has changed since" in refused(*words)
    shutil.copy(there / needed, tmp_path)
    run(*words)


def test_a_film_is_made_from_any_folder(drive, tmp_path, monkeypatch, run):
    """Recording, odometry and truth lie where they lay when the match was made and judged."""
    shutil.copytree(drive, tmp_path / "drive")
    monkeypatch.chdir(tmp_path / "drive")
    Path("other.csv").write_text("time_s,x_m,y_m\n0,10,20\n3,41,-10\n")
    run("evaluate", "live", "--ground-truth", "track.csv", "other.csv", "--tolerance", 5)
    monkeypatch.chdir(tmp_path)
    for name in ("live", "wheels"):
        said = run("replay", f"drive/{name}", "-o", f"{name}.gif", "--frames", 2).err
        assert "without the truth" not in said


def test_recorded_matches_need_no_other_file(there, tmp_path, monkeypatch, run):
    shutil.copytree(there / "whole", tmp_path / "whole")
    monkeypatch.chdir(tmp_path)
    run("replay", "whole", "-o", "match.gif", "--frames", 2)


def test_a_file_is_replaced_only_when_told(there, tmp_path, refused):
    film = tmp_path / "match.gif"
    film.write_text("mine")
    assert "replace it with --overwrite" in refused("replay", "whole", "-o", film)


def test_a_film_of_the_demo_shows_the_truth(tmp_path, monkeypatch, run):
    """Its folder is as `edge-vpr evaluate` leaves one, with the tracks of both drives."""
    monkeypatch.chdir(tmp_path)
    street = partial(simulate_pair, sensor="tiny", length_m=60.0)
    monkeypatch.setattr("edge_vpr.simulation.simulate_pair", street)
    folder = Path("demo[red]")
    assert "See demo[red]/report.html" in run("demo", "-o", folder).out
    run("replay", folder, "-o", "all.gif", "--all-events", "--frames", 2)
    result = MatchResult.load(folder)
    film = replay_of(result, None, None, 10, truth=evaluated_truth(folder))
    assert np.isfinite(film.true.query).all()
    assert (film.outcome.correct | film.outcome.wrong).all()
