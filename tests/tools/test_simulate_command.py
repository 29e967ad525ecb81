"""The command `edge-vpr simulate`: what it writes can be read back and is the simulated pair."""

from __future__ import annotations

import argparse
import json

import numpy as np
import pytest
from edge_vpr_tools import cli
from edge_vpr_tools.commands import simulate
from edge_vpr_tools.commands.simulate import SENSORS

from edge_vpr.evaluation.track_files import load_track
from edge_vpr.events import join_events
from edge_vpr.recordings import open_recording
from edge_vpr.simulation import CAMERAS, QUERY, REFERENCE, simulate_pair


def run(*arguments):
    cli.run(["simulate", *(str(argument) for argument in arguments)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulate") / "pair"
    run("-o", folder, "--sensor", "tiny", "--length", 10, "--seed", 4)
    return folder


def test_the_files_hold_the_events_and_the_ground_truth_of_the_pair(folder):
    pair = simulate_pair(4, "tiny", length_m=10)
    for name, simulated in zip(("reference", "query"), pair, strict=True):
        recording = open_recording(folder / f"{name}.npz")
        assert recording.sensor == simulated.sensor
        assert np.array_equal(join_events(list(recording)), join_events(list(simulated)))
        track = load_track(folder / f"{name}_track.csv")
        assert np.array_equal(track.time_us, simulated.track.time_us)
        assert np.abs(track.position - simulated.track.position).max() < 1e-4
        # metres of the wheels are positions along the route too
        wheels = load_track(folder / f"{name}_odometry.csv")
        true_m = np.interp(wheels.time_us, track.time_us, track.position[:, 0])
        assert np.abs(wheels.position[:, 0] - true_m).max() < 1.0


def test_what_was_simulated_is_noted_beside_it(folder):
    settings = json.loads((folder / "run.json").read_text())["settings"]
    assert settings["reference"]["drive"]["speed_range"] == 1.08
    assert settings["query"]["drive"]["speed_range"] == 2.0
    assert settings["query"]["camera"]["contrast_on"] == CAMERAS["tiny"].contrast_on
    assert settings["query"]["world"] == {"length_m": 10, "seed": 4}


def test_a_rover_drives_at_the_speed_it_is_told(tmp_path):
    run("-o", tmp_path / "slow", "--sensor", "tiny", "--length", 10, "--seed", 4, "--speed", 1.5)
    pair = simulate_pair(4, "tiny", length_m=10)
    for name, usual in zip(("reference", "query"), pair, strict=True):
        seconds = load_track(tmp_path / "slow" / f"{name}_track.csv").time_us[-1] / 1e6
        assert seconds == pytest.approx(4 * usual.duration_us / 1e6, rel=0.01)


def test_the_sensors_offered_are_the_cameras_there_are():
    assert set(SENSORS) == set(CAMERAS)
    (speed,) = {REFERENCE.speed_mps, QUERY.speed_mps}
    parser = argparse.ArgumentParser()
    simulate.add_arguments(parser)
    assert parser.parse_args(["-o", "street"]).speed == speed
