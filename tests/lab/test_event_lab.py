"""The Event-LAB adapter on files of Event-LAB's form; Event-LAB itself is imitated."""

from __future__ import annotations

import importlib.util
import sys
import types
from pathlib import Path

import h5py
import numpy as np
import pytest

from edge_vpr.events import Sensor
from tests.streams import random_events

ADAPTER = Path(__file__).parents[2] / "tools/lab/event_lab/edge_vpr.py"
SENSOR = Sensor(16, 12)
BEGIN_S = 1_587_452_582
CONFIG = {"frame_generator": "frames", "frame_accumulator": "polarity", "stream": True}
DATA_SET = {
    "dataset": {"resolution": [16, 12]},
    "format": {"data": {"timestamp_val": "ns"}},
    "other": {
        "offset": {"sunset1": BEGIN_S + 0.25, "sunset2": BEGIN_S - 100.0},
        "offset_time_scale": "s",
    },
}


class EventBaseline:
    """What the adapter uses of Event-LAB's class of this name."""

    def run_metrics(self, names, arrays, truth, timestamp, name, pair, **more):
        self.evaluated = names, arrays, truth, more
        return ["row"], {"curve": 1}

    def save_results(self, rows, curves, name, pair):
        self.saved = rows, curves, name, pair


class Drive:
    """Event-LAB's data set of one sequence."""

    def __init__(self, folder, name, seed):
        self.name, self.path = name, folder / f"{name}.hdf5"
        events = random_events(np.random.default_rng(seed), 3_000, SENSOR, 2_000_000)
        with h5py.File(self.path, "w") as file:
            for column in "xyp":
                file[f"events/{column}"] = events[column].astype(np.int16)
            file["events/t"] = (events["t"] + BEGIN_S * 1_000_000) * 1_000

    def get_dataset_info(self):
        return {"dataset_name": "imitated", "sequence_name": self.name, "hdf5_path": str(self.path)}


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("event_lab")
    return Drive(folder, "sunset1", 1), Drive(folder, "sunset2", 2)


@pytest.fixture
def adapter(monkeypatch):
    pytest.importorskip("yaml", reason="Event-LAB has PyYAML, edge-vpr needs none")
    lab = types.ModuleType("baselines.EventBaselineLab")
    lab.EventBaseline = EventBaseline
    monkeypatch.setitem(sys.modules, "baselines", types.ModuleType("baselines"))
    monkeypatch.setitem(sys.modules, "baselines.EventBaselineLab", lab)
    spec = importlib.util.spec_from_file_location("baselines.edge_vpr", ADAPTER)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def baseline(adapter, tmp_path):
    made = adapter.EdgeVprBaseline()
    made.outdir = tmp_path / "output"
    made.baseline_config |= {
        "program": [sys.executable, "-m", "edge_vpr_tools.cli"],
        "settings": {"pixels": 5, "sigma": 1.0, "sequence_length": 2},
    }
    return made


def run_as_event_lab(baseline, config, data_set, drives, truth):
    """Call a baseline as the runner does for one window of time, in milliseconds."""
    # as of 25d5425; earlier runners always call it
    if config["stream"]:
        baseline.format_data(config, data_set, *drives, 100)
    baseline.build_execute(config, data_set, truth)
    baseline.run()
    baseline.parse_results(truth)
    baseline.cleanup()


@pytest.mark.slow
def test_event_lab_gets_a_finite_matrix_of_references_by_queries(baseline, drives, tmp_path):
    truth = tmp_path / "truth.npy"
    # 2 s of windows of 100 ms; the reference begins 0.25 s later, the query where it begins
    np.save(truth, np.eye(17, 19))
    earlier = tmp_path / "output/imitated/sunset1_sunset2/frames_100/edge_vpr.npy"
    earlier.parent.mkdir(parents=True)
    earlier.write_bytes(b"of an earlier run")
    run_as_event_lab(baseline, CONFIG, DATA_SET, drives, str(truth))
    (names, (matrix,), truth_matrix, more) = baseline.evaluated
    assert names == ["edge_vpr"]
    assert matrix.shape == truth_matrix.shape
    assert np.isfinite(matrix).all()
    assert more["matrix_type"] == "distance"
    assert baseline.saved[2:] == ("edge_vpr", "sunset1_sunset2")
    # only results may lie where Event-LAB looks for results
    assert [path.name for path in baseline.output_dir.glob("*.npy")] == ["edge_vpr.npy"]


@pytest.mark.parametrize(
    ("config", "data_set", "error"),
    [
        ({"stream": False}, {}, "set stream to true"),
        ({"frame_accumulator": "eventcount"}, {}, "windows of 100 events are not covered"),
        ({}, {"format": {"data": {"timestamp_val": 7}}}, "timestamp_val of the data set is 7: exp"),
        (
            {},
            {"other": {"offset": {"sunset1": 5}, "offset_time_scale": "us"}},
            "offset_time_scale of the data set is 'us': state other.offset in seconds",
        ),
    ],
)
def test_what_is_not_covered_is_refused_before_edge_vpr_runs(
    adapter, baseline, drives, config, data_set, error
):
    baseline.baseline_config["program"] = ["/no/such/program"]
    with pytest.raises(adapter.EdgeVprFailedError, match=error):
        run_as_event_lab(baseline, CONFIG | config, DATA_SET | data_set, drives, "")


@pytest.mark.parametrize(("stated", "unit"), [(None, "ns"), ("us", "us"), (1e6, "us")])
def test_times_are_of_the_unit_that_the_data_set_states(baseline, drives, stated, unit):
    data_set = {"dataset": DATA_SET["dataset"], "format": {"data": {"timestamp_val": stated}}}
    baseline.format_data(CONFIG, data_set, *drives, 100)
    for words in (baseline.reference, baseline.query):
        assert words[words.index("--time-unit") + 1] == unit
        assert "--start-offset" not in words


def test_an_error_of_edge_vpr_is_event_labs_error(adapter, baseline, drives, tmp_path):
    baseline.format_data(CONFIG, DATA_SET, *drives, 100)
    baseline.reference[0] = str(tmp_path / "none.hdf5")
    with pytest.raises(adapter.EdgeVprFailedError, match=r"none\.hdf5 does not exist"):
        baseline.run()
    baseline.baseline_config["program"] = ["/no/such/program"]
    with pytest.raises(adapter.EdgeVprFailedError, match="cannot be started"):
        baseline.run()
