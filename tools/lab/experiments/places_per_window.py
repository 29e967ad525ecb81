"""Places at half windows against places at whole windows, with twice the memory and with the same.

The costs of half steps were chosen on simulated streets of the seeds 20 to 26 (with the small
sensor). The streets and the walks here chose only that places are at half windows by default. Maps
of published windows, as of the other recorded drives, cannot have such places.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from edge_vpr.descriptors.counting import count_windows
from edge_vpr.evaluation.calibration import reliability
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from lab.drives import FIRST_SEED, LENGTH_M, WALKS, street_pairs, walks
from lab.loop import Draw, Drives, Experiment, Row
from lab.nulls import null_queries
from lab.pairs import MappedPair, Pair, truths_of_tracks
from lab.spliced import carried_off, without_places
from lab.tables import TableView

TOLERANCES_M = (10.0, 20.0)
#: twice as many places of half as many pixels take as many bytes
PIXELS = (12, 25, 75, 150)
PRECISION = 0.99
WHOLE, CUT, CARRIED = "whole", "a quarter cut out", "carried off"
_NUMBER = "places per window"
LIGHTS: Mapping[str, str] = {
    "in other light": "street",
    "with 3 stops": "street, 3 stops",
    "in low sun": "street, low sun",
    "at noon": "street, noon",
}
MATCHED: Mapping[str, Mapping[str, Any]] = {"live": {"smooth": False}, "recorded": {}}


def open_street(seed: int) -> list[Pair]:
    """Simulate the drives of one street, with odometers on their wheels."""
    pairs = []
    for pair in street_pairs(FIRST_SEED + seed, LIGHTS, length_m=LENGTH_M):
        assert pair.tracks is not None
        pairs.append(replace(pair, truths=truths_of_tracks(*pair.tracks, *TOLERANCES_M)))
    return pairs


def recorded(pair: Pair) -> list[Pair]:
    """Return the walks; their truth is known to a second, so that both tolerances are 2 s."""
    truths = {"near": pair.truth_of, "wide": pair.truth_of}
    return [replace(pair, drives="as recorded", truths=truths)]


def measure(draw: Draw) -> Iterator[Row]:
    """Match whole drives, and drives that leave the map, with both maps, live and recorded."""
    pairs: list[Pair] = draw.pair
    reference = pairs[0].reference  # that of all
    for pixels in PIXELS:
        settings = PRESETS["default"].replaced({"pixels": pixels, "seed": draw.seed}, "half")
        whole = ReferenceMap.build(reference, settings, places_per_window=1)
        half = ReferenceMap.build(
            reference, settings, pixel_map=whole.pixel_map, places_per_window=2
        )
        for pair in pairs:
            counted = count_windows(pair.query, whole.pixel_map, settings)
            nulls = dict(null_queries(counted, np.random.default_rng(draw.seed)))
            shown = {WHOLE: counted, **{name: nulls[name] for name in NULLS}}
            for number, mapped in ((1, whole), (2, half)):
                truths = [
                    truth_of(mapped.places.centre_us, counted.centre_us)
                    for truth_of in pair.truths.values()
                ]
                row = {"pixels": pixels, "query": pair.drives, _NUMBER: number}
                for (matched, changes), (name, seen) in product(MATCHED.items(), shown.items()):
                    named = {**row, "matched": matched, "odometry": "none"}
                    drive = MappedPair(mapped, seen, truths[-1]).with_settings(changes)
                    yield {**named, "drive": name, **_figures(drive, drive.match(), truths)}
                    parts = _left_map(drive, number) if name == WHOLE else {}
                    for part_name, part in parts.items():
                        figures = _figures(part, part.match(), [part.truth])
                        yield {**named, "drive": part_name, **figures}
                    if pair.odometry is not None:
                        of_map, of_query = pair.odometry
                        along_mm = of_map.along(mapped.places.centre_us)
                        metred = replace(drive.reference, odometer_mm=along_mm)
                        metred_matches = replace(drive, reference=metred).match(of_query)
                        figures = _figures(drive, metred_matches, truths)
                        yield {**named, "odometry": "wheels", "drive": name, **figures}


def _left_map(drive: MappedPair, number: int) -> dict[str, MappedPair]:
    """Return the drive with the third quarter cut out of the map, and carried off."""
    places, windows = len(drive.reference) // number, len(drive.counted)
    cut = without_places(drive, number * (places // 2), number * (3 * places // 4))
    return {CUT: cut, CARRIED: carried_off(drive, windows // 3, 2 * windows // 3)}


#: null queries: correct matches come from the assumptions of the filter and from odometry alone
NULLS = ("null: windows shuffled", "null: query reversed")


def _figures(drive: MappedPair, matches: Matches, truths: Sequence[GroundTruth]) -> Row:
    """Return the figures of a drive; those of probabilities, and "wide", are by the last truth."""
    reference, judged = drive.reference, truths[-1].has_truth
    wide = truths[-1].correct[matches.place, matches.query]
    confidence = reference.acceptance.confidence
    assert confidence is not None
    accepted = judged & (matches.net_trust >= confidence.least_trust(PRECISION))
    place_bytes = reference.packed_bytes_per_place
    error = reliability(matches.probability[judged], wide[judged]).expected_calibration_error
    row = {
        "P@100R": None,
        "P@100R (wide)": float(wide[judged].mean()),
        "R@99P (wide)": None,
        "mean probability": float(matches.probability[judged].mean()),
        "calibration error": error,
        "windows": int(judged.sum()),
        "share accepted at 0.99": float(accepted.sum() / max(judged.sum(), 1)),
        "accepted at 0.99": int(accepted.sum()),
        "accepted and correct": int((accepted & wide).sum()),
        "places": len(reference),
        "bytes per window": reference.settings.window_parts * place_bytes,
        "bytes of the places": len(reference) * place_bytes,
        "differences per window": reference.places.counts.size,
    }
    if len(truths) > 1:  # of a whole drive
        near, far = (evaluate(matches, truth) for truth in truths)
        row["P@100R"] = near.precision_at_100_recall
        row["R@99P (wide)"] = far.recall_at_99_precision
    return row


def drives(data: Path | None) -> list[Drives]:
    """Return streets, and the walks of a folder."""
    routes = [Drives(f"streets of {LENGTH_M:g} m", open_street, varied=True)]
    if data is not None and (data / WALKS).is_dir():
        walked = walks(data)
        routes.append(replace(walked, open=lambda seed: recorded(walked.open(seed))))
    return routes


EXPERIMENT = Experiment(
    drives=drives,
    names=("pixels", "query", "drive", "odometry", "matched", _NUMBER),
    measure=measure,
    view=TableView(
        {"matched": "live", "odometry": "none", "drive": WHOLE},
        ("pixels", "query", "P@100R"),
        _NUMBER,
    ),
)
