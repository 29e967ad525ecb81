"""docs/specification.md: a device written from the page returns all that the model does."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from specification_device import HALF_ROWS, ROWS, Device, Drive, table

from edge_vpr.matching.drive import smoothed_trust
from edge_vpr.matching.place_filter import (
    BackwardPass,
    FixedLag,
    PlaceFilter,
    TransitionCosts,
    Transitions,
    WindowRows,
)
from firmware_model import Design
from firmware_model.vectors import load_manifest, standard_suites, write_suites
from firmware_model.vectors.random_cases import random_adaptive_design

DESIGN = Design(width=24, height=16, pixels=9, places=20, length=3, code_bits=3, lanes=4)
FILTER = replace(DESIGN, matching="filter", length=1, code="own-mean", full_scales=(0,))
LIVE = replace(FILTER, code="contrast", activity_costs=True, steps=())
DESIGNS = {
    "sequences": DESIGN,
    "filter": FILTER,
    "filter by activity": LIVE,
    "by_count": replace(FILTER, code="log", window="count", window_events=40, polarity=True),
    "random": random_adaptive_design(np.random.default_rng(1)),
}


def test_the_costs_of_steps_on_the_page_are_those_of_the_device():
    page = (Path(__file__).parents[2] / "docs/specification.md").read_text(encoding="utf-8")
    lines = re.findall(r"^ *\d+(?: +\d+){11}$", page, re.MULTILINE)
    rows = [tuple(map(int, line.split())) for line in lines]
    both = zip(ROWS, HALF_ROWS, strict=True)
    assert rows == [(row, *one, *two) for row, (one, two) in enumerate(both)]


@pytest.mark.slow
@pytest.mark.parametrize("name", DESIGNS)
def test_a_device_from_the_page_alone_returns_every_record_of_all_cases(name, tmp_path):
    """It reads the files of each case, and imports nothing of the project."""
    design = DESIGNS[name]
    write_suites(tmp_path / "v", design, standard_suites(design, 7), 7)
    differ, cases = [], 0
    for place, _ in load_manifest(tmp_path / "v").cases():
        folder = tmp_path / "v" / place
        device, found = Device(folder), {"event": [], "window": [], "match": []}
        for t, x, y, on in table(folder, "events"):
            for kind, values in device.take(t, x, y, on):
                found[kind].append(values)
        names = {"event": "events", "window": "windows", "match": "matches"}
        differ += [place for k, v in found.items() if v != table(folder, f"expected_{names[k]}")]
        cases += 1
    assert differ == [] and cases > 40


def drives():
    """Random drives: with jumps, odometry, or neither, on maps of 2 to 11 places."""
    for seed in range(30):
        rng = np.random.default_rng(seed)
        places, windows = int(rng.integers(2, 12)), int(rng.integers(1, 15))
        steps = tuple(rng.integers(0, 5, int(rng.integers(1, 5))).tolist())
        back = tuple(rng.integers(0, 5, int(rng.integers(0, 3))).tolist())
        design = {
            "activity_costs": (1, 2, 0, 0)[seed % 4], "steps": () if seed % 4 < 2 else steps,
            "back": back, "restart": int(rng.integers(0, 20)),
            "exclusion": int(rng.integers(0, 4)),
        }  # fmt: skip
        jumps = [] if seed % 3 else [(places - 1, 0)]
        along = np.cumsum(rng.integers(1, 900, places)) if seed % 2 else None
        driven = [None] * windows
        if along is not None:
            draws = rng.integers(-300, 2_000, windows).tolist()
            driven = [None if w == 0 or rng.random() < 0.3 else d for w, d in enumerate(draws)]
        distances = rng.integers(0, 400, (windows, places)).astype(np.int32)
        events = (rng.integers(0, 40, windows) * rng.integers(0, 2, windows)).astype(np.int64)
        own = rng.integers(-128, 128, places).astype(np.int32)
        yield design, distances, events, int(rng.integers(0, 60_000)), jumps, along, driven, own


@pytest.mark.parametrize("delay", [None, 0, 1, 3])
def test_smoothing_delay_odometry_and_jumps_are_those_of_the_page(delay):
    """Places, metrics and trust of the pipeline; `None` is the whole drive."""
    for design, distances, events, usual, jumps, along, driven, own in drives():
        costs = TransitionCosts(
            design["steps"] or None, design["back"], design["restart"],
            design["activity_costs"] or 1,
        )  # fmt: skip
        transitions = Transitions(
            distances.shape[1], costs, own if design["activity_costs"] else None,
            np.array(jumps, dtype=np.int32).reshape(-1, 2), along, exclusion=design["exclusion"],
        )  # fmt: skip
        place_filter = PlaceFilter(transitions, usual)
        rows, late = [], []
        lag = FixedLag(transitions, delay or 0)
        for row, count, distance in zip(distances, events, driven, strict=True):
            if distance is not None:
                place_filter.predict_travelled(distance, distance)
            rows.append(place_filter.update_windows(row[None], count[None]))
            late.append(lag.add(rows[-1], [distance])[0])
        page = Drive(
            design, distances.tolist(), events.tolist(), usual, jumps,
            () if along is None else along.tolist(), driven, own.tolist(),
        )  # fmt: skip
        if delay is not None:
            decided = np.concatenate([*late, lag.finish()[0]])
            found = [tuple(row) for row in decided[:, [0, 1, 5]].tolist()]
            assert page.delayed(delay) == found
            if delay == 0:
                assert found == [tuple(r.columns[0, [0, 1, 5]].tolist()) for r in rows]
        else:
            parts = [np.concatenate(column) for column in zip(*rows, strict=True)]
            every = WindowRows(*parts)
            BackwardPass(transitions).add_to(every, driven)
            against = every.evidence[np.arange(len(driven)), every.columns[:, 0]].astype(np.int64)
            place, metric = every.columns[:, 0], every.columns[:, 1]
            trust = smoothed_trust(place, every.columns[:, 5], against, driven, transitions)
            found = zip(place, metric, trust, strict=True)
            assert page.smoothed() == [tuple(map(int, one)) for one in found]
