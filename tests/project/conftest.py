"""A street that the examples drive on."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair
from tests.live.devices import sent_by


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map with positions, and the drive it was made of as bytes, which it surely knows."""
    folder = tmp_path_factory.mktemp("street")
    first, _ = simulate_pair(seed=0, length_m=60.0)
    ReferenceMap.build(first, track=first.track, tau="250ms").save(folder / "map.npz")
    (folder / "sent.bin").write_bytes(sent_by(first, first.sensor))
    return folder
