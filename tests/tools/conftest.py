"""Two drives of noise, their map and their matches."""

from __future__ import annotations

from pathlib import Path

import pytest
from edge_vpr_tools.cli import main

from edge_vpr.events import Sensor
from tests.streams import write_drives

SENSOR = Sensor(16, 12)
SMALL = ("--preset", "paper", "--pixels", "5", "--sigma", "1", "--tau", "100ms", "-L", "2")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with reference.npz, query.npz, map.npz of 19 places, and results."""
    folder = tmp_path_factory.mktemp("drive")
    write_drives(folder, 4_000, SENSOR, 2_000_000)
    files = [str(folder / name) for name in ("reference.npz", "map.npz", "query.npz", "results")]
    assert main(["map", files[0], "-o", files[1], *SMALL]) == 0
    assert main(["match", files[1], files[2], "-o", files[3]]) == 0
    return folder
