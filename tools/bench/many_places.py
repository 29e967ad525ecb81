"""``edge-vpr match`` of 1,000 windows on a million places: time and peak memory, each way to match.

``python tools/bench/many_places.py`` prints a line for each way; each is a process of its own. It
ends with 1 if one of them takes 1 GB or more.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.events import Sensor, make_events
from edge_vpr.map_record import coded_map
from edge_vpr.recordings import write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS

SENSOR, PIXELS, WINDOW_US = Sensor(346, 260), 150, 1_000_000
MOST_BYTES = 1e9
MATCHINGS = {
    "live": ["--no-smooth"],
    "4 windows late": ["--no-smooth", "--delay", "4"],
    "smoothed": [],
}


class Drive:
    """Windows of up to 19 events at each selected pixel."""

    sensor = SENSOR

    def __init__(self, pixel_map: PixelMap, windows: int) -> None:
        self._pixel_map, self._windows = pixel_map, windows

    def __iter__(self):
        rng = np.random.default_rng(2)
        for k in range(self._windows):
            at = np.repeat(np.arange(PIXELS), rng.integers(0, 20, PIXELS))
            t = np.sort(rng.integers(k * WINDOW_US, (k + 1) * WINDOW_US, at.size))
            rng.shuffle(at)
            yield make_events(t, self._pixel_map.x[at], self._pixel_map.y[at])


def write_inputs(folder: Path, places: int, windows: int) -> tuple[Path, Path]:
    """Write a map of random counts, and a drive."""
    rng = np.random.default_rng(1)
    flat = 7 * np.arange(PIXELS)
    pixel_map = PixelMap(
        SENSOR, (flat % 346).astype(np.uint16), (20 * (flat // 346)).astype(np.uint16)
    )
    start = np.arange(places, dtype=np.int64) * WINDOW_US
    counts = rng.integers(0, 20, (places, PIXELS), dtype=np.uint8)
    events = counts.sum(axis=1, dtype=np.int64)
    described = Descriptors(counts, start, start + WINDOW_US, events, selected=events)
    nothing = np.zeros((SENSOR.height, SENSOR.width), dtype=np.float32)
    settings = PRESETS["default"].replaced({"pixels": PIXELS}, "bench")
    counted = ReferenceMap(settings.uncoded, pixel_map, described, nothing, nothing > 0)
    map_file, drive = folder / "map.npz", folder / "drive.npz"
    coded_map(counted, settings).save(map_file)
    write_recording(drive, Drive(pixel_map, windows))
    return map_file, drive


def measure(command: list[str]) -> tuple[float, float, int]:
    """Run a process to its end; return its time, its processor time (s), and its peak memory."""
    start = time.perf_counter()
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    if os.waitstatus_to_exitcode(status):
        sys.exit(f"{' '.join(command)} failed")
    peak = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime, peak


def main() -> None:
    """Measure every way."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--places", type=int, default=1_000_000)
    parser.add_argument("--windows", type=int, default=1_000)
    args = parser.parse_args()
    too_much = False
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # a process inherits its parent's peak, so that the arrays are made in another one
        writer = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); "
        writer += "from pathlib import Path; from many_places import write_inputs; "
        writer += f"write_inputs(Path({name!r}), {args.places}, {args.windows})"
        subprocess.run([sys.executable, "-c", writer], check=True)
        for name, flags in MATCHINGS.items():
            seconds, busy, peak = measure(
                [
                    *(sys.executable, "-m", "edge_vpr_tools.cli", "match"),
                    *(str(folder / "map.npz"), str(folder / "drive.npz")),
                    *("-o", str(folder / "out"), "--overwrite", "--no-figures", "-q", *flags),
                ]
            )
            print(f"{name}: {seconds:.0f} s, {busy:.0f} s busy, {peak / 1e9:.2f} GB", flush=True)
            too_much = too_much or peak >= MOST_BYTES
    sys.exit(int(too_much))


if __name__ == "__main__":
    main()
