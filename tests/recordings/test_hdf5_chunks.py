"""Chunks of HDF5 whose size is not the one that the data set states, and those whose size is."""

from __future__ import annotations

import struct
import subprocess
import sys
import tracemalloc
import zlib

import numpy as np
import pytest

from edge_vpr.errors import EdgeVprError, RecordingError
from edge_vpr.events import Sensor
from edge_vpr.recordings import open_recording
from edge_vpr.recordings.hdf5 import lzf_size

h5py = pytest.importorskip("h5py")

SENSOR = Sensor(40, 30)
FILTERS = {
    "gzip": {"compression": "gzip"},
    "shuffle": {"compression": "gzip", "shuffle": True},
    "checksum": {"compression": "gzip", "shuffle": True, "fletcher32": True},
    "lzf": {"compression": "lzf", "shuffle": True},
    "lzf-checksum": {"compression": "lzf", "fletcher32": True},
    "only-checksum": {"fletcher32": True},
}
N, ROWS = 150, 64


def columns():
    rng = np.random.default_rng(5)
    t = np.sort(rng.integers(0, 9_000, N))
    return {"t": t, "x": rng.integers(0, 40, N), "y": t % 30, "p": rng.integers(0, 2, N) > 0}


def write(path, kind="gzip", layout="group", values=None):
    """Three chunks a data set, the last of them beyond the border."""
    with h5py.File(path, "w") as file:
        file.attrs["width"], file.attrs["height"] = SENSOR
        values = columns() if values is None else values
        how = {"chunks": (ROWS,), **FILTERS[kind]}
        if layout == "group":
            for name, column in values.items():
                file.create_dataset(f"events/{name}", data=column, **how)
        elif layout == "rows":
            dtype = [("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", ">i8")]
            rows = np.empty(N, dtype)
            for name, column in values.items():
                rows[name] = column
            file.create_dataset("CD/events", data=rows, **how)
        else:
            table = np.stack(list(values.values()), axis=1).astype(np.int64)
            file.create_dataset("events", data=table, **{**how, "chunks": (ROWS, 3)})


def read(path, layout="group", chunk=1 << 16):
    options = {"columns": "txyp", "sensor": SENSOR} if layout == "table" else {}
    events = np.concatenate(list(open_recording(path, chunk_events=chunk, **options)))
    return {name: events[name] for name in "txyp"}


def refused(path, layout="group"):
    with pytest.raises(RecordingError, match=r"chunk at row \d+ that does not expand to its"):
        read(path, layout)
    with pytest.raises(RecordingError, match="does not expand"):
        read(path, layout, chunk=7)


@pytest.mark.parametrize("layout", ["group", "rows", "table"])
@pytest.mark.parametrize("kind", FILTERS)
def test_whole_chunks_are_read_as_they_were_written_in_slices_of_any_size(kind, layout, tmp_path):
    expected = columns()
    start = expected["t"][0]
    write(tmp_path / "a.h5", kind, layout)
    for chunk in (1, 7, ROWS, 100, 1 << 16):
        again = read(tmp_path / "a.h5", layout, chunk)
        assert np.array_equal(again["t"] + start, expected["t"])
        assert all(np.array_equal(again[name], expected[name]) for name in "xyp")


@pytest.mark.parametrize("more", [-1, 1, -500, 1 << 20])
@pytest.mark.parametrize("kind", ["gzip", "shuffle"])
def test_a_deflated_chunk_of_another_size_is_refused(kind, more, tmp_path):
    """libhdf5 alone reads beyond the buffer of a short one, and expands a long one to its end."""
    write(tmp_path / "a.h5", kind)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        data = zlib.compress(bytes(ROWS * 8 + more))
        file["events/t"].id.write_direct_chunk((ROWS,), data)
    refused(tmp_path / "a.h5")


@pytest.mark.parametrize("layout", ["group", "rows", "table"])
@pytest.mark.parametrize("kind", FILTERS)
def test_a_chunk_that_says_that_it_is_not_compressed_has_its_full_size(kind, layout, tmp_path):
    """The fuzzer found one that had not, whose rest was what was in memory."""
    write(tmp_path / "a.h5", kind, layout)
    expected = read(tmp_path / "a.h5", layout)
    name = {"group": "events/y", "rows": "CD/events", "table": "events"}[layout]
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        dataset = file[name]
        at = (ROWS, 0)[: dataset.ndim]
        octets = dataset[ROWS : 2 * ROWS, :3].tobytes() if at[1:] else dataset[ROWS:128].tobytes()
        dataset.id.write_direct_chunk(at, octets, filter_mask=0b111)
    again = read(tmp_path / "a.h5", layout)
    assert all(np.array_equal(again[name], expected[name]) for name in "txyp")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file[name].id.write_direct_chunk(at, octets[:-1], filter_mask=0b111)
    refused(tmp_path / "a.h5", layout)


def test_a_chunk_that_claims_more_than_the_file_takes_no_memory(tmp_path):
    """The fuzzer found two chunks of one row, of which libhdf5 read the one of 2 GB."""
    path = tmp_path / "a.h5"
    write(path)
    with h5py.File(path) as file:
        found = file["events/p"].id.get_chunk_info(1)
    # a key of the tree of chunks: size, mask, row, then column 0, all in little endian
    key = struct.pack("<IIQQ", found.size, 0, ROWS, 0)
    data = path.read_bytes()
    assert data.count(key) == 1
    path.write_bytes(data.replace(key, struct.pack("<IIQQ", 2_130_706_465, 0, 0, 0)))
    tracemalloc.start()
    with pytest.raises(RecordingError, match=r"chunks of 2,130,706,\d+ bytes in a file of"):
        read(path)
    assert tracemalloc.get_traced_memory()[1] < 64 << 20
    tracemalloc.stop()


def test_a_cut_off_or_damaged_stream_is_refused(tmp_path):
    write(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        _, data = file["events/x"].id.read_direct_chunk((0,))
        file["events/x"].id.write_direct_chunk((0,), data[:-9])
    refused(tmp_path / "a.h5")


def test_lzf_that_expands_to_less_is_refused_and_its_size_is_what_h5py_expands(tmp_path):
    write(tmp_path / "a.h5", "lzf")
    rng = np.random.default_rng(2)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        for i in range(40):
            values = rng.integers(0, 1 + 5 * i, 3000).astype(np.uint8)
            values[i * 50 :] = 7
            dataset = file.create_dataset(f"{i}", data=values, chunks=(3000,), compression="lzf")
            mask, data = dataset.id.read_direct_chunk((0,))
            assert mask or lzf_size(np.frombuffer(data, np.uint8)) == 3000
        assert mask == 0
    octets = np.frombuffer(data, np.uint8)
    assert lzf_size(octets[:-1]) == -1
    assert lzf_size(np.array([32, 0], np.uint8)) == -1  # refers to before the start
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["events/t"].id.write_direct_chunk((0,), bytes([3, 1, 2, 3, 4]))
    refused(tmp_path / "a.h5")


def test_a_chunk_that_was_never_written_has_the_fill_value(tmp_path):
    write(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file["events/x"]
        dataset = file.create_dataset(
            "events/x", (N,), "<u2", chunks=(ROWS,), compression="gzip", fillvalue=9
        )
        dataset[:ROWS] = 3
    for chunk in (10, 1 << 16):
        again = read(tmp_path / "a.h5", chunk=chunk)["x"]
        assert again.tolist() == [3] * ROWS + [9] * (N - ROWS)


def test_filters_whose_sizes_cannot_be_checked_are_refused_with_a_remedy(tmp_path):
    values = columns()
    write(tmp_path / "a.h5", values=values)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file["events/t"]
        file.create_dataset("events/t", data=values["t"], chunks=(ROWS,), scaleoffset=0)
    with pytest.raises(RecordingError, match=r"filters \[6\], whose .* h5repack -f GZIP=4"):
        read(tmp_path / "a.h5")


def stored_through(path, number):
    """Write columns whose chunks went through a filter that need not be installed."""
    write(path, "only-checksum")
    with h5py.File(path, "r+") as file:
        del file["events/t"]
        pipeline = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        pipeline.set_chunk((ROWS,))
        pipeline.set_filter(number, h5py.h5z.FLAG_OPTIONAL, ())
        space = h5py.h5s.create_simple((N,))
        column = h5py.h5d.create(file["events"].id, b"t", h5py.h5t.STD_I64LE, space, pipeline)
        for first in range(0, N, ROWS):
            column.write_direct_chunk((first,), b"compressed")


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (32_001, r"/events/t, .* filter 32001 \(Blosc\), needs .* hdf5plugin, .*\[hdf5-filters\]"),
        (36_559, r"filter 36559 \(ECF, of Metavision\), which is not installed: .*PLUGIN_PATH"),
        (40_000, r"filter 40000 \(not in our list\), which is not installed"),
    ],
)
def test_a_filter_that_is_not_installed_is_named_with_what_installs_it(
    number, expected, tmp_path, monkeypatch
):
    monkeypatch.setattr(h5py.h5z, "filter_avail", lambda number: number < 256)
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    stored_through(tmp_path / "a.h5", number)
    with pytest.raises(EdgeVprError, match=expected):
        read(tmp_path / "a.h5")


def test_blosc_as_in_published_files_of_dsec_is_read_without_an_import_by_the_user(tmp_path):
    """In a process of its own: once imported, the library is found in any case."""
    pytest.importorskip("hdf5plugin")
    program = f"""
import h5py, hdf5plugin, numpy as np
rng = np.random.default_rng(5)
t = np.sort(rng.integers(0, 3_000_000, {N}))
columns = dict(t=t.astype("<u4"), x=t.astype("<u2") % 40, y=t.astype("<u2") % 30, p=t < 0)
with h5py.File({str(tmp_path / "dsec.h5")!r}, "w") as file:
    for name, column in columns.items():
        file.create_dataset(f"events/{{name}}", data=column.astype(column.dtype), chunks=({ROWS},),
                            **hdf5plugin.Blosc(cname="zstd", clevel=5, shuffle=1))
    file["t_offset"] = 49_599_300_523
np.save({str(tmp_path / "t.npy")!r}, t)
"""
    subprocess.run([sys.executable, "-c", program], check=True)
    program = f"""
import numpy as np, edge_vpr
recording = edge_vpr.open_recording({str(tmp_path / "dsec.h5")!r}, sensor="40x30")
t = np.load({str(tmp_path / "t.npy")!r})
assert np.array_equal(np.concatenate(list(recording))["t"], t - t[0])
assert recording.start_us == 49_599_300_523 + t[0]
"""
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.parametrize("kind", ["gzip", "lzf-checksum"])
def test_a_chunk_of_more_than_32_mib_is_read_and_expanded_once(kind, tmp_path):
    n = (1 << 22) + 5_000
    t = np.arange(n, dtype=np.int64)
    values = {"t": t, "x": t.astype("u2") % 40, "y": t.astype("u2") % 30, "p": t % 2 > 0}
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["width"], file.attrs["height"] = SENSOR
        for name, column in values.items():
            file.create_dataset(f"events/{name}", data=column, chunks=(n,), **FILTERS[kind])
    events = np.concatenate(list(open_recording(tmp_path / "a.h5", chunk_events=1 << 20)))
    assert all(np.array_equal(events[name], values[name]) for name in "txyp")
