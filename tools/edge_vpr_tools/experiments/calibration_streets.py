"""Simulated streets that the shipped table of probabilities is learnt and judged on.

Each street is mapped once and driven in three lights and speed profiles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

from edge_vpr.descriptors.descriptors import Descriptors
from edge_vpr.evaluation.truth_from_tracks import from_tracks
from edge_vpr.pipeline import count_windows, map_traverse
from edge_vpr.settings import PRESETS
from edge_vpr.simulate import QUERY, REFERENCE, Drive, Light, SimulatedRecording, simulate_pair
from edge_vpr_tools.experiments.detours import Case

#: these streets are not used by any other experiment
FIRST_SEED = 1_000
#: Trust compares the best place with those outside the exclusion zone of 3 places, so that it can
#: only indicate larger errors: a little over 3 places at 6 m/s and with windows of a second.
TOLERANCE_M = 20.0
PIXELS = (25, 150)
WINDOWS = ("time", "count")
QUERIES: dict[str, Drive] = {
    "half to double speed, other light": QUERY,
    "the same light": replace(
        REFERENCE, speed_range=1.3, traffic_per_km=8.0, lateral_m=-0.2, yaw_deg=-0.5
    ),
    "faster, with halts, at dusk": replace(
        QUERY,
        speed_mps=8.0,
        speed_range=1.5,
        stops=2,
        light=Light(sun=0.1, ambient=0.5, azimuth_deg=150.0, elevation_deg=15.0, glare=0.1),
    ),
}
_ELSEWHERE = "the same light"


class Street(NamedTuple):
    """Simulated street that is mapped, and one drive along it.

    Attributes
    ----------
    seed : int
    case : Case
    elsewhere : Descriptors or None
        Counts of a drive through the previous street, at the same pixels.
    """

    seed: int
    case: Case
    elsewhere: Descriptors | None


def streets(seeds: int, on_start: Callable[[str], None]) -> Iterator[Street]:
    """Simulate streets, and describe each drive with each number of pixels and kind of window."""
    before: SimulatedRecording | None = None
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        on_start(f"street {seed - FIRST_SEED + 1} of {seeds}")
        drives: dict[str, SimulatedRecording] = {}
        reference: SimulatedRecording | None = None
        for name, profile in QUERIES.items():
            first, second = simulate_pair(seed, query=profile)
            reference = first.keep() if reference is None else reference
            drives[name] = second.keep()
        assert reference is not None
        for pixels in PIXELS:
            for window in WINDOWS:
                changes = {
                    "pixels": pixels,
                    "window": window,
                    "events_per_pixel": None,
                    "seed": seed,
                }
                settings = PRESETS["default"].replaced(changes, "calibration")
                mapped = map_traverse(reference, settings)
                elsewhere = (
                    None
                    if before is None
                    else count_windows(before, mapped.pixel_map, mapped.settings)
                )
                for driven in drives.values():
                    counted = count_windows(driven, mapped.pixel_map, mapped.settings)
                    truth = from_tracks(
                        reference.track,
                        driven.track,
                        mapped.places.centre_us,
                        counted.centre_us,
                        TOLERANCE_M,
                    )
                    yield Street(seed, Case(mapped, counted, truth), elsewhere)
        before = drives[_ELSEWHERE]
