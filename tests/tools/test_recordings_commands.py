"""`edge-vpr info` and `edge-vpr convert`: what they print, write and refuse."""

from __future__ import annotations

import io
import json
import re
import sys

import numpy as np
import pytest
from edge_vpr_tools import cli
from edge_vpr_tools.console import watched, with_progress

from edge_vpr.events import Sensor, join_events, make_events
from edge_vpr.recordings import WRITTEN, open_recording, write_recording
from edge_vpr.simulation import simulate_pair

SENSOR = Sensor(40, 30)
EVENTS = make_events([0, 500_000, 500_000, 2_000_000], [1, 2, 3, 39], [1, 2, 3, 29], [1, 0, 1, 1])


def test_info_says_what_a_recording_holds(tmp_path, run):
    write_recording(tmp_path / "a.npz", EVENTS, sensor=SENSOR, start_us=77)
    out, err = run("info", tmp_path / "a.npz")
    assert err == ""  # no bar in a pipe
    assert out.splitlines() == [
        "format    npz (NumPy archive of events)",
        "sensor    40x30",
        "events    4",
        "duration  2.000000 s",
        "rate      2 events/s",
        "polarity  75.0% ON, 25.0% OFF",
        "times     0 to 2,000,000 µs from the start",
        "start     77 µs on the file's clock",
        "faults    none",
    ]


def test_info_of_a_sensor_that_is_not_stated_says_how_far_the_events_reach(tmp_path, run):
    (tmp_path / "a.csv").write_text("t,x,y,p\n0,1,2,1\n1000,5,90,0\n9000000,30,4,1\n")
    lines = run("info", tmp_path / "a.csv").out.splitlines()
    assert lines[1] == "sensor    not stated: --sensor WxH; largest x 30, y 90"
    assert lines[2:4] == ["events    3", "duration  9.000000 s"]
    facts = json.loads(run("info", tmp_path / "a.csv", "--json").out)
    assert (facts["sensor"], facts["largest_x"], facts["largest_y"]) == (None, 30, 90)
    assert facts["faults"]["off_sensor"] == 0


def test_info_counts_faults_and_goes_on(tmp_path, run):
    (tmp_path / "a.csv").write_text("0,1,1,1\n9,1,1,0\n8,1,1,0\n9,40,1,1\n10,1,1,1\nx,y,z,p\n11,1")
    words = ["info", tmp_path / "a.csv", "--sensor", "40x30"]
    facts = json.loads(run(*words, "--json").out)
    expected = {"backwards": 1, "off_sensor": 1, "unreadable": 1, "undated": 0, "truncated": 4}
    assert facts["faults"] == expected
    assert (facts["events"], facts["first_us"], facts["last_us"]) == (3, 0, 10)
    assert (facts["sensor"], facts["format"], facts["events_per_s"]) == ("40x30", "csv", 3e5)
    last = run(*words).out.splitlines()[-1]
    assert last == "faults    1 backwards, 1 off sensor, 1 unreadable, 4 truncated bytes"


def test_info_of_a_single_event_has_no_rate(tmp_path, run):
    write_recording(tmp_path / "a.raw", EVENTS[:1], sensor=SENSOR)
    assert json.loads(run("info", tmp_path / "a.raw", "--json").out)["events_per_s"] is None
    assert "rate      -" in run("info", tmp_path / "a.raw").out


@pytest.mark.parametrize(("first", "second"), [(".csv", ".txt"), (".npz", ".raw")])
def test_convert_goes_from_one_format_to_another(first, second, tmp_path, run):
    pytest.importorskip("pyarrow")
    write_recording(tmp_path / f"a{first}", EVENTS, sensor=SENSOR)
    flags = ["--sensor", "40x30"] if first == ".csv" else []
    out, err = run("convert", tmp_path / f"a{first}", tmp_path / f"b{second}", *flags)
    assert (out, err) == (f"{tmp_path / f'b{second}'}: 4 events of 40x30\n", "")
    again = open_recording(tmp_path / f"b{second}", sensor=SENSOR)
    assert np.array_equal(join_events(list(again)), EVENTS)


def test_the_help_of_convert_names_every_suffix_that_can_be_written(capsys):
    with pytest.raises(SystemExit):
        cli.main(["convert", "--help"])
    shown = capsys.readouterr().out
    assert [suffix for suffix in WRITTEN if suffix not in shown] == []


def test_convert_stops_at_faults_or_drops_and_counts_them(tmp_path, run, refused):
    (tmp_path / "a.csv").write_text("0,1,1,1\n9,1,1,0\n8,1,1,0\n")
    words = ["convert", tmp_path / "a.csv", tmp_path / "b.npz", "--sensor", "40x30"]
    assert "event 2: time runs backwards" in refused(*words, code=1)
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]
    dropped = "2 events of 40x30; dropped as faulty: 1 backwards"
    assert dropped in run(*words, "--on-fault", "drop").out


def test_convert_replaces_only_when_told(tmp_path, run, refused):
    write_recording(tmp_path / "a.npz", EVENTS, sensor=SENSOR)
    (tmp_path / "b.raw").write_text("mine")
    words = ["convert", tmp_path / "a.npz", tmp_path / "b.raw"]
    assert "exists: name another, or replace it with --overwrite" in refused(*words)
    assert (tmp_path / "b.raw").read_text() == "mine"
    run(*words, "--overwrite")
    assert open_recording(tmp_path / "b.raw").format == "evt2"


def test_a_terminal_gets_a_bar_and_the_events_all_the_same(tmp_path, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    write_recording(tmp_path / "a.npz", EVENTS, sensor=SENSOR)
    recording = watched(open_recording(tmp_path / "a.npz"), "reading it")
    assert recording.sensor == SENSOR
    for _ in range(2):
        assert np.array_equal(join_events(list(recording)), EVENTS)
    assert "reading it" in terminal.getvalue()
    drive, _ = simulate_pair(0, "tiny", length_m=20)
    assert sum(events.size for events in with_progress(drive, "driving")) > 0
    # the share that was driven is known, and so is the time that is left
    assert re.search(r"driving.*left: \S*0:00:0", terminal.getvalue())
