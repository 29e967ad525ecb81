"""Logs as receivers and loggers leave them: other formats, other encodings, other drives."""

from __future__ import annotations

import datetime as dt
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.errors import GroundTruthError
from edge_vpr.evaluation.ground_truth import from_tracks
from edge_vpr.evaluation.tables import read_text
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.evaluation.tracks import Track
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair
from tests.maps.saved_files import sentence
from tests.streams import centres

S = 1_000_000
GPX = """<?xml version="1.0" encoding="{encoding}"?>
<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><name>x</name><trkseg>
<trkpt lat="-27.5000" lon="152.9000"><ele>1</ele><time>2024-01-01T12:00:00Z</time></trkpt>
<trkpt lat="-27.5001" lon="152.9000"><time>2024-01-01T13:00:01.5+01:00</time></trkpt>
</trkseg><trkseg>
<trkpt lat="-27.5001" lon="152.9009"><time>2024-01-01T12:00:01.5Z</time></trkpt>
<trkpt lat="-27.5002" lon="152.9000"></trkpt>
<trkpt lat="-27.5002" lon="152.9000"><time>2024-01-01T12:00:02Z</time><fix>none</fix></trkpt>
<trkpt lat="north" lon="152.9000"><time>2024-01-01T12:00:03Z</time></trkpt>
<trkpt lat="-97.5" lon="152.9000"><time>2024-01-01T12:00:03Z</time></trkpt>
<trkpt lat="-27.5003" lon="152.9000"><time>2024-01-01T12:00:04</time></trkpt>
</trkseg></trk></gpx>"""


def angle(degrees: float, digits: int) -> str:
    whole, part = divmod(abs(degrees), 1.0)
    return f"{int(whole):0{digits}d}{part * 60:010.7f}"


def position(latitude: float, longitude: float) -> str:
    ns, ew = "S" if latitude < 0 else "N", "W" if longitude < 0 else "E"
    return f"{angle(latitude, 2)},{ns},{angle(longitude, 3)},{ew}"


def rmc(time: str, latitude=-27.0, longitude=153.0, date: str = "210420", fix=True) -> str:
    where = position(latitude, longitude) if fix else ",,,"
    return sentence(f"GPRMC,{time},{'A' if fix else 'V'},{where},0.0,,{date},,,A")


def gga(time: str, latitude: float, longitude: float, fix=True) -> str:
    where = position(latitude, longitude) if fix else ",,,"
    return sentence(f"GNGGA,{time},{where},{int(fix)},09,2.0,40.3,M,38.5,M,,")


def nmea(seconds: int) -> str:
    """A log of a drive to the south, at noon."""
    return "".join(
        rmc(f"1200{i:02}.00", -27.5 - i / 6_000, 152.9, "010124") for i in range(seconds)
    )


def written(folder: Path, *sentences: str) -> Path:
    path = folder / "log.nmea"
    path.write_text("".join(sentences), encoding="latin-1", newline="")
    return path


def straight(seconds, metres, start_us=0):
    """A drive along a line."""
    times = start_us + np.arange(seconds + 1) * S
    return Track(times, np.linspace(0.0, metres, seconds + 1)[:, None])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
def test_gpx_is_read_in_every_encoding(tmp_path, encoding):
    (tmp_path / "log.GPX").write_bytes(GPX.format(encoding=encoding).encode(encoding))
    track = load_track(tmp_path / "log.GPX")
    assert track.kind == "geographic"
    assert track.time_us.tolist() == [0, 1_500_000, 4_000_000]
    assert track.position.tolist() == [[-27.5, 152.9], [-27.5001, 152.9], [-27.5003, 152.9]]
    assert dict(track.dropped) == {
        "no time": 1, "no fix": 1, "unreadable position": 2, "a time that another has": 1,
    }  # fmt: skip
    assert track.entries == 8
    assert track.start_utc == dt.datetime(2024, 1, 1, 12, tzinfo=dt.UTC)


@given(st.floats(-89.9, 89.9), st.floats(-179.9, 179.9), st.sampled_from(["GP", "GN", "BD"]))
def test_a_position_survives_the_degrees_and_minutes_of_nmea(
    tmp_path_factory, latitude, longitude, talker
):
    line = sentence(f"{talker}RMC,070303.25,A,{position(latitude, longitude)},0,,210420,,,A")
    track = load_track(written(tmp_path_factory.getbasetemp(), line))
    np.testing.assert_allclose(track.position, [[latitude, longitude]], rtol=0, atol=2e-9)
    assert track.kind == "geographic"
    assert track.start_utc == dt.datetime(2020, 4, 21, 7, 3, 3, 250_000, tzinfo=dt.UTC)


def test_rmc_and_gga_of_one_instant_are_one_point_and_tenths_of_a_second_are_kept(tmp_path):
    lines = [
        both for tenth in range(12) for time in [f"0703{3 + tenth // 10:02d}.{tenth % 10}0"]
        for both in (rmc(time, -27.0, 153.0 + tenth / 1e5), gga(time, 5.0, 5.0))
    ]  # fmt: skip
    track = load_track(written(tmp_path, *lines))
    np.testing.assert_array_equal(track.time_us, np.arange(12) * 100_000)
    np.testing.assert_allclose(track.position[:, 1], 153.0 + np.arange(12) / 1e5)


def test_time_goes_on_past_midnight_with_dates_and_without(tmp_path):
    dated = [rmc("235959.00", 0, 0, "311220"), rmc("000000.00", 0, 0, "010121")]
    undated = [gga("235959.00", 0, 0), gga("000000.00", 0, 0)]
    for lines in (dated, undated):
        track = load_track(written(tmp_path, *lines))
        np.testing.assert_array_equal(track.time_us, [0, S])
        expected = dt.datetime(2020, 12, 31, 23, 59, 59, tzinfo=dt.UTC)
        assert track.start_utc == (None if lines is undated else expected)


def test_time_zero_is_the_first_second_of_the_log_even_before_the_first_fix(tmp_path):
    lines = [
        sentence("GPRMC,,V,,,,,,,,,,N"),
        rmc("070300.00", fix=False),
        gga("070300.00", 0, 0, fix=False),
        rmc("070302.00"),
    ]
    track = load_track(written(tmp_path, *lines))
    assert track.time_us.tolist() == [2 * S]
    assert dict(track.dropped) == {"no fix": 2}  # of RMC


def test_damaged_sentences_are_dropped_and_counted(tmp_path):
    good = rmc("070303.00")
    lines = [
        "\xff\xfe noise $GPRMC,07",
        good,
        good.replace("A,27", "A,28"),  # the checksum no longer fits
        good.replace("070303", "070304").split("*")[0] + "\r\n",  # nor is there one
        sentence("GPRMC,070305.00,A,2760.00000,S,15300.00000,E,0,,210420,,,A"),  # 60 minutes
        sentence("GPRMC,070306.00,A"),
        "$GSENSOR,76,976,148\r\n",
    ]
    track = load_track(written(tmp_path, *lines))
    assert track.time_us.tolist() == [0]
    assert dict(track.dropped) == {"bad checksum": 1, "no checksum": 1, "unreadable field": 3}


@pytest.mark.parametrize(("traverse", "fixes", "last_s"), [(1, 703, 714), (2, 623, 630)])
def test_real_logs_give_every_second_that_they_hold(shared_data, traverse, fixes, last_s):
    path = shared_data / f"brisbane_sparse49/sunset{traverse}.nmea"
    track = load_track(path)
    assert (track.time_us.size, track.time_us[-1]) == (fixes, last_s * S)
    assert not track.dropped
    # the same by splitting at commas, without checksums, dates or patterns
    rows = [line.split(",") for line in path.read_text().splitlines() if "RMC" in line]
    south = [-(int(row[3][:2]) + float(row[3][2:]) / 60) for row in rows]
    np.testing.assert_array_equal(track.position[:, 0], south)
    # the recorder's clips leave gaps of 3 and 4 s, which the largest gap must bridge
    assert np.diff(track.time_us).max() == 4 * S
    assert not np.isnan(track.at(centres(last_s))).any()


#: what is no track, by its name, and what is said of it
NO_TRACKS = [
    ("a.gpx", "<gpx>", "is not a GPX file"),
    ("a.gpx", "", "is not a GPX file"),
    ("a.gpx", "<gpx/>", "export the recorded track, not a planned route"),
    ("a.gpx", "<kml/>", "this is KML: convert it to GPX"),
    ("a.gpx", '<!DOCTYPE x [<!ENTITY a "aaaa">]><gpx>&a;</gpx>', "declares XML entities"),
    ("a.gpx", "<a>" * 100_000, "is not a GPX file"),
    ("a.gpx", GPX.format(encoding="utf-8").replace("12:00:04", "11:00:04"), "time runs backwards"),
    ("a.nmea", "nothing of the kind", "none at all"),
    ("a.nmea", rmc("070303.00", fix=False) + rmc("070304.00", fix=False),
     r"no RMC or GGA sentence with a fix \(2 with no fix"),
    ("a.nmea", rmc("070303.00") + rmc("070001.00"),
     "backwards by 182 s at RMC sentence 2"),
    ("a.nmea", rmc("120000.00", date="050180") + rmc("120001.00", date="010320"),
     r"by 14,666 days at RMC sentence 2.*Track.shifted"),
    ("a.nmea", None, "cannot be read"),
    ("a.xlsx", "", r"give a log of NMEA or GPX, a \.csv table, or poses of TUM or KITTI"),
    ("a.json", "{}", "is not a track: give"),
    ("a.csv", "t,x_m\n0,0\n", "expected time_s,x_m"),
    ("a.csv", "time_s,y_m\n0,0\n", "expected time_s,x_m"),
    ("a.csv", "time_s,lat\n0,1\n", "expected time_s,x_m"),
    ("a.csv", "time_s,x_km,y_km\n0,1,1\n", "expected time_s,x_m"),
    ("a.csv", "time_s,x_m\n", "no rows"),
    ("a.csv", "time_s,x_m\n0,zero\n", "row 1 has 'zero' in x_m"),
    ("a.csv", "time_s,x_m\n0,0\n1\n", "row 2 is '1', not 2 cells"),
    ("a.csv", "time_s,x_m\n0,inf\n", "row 1 is not finite"),
    ("a.csv", "time_s,x_m\n9,0\n0,0\n", "a.csv: time runs backwards by 9 s at entry 2"),
    ("a.csv", "time_s,lat,lon,x\n0,1,1,1\n", "2 kinds of position .lat,lon and x.: leave"),
    ("a.csv", "time_s,timestamp,x\n0,1,1\n", "2 columns of time .time_s, timestamp.: leave"),
    ("a.csv", "timestamp,x\n1587452582350000000,1\n", "name their unit .* as in time_ns"),
    ("a.csv", "time_s,lat,lon\n0,3327.5,7039.6\n", "outside 90 and 180 .* with their decimals"),
    ("a.csv", "time_s,lat,lon\n0,120,30\n", "latitude first, then longitude"),
    ("a.csv", "1,0,odom,2.5\n", "has 4 cells in its first line: .* tables a header"),
    ("a.txt", "0 1 2 3\n", "has 4 cells in its first line: poses have 8"),
    ("a.txt", "0 1 2 3 4 5 6 7\n0 1\n", "row 2 is '0,1', not 8 cells"),
    ("a.txt", "# nothing\n", "has no rows"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "text", "says"), NO_TRACKS)
def test_a_file_that_is_no_track_says_why(tmp_path, name, text, says):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(GroundTruthError, match=says) as caught:
        load_track(tmp_path / name)
    assert name in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("spoilt", "says"),
    [
        (lambda line: line.replace(",152", ",153"), "copy the log again"),
        (lambda line: "", "open sky"),
        (lambda line: line.replace("RMC", "GLL"), "it has GLL sentences: let the receiver send"),
    ],
)
def test_a_log_without_a_fix_gets_advice_that_helps(tmp_path, spoilt, says):
    (tmp_path / "log.nmea").write_text("\n".join(spoilt(line) for line in nmea(9).splitlines()))
    with pytest.raises(GroundTruthError, match=says):
        load_track(tmp_path / "log.nmea")


def test_an_offset_sets_a_clock_right():
    track = straight(10, 100)
    assert track.shifted(2.5).time_us[0] == 2_500_000
    assert track.shifted(2.5).at([7_500_000]).tolist() == track.at([5_000_000]).tolist()
    assert track.shifted(-4).time_us[0] == -4_000_000
    for wrong in (float("nan"), float("inf"), 1e15):
        with pytest.raises(GroundTruthError, match="expected seconds such as"):
            track.shifted(wrong)


@pytest.mark.parametrize(
    ("header", "row", "expected"),
    [
        ("time_s,lat,lon,heading", "{},33.45,70.66,S", (33.45, 70.66)),
        ("time_s,lat,lon", "{},-33.45,289.34", (-33.45, -70.66)),
        ("time_s,lat,lon", "{},33.45,180", (33.45, 180.0)),
    ],
)
def test_longitudes_may_count_eastwards_to_360(tmp_path, header, row, expected):
    without = re.sub("[^,]", "", row)
    lines = [header, "9" + without, *(row.format(10 + t) for t in range(3))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert load_track(tmp_path / "a.csv").position == pytest.approx(np.array([expected] * 3))


def test_waypoints_with_times_are_a_track_where_there_is_no_other(tmp_path):
    for text in (GPX, GPX.replace("trkpt", "wpt")):  # three of seven are read
        (tmp_path / "a.gpx").write_text(text.format(encoding="utf-8"))
        assert len(load_track(tmp_path / "a.gpx").time_us) == 3
    extra = '</trk><wpt lat="0" lon="0"><time>2024-01-01T12:00:02Z</time></wpt>'
    (tmp_path / "a.gpx").write_text(GPX.format(encoding="utf-8").replace("</trk>", extra))
    assert len(load_track(tmp_path / "a.gpx").time_us) == 3


def test_times_that_no_clock_shows_are_refused(tmp_path):
    for time in ("1e300", "1e13"):
        (tmp_path / "t.csv").write_text(f"time_s,x_m\n0,0\n{time},1\n")
        with pytest.raises(GroundTruthError, match="from the recording's start"):
            load_track(tmp_path / "t.csv")
    with pytest.raises(GroundTruthError, match="beyond"):
        Track([0, 2**61], [[0.0], [1.0]])


def test_a_file_too_long_to_be_a_log_is_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr("edge_vpr.evaluation.tables.MAX_BYTES", 100)
    (tmp_path / "a.txt").write_text("x" * 101)
    with pytest.raises(GroundTruthError, match="has more than 100 bytes"):
        read_text(tmp_path / "a.txt")


# --- tables as the field writes them ---------------------------------------------------------


@pytest.mark.parametrize(
    ("header", "kind", "columns"),
    [
        ("time_s,position_m", "metric", 1),
        ("time_s,x_m", "metric", 1),
        ("time_s,x_m,y_m", "metric", 2),
        ("Time_s, x_m, y_m, z_m", "metric", 3),
        ("time_s,latitude,longitude", "geographic", 2),
    ],
)
def test_a_table_is_read_by_its_header(tmp_path, header, kind, columns):
    path = tmp_path / "track.csv"
    path.write_text(f"# by hand\n{header}\n" + "".join(
        f"{time},{','.join(str(time / 1e5 + c) for c in range(columns))}\n"
        for time in (0, 0.000001, 1.5)
    ))  # fmt: skip
    track = load_track(path)
    assert track.kind == kind
    assert track.time_us.tolist() == [0, 1, 1_500_000]
    np.testing.assert_array_equal(track.position[2], 1.5e-5 + np.arange(columns))


def test_points_further_apart_than_5_s_are_bridged_if_asked_for(tmp_path):
    path = tmp_path / "track.csv"
    path.write_text("time_s,position_m\n0,0\n60,30\n")
    assert np.isnan(load_track(path).at([30 * S])).all()
    assert load_track(path, max_gap_s=60.0).at([30 * S]).tolist() == [[15.0]]


EUROC = "p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m]"
UNIX_S = 1_587_452_582
POSES = [(0.0, 1.0, 2.0, 3.0), (0.5, 1.5, 2.0, 3.0), (1.25, 2.5, 2.0, 3.5)]


def tum(seconds, x, y, z):
    return f"{UNIX_S + seconds:.6f} {x} {y} {z} 0 0 0 1"


def euroc(seconds, x, y, z):
    return f"{round((UNIX_S + seconds) * 10**9)},{x},{y},{z},1,0,0,0"


def microseconds(seconds, x, y, z):
    return f"{round((UNIX_S + seconds) * 10**6)} {x} {y} {z} 0 0 0 1"


@pytest.mark.parametrize(
    ("name", "head", "line"),
    [
        ("groundtruth.txt", "# timestamp tx ty tz qx qy qz qw\n", tum),
        ("poses.tum", "", tum),
        ("poses.txt", "# time of the camera\n# timestamp[us] px py pz qx qy qz qw\n", microseconds),
        ("poses.csv", "#timestamp[us],px,py,pz,qx,qy,qz,qw\n",
         lambda *pose: microseconds(*pose).replace(" ", ",")),
        ("data.csv", f"#timestamp [ns], {EUROC}, q_RS_w [], a, b, c\n", euroc),
        ("odom.csv", "timestamp_ns,x,y,z,qw,qx,qy,qz\n", euroc),
        ("odom.csv", "frame,timestamp,tx,ty,tz\n",
         lambda *pose: "map," + ",".join(tum(*pose).split()[:4])),
    ],
)  # fmt: skip
def test_poses_of_tum_and_euroc_and_tables_with_timestamps_are_read(name, head, line, tmp_path):
    text = head + "\n".join(line(*pose) for pose in POSES) + "\n"
    (tmp_path / name).write_text(text)
    track = load_track(tmp_path / name)
    assert track.kind == "metric"
    assert track.time_us.tolist() == [round((UNIX_S + pose[0]) * S) for pose in POSES]
    assert track.position.tolist() == [list(pose[1:]) for pose in POSES]


def test_a_gps_table_with_timestamps_and_more_columns_is_geographic(tmp_path):
    text = "timestamp,status,lat,lon,altitude\n0.5,fix,-27.5,152.9,3\n1.5,fix,-27.5001,152.8999,4\n"
    (tmp_path / "fix.csv").write_text(text)
    track = load_track(tmp_path / "fix.csv")
    assert track.kind == "geographic"
    assert track.position.tolist() == [[-27.5, 152.9], [-27.5001, 152.8999]]
    assert track.time_us.tolist() == [500_000, 1_500_000]


@pytest.mark.parametrize(
    "times", ["poses/times.txt", "poses/07_times.txt", "sequences/07/times.txt"]
)
def test_poses_of_kitti_take_their_times_from_the_sequence(times, tmp_path):
    poses = tmp_path / "poses" / "07.txt"
    poses.parent.mkdir()
    rows = [f"1 0 0 {x} 0 1 0 {y} 0 0 1 {z}" for _, x, y, z in POSES]
    poses.write_text("\n".join(rows) + "\n")
    with pytest.raises(GroundTruthError, match=r"have no times: put the sequence's times\.txt"):
        load_track(poses)
    (tmp_path / times).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / times).write_text("".join(f"{pose[0]:e}\n" for pose in POSES))
    track = load_track(poses)
    assert track.time_us.tolist() == [0, 500_000, 1_250_000]
    assert track.position.tolist() == [list(pose[1:]) for pose in POSES]
    (tmp_path / times).write_text("0\n1\n")
    with pytest.raises(GroundTruthError, match=r"has 2 times, and .* 3 poses"):
        load_track(poses)


def test_unix_times_suggest_the_offsets_with_which_the_tracks_cover_the_drives():
    first = straight(10, 100, start_us=UNIX_S * S + 250_000)
    second = straight(10, 100, start_us=(UNIX_S + 900) * S)
    with pytest.raises(GroundTruthError) as raised:
        from_tracks(first, second, centres(10), centres(10), 5.0)
    offset = re.search(r"reference track covers .* shift it by (\S+) s", str(raised.value))[1]
    first = first.shifted(float(offset))
    with pytest.raises(GroundTruthError, match=rf"query track .* by -{UNIX_S + 900} s"):
        from_tracks(first, second, centres(10), centres(10), 5.0)
    second = second.shifted(-UNIX_S - 900)
    assert from_tracks(first, second, centres(10), centres(10), 5.0).has_place.all()


def test_unix_times_of_a_recording_of_such_times_name_its_own_start():
    drive, _ = simulate_pair(0, "tiny", length_m=60)
    drive.start_us = UNIX_S * S + 750_000
    track = straight(11, 100, start_us=UNIX_S * S)
    with pytest.raises(GroundTruthError, match=rf"shift it by -{UNIX_S}\.75 s \(Track.shifted\)$"):
        ReferenceMap.build(drive, pixels=20, track=track)
    ReferenceMap.build(drive, pixels=20, track=track.shifted(-UNIX_S - 0.75))


def test_a_table_in_memory_is_the_track_of_its_file(tmp_path):
    pandas = pytest.importorskip("pandas")
    times = [0, 500_000_000, 2_000_000_001]
    table = {"Timestamp [ns]": times, "x_m": [0.1, 2, float("nan")], "note": [*"abc"]}
    pandas.DataFrame(table).to_csv(tmp_path / "track.csv", index=False)
    track = load_track(tmp_path / "track.csv")
    assert (track.time_us.tolist(), track.position.tolist()) == ([0, 500_000], [[0.1], [2.0]])
    arrays = {name: np.array(each) for name, each in table.items()}
    tables = [table, pandas.DataFrame(table), arrays]
    if pyarrow := pytest.importorskip("pyarrow"):
        tables.append(pyarrow.table(table))
    assert [load_track(each) == track for each in tables] == [True] * 4


@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_dates_of_a_table_in_memory_are_read_to_the_microsecond(zone):
    pandas = pytest.importorskip("pandas")
    dates = pandas.to_datetime(["2024-03-04T10:00:00.000000", None, "2024-03-04T10:00:01.000250"])
    where = {"latitude": [50.0, 50.1, 50.0001], "longitude": [8.0, 8.1, 8.0001]}
    track = load_track(pandas.DataFrame({"time": dates.tz_localize(zone), **where}), max_gap_s=2)
    assert track.time_us.tolist() == [0, 1_000_250]
    assert track.start_utc == dt.datetime(2024, 3, 4, 10 if zone is None else 9, tzinfo=dt.UTC)
    assert track.dropped == {"no time": 1}
    assert track.max_gap_us == 2_000_000


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"a": [1]}, "^the track data has the header 'a': expected time_s"),
        ({"time_s": [1, 2], "x_m": [1]}, r"has columns of shapes \(2,\), \(1,\): give one value"),
        ({"time_s": [], "x_m": []}, "at least one row"),
        ({}, "columns of shapes : give"),
        (
            {"time_s": [0, 1], "x_m": ["here", "there"]},
            "row 1 has 'here' in x_m: expected a number",
        ),
        ({"time_s": [0, 1], "x_m": ["1_000", "2"]}, "row 1 has '1_000' in x_m: expected a number"),
    ],
)
def test_a_table_in_memory_that_is_no_track_is_refused(table, message):
    with pytest.raises(GroundTruthError, match=message):
        load_track(table)


def test_seconds_in_the_place_of_microseconds_are_recognised():
    with pytest.raises(GroundTruthError, match=r"has 0.5, and is in whole microsec.*1e6"):
        Track([0.0, 0.5, 1.0], [[0.0], [1.0], [2.0]])
    products = np.array([0.1, 1.1, 1_587_452_582.35]) * 1e6  # not all whole
    assert Track(products, np.zeros((3, 1))).time_us.tolist() == [
        100_000, 1_100_000, 1_587_452_582_350_000,
    ]  # fmt: skip
