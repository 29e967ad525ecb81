"""docs/specification.md and the modules that are the same as a program."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import firmware_model
from firmware_model import Design, Memories
from firmware_model import specification as spec
from firmware_model import specification_drive as drive
from firmware_model.design import LEVELS
from firmware_model.vectors.facts import replaced
from firmware_model.vectors.fast_filter import advanced_by
from fixedpoint.activity import BANK_COSTS
from tests.firmware_model.designs import random_stream, wrapped

ROOM = Path(firmware_model.__file__).parent


def test_the_costs_of_steps_on_the_page_are_those_of_the_table():
    page = (Path(__file__).parents[2] / "docs/specification.md").read_text(encoding="utf-8")
    lines = re.findall(r"^ *\d+(?: +\d+){12}$", page, re.MULTILINE)
    rows = [tuple(map(int, line.split())) for line in lines]
    both = zip(*BANK_COSTS.values(), strict=True)
    assert rows == [(row, *one, *two) for row, (one, two) in enumerate(both)]


def test_the_page_names_functions_that_exist():
    page = (Path(__file__).parents[2] / "docs/specification.md").read_text(encoding="utf-8")
    for section, module in (("6", spec), ("10", drive)):
        text = re.split(r"^## ", page, flags=re.MULTILINE)
        (body,) = [one for one in text if one.startswith(f"{section}. ")]
        named = re.findall(r"`([a-z]+_[a-z_]+)`(?=[,) ])", body)
        names = {*vars(spec), *vars(drive), *Design.__dataclass_fields__, "mean_activity"}
        assert named and set(named) <= names, set(named) - names
        assert module.__doc__ and "docs/specification.md" in module.__doc__


def test_the_specification_imports_tables_alone():
    """It can be read by itself: no kernel and no NumPy computes anything of it."""
    may = {"design", "memories", "specification"}
    for name in ("specification", "specification_drive"):
        for node in ast.walk(ast.parse((ROOM / f"{name}.py").read_text(encoding="utf-8"))):
            modules = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            for module in modules:
                room, _, inside = module.partition(".")
                assert room not in ("numpy", "edge_vpr"), module
                assert room != "firmware_model" or inside in may, module
                assert room != "fixedpoint" or inside == "activity", module


def drawn(seed: int, gains: int) -> tuple[Memories, list[firmware_model.Event]]:
    """Draw a map of the places' own windows, and a stream of events."""
    rng = np.random.default_rng((seed, gains))
    design = Design(
        width=8, height=6, pixels=7, code="contrast", tau_us=100, places=int(rng.integers(1, 14)),
        matching="filter", places_per_window=1 + seed % 2, gains=gains, restart=8, exclusion=2,
    )  # fmt: skip
    flat = rng.choice(48, design.pixels, replace=False)
    memories = Memories(
        design,
        [(int(f % 8), int(f // 8)) for f in flat],
        rng.integers(0, 8, (design.places, design.slots)).tolist(),
        mean=rng.integers(0, 700, design.slots).tolist(),
        activity=int(rng.integers(256, 4096)),
        place_activity=rng.integers(-40, 30, design.places).tolist(),
        place_bias=rng.integers(0, 9, design.places).tolist(),
        limits=rng.integers(0, 5, design.slots).tolist(),
    )
    return memories, wrapped(random_stream(rng, memories, 1500), design)


@pytest.mark.parametrize("gains", [1, 7])
@pytest.mark.parametrize("seed", range(4))
def test_a_device_matches_as_a_computer_without_odometry(seed, gains):
    memories, events = drawn(seed, gains)
    machine = spec.Machine(memories)
    counts, matches = [], []
    for event in events:
        for result in machine.take(event):
            if isinstance(result, spec.WindowResult):
                counts.append(machine.counts)
            elif isinstance(result, spec.MatchResult):
                matches.append(result)
    counted = [spec.counted_events(one, memories.limits) for one in counts]
    assert [state.counted for state in machine.states] == counted
    design, sums = memories.design, memories.design.sums
    codes = drive.codes_of_sums(
        counts, LEVELS, memories.mean, design.code_bits,
        [state.paused for state in machine.states], sums,
    )  # fmt: skip
    drive_map = drive.DriveMap(spec.FilterMap.of(memories), memories.place_bias, memories.activity)
    distances = [[machine.distances(one) for one in of_window] for of_window in codes]
    windows = drive.windows_of(drive_map, distances, counted)
    told = [(m.place, m.sum, m.second, m.second_sum, m.ties, m.trust) for m in matches]
    assert len(told) > 30
    assert told == drive.live_matches(windows)


@pytest.mark.parametrize("gains", [1, 7])
@pytest.mark.parametrize("seed", range(4))
def test_the_filter_that_draws_cases_advances_as_the_specification(seed, gains):
    memories, events = drawn(seed, gains)
    expected = spec.trace(memories, events)
    with replaced("advance", advanced_by):
        drawn_by = spec.trace(memories, events)
    assert len(expected.states) > 30
    assert (drawn_by.matches, drawn_by.states) == (expected.matches, expected.states)


def test_only_differences_of_biases_matter():
    memories, events = drawn(1, 7)
    higher = replace(memories, place_bias=[one + 200 for one in memories.place_bias])
    assert max(memories.place_bias) < 50
    before, after = spec.trace(memories, events), spec.trace(higher, events)
    assert before.matches == after.matches
    assert [one.spread for one in before.states] == [one.spread for one in after.states]


def test_the_bias_is_half_of_how_typical_a_place_is():
    typical = drive.typical_distances([[0, 0], [0, 0], [7, 7]])
    assert typical == [-1, -1, 4]  # of 4, 4 and 9, less 5
    assert drive.bias_of(typical) == [3, 3, 0]
    assert drive.bias_of([-300, 0, 400]) == [255, 200, 0]


def test_one_window_of_fifty_may_have_more_events_than_the_limit():
    assert drive.limits_of([[count] for count in range(49)]) == [48]
    assert drive.limits_of([[count] for count in range(50)]) == [48]
    assert drive.limits_of([[99 - count] for count in range(100)]) == [97]
    assert spec.counted_events([3, 0, 1023], [5, 4, 100]) == 103


def test_before_the_first_window_nothing_is_known():
    memories, _ = drawn(0, 7)
    filter_map = spec.FilterMap.of(memories)
    state = spec.Kept.of(memories).filter
    paused = spec.advance(filter_map, state, -368, True, [[0] * len(filter_map.activity)] * 3)
    assert paused.best.nearest.sum == 0 and paused.trust.trust == 0
    assert paused.seen.few == 1 and not paused.seen.stands
    assert paused.state.reciprocals == (0, 0, 0)
