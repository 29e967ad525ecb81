"""A simulated street."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from edge_vpr.evaluation.tracks import Track
from edge_vpr.events import Events, join_events
from edge_vpr.recordings import write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair
from tests.live.devices import Clock

Street = tuple[Path, Events, Track]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The time of live sessions, which goes on when the test says so."""
    clock = Clock()
    for name in ("odometer", "reader", "session", "state", "watches"):
        monkeypatch.setattr(f"edge_vpr.live.{name}.time", clock)
    return clock


@pytest.fixture
def greets_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A host that is held up takes its line to be silent, and an answer would be amid events."""
    monkeypatch.setattr("edge_vpr.live.watches.GREET_S", math.inf)


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Street:
    """A folder's map.npz of a street of 200 m, with query.npz of another drive; this drive."""
    folder = tmp_path_factory.mktemp("street")
    first, second = simulate_pair(seed=0, length_m=200.0)
    ReferenceMap.build(first, track=first.track).save(folder / "map.npz")
    write_recording(folder / "query.npz", second)
    return folder / "map.npz", join_events(list(second)), second.track
