"""HDF5: chunks, the filters that they went through, damage, and sizes that are claimed."""

from __future__ import annotations

import struct
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest

from edge_vpr.errors import EdgeVprError, RecordingError
from edge_vpr.events import Sensor
from tests.streams import read_events

h5py = pytest.importorskip("h5py")

SENSOR = Sensor(40, 30)
FILTERS = {
    "gzip": {"compression": "gzip"},
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
    events = read_events(path, chunk_events=chunk, **options)
    return {name: events[name] for name in "txyp"}


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


def test_a_chunk_that_claims_more_than_the_file_takes_no_memory(tmp_path):
    """The fuzzer found two chunks of one row, of which libhdf5 read the one of 2 GB."""
    path = tmp_path / "a.h5"
    write(path)
    with h5py.File(path) as file:
        chunk = file["events/p"].id.get_chunk_info(1)
    # a key of the tree of chunks: size, mask, row, then column 0, all in little endian
    key = struct.pack("<IIQQ", chunk.size, 0, ROWS, 0)
    data = path.read_bytes()
    assert data.count(key) == 1
    path.write_bytes(data.replace(key, struct.pack("<IIQQ", 2_130_706_465, 0, 0, 0)))
    tracemalloc.start()
    with pytest.raises(RecordingError, match=r"chunks of 2,130,706,\d+ bytes in a file of"):
        read(path)
    assert tracemalloc.get_traced_memory()[1] < 64 << 20
    tracemalloc.stop()


@pytest.mark.parametrize("kind", ["gzip", "lzf-checksum"])
def test_a_damaged_chunk_ends_the_pass(kind, tmp_path):
    write(tmp_path / "a.h5", kind)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        mask, data = file["events/x"].id.read_direct_chunk((ROWS,))
        changed = data[:-9] + bytes([data[-9] ^ 4]) + data[-8:]
        file["events/x"].id.write_direct_chunk((ROWS,), changed, filter_mask=mask)
    with pytest.raises(RecordingError, match=r"is damaged after event 0 "):
        read(tmp_path / "a.h5")
    with pytest.raises(RecordingError, match=r"is damaged after event 63 "):
        read(tmp_path / "a.h5", chunk=7)


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
    hdf5plugin, values = pytest.importorskip("hdf5plugin"), columns()
    with h5py.File(tmp_path / "dsec.h5", "w") as file:
        for name, column in values.items():
            how = hdf5plugin.Blosc(cname="zstd", clevel=5, shuffle=1)
            file.create_dataset(f"events/{name}", data=column, chunks=(ROWS,), **how)
        file["t_offset"] = 49_599_300_523
    program = (
        "import sys, numpy, edge_vpr\n"
        "recording = edge_vpr.open_recording(sys.argv[1], sensor='40x30')\n"
        "numpy.save('t.npy', numpy.concatenate(list(recording))['t'] + recording.start_us)"
    )
    words = [sys.executable, "-c", program, tmp_path / "dsec.h5"]
    subprocess.run(words, check=True, cwd=tmp_path)
    assert np.array_equal(np.load(tmp_path / "t.npy"), values["t"] + 49_599_300_523)


def test_a_chunk_of_more_than_32_mib_is_read(tmp_path):
    n = (1 << 22) + 5_000
    t = np.arange(n, dtype=np.int64)
    values = {"t": t, "x": t.astype("u2") % 40, "y": t.astype("u2") % 30, "p": t % 2 > 0}
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["width"], file.attrs["height"] = SENSOR
        for name, column in values.items():
            file.create_dataset(f"events/{name}", data=column, chunks=(n,), **FILTERS["gzip"])
    events = read_events(tmp_path / "a.h5", chunk_events=1 << 20)
    assert all(np.array_equal(events[name], values[name]) for name in "txyp")
