"""The published data sets under their real names, and counting pixels inside tonic."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lab.datasets import (
    BRISBANE_TRAVERSES,
    QCR_LANDMARKS_M,
    QCR_TRAVERSES,
    BrisbaneTraverse,
    QCRTraverse,
)

from edge_vpr.descriptors.counting import CountPixels
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import FixedCount, FixedTime
from edge_vpr.errors import EventError, GroundTruthError, RecordingError, UsageError
from edge_vpr.evaluation.ground_truth import from_tracks
from edge_vpr.evaluation.tracks import great_circle
from edge_vpr.events import EVENT_DTYPE, Sensor, make_events
from tests import naive
from tests.maps.saved_files import sentence
from tests.recordings import recording_files

SMALL = Sensor(6, 5)
SECOND = 1_000_000
needs_tonic = "tonic is not installed (extra tonic)"


def brisbane(name: str) -> BrisbaneTraverse:
    return next(traverse for traverse in BRISBANE_TRAVERSES if traverse.name == name)


def qcr(name: str) -> QCRTraverse:
    return next(traverse for traverse in QCR_TRAVERSES if traverse.name == name)


# --- counting -------------------------------------------------------------------------------------

pixels = st.lists(
    st.tuples(st.integers(0, 5), st.integers(0, 4)), min_size=1, max_size=8, unique=True
)
events = st.lists(
    st.tuples(
        st.integers(0, 60).map(lambda t: t * 7), st.integers(0, 5), st.integers(0, 4), st.booleans()
    ),
    max_size=60,
).map(sorted)
dtypes = st.sampled_from(
    [
        EVENT_DTYPE,
        np.dtype([("t", int), ("x", int), ("y", int), ("p", int)]),  # most of tonic's
        np.dtype([("x", "<i2"), ("y", "<i2"), ("p", "i1"), ("t", "<u8")]),
    ]
)


def as_array(rows, dtype):
    array = np.zeros(len(rows), dtype)
    for column, name in enumerate("txyp"):
        array[name] = [row[column] for row in rows]
    return array


def pixel_map(chosen) -> PixelMap:
    return PixelMap(SMALL, *(np.array(c) for c in zip(*chosen, strict=True)))


@given(events, pixels, dtypes)
def test_counts_are_the_oracles_for_any_event_dtype(rows, chosen, dtype):
    array = as_array(rows, dtype)
    before = array.copy()
    counts = CountPixels(pixel_map(chosen))(array)
    assert counts.dtype == np.int64
    assert counts.tolist() == naive.count(rows, chosen)
    np.testing.assert_array_equal(array, before)


@given(events, pixels, dtypes)
def test_windows_are_the_oracles(rows, chosen, dtype):
    array, selected = as_array(rows, dtype), pixel_map(chosen)
    by_time = CountPixels(selected, FixedTime(50))(array)
    expected = [naive.count(w, chosen) for w in naive.fixed_time_windows(rows, 50)]
    np.testing.assert_array_equal(by_time, np.reshape(expected, (-1, len(chosen))))
    by_count = CountPixels(selected, FixedCount(3))(array)
    expected = [naive.count(w, chosen) for w in naive.fixed_count_windows(rows, chosen, 3)]
    np.testing.assert_array_equal(by_count, np.reshape(expected, (-1, len(chosen))))


@pytest.mark.parametrize("x", [6, -1, 65536])
def test_a_column_off_the_sensor_is_an_error_and_never_another_pixel(x):
    array = np.array([(x, 0)], [("x", int), ("y", int)])
    with pytest.raises(EventError, match=r"off the 6x5 sensor|column x spans .* outside 0 to"):
        CountPixels(pixel_map([(0, 0)]))(array)


def test_missing_fields_and_time_out_of_order_are_errors():
    array = np.zeros(2, [("x", int), ("y", int)])
    with pytest.raises(EventError, match="without all of the fields"):
        CountPixels(pixel_map([(0, 0)]), FixedTime(5))(array)
    with pytest.raises(EventError, match="give a structured array"):
        CountPixels(pixel_map([(0, 0)]))(np.zeros((2, 4)))
    with pytest.raises(EventError, match="time runs backwards"):
        CountPixels(pixel_map([(0, 0)]), FixedTime(5))(make_events([9, 3], [0, 0], [0, 0]))


def test_it_works_after_other_transforms():
    transforms = pytest.importorskip("tonic.transforms", reason=needs_tonic)
    chain = transforms.Compose([
        transforms.CropTime(min=10, max=30),
        transforms.TimeAlignment(),
        CountPixels(pixel_map([(1, 1), (2, 2)]), FixedTime(10)),
    ])  # fmt: skip
    events = make_events([5, 12, 13, 25, 29, 35], [1, 1, 2, 1, 1, 1], [1, 1, 2, 1, 1, 1])
    counts = chain(np.asarray(events))
    # after alignment the events lie at 0, 1, 13 and 17 us: one window is complete
    assert counts.tolist() == [[1, 1]]


@pytest.mark.parametrize("by", ["time", "events"])
def test_slices_are_windows(by):
    tonic = pytest.importorskip("tonic", reason=needs_tonic)
    rng = np.random.default_rng(4)
    array = make_events(
        np.sort(rng.integers(0, 500, 200)), rng.integers(0, 6, 200), rng.integers(0, 5, 200)
    )
    selected = PixelMap.all_of(SMALL)
    count = CountPixels(selected)
    if by == "time":
        slicer = tonic.slicers.SliceByTime(time_window=50, start_time=0)
        one = CountPixels(selected, FixedTime(50))(array)
    else:
        slicer = tonic.slicers.SliceByEventCount(event_count=7)
        one = np.array([count(array[i : i + 7]) for i in range(0, 196, 7)])
    sliced = tonic.SlicedDataset([(array, "a"), (array, "b")], slicer, transform=count)
    counts_of_slices = np.array([counts for counts, _ in sliced])
    np.testing.assert_array_equal(counts_of_slices, np.concatenate([one, one]))
    assert [target for _, target in sliced] == ["a"] * len(one) + ["b"] * len(one)


# --- the traverses --------------------------------------------------------------------------------


def test_names_are_unique_and_those_that_the_authors_published():
    for traverses in (BRISBANE_TRAVERSES, QCR_TRAVERSES):
        names = [n for t in traverses for n in (t.file_name("bag"), t.file_name("parquet"))]
        assert len(set(names)) == 2 * len(traverses)
    sunset1 = brisbane("sunset1")
    assert sunset1.file_name("bag") == "dvs_vpr_2020-04-21-17-03-03.bag"
    assert sunset1.file_name("parquet") == (
        "dvs_vpr_2020-04-21-17-03-03_no_hot_pixels_nobursts_denoised.parquet"
    )
    assert list(sunset1.logs) == [
        "dvs_vpr_2020-04-21-17-03-03.nmea",
        "20200421_170039-sunset1_concat.nmea",
    ]
    assert qcr("slow1").file_name("parquet") == "bags_2022-03-28-12-03-44_denoised.parquet"


def test_each_traverse_begins_within_a_minute_of_its_name():
    for traverse in BRISBANE_TRAVERSES:
        # the name is the local time in Brisbane, ten hours ahead of UTC
        named = np.datetime64(
            traverse.recording[8:18] + "T" + traverse.recording[19:].replace("-", ":")
        )
        unix_s = (named - np.datetime64("1970-01-01T10:00:00")).astype(int)
        for beginning_s in traverse.logs.values():
            assert abs(beginning_s - unix_s) < 60


def test_a_landmark_is_one_place_for_all_speeds():
    for traverse in QCR_TRAVERSES:
        track = traverse.track()
        np.testing.assert_array_equal(track.at(track.time_us)[:, 0], QCR_LANDMARKS_M)
    assert (QCR_LANDMARKS_M[0], QCR_LANDMARKS_M[-1]) == (0.0, 160.0)
    assert (np.diff(QCR_LANDMARKS_M) > 0).all()


def test_the_complete_log_begins_with_the_recording(shared_data, tmp_path):
    """The published beginnings lie within 3 s of the first GPS second of the complete logs."""
    for name in ("sunset1", "sunset2"):
        traverse = brisbane(name)
        log = tmp_path / f"{traverse.video}_concat.nmea"
        log.symlink_to(shared_data / "brisbane_sparse49" / f"{name}.nmea")
        track, beginning_us = traverse.origin(tmp_path, 0)
        assert abs(beginning_us / 1e6 - track.start_utc.timestamp()) < 3


# --- the datasets ---------------------------------------------------------------------------------


@pytest.fixture
def datasets():
    pytest.importorskip("tonic", reason=needs_tonic)
    from lab import tonic_datasets as datasets

    return datasets


def write_parquet(path: Path, t: np.ndarray, pixel: np.ndarray | None = None) -> None:
    """Write one event a time, as the authors do: absolute microseconds.

    Event n is at column n and row n of the sensor, or those of pixel n.
    """
    pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra parquet)")
    parquet = pytest.importorskip("pyarrow.parquet")
    n = np.arange(len(t)) if pixel is None else pixel
    table = {"t": t, "x": n % 346, "y": n % 260, "p": n % 2}
    parquet.write_table(pa.table({k: v.astype(np.uint64) for k, v in table.items()}), path)


def write_bag(path: Path, t: np.ndarray) -> None:
    """Write the same events as a ROS 1 bag of the DAVIS driver's messages, ten events each."""
    events = [(int(us), i % 346, i % 260, i % 2 == 1) for i, us in enumerate(t.tolist())]
    parts = [events[first : first + 10] for first in range(0, len(events), 10)]
    messages = [("/dvs/events", recording_files.event_array(part, 346, 260, 1)) for part in parts]
    recording_files.write_bag(path, 1, messages)


def write_log(path: Path, seconds: int) -> None:
    """Write a drive north at 10 m/s, from 07:03:14 UTC on."""
    with path.open("w") as file:
        for second in range(seconds):
            minutes = 30.0 - second * 10 / 1852
            where = f"27{minutes:09.6f},S,15254.0,E"
            file.write(sentence(f"GPRMC,0703{14 + second:02d}.00,A,{where},0,,210420,,,A"))


@pytest.mark.parametrize(("files", "log", "offset_s"), [
    ("parquet", "dvs_vpr_2020-04-21-17-03-03.nmea", 1587452593.35),
    ("bag", "20200421_170039-sunset1_concat.nmea", 1587452582.35),
])  # fmt: skip
def test_a_brisbane_traverse_begins_with_its_gps_log_and_ends_with_it(
    datasets, tmp_path, files, log, offset_s
):
    sunset1, zero = brisbane("sunset1"), round(offset_s * 1e6)
    t = zero + np.arange(-30, 120) * 100_000  # from 3 s before the log to 12 s
    write = write_parquet if files == "parquet" else write_bag
    write(tmp_path / sunset1.file_name(files), t)
    write_log(tmp_path / log, 10)
    dataset = datasets.BrisbaneEventVPR(tmp_path, files=files)
    assert (len(dataset), dataset.traverses) == (1, ("sunset1",))
    [(events, target)] = list(dataset)
    assert events.dtype == EVENT_DTYPE
    # the log spans 9 s: events from 0 on, up to 9 s
    assert events["t"].tolist() == list(range(0, 9 * SECOND, 100_000))
    i = np.arange(30, 120)
    np.testing.assert_array_equal(events["x"], i % 346)
    np.testing.assert_array_equal(events["p"], (i % 2 == 1)[:90])
    assert target.traverse == "sunset1"
    there, here = target.track.at([4 * SECOND]), target.track.at([0])
    np.testing.assert_allclose(great_circle(there, here), 40, rtol=0.01)


def test_what_is_missing_is_named_with_the_page_to_get_it_from(datasets, tmp_path):
    with pytest.raises(RecordingError, match=r"does not hold dvs_vpr_2020-04-27.*zenodo"):
        datasets.BrisbaneEventVPR(tmp_path, ["night"], files="bag")
    with pytest.raises(
        UsageError, match="traverse 'dusk' is unknown: choose from sunset1, sunset2"
    ):
        datasets.BrisbaneEventVPR(tmp_path, ["dusk"])
    with pytest.raises(UsageError, match="use parquet or bag"):
        datasets.QCREventVPR(tmp_path, files="feather")
    sunset1 = brisbane("sunset1")
    write_parquet(tmp_path / sunset1.file_name("parquet"), np.arange(5))
    dataset = datasets.BrisbaneEventVPR(tmp_path)
    with pytest.raises(
        GroundTruthError, match=r"no GPS log of sunset1 \(dvs_vpr_2020-04-21-17-03-03"
    ):
        dataset[0]
    write_log(tmp_path / f"{sunset1.recording}.nmea", 10)
    with pytest.raises(RecordingError, match=r"holds no events from 1.58745e\+09 s"):
        dataset[0]
    with pytest.raises(IndexError):
        dataset[1]


def test_qcr_traverses_of_two_speeds_have_the_truth_of_their_landmarks(datasets, tmp_path):
    for name in ("normal1", "slow1"):
        traverse = qcr(name)
        end = traverse.start_s + traverse.landmarks_s[-1] + 5
        t = 1_629_325_542_000_000 + np.arange(0, int(end * 10)) * 100_000
        write_parquet(tmp_path / traverse.file_name("parquet"), t)
    dataset = datasets.QCREventVPR(tmp_path, ["normal1", "slow1"])
    (reference, there), (query, here) = dataset
    assert (there.traverse, here.traverse) == ("normal1", "slow1")
    # slow1 sets off 12 s after its first event and ends 263 s later
    assert (query["t"][0], query["t"][-1]) == (0, 263 * SECOND - 100_000)
    assert query["x"][0] == 120
    assert reference["t"][-1] == 163 * SECOND - 100_000
    place, moment = (np.arange(n) * SECOND + SECOND // 2 for n in (163, 263))
    truth = from_tracks(there.track, here.track, place, moment, 3.0)
    assert truth.has_truth.all()
    assert truth.has_place.all()
    # the fourth landmark is passed at 58 s and, slowly, at 110 s
    assert truth.correct[57, 109]
