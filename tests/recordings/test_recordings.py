"""Every recording: the same promises whatever the format, and faults decided in one place."""

from __future__ import annotations

import gzip
import lzma
import os
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge_vpr.errors import EdgeVprError, EventError, RecordingError, UsageError
from edge_vpr.events import Columns, Sensor, join_events, make_events
from edge_vpr.recordings import FORMATS, RAW, WRITTEN, open_recording, sniff, write_recording
from edge_vpr.recordings.decoding import Unwrapper
from edge_vpr.recordings.reading import FaultLog
from tests.recordings.fuzz_recordings import write_seeds
from tests.streams import random_events

ROOT = Path(__file__).parents[2]
SENSOR = Sensor(40, 30)


def read(path, **options):
    """All events of a recording, and the recording."""
    recording = open_recording(path, **options)
    return join_events(list(recording)), recording


events_strategy = st.lists(
    st.tuples(
        st.one_of(st.integers(0, 3), st.integers(0, 10**8)),  # steps of time
        st.integers(0, SENSOR.width - 1),
        st.integers(0, SENSOR.height - 1),
        st.booleans(),
    ),
    min_size=1,
    max_size=60,
)


def from_steps(rows):
    steps, x, y, p = (np.array(column) for column in zip(*rows, strict=True))
    return make_events(np.cumsum(steps), x, y, p)


@pytest.mark.parametrize("suffix", WRITTEN)
@given(rows=events_strategy, start=st.integers(-(10**15), 10**15), chunk=st.integers(1, 70))
@settings(max_examples=40)  # of each format, which share what cuts events into chunks
def test_what_is_written_is_read_again_to_the_bit_for_any_chunking(
    suffix, rows, start, chunk, tmp_path_factory
):
    events = from_steps(rows)
    path = tmp_path_factory.mktemp("round") / f"trip{suffix}"
    pieces = [events[i : i + chunk] for i in range(0, events.size, chunk)]
    assert write_recording(path, pieces, sensor=SENSOR, start_us=start) == events.size
    assert [p.name for p in path.parent.iterdir()] == [path.name]

    recording = open_recording(path, chunk_events=chunk)
    chunks, others = zip(*zip(recording, recording, strict=True), strict=True)  # two passes at once
    again = join_events(list(chunks))
    assert np.array_equal(join_events(list(others)), again)
    assert again.packed and all(map(len, chunks))
    assert recording.position in (None, 1.0)
    assert (recording.sensor, recording.faults.total) == (SENSOR, 0)
    assert recording.start_us == start
    assert np.array_equal(again, events)


def plain_sift(rows, sensor):
    """Which rows are good, in plain Python, and the counts of the others."""
    good, late, off, last = [], 0, 0, None
    for t, x, y, p in rows:
        if not (0 <= x < sensor.width and 0 <= y < sensor.height):
            off += 1
        elif last is not None and t < last:
            late += 1
        else:
            good.append((t, x, y, p))
            last = t
    return good, late, off


@given(
    rows=st.lists(
        st.tuples(st.integers(-9, 40), st.integers(-2, 6), st.integers(-2, 6), st.booleans()),
        max_size=40,
    ),
    chunk=st.integers(1, 41),
)
def test_faulty_events_are_dropped_and_counted_as_plain_python_does_for_any_chunking(rows, chunk):
    sensor = Sensor(4, 5)
    log = FaultLog(Path("x"), sensor, "drop", origin_us=0)
    kept = []
    for i in range(0, len(rows), chunk):
        t, x, y, p = (np.array(c) for c in zip(*rows[i : i + chunk], strict=True))
        kept += log.admit(Columns(t, x, y, p)).tolist()
    good, late, off = plain_sift(rows, sensor)
    assert kept == good
    assert (log.faults.backwards, log.faults.off_sensor) == (late, off)
    assert log.faults.total == len(rows) - len(good)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ((4, 1, 1, 1), ("event 2:", "backwards, from 5 to 4 us: sort", "on_fault='drop'")),
        ((6, 40, 1, 1), ("event 2:", "pixel (40, 1) at 6 us", "40x30", "on_fault='drop'")),
        ((6, 1, -1, 1), ("event 2:", "pixel (1, -1)", "on_fault='drop'")),
    ],
)
def test_a_fault_is_an_error_that_says_what_and_where_and_can_be_dropped(row, words, tmp_path):
    path = tmp_path / "a.csv"
    rows = [(0, 0, 0, 0), (5, 1, 1, 1), row, (7, 2, 2, 0)]
    path.write_text("".join("{},{},{},{}\n".format(*r) for r in rows))
    with pytest.raises(RecordingError) as raised:
        read(path, sensor=SENSOR)
    assert all(word in str(raised.value) for word in words)
    assert "\n" not in str(raised.value)
    events, recording = read(path, sensor=SENSOR, on_fault="drop")
    assert events["t"].tolist() == [0, 5, 7]
    assert recording.faults.total == 1


def test_faults_are_counted_anew_on_each_pass(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("0 0 0 1\n5 1 1 1\n4 1 1 1\n")
    recording = open_recording(path, sensor=SENSOR, on_fault="drop")
    for _ in range(2):
        list(recording)
        assert recording.faults.backwards == 1
    assert str(recording.faults) == "1 backwards"


@given(
    steps=st.lists(st.integers(-127, 127), min_size=1, max_size=50),
    cut=st.integers(0, 50),
    begin=st.integers(0, 255),
)
def test_a_wrapping_clock_is_continued_for_any_step_of_less_than_half_its_period(steps, cut, begin):
    times = begin + np.cumsum([0, *steps])
    raw = (times % 256).astype(np.uint8)
    clock = Unwrapper(8)
    again = np.concatenate([clock.unwrap(raw[:cut]), clock.unwrap(raw[cut:])])
    assert (again - again[0]).tolist() == (times - times[0]).tolist()


@pytest.mark.parametrize("name", ["a.csv", "a.npz", "a.raw", "a.aedat4", "a.bag", "a.h5"])
def test_a_missing_or_empty_file_is_one_line(name, tmp_path):
    with pytest.raises(RecordingError, match=r"does not exist: check the path"):
        open_recording(tmp_path / name)
    (tmp_path / name).touch()
    with pytest.raises(RecordingError, match=r"is empty \(0 bytes\)"):
        open_recording(tmp_path / name)


def test_every_format_is_fuzzed_and_its_suffixes_are_on_the_page(tmp_path):
    for library in ("h5py", "lz4", "PIL", "pyarrow", "rosbags"):
        pytest.importorskip(library)
    write_seeds(tmp_path)
    page = (ROOT / "docs/recordings.md").read_text(encoding="utf-8")
    names = set()
    for path in tmp_path.iterdir():
        name = sniff(path)
        names |= {"evt2", "evt21", "evt3"} if name == RAW else {name}
    assert names == set(FORMATS)
    for each in FORMATS.values():
        assert all(f"`{suffix}`" in page for suffix in each.suffixes), each


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.xyz", b"what is this?", "has no known format"),
        ("a.raw", b"\x00\x01\x02\x03", "format=, one of evt2, evt21 and evt3"),
        ("a.npz", b"PK\x03\x04 cut", "is damaged (BadZipFile"),
        ("a.npy", b"\x93NUMPY\x01\x00", "no readable NumPy array"),
        ("a.csv", b"\x00\x01\x02\x03" * 9, "has no known format"),
        ("a.csv", b"when,where\n1,2\n", "names no columns"),
        ("a.csv", b"# only a comment\n", "holds no events"),
        ("a.csv", b"t,x,y,p\n", "holds no events"),
        ("a.bag", b"#ROSBAG V2.0\n", "rosbag reindex"),
        ("a.h5", b"\x89HDF\r\n\x1a\n", "damaged, cut off or no HDF5"),
        ("a.parquet", b"PAR1....", "is damaged (ArrowInvalid"),
        ("a.aedat4", b"#!AER-DAT4.0\r\n\x09\0\0\0abc", "damaged or cut off in its header"),
        ("a.aedat", b"#!AER-DAT3.0\r\n", "only 2, 3.1 and 4 are read"),
        ("a.aedat", b"#!AER-DAT3.1\r\n", "damaged in its header at byte 14"),
        ("a.aedat", b"#!AER-DAT2.0\r\n# AEChip: x.Cochlea\r\n", "x.Cochlea"),
        ("a.db3", b"SQLite format 3\0", "try ros2 bag reindex"),
        ("a.raw", b"% format EVT4;height=3;width=4\n% end\n", "EVT4"),
        ("a.raw", b"% evt 2.0\n% geometry 4x3\n% end\n", "holds no events"),
        ("a.raw", b"% evt 2.0\n% geometry wide\n% end\n", "WIDTHxHEIGHT"),
        ("a.dat", b"% Version 2\n% Height 3\n% Width 4\n\x07\x08", "by faery, as docs/recordings"),
        ("a.es", b"Event Stream\2\0\0", "by faery, as docs/recordings"),
        (
            "a.csv.gz",
            gzip.compress(b"t,x,y,p\n", mtime=0),
            "is compressed by gzip: unpack it first",
        ),
        ("a.txt", lzma.compress(b"t,x,y,p\n"), "is compressed by xz: unpack it first"),
    ],
)
def test_an_unreadable_file_is_one_line_that_says_why(name, content, words, tmp_path):
    libraries = {".parquet": "pyarrow", ".h5": "h5py", ".bag": "rosbags", ".db3": "rosbags"}
    if library := libraries.get(Path(name).suffix):
        pytest.importorskip(library)
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(EdgeVprError) as raised:
        list(open_recording(path, sensor=None if name == "a.raw" else SENSOR))
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


def test_an_archive_or_a_folder_of_other_things_says_what_it_holds(tmp_path):
    np.savez(tmp_path / "a.npz", weights=np.zeros(3))
    with pytest.raises(RecordingError, match="holds weights, and neither events"):
        open_recording(tmp_path / "a.npz")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("a.csv", "t,x,y,p\n")
    with pytest.raises(RecordingError, match=r"a zip archive of a\.csv: unpack it first"):
        open_recording(tmp_path / "a.zip")
    with pytest.raises(RecordingError, match=r"without \*\.db3"):
        open_recording(tmp_path)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"format": "evt9"}, "format 'evt9' is unknown"),
        ({"on_fault": "ignore"}, "choose error or drop"),
        ({"time_unit": "min"}, "choose s, ms, us or ns"),
        ({"columns": "abc"}, "write for example xytp"),
        ({"chunk_events": 0}, "not positive"),
        ({"frame_period": 0}, "no positive number"),
        ({"frame_period": "often"}, "no positive number"),
        ({"sensor": 346}, "or '346x260'"),
        ({"start": "soon"}, "is no number of seconds"),
        ({"start": 5, "end": 2}, "is not after the start"),
        ({"columns": 4}, "columns is an int (4): give text"),
        ({}, "sensor='346x260'"),
    ],
)
def test_wrong_use_names_the_remedy(options, words, tmp_path):
    (tmp_path / "a.csv").write_text("0 0 0 1\n")
    with pytest.raises(UsageError) as raised:
        open_recording(tmp_path / "a.csv", **options)
    assert words in str(raised.value)


def test_a_sensor_against_the_files_own_is_refused_and_the_same_one_is_not(tmp_path):
    path = tmp_path / "a.npz"
    write_recording(path, make_events([0], [1], [1]), sensor=SENSOR)
    assert open_recording(path, sensor=SENSOR).sensor == SENSOR
    with pytest.raises(UsageError, match="40x30 sensor, and 41x30 was named"):
        open_recording(path, sensor=Sensor(41, 30))


def test_a_camera_that_the_file_only_names_may_have_recorded_a_part(tmp_path):
    words = np.array([0x8000_0000, 0x1000_0801], "<u4")  # time 0, an event at (1, 1)
    path = tmp_path / "a.raw"
    path.write_bytes(b"% evt 2.0\n% plugin_name hal_plugin_imx636_evk4\n% end\n" + words.tobytes())
    assert open_recording(path).sensor == Sensor(1280, 720)
    assert open_recording(path, sensor="640x480").sensor == Sensor(640, 480)


def test_nothing_half_written_is_left_and_nothing_is_replaced_unasked(tmp_path):
    def broken():
        yield make_events([0, 1], [0, 1], [0, 1])
        yield make_events([0], [0], [0])  # goes back

    for suffix in WRITTEN:
        with pytest.raises(EventError, match="runs backwards"):
            write_recording(tmp_path / f"a{suffix}", broken(), sensor=SENSOR)
        with pytest.raises(RecordingError, match="no events to write"):
            write_recording(tmp_path / f"a{suffix}", [], sensor=SENSOR)
        assert not list(tmp_path.iterdir())

    good = make_events([0], [1], [1])
    path = tmp_path / "a.npz"
    write_recording(path, good, sensor=SENSOR)
    before = path.read_bytes()
    with pytest.raises(UsageError, match="exists: name another, or replace it with overwrite=True"):
        write_recording(path, good, sensor=SENSOR)
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(UsageError, match=r"folder.npz: it is not a file: name another one"):
        write_recording(tmp_path / "folder.npz", good, sensor=SENSOR, overwrite=True)
    with pytest.raises(EventError):
        write_recording(path, broken(), sensor=SENSOR, overwrite=True)
    assert path.read_bytes() == before
    with pytest.raises(UsageError, match="cannot be written: choose one of"):
        write_recording(tmp_path / "a.aedat4", good, sensor=SENSOR)
    with pytest.raises(UsageError, match="needs the size of the sensor"):
        write_recording(tmp_path / "b.npz", good)
    with pytest.raises(UsageError, match="folder"):
        write_recording(tmp_path / "no" / "b.npz", good, sensor=SENSOR)


@pytest.mark.parametrize(
    ("suffix", "sensor", "t", "words"),
    [
        (".raw", Sensor(2049, 4), [0], "2048x2048"),
        (".raw", SENSOR, [0, 64 << 27], "2.4 hours"),
        (".raw", SENSOR, [-1], "negative"),
    ],
)
def test_events_that_a_format_cannot_hold_are_refused(suffix, sensor, t, words, tmp_path):
    zeros = np.zeros(len(t), int)
    with pytest.raises(RecordingError) as raised:
        write_recording(tmp_path / f"a{suffix}", make_events(t, zeros, zeros), sensor=sensor)
    assert words in str(raised.value)
    assert not list(tmp_path.iterdir())


def test_a_newer_archive_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, events=make_events([0], [0], [0]), sensor=[4, 4], start_us=0, schema=2)
    with pytest.raises(RecordingError, match="event schema 2, and this edge-vpr knows 1: upgrade"):
        open_recording(path)


def test_a_damaged_member_of_an_archive_is_found(tmp_path):
    path = tmp_path / "a.npz"
    write_recording(path, random_events(np.random.default_rng(0), 999, SENSOR, 9999), sensor=SENSOR)
    with zipfile.ZipFile(path) as archive:
        offset = archive.getinfo("events.npy").header_offset
    data = bytearray(path.read_bytes())
    data[offset + 5000] ^= 1
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="damaged after event"):
        read(path)


@pytest.mark.slow
@pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="3 million events are slow without Numba"
)
def test_memory_does_not_grow_with_the_file(tmp_path):
    """Reading 39 million bytes of events takes less than 8 million."""

    def pieces():
        rng = np.random.default_rng(0)
        for i in range(60):
            events = random_events(rng, 50_000, SENSOR, 10**6)
            events.t += i * 10**6
            yield events

    for suffix in (".npz", ".raw"):
        write_recording(tmp_path / f"a{suffix}", pieces(), sensor=SENSOR)
        recording = open_recording(tmp_path / f"a{suffix}", chunk_events=1 << 14)
        next(iter(recording))  # loads what it needs
        tracemalloc.start()
        assert sum(events.size for events in recording) == 3_000_000
        assert tracemalloc.get_traced_memory()[1] < 8_000_000
        tracemalloc.stop()
