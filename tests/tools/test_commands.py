"""The commands, as their users call them: what they print, leave behind, and say to bad use."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
from unittest.mock import Mock

import numpy as np
import pytest
from edge_vpr_tools.cli import main

from edge_vpr.errors import UsageError
from edge_vpr.match_result import MatchResult
from edge_vpr.matching.matches import Matches
from edge_vpr.recordings import Recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair
from tests.streams import read_events
from tests.tools.conftest import SMALL

#: with the settings of a robot
FEW = ("--pixels", 5, "--sigma", 1, "--tau", "100ms")


@pytest.fixture
def results(drive, tmp_path):
    """A folder of matches that a test may change."""
    return shutil.copytree(drive / "results", tmp_path / "results")


def line_track(path, seconds, metres, begin=0.0):
    """A table of a drive along a line."""
    rows = [f"{begin + i / 10},{metres * i / (10 * seconds)}" for i in range(10 * seconds + 1)]
    path.write_text("\n".join(["time_s,position_m", *rows]) + "\n")
    return path


def names_in(folder):
    return {path.name for path in folder.iterdir()}


def test_match_leaves_a_folder_that_explains_itself(drive):
    results = drive / "results"
    files = "map.npz matches.npz matches.csv queries.npz run.json metrics.json report.html"
    assert names_in(results) == {*files.split(), "matches.svg", "distance_matrix.svg", "pixels.svg"}
    run = json.loads((results / "run.json").read_text())
    assert run["settings"]["pixels"] == 5
    assert [len(file["sha256"]) for file in run["inputs"]] == [64, 64]
    page = (results / "report.html").read_text()
    assert page.count("<svg ") == 3
    assert 'src="http' not in page
    assert "href=" not in re.sub('href="(#|data:image/png;base64,)', "", page)


def test_a_folder_of_results_in_place_of_a_recording_names_its_recording(drive, results, refused):
    words = ["map", results, "-o", results.parent / "out.npz"]
    says = f"results of {drive / 'map.npz'}, {drive / 'query.npz'}: name the recording among them"
    assert says in refused(*words, code=1)
    run = json.loads((results / "run.json").read_text())
    (results / "run.json").write_text(json.dumps(run | {"inputs": []}))  # as of the demo
    (results / "figure.png").touch()
    assert "of edge-vpr simulate -o street" in refused(*words, code=1)


def test_the_drive_of_the_demo_is_that_of_simulate(tmp_path, monkeypatch):
    """As its folder of results says in place of a recording."""
    pairs = []

    def noted(*arguments, **changes):
        pairs.append(simulate_pair(*arguments, **changes))
        raise UsageError("these are enough")

    monkeypatch.setattr("edge_vpr.simulation.simulate_pair", noted)
    assert main(["simulate", "-o", str(tmp_path / "street")]) == 2
    assert main(["demo", "-o", str(tmp_path / "demo")]) == 2
    simulated, demo = (
        [(drive.world, drive.camera, drive.drive, drive.seed) for drive in pair] for pair in pairs
    )
    assert simulated == demo


def test_the_next_command_can_be_copied(drive, tmp_path, run):
    folder = tmp_path / "drive of monday"
    printed = run("match", drive / "map.npz", drive / "query.npz", "-o", folder).out
    truth = ["--ground-truth", "MAP_TRACK", "QUERY_TRACK", "--tolerance", "METRES"]
    copied = shlex.split(printed.rpartition("next, compare with the truth: ")[2])
    assert copied == ["edge-vpr", "evaluate", str(folder), *truth]


@pytest.mark.parametrize("more", [[], ["--online"], ["--online", "--every", "window"]])
def test_a_match_reads_its_recording_once(drive, tmp_path, monkeypatch, more, run):
    """Also for its report, which shows the windows of a match event by event."""
    read, passes = Recording.__iter__, []

    def noted(recording):
        passes.append(recording.path)
        return read(recording)

    monkeypatch.setattr(Recording, "__iter__", noted)
    run("match", drive / "map.npz", drive / "query.npz", *more, "-o", tmp_path / "results")
    assert passes == [drive / "query.npz"]
    assert (tmp_path / "results/report.html").is_file()
    if more:
        queries = MatchResult.load(drive / "results").queries
        assert MatchResult.load(tmp_path / "results").windows == queries


@pytest.mark.parametrize("every", ["event", "7", "30ms", "window", "change"])
def test_matches_online_say_what_the_localiser_says(drive, tmp_path, every, run):
    output = tmp_path / "results"
    words = ["match", drive / "map.npz", drive / "query.npz", "--online", "--every", every]
    run(*words, "--exclusion", 1, "-o", output)
    files = "map.npz matches.npz matches.csv matches.svg pixels.svg report.html run.json"
    assert names_in(output) == {*files.split(), "metrics.json", "windows.npz"}
    place = Matches.load(output / "matches.npz").place
    header, *lines = (output / "matches.csv").read_text().splitlines()
    assert header == (drive / "results" / "matches.csv").read_text().splitlines()[0]
    assert [int(line.split(",")[2]) for line in lines] == place.tolist()
    reference, kept = (ReferenceMap.load(folder / "map.npz") for folder in (drive, output))
    assert kept.settings == reference.settings  # what is asked of one run is no part of the map
    if every == "window":
        batch = Matches.load(drive / "results" / "matches.npz")
        assert place.tolist() == (batch.place + 1 - 2 // 2).tolist()


def test_only_a_folder_of_our_results_is_replaced_when_told(drive, tmp_path, run, refused):
    words = ["match", drive / "map.npz", drive / "query.npz", "--no-figures", "-o"]
    run(*words, tmp_path / "results")
    (tmp_path / "results" / "stale.png").write_text("")
    run(*words, tmp_path / "results", "--overwrite")
    assert not (tmp_path / "results" / "stale.png").exists()
    assert names_in(tmp_path) == {"results"}
    (tmp_path / "results" / "mine").mkdir()
    assert "also holds 'mine'" in refused(*words, tmp_path / "results", "--overwrite")
    assert (tmp_path / "results" / "mine").is_dir()
    (tmp_path / "holiday.jpg").write_text("precious")
    assert "is not a folder of edge-vpr's results" in refused(*words, tmp_path, "--overwrite")
    assert (tmp_path / "holiday.jpg").read_text() == "precious"


@pytest.mark.parametrize(
    "line",
    [
        "simulate --sensor tiny --length 20",
        "match {d}/map.npz {d}/query.npz --no-figures",
        "match {d}/map.npz {d}/query.npz --no-figures --online",
        "golden --map {d}/map.npz --suite random --vectors 10kB",
        "hardware --map {d}/map.npz --vectors 10kB",
        "profile --map {d}/map.npz --recording {d}/query.npz --quick --window-s 0.1 --pairs 5",
    ],
    ids=lambda line: line.split()[0] + "-online" * ("--online" in line),
)
def test_of_two_runs_into_one_new_folder_one_wins(line, drive, run, tmp_path, monkeypatch):
    """The other run ends while this one waits for the disk, later than all checks of the flags."""
    sync, won = os.fsync, tmp_path / "new"

    def other_ends(handle):
        if not won.exists():
            won.mkdir()
            (won / "run.json").write_text("{}")
        sync(handle)

    monkeypatch.setattr(os, "fsync", other_ends)
    lines = run(*line.format(d=drive).split(), "-o", won, code=2).err.splitlines()
    assert sum(line.startswith("edge-vpr: error: ") for line in lines) == 1
    assert f"another run wrote {won} in the meantime" in lines[-1]
    assert names_in(tmp_path) == {"new"} and names_in(won) == {"run.json"}


def test_an_interrupt_leaves_nothing_half_written(drive, run, tmp_path, monkeypatch):
    monkeypatch.setattr("edge_vpr.match_result.write_csv", Mock(side_effect=KeyboardInterrupt))
    words = ["match", drive / "map.npz", drive / "query.npz", "-o", tmp_path / "results"]
    assert "interrupted" in run(*words, code=130).err
    assert list(tmp_path.iterdir()) == []


#: what Numba raises when it is imported from a folder that a service may not write to
NO_CACHE = RuntimeError("cannot cache function '_below': no locator available for file 'a.py'")


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (NO_CACHE, "set NUMBA_CACHE_DIR to a folder that can be written to"),
        (ZeroDivisionError("oh"), "internal error, ZeroDivisionError: oh"),
    ],
)
def test_an_error_that_nobody_expected_is_one_line_and_debug_shows_the_trace(
    drive, run, refused, tmp_path, monkeypatch, error, says
):
    monkeypatch.setattr("edge_vpr.match_result.write_csv", Mock(side_effect=error))
    words = ["match", drive / "map.npz", drive / "query.npz", "-o", tmp_path / "results"]
    assert says in refused(*words, code=1)
    assert "Traceback" in run("--debug", *words, code=1).err


def test_matches_event_by_event_are_evaluated_by_the_same_command(
    drive, run, tmp_path, monkeypatch
):
    folder = tmp_path / "online"
    run("match", drive / "map.npz", drive / "query.npz", "--online", "-o", folder)
    tracks = [line_track(tmp_path / f"{name}.csv", 2, 20) for name in ("reference", "query")]
    words = ["evaluate", folder, "--ground-truth", *tracks, "--tolerance", 2, "--offset", 0, 0]
    assert "P@100R" in run(*words).out
    evaluation = json.loads((folder / "metrics.json").read_text())["evaluation"]
    matches = Matches.load(folder / "matches.npz")
    reference = ReferenceMap.load(folder / "map.npz")
    error_us = np.abs(reference.places.centre_us[matches.place] - matches.time_us)
    right = error_us <= 200_000
    assert evaluation["queries"] == len(matches) > 100
    assert evaluation["precision_at_100_recall"] == pytest.approx(right.mean(), abs=0.01)
    assert set(evaluation["recall_at"]) == {"1"}  # of each match only the best place is kept
    assert (folder / "matches.svg").is_file()
    # of more matches than the truth has room for, some are evaluated, and it says how many
    room = len(matches) * len(reference) // 2
    monkeypatch.setattr("edge_vpr_tools.truth_files._MOST_CELLS", room)
    some = -(-len(matches) // 3)
    assert f"one match in 3 is evaluated: {some:,} of {len(matches):,}\n" in run(*words).err
    assert json.loads((folder / "metrics.json").read_text())["evaluation"]["queries"] == some


def test_a_matrix_is_declared_by_its_rows_whatever_its_file(results, tmp_path, run, refused):
    """A table could be tracks or an alignment too."""
    np.savetxt(tmp_path / "truth.csv", np.eye(19), fmt="%d", delimiter=",")
    words = ["evaluate", results, "--ground-truth", tmp_path / "truth.csv"]
    assert "P@100R" in run(*words, "--rows", "reference").out
    assert json.loads((results / "metrics.json").read_text())["evaluation"]["queries"] == 18
    assert (results / "precision_recall.svg").is_file()
    assert "or of a matrix --rows" in refused(*words)
    assert "and of a matrix its --rows" in refused(*words, "--tolerance", 1, code=1)


def test_info_shows_how_a_track_fits_its_recording(drive, tmp_path, run, refused):
    log = line_track(tmp_path / "log.csv", 1, 5, begin=100.5)
    words = ["info", drive / "query.npz", "--track", log, "--track-offset", -100]
    said = run(*words).out
    line = (
        r"^drive track  5 m from 0\.5 to 1\.5 s, 5 m/s in the mean and 5 m/s at most, longest gap "
    )
    assert re.search(line + r"0\.1 s; covers [45]\d\.\d% of the drive$", said, re.MULTILINE)
    facts = json.loads(run(*words, "--json").out)["facts"]
    assert all(text in said for text in facts.values()) and len(facts) == 2
    assert "--track is of a rec" in refused("info", drive / "map.npz", "--track", log)


def test_map_shows_each_drive_and_its_track(drive, tmp_path, run):
    first, second = (line_track(tmp_path / f"{name}.csv", 2, 20) for name in "ab")
    recordings = [drive / f"{name}.npz" for name in ("reference", "query")]
    tracks = ["--track", first, "--track", second, "--same-route"]
    said = run("map", *recordings, "-o", tmp_path / "map.npz", *FEW, *tracks).out
    for heading in ("drive", recordings[1]):
        assert re.search(f"^{heading} +[\\d,]+ events in ", said, re.MULTILINE)
        assert re.search(f"^{heading} track +20 m from 0.0 to 2.0 s, 10 m/s", said, re.MULTILINE)


def test_calibrating_says_what_it_learnt_from(drive, run, refused, tmp_path):
    mapped, track = tmp_path / "map.npz", tmp_path / "track.csv"
    run("map", drive / "reference.npz", "-o", mapped, *FEW)
    line_track(track, 3, 30)
    folder, metrics = tmp_path / "results", tmp_path / "results/metrics.json"
    run("match", mapped, drive / "query.npz", "--no-figures", "--online", "-o", folder)
    assert f"run edge-vpr evaluate {folder} first" in refused("calibrate", folder)
    run("evaluate", folder, "--ground-truth", track, track, "--tolerance", 5, "--offset", 0, 0)
    said = run("calibrate", folder, "-o", tmp_path / "learnt.npz").out
    assert re.search(r"from \d+ matches, \d+ of them correct and 0 off the map", said)
    # a damaged file, or another truth than that of the evaluation, ends it before it saves
    none = tmp_path / "none.npz"
    whole = metrics.read_text()
    metrics.write_text("{")
    refused("calibrate", folder, "-o", none)
    metrics.write_text(whole)
    track.write_text("time_s,position_m\n0,0\n3,30\n")
    says = "has moved or changed since the evaluation"
    assert says in refused("calibrate", folder, "-o", none)
    assert not none.exists()


@pytest.mark.parametrize("places_per_window", [2, 1])
def test_a_map_says_that_its_places_are_at_half_windows(places_per_window, drive, tmp_path, run):
    """Where it is made, matched and reported."""
    mapped, out, half = tmp_path / "map.npz", tmp_path / "out", "(at half windows)"
    shown = places_per_window == 2
    words = ["--tau", "100ms", "--pixels", 5, "--places-per-window", places_per_window]
    assert (half in run("map", drive / "reference.npz", "-o", mapped, *words).out) == shown
    words = ["match", mapped, drive / "query.npz", "-o", out, "--figures", "svg"]
    assert (half in run(*words).out) == shown
    assert (half in (out / "report.html").read_text()) == shown
    label = "reference place, at half windows"
    assert (label in (out / "distance_matrix.svg").read_text()) == shown


@pytest.mark.parametrize("command", ["map", "convert"])
def test_no_command_writes_over_its_input_by_another_name(drive, tmp_path, refused, command):
    source, output = tmp_path / "drive.npz", tmp_path / "other.npz"
    shutil.copy(drive / "reference.npz", source)
    output.symlink_to(source)
    words = [source, "-o", output, *SMALL] if command == "map" else [source, output]
    assert "is the input" in refused(command, *words, "--overwrite")
    assert source.read_bytes() == (drive / "reference.npz").read_bytes()


@pytest.mark.parametrize("more", [[], ["--online"]])
def test_match_does_not_replace_the_folder_that_its_map_or_drive_lies_in(
    more, drive, results, refused
):
    shutil.copy(drive / "query.npz", results)
    for inputs in (
        (results / "map.npz", drive / "query.npz"),
        (drive / "map.npz", results / "query.npz"),
    ):
        said = refused("match", *inputs, "-o", results, "--overwrite", *more)
        assert "holds the input" in said
    assert (results / "query.npz").is_file()


@pytest.mark.slow
def test_evaluate_shows_what_a_log_covers_and_sets_clocks_right(results, tmp_path, run, refused):
    reference = line_track(tmp_path / "reference.csv", 2, 20)
    late = line_track(tmp_path / "late.csv", 2, 20, begin=1.0)
    evaluate = ["evaluate", results, "--tolerance", 2, "--ground-truth", reference]
    said = run(*evaluate, late).out
    assert re.search(r"query track +20 m from 1\.0 to 3\.0 s, .*; covers [45]\d\.\d% of the", said)
    said = run(*evaluate, late, "--offset", 0, -1)
    assert said.err == "" and re.search(r"query track .*; covers 100\.0% of the drive", said.out)
    assert "give two tracks" in refused(*evaluate, "--offset", 0, 5)


def test_one_log_for_both_drives_is_refused(results, tmp_path, run, refused):
    """By name, or a copy of it; with an offset it is one log of both."""
    log = line_track(tmp_path / "log.csv", 2, 20)
    shutil.copy(log, tmp_path / "copy.csv")
    evaluate = ["evaluate", results, "--tolerance", 2, "--ground-truth", log]
    for other in (log, tmp_path / "copy.csv"):
        assert "both are the same log: name that of" in refused(*evaluate, other)
    run(*evaluate, log, "--offset", 0, 0)


@pytest.mark.parametrize(
    ("name", "contents"),
    [
        ("metrics.json", ("{", "[1]", "[" * 100_000, '{"queries": NaN}')),
        (
            "run.json",
            ({"inputs": [{"path": "a"}]}, {"inputs": 3}, {"settings": [1]}, {"machine": None}),
        ),
    ],
)
def test_a_damaged_record_is_named(name, contents, results, tmp_path, refused):
    log, whole = line_track(tmp_path / "log.csv", 2, 20), json.loads((results / name).read_text())
    truth = ["--ground-truth", log, log, "--offset", 0, 0, "--tolerance", 2]
    for content in contents:
        text = content if isinstance(content, str) else json.dumps(whole | content)
        (results / name).write_text(text)
        assert name in refused("evaluate", results, *truth)


def test_the_name_of_a_file_cannot_write_on_the_terminal(tmp_path, refused):
    name = "drive\x1b[2J\x1b]0;owned\x07\n\u202ezpn.csv"
    for command in (["map", tmp_path / name], ["match", tmp_path / name, "q.npz"]):
        said = refused(*command, "-o", tmp_path / "out.npz", code=1)
        assert "drive\\x1b[2J" in said and said.rstrip("\n").isprintable()


@pytest.mark.parametrize("log", ["metres", "none"])
def test_tau_auto_fits_the_window_to_a_slow_robot(log, tmp_path, run):
    drives, path = tmp_path / "drives", tmp_path / "map.npz"
    run("simulate", "-o", drives, "--sensor", "tiny", "--length", 15, "--speed", 1)
    track = ["--track", drives / "reference_track.csv"] if log == "metres" else []

    def mapped(tau):
        words = ["map", drives / "reference.npz", "-o", path, "--overwrite", "--tau", tau, *track]
        told = run(*words, "--pixels", 50, "--sigma", 1).out
        return ReferenceMap.load(path), told

    short, told = mapped("500ms")
    assert ("m of travel" in told) == (log == "metres")
    named_s = float(re.search(r"--tau auto makes it ([\d.]+) s", told)[1])
    fitting, _ = mapped("auto")
    if log == "metres":
        travel_m = np.median(np.diff(fitting.along_mm[:: fitting.settings.window_parts])) / 1e3
        assert 2 <= travel_m <= 3
    else:
        assert fitting.windows.selected_events.mean() / len(fitting.pixel_map) > 2
    assert fitting.settings.tau_us > short.settings.tau_us
    assert named_s == pytest.approx(fitting.settings.tau_us / 1e6, rel=0.3)


def test_a_query_that_does_not_say_its_sensor_has_that_of_the_map(drive, tmp_path, run):
    """For every command that reads it beside the map or the matches."""
    events = read_events(drive / "query.npz")
    columns = [events[name] for name in "txyp"]
    np.savetxt(tmp_path / "query.csv", np.column_stack(columns), fmt="%d", delimiter=",")
    reference, query = drive / "map.npz", tmp_path / "query.csv"
    for words in (
        ["match", reference, query, "-o", tmp_path / "m", "--no-figures"],
        ["match", reference, query, "-o", tmp_path / "live", "--online", "--no-figures"],
        ["replay", tmp_path / "live", "-o", tmp_path / "film.gif", "--frames", 2],
        ["map", reference, query, "-o", tmp_path / "learnt.npz", "--same-route"],
        ["golden", "--map", reference, "--recording", query, "--suite", "recording",
         "-o", tmp_path / "vectors"],
    ):  # fmt: skip
        run(*words)
    of_sensor = Matches.load(drive / "results" / "matches.npz")
    np.testing.assert_array_equal(Matches.load(tmp_path / "m/matches.npz").place, of_sensor.place)
