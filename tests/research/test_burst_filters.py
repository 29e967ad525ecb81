"""The experiment that says what a causal burst filter costs."""

from __future__ import annotations

import dataclasses

import numpy as np
from edge_vpr_tools.research.experiments.burst_filters import FILTERS, Flashed, matched
from streams import Drive, random_events

from edge_vpr.descriptors.counting import cleaned
from edge_vpr.events import Sensor
from edge_vpr.online.localiser import Localiser, MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings

SENSOR = Sensor(24, 18)
SETTINGS = Settings(pixels=10, sigma=1.0, tau_us=50_000, sequence_length=2)


def drives():
    rng = np.random.default_rng(0)
    return [Drive(random_events(rng, 20_000, SENSOR, 2_000_000), SENSOR) for _ in range(2)]


def test_flashes_are_added_in_the_order_of_time_and_take_no_event_away():
    query = drives()[1]
    plain = np.concatenate(list(query))
    flashed = np.concatenate(list(Flashed(query, 10.0, seed=3)))
    assert (np.diff(flashed["t"]) >= 0).all()
    assert flashed.size > plain.size + 1_000
    assert set(plain.tolist()) <= set(flashed.tolist())
    assert np.concatenate(list(Flashed(query, 0.0, seed=3))).tobytes() == plain.tobytes()


def test_each_filter_matches_and_the_exact_one_as_a_recording_is():
    walked, query = drives()
    reference = ReferenceMap.build(walked, SETTINGS)
    flashed = Flashed(query, 10.0, seed=3)
    found = {name: matched(reference, flashed, name) for name in FILTERS}
    localiser = Localiser(reference, every=MatchSchedule.window(SETTINGS))
    rows = np.concatenate([localiser.update(part) for part in cleaned(flashed, SETTINGS)])
    assert found["exact"].place.tolist() == rows["place"].tolist()
    assert found["exact"].distance.tolist() == rows["distance"].tolist()
    sums = [each.distance_sum.tolist() for each in found.values()]
    assert len(set(map(tuple, sums))) == 3  # each counts other events
    without = dataclasses.replace(SETTINGS, remove_bursts=False)
    kept = Localiser(reference, every=MatchSchedule.window(SETTINGS))
    rows = np.concatenate([kept.update(part) for part in cleaned(flashed, without)])
    assert found["none"].distance.tolist() == rows["distance"].tolist()
