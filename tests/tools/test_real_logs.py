"""Logs as loggers leave them: with matches that are all correct, never another share in silence.

Each trouble is written into the logs of two simulated drives, and evaluated as by the command. The
share is right, or the log is refused, or the trouble stands in the facts beside it.
"""

from __future__ import annotations

import datetime as dt
import re
from functools import partial

import numpy as np
import pytest
from edge_vpr_tools.truth_files import TruthFiles, load_evaluated

from edge_vpr.errors import EdgeVprError
from edge_vpr.recordings import TimeCrop, open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair
from tests.maps.saved_files import sentence

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


def degrees(x):
    return ORIGIN[0] + x * METRE, ORIGIN[1]


def nmea(
    rows, start=MIDDAY, kind="RMC", checked=True, date=None, clock=lambda t: t, mode="A", quality=1
):
    text = ""
    for t, x in rows:
        at = start + dt.timedelta(seconds=clock(t))
        time, day = f"{at:%H%M%S}.{at.microsecond // 10_000:02}", f"{date or at:%d%m%y}"
        where = ",,,"
        if x is not None:
            where = ",".join(
                f"{int(angle):0{width}}{angle % 1 * 60:09.6f},{way}"
                for angle, width, way in zip(map(abs, degrees(x)), (2, 3), "SE", strict=True)
            )
        if kind == "RMC":
            body = f"GPRMC,{time},{'V' if x is None else 'A'},{where},0.1,0.0,{day},,,{mode}"
        else:
            body = f"GPGGA,{time},{where},{0 if x is None else quality},08,1.0,10.0,M,0.0,M,,"
        text += sentence(body) if checked else f"${body}\r\n"
    return text


def gpx(rows, time="{:%Y-%m-%dT%H:%M:%SZ}"):
    points = "".join(
        f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}"><time>'
        f"{time.format(MIDDAY + dt.timedelta(seconds=t))}</time></trkpt>\n"
        for t, x in rows
        if x is not None
        for lat, lon in [degrees(x)]
    )
    return f'<?xml version="1.0"?>\n<gpx version="1.1"><trk><trkseg>{points}</trkseg></trk></gpx>'


def table(rows, header="time_s,x_m", row="{t:.3f},{x:.3f}"):
    lines = (row.format(t=t, x=x) for t, x in rows if x is not None)
    return "\n".join([header, *lines]) + "\n"


def geographic(rows):
    return table(
        [(t, None if x is None else degrees(x)) for t, x in rows],
        "time_s,latitude,longitude", "{t:.3f},{x[0]:.9f},{x[1]:.9f}",
    )  # fmt: skip


def tum(rows):
    return "".join(f"{t:.4f} {x:.4f} 0 0 0 0 0 1\n" for t, x in rows if x is not None)


FORMATS = {"nmea": nmea, "gpx": gpx, "csv": geographic, "txt": tum}


def judged(drives, tmp_path, texts, suffix, tolerance=10.0, **changes):
    """Return how many matches are correct, how many are judged, and the facts as text."""
    folder, _ = drives
    files = []
    for name, text in zip(("reference", "query"), texts, strict=True):
        files.append(str(tmp_path / f"{name}.{suffix}"))
        raw = text if isinstance(text, bytes) else text.encode()
        (tmp_path / f"{name}.{suffix}").write_bytes(raw)
    result, truth, _ = load_evaluated(str(folder), TruthFiles(tuple(files), tolerance, **changes))
    judgement = result.evaluate(truth)
    lines = (f"{heading}: {text}" for heading, text in result.facts(truth).items())
    return int(judgement.correct.sum()), judgement.queries, "\n".join(lines)


@pytest.fixture
def judge(drives, tmp_path):
    return partial(judged, drives, tmp_path)


@pytest.mark.parametrize("suffix", FORMATS)
def test_good_logs_judge_every_match_and_show_the_drive(drives, judge, suffix):
    texts = [FORMATS[suffix](rows) for rows in drives[1]]
    correct, queries, facts = judge(texts, suffix)
    assert correct == queries >= 55
    assert len(facts.splitlines()) == 7
    assert re.search(
        r"reference: [\d,]+ events in \d\d\.\d s, [\d,]+ events/s, of 32x32 pixels", facts
    )
    line = re.search(
        r"query track: ([\d.]+) m from 0\.0 to \d\d\.0 s, ([\d.]+) m/s in the mean", facts
    )
    assert 290 < float(line[1]) <= 300 and 4 < float(line[2]) < 7
    assert re.search(r"longest gap 1 s; covers (9[5-9]|100)\.\d% of the drive", facts)
    assert "left out" not in facts
    assert re.search(r"routes: [\d.]+ m apart in the median, [\d.]+ m at most", facts)


# Gaps: what is not known is not wrong.


@pytest.mark.parametrize("gap", [7, 12])
def test_a_sparse_log_is_refused_until_its_gaps_may_be_bridged(drives, judge, gap):
    logs = [[row for row in rows if row[0] % gap == 0 or row is rows[-1]] for rows in drives[1]]
    texts = [gpx(rows) for rows in logs]
    with pytest.raises(
        EdgeVprError, match=f"points are up to {gap} s apart.*header, or give max_gap_s"
    ):
        judge(texts, "gpx", tolerance=30.0)
    correct, queries, _ = judge(texts, "gpx", tolerance=30.0, longest_gap_s=float(gap))
    assert correct == queries >= 55
    with pytest.raises(EdgeVprError, match=r"of 0 s .*: expected seconds such as 20"):
        judge(texts, "gpx", longest_gap_s=0.0)


# Positions that no drive can have.


@pytest.mark.parametrize("jump", [150.0, 5e3, 2e6])
def test_fixes_that_need_more_than_100_m_s_are_left_out_and_counted(drives, judge, jump):
    logs = [[(t, x + jump * (t % 5 == 2)) for t, x in rows] for rows in drives[1]]
    correct, queries, facts = judge([nmea(rows) for rows in logs], "nmea")
    assert correct == queries >= 54
    assert "left out:" in facts
    assert facts.count("with more than 100 m/s") == 2


def test_fixes_that_the_receiver_calls_estimated_are_left_out_and_counted(drives, judge):
    """RMC is void from 13 to 35 s, and GGA has quality 6, up to 50 m beside the street."""
    rows = drives[1][0]
    text = "".join(
        nmea([(t, None if 13 <= t < 35 else x)])
        + nmea([(t, x + 50 * (13 <= t < 35))], kind="GGA", quality=6 if 13 <= t < 35 else 1)
        for t, x in rows
    )
    estimated = nmea(rows[:13]) + nmea([(t, x + 50) for t, x in rows[13:35]], mode="E")
    rmc_is_sure = "".join(
        nmea([(t, x + 50 * (13 <= t < 35))], mode="")
        + nmea([(t, x + 50 * (13 <= t < 35))], kind="GGA", quality=6 if 13 <= t < 35 else 1)
        for t, x in rows
    )
    only_gga = "".join(sentence for sentence in text.splitlines(True) if "GGA" in sentence)
    for log, why in (
        (text, "22 with no fix"),
        (estimated + nmea(rows[35:]), "22 with an estimated fix"),
        (rmc_is_sure, "22 with an estimated fix"),
        (only_gga, "22 with an estimated fix"),
    ):
        correct, queries, facts = judge([log, nmea(drives[1][1])], "nmea")
        assert correct == queries and 25 < queries < 40
        assert why in facts


def test_a_position_that_froze_for_a_while_shows_in_the_largest_speed(drives, judge):
    logs = [list(rows) for rows in drives[1]]
    held = logs[1][20][1]
    logs[1] = [(t, held if 20 < t < 32 else x) for t, x in logs[1]]
    correct, queries, facts = judge([nmea(rows) for rows in logs], "nmea")
    assert correct < queries
    largest = [float(each) for each in re.findall(r"([\d.]+) m/s at most", facts)]
    assert largest[0] < 15 and 40 < largest[1] < 100


# Clocks.


@pytest.mark.parametrize(("step", "remedy"), [
    (-18, "time runs backwards by 17 s at RMC sentence 11"),
    (-3, "time runs backwards by 2 s at RMC sentence 11"),
    (1, "before the first fix, time steps by 2 s at RMC sentence 11"),
    (40, "before the first fix, time steps by 41 s at RMC sentence 11"),
    (-7 * 3600, "time runs backwards by 25,199 s at RMC sentence 11"),
    (2 * 86_400, "the date changes by 2 days at RMC sentence 11"),
    (20 * 365 * 86_400, "the date changes by 7,300 days at RMC sentence 11"),
])  # fmt: skip
def test_a_clock_that_is_set_at_the_first_fix_is_refused(drives, judge, step, remedy):
    """The camera starts with the logger, and the first fix comes ten seconds later."""
    logs = [[(t, None if t < 10 else x) for t, x in rows] for rows in drives[1]]
    texts = [nmea(rows, clock=lambda t: t - step * (t < 10)) for rows in logs]
    with pytest.raises(EdgeVprError, match=f"{remedy}, where the receiver set its clock.*shifted"):
        judge(texts, "nmea")
    # as the message says: the part of the right clock, and where it begins
    texts = [nmea(rows[10:]) for rows in logs]
    correct, queries, _ = judge(texts, "nmea", offset_s=(10.0, 10.0))
    assert correct == queries >= 40


def test_a_log_that_was_appended_to_is_refused_or_shows_its_gap(drives, judge):
    """The drive before was through another street, 18 hours or 8 hours earlier."""
    reference, query = drives[1]

    def appended(hours):
        before = nmea([(t, x + 30) for t, x in query], MIDDAY - dt.timedelta(hours=hours))
        return before + nmea(query)

    with pytest.raises(
        EdgeVprError, match=r"runs backwards by 2\d,\d+ s at RMC sentence \d+, where"
    ):
        judge([nmea(reference), appended(18)], "nmea")
    correct, queries, facts = judge([nmea(reference), appended(8)], "nmea")
    assert correct < queries
    assert re.search(r"query track: .* longest gap 28,7\d\d s", facts)


def test_a_gpx_begins_with_its_first_time_even_without_a_fix(drives, judge):
    fixless = "</time></trkpt>", "</time><fix>none</fix></trkpt>", 12
    texts = [gpx(rows).replace(*fixless) for rows in drives[1]]
    correct, queries, facts = judge(texts, "gpx")
    assert correct == queries >= 40
    assert facts.count("12 with no fix") == facts.count(" m from 12.0 to ") == 2


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
    correct, queries, facts = judge(texts, "nmea")
    assert correct == queries >= 55
    assert "left out" not in facts


def test_dates_of_a_log_and_of_its_recording_are_shown(drives, tmp_path):
    paths = [tmp_path / "first.npz", tmp_path / "second.npz"]
    begin_us = round(MIDDAY.timestamp() * 1e6)
    for path, drive in zip(paths, simulate_pair(7, "tiny", length_m=300), strict=True):
        write_recording(path, drive, start_us=begin_us)
    ReferenceMap.build(paths[0], pixels=60).match(paths[1]).save(tmp_path / "m")
    judge = partial(judged, (tmp_path / "m", drives[1]), tmp_path)
    early = MIDDAY - dt.timedelta(seconds=6)
    facts = judge([nmea(rows, early) for rows in drives[1]], "nmea")[2]
    assert facts.count("time 0 is 2024-03-04 12:00:00 UTC") == 2
    assert facts.count("time 0 is 2024-03-04 11:59:54 UTC") == 2


# Forms of files.


def comma(text):
    return text.replace(",", ";").replace(".", ",")


def columns(header, row):
    """A table of latitude and longitude whose header and rows are written so."""
    return lambda rows: table([(t, degrees(x)) for t, x in rows if t < 60], header, row)


@pytest.mark.parametrize(
    ("suffix", "form"),
    [
        ("nmea", partial(nmea, checked=False)),
        # the content says what a log is
        *((suffix, form) for suffix in ("txt", "log") for form in (nmea, gpx, geographic, tum)),
        ("gpx", partial(gpx, time="{:%Y-%m-%d %H:%M:%S}")),
        ("gpx", partial(gpx, time="{:%Y-%m-%dT%H:%M:%S,5}+02")),
        ("gpx", partial(gpx, time="{:%Y-%m-%dT%H:%M:%S}-0700")),
        ("csv", lambda rows: comma(geographic(rows))),
        ("csv", lambda rows: geographic(rows).replace(",", "\t")),
        ("csv", lambda rows: geographic(rows).replace(",", ";")),
        ("csv", lambda rows: comma(geographic(rows)).encode("utf-16")),
        ("csv", lambda rows: geographic(rows).replace("\n", "\r\n").encode("utf-8-sig")),
        ("csv", columns("Time (s),Latitude (°),Longitude (°)", "{t},{x[0]:.9f},{x[1]:.9f}")),
        ("csv", columns("time,latitude_deg,longitude_deg", "{t},{x[0]:.9f},{x[1]:.9f}")),
        ("csv", columns("timestamp_ms,speed,lat,lon", "{t:.0f}000,,{x[0]:.9f},{x[1]:.9f}")),
        ("csv", columns("time,lat,lon", "2024-03-04T10:00:{t:02.0f}Z,{x[0]:.9f},{x[1]:.9f}")),
    ],
)
def test_every_form_of_a_log_is_read(drives, judge, suffix, form):
    correct, queries, facts = judge([form(rows) for rows in drives[1]], suffix)
    assert correct == queries >= 54
    assert "left out" not in facts


@pytest.mark.parametrize(
    ("suffix", "form", "says"),
    [
        ("gpx", partial(gpx, time="{:%d. %b %Y %H:%M}"), "with unreadable time.*write times such"),
        ("gpx", partial(gpx, time="{:%Y-%m-%d %H:%M:%S} UTC"), "with unreadable time.*write times"),
        ("csv", lambda rows: geographic(rows).replace(".", ","), "write decimals with points"),
    ],
)
def test_a_form_that_cannot_be_read_is_named(drives, judge, suffix, form, says):
    with pytest.raises(EdgeVprError, match=says):
        judge([form(rows) for rows in drives[1]], suffix)


def test_rows_without_a_position_are_left_out(drives, judge):
    texts = [geographic(rows).replace("\n7.000,", "\n7.000,nan,nan\n7.100,,\n7.200,") for rows in
             drives[1]]  # fmt: skip
    correct, queries, facts = judge(texts, "csv")
    assert correct == queries >= 54
    assert facts.count("2 with no position") == 2


def test_what_was_mapped_and_matched_from_a_start_is_judged_at_its_own_times(drives, tmp_path):
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
    correct, queries, facts = judged((tmp_path / "m", drives[1]), tmp_path, texts, "csv")
    assert correct == queries >= 40
    assert len(re.findall(r"covers (9[5-9]|100)\.\d% of the drive", facts)) == 2
