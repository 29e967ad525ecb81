"""The jobs of the commands, called from Python without a command line."""

from __future__ import annotations

import json
import time

from edge_vpr_tools.cli import main
from edge_vpr_tools.commands.info import summarise
from edge_vpr_tools.runs.mapping import calibrate
from edge_vpr_tools.runs.truth_files import load_truth
from test_commands import drive  # noqa: F401

from edge_vpr.pipeline import describe_query, match_query
from edge_vpr.recordings import open_recording
from edge_vpr.reference_map import MatchResult, ReferenceMap
from edge_vpr.results import to_json


def test_building_and_matching_give_what_the_commands_write(drive, tmp_path):  # noqa: F811
    """A map made of the settings of the command's map is the same, and so are the matches."""
    written = ReferenceMap.load(drive / "map.npz")
    made = ReferenceMap.build(drive / "reference.npz", written.settings)
    assert made == written

    found = made.match(drive / "query.npz")
    flags = [str(drive / "map.npz"), str(drive / "query.npz"), "--no-figures"]
    assert main(["match", *flags, "-o", str(tmp_path / "windows")]) == 0
    again = MatchResult.load(tmp_path / "windows")
    assert (again.matches, again.queries, again.reference) == (found.matches, found.queries, made)
    found.save(tmp_path / "saved")
    names = {file.name for file in (tmp_path / "windows").iterdir()} - {"report.html"}
    assert {file.name for file in (tmp_path / "saved").iterdir()} == names
    assert (tmp_path / "saved/matches.csv").read_bytes() == (
        tmp_path / "windows/matches.csv"
    ).read_bytes()
    metrics = [
        json.loads((tmp_path / n / "metrics.json").read_text()) for n in ("saved", "windows")
    ]
    assert metrics[0].keys() == metrics[1].keys()
    (recording,) = json.loads((tmp_path / "saved/run.json").read_text())["inputs"]
    assert recording["path"] == str(drive / "query.npz")

    online = made.match(drive / "query.npz", every="20ms")
    command = ["match", *flags, "--online", "--every", "20ms", "-o", str(tmp_path / "online")]
    assert main(command) == 0
    again = MatchResult.load(tmp_path / "online")
    assert (again.matches, again.queries) == (online.matches, None)

    truth = tmp_path / "truth.csv"
    truth.write_text("query_s,reference_s\n0,0\n1000,1000\n")
    times = (made.places.centre_us, found.queries.centre_us)
    known = load_truth([str(truth)], *times, tolerance=0.3, rows=None, frame_period=None)
    learnt = calibrate(made, found.matches, known)
    assert 0 < learnt.matches <= len(found.matches) and 0 <= learnt.right <= learnt.matches
    assert learnt.reference.confidence == learnt.confidence


def test_a_recording_is_summed_up_as_info_says(drive, capsys):  # noqa: F811
    """The record's fields are those of `--json`."""
    path = drive / "query.npz"
    found = summarise(open_recording(path))
    assert main(["info", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == to_json(found)
    assert found.events_per_s == found.events * 1e6 / found.duration_us


def test_times_are_without_compilation(drive, tmp_path, monkeypatch):  # noqa: F811
    """Kernels that load in a first call, or when a whole drive comes, are in no time of a match."""
    calls = {"describe_query": 0, "match_query": 0}
    longest = 0

    def slow(name, original):
        def call(*args, **kwargs):
            nonlocal longest
            calls[name] += 1
            new = calls[name] == 1
            if name == "match_query" and len(args[1]) > longest:
                longest, new = len(args[1]), True
            if new:
                time.sleep(0.3)
            return original(*args, **kwargs)

        return call

    for original in (describe_query, match_query):
        name = original.__name__
        monkeypatch.setattr(f"edge_vpr.reference_map.{name}", slow(name, original))
    out = tmp_path / "run"
    words = ["match", str(drive / "map.npz"), str(drive / "query.npz"), "-o", str(out)]
    assert main([*words, "--no-figures"]) == 0
    found = json.loads((out / "metrics.json").read_text())
    assert calls["match_query"] > 1
    assert found["counting_s"] < 0.3 and found["matching_s"] < 0.3
