"""Damaged and odd recordings: false sizes, expanding data, texts, links, full disks."""

from __future__ import annotations

import bz2
import io
import os
import re
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from edge_vpr.errors import EdgeVprError, RecordingError
from edge_vpr.events import EVENT_DTYPE, Sensor, join_events, make_events
from edge_vpr.recordings import aedat, frames, open_recording, write_recording
from edge_vpr.recordings.aedat import expand
from edge_vpr.recordings.reading import foreign_errors
from tests.recordings import recording_files as files
from tests.streams import random_events, read_events

SENSOR = Sensor(40, 30)
FUZZER = Path(__file__).with_name("fuzz_recordings.py")


def refusal(path, **options):
    """Message with which a recording is refused, on opening or on the way."""
    with pytest.raises(EdgeVprError) as raised:
        list(open_recording(path, **options))
    text = str(raised.value)
    assert path.name in text
    assert text.isprintable()
    return text


def fuzz(*words):
    """Run the fuzzer; what it prints."""
    for module in ("h5py", "pyarrow", "rosbags", "lz4", "faery"):
        pytest.importorskip(module)
    done = subprocess.run([sys.executable, FUZZER, *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are read from /proc")
@pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="plain kernels take too much time"
)
def test_mutated_files_of_every_reader_are_read_or_refused_within_their_limits():
    out = fuzz("--inputs", "400", "--seed", "1").splitlines()[-1]
    assert out.startswith("400 inputs")
    assert out.endswith(" 0 failed")
    # both outcomes happen, or the mutations were too weak or too strong to say anything
    assert all(int(out.split(word)[0].split()[-1]) > 40 for word in (" accepted", " refused"))


# --- bombs ----------------------------------------------------------------------------------


def npy_header(shape, dtype):
    out = io.BytesIO()
    facts = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(out, facts)
    return out.getvalue()


def zip_of(path, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)


def png_of(width, height, rows):
    def chunk(name, data):
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


@pytest.fixture(scope="module")
def bombs(tmp_path_factory):
    """Small files that expand to gigabytes, or claim to, and one that ended the process."""
    for module in ("h5py", "pyarrow", "rosbags", "lz4"):
        pytest.importorskip(module)
    import h5py
    import lz4.frame

    folder = tmp_path_factory.mktemp("bombs")
    pixels, events = (1, 15_000, 60_000), npy_header((1,), EVENT_DTYPE.descr) + bytes(13)
    wide = [("t", "<i8"), ("x", "u1"), ("y", "u1"), ("z", "V500000000")]
    long_header = b"\x93NUMPY\2\0" + struct.pack("<I", 1 << 29)
    zip_of(folder / "frame.npz", frames=npy_header(pixels, "|u1"))
    zip_of(folder / "small.npz", events=events, sensor=npy_header((2**27,), "<i8"))
    zip_of(folder / "row.npz", events=npy_header((2,), wide))
    zip_of(folder / "header.npz", events=long_header + bytes(1 << 16))
    with zipfile.ZipFile(folder / "lzma.npz", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("events.npy", events)
    with zipfile.ZipFile(folder / "members.npz", "w") as archive:
        for i in range(2_000):
            archive.writestr(f"{i:0600}.npy", b"")
    np.savez(folder / "counts.npz", frames=np.full((1, 2, 2), 1 << 24), window_s=1.0)
    data = lz4.frame.compress(bytes(1 << 29))
    header = files.aedat4_header((0, "events", *SENSOR), compression=1)
    (folder / "packet.aedat4").write_bytes(header + struct.pack("<ii", 0, len(data)) + data)
    (folder / "length.aedat4").write_bytes(b"#!AER-DAT4.0\r\n\xff\xff\xff\xff")
    claim = struct.pack("<hhiiiiii", 1, 0, 1 << 20, 4, 0, 2_000, 2_000, 2_000)
    with (folder / "packet3.aedat").open("wb") as file:
        file.write(files.aedat3(claim))
        file.truncate(file.tell() + (1 << 20) * 2_000)  # as long as it claims, but empty on disk
    (folder / "header3.aedat").write_bytes(b"#!AER-DAT3.1\r\n" + b"#\r\n" * (1 << 21))
    rows = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
    for name, n, chunk, filters in (
        ("unwritten", 10**12, 1 << 14, {}),
        ("chunk", 3_000_000, 3_000_000, {"compression": "gzip"}),
    ):
        with h5py.File(folder / f"{name}.h5", "w") as file:
            file.attrs["geometry"] = "40x30"
            events = file.create_dataset("CD/events", (n,), rows, chunks=(chunk,), **filters)
            if filters:
                events[:1] = 0
    (folder / "number.csv").write_text(
        "t [us],x,y,p\n0,1,1,1\n3,1e999999999,1,1\n1e999999999,1,1,1\n"
    )
    (folder / "huge.npy").write_bytes(npy_header((2**60,), "<i8") + b"1234")
    _statistics_of_another_schema(folder / "statistics.parquet")
    return folder


def _statistics_of_another_schema(path):
    """Say of an optional column that it is required: pyarrow aborted, as the fuzzer found."""
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table({name: np.arange(9) for name in "txy"}), path)
    data = path.read_bytes()
    optional, required = b"\x25\x02\x18\x01t", b"\x25\x00\x18\x01t"
    assert data.count(optional) == 1
    path.write_bytes(data.replace(optional, required))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are read from /proc")
def test_bombs_are_refused_or_read_in_512_megabytes(bombs):
    paths = sorted(bombs.iterdir())
    assert sum(path.stat().st_blocks for path in paths) * 512 < 30_000_000
    out = fuzz("--files", *map(str, paths)).splitlines()
    # the counts are events that a file may claim, if they are read piece by piece
    assert [line.split()[0] for line in out[:-1] if " 1 accepted" in line] == [
        "counts.npz",
        "number.csv",
    ]


@pytest.mark.slow
def test_bombs_are_named_with_what_they_claim(bombs):
    for name, words in (
        ("frame.npz", "rows of 900,000,000 bytes"),
        ("small.npz", "claims 1,073,741,824 bytes, and the most is 67,108,864"),
        ("row.npz", "rows of 500,000,010 bytes"),
        ("header.npz", "a header of 536,870,912 bytes"),
        ("lzma.npz", "compressed by method 14"),
        ("members.npz", "a list of"),
        ("packet.aedat4", "the packet at byte"),
        ("length.aedat4", "its header claims 4,294,967,295 bytes"),
        ("packet3.aedat", "it claims 2,097,152,000 bytes, of 67,108,864 at most"),
        ("header3.aedat", "its header is longer than 4,194,304 bytes"),
        ("unwritten.h5", "claims 14,000,000,000,000 bytes, and the file holds 0"),
        ("chunk.h5", "each of 42,000,000 expanded"),
    ):
        assert words in refusal(bombs / name)


def test_a_picture_that_claims_more_than_a_camera_has_is_refused_by_its_header(tmp_path):
    (tmp_path / "0.png").write_bytes(png_of(10_000, 10_000, b"\0"))
    assert "claims 10000x10000 pixels" in refusal(tmp_path, frame_period=1)


def test_decompression_stops_at_its_limit_and_joins_frames(monkeypatch):
    data = bz2.compress(b"a" * 1000) + bz2.compress(b"b")
    new, errors = bz2.BZ2Decompressor, (OSError, EOFError)
    monkeypatch.setattr(aedat, "LIMIT_BYTES", 1001)
    assert expand(new, data, errors) == b"a" * 1000 + b"b"
    with pytest.raises(ValueError, match="cut off"):
        expand(new, data[:-3], errors)
    monkeypatch.setattr(aedat, "LIMIT_BYTES", 1000)
    with pytest.raises(ValueError, match="more than 1,000 bytes"):
        expand(new, data, errors)


def test_a_frame_of_many_events_is_expanded_in_pieces_that_change_nothing(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "a.npz", frames=rng.integers(0, 90, (3, 7, 9)))
    whole = read_events(tmp_path / "a.npz", frame_period=1)
    for most in (50, 1000):
        monkeypatch.setattr(frames, "_MOST_EXPANDED", most)
        pieces = open_recording(tmp_path / "a.npz", frame_period=1)
        assert np.array_equal(join_events(list(pieces)), whole)


def test_a_damaged_parquet_file_is_refused_with_its_place(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    numbers = np.arange(50_000)
    table = pa.table({"t": numbers, "x": numbers % 40, "y": numbers % 30})
    path = tmp_path / "a.parquet"
    parquet.write_table(table, path, row_group_size=20_000, write_page_checksum=True)
    data = path.read_bytes()
    path.write_bytes(data[:60_000] + b"damaged" + data[60_007:])
    assert re.search("damaged after event [0-9,]+ ", refusal(path, sensor=SENSOR))
    parquet.write_table(pa.table({"t": ["a"], "x": [1], "y": [1]}), tmp_path / "text.parquet")
    assert "column t has type string" in refusal(tmp_path / "text.parquet", sensor=SENSOR)


# --- silently wrong -------------------------------------------------------------------------


def columns_npz(path, t, **more):
    zeros = np.zeros(len(t), np.uint16)
    np.savez(path, **({"t": t, "x": zeros, "y": zeros} | more), sensor=[40, 30])


def test_a_column_that_is_shorter_than_its_header_is_a_cut_off_end(tmp_path):
    column = npy_header((5,), "<i8") + np.arange(5).tobytes()
    short = npy_header((5,), "<i8") + np.arange(3).tobytes() + b"12"
    zip_of(
        tmp_path / "a.npz",
        t=column,
        x=column,
        y=short,
        sensor=npy_header((2,), "<i8") + np.array([40, 30]).tobytes(),
    )
    assert "cut off: 14 bytes" in refusal(tmp_path / "a.npz")
    for chunk in (1, 2, 3, 4, 99):
        recording = open_recording(tmp_path / "a.npz", on_fault="drop", chunk_events=chunk)
        assert join_events(list(recording))["x"].tolist() == [0, 1, 2]
        assert recording.faults.truncated == 14


def test_a_column_that_is_longer_than_its_header_is_refused(tmp_path):
    """Its last events would be left out in silence."""
    column = npy_header((3,), "<i8") + np.arange(5).tobytes()
    sensor = npy_header((2,), "<i8") + np.array([40, 30]).tobytes()
    zip_of(tmp_path / "a.npz", t=column, x=column, y=column, sensor=sensor)
    for fault in ("error", "drop"):
        text = refusal(tmp_path / "a.npz", on_fault=fault)
        assert "announces (3,) of int64 and holds 40 bytes" in text


@pytest.mark.parametrize(
    ("t", "unit", "entry"),
    [
        (np.array([0, 2**63 - 5]), None, 1),
        (np.array([0, 2**63 + 5], np.uint64), None, 1),
        (np.array([0, -(2**60) - 1]), None, 1),
        (np.array([0, 2**44]), "s", 1),
        (np.array([0, 2**62]), "s", 1),
        (np.array([0.0, 1e300]), "us", 1),
        (np.array([0.0, np.inf]), "us", 1),
        (np.array([0, "NaT"], "M8[us]"), None, 1),
        (np.array([0, 2**60], "M8[7D]"), None, 1),
    ],
)
def test_a_time_that_does_not_fit_or_is_none_is_no_event(t, unit, entry, tmp_path):
    columns_npz(tmp_path / "a.npz", t)
    text = refusal(tmp_path / "a.npz", time_unit=unit)
    assert f"entry {entry} is no event" in text or "lies beyond 2**60 us" in text
    recording = open_recording(tmp_path / "a.npz", time_unit=unit, on_fault="drop")
    assert join_events(list(recording))["t"].tolist() == [0]
    assert recording.faults.unreadable == 1


@pytest.mark.parametrize(
    ("dtype", "us"),
    [
        ("M8[25us]", 75),
        ("M8[ns]", 0),
        ("M8[3ms]", 9000),
        ("M8[2h]", 6 * 3_600_000_000),
        ("m8[s]", 3_000_000),
        (">M8[us]", 3),
    ],
)
def test_datetimes_of_any_scale_are_microseconds(dtype, us, tmp_path):
    columns_npz(tmp_path / "a.npz", np.array([0, 3], dtype))
    assert read_events(tmp_path / "a.npz")["t"].tolist() == [0, us]


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"t": np.array([0, 1j])}, "column t has dtype complex128"),
        ({"t": np.array([0, 1], "M8[M]")}, "no unit of fixed length"),
        ({"t": np.array(["a", "b"])}, "column t has dtype <U1"),
        ({"x": np.array([0, 1j])}, "column x has dtype complex128"),
        ({"p": np.array(["a", "b"])}, "column p has dtype <U1"),
    ],
)
def test_columns_that_are_no_real_numbers_are_refused(columns, words, tmp_path):
    columns_npz(tmp_path / "a.npz", **({"t": np.arange(2)} | columns))
    assert words in refusal(tmp_path / "a.npz")


@pytest.mark.parametrize("side", [0, -1, 65537, 2**20, 2**62])
def test_sensors_have_1_to_65536_pixels_a_side(side, tmp_path):
    events = make_events([0], [0], [0])
    np.savez(tmp_path / "a.npz", events=events, sensor=[side, 30])
    assert "sides are 1 to 65,536" in refusal(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", events=events, sensor=[65536, 65536])
    assert open_recording(tmp_path / "b.npz").sensor == Sensor(65536, 65536)


def test_a_polarity_byte_beyond_1_is_on_and_no_strange_boolean(tmp_path):
    events = make_events([0, 1, 2], [0, 0, 0], [0, 0, 0], [1, 0, 1])
    np.save(tmp_path / "a.npy", events)
    data = (tmp_path / "a.npy").read_bytes()
    at = data.index(np.asarray(events).tobytes()) + EVENT_DTYPE.itemsize - 1
    (tmp_path / "a.npy").write_bytes(data[:at] + b"\x07" + data[at + 1 :])
    (again,) = open_recording(tmp_path / "a.npy", sensor=SENSOR)
    assert again["p"].copy().view(np.uint8).tolist() == [1, 0, 1]


def test_csv_stays_readable_for_others(tmp_path):
    path = tmp_path / "a.csv"
    write_recording(path, make_events([3, 9], [1, 39], [2, 29], [0, 1]), sensor=SENSOR, start_us=-7)
    table = np.genfromtxt(path, delimiter=",", comments="#", skip_header=2)
    assert table.tolist() == [[3, 1, 2, 0], [9, 39, 29, 1]]


# --- other files, names, foreign exceptions -------------------------------------------------


def test_hdf5_reads_no_other_file(tmp_path):
    h5py = pytest.importorskip("h5py")
    t = np.arange(8)
    (tmp_path / "secret").write_bytes(b"root:x:0:0:root:/root:/bin/bash\n" * 4)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = t
    with h5py.File(tmp_path / "external.h5", "w") as file:
        file["events/t"] = file["events/y"] = t
        file.create_dataset("events/x", (8,), "i8", external=[(str(tmp_path / "secret"), 0, 64)])
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        file["events/t"] = file["events/y"] = t
        layout = h5py.VirtualLayout((8,), "i8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", (8,))
        file.create_virtual_dataset("events/x", layout)
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["events/t"] = file["events/y"] = t
        file["events/x"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "x")
    for name in ("external", "virtual"):
        assert "lies in other files" in refusal(tmp_path / f"{name}.h5", sensor=SENSOR)
    assert "holds no datasets t, x, y, p" in refusal(tmp_path / "link.h5", sensor=SENSOR)


def test_texts_out_of_a_file_do_not_reach_the_terminal_as_they_are(tmp_path):
    np.savez(tmp_path / "a.npz", **{"\x1b[2J\x1b[31mgone\u202e": np.zeros(2)})
    text = refusal(tmp_path / "a.npz")
    assert r"\x1b[2J\x1b[31mgone\u202e" in text
    np.savez(tmp_path / "b.npz", **{f"{i}{'long' * 20}": np.zeros(2) for i in range(90)})
    assert len(refusal(tmp_path / "b.npz")) <= 1000
    (tmp_path / "c.csv").write_bytes(b"t,x,y,p\n0,0,0,1\n\x1b]0;title\x07\n")
    assert r"\x1b]0;title" in refusal(tmp_path / "c.csv", sensor=SENSOR)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (KeyError("x"), "a.bin is damaged after event 5 (KeyError: 'x')"),
        (RecursionError("deep"), "RecursionError: deep"),
        (MemoryError(), "needs more memory after event 5"),
        (OSError(5, "Input/output error"), "cannot be read after event 5: Input/output error"),
        (OSError("not by the system"), "is damaged after event 5 (OSError: not by the system)"),
        (type("PanicException", (BaseException,), {})("rust"), "PanicException: rust"),
        (RecordingError("sensor is odd"), "a.bin: sensor is odd"),
    ],
)
def test_no_foreign_exception_passes_the_wall(error, words):
    with (
        pytest.raises(RecordingError) as raised,
        foreign_errors(Path("a.bin"), lambda: " after event 5"),
    ):
        raise error
    assert words in str(raised.value)
    with pytest.raises(KeyboardInterrupt), foreign_errors(Path("a.bin")):
        raise KeyboardInterrupt


# --- full disks -----------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".raw", ".csv", ".npz"])
@pytest.mark.parametrize("size", [3_000, 30_000])
def test_a_full_disk_is_one_line_and_leaves_nothing(suffix, size, tmp_path, files_end_at):
    def drive():
        for i in range(30):
            events = random_events(np.random.default_rng(i), 5_000, SENSOR, 5_000)
            events.t += 5_000 * i
            yield events

    path, source = tmp_path / f"a{suffix}", drive()
    with files_end_at(size), pytest.raises(RecordingError) as raised:
        write_recording(path, source, sensor=SENSOR)
    message = str(raised.value)
    assert message.startswith(f"{path} cannot be written: ") and "File too large" in message
    assert "\n" not in message
    assert suffix == ".npz" or next(source, None) is not None  # a disk that is full ends the drive
    assert not list(tmp_path.iterdir())
