"""The experiments on published traverses, in small files of the published layout."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from lab import datasets
from lab import drives as drive_pairs
from lab.__main__ import main
from lab.experiments import fixed_number, rivals, trust
from lab.loop import Draw

from edge_vpr.errors import GroundTruthError, UsageError
from edge_vpr.evaluation.ground_truth import GroundTruth, TruePositions
from edge_vpr.events import join_events
from edge_vpr.simulation import simulate_pair
from tests.lab.test_datasets import brisbane, qcr, write_bag, write_log, write_parquet

SECOND = 1_000_000
PAIR = "Brisbane, sunset2 against sunset1"


def write_brisbane(folder, name, kind="parquet", per_second=400, seconds=30):
    """Write a traverse that fires 3 s before its GPS log too.

    In each second, 30 pixels that are 50 columns or rows apart fire in numbers of their
    own, so that every window has events at the selected ones.
    """
    traverse = brisbane(name)
    log = f"{traverse.recording}.nmea" if kind == "parquet" else f"{traverse.video}_concat.nmea"
    first = round((traverse.logs[log] - 3) * SECOND)
    times = first + np.arange((seconds + 3) * per_second) * (SECOND // per_second)
    if kind == "parquet":
        rng = np.random.default_rng(7)
        shares = rng.dirichlet(np.full(30, 0.5), seconds + 3)
        n = 1_326 * np.arange(30)
        fires = np.concatenate([rng.choice(n, per_second, p=share) for share in shares])
        write_parquet(folder / traverse.file_name(kind), times, fires)
    else:
        write_bag(folder / traverse.file_name(kind), times)
    write_log(folder / log, seconds)
    return folder / log


@pytest.fixture(scope="module")
def downloads(tmp_path_factory):
    folder = tmp_path_factory.mktemp("downloads")
    for name in ("sunset1", "sunset2"):
        write_brisbane(folder, name)
    return folder


@pytest.fixture(scope="module")
def pair(downloads):
    """The two traverses, the same drive twice, with few pixels and short sequences."""
    changes = {"pixels": 25, "sequence_length": 3, "sigma": 1.0}
    (both,) = drive_pairs.whole_pairs(downloads)
    return replace(both, settings=both.settings.replaced(changes, "test"))


@pytest.mark.parametrize("kind", ["parquet", "bag"])
def test_pairs_of_published_traverses_are_cut_to_their_tracks(kind, tmp_path):
    for name in ("sunset1", "sunset2"):
        write_brisbane(tmp_path, name, kind, per_second=20, seconds=24)
    few, many = drive_pairs.open_pairs(tmp_path)
    assert [few.name, many.name] == [f"{PAIR}, 25 px", f"{PAIR}, 150 px"]
    (pair,) = drive_pairs.whole_pairs(tmp_path)
    assert pair.drives == PAIR and pair.settings.pixels == 150 and pair.has_events
    for drive, track in zip((pair.reference, pair.query), pair.tracks, strict=True):
        times = join_events(list(drive))["t"]
        assert (times[0], times[-1], track.time_us[-1]) == (0, 22_950_000, 23_000_000)
    centres = np.arange(23) * SECOND + SECOND // 2
    # 10.007 m/s on a sphere: within 70 m of a place for less than 7 s
    truth = pair.truth_of(centres, centres)
    assert np.array_equal(truth.correct, abs(centres[:, None] - centres) <= 6 * SECOND)


def test_qcr_traverses_are_pairs_too(tmp_path):
    for name in ("normal1", "fast1", "slow1"):
        traverse = qcr(name)
        start = 1_629_000_000 * SECOND
        # from the first event on, before the robot set off
        times = start + np.arange(200) * SECOND
        write_parquet(tmp_path / traverse.file_name("parquet"), times)
    pairs = drive_pairs.whole_pairs(tmp_path)
    assert [pair.drives for pair in pairs] == [
        "QCR, fast1 against normal1", "QCR, slow1 against normal1",
    ]  # fmt: skip
    reference, fast = (fixed_number.extent(d) for d in (pairs[0].reference, pairs[0].query))
    # an event a second, from 2 s to 165 s and from 7.7 s to 72.2 s
    assert (reference.events, fast.events) == (163, 65)
    assert fast.duration_us / reference.duration_us == pytest.approx(64 / 162)


def test_fixed_number_and_fixed_time_are_compared_on_published_traverses(pair, monkeypatch):
    """The same duration, the same events, every match right; and a street at twice the speed."""
    monkeypatch.setattr(fixed_number, "VARIANTS", fixed_number.VARIANTS[:2])
    for row in fixed_number.measure(Draw(pair, 0, True)):
        measures = (fixed_number.DURATION, fixed_number.EVENTS, "P@100R")
        assert [row[measure] for measure in measures] == [1.0, 1.0, 1.0]
    street = partial(simulate_pair, sensor="tiny")
    monkeypatch.setattr(fixed_number, "simulate_pair", street)
    monkeypatch.setattr(fixed_number, "LENGTH_M", 50.0)
    monkeypatch.setattr(fixed_number, "SPEEDS", (2.0,))
    ((_, twice),) = fixed_number.street(0)
    reference, query = (fixed_number.extent(drive) for drive in twice.events)
    assert query.duration_us / reference.duration_us == pytest.approx(0.5, abs=0.05)


def test_a_promise_is_kept_up_to_the_edge_of_the_exclusion_zone_and_no_further():
    """Places are 30 m apart; the first and the last, and no others, lie within 5 m."""
    along = np.array([0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 4.0, np.nan])
    query = np.array([61.0, 2.0, np.nan])
    positions = TruePositions(along[:, None], query[:, None], "metric", "m", 1.0)
    correct = np.abs(along[:, None] - query) <= positions.tolerance
    truth = GroundTruth(correct, np.array([True, True, False]), "by hand", positions=positions)
    zone = trust.in_zone(truth, 1)
    assert np.flatnonzero(zone.correct[:, 0]).tolist() == [1, 2, 3]
    assert np.flatnonzero(zone.correct[:, 1]).tolist() == [0, 1, 5, 6, 7]
    assert not zone.correct[:, 2].any() and np.array_equal(zone.has_truth, truth.has_truth)
    frames = replace(truth, positions=replace(positions, unit="frames"))
    assert np.flatnonzero(trust.in_zone(frames, 1).correct[:, 1]).tolist() == [0, 1, 5, 6, 7]
    nearer = replace(positions, query=np.array([[61.0], [1.0], [np.nan]]), unit="frames")
    promised = trust.in_zone(replace(truth, positions=nearer), 1).correct[:, 1]
    assert np.flatnonzero(promised).tolist() == [0, 1]


def test_a_lone_traverse_is_no_pair_and_what_to_download_is_said(downloads, tmp_path):
    (recording,) = downloads.glob("dvs_vpr_2020-04-21*.parquet")
    (tmp_path / recording.name).symlink_to(recording)
    says = (
        r"holds no pair, only Brisbane sunset1: name a folder .* \(such as .*parquet \(1.93 GB\), "
        r".*nmea of https://huggingface.co/.*, QCR-.*zenodo.* under their published .*--dry-run"
    )
    with pytest.raises(UsageError, match=says):
        drive_pairs.check_data(tmp_path)
    drive_pairs.check_logs(tmp_path)  # of one traverse, no log is needed


def test_a_missing_log_is_an_error_before_any_work(downloads, tmp_path, capsys, monkeypatch):
    for file in downloads.glob("*.parquet"):
        (tmp_path / file.name).symlink_to(file)
    with pytest.raises(GroundTruthError, match=r"no GPS log of sunset1 .* download it from https"):
        drive_pairs.check_logs(tmp_path)
    monkeypatch.setattr(rivals, "measure", None)  # is not called
    assert main(["rivals", "--data", str(tmp_path)]) == 1
    assert "no GPS log of sunset1" in capsys.readouterr().err


def test_a_recording_that_begins_after_its_track_has_the_positions_of_its_times(tmp_path):
    write_brisbane(tmp_path, "sunset1", per_second=20, seconds=12)
    traverse = brisbane("sunset1")
    path = tmp_path / traverse.file_name("parquet")
    whole = datasets.open_drive(traverse, path)
    first = round(traverse.beginning_s * SECOND)
    write_parquet(path, first + np.arange(2 * SECOND, 14 * SECOND, SECOND // 20))
    late = datasets.open_drive(traverse, path)
    times = join_events(list(late.recording))["t"]
    assert (times[0], times[-1]) == (0, 8_950_000) and late.track.time_us[-1] == 9 * SECOND
    at = np.array([0, 5 * SECOND])
    np.testing.assert_array_equal(late.track.at(at), whole.track.at(at + 2 * SECOND))


def test_a_dry_run_lists_every_file_and_finds_those_that_are_not_the_published_ones(
    downloads, tmp_path, capsys, monkeypatch
):
    assert main(["all", "--data", str(tmp_path), "--dry-run"]) == 0
    shown = capsys.readouterr().out
    assert "simulated: 5 trials, of simulated streets" in shown
    assert "speck-walks: cannot run: the folder speck_walks, two walks with" in shown
    for line in (
        "  missing: dvs_vpr_2020-04-22-17-24-21_no_hot_pixels_nobursts_denoised.parquet (2.78 GB)",
        "QCR-Event-VPR, fast1 (https://zenodo.org/records/10494919)",
        "  missing: speck_walks/query.npz",
    ):
        assert line in shown.splitlines()
    assert main(["simulated", "joules", "--dry-run"]) == 0
    assert capsys.readouterr().out.count("\n") == 2  # they read no files
    # the small files of these tests have the published names, and not the published sizes
    assert main(["rivals", "--data", str(downloads), "--dry-run"]) == 2
    shown = capsys.readouterr()
    assert shown.out.splitlines()[0].endswith(f"windows of N events; {PAIR}")
    assert "bytes, of 1,925,019,428 published: download it again from https://hugg" in shown.err
    recording = next(downloads.glob("dvs_vpr_2020-04-21*.parquet"))
    content = recording.read_bytes()
    for sha256, code in ((hashlib.sha256(content).hexdigest(), 0), ("0" * 64, 2)):
        first, *others = (
            replace(each, size=None, sha256="") for each in datasets.BRISBANE_TRAVERSES
        )
        data_set = (replace(first, size=len(content), sha256=sha256), *others), datasets.BRISBANE_M
        monkeypatch.setitem(datasets.DATA_SETS, "Brisbane", data_set)
        assert main(["rivals", "--data", str(downloads), "--dry-run"]) == code
        assert ("another SHA-256 than published" in capsys.readouterr().err) == bool(code)
