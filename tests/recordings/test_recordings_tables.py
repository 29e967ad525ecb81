"""Tables of events: names, orders, units, and entries that are no event."""

from __future__ import annotations

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import Sensor, join_events
from edge_vpr.recordings import open_recording
from tests.streams import random_events

SENSOR = Sensor(64, 48)
ROWS = [(1000, 3, 4, True), (1250, 63, 47, False), (2_000_000, 0, 0, True)]
EXPECTED = [(0, 3, 4, True), (250, 63, 47, False), (1_999_000, 0, 0, True)]


def write_table(path, table, *, header=False, whole=False):
    """Write columns by their names; `whole` makes one array of fields of them in NPZ and HDF5."""
    dtype = [(name, column.dtype) for name, column in table.items()]
    rows = np.empty(len(next(iter(table.values()))), dtype)
    for name, column in table.items():
        rows[name] = column
    if path.suffix == ".csv":
        forms = ["%.18e" if column.dtype.kind == "f" else "%d" for column in table.values()]
        names = ",".join(table) if header else ""
        np.savetxt(path, rows, forms, delimiter=",", header=names, comments="")
    elif path.suffix == ".npy":
        np.save(path, rows)
    elif path.suffix == ".npz":
        np.savez(path, **({"events": rows} if whole else table))
    elif path.suffix == ".h5":
        with pytest.importorskip("h5py").File(path, "w") as file:
            for name, column in ({"events": rows} if whole else table).items():
                file[name if whole else f"events/{name}"] = column
    else:
        pyarrow = pytest.importorskip("pyarrow")
        pytest.importorskip("pyarrow.parquet").write_table(pyarrow.table(table), path)
    return path


def rows_of(path, **options):
    recording = open_recording(path, **({"sensor": SENSOR} | options))
    return join_events(list(recording)).tolist(), recording


@pytest.mark.parametrize("separator", [",", " ", "\t", ";", ", "])
@pytest.mark.parametrize("order", ["txyp", "xytp", "pyxt"])
@pytest.mark.parametrize("header", [True, False])
def test_text_in_any_order_and_separator_gives_the_same_events(separator, order, header, tmp_path):
    lines = [separator.join({"t": "timestamp", "p": "polarity"}.get(c, c) for c in order)]
    for t, x, y, p in ROWS:
        values = {"t": f"{t / 1e6:.6f}", "x": str(x), "y": str(y), "p": str(int(p))}
        lines.append(separator.join(values[c] for c in order))
    path = tmp_path / "a.txt"
    path.write_text("# a comment\n" + "\n".join(lines[0 if header else 1 :]) + "\n")
    rows, recording = rows_of(path, columns=None if header else order, time_unit="s")
    assert rows == EXPECTED
    assert recording.start_us == 1000


@given(us=st.integers(0, 1 << 52), unit=st.sampled_from(["s", "ms", "us", "ns"]))
def test_whole_microseconds_are_exact_in_text_of_any_unit(us, unit, tmp_path_factory):
    path = tmp_path_factory.mktemp("t") / "a.csv"
    places = {"s": 6, "ms": 3, "us": 0, "ns": 0}[unit]
    number = Decimal(us * 1000 if unit == "ns" else us).scaleb(-places)
    path.write_text(f"{number:f},0,0,1\n")
    assert open_recording(path, sensor=SENSOR, time_unit=unit).start_us == us


def test_seconds_since_1970_keep_their_microseconds(tmp_path):
    (tmp_path / "a.txt").write_text("1587540271.650123 1 2 0\n1587540271.650124999 1 2 1\n")
    rows, recording = rows_of(tmp_path / "a.txt", time_unit="s")
    assert recording.start_us == 1_587_540_271_650_123
    assert [row[0] for row in rows] == [0, 2]


def test_a_first_line_of_two_numbers_is_the_sensor(tmp_path):
    (tmp_path / "a.txt").write_text("240 180\n5 3 4 1\n")
    assert open_recording(tmp_path / "a.txt").sensor == Sensor(240, 180)


def test_unusual_numbers_are_read_and_entries_that_are_no_event_are_not(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(
        "t [s],x,y,p\r\n"
        "1e-05,3.0,4,1\r\n"  # an exponent, a whole number with a fraction
        "\r\n"
        "0.00002,5,6,true\r\n"
        "0.00003,5.5,6,0\r\n"  # half a pixel
        "0.00003,5,6\r\n"  # a column too few
        "nan,5,6,1\r\n"
        "0.00004,5,6,-1\r\n"
        "0.00005,5"  # cut off
    )
    with pytest.raises(RecordingError, match=r"line 3 of the events is no event .*on_fault="):
        rows_of(path)
    rows, recording = rows_of(path, on_fault="drop")
    assert rows == [(0, 3, 4, True), (10, 5, 6, True), (30, 5, 6, False)]
    assert (recording.faults.unreadable, recording.faults.truncated) == (3, 9)
    assert recording.faults.total == 4


def test_a_whole_last_line_without_line_feed_is_an_event(tmp_path):
    (tmp_path / "a.csv").write_text("0,1,2,1\n5,1,2,1")
    assert len(rows_of(tmp_path / "a.csv")[0]) == 2


def test_a_fraction_after_whole_times_is_refused_without_a_unit(tmp_path):
    lines = [f"{i},0,0,1" for i in range(100_000)] + ["100000.5,0,0,1"]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(RecordingError, match=r"decimal point.*: pass time_unit=, one of s, ms"):
        rows_of(tmp_path / "a.csv")
    assert len(rows_of(tmp_path / "a.csv", time_unit="us")[0]) == 100_001


def test_arrays_of_fields_or_columns_of_any_type_are_events(tmp_path):
    t, x, y, p = (np.array(column) for column in zip(*ROWS, strict=True))
    fields = np.zeros(3, [("polarity", "i1"), ("x", "f4"), ("y", "u8"), ("ts", "f8")])
    fields["polarity"], fields["x"], fields["y"], fields["ts"] = p * 2 - 1, x, y, t / 1e6
    np.save(tmp_path / "fields.npy", fields)
    np.save(tmp_path / "columns.npy", np.stack([t, x, y, p], axis=1))
    np.save(tmp_path / "other.npy", np.stack([x, y, t, p], axis=1).astype(float) * [1, 1, 1e-6, 1])
    np.savez(tmp_path / "a.npz", t=t, x=x, y=y, p=p, width=64, height=48)
    np.savez_compressed(tmp_path / "b.npz", events=fields, sensor_size=np.array([64, 48]))
    np.savez(tmp_path / "c.npz", t=t.astype("datetime64[us]"), x=x, y=y, p=p)
    assert rows_of(tmp_path / "fields.npy", time_unit="s")[0] == EXPECTED
    assert rows_of(tmp_path / "columns.npy")[0] == EXPECTED
    assert rows_of(tmp_path / "other.npy", columns="xytp", time_unit="s")[0] == EXPECTED
    for name, unit in (("a.npz", None), ("b.npz", "s")):
        assert rows_of(tmp_path / name, sensor=None, time_unit=unit)[0] == EXPECTED
    assert rows_of(tmp_path / "c.npz")[0] == EXPECTED


def test_arrays_that_are_no_events_say_why(tmp_path):
    objects = np.array([{"t": 1}], object)
    for name, array, words in (
        ("a", objects, "never unpickled"),
        ("b", np.zeros((5, 2)), r"shape \(5, 2\)"),
        ("c", np.asfortranarray(np.zeros((5, 4))), "Fortran order"),
        ("d", np.zeros(2, [("when", "i8"), ("x", "u2")]), "fields when, x"),
    ):
        np.save(tmp_path / f"{name}.npy", array, allow_pickle=True)
        with pytest.raises(RecordingError, match=words):
            rows_of(tmp_path / f"{name}.npy")
    np.savez(tmp_path / "a.npz", t=np.arange(3), x=np.arange(2), y=np.arange(3))
    with pytest.raises(RecordingError, match=r"shapes t \(3,\), x \(2,\)"):
        rows_of(tmp_path / "a.npz")


def test_an_array_that_is_cut_off_says_how_many_events_are_left(tmp_path):
    path = tmp_path / "a.npy"
    events = random_events(np.random.default_rng(0), 100, SENSOR, 1000)
    np.save(path, events)
    path.write_bytes(path.read_bytes()[:-20])  # 13 bytes an event
    with pytest.raises(RecordingError, match=r"cut off: 20 bytes .* at event 98 of 100"):
        rows_of(path)
    rows, recording = rows_of(path, on_fault="drop")
    assert len(rows) == 98
    assert recording.faults.truncated == 20


@pytest.mark.parametrize("row_group", [1000, 10**6])
def test_parquet_of_the_papers_authors_is_read_by_batches(row_group, tmp_path):
    """Columns x, y, p, t with t in whole microseconds since 1970, and a pandas index."""
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    events = random_events(np.random.default_rng(1), 20_000, SENSOR, 10**7)
    columns = {name: events[name].copy() for name in ("x", "y", "p", "t")}
    columns["t"] = columns["t"] + 1_587_452_582_350_000
    table = pa.table(columns | {"__index_level_0__": np.arange(events.size)})
    parquet.write_table(table, tmp_path / "a.parquet", row_group_size=row_group)
    recording = open_recording(tmp_path / "a.parquet", sensor=SENSOR, chunk_events=3000)
    chunks = list(recording)
    again = join_events(chunks)
    assert max(chunk.size for chunk in chunks) <= 3000
    assert recording.start_us == 1_587_452_582_350_000 + events["t"][0]
    again.t += events["t"][0]
    assert np.array_equal(again, events)


def test_parquet_with_nulls_or_other_columns_says_so(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    parquet.write_table(pa.table({"a": [1], "t": [2]}), tmp_path / "a.parquet")
    with pytest.raises(RecordingError, match="has the columns a, t, and not"):
        rows_of(tmp_path / "a.parquet")
    nulls = pa.table({"t": [1, None, 3], "x": [1, 2, 3], "y": [1, 2, 3], "p": [1, 0, 1]})
    parquet.write_table(nulls, tmp_path / "b.parquet")
    with pytest.raises(RecordingError, match=r"entry 1 is no event \(t = nan"):
        rows_of(tmp_path / "b.parquet", time_unit="us")
    rows, recording = rows_of(tmp_path / "b.parquet", on_fault="drop", time_unit="us")
    assert rows == [(0, 1, 1, True), (2, 3, 3, True)]
    assert recording.faults.unreadable == 1


def test_hdf5_of_metavision_and_of_dsec_and_of_float_seconds_are_read(tmp_path):
    h5py = pytest.importorskip("h5py")
    t, x, y, p = (np.array(column) for column in zip(*ROWS, strict=True))
    with h5py.File(tmp_path / "metavision.h5", "w") as file:
        file.attrs["geometry"] = "64x48"
        rows = np.zeros(3, [("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
        rows["x"], rows["y"], rows["p"], rows["t"] = x, y, p, t
        file["CD/events"] = rows
        file["CD/indexes"] = np.zeros(2, [("id", "u8"), ("ts", "i8")])
        file["EXT_TRIGGER/events"] = np.zeros(2, [("p", "i2"), ("t", "i8"), ("id", "i2")])
    with h5py.File(tmp_path / "dsec.h5", "w") as file:
        for name, column in zip("txyp", (t.astype("u4"), x, y, p), strict=True):
            file[f"events/{name}"] = column
        file["t_offset"] = 49_599_300_523
        file["ms_to_idx"] = np.arange(2000)
    with h5py.File(tmp_path / "floats.h5", "w") as file:
        for name, column in zip(("ts", "xs", "ys", "ps"), (t / 1e6, x, y, p), strict=True):
            file[f"events/{name}"] = column
    rows, recording = rows_of(tmp_path / "metavision.h5", sensor=None)
    assert (rows, recording.sensor, recording.start_us) == (EXPECTED, SENSOR, 1000)
    rows, recording = rows_of(tmp_path / "dsec.h5")
    assert (rows, recording.start_us) == (EXPECTED, 49_599_301_523)
    assert rows_of(tmp_path / "floats.h5", time_unit="s")[0] == EXPECTED


@pytest.mark.parametrize("units", ["nanoseconds", b"nanoseconds", " NS "])
def test_hdf5_whose_times_have_an_attribute_units_needs_no_time_unit(units, tmp_path):
    """As in NSAVP: names of columns without a unit, and the size of the sensor at the group."""
    h5py = pytest.importorskip("h5py", reason="h5py is not installed (extra hdf5)")
    t, x, y, p = (np.array(column) for column in zip(*ROWS, strict=True))
    path = tmp_path / "R0_FA0_dvxplorer_left.h5"
    with h5py.File(path, "w") as file:
        events = file.create_group("events")
        events.attrs.update(width=SENSOR.width, height=SENSOR.height)
        events["x_coordinates"], events["y_coordinates"] = x.astype("u2"), y.astype("u2")
        events["polarities"] = p.astype("u1")
        since_ns = 1_650_000_000 * 10**9 + t.astype("u8") * 1_000
        events.create_dataset("timestamps", data=since_ns, chunks=(2,), compression="gzip")
        events["timestamps"].attrs["units"] = units
    assert rows_of(path, sensor=None)[0] == EXPECTED
    with h5py.File(path, "a") as file:
        file["events/timestamps"].attrs["units"] = "fortnights"
    with pytest.raises(RecordingError, match="check time_unit="):
        rows_of(path, sensor=None)


def test_hdf5_with_two_cameras_asks_which(tmp_path):
    h5py = pytest.importorskip("h5py")
    events = np.array([(x, y, t / 1e6, 2 * p - 1) for t, x, y, p in ROWS])
    with h5py.File(tmp_path / "mvsec.hdf5", "w") as file:
        file["davis/left/events"] = events
        file["davis/right/events"] = events[:2]
    path = tmp_path / "mvsec.hdf5"
    with pytest.raises(UsageError, match="davis/left/events, davis/right/events: choose one"):
        rows_of(path, columns="xytp")
    with pytest.raises(RecordingError, match="columns="):
        rows_of(path)
    rows, _ = rows_of(path, columns="xytp", topic="/davis/left/events", time_unit="s")
    assert rows == EXPECTED


def test_hdf5_that_was_not_closed_is_found(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, n in zip("txyp", (5, 5, 4, 5), strict=True):
            file[f"events/{name}"] = np.arange(n)
    with pytest.raises(RecordingError, match=r"different lengths .*y 4"):
        rows_of(tmp_path / "a.h5")


def test_without_a_polarity_all_events_are_on(tmp_path):
    (tmp_path / "a.csv").write_text("t,x,y\n0,1,2\n")
    assert rows_of(tmp_path / "a.csv")[0] == [(0, 1, 2, True)]
    (tmp_path / "b.csv").write_text("0,1,2\n1,1,2\n")
    rows, recording = rows_of(tmp_path / "b.csv")
    assert rows == [(0, 1, 2, True), (1, 1, 2, True)]
    assert recording.without_polarity


# --- headers, units and orders of other programs ---------------------------------------------


def rows_written(n=2_000):
    """Events of 10,000 a second, as of a small sensor, in whole microseconds."""
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, n * 100, n)) + 91
    return t, rng.integers(0, 64, n), rng.integers(0, 48, n), rng.integers(0, 2, n)


UNIT_NAMES = {
    "s": ("s", "sec", "Seconds"),
    "ms": ("ms", "msec", "milliseconds"),
    "us": ("us", "µs", "usec", "microseconds"),
    "ns": ("ns", "nsec", "nanoseconds"),
}
US_OF = {"s": 1e-6, "ms": 1e-3, "us": 1, "ns": 1_000}


@pytest.mark.parametrize(
    ("unit", "name"), [(unit, name) for unit, names in UNIT_NAMES.items() for name in names]
)
@pytest.mark.parametrize(
    "form", ["{0} [{1}]", "{0}({1})", "{0}_{1}", '"{0} [{1}]"', "#{0} [{1}]", "{0}/{1}"]
)
def test_a_header_states_the_unit_of_the_times(unit, name, form, tmp_path):
    path = tmp_path / "a.csv"
    t, x, y, p = rows_written(50)
    lines = [form.format("timestamp", name) + ",x [px],y_px,polarity"]
    lines += [f"{t * US_OF[unit]:.9g},{x},{y},{p}" for t, x, y, p in zip(t, x, y, p, strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="latin-1" if "µ" in name else "utf-8")
    rows, _ = rows_of(path)
    assert [row[0] for row in rows] == (t - t[0]).tolist()
    assert [row[1:] for row in rows] == list(zip(x, y, p == 1, strict=True))
    # who names a unit knows better
    assert rows_of(path, time_unit="ns" if unit == "us" else "us")[1].start_us != t[0]


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("quoted", [False, True])
@pytest.mark.parametrize("index", ["none", "pandas"])
def test_an_index_and_quotes_are_passed_over(separator, quoted, index, tmp_path):
    t, x, y, p = rows_written(50)
    quote = '"{}"'.format if quoted else str
    names = [quote(name) for name in ("x", "y", "p", "t")]
    if index == "pandas" and separator == " ":
        names.insert(0, quote("row"))
    elif index == "pandas":
        names.insert(0, quote("") if quoted else "")
    lines = [separator.join(names)]
    for i, row in enumerate(zip(x, y, p, t, strict=True)):
        words = [quote(value) for value in row]
        lines.append(separator.join(words if index == "none" else [quote(i), *words]))
    path = tmp_path / "a.csv"
    path.write_text("\r\n".join(lines) + "\r\n")
    rows, _ = rows_of(path)
    assert rows == list(zip(t - t[0], x, y, p == 1, strict=True))


@pytest.mark.parametrize("separator", [";", "\t", " ; "])
def test_decimal_commas_are_read(separator, tmp_path):
    path = tmp_path / "a.csv"
    lines = [separator.join(("t [ms]", "x", "y", "p")), "0,5;1;2;1", "0,5021;3;4;0", "7;5;6;1"]
    path.write_text("\n".join(lines).replace(";", separator.strip(" ")) + "\n")
    rows, _ = rows_of(path)
    assert rows == [(0, 1, 2, True), (2, 3, 4, False), (6500, 5, 6, True)]


@pytest.mark.parametrize(
    "line",
    [
        "%geometry:64,48", "% geometry: 64 x 48", "%geometry 64,48", "# Geometry = 64;48",
        '"%geometry:64,48"', "%  GEOMETRY:64 48", "#resolution: 64x48", "% sensor_size 64,48",
    ],
)  # fmt: skip
def test_a_comment_states_the_size_of_the_sensor(line, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"{line}\nx,y,polarity,timestamp_us\n3,4,1,1000\n% a comment\n63,47,0,1250\n")
    recording = open_recording(path)
    assert recording.sensor == SENSOR
    assert join_events(list(recording)).tolist() == EXPECTED[:2]


def test_a_comment_before_the_events_is_a_header_if_it_names_all_columns(tmp_path):
    """numpy.savetxt writes its header so."""
    t, x, y, p = rows_written(50)
    for name, header in (("named", "x y p ts"), ("other", "events of Monday")):
        order = (x, y, p, t) if name == "named" else (t, x, y, p)
        np.savetxt(tmp_path / f"{name}.txt", np.column_stack(order), "%d", header=header)
        rows, _ = rows_of(tmp_path / f"{name}.txt")
        assert rows == list(zip(t - t[0], x, y, p == 1, strict=True))


def test_columns_overrule_a_foreign_header(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("Zeit;Spalte;Zeile;Vorzeichen\n1000;3;4;1\n1250;63;47;0\n")
    with pytest.raises(RecordingError, match="columns='xytp'"):
        rows_of(path)
    assert rows_of(path, columns="txyp")[0] == EXPECTED[:2]
    path.write_text("t,x,y,p\n3,4,1000,1\n63,47,1250,0\n")  # it is wrong
    assert rows_of(path, columns="xytp")[0] == EXPECTED[:2]
    with pytest.raises(RecordingError, match="4 columns a line, and columns= names 5"):
        rows_of(path, columns="xytp-")


SUFFIXES = [".csv", ".npy", ".npz", ".parquet", ".h5"]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("names", ["sec nsec", "ts.secs ts.nsecs", "tv_sec tv_usec"])
def test_seconds_and_their_fractions_in_two_columns_are_refused_by_name(names, suffix, tmp_path):
    path, names = tmp_path / f"a{suffix}", names.split()
    t, x, y, p = rows_written(50)
    table = dict(zip([*names, "x", "y", "p"], (t // 10**6, t % 10**6, x, y, p), strict=True))
    write_table(path, table, header=True)
    with pytest.raises(RecordingError, match=f"{', '.join(names)} are the parts of one time"):
        rows_of(path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"0 9 1 2 1\n" * 9, "5 columns a line, and t, x, y, p are 4.*a time in two columns"),
        (b"0,009,1,2,1\n" * 9, "5 columns a line.*decimal comma between semicolons"),
        (b"9,1\n" * 9, "2 columns a line, and t, x, y, p are 4"),
        (b"1 " * 10**6, "no line feed"),
        ("t,x,y,p\n1,2,3,1\n".encode("utf-16"), "UTF-16: save it as UTF-8"),
    ],
    ids=["two times", "decimal comma", "two columns", "no line", "utf-16"],
)
def test_text_that_is_no_table_of_events_says_why(content, words, tmp_path):
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(RecordingError, match=words):
        rows_of(tmp_path / "a.csv", chunk_events=1 << 12)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_times_in_floating_point_are_refused_without_a_unit(suffix, unit, tmp_path):
    t, x, y, p = rows_written()
    table = {"t": t * float(US_OF[unit]), "x": x, "y": y, "p": p}
    path = write_table(tmp_path / f"a{suffix}", table)
    with pytest.raises(RecordingError, match="no unit is stated: pass time_unit=, one of s, ms"):
        rows_of(path)
    rows, _ = rows_of(path, time_unit=unit)
    assert [row[0] for row in rows] == (t - t[0]).tolist()


@pytest.mark.parametrize("suffix", SUFFIXES[1:])
def test_times_in_float32_are_refused_in_any_unit(suffix, tmp_path):
    t, x, y, p = rows_written()
    table = {"t": (t / 1e6).astype(np.float32), "x": x, "y": y, "p": p}
    path = write_table(tmp_path / f"a{suffix}", table)
    with pytest.raises(RecordingError, match="float32, which has too few digits"):
        rows_of(path, time_unit="s")


@pytest.mark.parametrize("names", ["ts xs ys ps", "timestamp_us x y polarity", "Time col row on"])
def test_npz_takes_the_names_that_npy_takes(names, tmp_path):
    t, x, y, p = rows_written()
    np.savez(tmp_path / "a.npz", **dict(zip(names.split(), (t, x, y, p), strict=True)))
    np.savez(tmp_path / "b.npz", np.column_stack((t, x, y, p)))
    for name in ("a.npz", "b.npz"):
        rows, _ = rows_of(tmp_path / name)
        assert rows == list(zip(t - t[0], x, y, p == 1, strict=True))


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".parquet", ".h5"])
def test_columns_name_the_foreign_fields_of_a_table(suffix, tmp_path):
    t, x, y, p = rows_written()
    table = {"spalte": x, "zeile": y, "zeit": t, "serie": t * 0, "vz": p}
    path = write_table(tmp_path / f"a{suffix}", table, whole=True)
    with pytest.raises(RecordingError, match="columns="):
        rows_of(path)
    events, _ = rows_of(path, columns="xyt-p")
    assert events == list(zip(t - t[0], x, y, p == 1, strict=True))


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(("off", "on"), [(0, 1), (-1, 1), (1, 2), (0, 255)])
def test_a_polarity_is_1_or_0_or_minus_1_and_anything_else_is_refused(off, on, suffix, tmp_path):
    t, x, y, p = rows_written()
    table = {"t": t, "x": x, "y": y, "p": np.where(p == 1, on, off)}
    path = write_table(tmp_path / f"a{suffix}", table)
    if on == 1:
        assert [row[3] for row in rows_of(path)[0]] == (p == 1).tolist()
    else:
        with pytest.raises(RecordingError, match=f"polarity {on}, which is 1 for ON, and 0 or -1"):
            rows_of(path, on_fault="drop")


@pytest.mark.parametrize("order", ["xytp", "-txyp", "txy-"])
@pytest.mark.parametrize("suffix", [".csv", ".npy", ".npz"])
def test_columns_without_names_are_in_the_stated_order(order, suffix, tmp_path):
    t, x, y, p = rows_written(500)
    named = {"t": t, "x": x, "y": y, "p": p, "-": p * 7}
    table = np.column_stack([named[name] for name in order])
    path = tmp_path / f"a{suffix}"
    if suffix == ".csv":
        np.savetxt(path, table, "%d", delimiter=",")
    elif suffix == ".npy":
        np.save(path, table)
    else:
        np.savez(path, events=table)
    rows, recording = rows_of(path, columns=order)
    assert [row[:3] for row in rows] == list(zip(t - t[0], x, y, strict=True))
    assert recording.without_polarity == ("p" not in order)
