"""The firmware model: equal to the pipeline bit for bit; designs, tables and their sizes."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge_vpr.compiling import plain
from edge_vpr.descriptors import activity as activity_of_drives
from edge_vpr.descriptors.codes import encode, saturated
from edge_vpr.descriptors.counting import DescriptorStream
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import FixedCount, FixedTime
from edge_vpr.events import Sensor, make_events
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.match import Match
from edge_vpr.matching.place_filter import PlaceFilter
from edge_vpr.matching.prediction import TransitionCosts, Transitions
from edge_vpr.matching.search import best_matches
from edge_vpr.matching.sequences import sequence_sums
from firmware_model import (
    Design,
    DesignError,
    Event,
    EventResult,
    Machine,
    MatchResult,
    Memories,
    WindowResult,
    cost,
    trace,
)
from firmware_model.design import formats_of
from firmware_model.specification import ilog, mean_activity_after
from firmware_model.vectors.random_cases import random_design, random_memories
from fixedpoint import activity
from fixedpoint.own_mean import ContrastCode
from tests.firmware_model.designs import drawn_drive, wrapped

ROOM = Path(__file__).parents[2] / "firmware_model"


def pipeline(memories: Memories, events: list[Event], start: int):
    """Codes of each window and its match, by edge_vpr."""
    design = memories.design
    x, y = (np.array(column) for column in zip(*memories.pixels, strict=True))
    stream = DescriptorStream(
        PixelMap(Sensor(design.width, design.height), x, y),
        FixedTime(design.tau_us) if design.window == "time" else FixedCount(design.window_events),
    )
    t, x, y, on = zip(*events, strict=True)
    counted = stream.update(make_events(np.array(t) - start, x, y, on))
    events = counted.selected_events
    if design.contrast:
        limited = np.minimum(counted.counts, np.array(memories.limits))
        events = limited.sum(axis=1, dtype=np.int64)
        code = ContrastCode(design.code_bits)
        mean = np.array(memories.mean, dtype=np.int32)
        counted = replace(counted, selected=events)
        coded = encode(counted, code, memories.activity, design.gains, mean)
        codes = coded.counts
        sums = codes[:, None]
        if coded.summed is not None:
            sums = np.concatenate([sums, coded.summed], axis=1)
    else:
        codes = saturated(counted, design.code_max).counts
        sums = codes[:, None]
    if design.filters:
        return codes, by_filter(memories, sums, events)
    if len(codes) < design.length:
        return codes, []
    distances = ReferenceIndex(np.array(memories.places)).matrix(codes)
    sums = sequence_sums(distances, design.length)
    matches, last = [], design.length - 1
    for j, (best, second, ties) in enumerate(
        zip(*map(np.ndarray.tolist, best_matches(sums, design.exclusion)), strict=True)
    ):
        best_sum = int(sums[best, j])
        second_best = (second + last, int(sums[second, j])) if second >= 0 else (None, None)
        accepted = best_sum <= design.largest_sum
        matches.append(MatchResult(j + last, best + last, best_sum, *second_best, ties, accepted))
    return codes, matches


def by_filter(memories: Memories, codes, events):
    """Matches of each window by the pipeline's place filter; the codes are of each sum."""
    design = memories.design
    costs = TransitionCosts(design.restart, design.places_per_window, gains=design.gains)
    own = np.array(memories.place_activity, dtype=np.int32)
    transitions = Transitions(design.places, costs, own, exclusion=design.exclusion)
    bias = np.array(memories.place_bias, dtype=np.int64)
    transitions.table = transitions.table._replace(bias=bias)
    place_filter = PlaceFilter(transitions, memories.activity)
    places, matches = np.array(memories.places), []
    for j, window in enumerate(events.tolist()):
        of_sums = codes[j, : design.sums]
        distances = np.abs(places[None].astype(int) - of_sums[:, None].astype(int)).sum(axis=2)
        rows = place_filter.update_windows(distances[None].astype(np.int32), np.array([window]))
        m = Match(*rows.matches[0].tolist())
        second = (None, None) if m.second < 0 else (m.second, int(m.second_distance))
        accepted = m.second >= 0 and m.trust >= design.trust
        matches.append(MatchResult(j, m.place, int(m.distance), *second, m.ties, accepted, m.trust))
    return matches


def test_logarithms_are_those_of_the_pipeline():
    """The model has its own way to a logarithm of every size."""
    least = activity.least_events().tolist()
    for log, events in enumerate(least, 1):
        assert ilog(events - 1) < log <= ilog(events)
    assert ilog((1 << 23) - 1) == len(least)


def test_the_activity_saturates_where_its_width_ends():
    """Windows of more than 2**23 events count as that many, and their mean stays in 31 bits."""
    ours, theirs = 0, 0
    for _ in range(2000):
        ours = mean_activity_after(ours, 1 << 40)
        theirs = plain(activity_of_drives.mean_activity_after)(theirs, 1 << 40)
    assert ours == theirs and ours.bit_length() == 31


@pytest.mark.parametrize("adaptive", [False, True])
def test_the_model_equals_the_pipeline_on_random_designs_and_streams(adaptive):
    """Codes of every window and every field of every match, over 540 designs, clocks wrapping.

    300 are of sequences; the others have the place filter, contrast codes, or both.
    """
    seen = Counter()
    for seed in range(240 if adaptive else 300):
        memories, start, events = drawn_drive(seed, adaptive=adaptive)
        design = memories.design
        codes, matches = pipeline(memories, events, start)
        done = trace(memories, wrapped(events, design), start)
        assert [window.codes for window in done.windows] == list(map(tuple, codes.tolist())), seed
        assert done.matches == matches, seed
        form = formats_of(design)
        assert all(0 <= event.counted <= form["count"].highest for event in done.events)
        assert all(0 <= max(window.codes) <= form["code"].highest for window in done.windows)
        most = form["sum" if adaptive else "sequence"].highest
        assert all(0 <= match.sum <= most for match in done.matches)
        if design.filters:
            assert all(0 <= match.trust <= form["trust"].highest for match in done.matches)
        # the comparison above is worth nothing for what did not occur
        seen["windows"] += len(codes)
        seen["matches"] += len(matches)
        seen["ties"] += sum(match.ties > 0 for match in matches)
        seen["accepted"] += sum(match.accepted for match in matches)
        seen["no second"] += sum(match.second is None for match in matches)
        seen["wraps"] += events[-1].t >> design.timestamp_bits > start >> design.timestamp_bits
        if adaptive:
            count_adaptive(seen, design, done)
    assert min(seen.values()) > 20, seen
    if adaptive:
        assert seen["pauses"] > 300 and seen["moves"] > 300, seen
    else:
        assert seen["matches"] > 3000 and min(seen.values()) > 30, seen


def count_adaptive(seen, design, done):
    """Count what the place filter and contrast codes did."""
    seen["filter"] += design.filters
    seen["pauses"] += sum(state.paused for state in done.states)
    seen["contrast"] += design.contrast
    seen["seven gains"] += design.gains > 1
    seen["places at half windows"] += design.places_per_window == 2
    weights = [state.weight for state in done.states if not state.paused]
    seen["less weight"] += sum(weight in range(8) for weight in weights)
    seen["moves"] += len(weights)
    seen["rejected by trust"] += sum(
        m.second is not None and m.trust < design.trust for m in done.matches if design.filters
    )


def small(**changes) -> Design:
    values = {"width": 4, "height": 3, "pixels": 2, "places": 3, "length": 1, "tau_us": 10}
    values |= {"code_bits": 8}
    return Design(**(values | changes))


def tables(design: Design) -> Memories:
    pixels = [(f % design.width, f // design.width) for f in range(design.pixels)]
    return Memories(design, pixels, [[0] * design.slots] * design.places)


def test_state_can_be_read_after_every_event():
    """Counts and the end of the window show what the event did, and nothing else."""
    machine = Machine(tables(small(code_bits=1)))
    assert list(machine.take(Event(3, 1, 0, True))) == [EventResult(0, 1, 1)]
    assert machine.counts == [0, 1]
    assert list(machine.take(Event(4, 2, 2, True))) == [EventResult(1, None, 0)]
    list(machine.take(Event(4, 1, 0, False)))
    list(machine.take(Event(4, 1, 0, True)))
    assert machine.counts == [0, 1]  # full
    results = list(machine.take(Event(10, 0, 0, True)))
    assert results[0][:3] == (0, 4, (0, 1))
    assert isinstance(results[1], MatchResult) and results[2] == EventResult(4, 0, 1)
    assert (machine.end, machine.counts) == (20, [1, 0])


def test_the_clock_may_wrap_and_a_late_event_counts_in_the_open_window():
    """A window spans the wrap; an event up to half the clock's period late ends no window."""
    machine = Machine(tables(small(timestamp_bits=8)), start=250)
    assert len(list(machine.take(Event(255, 0, 0, True)))) == 1
    assert len(list(machine.take(Event(3, 0, 0, True)))) == 1  # 259, of [250, 260)
    results = list(machine.take(Event(4, 0, 0, True)))  # 260
    assert results[0][:3] == (0, 2, (2, 0))
    assert machine.end == 14
    assert [type(r) for r in machine.take(Event(255, 0, 0, True))] == [EventResult]  # 5 us late
    assert machine.counts == [2, 0]
    # from half a period behind the window's end on, a time is in the past
    assert [type(r) for r in machine.take(Event(14 + 129, 0, 0, True))] == [EventResult]
    assert sum(isinstance(r, WindowResult) for r in machine.take(Event(14 + 128, 0, 0, True))) == 13


DAVIS = Design(width=346, height=260, pixels=150, places=860, length=5, lanes=8, code="counts")


def test_cycles_agree_with_the_measured_core():
    """A throw-away core took N + K ceil(N/P) + about 6 cycles a match."""
    assert abs(cost.cycles(DAVIS).match - (150 + 860 * 19 + 6)) <= 2


def test_widths_hold_the_largest_values_and_no_more():
    """Widths of 150 pixels as worked out by hand: SAD 12, 14, 16 bits; 15, 17, 19 over L = 10."""
    for bits, distance, sequence in ((4, 12, 15), (6, 14, 17), (8, 16, 19)):
        formats = formats_of(replace(DAVIS, length=10, code_bits=bits))
        assert (formats["distance"].width, formats["sequence"].width) == (distance, sequence)
    assert formats["place"].width == 10 and formats["owner"].highest >= 260


def test_memory_sizes_of_a_known_design():
    """Bits of each memory, by hand; block memories are counted whole."""
    design = replace(DAVIS, code_bits=4)
    sizes = cost.memories(design)
    assert sizes["displacement"] == (260, 9) and sizes["lookup"] == (512, 9 + 8)
    assert sizes["pixel_delay"] == (2, 9 + 1)
    assert sizes["counts"] == (150, 4) and "level" not in sizes
    assert sizes["places"] == (860 * 19, 32) and sizes["places"].bits == 522_880
    assert sizes["history"] == (5 * 860, 12) and sizes["delay"] == (4, 14)
    assert sizes["places"].tiles(256, 16) == 64 * 2  # 16,340 words of 32 bits
    assert cost.operations(design).absolute_differences == 860 * 150


def test_the_lookup_finds_every_selected_pixel_and_no_other():
    """All pixels of random sensors, also those that share an entry with another row."""
    for seed in range(100):
        rng = np.random.default_rng(seed)
        design = random_design(rng)
        memories = random_memories(rng, design)
        lookup = memories.lookup()
        slots = {pixel: slot for slot, pixel in enumerate(memories.pixels)}
        for y in range(design.height):
            for x in range(design.width):
                assert lookup(x, y) == slots.get((x, y))


def test_a_design_survives_its_file(tmp_path):
    """TOML gives back the same design, for 50 of them."""
    for seed in range(50):
        design = random_design(np.random.default_rng(seed))
        design.save(tmp_path / "design.toml", overwrite=True)
        assert Design.load(tmp_path / "design.toml") == design


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pixels": 0}, "pixels = 0"),
        ({"pixels": 13}, "take fewer"),
        ({"code": "cube"}, "choose from counts"),
        ({"code_bits": 17}, "expected 1 to 16"),
        ({"length": 4}, "longer map"),
        ({"largest_sum": 9, "matching": "filter"}, "accepts by trust"),
        ({"lookup_depth": 5}, "power of two"),
        ({"timestamp_bits": 4}, "half of the time"),
        ({"window": "sliding"}, "choose from"),
        ({"matching": "viterbi"}, "choose from sequence"),
        ({"matching": "filter", "length": 2}, "leave length out"),
        ({"places_per_window": 2}, "of sequences"),
        ({"places_per_window": 3, "matching": "filter"}, "expected 1 to 2"),
        ({"restart": 31}, "restart = 31"),
        ({"gains": 3, "matching": "filter"}, "gains = 3: expected 1 or 7"),
        ({"gains": 7, "matching": "filter"}, "gains = 7: they need the place filter, contrast"),
        ({"gains": 7, "code": "contrast"}, "gains = 7: they need the place filter, contrast"),
        ({"trust": 1}, "only the place filter"),
        ({"code": "contrast", "code_bits": 9}, "of contrast codes: expected 1 to 8"),
    ],
)
def test_a_design_that_cannot_be_is_refused(changes, message):
    """Each error names the value and what was expected."""
    with pytest.raises(DesignError, match=message):
        small(**changes)


def test_files_that_are_no_design_are_refused(tmp_path):
    """A missing file, an unknown and a missing name."""
    for text, message in (("widht = 3", "unknown name"), ("width = 3", "lacks height")):
        (tmp_path / "d.toml").write_text(text)
        with pytest.raises(DesignError, match=message):
            Design.load(tmp_path / "d.toml")
    with pytest.raises(DesignError, match="cannot read"):
        Design.load(tmp_path / "missing.toml")


def test_tables_that_do_not_fit_the_design_are_refused():
    """Number of pixels and places, place length, codes and pixels off the sensor."""
    design = small()
    good = tables(design)
    for pixels, places, message in (
        ([(0, 0)], good.places, "different pixels"),
        ([(0, 0), (4, 0)], good.places, "lies off"),
        (good.pixels, good.places[:2], "2 places"),
        (good.pixels, [[0, 0], [0, 0], [0, 256]], "place 2"),
    ):
        with pytest.raises(DesignError, match=message):
            Memories(design, pixels, places)
    adaptive = small(matching="filter", code="contrast", code_bits=3)
    for changed, wrong, message in (
        (adaptive, {"mean": [0]}, "means of 1 counters of contrast codes: expected 2 from 0"),
        (adaptive, {"mean": [0, 2561]}, "from 0 to 2560"),
        (design, {"mean": [0, 0]}, "means of 2 counters of contrast codes: expected 0"),
        (adaptive, {"limits": [0, 1024]}, "limits of 2 .* from 0 to 1023"),
        (adaptive, {"place_bias": [0, 256, 0]}, "biases of 3 .* from 0 to 255"),
        (design, {"place_bias": [0, 0, 0]}, "biases of 3 .*: expected 0 from"),
        (adaptive, {"place_activity": [0, 128, 0]}, "activities of 3 .* from -128 to 127"),
        (design, {"activity": 1}, "expected 0 to 0"),
        (adaptive, {"activity": 1 << 31}, "activity = 2147483648"),
    ):
        with pytest.raises(DesignError, match=message):
            Memories(changed, good.pixels, good.places, **wrong)
    with pytest.raises(DesignError, match="lookup_depth = 8"):
        # what one row leaves free is not two neighbours
        Memories(
            small(pixels=4, lookup_depth=4), [(0, 0), (2, 0), (0, 1), (1, 1)], [[0] * 4] * 3
        ).lookup()


#: without those that need the package of a simulator to be imported
PROGRAMS = [
    path.relative_to(ROOM.parent).with_suffix("").as_posix().replace("/", ".")
    for path in sorted(ROOM.rglob("*.py"))
    if '__name__ == "__main__"' in path.read_text() and "cocotb" not in path.parts
]


@pytest.mark.parametrize("program", PROGRAMS)
def test_every_program_says_what_it_does_instead_of_doing_it(program):
    words = [sys.executable, "-m", program, "--help"]
    done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOM.parent)
    assert done.stdout.startswith(f"usage: {program.rpartition('.')[2]}.py")
