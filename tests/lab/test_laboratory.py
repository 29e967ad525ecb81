"""The command of the laboratory, its loop, and each experiment once on its smallest drives."""

from __future__ import annotations

import csv
import importlib
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import pytest
from lab.__main__ import main
from lab.experiments import EXPERIMENTS, fixed_number, rivals
from lab.loop import DRIVES, Drives, Experiment, open_experiment, run_trial, trials_of
from lab.plots import dots

from edge_vpr.simulation import simulate_pair
from tests.lab.in_process import walks_in


@pytest.fixture(autouse=True)
def workers_of_this_process(monkeypatch):
    """Processes take two seconds to start, and do not see what a test has changed."""
    monkeypatch.setattr("lab.__main__.processes", lambda count: ThreadPoolExecutor(1))


def refused(capsys, *arguments, code, says):
    """Check for one line on standard error, beside those of trials, that says what is wrong."""
    assert main([str(each) for each in arguments]) == code
    *trials, line = capsys.readouterr().err.splitlines()
    assert all(": trial " in each for each in trials)
    assert says in line and line.startswith("edge-vpr: error: ")


#: what an experiment says of a folder without drives
WITHOUT = {
    "speck-walks": "two walks with a Speck, 128 x 128, in short frames",
    **dict.fromkeys(("codes", "mount-shift", "trust"), "records/10494919"),
}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_says_where_its_data_come_from(name, capsys, tmp_path):
    arguments = (name, "--data", tmp_path, "-o", tmp_path)
    if not open_experiment(name).reads_data:
        refused(capsys, *arguments, code=2, says=f"experiment {name} reads no --data: leave it out")
    elif name in WITHOUT:
        refused(capsys, *arguments, code=2, says=WITHOUT[name])
    arguments = (name, "--data", tmp_path / "none")
    refused(capsys, *arguments, code=2, says="none is not a folder: name the one that holds")


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    return walks_in(tmp_path_factory.mktemp("data"), 128)


#: sequences of 20 windows, sequences of 5 at four times the speed, drives that are aligned, and
#: tolerances that most pairs of a short street are within
LONG = (
    "rivals", "fixed-number", "several-drives", "calibration", "places-per-window", "robustness",
)  # fmt: skip


@pytest.mark.filterwarnings("ignore::edge_vpr.errors.EdgeVprWarning")  # noise is no route
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_runs_on_its_smallest_drives(name, walks, monkeypatch):
    def street(seed, *device, **more):
        length_m = 150.0 if name in LONG else 60.0
        return simulate_pair(seed, "tiny", **{**more, "length_m": length_m})

    module = f"lab.experiments.{name.replace('-', '_')}"
    for each in ("lab.drives", module):
        if hasattr(importlib.import_module(each), "simulate_pair"):
            monkeypatch.setattr(f"{each}.simulate_pair", street)
    experiment = open_experiment(name)
    trial, *_ = trials_of(name, walks if experiment.reads_data else None, 1)
    rows = run_trial(trial)
    assert all(set(experiment.names) <= row.keys() for row in rows)
    measured = set().union(*rows) - {*experiment.names, "drives"}
    assert any(isinstance(row.get(each), float) for row in rows for each in measured)
    if experiment.figure is not None:
        drawing = experiment.figure([{DRIVES: trial.drives, **row} for row in rows])
        assert drawing.axes


def test_the_command_runs_on_processes_and_makes_the_published_table(tmp_path):
    """Of the one experiment that only computes."""
    words = [sys.executable, "-m", "lab", "joules", "--workers", "2", "-o", tmp_path]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "1,000 places:\n\n| system | device |" in done.stdout
    assert {path.name for path in tmp_path.iterdir()} == {"joules.csv"}
    with (tmp_path / "joules.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) > 10


def declared(name, ran):
    """An experiment on two drives, which notes what it measures."""

    def measure(draw):
        ran.append((draw.pair, draw.seed, draw.systems))
        for system in ("one", "two"):
            yield {"system": system, "P@100R": 0.5 + draw.seed / 10, "change": -0.25}

    return Experiment(
        drives=lambda data: [
            Drives("street", lambda seed: f"{name} {seed}", varied=True),
            Drives("given", lambda seed: name, drawn=False),
        ],
        names=("system",),
        measure=measure,
        figure=partial(dots, measure="P@100R", row="system", series="system"),
        takes_systems=name == "rivals",
    )


def test_the_rows_of_all_trials_are_a_table_and_a_figure(capsys, tmp_path, monkeypatch):
    ran = []
    for module, name in ((rivals, "rivals"), (fixed_number, "fixed-number")):
        monkeypatch.setattr(module, "EXPERIMENT", declared(name, ran))
    assert main(["rivals", "fixed-number", "--seeds", "2", "-o", str(tmp_path / "results")]) == 0
    shown, progress = capsys.readouterr()
    # in the order in which they end
    assert sorted(re.sub(r"\d of 6, after \d+ s", "n", line) for line in progress.splitlines()) == [
        f"edge-vpr: {name}, {drives}: trial n"
        for name in ("fixed-number", "rivals")
        for drives in ("given, seed 0", "street, seed 0", "street, seed 1")
    ]
    assert "rivals:\n\nstreet, ± over 2 seeds:\n\n| system | P@100R | change |" in shown
    assert "| one | 0.550 ± 0.071 | -0.250 ± 0.000 |" in shown and "fixed-number:\n" in shown
    assert len(ran) == 2 * 3
    names = {path.name for path in (tmp_path / "results").iterdir()}
    assert names == {
        f"{name}.{kind}" for name in ("rivals", "fixed-number") for kind in ("csv", "svg")
    }
    written = (tmp_path / "results/rivals.csv").read_text().splitlines()
    assert written[:2] == ["drives,system,seed,P@100R,change", "street,one,0,0.5,-0.25"]
    assert len(written) == 7
    assert (tmp_path / "results/rivals.svg").read_text().count("<svg ") == 1
    ran.clear()
    systems = ["--with", "hog", "--with", "model:a.onnx"]
    assert main(["rivals", "--seeds", "1", *systems, "-o", str(tmp_path / "results")]) == 0
    assert [draw[2] for draw in ran] == [("hog", "model:a.onnx")] * 2
    capsys.readouterr()
    # before any of them is run
    refused(capsys, "fixed-number", "--with", "hog", code=2, says="leave --with out")
    assert len(ran) == 2


def test_a_trial_that_fails_is_named_and_the_others_are_not_run_again(
    capsys, tmp_path, monkeypatch
):
    ran, lucky = [], []
    usual = declared("rivals", ran)

    def measure(draw):
        if draw.pair == "rivals 1" and not lucky:
            raise ValueError("no luck")
        yield from usual.measure(draw)

    monkeypatch.setattr(rivals, "EXPERIMENT", replace(usual, measure=measure))
    arguments = ("rivals", "--seeds", "2", "-o", tmp_path / "out")
    refused(capsys, *arguments, code=1, says="rivals, street, seed 1: internal error, ValueError")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["rivals.jsonl"]
    assert len(ran) == 2
    lucky.append(True)
    assert main([*map(str, arguments), "--resume"]) == 0
    assert [draw[0] for draw in ran[2:]] == ["rivals 1"]
    resumed = (tmp_path / "out/rivals.csv").read_text()
    assert not (tmp_path / "out/rivals.jsonl").exists()
    assert main([*map(str, arguments)]) == 0
    assert (tmp_path / "out/rivals.csv").read_text() == resumed
    (tmp_path / "out/rivals.jsonl").write_text('["street", 0, [], [{"sys')
    capsys.readouterr()
    refused(capsys, *arguments, "--resume", code=2, says="rivals.jsonl, line 1 is cut off")
