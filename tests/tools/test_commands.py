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

from edge_vpr.archive import write_archive
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor, join_events
from edge_vpr.match_result import MatchResult
from edge_vpr.matching.matches import Matches
from edge_vpr.recordings import Recording, open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair
from tests.streams import random_events, write_drives

SENSOR = Sensor(16, 12)
SMALL = ["--preset", "paper", "--pixels", "5", "--sigma", "1", "--tau", "100ms", "-L", "2"]


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A folder with two drives, a map and matches."""
    folder = tmp_path_factory.mktemp("drive")
    write_drives(folder, 4_000, SENSOR, 2_000_000)
    assert main(["map", str(folder / "reference.npz"), "-o", str(folder / "map.npz"), *SMALL]) == 0
    match = ["match", str(folder / "map.npz"), str(folder / "query.npz")]
    assert main([*match, "-o", str(folder / "results")]) == 0
    return folder


def call(capsys, *arguments):
    """Exit code and the lines on standard error."""
    code = main([str(argument) for argument in arguments])
    return code, capsys.readouterr().err.strip().splitlines()


def refused(capsys, *arguments, code, says):
    """Check for one line on standard error that says what is wrong."""
    ended, lines = call(capsys, *arguments)
    assert ended == code, lines
    assert len(lines) == 1
    assert says in lines[0]
    assert lines[0].startswith("edge-vpr: error: ")


def test_match_leaves_a_folder_that_explains_itself(drive):
    results = drive / "results"
    assert {path.name for path in results.iterdir()} == {
        "map.npz",
        "matches.npz",
        "matches.csv",
        "queries.npz",
        "run.json",
        "metrics.json",
        "report.html",
        "matches.svg",
        "distance_matrix.svg",
        "pixels.svg",
    }
    run = json.loads((results / "run.json").read_text())
    assert run["settings"]["pixels"] == 5
    assert [len(file["sha256"]) for file in run["inputs"]] == [64, 64]
    page = (results / "report.html").read_text()
    assert page.count("<svg ") == 3
    assert 'src="http' not in page
    assert "href=" not in re.sub('href="(#|data:image/png;base64,)', "", page)


def test_a_folder_of_results_in_place_of_a_recording_names_its_recording(drive, tmp_path, capsys):
    results, out = tmp_path / "results", tmp_path / "out.npz"
    shutil.copytree(drive / "results", results)
    says = f"results of {drive / 'map.npz'}, {drive / 'query.npz'}: name the recording among them"
    refused(capsys, "map", results, "-o", out, code=1, says=says)
    run = json.loads((results / "run.json").read_text())
    (results / "run.json").write_text(json.dumps(run | {"inputs": []}))  # as of the demo
    (results / "figure.png").touch()
    refused(capsys, "map", results, "-o", out, code=1, says="of edge-vpr simulate -o street")


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


def test_settings_lie_flags_over_file_over_preset(drive, tmp_path):
    config = tmp_path / "settings.toml"
    config.write_text('preset = "tiny"\nsigma = 1.0\ntau_us = 100000\nseed = 3\n')
    output = tmp_path / "map.npz"
    source = str(drive / "reference.npz")
    flags = ["--config", str(config), "--seed", "4", "--strategy", "random"]
    assert main(["map", source, "-o", str(output), *flags]) == 0
    settings = ReferenceMap.load(output).settings
    assert (settings.pixels, settings.seed, settings.strategy) == (25, 4, "random")


def test_the_next_command_can_be_copied(drive, tmp_path, capsys):
    folder = tmp_path / "drive of monday"
    words = ["match", str(drive / "map.npz"), str(drive / "query.npz"), "-o", str(folder)]
    assert main(words) == 0
    printed = capsys.readouterr().out.rpartition("next, compare with the truth: ")[2]
    truth = ["--ground-truth", "MAP_TRACK", "QUERY_TRACK", "--tolerance", "METRES"]
    assert shlex.split(printed) == ["edge-vpr", "evaluate", str(folder), *truth]


def test_evaluate_adds_figures_and_metrics(drive, tmp_path, capsys):
    matrix = np.eye(19, 19, dtype=np.uint8)
    np.save(tmp_path / "truth.npy", matrix)
    arguments = ["evaluate", drive / "results", "--ground-truth", tmp_path / "truth.npy"]
    assert main([*map(str, arguments), "--rows", "reference"]) == 0
    assert "P@100R" in capsys.readouterr().out
    metrics = json.loads((drive / "results" / "metrics.json").read_text())
    assert metrics["evaluation"]["queries"] == 18
    assert (drive / "results" / "precision_recall.svg").is_file()


@pytest.mark.parametrize("more", [[], ["--online"], ["--online", "--every", "window"]])
def test_a_match_reads_its_recording_once(drive, tmp_path, monkeypatch, more):
    """Also for its report, which shows the windows of a match event by event."""
    read, passes = Recording.__iter__, []

    def noted(recording):
        passes.append(recording.path)
        return read(recording)

    monkeypatch.setattr(Recording, "__iter__", noted)
    arguments = ["match", str(drive / "map.npz"), str(drive / "query.npz"), *more]
    assert main([*arguments, "-o", str(tmp_path / "results")]) == 0
    assert passes == [drive / "query.npz"]
    assert (tmp_path / "results/report.html").is_file()
    if more:
        queries = MatchResult.load(drive / "results").queries
        assert MatchResult.load(tmp_path / "results").windows == queries


@pytest.mark.parametrize("every", ["event", "7", "30ms", "window", "change"])
def test_matches_online_say_what_the_localiser_says(drive, tmp_path, every):
    arguments = ["match", str(drive / "map.npz"), str(drive / "query.npz"), "--online"]
    output = tmp_path / "results"
    assert main([*arguments, "--every", every, "--exclusion", "1", "-o", str(output)]) == 0
    assert {path.name for path in output.iterdir()} == {
        "map.npz",
        "matches.npz",
        "matches.csv",
        "matches.svg",
        "pixels.svg",
        "report.html",
        "run.json",
        "metrics.json",
        "windows.npz",
    }
    matches = Matches.load(output / "matches.npz")
    place = matches.place
    header, *lines = (output / "matches.csv").read_text().splitlines()
    assert header == (drive / "results" / "matches.csv").read_text().splitlines()[0]
    assert [int(line.split(",")[2]) for line in lines] == place.tolist()
    reference, kept = (ReferenceMap.load(folder / "map.npz") for folder in (drive, output))
    assert kept.settings == reference.settings  # what is asked of one run is no part of the map
    if every == "window":
        batch = Matches.load(drive / "results" / "matches.npz")
        assert place.tolist() == (batch.place + 1 - 2 // 2).tolist()


MATCH = "match {d}/map.npz {d}/query.npz -o"
MAP = "map {d}/reference.npz -o {t}/map.npz"


@pytest.mark.parametrize(
    ("line", "code", "says"),
    [
        (f"{MATCH} {{t}}/results --online --every day", 2, "expected event, a number of"),
        (f"{MATCH} {{t}}/results -L 99", 2, "sequence length 99 is longer than the"),
        (f"{MATCH} {{d}}/results", 2, "exists: name another, or replace it"),
        ("match {d}/query.npz {d}/query.npz -o {t}/results", 1, "reference map"),
        (f"{MATCH} {{t}}/results --every 10ms", 2, "add --online"),
        (f"{MATCH} {{t}}/results --matrix {{t}}/d.txt", 2, "does not end in .npy"),
        (f"{MAP} --pixels 50 --strategy seed-code --tau 100ms", 2, "pixels can be drawn before"),
        (f"{MAP} --tau 1h", 2, "expected a time such as 1s"),
        (f"{MAP} --tau 60s", 2, "shorter than one window of 60 s"),
        (f"{MAP} --strategy best", 2, "choose from variance"),
        ("map {d}/reference.npz -o {d}/map.npz", 2, "exists: name another"),
        ("map {t}/none.npz -o {t}/map.npz", 1, "none.npz"),
        ("evaluate {t}/none --ground-truth x.npy --rows query", 1, "run edge-vpr match first"),
        ("evaluate {d}/results --ground-truth x.npy", 2, "whether its rows are reference or query"),
    ],
)
def test_wrong_use_is_one_line_and_leaves_nothing(line, code, says, drive, capsys, tmp_path):
    refused(capsys, *line.format(d=drive, t=tmp_path).split(), code=code, says=says)
    assert not list(tmp_path.iterdir())


def test_an_unreadable_recording_and_an_unknown_format(capsys, tmp_path):
    (tmp_path / "broken.npz").write_bytes(b"PK broken")
    (tmp_path / "drive.xyz").write_bytes(b"what is this?")
    for name in ("broken.npz", "drive.xyz"):
        arguments = ("map", tmp_path / name, "-o", tmp_path / "map.npz")
        code, lines = call(capsys, *arguments)
        assert code in (1, 2)
        assert len(lines) == 1
        assert name in lines[0]


def test_a_recording_of_another_camera(drive, capsys, tmp_path):
    events = random_events(np.random.default_rng(0), 2_000, Sensor(20, 12), 2_000_000)
    write_recording(tmp_path / "other.npz", [events], sensor=Sensor(20, 12))
    arguments = ("match", drive / "map.npz", tmp_path / "other.npz", "-o", tmp_path / "results")
    refused(capsys, *arguments, code=1, says="of a 20x12 sensor and the map of a 16x12 one")
    assert not (tmp_path / "results").exists()


def test_a_folder_that_is_not_ours_is_never_replaced(drive, capsys, tmp_path):
    (tmp_path / "holiday.jpg").write_text("precious")
    arguments = ("match", drive / "map.npz", drive / "query.npz", "-o", tmp_path, "--overwrite")
    refused(capsys, *arguments, code=2, says="is not a folder of edge-vpr's results")
    assert (tmp_path / "holiday.jpg").read_text() == "precious"


def test_an_output_of_ours_is_replaced_when_told(drive, tmp_path):
    arguments = ["match", str(drive / "map.npz"), str(drive / "query.npz"), "-o"]
    arguments += [str(tmp_path / "results"), "--no-figures"]
    assert main(arguments) == 0
    (tmp_path / "results" / "stale.png").write_text("")
    assert main([*arguments, "--overwrite"]) == 0
    assert not (tmp_path / "results" / "stale.png").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


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
def test_of_two_runs_into_one_new_folder_one_wins(line, drive, capsys, tmp_path, monkeypatch):
    """The other run ends while this one waits for the disk, later than all checks of the flags."""
    sync, won = os.fsync, tmp_path / "new"

    def other_ends(handle):
        if not won.exists():
            won.mkdir()
            (won / "run.json").write_text("{}")
        sync(handle)

    monkeypatch.setattr(os, "fsync", other_ends)
    code, lines = call(capsys, *line.format(d=drive).split(), "-o", won)
    assert code == 2, lines
    assert sum(line.startswith("edge-vpr: error: ") for line in lines) == 1
    assert f"another run wrote {won} in the meantime" in lines[-1]
    assert [path.name for path in tmp_path.iterdir()] == ["new"]
    assert [path.name for path in won.iterdir()] == ["run.json"]


def test_a_map_of_another_version(drive, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("edge_vpr.archive.SCHEMA_VERSION", 99)
    write_archive(tmp_path / "map.npz", "reference map", {}, {})
    monkeypatch.undo()
    arguments = ("match", tmp_path / "map.npz", drive / "query.npz", "-o", tmp_path / "results")
    refused(capsys, *arguments, code=1, says="schema version 99 and this edge-vpr reads version")


def test_an_interrupt_leaves_nothing_half_written(drive, capsys, tmp_path, monkeypatch):
    def interrupt(*unused):
        raise KeyboardInterrupt

    monkeypatch.setattr("edge_vpr.match_result.write_csv", interrupt)
    arguments = ("match", drive / "map.npz", drive / "query.npz", "-o", tmp_path / "results")
    code, lines = call(capsys, *arguments)
    assert code == 130
    assert "interrupted" in lines[0]
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
    drive, capsys, tmp_path, monkeypatch, error, says
):
    monkeypatch.setattr("edge_vpr.match_result.write_csv", Mock(side_effect=error))
    arguments = ("match", drive / "map.npz", drive / "query.npz", "-o", tmp_path / "results")
    refused(capsys, *arguments, code=1, says=says)
    _, lines = call(capsys, "--debug", *arguments)
    assert any("Traceback" in line for line in lines)


def test_a_file_of_somebody_else_in_a_results_folder_is_never_deleted(drive, capsys, tmp_path):
    arguments = ["match", str(drive / "map.npz"), str(drive / "query.npz"), "-o"]
    arguments += [str(tmp_path / "results"), "--no-figures"]
    assert main(arguments) == 0
    (tmp_path / "results" / "mine").mkdir()
    refused(capsys, *arguments, "--overwrite", code=2, says="also holds 'mine'")
    assert (tmp_path / "results" / "mine").is_dir()


def test_matches_event_by_event_are_evaluated_by_the_same_command(
    drive, capsys, tmp_path, monkeypatch
):
    arguments = ["match", str(drive / "map.npz"), str(drive / "query.npz"), "--online"]
    assert main([*arguments, "-o", str(tmp_path / "online")]) == 0
    for name in ("reference", "query"):
        (tmp_path / f"{name}.csv").write_text("time_s,position_m\n0,0\n1,10\n2,20\n")
    tracks = [str(tmp_path / f"{name}.csv") for name in ("reference", "query")]
    folder = tmp_path / "online"
    arguments = ["evaluate", str(folder), "--ground-truth", *tracks, "--tolerance", "2"]
    arguments += ["--offset", "0", "0"]
    assert main(arguments) == 0
    assert "P@100R" in capsys.readouterr().out
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
    assert main(arguments) == 0
    evaluation = json.loads((folder / "metrics.json").read_text())["evaluation"]
    some = -(-len(matches) // 3)
    says = f"edge-vpr: one match in 3 is evaluated: {some:,} of {len(matches):,}\n"
    assert evaluation["queries"] == some and says in capsys.readouterr().err


def test_a_matrix_is_declared_by_its_rows_whatever_its_file(drive, tmp_path, capsys):
    results = tmp_path / "results"
    shutil.copytree(drive / "results", results)
    matrix = np.eye(19, dtype=np.uint8)
    np.save(tmp_path / "truth.npy", matrix)
    np.savetxt(tmp_path / "truth.csv", matrix, fmt="%d", delimiter=",")
    evaluations = []
    for name in ("truth.npy", "truth.csv"):
        words = ["evaluate", results, "--ground-truth", tmp_path / name]
        assert main([*map(str, words), "--rows", "reference"]) == 0
        evaluations.append(json.loads((results / "metrics.json").read_text())["evaluation"])
    assert evaluations[0] == evaluations[1]
    refused(capsys, *words, code=2, says="or of a matrix --rows")
    refused(capsys, *words, "--tolerance", 1, code=1, says="and of a matrix its --rows")


def test_info_shows_how_a_track_fits_its_recording(drive, tmp_path, capsys):
    log = line_track(tmp_path / "log.csv", 1, 5, begin=100.5)
    words = ["info", str(drive / "query.npz"), "--track", str(log), "--track-offset", "-100"]
    assert main(words) == 0
    said = capsys.readouterr().out
    line = (
        r"^drive track  5 m from 0\.5 to 1\.5 s, 5 m/s in the mean and 5 m/s at most, longest gap "
    )
    assert re.search(line + r"0\.1 s; covers [45]\d\.\d% of the drive$", said, re.MULTILINE)
    assert main([*words, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)["facts"]
    assert all(text in said for text in facts.values()) and len(facts) == 2
    refused(capsys, "info", drive / "map.npz", "--track", log, code=2, says="--track is of a rec")


def test_map_shows_each_drive_and_its_track(drive, tmp_path, capsys):
    first, second = (line_track(tmp_path / f"{name}.csv", 2, 20) for name in "ab")
    recordings = [str(drive / f"{name}.npz") for name in ("reference", "query")]
    words = ["map", *recordings, "-o", str(tmp_path / "map.npz"), "--tau", "100ms", "--pixels", "5"]
    words += ["--sigma", "1", "--track", str(first), "--track", str(second), "--same-route"]
    assert main(words) == 0
    said = capsys.readouterr().out
    for heading in ("drive", recordings[1]):
        assert re.search(f"^{heading} +[\\d,]+ events in ", said, re.MULTILINE)
        assert re.search(f"^{heading} track +20 m from 0.0 to 2.0 s, 10 m/s", said, re.MULTILINE)


@pytest.mark.slow
def test_by_default_the_place_filter_matches_offline_and_online_alike(drive, capsys, tmp_path):
    flags = ["--pixels", "5", "--tau", "100ms", "--sigma", "1"]
    mapped, query = str(tmp_path / "map.npz"), str(drive / "query.npz")
    assert main(["map", str(drive / "reference.npz"), "-o", mapped, *flags]) == 0
    settings = ReferenceMap.load(mapped).settings
    assert (settings.matching, settings.counter_scaling) == ("filter", "contrast")
    whole, live = tmp_path / "whole", tmp_path / "live"
    assert main(["match", mapped, query, "-o", str(whole), "--no-smooth"]) == 0
    arguments = ["match", mapped, query, "-o", str(live), "--online", "--every", "window"]
    assert main(arguments) == 0
    batch, online = (Matches.load(folder / "matches.npz") for folder in (whole, live))
    assert online.place.tolist()[: len(batch)] == batch.place.tolist()
    assert online.trust.tolist()[: len(batch)] == batch.trust.tolist()
    record = json.loads((live / "run.json").read_text())
    assert record["settings"]["smooth"] is False
    truth = np.eye(batch.places_in_map, len(batch), dtype=np.uint8)
    np.save(tmp_path / "truth.npy", truth)
    arguments = ["evaluate", str(whole), "--ground-truth", str(tmp_path / "truth.npy")]
    assert main([*arguments, "--rows", "reference"]) == 0
    metrics = json.loads((whole / "metrics.json").read_text())
    assert metrics["evaluation"]["score"] == "trust"


def test_calibrating_says_what_it_learnt_from(drive, capsys, tmp_path):
    flags = ["--pixels", "5", "--tau", "100ms", "--sigma", "1"]
    mapped, query = str(tmp_path / "map.npz"), str(drive / "query.npz")
    assert main(["map", str(drive / "reference.npz"), "-o", mapped, *flags]) == 0
    (tmp_path / "track.csv").write_text("time_s,position_m\n0,0\n1,10\n2,20\n3,30\n")
    truth = ["--ground-truth", *[str(tmp_path / "track.csv")] * 2, "--tolerance", "5"]
    truth += ["--offset", "0", "0"]
    for every in ("window", "50ms"):
        folder = str(tmp_path / every)
        match = ["match", mapped, query, "--no-figures", "--online", "--every", every]
        assert main([*match, "-o", folder]) == 0
        assert main(["calibrate", folder]) == 2
        assert f"run edge-vpr evaluate {folder} first" in capsys.readouterr().err
        assert main(["evaluate", folder, *truth]) == 0
        capsys.readouterr()
        assert main(["calibrate", folder, "-o", folder + ".npz"]) == 0
        assert re.search(
            r"from \d+ matches, \d+ of them correct and 0 off the map", capsys.readouterr().out
        )
    # a damaged file, or another truth than that of the evaluation, ends it before it saves
    none, metrics = tmp_path / "none.npz", tmp_path / "50ms/metrics.json"
    whole = metrics.read_text()
    metrics.write_text("{")
    assert main(["calibrate", folder, "-o", str(none)]) == 2
    metrics.write_text(whole)
    (tmp_path / "track.csv").write_text("time_s,position_m\n0,0\n3,30\n")
    capsys.readouterr()
    assert main(["calibrate", folder, "-o", str(none)]) == 2
    assert "has moved or changed since the evaluation" in capsys.readouterr().err
    assert not none.exists()


def test_a_map_says_that_its_places_are_at_half_windows(drive, tmp_path, capsys):
    """Where it is made, matched and reported."""
    mapped, query, half = str(tmp_path / "map.npz"), str(drive / "query.npz"), "(at half windows)"
    small = ["--tau", "100ms", "--pixels", "5"]
    for words, shown in (([], True), (["--places-per-window", "1"], False)):
        make = ["map", str(drive / "reference.npz"), "-o", mapped, "--overwrite", *small, *words]
        assert main(make) == 0
        assert (half in capsys.readouterr().out) == shown
        out = tmp_path / str(shown)
        assert main(["match", mapped, query, "-o", str(out), "--figures", "svg"]) == 0
        assert (half in capsys.readouterr().out) == shown
        assert (half in (out / "report.html").read_text()) == shown
        label = "reference place, at half windows"
        assert (label in (out / "distance_matrix.svg").read_text()) == shown


@pytest.mark.parametrize("link", ["itself", "symbolic", "hard"])
@pytest.mark.parametrize("command", ["map", "convert"])
def test_no_command_writes_over_its_input_by_whatever_name(drive, tmp_path, capsys, command, link):
    source, output = tmp_path / "drive.npz", tmp_path / "other.npz"
    before = (drive / "reference.npz").read_bytes()
    source.write_bytes(before)
    if link == "itself":
        output = source
    elif link == "symbolic":
        output.symlink_to(source)
    else:
        output.hardlink_to(source)
    arguments = [source, "-o", output, *SMALL] if command == "map" else [source, output]
    refused(capsys, command, *arguments, "--overwrite", code=2, says="is the input")
    assert source.read_bytes() == before


def test_match_does_not_replace_the_folder_that_its_map_or_drive_lies_in(drive, tmp_path, capsys):
    folder = tmp_path / "results"
    shutil.copytree(drive / "results", folder)
    shutil.copy(drive / "query.npz", folder)
    for arguments in (
        (folder / "map.npz", drive / "query.npz"),
        (drive / "map.npz", folder / "query.npz"),
    ):
        for more in ([], ["--online"]):
            refused(
                capsys, "match", *arguments, "-o", folder, "--overwrite", *more,
                code=2, says="holds the input",
            )  # fmt: skip
    assert (folder / "query.npz").is_file()


@pytest.mark.parametrize("more", [[], ["--online"]])
def test_a_damaged_map_is_an_error_and_not_a_crash(drive, tmp_path, capsys, more):
    whole = bytearray((drive / "map.npz").read_bytes())
    whole[len(whole) // 2] ^= 4
    (tmp_path / "map.npz").write_bytes(whole)
    refused(
        capsys, "match", tmp_path / "map.npz", drive / "query.npz", "-o", tmp_path / "out", *more,
        code=1, says="map.npz",
    )  # fmt: skip
    assert not (tmp_path / "out").exists()


def line_track(path, seconds, metres, begin=0.0):
    """A table of a drive along a line."""
    rows = [f"{begin + i / 10},{metres * i / (10 * seconds)}" for i in range(10 * seconds + 1)]
    path.write_text("\n".join(["time_s,position_m", *rows]) + "\n")
    return path


@pytest.mark.slow
def test_evaluate_shows_what_a_log_covers_and_sets_clocks_right(drive, tmp_path, capsys):
    results = tmp_path / "results"
    shutil.copytree(drive / "results", results)
    reference = line_track(tmp_path / "reference.csv", 2, 20)
    late = line_track(tmp_path / "late.csv", 2, 20, begin=1.0)
    evaluate = ["evaluate", str(results), "--tolerance", "2", "--ground-truth", str(reference)]
    assert main([*evaluate, str(late)]) == 0
    said = capsys.readouterr().out
    assert re.search(r"query track +20 m from 1\.0 to 3\.0 s, .*; covers [45]\d\.\d% of the", said)
    assert main([*evaluate, str(late), "--offset", "0", "-1"]) == 0
    said = capsys.readouterr()
    assert said.err == "" and re.search(r"query track .*; covers 100\.0% of the drive", said.out)
    refused(capsys, *evaluate, "--offset", 0, 5, code=2, says="give two tracks")


def test_one_log_for_both_drives_is_refused(drive, tmp_path, capsys):
    """By name, or a copy of it; with an offset it is one log of both."""
    results = tmp_path / "results"
    shutil.copytree(drive / "results", results)
    log = line_track(tmp_path / "log.csv", 2, 20)
    shutil.copy(log, tmp_path / "copy.csv")
    evaluate = ["evaluate", str(results), "--tolerance", "2", "--ground-truth", str(log)]
    for other in (log, tmp_path / "copy.csv"):
        refused(capsys, *evaluate, other, code=2, says="both are the same log: name that of")
    assert main([*evaluate, str(log), "--offset", "0", "0"]) == 0


def test_a_damaged_record_of_metrics_is_named(drive, tmp_path, capsys):
    results = tmp_path / "results"
    shutil.copytree(drive / "results", results)
    reference = line_track(tmp_path / "reference.csv", 2, 20)
    evaluate = ["evaluate", results, "--tolerance", "2", "--ground-truth", reference, reference]
    evaluate += ["--offset", 0, 0]
    for text in ("{", "[1]", "[" * 100_000, '{"queries": NaN}'):
        (results / "metrics.json").write_text(text)
        refused(capsys, *evaluate, code=2, says="metrics.json")


def test_a_damaged_record_of_a_run_is_named(drive, tmp_path, capsys):
    results = tmp_path / "results"
    shutil.copytree(drive / "results", results)
    reference = line_track(tmp_path / "reference.csv", 2, 20)
    evaluate = ["evaluate", results, "--tolerance", "2", "--ground-truth", reference, reference]
    evaluate += ["--offset", 0, 0]
    for change in (
        {"inputs": [{"path": "a"}]},
        {"inputs": 3},
        {"settings": [1]},
        {"machine": None},
    ):
        record = json.loads((drive / "results" / "run.json").read_text())
        (results / "run.json").write_text(json.dumps(record | change))
        refused(capsys, *evaluate, code=2, says="run.json")


def test_the_name_of_a_file_cannot_write_on_the_terminal(tmp_path, capsys):
    name = "drive\x1b[2J\x1b]0;owned\x07\n\u202ezpn.csv"
    refused(capsys, "map", tmp_path / name, "-o", tmp_path / "m.npz", code=1, says="drive\\x1b[2J")
    assert main(["match", str(tmp_path / name), "q.npz", "-o", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.rstrip("\n").isprintable()


@pytest.mark.parametrize("log", ["metres", "none"])
def test_tau_auto_fits_the_window_to_a_slow_robot(log, tmp_path, capsys):
    drives = tmp_path / "drives"
    words = ["simulate", "-o", drives, "--sensor", "tiny", "--length", "15", "--speed", "1"]
    assert main([str(word) for word in words]) == 0
    file = drives / "reference_track.csv"
    track = [] if log == "none" else ["--track", str(file)]

    def mapped(*flags):
        path = tmp_path / "map.npz"
        words = ["map", str(drives / "reference.npz"), "-o", str(path), "--overwrite", *track]
        assert main([*words, "--pixels", "50", "--sigma", "1", *flags]) == 0
        return ReferenceMap.load(path), capsys.readouterr().err

    short, warned = mapped("--tau", "500ms")
    assert ("in a window" in warned) == (log == "metres")
    named = int(re.search(r"map with --tau (\d+)ms", warned)[1])
    fitting, warned = mapped("--tau", "auto")
    assert "map with --tau" not in warned
    if log == "metres":
        travel_m = np.median(np.diff(fitting.along_mm[:: fitting.settings.window_parts])) / 1e3
        assert 2 <= travel_m <= 3
    else:
        assert fitting.windows.selected_events.mean() / len(fitting.pixel_map) > 2
    assert fitting.settings.tau_us > short.settings.tau_us
    assert abs(named * 1_000 - fitting.settings.tau_us) <= 0.3 * fitting.settings.tau_us


def test_a_query_that_does_not_say_its_sensor_has_that_of_the_map(drive, tmp_path):
    """For every command that reads it beside the map or the matches."""
    events = join_events(list(open_recording(drive / "query.npz")))
    columns = [events[name] for name in "txyp"]
    np.savetxt(tmp_path / "query.csv", np.column_stack(columns), fmt="%d", delimiter=",")
    reference, query = drive / "map.npz", tmp_path / "query.csv"
    for words in (
        ["match", reference, query, "-o", tmp_path / "m", "--no-figures"],
        ["match", reference, query, "-o", tmp_path / "live", "--online", "--no-figures"],
        ["replay", tmp_path / "live", "-o", tmp_path / "film.gif", "--frames", "2"],
        ["map", reference, query, "-o", tmp_path / "learnt.npz", "--same-route"],
        ["golden", "--map", reference, "--recording", query, "--suite", "recording",
         "-o", tmp_path / "vectors"],
    ):  # fmt: skip
        assert main([str(word) for word in words]) == 0
    of_sensor = Matches.load(drive / "results" / "matches.npz")
    np.testing.assert_array_equal(Matches.load(tmp_path / "m/matches.npz").place, of_sensor.place)
