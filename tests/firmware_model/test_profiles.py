"""The promise of both profiles: recorded, live, specification, C and core are equal to the bit.

The specification is what the others are held to, by one drive of each profile.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from edge_vpr_tools.estimate.of_map import design_of, memories_of

from edge_vpr.drive_inputs import opened
from edge_vpr.events import Events, Sensor
from edge_vpr.match_result import describe_query
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from firmware_model import Event, MatchResult
from firmware_model.emulation.build import HOST, build
from firmware_model.hardware import replay
from firmware_model.hardware.simulation import Conditions
from firmware_model.vectors import write_suites
from firmware_model.vectors.case import Case
from tests.firmware_model.designs import run_host, told
from tests.streams import Drive, cut_up, random_events, with_sums

SENSOR = Sensor(24, 16)
_SMALL = {"pixels": 12, "sigma": 1.0, "tau_us": 100_000, "remove_bursts": False}
#: settings of each profile, by what is chosen
PROFILES: dict[str, dict[str, Any]] = {
    "robot": {"preset": "default"},
    "robot, one gain": {"preset": "default", "gains": 1},
    "robot, one place per window": {"preset": "default", "places_per_window": 1, "gains": 1},
    "paper": {"preset": "paper", "counter_code": "linear", "counter_bits": 4},
    "paper, windows by number": {
        "preset": "paper", "counter_code": "linear", "counter_bits": 4, "window": "count",
        "events_per_pixel": 1.0,
    },
}  # fmt: skip


class Driven(NamedTuple):
    """A map, a drive of it, and what the specification says of the drive."""

    reference: ReferenceMap
    events: Events
    case: Case
    matches: list[MatchResult]

    def same(self, rows: Sequence[Sequence[int]]) -> None:
        """Hold place, sum, second place, its sum, and ties of all matches to the device's."""
        expected = [
            (m.place, m.sum, -1 if m.second is None else m.second,
             -1 if m.second_sum is None else m.second_sum, m.ties)
            for m in self.matches
        ]  # fmt: skip
        assert len(expected) > 15
        assert [tuple(map(int, row)) for row in rows][: len(expected)] == expected


@pytest.fixture(scope="module", params=PROFILES)
def driven(request) -> Driven:
    rng = np.random.default_rng(11)
    profile = dict(PROFILES[request.param])
    settings = PRESETS[profile.pop("preset")].replaced(_SMALL | profile, "the test")
    assert settings.profile == request.param.partition(",")[0]
    drives = [random_events(rng, 12_000, SENSOR, 3_000_000) for _ in range(2)]
    reference = ReferenceMap.build(Drive(drives[0], SENSOR), settings)
    # as a robot: every window by what came before it
    now = replace(reference.settings, smooth=False)
    reference = replace(reference, settings=now)
    design = design_of(reference, lanes=4)
    events = tuple(Event(t, x, y, bool(p)) for t, x, y, p in drives[1].tolist())
    case = Case("drive", memories_of(reference, design), events)
    return Driven(reference, drives[1], case, case.trace().matches)


def test_recorded_matches_are_those_of_the_specification(driven):
    """By Numba, all windows at once."""
    queries = describe_query(driven.reference, opened(Drive(driven.events, SENSOR)))
    matches = match_descriptors(driven.reference.places, queries, driven.reference.settings)
    length = driven.reference.settings.windows_per_match
    shift = length - 1 - length // 2  # from the middle window of a sequence to the newest
    second = np.where(matches.second < 0, -1, matches.second + shift)
    second_sum = np.where(matches.second < 0, -1, np.rint(matches.second_distance * length))
    driven.same(
        list(
            zip(
                matches.place + shift,
                np.rint(matches.distance * length),
                second,
                second_sum,
                matches.ties,
                strict=True,
            )
        )
    )


def test_live_matches_are_those_of_the_specification(driven):
    """By Numba, event by event, in pieces of any size."""
    settings = driven.reference.settings
    localiser = Localiser(driven.reference, every=MatchSchedule.window(settings))
    pieces = cut_up(np.random.default_rng(3), driven.events, 20)
    matches = np.concatenate([localiser.update(piece) for piece in pieces])
    rows = with_sums(matches, settings.windows_per_match)
    names = ["place", "distance", "second", "second_distance", "ties"]
    driven.same(rows[names].tolist())


def test_the_firmware_returns_every_record_of_the_specification(driven, tmp_path):
    """In C, as a program of this computer."""
    pytest.importorskip("ziglang", reason="ziglang is not installed (extra firmware)")
    assert run_host(build(HOST, tmp_path), driven.case, tmp_path) == told(driven.case)


@pytest.mark.skipif(shutil.which("iverilog") is None, reason="iverilog is not installed")
def test_the_core_returns_every_record_of_the_specification(driven, tmp_path: Path):
    """In SystemVerilog, simulated with stalls and a reset."""
    short = replace(driven.case, events=driven.case.events[:8_000])
    write_suites(tmp_path / "v", short.design, {"drive": [short]}, 0, rtl=True)
    outcome = replay.hold(tmp_path / "v", Conditions(seed=2, stall=20, resets=1))
    assert outcome.differences == [] and outcome.compared["match"] > 5
