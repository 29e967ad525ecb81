"""Cameras' own formats: against plain decoders, against other readers, on real files."""

from __future__ import annotations

import re
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.errors import MissingExtraError, RecordingError, UsageError
from edge_vpr.events import Sensor, join_events, make_events
from edge_vpr.recordings import open_recording, write_recording
from tests.recordings import recording_files as files
from tests.streams import absolute, random_events

SENSOR = Sensor(640, 480)


def body(path):
    """A RAW file without its header lines."""
    data = path.read_bytes()
    while data.startswith(b"% "):
        line, _, data = data.partition(b"\n")
        if line == b"% end":
            break
    return data


@pytest.fixture
def real(shared_data):
    return shared_data / "recordings"


# --- real files -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "encoding", "size", "sensor"),
    [  # the header of the first has no size; the name of the camera's driver stands for it
        ("evt2_gen3_640x480.raw", "evt2", 539_481, Sensor(640, 480)),
        ("evt3_gen41_1280x720_driving.raw", "evt3", 219_596, Sensor(1280, 720)),
    ],
)
def test_a_real_file_is_what_a_plain_decoder_makes_of_it(real, name, encoding, size, sensor):
    words = np.frombuffer(body(real / name), files.EVT_WORDS[encoding])
    expected = files.PlainDecoder(encoding).decode(words)
    for chunk in (1000, 1 << 16):
        events, recording = absolute(real / name, chunk_events=chunk)
        assert events.tolist() == expected
        assert (events.size, recording.sensor) == (size, sensor)
        assert recording.faults.total == 0


@pytest.mark.parametrize("name", ["evt2_gen3_640x480.raw", "evt3_gen41_1280x720_driving.raw"])
def test_real_files_are_what_eventcv_reads(real, name):
    eventcv = pytest.importorskip("eventcv")
    x, y, t, p = eventcv.load(str(real / name)).numpy().T
    events, _ = absolute(real / name)
    assert np.array_equal(make_events(t, x, y, p), events)


def test_a_real_aedat4_file_is_what_faery_reads(real):
    faery = pytest.importorskip("faery")
    path = real / "aedat4_davis346.aedat4"
    other = faery.events_stream_from_file(path).to_array()
    events, recording = absolute(path)
    assert np.array_equal(make_events(other["t"], other["x"], other["y"], other["on"]), events)
    assert (events.size, recording.sensor) == (6_676, Sensor(346, 260))


def test_an_aedat4_file_that_is_cut_off_keeps_its_whole_packets(real, tmp_path):
    pytest.importorskip("lz4")
    data = (real / "aedat4_davis346.aedat4").read_bytes()
    path = tmp_path / "cut.aedat4"
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(RecordingError, match=r"cut off: .* within a packet"):
        absolute(path)
    some, recording = absolute(path, on_fault="drop")
    whole, _ = absolute(real / "aedat4_davis346.aedat4")
    assert recording.faults.truncated > 0
    assert 0 < some.size < whole.size
    assert np.array_equal(some, whole[: some.size])
    frame = b"\x04\x22\x4d\x18"  # LZ4's; number and size of the stream stand before it
    at = data.index(frame) - 8
    while data[at : at + 4] != bytes(4):  # the first packet of stream 0, the events
        at = data.index(frame, at + 12) - 8
    flipped = bytearray(data)
    flipped[at + 8 : at + 12] = bytes(4)
    path.write_bytes(flipped)
    with pytest.raises(RecordingError, match=r"damaged in the packet at byte"):
        absolute(path)


# --- files of our own making -----------------------------------------------------------------


def rows_of(steps):
    """Steps in microseconds, each with a pixel and a polarity."""
    pixel = st.integers(0, SENSOR.width - 1), st.integers(0, SENSOR.height - 1)
    return st.lists(st.tuples(steps, *pixel, st.booleans()), min_size=1, max_size=50)


events_strategy = rows_of(st.integers(0, 9) | st.integers(0, 8_000_000))
#: The clock of EVT 3.0 wraps after 16.8 s, so that a pause is known by the usual ones alone.
steady_strategy = st.integers(0, 6_000_000).flatmap(
    lambda usual: rows_of(st.integers(0, 9) | st.integers(usual, usual * 8 // 7))
)


def timed(rows, start=0):
    events, t = [], start
    for step, x, y, p in rows:
        t += step
        events.append((t, x, y, p))
    return events


@given(
    rows=steady_strategy, wraps_at=st.floats(0, 1), vectors=st.booleans(), chunk=st.integers(1, 99)
)
def test_evt3_is_decoded_beyond_the_wraps_of_its_clock(
    rows, wraps_at, vectors, chunk, tmp_path_factory
):
    start = (1 << 24) - int(wraps_at * sum(step for step, *_ in rows))  # the clock wraps on the way
    events = timed(rows, max(0, start))
    path = tmp_path_factory.mktemp("evt3") / "a.raw"
    path.write_bytes(files.raw_header("3.0", *SENSOR) + files.encode_evt3(events, vectors))
    again, recording = absolute(path, chunk_events=chunk)
    # the file knows its times modulo 2**24 only
    shift = events[0][0] - recording.start_us
    assert shift % (1 << 24) == 0
    assert [(t + shift, x, y, p) for t, x, y, p in again.tolist()] == events
    assert recording.sensor == SENSOR


@pytest.mark.parametrize("endianness", ["little", "big", "legacy"])
@given(rows=events_strategy, chunk=st.integers(1, 99))
def test_evt21_is_decoded_in_each_byte_order(endianness, rows, chunk, tmp_path_factory):
    events = timed(rows, (1 << 34) - 10_000_000)  # wraps on the way
    path = tmp_path_factory.mktemp("evt21") / "a.raw"
    fields = f"format EVT21;height=480;width=640;endianness={endianness}"
    path.write_bytes(
        files.raw_header("2.1", *SENSOR, fields) + files.encode_evt21(events, endianness)
    )
    again, recording = absolute(path, chunk_events=chunk)
    shift = events[0][0] - recording.start_us
    assert shift in (0, 1 << 34)
    assert [(t + shift, x, y, p) for t, x, y, p in again.tolist()] == events


def test_events_before_the_first_time_are_dropped_and_counted_but_no_error(tmp_path):
    words = [10, 0x2005, 0x2006, 0x8001, 0x6002, 0x2007]
    path = tmp_path / "a.raw"
    path.write_bytes(files.raw_header("3.0", *SENSOR) + struct.pack("<6H", *words))
    events, recording = absolute(path)
    assert events.tolist() == [(4098, 7, 10, False)]
    assert recording.faults.undated == 2
    assert str(recording.faults) == "2 undated"


DAT_HEAD = b"% Data file containing CD events.\n% Version 2\n% Height 480\n% Width 640\n\x0c\x08"


def test_a_file_that_ends_within_an_event_says_at_which_byte(tmp_path):
    path, size = tmp_path / "a.raw", 4
    write_recording(path, make_events([0, 1, 2], [1, 2, 3], [1, 2, 3]), sensor=SENSOR)
    data = path.read_bytes()
    path.write_bytes(data[:-1])
    where = f"{len(data) - size:,}"
    with pytest.raises(RecordingError, match=f"cut off: {size - 1} bytes .* at byte {where}"):
        absolute(path)
    events, recording = absolute(path, on_fault="drop")
    assert events.size == 2
    assert recording.faults.truncated == size - 1


def steady(seconds, start=0):
    """A thousand events a second of a camera, as rows."""
    return [(start + i * 1_000, i % 640, i % 480, i % 2 == 0) for i in range(seconds * 1_000)]


@pytest.mark.parametrize("gap_s", [5, 8.3, 8.5, 10, 12, 14])
@pytest.mark.parametrize("before_s", [0, 2])
def test_a_gap_forwards_in_evt3_is_not_backwards(gap_s, before_s, tmp_path):
    first = steady(before_s) or [(5, 1, 2, True)]
    after = steady(1, first[-1][0] + int(gap_s * 1e6))
    path = tmp_path / "a.raw"
    path.write_bytes(files.raw_header("3.0", *SENSOR) + files.encode_evt3(first + after))
    events, recording = absolute(path)
    assert events.tolist() == first + after
    assert str(recording.faults) == "none"


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("end", [True, False])
def test_a_raw_header_may_have_any_letters_and_length(encoding, version, end, tmp_path):
    rows = steady(1)
    write_recording(tmp_path / "b.raw", make_events(*zip(*rows, strict=True)), sensor=SENSOR)
    words = (tmp_path / "b.raw").read_bytes().partition(b"% end\n")[2]
    words = words if version == "2.0" else files.encode_evt3(rows)
    notes = [f"% note {i}: Z\u00fcrich, 20 \u00b0C, na\u00efve\n" for i in range(3_000)]
    lines = [*notes, f"% evt {version}\n", "% geometry 640x480\n", *(["% end\n"] if end else [])]
    path = tmp_path / "a.raw"
    path.write_bytes("".join(lines).encode(encoding) + words)
    events, recording = absolute(path)
    assert events.tolist() == rows
    assert (recording.sensor, recording.format) == (SENSOR, f"evt{version[0]}")


@pytest.mark.parametrize("sensor", ["128x128", "240x180", "346x260", "640x480", "208x192"])
@pytest.mark.parametrize("first", [0, 0x23 << 24 | 5 << 12])
def test_aedat2_without_a_chip_is_read_with_the_size_of_the_sensor(sensor, first, tmp_path):
    """As v2e and CIFAR10-DVS write it; the first event may begin with the byte of "#"."""
    width, height = map(int, sensor.split("x"))
    rng = np.random.default_rng(0)
    x, y, p = (rng.integers(0, side, 500) for side in (width, height, 2))
    if width == 128:  # mirrored columns, rows from below, and ON is 0
        address = (127 - x) << 1 | (127 - y) << 8 | (1 - p)
    else:
        address = (width - 1 - x) << 12 | (height - 1 - y) << 22 | p << 11
        if first and height > 0x23 << 2:
            address[0] = first
            x[0], y[0], p[0] = width - 1 - 5, height - 1 - (0x23 << 2), 0
    pairs = list(zip(address.tolist(), range(0, 5_000, 10), strict=True))
    path = tmp_path / "a.aedat"
    path.write_bytes(files.aedat2("", pairs).replace(b"# AEChip: \r\n", b"# User: \xfc\r\n"))
    events, recording = absolute(path, sensor=sensor)
    assert np.array_equal(events, make_events(np.arange(0, 5_000, 10), x, y, p))
    assert str(recording.sensor) == sensor
    for wrong in (None, "320x240"):
        with pytest.raises(UsageError, match=r"pass sensor=, one of 128x128, .*346x260"):
            absolute(path, sensor=wrong)
    path.write_bytes(files.aedat2("x.Cochlea", pairs))
    with pytest.raises(RecordingError, match=r"x\.Cochlea, whose addresses are not known"):
        absolute(path, sensor=sensor)


#: the line of docs/recordings.md
CONVERT = re.search(
    r"^python -c (\"import faery.*\")$",
    (Path(__file__).parents[2] / "docs" / "recordings.md").read_text(encoding="utf-8"), re.M,
)[1]  # fmt: skip


@pytest.mark.parametrize("name", ["drive.dat", "drive.es"])
def test_dat_and_event_stream_are_converted_by_the_line_of_the_page(name, tmp_path, monkeypatch):
    """Beyond a wrap of DAT's 32 bits, too; and where they are opened, the error leads there."""
    monkeypatch.chdir(tmp_path)
    es = pytest.importorskip("faery.extension").es
    t = np.array([(1 << 32) - 10, (1 << 32) - 1, 1 << 32, (1 << 32) + 5])
    packet = np.zeros(4, [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
    packet["t"], packet["x"], packet["y"], packet["on"] = t, 3, 4, [1, 0, 1, 1]
    if name == "drive.es":
        packet["t"] = t - t[0]
        packet["y"] = SENSOR.height - 1 - packet["y"]  # row 0 is the lowest
        with es.Encoder(tmp_path / name, "dvs", False, tuple(SENSOR)) as encoder:
            encoder.write(packet)
    else:
        pixel = 3 | 4 << 14 | packet["on"].astype(np.uint32) << 28
        words = np.stack([t.astype(np.uint32), pixel], axis=1, dtype=np.uint32, casting="unsafe")
        (tmp_path / name).write_bytes(DAT_HEAD + words.tobytes())
    with pytest.raises(RecordingError, match=r"by faery, as docs/recordings.md says"):
        open_recording(tmp_path / name)
    line = CONVERT.strip('"').replace("drive.dat", name)
    exec(line, {})
    (events,) = open_recording(tmp_path / "drive.npz", sensor=SENSOR)
    assert (events.x.tolist(), events.y.tolist()) == ([3] * 4, [4] * 4)
    assert events["t"].tolist() == [0, 9, 10, 15]
    assert events["p"].tolist() == [True, False, True, True]


def test_what_we_write_other_readers_read(tmp_path):
    expelliarmus = pytest.importorskip("expelliarmus")
    events = random_events(np.random.default_rng(0), 3_000, SENSOR, 10**7)
    write_recording(tmp_path / "a.raw", events, sensor=SENSOR)
    other = expelliarmus.Wizard(encoding="evt2").read(str(tmp_path / "a.raw"))
    assert np.array_equal(make_events(other["t"], other["x"], other["y"], other["p"]), events)


def test_aedat2_of_a_davis_is_what_eventcv_reads_with_its_columns_turned(tmp_path):
    """jAER computes sizeX - 1 - column when it reads its own files; eventcv leaves that out."""
    eventcv = pytest.importorskip("eventcv")
    rng = np.random.default_rng(0)
    pairs = []
    for t in range(0, 9000, 3):
        x, y, p = rng.integers(240), rng.integers(180), rng.integers(2)
        pairs.append((int(y << 22 | x << 12 | p << 11), t))
        if t % 90 == 0:
            pairs.append((1 << 31 | 12345, t))  # a sample of a frame
    path = tmp_path / "a.aedat"
    path.write_bytes(files.aedat2("eu.seebetter.ini.chips.davis.DAVIS240C", pairs))
    x, y, t, p = eventcv.load(str(path)).numpy().T
    events, recording = absolute(path)
    assert events.size == 3000
    assert np.array_equal(make_events(t, 239 - x, y, p), events)
    assert recording.sensor == Sensor(240, 180)


def test_aedat2_of_a_dvs128_is_read_beyond_the_wrap_as_jaer_turns_it(tmp_path):
    """Column 127 - raw, an ON event has polarity bit 0, and row 0 is the lowest."""
    pairs = [(20 << 8 | 10 << 1 | 1, (1 << 32) - 5), (127 << 8 | 127 << 1, 3), (1 << 15, 4)]
    path = tmp_path / "a.aedat"
    path.write_bytes(files.aedat2("ch.unizh.ini.jaer.chip.retina.DVS128", pairs))
    recording = open_recording(path)
    assert join_events(list(recording)).tolist() == [(0, 117, 107, False), (8, 0, 0, True)]
    assert recording.sensor == Sensor(128, 128)


def test_aedat3_is_read_beyond_the_wraps_of_its_packets_without_invalid_events(tmp_path):
    """Column 0, row 0 is the upper left pixel, as in libcaer."""
    path = tmp_path / "a.aedat"
    frame = bytes(48)  # of whatever is no event of the polarity
    path.write_bytes(
        files.aedat3(
            files.aedat3_packet(0, [struct.pack("<Ii", 1, 0)], 4),  # a special event
            files.aedat3_polarity([(2**31 - 5, 10, 20, True), (2**31 - 4, 239, 179, False)]),
            files.aedat3_packet(2, [frame], 16),
            files.aedat3_polarity([(2, 0, 0, False)], wraps=1, valid=False),
            files.aedat3_polarity([(3, 0, 0, True)], wraps=1),
        )
    )
    events, recording = absolute(path)
    assert recording.format == "aedat3" and recording.sensor == Sensor(240, 180)
    assert events.tolist() == [
        (2**31 - 5, 10, 20, True), (2**31 - 4, 239, 179, False), (2**31 + 3, 0, 0, True),
    ]  # fmt: skip
    chunks = [chunk.size for chunk in open_recording(path, chunk_events=1)]
    assert chunks == [1, 1, 1]


def test_aedat3_with_two_cameras_asks_which(tmp_path):
    path = tmp_path / "a.aedat"
    sources = "#Source 0: DVS128\r\n#-Source 0: FILE\r\n#Source 3: DAVIS346BMono"
    left, right = (files.aedat3_polarity([(5, 1, 2, True)], source=n) for n in (0, 3))
    path.write_bytes(files.aedat3(left, right, right, sources=sources))
    with pytest.raises(UsageError, match=r"0 \(DVS128\), 3 \(DAVIS346BMono\): choose with topic="):
        open_recording(path)
    with pytest.raises(RecordingError, match="no camera 'up'"):
        open_recording(path, topic="up")
    events, recording = absolute(path, topic="DVS128")
    assert (len(events), recording.sensor) == (1, Sensor(128, 128))
    events, recording = absolute(path, topic="3")
    assert (len(events), recording.sensor) == (2, Sensor(346, 260))


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (files.aedat3(form="SerializedTS"), "format SerializedTS, and only RAW is read"),
        (files.aedat3(files.aedat3_packet(1, [bytes(9)], 4)), "events of 9 bytes"),
        (files.aedat3(struct.pack("<hhiiiiii", 1, 0, -8, 4, 0, 1, 1, 1)), "1 events of -8 bytes"),
        (files.aedat3(struct.pack("<hhiiiiii", 1, 0, 8, 4, -1, 1, 1, 1)), "-1 wraps"),
        (files.aedat3(files.aedat3_polarity([(5, 1, 2, True)])[:-1]), "cut off: 35 bytes too many"),
        (files.aedat3(files.aedat3_polarity([(5, 1, 2, True)]), bytes(9)), "cut off"),
        (files.aedat3(files.aedat3_polarity([(5, 1, 2, True)]), sources="#X"), "has no camera"),
    ],
)
def test_damage_of_aedat3_is_named(data, says, tmp_path):
    path = tmp_path / "a.aedat"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=says):
        absolute(path)


def test_aedat4_with_two_cameras_asks_which(tmp_path):
    left, right = (0, "left", 346, 260), (3, "right", 640, 480)
    path = tmp_path / "a.aedat4"
    path.write_bytes(
        files.aedat4_header(left, right)
        + files.aedat4_packet(0, [(5, 1, 2, True)])
        + files.aedat4_packet(3, [(6, 600, 400, False), (9, 1, 1, True)])
        + files.aedat4_packet(3, [])
        + files.aedat4_packet(0, [(7, 3, 4, True)])
    )
    with pytest.raises(UsageError, match=r"0 \(left\), 3 \(right\): choose with topic="):
        open_recording(path)
    with pytest.raises(RecordingError, match="no event stream 'up'"):
        open_recording(path, topic="up")
    events, recording = absolute(path, topic="left")
    assert events.tolist() == [(5, 1, 2, True), (7, 3, 4, True)]
    assert recording.sensor == Sensor(346, 260)
    events, recording = absolute(path, topic="3")
    assert events.tolist() == [(6, 600, 400, False), (9, 1, 1, True)]
    assert recording.sensor == Sensor(640, 480)


@pytest.mark.parametrize(
    ("name", "head", "module", "extra"),
    [
        ("a.parquet", b"PAR1", "pyarrow.parquet", "parquet"),
        ("a.h5", b"\x89HDF\r\n\x1a\n", "h5py", "hdf5"),
        ("a.bag", b"#ROSBAG V2.0\n", "rosbags.rosbag1", "ros"),
    ],
)
def test_a_missing_library_names_the_extra(name, head, module, extra, tmp_path, monkeypatch):
    (tmp_path / name).write_bytes(head)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"run pip install -e '.*\[{extra}\]'"):
        open_recording(tmp_path / name)


def test_only_the_library_of_the_opened_format_is_imported(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((1, 4), np.int64))
    program = (
        "import sys; from edge_vpr.events import Sensor; "
        "from edge_vpr.recordings import open_recording; "
        f"list(open_recording({str(tmp_path / 'a.npy')!r}, sensor=Sensor(2, 2))); "
        "print([m for m in ('pandas', 'pyarrow', 'h5py', 'rosbags', 'matplotlib', 'PIL')"
        " if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert out.stdout.strip() == "[]", out.stderr
