"""The shipped tables of probabilities on simulated streets that they were not learnt from.

Each street is mapped once and driven in ten ways: in other lights, at other speeds, with other
thresholds of the camera, and with stops. Each drive has six
versions: as it was; with a quarter of the places cut out of the map; with a detour through another
street, as long as a quarter of the drive; with the camera carried to another part of the street and
back; backwards; and of another street altogether. Matches of a robot have the running mean of the
query, those of whole drives the drive's own mean. `learn` learns the tables on other streets, in
the same way, but with drives that change between two windows, each from the versions of
`LEARNT_FROM`. Queries of `nulls`, whose windows or pixels are shuffled, are used only for testing.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edge_vpr import __version__
from edge_vpr.confidence import DEFAULT_TABLES, LIVE, LIVE_ON_MAP, SMOOTHED, TABLES
from edge_vpr.descriptors.counting import count_windows
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.calibration import learn_confidence
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.files import replacing
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import QUERY, REFERENCE, Light, SimulatedRecording, simulate_pair
from lab.drives import STREETS, Second, second_drive
from lab.loop import Draw, Drives, Experiment, Row
from lab.nulls import scrambled
from lab.pairs import TRUSTED_M, MappedPair, truth_of_tracks
from lab.shipped_tables import (
    MATCHINGS,
    NAMES,
    VIEW,
    Sample,
    evaluate_tables,
    joined,
    sample,
)
from lab.spliced import (
    ANOTHER,
    BACKWARDS,
    CARRIED,
    CUT,
    DETOUR,
    WHOLE,
    carried_off,
    spliced,
    with_detour,
    without_places,
)

# Streets, their drives, and the versions of each drive.


#: streets from here on are those on which the rules of the filter were chosen, too; those of the
#: evaluation chose nothing
FIRST_SEED, FIRST_UNSEEN = 20, 1_000
PIXELS = (25, 150)
WINDOWS = ("time", "count")
QUERIES: dict[str, Second] = {
    "half to double speed, other light": Second(QUERY),
    "the same light": Second(
        replace(REFERENCE, speed_range=1.3, traffic_per_km=8.0, lateral_m=-0.2, yaw_deg=-0.5)
    ),
    "faster, with halts, at dusk": Second(
        replace(
            QUERY,
            speed_mps=8.0,
            speed_range=1.5,
            stops=2,
            light=Light(sun=0.1, ambient=0.5, azimuth_deg=150.0, elevation_deg=15.0, glare=0.1),
        )
    ),
    **{
        kind: STREETS[f"street, {kind}"]
        for kind in ("low sun", "half speed", "quarter speed", "double speed", "thresholds x 2",
                     "thresholds x 0.5", "3 stops of 2 min")
    },
}  # fmt: skip
_ELSEWHERE = "the same light"
_CUTS = 7  # random stream that decides where drives are cut
#: parts of a window between which drives are spliced where the tables are judged: a robot may be
#: carried off, or leave the map, at any time
PARTS = 4


class Street(NamedTuple):
    """Reference drive of a simulated street, and drives by the names of `QUERIES`."""

    seed: int
    reference: SimulatedRecording
    drives: Mapping[str, SimulatedRecording]


def open_street(seed: int) -> Street:
    """Simulate the drives of a street."""
    reference, query = simulate_pair(seed)
    drives = {name: second_drive(query, second) for name, second in QUERIES.items()}
    return Street(seed, reference.keep(), drives)


def driven(
    street: Street, elsewhere: SimulatedRecording, parts: int = 1, **changes: Any
) -> Iterator[tuple[MappedPair, Descriptors]]:
    """Map a street and count its drives, with each number of pixels and kind of window.

    Drives are counted in parts of windows, so many in a window, each with the truth of the window
    that ends with it. With each drive come the counts of a drive of another street at the same
    pixels. `changes` are settings that differ from the default.
    """
    for pixels in PIXELS:
        for window in WINDOWS:
            chosen = {
                "pixels": pixels,
                "window": window,
                "events_per_pixel": None,
                "seed": street.seed,
                **changes,
            }
            settings = PRESETS["default"].replaced(chosen, "calibration")
            mapped = ReferenceMap.build(street.reference, settings)
            counted = partial(_in_parts, mapped, parts)
            away = counted(elsewhere)
            for drive in street.drives.values():
                some = counted(drive)
                first_us = some.start_us[np.maximum(np.arange(len(some)) - parts + 1, 0)]
                centre_us = first_us + (some.end_us - first_us) // 2
                truth_of = truth_of_tracks(street.reference.track, drive.track, TRUSTED_M)
                truth = truth_of(mapped.places.centre_us, centre_us)
                yield MappedPair(mapped, some, truth), away


def _in_parts(mapped: ReferenceMap, parts: int, drive: SimulatedRecording) -> Descriptors:
    """Count a drive in parts of windows, so many in a window."""
    settings = mapped.settings
    part: dict[str, Any] = {"places_per_window": 1, "tau_us": settings.tau_us // parts}
    if settings.events_per_pixel is not None:
        part["events_per_pixel"] = settings.events_per_pixel / parts
    return count_windows(drive, mapped.pixel_map, settings.replaced(part, "parts of a window"))


def versions_of(
    pair: MappedPair, elsewhere: Descriptors, rng: np.random.Generator, parts: int = 1
) -> dict[str, MappedPair]:
    """Return the versions of a drive by name, in whole windows.

    Parameters
    ----------
    pair : MappedPair
        Map, and the drive in parts of windows, see `driven`.
    elsewhere : Descriptors
        Parts of a drive of another street.
    rng : Generator
        Decides where the map and the drive are cut.
    parts : int
        How many parts are a window.
    """
    places, n = len(pair.reference), len(pair.counted)
    in_order = np.arange(n)
    first = int(rng.integers(0, 3 * places // 4))
    part_of_map = without_places(pair, first, first + places // 4)
    whole = spliced(pair, in_order, parts)
    cut = spliced(part_of_map, in_order, parts)
    length = min(n // 4, len(elsewhere))
    start = int(rng.integers(0, len(elsewhere) - length + 1))
    away = elsewhere.take(np.arange(start, start + length))
    return {
        WHOLE: whole,
        CUT: cut,
        DETOUR: with_detour(pair, away, int(rng.integers(parts, n)), parts),
        CARRIED: carried_off(pair, n // 3, 2 * n // 3, parts),
        BACKWARDS: spliced(whole, np.arange(len(whole.counted))[::-1]),
        ANOTHER: of_another_route(pair, elsewhere, parts),
    }


def of_another_route(pair: MappedPair, elsewhere: Descriptors, parts: int = 1) -> MappedPair:
    """Return the map of a pair with a drive of another route, of so many parts in a window."""
    nowhere = np.zeros((len(pair.reference), len(elsewhere)), dtype=np.bool_)
    judged = np.ones(len(elsewhere), dtype=np.bool_)
    away = MappedPair(pair.reference, elsewhere, GroundTruth(nowhere, judged, ANOTHER))
    return spliced(away, np.arange(len(elsewhere)), parts)


# Learn the tables.


#: Versions that each table is learnt from. Smoothing continues a path over the edge of the map, and
#: is hardly ever wrong on a drive along it: with such drives, the promise of a precision would fail
#: for those that leave the map.
LEARNT_FROM: Mapping[str, tuple[str, ...]] = {
    LIVE: (WHOLE, CUT, DETOUR, CARRIED, BACKWARDS, ANOTHER),
    SMOOTHED: (CUT, DETOUR, BACKWARDS, ANOTHER),
    LIVE_ON_MAP: (WHOLE,),
}


def learn(seeds: int, folder: Path, on_start: Callable[[str], None]) -> None:
    """Learn the tables on simulated streets, and write them in the package's format, atomically.

    Places are at whole windows: these tables hold for places at half windows too, and not the other
    way round.
    """
    streets = []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        on_start(f"street {seed - FIRST_SEED + 1} of {seeds}")
        streets.append(samples_of(seed))
    write_tables(streets, folder)


def samples_of(seed: int) -> dict[str, Sample]:
    """Return the matches of all drives of a street, for each table."""
    rng = np.random.default_rng((_CUTS, seed))
    samples: dict[str, list[Sample]] = {name: [] for name in LEARNT_FROM}
    for pair, elsewhere in driven(open_street(seed), drive_elsewhere(seed), places_per_window=1):
        for version, changed in versions_of(pair, elsewhere, rng).items():
            matched = {
                matching: sample(changed.with_settings(changes))
                for matching, changes in MATCHINGS.items()
            }
            matched[LIVE_ON_MAP] = matched[LIVE]
            for name, versions in LEARNT_FROM.items():
                if version in versions:
                    samples[name].append(matched[name])
    return {name: joined(some) for name, some in samples.items()}


def drive_elsewhere(seed: int) -> SimulatedRecording:
    """Simulate a drive of the street before, which is another one."""
    _, query = simulate_pair(seed - 1)
    return second_drive(query, QUERIES[_ELSEWHERE])


def write_tables(streets: Sequence[dict[str, Sample]], folder: Path) -> None:
    """Write the tables that are learnt from the matches of some streets."""
    seeds = len(streets)
    samples = {name: joined([street[name] for street in streets]) for name in streets[0]}
    made = {
        "made_by": f"python -m lab calibration --seeds {seeds} --table DIR",
        "version": __version__,
        "street_seeds": [FIRST_SEED, FIRST_SEED + seeds - 1],
        TABLES: {name: _table(samples[name]) for name in MATCHINGS},
        LIVE_ON_MAP: _table(samples[LIVE_ON_MAP]),
    }
    with replacing(folder / DEFAULT_TABLES) as temporary:
        temporary.write_text(json.dumps(made, allow_nan=False) + "\n", encoding="utf-8")


def _table(learnt: Sample) -> dict[str, object]:
    """Return what the file holds of the table that is learnt from these matches."""
    confidence = learn_confidence(learnt.trust, learnt.correct)
    return {
        "right": round(float(learnt.correct.mean()), 4),
        "off_map": round(float(1 - learnt.has_place.mean()), 4),
        "trust": confidence.trust.tolist(),
        "probability": [round(p, 6) for p in confidence.probability.tolist()],
        "matches": confidence.matches.tolist(),
    }


# Evaluate the shipped tables.


def unseen_street(seed: int) -> dict[str, list[MappedPair]]:
    """Open the versions of all drives of a street that no table was learnt from."""
    street_seed = FIRST_UNSEEN + seed
    rng = np.random.default_rng((_CUTS, street_seed))
    versions_by_name: dict[str, list[MappedPair]] = {}
    for pair, elsewhere in driven(open_street(street_seed), drive_elsewhere(street_seed), PARTS):
        versions = versions_of(pair, elsewhere, rng, PARTS)
        for name, version in (versions | scrambled(versions[WHOLE], rng)).items():
            versions_by_name.setdefault(name, []).append(version)
    return versions_by_name


def measure(draw: Draw) -> Iterator[Row]:
    """Evaluate every table on all drives of one street."""
    yield from evaluate_tables(draw.pair, list(MATCHINGS), (LIVE,), LEARNT_FROM[LIVE])


EXPERIMENT = Experiment(
    drives=lambda data: [Drives("simulated streets", unseen_street, varied=True)],
    names=NAMES,
    measure=measure,
    view=VIEW,
    reads_data=False,
)
