"""Errors of positions are those of known places."""

from __future__ import annotations

import numpy as np
import pytest
from lab.experiments import position

from edge_vpr.evaluation.tracks import Track, with_positions
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair


def test_a_position_is_compared_with_the_track_at_the_end_of_its_window():
    """At 1 m/s, the middle of a window of 1 s is 0.5 m behind its end, and is led by that."""
    reference, _ = simulate_pair(0, "tiny", length_m=40.0)
    time_us = np.arange(61) * 1_000_000
    track = Track(time_us, time_us[:, None] / 1e6)
    mapped = with_positions(ReferenceMap.build(reference, pixels=20), track)
    end_s = np.arange(1, len(mapped) // 2)
    place, accepted = 2 * (end_s - 1), end_s != 1
    live = position.Live((end_s - 1) * 1_000_000, end_s * 1_000_000, place, accepted)
    rows = position.positions_of(mapped, live, track)
    for name, error in ((position.OF_PLACE, 0.5), (position.REPORTED, 0.0)):
        assert rows[name]["median error (m)"] == pytest.approx(error, abs=0.01)
        assert rows[name]["accepted at 0.99"] == pytest.approx(1 - 1 / end_s.size)
        assert rows[name]["kilometres"] == pytest.approx((end_s.size - 2) / 1e3)
        assert rows[name]["steps back per km"] == 0
    place[3] = place[2] - 2  # two places of half a window
    rows = position.positions_of(mapped, live, track)
    assert rows[position.OF_PLACE]["steps back"] == 1
    accepted[2] = False
    assert position.positions_of(mapped, live, track)[position.OF_PLACE]["steps back"] == 0
