"""Events in memory are recordings: each form of them gives the map that their file gives."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from edge_vpr import ReferenceMap, open_recording, write_recording
from edge_vpr.errors import EdgeVprError, EventError, RecordingError, UsageError
from edge_vpr.events import EVENT_DTYPE, Sensor, join_events, make_events
from edge_vpr.simulation import simulate_pair
from tests.streams import read_events


@pytest.fixture(scope="module")
def drives():
    return simulate_pair(0, "tiny", length_m=40)


@pytest.fixture(scope="module")
def events(drives):
    events = join_events(list(drives[0]))
    events.t -= events["t"][0]  # time 0 of foreign events is the first of them
    return events


def structured(events):
    """In the order and the types of another program, on a clock of its own."""
    foreign = np.empty(len(events), [("x", "i2"), ("y", "i2"), ("polarity", "i1"), ("ts", "i8")])
    foreign["x"], foreign["y"] = events["x"], events["y"]
    foreign["polarity"], foreign["ts"] = events["p"] * 2 - 1, events["t"] + 10**15
    return foreign


def four(events):
    return [events[name] for name in "txyp"]


def frame(events):
    return pytest.importorskip("pandas").DataFrame({name: events[name] for name in "xytp"})


def arrow(events):
    columns = {name: events[name].copy() for name in "xytp"}
    return pytest.importorskip("pyarrow").table(columns)


class Sample:
    """A data set as tonic makes them, of one recording."""

    sensor_size = (32, 32, 2)

    def __init__(self, events, number=1):
        self._events, self._number = events, number

    def __len__(self):
        return self._number

    def __getitem__(self, index):
        return self._events, "a target"


FORMS = {
    "events": lambda events: events,
    "structured": structured,
    "four arrays": lambda events: tuple(four(events)),
    "four lists": lambda events: [column.tolist() for column in four(events)],
    "one array of four columns": lambda events: np.column_stack(four(events)),
    "mapping": lambda events: {name: events[name] for name in "pyxt"},
    "stated seconds": lambda events: {"t_s": events["t"] / 1e6, "x": events["x"], "y": events["y"]},
    "DataFrame": frame,
    "DataFrame of dates": lambda events: frame(events).assign(
        t=lambda table: table["t"].astype("datetime64[us]")
    ),
    "Arrow": arrow,
    "sample": lambda events: (events, 3),
    "data set": Sample,
}


@pytest.mark.parametrize("form", FORMS)
def test_each_form_of_events_in_memory_gives_the_map_and_the_match_of_its_file(
    form, drives, events, tmp_path
):
    write_recording(tmp_path / "drive.npz", events, sensor=drives[0].sensor)
    expected = ReferenceMap.build(tmp_path / "drive.npz", pixels=20)
    held = FORMS[form](events)
    made = ReferenceMap.build(held, sensor=(32, 32), pixels=20)
    # events that count from 1970 say when they began
    assert replace(made, clock_us=0) == expected
    # the map knows the sensor of its camera
    np.testing.assert_array_equal(
        made.match(held).matches.place, expected.match(tmp_path / "drive.npz").matches.place
    )


def test_time_0_of_what_a_recording_yielded_stays_that_of_the_recording(drives):
    events = join_events(list(drives[0]))
    assert events["t"][0] > 0
    built = ReferenceMap.build(events, sensor=drives[0].sensor, track=drives[0].track, pixels=20)
    assert built == ReferenceMap.build(drives[0], track=drives[0].track, pixels=20)


def test_times_in_floating_point_need_a_unit(events):
    table = np.column_stack(four(events)).astype(float)
    with pytest.raises(RecordingError, match="no unit is stated: pass time_unit="):
        open_recording(table, sensor="32x32")
    for each, unit in ((table, "us"), (table / [1e6, 1, 1, 1], "s")):
        read = read_events(each, sensor="32x32", time_unit=unit)
        np.testing.assert_array_equal(read["t"], events["t"] - events["t"][0])


def test_events_in_memory_are_cut_and_their_unit_is_read_as_of_a_file(events):
    part = read_events(events, sensor="32x32", start=1, end=2)
    wanted = events[(events["t"] >= 1_000_000) & (events["t"] < 2_000_000)]
    np.testing.assert_array_equal(part["t"], wanted["t"] - 1_000_000)
    nanoseconds = four(events)
    nanoseconds[0] = nanoseconds[0] * 1000
    read = read_events(nanoseconds, sensor="32x32", time_unit="ns")
    np.testing.assert_array_equal(read, events)


@pytest.mark.parametrize(
    "recording, complaint",
    [
        (lambda events: events, "does not say how large its sensor is"),
        (lambda events: Sample(events, 6), r"holds 6 recordings, .* give .* dataset\[0\]\[0\],"),
        (lambda events: four(events)[:2], "is a sequence of 2"),
        (lambda events: ((events, [1, 2], [3, 4]), 7), r"of a data set's sample its events"),
        (lambda events: (events, events), "is a sequence of 2: .* of several recordings one"),
        (lambda events: [events], r"is a sequence of 1: .*np\.concatenate of the parts of one"),
        (lambda events: ["a.raw", Path("b.raw")], "is a sequence of 2"),
        (lambda events: [open_recording(events, sensor="32x32")] * 2, "is a sequence of 2"),
        (lambda events: [{name: events[name] for name in "txyp"}] * 2, "is a sequence of 2"),
        (lambda events: {"a": events["x"], "b": events["y"]}, "has the columns a, b, and not"),
        (lambda events: {"t": events["t"], "x": events["x"][1:], "y": events["y"]}, "of shapes"),
        (lambda events: np.empty(0, EVENT_DTYPE), "does not say how large"),
        (lambda events: events["t"], "which are no events"),
        (lambda events: np.zeros((9, 2, 32, 32)), r"frames of counts, save them as .*PublishedW"),
        (lambda events: 5, "give a path, events"),
        (lambda events: None, "give a path, events"),
    ],
)
def test_what_is_no_recording_is_refused_in_one_line_that_says_what_to_give(
    recording, complaint, events
):
    with pytest.raises(EdgeVprError, match=complaint):
        ReferenceMap.build(recording(events))


def test_a_sensor_that_contradicts_the_recording_is_refused(drives):
    with pytest.raises(UsageError, match="leave it out"):
        ReferenceMap.build(drives[0], sensor=(346, 260))


def test_a_result_of_events_in_memory_is_saved_without_naming_a_file(drives, events, tmp_path):
    made = ReferenceMap.build(events, sensor=(32, 32), pixels=20)
    for held in (events, open_recording(events, sensor=(32, 32))):
        result = made.match(held)
        assert result.inputs == ()
        result.save(tmp_path / "out", overwrite=True)


class Drive(NamedTuple):
    """A recording of one's own."""

    sensor: Sensor
    events: Any

    def __iter__(self):
        return iter([self.events[:10], self.events[10:]])


def test_a_recording_that_is_a_tuple_is_taken_as_the_recording_that_it_is(drives):
    settings = {"pixels": 10, "sigma": 1.0}
    drive = Drive(drives[0].sensor, join_events(list(drives[0])))
    expected = ReferenceMap.build(drives[0], **settings)
    assert ReferenceMap.build(drive, **settings).places == expected.places


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (([0.5], [1], [1]), "column t holds 0.5: give whole microseconds"),
        (([np.nan], [1], [1]), "column t holds nan"),
        (([np.inf], [1], [1]), "column t holds inf"),
        (([1], [1.7], [1]), "column x holds 1.7: give whole numbers"),
        (([1], [1], [1], [np.nan]), "column p holds nan: give numbers"),
    ],
)
def test_events_are_not_made_of_numbers_that_would_be_cut_off(columns, words):
    with pytest.raises(EventError, match=words):
        make_events(*columns)
    whole = make_events([1.0], [2.0], [3.0], [0.5])
    assert whole.tolist() == [(1, 2, 3, True)]


def test_columns_of_text_and_columns_as_rows_name_their_remedy(events):
    columns = four(events)
    with pytest.raises(RecordingError, match=r"transpose it \(\.T\)"):
        open_recording(np.array(columns), sensor="32x32")
    columns[1] = columns[1].astype(str)
    with pytest.raises(RecordingError, match=r"x\.astype\(float\)"):
        open_recording(columns, sensor="32x32")
