"""The filter over place and gain: equal to the specification, live, with odometry, and smoothed."""

from __future__ import annotations

import numpy as np
import pytest

from edge_vpr.matching.filter_match import MISFIT, PLACE, TRUST
from edge_vpr.matching.place_filter import PATIENCE, PATIENCE_SMOOTHED, PlaceFilter
from edge_vpr.matching.prediction import TransitionCosts, Transitions
from edge_vpr.matching.smoothing import BackwardPass
from firmware_model import specification_drive as spec
from firmware_model.specification import activity_of, gains_of, is_pause, mean_activity_after
from fixedpoint.activity import BANK_COSTS, SUMS, bank_costs

PIXELS = 9


def drawn_map(rng, per_window, jumps=(), gains=7):
    """Return a map of random codes, its constants, and the filter with these."""
    places = int(rng.integers(2, 40))
    codes = rng.integers(0, 8, (places, PIXELS))
    activity = rng.integers(-40, 30, places).astype(np.int32)
    along = np.cumsum(rng.integers(0, 3_000, places)).astype(np.int64)
    along[-1] += 1_000
    typical = np.array(spec.typical_distances(codes.tolist()), dtype=np.int64)
    mean, restart, exclusion = int(rng.integers(1, 60_000)), int(rng.integers(1, 31)), 3
    kept = [pair for pair in jumps if max(pair) < places]
    known = spec.DriveMap.of(
        activity.tolist(), typical.tolist(), mean, per_window, restart << 2, exclusion,
        along.tolist(), kept, gains_of(gains),
    )  # fmt: skip
    transitions = Transitions(
        places, TransitionCosts(restart, per_window, gains=gains), activity,
        np.array(kept, dtype=np.int32).reshape(-1, 2), along, typical, exclusion,
    )  # fmt: skip
    return known, transitions


def drawn_drive(rng, known, windows):
    """Return distances of sums, and events: near the mean, few, none, or many."""
    places = len(known.typical)
    distances = rng.integers(0, 7 * PIXELS, (windows, len(SUMS), places))
    true = np.cumsum(rng.integers(0, 3, windows)) % places
    distances[np.arange(windows), :, true] //= 6
    octaves = rng.normal(0, 1.5, windows) - 5 * (rng.random(windows) < 0.3)
    events = ((known.mean_activity >> 8) * 2.0**octaves).astype(np.int64)
    events[rng.random(windows) < 0.1] = 0
    return distances, events


def specified(known, distances, events, patience, driven):
    """Run the specification over a drive whose distances count as they are."""
    state, mean, windows = known.begin(), known.mean_activity, []
    for row, counted, mm in zip(distances.tolist(), events.tolist(), driven, strict=True):
        of_mean = known.mean_activity if len(known.filter.gains) > 1 else mean
        window = spec.advance_window(
            known, state, activity_of(counted, of_mean), is_pause(counted, mean), row,
            patience=patience, driven=mm, driven_whole=mm or 0,
        )  # fmt: skip
        state, mean = window.advanced.state, mean_activity_after(mean, counted)
        windows.append(window)
    return spec.live_matches(windows), windows


def run(bank, distances, events, driven):
    """Run the kernel over a drive, window by window, and return the rows."""
    found = []
    for row, counted, mm in zip(distances, events, driven, strict=True):
        if mm is not None:
            bank.predict_travelled(mm, mm)
        found.append(bank.update_windows(row[None, : bank.sums], np.array([counted])))
    return type(found[0])(*(np.concatenate(column) for column in zip(*found, strict=True)))


@pytest.mark.parametrize("per_window", [1, 2])
@pytest.mark.parametrize("odometry", [False, True])
@pytest.mark.parametrize("gains", [1, 7])
@pytest.mark.parametrize("seed", range(4))
def test_kernel_equals_the_specification_live_and_smoothed(per_window, odometry, gains, seed):
    rng = np.random.default_rng((per_window, odometry, seed))
    jumps = [(3, 1), (7, 2)] if seed % 2 else []
    known, transitions = drawn_map(rng, per_window, jumps, gains)
    windows = 40
    distances, events = drawn_drive(rng, known, windows)
    driven = [int(mm) if odometry and rng.random() < 0.6 else None
              for mm in rng.integers(-500, 4_000, windows)]  # fmt: skip
    driven[0] = None  # no window is before it
    for patience in (PATIENCE, PATIENCE_SMOOTHED):
        matches, specified_windows = specified(known, distances, events, patience, driven)
        bank = PlaceFilter(transitions, known.mean_activity, patience)
        rows = run(bank, distances, events, driven)
        told = [
            [m.place, m.sum, -1 if m.second is None else m.second,
             -1 if m.second_sum is None else m.second_sum, m.ties, m.trust]
            for m in matches
        ]  # fmt: skip
        assert rows.columns[:, :MISFIT].tolist() == told
        of_windows = [
            spec.misfit_of(w, one.gain, one.place, known.typical[one.place])
            for w in specified_windows
            for one in [w.advanced.best]
        ]
        assert rows.columns[:, MISFIT].tolist() == spec.running_misfits(of_windows)
    residual = np.empty(windows, dtype=np.int64)
    BackwardPass(transitions).add_to(rows, driven, residual)
    smoothed = spec.smoothed(known, specified_windows)
    assert rows.best.tolist() == [[one.place, one.gain] for one, _ in smoothed]
    assert rows.columns[:, PLACE].tolist() == [one.told for one, _ in smoothed]
    assert rows.least.tolist() == [
        [min(column) for column in zip(*whole, strict=True)] for _, whole in smoothed
    ]
    against = [w.evidence(one.gain)[one.place] for w, (one, _) in
               zip(specified_windows, smoothed, strict=True)]  # fmt: skip
    assert residual.tolist() == against


def test_windows_together_or_one_by_one_are_equal():
    rng = np.random.default_rng(3)
    known, transitions = drawn_map(rng, 2)
    distances, events = drawn_drive(rng, known, 30)
    one = PlaceFilter(transitions, known.mean_activity)
    many = PlaceFilter(transitions, known.mean_activity)
    rows = run(one, distances, events, [None] * 30)
    together = many.update_windows(distances, events)
    assert np.array_equal(rows.columns, together.columns)
    assert np.array_equal(rows.metrics, together.metrics)
    for mine, other in zip(one.to_arrays().values(), many.to_arrays().values(), strict=True):
        assert np.array_equal(mine, other)


@pytest.mark.parametrize("per_window", [1, 2])
def test_costs_follow_from_the_shares(per_window):
    assert bank_costs(per_window).tolist() == [list(row) for row in BANK_COSTS[per_window]]


def test_trust_is_never_negative_and_begins_at_nothing():
    rng = np.random.default_rng(5)
    known, transitions = drawn_map(rng, 1)
    rows = PlaceFilter(transitions, known.mean_activity).update_windows(
        *drawn_drive(rng, known, 50)
    )
    assert rows.columns[0, TRUST] == 0
    assert (rows.columns[:, TRUST] >= 0).all()
