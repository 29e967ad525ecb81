"""The experiments on rivals and on a moved mounting, on small drives."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from edge_vpr_tools.research.baselines import baseline_names
from edge_vpr_tools.research.experiments import (
    agreement,
    event_speed,
    mount_shift,
    pixel_number,
    rivals,
    window_length,
)
from edge_vpr_tools.research.experiments import (
    drives as counted_pairs,
)
from edge_vpr_tools.research.experiments.drives import Pair
from edge_vpr_tools.research.experiments.mount_shift import ShiftedWindows, shifted

from edge_vpr.evaluation.ground_truth import from_alignment
from edge_vpr.evaluation.metrics import mean_precision, precision_recall
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import CAMERAS, simulate_pair

TAU = 1_000_000
SETTINGS = PRESETS["paper"].replaced({"sequence_length": 2, "sigma": 2.0, "pixels": 150}, "test")


def truth_of(places_us, queries_us):
    ends = np.array([[0.0, 0.0], [100.0, 100.0]])
    return from_alignment(ends, queries_us / TAU, places_us / TAU, 1.0, "s")


def drives(windows=20):
    """The same drive twice, the second with a tenth of its events gone."""
    rng = np.random.default_rng(0)
    rough = rng.gamma(0.6, 6.0, (windows, 24, 24))
    images = rng.poisson(rough.repeat(4, axis=1).repeat(4, axis=2)).astype(np.uint16)
    return images, rng.binomial(images, 0.9).astype(np.uint16)


@pytest.mark.slow
def test_rivals_are_compared_and_set_as_a_table_and_a_figure(monkeypatch, tmp_path):
    pair = counted_pairs.count_pair(
        "drives", *(ShiftedWindows(images, TAU) for images in drives()), SETTINGS, truth_of
    )
    assert np.array_equal(pair.reference.centre_us, np.arange(20) * TAU + TAU // 2)
    monkeypatch.setattr(counted_pairs, "recorded_pairs", lambda data: iter([pair]))
    monkeypatch.setattr(counted_pairs, "simulated_pair", lambda seed: pair)
    started = []
    figures = (tmp_path / "figure.png", tmp_path / "figure.pdf")
    text = rivals.run(tmp_path, 2, started.append, *figures, baselines=["all-pixels@1,3"])
    for figure in ("figure.png", "figure_time.png", "figure_curves.png"):
        assert (tmp_path / figure).stat().st_size > 10_000
    assert (tmp_path / "figure_curves.pdf").is_file()
    assert started[0] == "street 1 of 2" and len(started) == 4
    assert text.count("all pixels, SAD | 1.000") == 2
    assert text.count("| all pixels, SAD, windows 1, 3 | 1.000") == 2
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    assert len(lines) == 2 * (3 + len(baseline_names()))
    assert "| 9,216 | 184,320 |" in text  # bytes of 96 x 96 pixels, and differences to 20 places
    assert "| describing | matching | time a query |" in lines[0]
    for line in lines[2 : 2 + len(baseline_names())]:
        describing, matching, both = (
            float(cell.replace(",", "").removesuffix(" us ")) for cell in line.split("|")[-4:-1]
        )
        # medians of the trials, which need not be of the same one
        assert both >= max(describing, matching) > 0, line


def test_a_simulated_street_is_counted_by_events():
    pair = counted_pairs.simulated_pair(1, length_m=20, sensor="tiny")
    totals = pair.reference.images.sum(axis=(1, 2))
    assert len(pair.reference.images) >= 2 and len(pair.query.images) >= 2
    # hot pixels were taken out after the windows were counted
    assert totals.min() > 0.5 * totals.max()
    found = rivals.compare_all(
        counted_pairs.CountedPair("tiny", pair.reference, pair.query,
                           pair.settings.replaced({"sequence_length": 1}, "test"), pair.truth_of),
        0, ["all-pixels", "active-pixels"],
    )  # fmt: skip
    assert set(found) == {"all-pixels", "active-pixels"}


def test_a_curve_of_trials_is_the_mean_of_their_precision():
    """One trial is right in all matches, the other's surest of two is wrong; one finds nothing."""
    right = np.array([True, True])
    curves = [
        precision_recall(np.array([0.1, 0.2]), correct, right)
        for correct in (right, np.array([False, True]), ~right)
    ]
    found = mean_precision(curves, np.array([0.0, 0.5, 1.0]))
    # at recall 0 the strictest threshold: 1, 0 and 0; then 1, 1/2 and never
    assert found == pytest.approx([1 / 3, 0.5, 0.5])


def test_a_system_that_does_not_fit_a_sensor_is_said_to(monkeypatch, tmp_path):
    """The released code draws 100 pixels, each 7 pixels apart."""
    images = [ShiftedWindows(drive[:, :32, :32], TAU) for drive in drives()]
    pair = counted_pairs.count_pair("drives", *images, SETTINGS, truth_of)
    monkeypatch.setattr(counted_pairs, "simulated_pair", lambda seed: pair)
    text = rivals.run(None, 1, lambda name: None)
    assert "released code: 100 pixels, clipped at 10, SAD | does not fit |" in text
    assert "| all pixels, SAD | 1.000 |" in text


def test_an_image_is_shifted_and_what_leaves_is_lost():
    image = np.arange(12).reshape(3, 4)
    moved = shifted(image, 1, -2)
    assert moved.tolist() == [[0, 8, 9, 10], [0, 0, 0, 0], [0, 0, 0, 0]]
    assert np.array_equal(shifted(image, 0, 0), image)


def test_the_mount_shift_is_undone_and_drawn(monkeypatch, tmp_path):
    reference, query = (ShiftedWindows(images, TAU) for images in drives())
    pair = Pair("drives", reference, query, SETTINGS, truth_of)
    monkeypatch.setattr(mount_shift, "pairs", lambda data: iter([pair]))
    monkeypatch.setattr(mount_shift, "SHIFTS", (0, 4))
    text = mount_shift.run(tmp_path, 1, lambda name: None, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
    assert "| counts, registered | 1.000 | 1.000 |" in text
    # the places of the drives are patterns of 4 x 4 pixels: a shift by 4 shows other pixels
    every = next(line for line in text.splitlines() if line.startswith("| all pixels, counts"))
    same, moved = (float(cell) for cell in every.split("|")[2:4])
    assert same == 1 > moved and "| all pixels, 3-bit logarithms | 1.000 |" in text
    assert "off by at most" in text


def test_the_number_of_pixels_is_varied_and_what_does_not_fit_is_left_out(monkeypatch, tmp_path):
    pair = counted_pairs.count_pair(
        "drives", *(ShiftedWindows(images, TAU) for images in drives()), SETTINGS, truth_of
    )
    monkeypatch.setattr(counted_pairs, "recorded_pairs", lambda data: iter([pair]))
    monkeypatch.setattr(counted_pairs, "simulated_pair", lambda seed: pair)
    monkeypatch.setattr(pixel_number, "NUMBERS", (5, 150))
    text = pixel_number.run(tmp_path, 1, lambda name: None, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
    released = next(line for line in text.splitlines() if line.startswith("| mean"))
    assert released.endswith("| - |")  # 150 circles of 7 pixels do not fit
    assert "| variance |" in text and "| all pixels |  | 1.000 |" in text


def test_few_pixels_are_compared_with_all(monkeypatch, tmp_path):
    pair = counted_pairs.count_pair(
        "drives", *(ShiftedWindows(images, TAU) for images in drives()), SETTINGS, truth_of
    )
    monkeypatch.setattr(agreement, "recorded_pairs", lambda data: iter([pair]))
    monkeypatch.setattr(agreement, "NUMBERS", (25, 150))
    monkeypatch.setattr(agreement, "street", partial(agreement.street, length_m=40, sensor="tiny"))
    text = agreement.run(tmp_path, 2, lambda name: None, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
    streets, recorded = text.split("drives:")
    assert "| distances, by variance |" in streets
    # the pixels stand for blocks of 4 x 4, so that every match is the same
    assert "| same place, by variance | 1.000 ± 0.000 | 1.000 ± 0.000 |" in recorded


def test_all_pixels_agree_with_themselves_and_not_with_noise():
    images, _ = drives(12)
    rng = np.random.default_rng(1)
    noise = rng.permutation(images.ravel()).reshape(images.shape)
    every = images.mean(axis=(1, 2))
    assert agreement.correlation(every, 3 * every + 1) == pytest.approx(1)
    assert agreement.correlation(every, -every) == pytest.approx(-1)
    assert agreement.correlation(every, np.ones(12)) == 0
    found = agreement.correlation(images.astype(float), noise.astype(float))
    assert found == pytest.approx(np.corrcoef(images.ravel(), noise.ravel())[0, 1])


def test_what_fires_by_the_clock_makes_fewer_events_in_a_faster_drive():
    """With much noise, four times the speed makes fewer events; without any, it does not."""
    noisy = replace(CAMERAS["tiny"], noise_hz=20.0)
    quiet = replace(noisy, noise_hz=0.0, hot_pixels=0, bursts_per_minute=0.0)
    still = {"traffic_per_km": 0.0, "shake_px": 0.0}
    slow, fast = (event_speed.events_of(noisy, still, v, 1, 20.0) for v in (3.0, 12.0))
    assert fast < 0.6 * slow
    slow, fast = (event_speed.events_of(quiet, still, v, 1, 20.0) for v in (3.0, 12.0))
    assert fast > 0.9 * slow
    text = event_speed.table({"tiny": event_speed.events_at_speeds(quiet, still, 1, 20.0)})
    assert "| tiny |" in text and "share at 12 m/s" in text


def test_windows_and_sequences_of_equal_time_are_compared(monkeypatch, tmp_path):
    tried = window_length.variant(0.5, 8.0).changes
    assert tried == {"tau_us": 500_000, "sequence_length": 16, "exclusion": 6}
    short = partial(simulate_pair, sensor="tiny", length_m=80.0)
    monkeypatch.setattr(window_length, "simulate_pair", short)
    monkeypatch.setattr(window_length, "WINDOWS_S", (0.5, 1.0))
    monkeypatch.setattr(window_length, "SPANS_S", (2.0,))
    few = PRESETS["paper"].replaced({"pixels": 25}, "test")
    monkeypatch.setattr(window_length, "PRESETS", {"paper": few})
    text = window_length.run(None, 1, lambda name: None, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
    assert "| 0.5 s |" in text and "| window | 2 s a match |" in text
