"""The jobs of the commands, called from Python without a command line."""

from __future__ import annotations

import json

import numpy as np
from edge_vpr_tools.cli import main
from edge_vpr_tools.commands.info import summarise
from edge_vpr_tools.results import to_json
from edge_vpr_tools.runs.mapping import calibrate, map_recording
from edge_vpr_tools.runs.matching import localise, made_causal, match_recording, parse_every
from edge_vpr_tools.runs.truth_files import load_truth
from test_commands import drive  # noqa: F401

from edge_vpr.matching.matches import Matches
from edge_vpr.recordings import open_recording
from edge_vpr.reference_map import ReferenceMap


def test_mapping_and_matching_give_what_the_commands_write(drive, tmp_path):  # noqa: F811
    """A map made of the settings of the command's map is the same, and so are the matches."""
    written = ReferenceMap.load(drive / "map.npz")
    made = map_recording(open_recording(drive / "reference.npz"), written.settings)
    assert np.array_equal(made.reference.places.counts, written.places.counts)
    assert made.removed.events > 0 and made.seconds > 0

    query = open_recording(drive / "query.npz")
    found = match_recording(made.reference, query)
    flags = [str(drive / "map.npz"), str(drive / "query.npz"), "--no-figures"]
    assert main(["match", *flags, "-o", str(tmp_path / "windows")]) == 0
    assert np.array_equal(found.matches.place, Matches.load(tmp_path / "windows/matches.npz").place)
    metrics = json.loads((tmp_path / "windows/metrics.json").read_text())
    assert set(to_json(found.metrics(made.reference, query.faults))) == set(metrics)
    assert metrics["queries"] == len(found.matches)

    every = parse_every("20ms", made.reference)
    online = localise(made_causal(made.reference), query, every)
    command = ["match", *flags, "--online", "--every", "20ms", "-o", str(tmp_path / "online")]
    assert main(command) == 0
    assert np.array_equal(online.matches.place, Matches.load(tmp_path / "online/matches.npz").place)

    truth = tmp_path / "truth.csv"
    truth.write_text("query_s,reference_s\n0,0\n1000,1000\n")
    times = (made.reference.places.centre_us, found.queries.centre_us)
    known = load_truth([str(truth)], *times, tolerance=0.3, rows=None, frame_period=None)
    learnt = calibrate(made.reference, found.matches, known)
    assert 0 < learnt.matches <= len(found.matches) and 0 <= learnt.right <= learnt.matches
    assert learnt.reference.confidence == learnt.confidence


def test_a_recording_is_summed_up_as_info_says(drive, capsys):  # noqa: F811
    """The record's fields are those of `--json`."""
    path = drive / "query.npz"
    found = summarise(open_recording(path))
    assert main(["info", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == to_json(found)
    assert found.events_per_s == found.events * 1e6 / found.duration_us
