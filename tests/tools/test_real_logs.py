"""Logs as loggers leave them: with matches that are all correct, never another share in silence.

Each trouble is written into the logs of two simulated drives, and evaluated as by the command.
"""

from __future__ import annotations

import datetime as dt
import re
from functools import partial

import numpy as np
import pytest
from edge_vpr_tools.truth_files import given_truth, load_evaluated
from saved_files import checksum

from edge_vpr.errors import EdgeVprError, EdgeVprWarning
from edge_vpr.recordings import TimeCrop, open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair

MIDDAY = dt.datetime(2024, 3, 4, 12, tzinfo=dt.UTC)
ORIGIN, METRE = (-20.0, 140.0), 1 / 111_194.93


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Two drives, their positions each second, and the folder of matches, all within 10 m."""
    first, second = simulate_pair(7, "tiny", length_m=300)
    folder = tmp_path_factory.mktemp("matched") / "m"
    ReferenceMap.build(first, pixels=60).match(second).save(folder)
    return folder, [seconds(drive.track) for drive in (first, second)]


def seconds(track, every=1.0):
    """Return rows of time in seconds and metres along the street, up to the end of a track."""
    times = np.arange(0, track.time_us[-1] / 1e6, every)
    metres = np.interp(times, track.time_us / 1e6, track.position[:, 0])
    return [(float(t), float(x)) for t, x in zip(times, metres, strict=True)]


# The formats, each of rows of time and metres; a row without metres has no fix.


def sentence(body, checked=True):
    return f"${body}*{checksum(body):02X}\r\n" if checked else f"${body}\r\n"


def degrees(x):
    return ORIGIN[0] + x * METRE, ORIGIN[1]


def nmea(rows, start=MIDDAY, kind="RMC", checked=True, date=None, clock=lambda t: t):
    text = ""
    for t, x in rows:
        at = start + dt.timedelta(seconds=clock(t))
        time, day = f"{at:%H%M%S}.{at.microsecond // 10_000:02}", f"{date or at:%d%m%y}"
        where = ",,,"
        if x is not None:
            south, east = (abs(angle) for angle in (degrees(x) if np.isscalar(x) else x))
            side = "S" if np.isscalar(x) else "N"
            where = ",".join(
                f"{int(angle):0{width}}{angle % 1 * 60:09.6f},{way}"
                for angle, width, way in ((south, 2, side), (east, 3, "E"))
            )
        if kind == "RMC":
            body = f"GPRMC,{time},{'V' if x is None else 'A'},{where},0.1,0.0,{day},,,A"
        else:
            body = f"GPGGA,{time},{where},{int(x is not None)},08,1.0,10.0,M,0.0,M,,"
        text += sentence(body, checked)
    return text


def gpx(rows, time="{:%Y-%m-%dT%H:%M:%SZ}"):
    points = "".join(
        f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}"><time>'
        f"{time.format(MIDDAY + dt.timedelta(seconds=t))}</time></trkpt>\n"
        for t, x in rows
        if x is not None
        for lat, lon in [degrees(x) if np.isscalar(x) else x]
    )
    return f'<?xml version="1.0"?>\n<gpx version="1.1"><trk><trkseg>{points}</trkseg></trk></gpx>'


def table(rows, header="time_s,x_m", row="{t:.3f},{x:.3f}"):
    lines = (row.format(t=t, x=x) for t, x in rows if x is not None)
    return "\n".join([header, *lines]) + "\n"


def geographic(rows):
    return table(
        [(t, None if x is None else (degrees(x) if np.isscalar(x) else x)) for t, x in rows],
        "time_s,latitude,longitude", "{t:.3f},{x[0]:.9f},{x[1]:.9f}",
    )  # fmt: skip


def tum(rows):
    return "".join(f"{t:.4f} {x:.4f} 0 0 0 0 0 1\n" for t, x in rows if x is not None)


FORMATS = {"nmea": nmea, "gpx": gpx, "csv": geographic, "txt": tum}


def judged(drives, tmp_path, capsys, texts, suffix, tolerance=10.0, **flags):
    """Return how many matches are correct, how many are judged, and what was printed."""
    folder, _ = drives
    files = []
    for name, text in zip(("reference", "query"), texts, strict=True):
        files.append(str(tmp_path / f"{name}.{suffix}"))
        raw = text if isinstance(text, bytes) else text.encode()
        (tmp_path / f"{name}.{suffix}").write_bytes(raw)
    given, find_offset = given_truth(
        files, tolerance, None, None, flags.get("offset"), flags.get("longest_gap")
    )
    result, truth, _ = load_evaluated(str(folder), given, find_offset=find_offset)
    found = result.evaluate(truth)
    # fewer judged matches make those that are judged no more doubtful
    assert not any("cannot be judged" in note for note in found.truth.notes)
    return int(found.correct.sum()), found.queries, capsys.readouterr().err


@pytest.fixture
def judge(drives, tmp_path, capsys):
    return partial(judged, drives, tmp_path, capsys)


@pytest.mark.parametrize("suffix", FORMATS)
def test_good_logs_judge_every_match_without_a_warning(drives, judge, suffix):
    texts = [FORMATS[suffix](rows) for rows in drives[1]]
    correct, queries, said = judge(texts, suffix)
    assert correct == queries >= 55
    assert said == ""


# Gaps: what is not known is not wrong.


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize(("first", "last"), [(0, 8), (0, 25), (20, 28), (15, 40), (40, 99)])
@pytest.mark.parametrize("suffix", ["nmea", "csv"])
def test_matches_in_a_gap_are_unknown_and_not_wrong(drives, judge, suffix, which, first, last):
    logs = [list(rows) for rows in drives[1]]
    logs[which] = [(t, None if first <= t < last else x) for t, x in logs[which]]
    correct, queries, said = judge([FORMATS[suffix](rows) for rows in logs], suffix)
    assert correct == queries
    assert 10 < queries < 55
    assert "matches cannot be judged and are left out" in said


def test_a_wrong_match_is_wrong_although_the_log_has_a_gap(drives, judge):
    logs = [list(rows) for rows in drives[1]]
    logs[0] = [(t, None if 20 <= t < 28 else x) for t, x in logs[0]]
    # the query is said to have turned round in the middle of the street
    turn = logs[1][len(logs[1]) // 2]
    logs[1] = [(t, x if t <= turn[0] else 2 * turn[1] - x) for t, x in logs[1]]
    correct, queries, _ = judge([table(rows) for rows in logs], "csv")
    assert 0.3 * queries < correct < 0.8 * queries
    assert queries > 30


def test_the_longest_gap_can_be_set(drives, judge):
    logs = [[(t, x) for t, x in rows if not 20 <= t < 28] for rows in drives[1]]
    texts = [table(rows) for rows in logs]
    assert judge(texts, "csv", tolerance=20.0)[1] < 50
    correct, queries, _ = judge(texts, "csv", tolerance=20.0, longest_gap=9.0)
    assert correct == queries >= 55
    with pytest.raises(EdgeVprError, match=r"of 0 s .*: expected seconds such as 20"):
        judge(texts, "csv", longest_gap=0.0)


@pytest.mark.parametrize("gap", [7, 12])
def test_a_sparse_log_needs_no_flag(drives, judge, gap):
    logs = [[row for row in rows if row[0] % gap == 0 or row is rows[-1]] for rows in drives[1]]
    correct, queries, said = judge([gpx(rows) for rows in logs], "gpx", tolerance=30.0)
    assert correct == queries >= 55
    assert said == ""


# Positions that no drive can have.


@pytest.mark.parametrize("suffix", ["nmea", "gpx", "csv"])
@pytest.mark.parametrize("every", [2, 3, 10])
def test_fixes_at_null_island_are_left_out_and_counted(drives, judge, suffix, every):
    logs = [[(t, (0.0, 0.0) if t % every == 1 else x) for t, x in rows] for rows in drives[1]]
    correct, queries, said = judge([FORMATS[suffix](rows) for rows in logs], suffix)
    assert correct == queries >= 54
    assert "with 0 N 0 E" in said


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("jump", [150.0, 5e3, 2e6])
def test_jumps_are_left_out_and_counted(drives, judge, suffix, jump):
    logs = [[(t, x + jump * (t % 5 == 2)) for t, x in rows] for rows in drives[1]]
    correct, queries, said = judge([FORMATS[suffix](rows) for rows in logs], suffix)
    assert correct == queries >= 54
    assert "with a position that cannot be reached" in said


@pytest.mark.parametrize(("first", "last"), [(20, 32), (35, 99)])
@pytest.mark.parametrize("which", [0, 1])
def test_a_position_frozen_for_a_while_judges_nothing(drives, judge, which, first, last):
    logs = [list(rows) for rows in drives[1]]
    held = logs[which][first][1]
    logs[which] = [(t, held if first < t < last else x) for t, x in logs[which]]
    correct, queries, said = judge([nmea(rows) for rows in logs], "nmea")
    assert correct == queries < 52
    assert "frozen" in said


@pytest.mark.parametrize("suffix", FORMATS)
def test_fixes_of_two_receivers_in_turn_are_named(drives, judge, suffix):
    logs = [[(t, x + 55 * (t % 2)) for t, x in rows] for rows in drives[1]]
    _, _, said = judge([FORMATS[suffix](rows) for rows in logs], suffix, tolerance=30.0)
    for name in ("reference", "query"):
        assert f"{name} log: its positions change between two tracks 55 m apart, as of two" in said


def test_sentences_of_two_receivers_at_one_instant_are_named(drives, judge):
    texts = [
        "".join(nmea([(t, x)]) + nmea([(t, x + 55)], kind="GGA") for t, x in rows)
        for rows in drives[1]
    ]
    correct, queries, said = judge(texts, "nmea")
    assert correct == queries >= 55  # by those that come first
    assert said.count("sentences of one instant are 55 m apart, as of two receivers") == 2


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("jump", [-15.0, 15.0])
def test_a_jump_after_which_positions_stay_is_named_with_its_time(drives, judge, suffix, jump):
    logs = [[(t, x + jump * (t >= 30)) for t, x in rows] for rows in drives[1]]
    _, _, said = judge([FORMATS[suffix](rows) for rows in logs], suffix, tolerance=30.0)
    assert len(re.findall(r"its position jumps by 1[3-7] m at 30 s: positions before", said)) == 2
    wrong = [[(t, x + jump * (t == 30)) for t, x in rows] for rows in drives[1]]
    assert "jumps" not in judge([FORMATS[suffix](rows) for rows in wrong], suffix)[2]


@pytest.mark.parametrize("suffix", FORMATS)
def test_noise_and_stops_are_neither_jumps_nor_two_receivers(drives, judge, suffix):
    rng = np.random.default_rng(3)
    noisy = [[(t, x + float(rng.normal(0, 4))) for t, x in rows] for rows in drives[1]]
    _, _, said = judge([FORMATS[suffix](rows) for rows in noisy], suffix, tolerance=30.0)
    assert said == ""
    stops = [[(t, x * (t < 20) + rows[20][1] * (t >= 20)) for t, x in rows] for rows in drives[1]]
    _, _, said = judge([FORMATS[suffix](rows) for rows in stops], suffix, tolerance=30.0)
    assert "jumps" not in said and "receivers" not in said


# A truth that every match passes, or no match can.


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_receiver_that_froze_proves_nothing(drives, judge, suffix):
    logs = [[(t, 5.0) for t, _ in rows] for rows in drives[1]]
    _, _, said = judge([FORMATS[suffix](rows) for rows in logs], suffix)
    assert "did the receiver move?" in said
    assert "100% of all pairs of place and query count as the same place" in said


@pytest.mark.parametrize(("which", "name"), [(0, "reference"), (1, "query")])
def test_a_frozen_log_that_ends_before_its_drive_is_refused_by_its_cause(
    drives, judge, which, name
):
    logs = [list(rows) for rows in drives[1]]
    logs[which] = [(t, 5.0) for t, _ in logs[which][:-5]]
    with pytest.raises(EdgeVprError, match=f"the {name} log repeats one position from 0 to .*froz"):
        judge([nmea(rows) for rows in logs], "nmea")


def test_a_tolerance_beyond_the_route_proves_nothing(drives, judge):
    _, _, said = judge([table(rows) for rows in drives[1]], "csv", tolerance=500.0)
    assert "less than the tolerance of 500 m" in said


def test_kilometres_are_noticed_and_degrees_refused(drives, judge):
    kilometres = [[(t, x / 1e3) for t, x in rows] for rows in drives[1]]
    _, _, said = judge([table(rows, row="{t:.3f},{x:.6f}") for rows in kilometres], "csv")
    assert "are its positions in kilometres, or its" in said
    texts = [
        table([(t, degrees(x)) for t, x in rows], "time_s,x,y", "{t},{x[1]:.9f},{x[0]:.9f}")
        for rows in drives[1]
    ]
    with pytest.raises(EdgeVprError, match="looks like degrees: name its columns latitude"):
        judge(texts, "csv")


def test_a_tolerance_below_the_spacing_of_places_is_noticed(drives, judge):
    _, _, said = judge([table(rows) for rows in drives[1]], "csv", tolerance=2.0)
    assert "below the distance of neighbouring places" in said


# Clocks.


@pytest.mark.parametrize("step", [-18, -3, -7 * 3600, 13 * 3600, -20 * 365 * 86_400])
def test_a_clock_that_is_set_at_the_first_fix_moves_what_came_before(drives, judge, step):
    """The camera starts with the logger, and the first fix comes ten seconds later."""
    logs = [[(t, None if t < 10 else x) for t, x in rows] for rows in drives[1]]
    texts = [nmea(rows, clock=lambda t: t - step * (t < 10)) for rows in logs]
    correct, queries, said = judge(texts, "nmea")
    assert correct == queries >= 40
    assert f"set {'back' if step < 0 else 'on'} by {abs(step):,} s" in said


def test_leap_seconds_that_are_learnt_after_the_first_fix_move_what_came_before(drives, judge):
    texts = [nmea(rows, clock=lambda t: t + 18 * (t < 20)) for rows in drives[1]]
    correct, queries, said = judge(texts, "nmea")
    assert correct == queries >= 55
    assert "set back by 18 s" in said


@pytest.mark.parametrize("step", [-3, -2, -1, 2, 3, 1024 * 7 * 86_400, -1024 * 7 * 86_400])
def test_a_clock_that_is_set_by_seconds_or_a_rollover_on_the_way_moves_what_came_before(
    drives, judge, step
):
    texts = [
        "".join(
            nmea([row], kind=kind, clock=lambda t: t - step * (t < 20))
            for row in rows
            for kind in ("RMC", "GGA")
        )
        for rows in drives[1]
    ]
    correct, queries, said = judge(texts, "nmea")
    assert correct == queries >= 55
    for log in ("reference", "query"):
        way = "back" if step < 0 else "on"
        assert f"{log} log: the receiver's clock was set {way} by {abs(step):,} s" in said


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_lost_and_repeated_sentences_are_no_clock_that_is_set(drives, judge, lost):
    logs = [[row for row in rows if not 20 <= row[0] < 20 + lost] for rows in drives[1]]
    texts = [nmea([*rows[:10], rows[9], *rows[10:]]) for rows in logs]
    correct, queries, said = judge(texts, "nmea")
    assert (correct, said) == (queries, "")


@pytest.mark.parametrize("late", [0, 1, 3])
@pytest.mark.parametrize("kind", ["RMC", "GGA"])
def test_the_date_may_change_late_at_midnight(drives, judge, late, kind):
    start = dt.datetime(2024, 3, 4, 23, 59, 40, tzinfo=dt.UTC)
    texts = [
        "".join(
            nmea([row], start, kind, date=start + dt.timedelta(days=row[0] >= 20 + late))
            for row in rows
        )
        for rows in drives[1]
    ]
    correct, queries, said = judge(texts, "nmea")
    assert (correct, said) == (queries, "")
    assert queries >= 55


def test_sentences_a_second_late_are_sorted(drives, judge):
    texts = []
    for rows in drives[1]:
        late = [nmea([row], kind="GGA") for row in rows]
        texts.append(
            "".join(nmea([row]) + gga for row, gga in zip(rows, ["", *late], strict=False))
        )
    correct, queries, said = judge(texts, "log")
    assert (correct, said) == (queries, "")
    swapped = [
        "".join(FORMATS["txt"]([row]) for pair in zip(rows[1::2], rows[::2], strict=False)
                for row in pair)
        for rows in drives[1]
    ]  # fmt: skip
    correct, queries, _ = judge(swapped, "txt")
    assert correct == queries >= 54


@pytest.mark.parametrize("suffix", ["gpx", "csv", "txt"])
def test_a_time_that_occurs_twice_is_left_out_and_counted(drives, judge, suffix):
    logs = [[*rows[:9], (rows[8][0], rows[8][1] + 3), *rows[9:]] for rows in drives[1]]
    correct, queries, said = judge([FORMATS[suffix](rows) for rows in logs], suffix)
    assert (correct, said) == (queries, "")


@pytest.mark.parametrize("late", [-20.0, -10.0, -5.0, 5.0, 10.0, 20.0])
@pytest.mark.parametrize("which", [0, 1])
def test_a_clearly_better_offset_is_named_and_taken_if_asked(drives, judge, which, late):
    logs = [list(rows) for rows in drives[1]]
    logs[which] = [(t + late, x) for t, x in logs[which]]
    texts = [table(rows) for rows in logs]
    correct, queries, said = judge(texts, "csv")
    assert correct < 0.3 * queries
    assert f"with the {('reference', 'query')[which]} log" in said
    found = re.search(r"pass --offset (\S+) (\S+)", said).groups()
    # as it says, give or take 0.5 s
    assert abs(float(found[which]) + late) <= 0.5 and float(found[1 - which]) == 0
    correct, queries, said = judge(texts, "csv", offset=["auto"])
    assert correct == queries >= 50
    assert f"--offset auto takes --offset {' '.join(found)}" in said


@pytest.mark.parametrize("early", [0, 1, 6])
def test_dates_of_a_log_and_of_its_recording_that_begin_apart_are_named(
    drives, tmp_path, capsys, early
):
    paths = [tmp_path / "first.npz", tmp_path / "second.npz"]
    begin_us = round(MIDDAY.timestamp() * 1e6)
    for path, drive in zip(paths, simulate_pair(7, "tiny", length_m=300), strict=True):
        write_recording(path, drive, start_us=begin_us)
    ReferenceMap.build(paths[0], pixels=60).match(paths[1]).save(tmp_path / "m")
    judge = partial(judged, (tmp_path / "m", drives[1]), tmp_path, capsys)
    start = MIDDAY - dt.timedelta(seconds=early)
    texts = [
        nmea([*((t, rows[0][1]) for t in range(early)), *((t + early, x) for t, x in rows)], start)
        for rows in drives[1]
    ]
    correct, queries, said = judge(texts, "nmea")
    for log in ("reference", "query"):
        line = f"{log} log: by the dates of both, the log is laid 6.0 s too late on"
        assert (line in said) == (early == 6)
    assert ("shift it by -6 s" in said) == (early == 6)
    correct, queries, said = judge(texts, "nmea", offset=[f"-{early}", f"-{early}"])
    assert (correct, said) == (queries, "")
    if early == 6:
        with pytest.warns(EdgeVprWarning, match=r"^track: by the dates of both, the log is laid 6"):
            ReferenceMap.build(paths[0], pixels=60, track=tmp_path / "reference.nmea")


def test_an_offset_is_seconds_or_auto(drives, judge):
    texts = [table(rows) for rows in drives[1]]
    for wrong in (["1"], ["1", "2", "3"], ["car", "2"]):
        with pytest.raises(EdgeVprError, match=r"--offset .*: give the seconds"):
            judge(texts, "csv", offset=wrong)
    said = judge(texts, "csv", offset=["auto"])[2]
    assert "no other offset" in said or "--offset 0 -0.5: " in said  # give or take 0.5 s


# Forms of files.


def test_sentences_without_a_checksum_are_read_and_counted(drives, judge):
    texts = [nmea(rows, checked=False) for rows in drives[1]]
    correct, queries, said = judge(texts, "nmea")
    assert correct == queries >= 55
    assert "sentences have no checksum" in said


@pytest.mark.parametrize("suffix", ["txt", "log"])
@pytest.mark.parametrize("form", [nmea, gpx, geographic, tum])
def test_the_content_says_what_a_log_is(drives, judge, form, suffix):
    correct, queries, _ = judge([form(rows) for rows in drives[1]], suffix)
    assert correct == queries >= 55


@pytest.mark.parametrize(
    "time",
    ["{:%Y-%m-%d %H:%M:%S} UTC", "{:%Y/%m/%d %H:%M:%S}", "{:%Y-%m-%dT%H:%M:%S,5}+02",
     "{0.year}-{0.month}-{0.day} {0:%H:%M:%S}Z", "{:%Y-%m-%dT%H:%M:%S}-0700"],
)  # fmt: skip
def test_times_of_gpx_are_read_as_loggers_write_them(drives, judge, time):
    correct, queries, _ = judge([gpx(rows, time) for rows in drives[1]], "gpx")
    assert correct == queries >= 54


def test_times_that_cannot_be_read_are_named(drives, judge):
    texts = [gpx(rows, "{:%d. %b %Y %H:%M}") for rows in drives[1]]
    with pytest.raises(EdgeVprError, match=r"with unreadable time.*write times such as"):
        judge(texts, "gpx")


def comma(text):
    return text.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    "dialect",
    [
        comma,
        lambda text: text.replace(",", "\t"),
        lambda text: text.replace(",", ";"),
        lambda text: comma(text).encode("utf-16"),
        lambda text: text.replace("\n", "\r\n").encode("utf-8-sig"),
        lambda text: text.replace("\n", ",\n").replace(",\n", "\n"),
    ],
)
def test_tables_are_read_in_every_dialect(drives, judge, dialect):
    texts = [dialect(geographic(rows)) for rows in drives[1]]
    correct, queries, said = judge(texts, "csv")
    assert (correct, said) == (queries, "")
    assert queries >= 55


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("Time (s),Latitude (°),Longitude (°)", "{t},{x[0]:.9f},{x[1]:.9f}"),
        ("time,latitude_deg,longitude_deg", "{t},{x[0]:.9f},{x[1]:.9f}"),
        ("timestamp_ms,speed,lat,lon", "{t:.0f}000,,{x[0]:.9f},{x[1]:.9f}"),
        ("time,lat,lon", "2024-03-04T10:00:{t:02.0f}Z,{x[0]:.9f},{x[1]:.9f}"),
    ],
)
def test_names_of_columns_are_read_with_their_units(drives, judge, header, row):
    texts = [table([(t, degrees(x)) for t, x in rows if t < 60], header, row) for rows in drives[1]]
    correct, queries, _ = judge(texts, "csv")
    assert correct == queries >= 55


def test_rows_without_a_position_are_left_out(drives, judge):
    texts = [geographic(rows).replace("\n7.000,", "\n7.000,nan,nan\n7.100,,\n7.200,") for rows in
             drives[1]]  # fmt: skip
    correct, queries, _said = judge(texts, "csv")
    assert correct == queries >= 54


def test_decimal_commas_between_commas_are_named(drives, judge):
    texts = [geographic(rows).replace(".", ",") for rows in drives[1]]
    with pytest.raises(EdgeVprError, match="write decimals with points"):
        judge(texts, "csv")


def test_what_was_mapped_and_matched_from_a_start_is_judged_at_its_own_times(
    drives, tmp_path, capsys
):
    first, second = simulate_pair(7, "tiny", length_m=300)
    paths = [tmp_path / "first.npz", tmp_path / "second.npz"]
    for path, drive in zip(paths, (first, second), strict=True):
        write_recording(path, drive)
    parts = [
        open_recording(path).cropped(TimeCrop(start_us=start * 1_000_000))
        for path, start in zip(paths, (6, 10), strict=True)
    ]
    ReferenceMap.build(parts[0], pixels=60).match(parts[1]).save(tmp_path / "m")
    texts = [table(rows) for rows in drives[1]]
    correct, queries, said = judged((tmp_path / "m", drives[1]), tmp_path, capsys, texts, "csv")
    assert correct == queries >= 40
    assert "cannot be judged" not in said
