"""The Event-LAB adapter on files of Event-LAB's form; Event-LAB itself is imitated."""

from __future__ import annotations

import importlib.util
import json
import sys
import types
from pathlib import Path

import h5py
import numpy as np
import pytest
from edge_vpr_tools import cli
from streams import random_events

from edge_vpr.events import Sensor

ADAPTER = Path(__file__).parents[2] / "tools/adapters/event_lab"
SENSOR = Sensor(16, 12)
BEGIN_S = 1_587_452_582


class EventBaseline:
    """What the adapter uses of Event-LAB's class of this name."""

    def run_metrics(self, names, arrays, truth, timestamp, name, pair, **more):
        self.evaluated = names, arrays, truth, more
        return ["row"], {"curve": 1}

    def save_results(self, rows, curves, name, pair):
        self.saved = rows, curves, name, pair


def load(name):
    spec = importlib.util.spec_from_file_location(f"baselines.{name}", ADAPTER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def adapter(monkeypatch):
    pytest.importorskip("yaml", reason="Event-LAB has PyYAML, edge-vpr needs none")
    lab = types.ModuleType("baselines.EventBaselineLab")
    lab.EventBaseline = EventBaseline
    for name in ("baselines", "baselines.edge_vpr_matrix", "baselines.edge_vpr"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    monkeypatch.setitem(sys.modules, "baselines.EventBaselineLab", lab)
    load("edge_vpr_matrix")
    return load("edge_vpr")


class Drive:
    """Event-LAB's data set of one sequence."""

    def __init__(self, folder, name, seed):
        self.name, self.folder = name, folder
        rng = np.random.default_rng(seed)
        events = random_events(rng, 3_000, SENSOR, 2_000_000)
        with h5py.File(folder / f"{name}.hdf5", "w") as file:
            for column in "xyp":
                file[f"events/{column}"] = events[column].astype(np.int16)
            file["events/t"] = (events["t"] + BEGIN_S * 1_000_000) * 1_000
        self.frames = folder / f"{name}-frames-100"
        self.frames.mkdir()
        for i in range(14):
            frame = rng.integers(0, 5, (12, 16, 2)).astype(np.float32)
            np.save(self.frames / f"frame_{i:06d}.npy", frame)
        np.save(self.frames / "event_frame_times_ticks.npy", np.arange(14))
        metadata = {"start_tick": 5, "ticks_per_second": 1e9, "timewindow_ms": 100.0}
        (self.frames / "metadata.json").write_text(json.dumps(metadata))

    def get_dataset_info(self):
        return {
            "dataset_name": "imitated",
            "sequence_name": self.name,
            "hdf5_path": str(self.folder / f"{self.name}.hdf5"),
            "file_path": {f"{self.name}-frames-100": str(self.frames)},
        }


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("event_lab")
    return Drive(folder, "sunset1", 1), Drive(folder, "sunset2", 2)


def prepared(adapter, drives, folder, more=None, **configured):
    baseline = adapter.EdgeVprBaseline()
    baseline.outdir = folder
    settings = {"pixels": 5, "sigma": 1.0, "sequence_length": 2}
    baseline.baseline_config |= {
        "program": [sys.executable, "-m", "edge_vpr_tools.cli"], "settings": settings,
        **configured,
    }  # fmt: skip
    dataset = {
        "dataset": {"resolution": [16, 12]},
        "other": {"offset": {"sunset1": BEGIN_S + 0.25, "sunset2": BEGIN_S - 100.0}},
    }
    dataset |= more or {}
    config = {"frame_generator": "frames", "ground_truth_tolerance": 0.0}
    baseline.format_data(config, dataset, *drives, 100)
    baseline.build_execute(config, dataset, "")
    return baseline


@pytest.mark.slow
def test_event_lab_gets_a_finite_matrix_of_references_by_queries(adapter, drives, tmp_path):
    baseline = prepared(adapter, drives, tmp_path)
    baseline.run()
    truth = tmp_path / "truth.npy"
    # 2 s of windows of 100 ms; the reference begins 0.25 s later, the query where it begins
    np.save(truth, np.eye(17, 19))
    baseline.parse_results(GT=str(truth))
    baseline.cleanup()
    (names, (matrix,), given, more) = baseline.evaluated
    assert names == ["edge_vpr"]
    assert matrix.shape == given.shape
    assert np.isfinite(matrix).all()
    assert more["matrix_type"] == "distance"
    assert baseline.saved[2:] == ("edge_vpr", "sunset1_sunset2")
    # only results may lie where Event-LAB looks for results
    assert [path.name for path in baseline.output_dir.glob("*.npy")] == ["edge_vpr.npy"]


def test_frames_are_taken_as_windows_if_both_drives_have_them(adapter, drives, tmp_path):
    baseline = prepared(adapter, drives, tmp_path, frames=True, program=["edge-vpr"])
    output = tmp_path / "d.npy"
    matrix_module = sys.modules["baselines.edge_vpr_matrix"]
    for words in matrix_module.commands(baseline.request, output, tmp_path):
        assert words[0] == "edge-vpr"
        assert cli.main(words[1:]) == 0
    found = np.load(output)
    assert found.shape == (14, 14)
    assert np.isfinite(found).all()


def test_units_are_those_that_the_data_set_states(adapter, drives, tmp_path):
    other = {"offset": {"sunset1": 1_500_250, "sunset2": 0}, "offset_time_scale": "us"}
    for stated, unit in (
        ({}, "ns"),
        ({"timestamp_val": "us"}, "us"),
        ({"timestamp_val": 1e6}, "us"),
    ):
        more = {"format": {"data": stated}, "other": other}
        request = prepared(adapter, drives, tmp_path, more).request
        assert request.time_unit == unit
        assert (request.reference.offset_s, request.query.offset_s) == ("1.50025", "0")
    request = prepared(adapter, drives, tmp_path, {"format": {"data": {}}}, time_unit="ms").request
    assert request.time_unit == "ms"
    assert request.reference.offset_s == "1587452582.25"
    for more in (
        {"format": {"data": {"timestamp_val": 7}}},
        {"other": {**other, "offset_time_scale": "h"}},
    ):
        with pytest.raises(
            adapter.EdgeVprFailedError, match=r"of the data set is (7|'h'): expected"
        ):
            prepared(adapter, drives, tmp_path, more)


def test_windows_of_a_number_of_events_are_refused(adapter, drives):
    with pytest.raises(adapter.EdgeVprFailedError, match="windows of 100000 events"):
        adapter.EdgeVprBaseline().format_data(
            {"frame_accumulator": "eventcount"}, {}, *drives, 100_000
        )


def test_an_error_of_edge_vpr_is_event_labs_error(adapter, drives, tmp_path):
    module = sys.modules["baselines.edge_vpr_matrix"]
    drive = module.Drive(tmp_path / "none.hdf5")
    for program, words in (
        ([sys.executable, "-m", "edge_vpr_tools.cli"], "none.hdf5 does not exist"),
        (["/no/such/program"], "cannot be started"),
    ):
        request = module.Request(drive, drive, 100, (16, 12), program=program)
        with pytest.raises(module.EdgeVprFailedError, match=words):
            module.write_distance_matrix(request, tmp_path / "d.npy")
