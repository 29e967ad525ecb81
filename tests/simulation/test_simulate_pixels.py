"""The simulated pixel: against plain Python, and its noise."""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor, check_events, join_events
from edge_vpr.simulation import CAMERAS, Camera, PixelArray
from edge_vpr.simulation.view import Noise
from tests import naive

LIGHT = st.floats(0.015625, 64.0, width=32)


def by_pixel(events):
    events_of = defaultdict(list)
    for t, x, y, p in events.tolist():
        events_of[x, y].append((t, p))
    return events_of


@given(st.data())
def test_every_pixel_fires_as_plain_python_says(data):
    """Times and polarities are equal to the bit, however often the events are taken out."""
    sensor = Sensor(3, 2)
    n = data.draw(st.integers(2, 12))
    light = np.array(
        data.draw(st.lists(st.lists(LIGHT, min_size=6, max_size=6), min_size=n, max_size=n)),
        np.float32,
    )
    gaps = data.draw(st.lists(st.integers(0, 5000), min_size=n, max_size=n))
    times = np.cumsum(gaps).tolist()
    on, off = (np.array(data.draw(st.lists(st.floats(0.02, 2), min_size=6, max_size=6)))
               for _ in range(2))  # fmt: skip
    refractory = data.draw(st.integers(0, 3000))
    taken = data.draw(st.sets(st.integers(0, n - 1)))

    pixels = PixelArray(sensor, on, off, refractory)
    parts = []
    for k in range(n):
        pixels.step(light[k], times[k])
        if k in taken:
            parts.append(pixels.take())
    events = join_events([*parts, pixels.take()])

    check_events(events, sensor)
    simulated = by_pixel(events)
    for i in range(sensor.pixels):
        expected = naive.pixel_events(
            light[:, i].tolist(), times, float(on[i]), float(off[i]), refractory
        )
        assert simulated[i % 3, i // 3] == expected


def test_a_doubling_of_light_makes_as_many_events_as_thresholds_fit_into_it():
    """ln 2 = 0.693: three thresholds of 0.2, at 29, 58 and 87 % of the way."""
    pixels = PixelArray(Sensor(1, 1), np.array([0.2]), np.array([0.2]), 0)
    pixels.step(np.array([1.0], np.float32), 0)
    pixels.step(np.array([2.0], np.float32), 1_000_000)
    events = pixels.take()
    assert events["t"].tolist() == [int(1e6 * k * 0.2 / math.log(2)) for k in (1, 2, 3)]
    assert events["p"].all()


@pytest.mark.parametrize(
    ("light", "time_us", "message"),
    [
        (np.ones(5, np.float32), 10, "give 6 values"),
        (np.array([1, 1, 1, 0, 1, 1], np.float32), 10, "no logarithm"),
        (np.array([1, 1, 1, np.nan, 1, 1], np.float32), 10, "no logarithm"),
        (np.ones(6, np.float32), -1, "time runs backwards"),
    ],
)
def test_light_that_no_pixel_can_take_is_refused(light, time_us, message):
    pixels = PixelArray(Sensor(3, 2), np.full(6, 0.2), np.full(6, 0.2), 0)
    pixels.step(np.ones(6, np.float32), 0)
    with pytest.raises(UsageError, match=message):
        pixels.step(light, time_us)


def test_thresholds_spread_from_pixel_to_pixel_and_belong_to_the_device():
    camera = CAMERAS["default"]
    on, off = camera.thresholds(3)
    assert np.array_equal(on, camera.thresholds(3)[0])
    assert not np.array_equal(on, camera.thresholds(4)[0])
    assert not np.array_equal(on, off)
    for thresholds in (on, off):
        assert thresholds.min() > 0
        assert abs(thresholds.mean() - 0.25) < 0.002
        assert abs(thresholds.std() - 0.03) < 0.002


def noise_of(camera, duration_us=20_000_000):
    stretch_us = 100_000
    noise = Noise(camera, seed=5, device=2, duration_us=duration_us)
    stretches = [
        noise.between(number, start, start + stretch_us)
        for number, start in enumerate(range(0, duration_us, stretch_us))
    ]
    for number, (times, _, _) in enumerate(stretches):
        assert ((times >= number * stretch_us) & (times < (number + 1) * stretch_us)).all()
    return noise, *(np.concatenate(column) for column in zip(*stretches, strict=True))


def test_background_noise_has_its_rate_everywhere_and_hot_pixels_stand_out():
    """Counts are Poisson: mean and variance agree; the hot pixels are those of the device."""
    camera = Camera(noise_hz=0.5, hot_pixels=5, hot_hz=300, bursts_per_minute=0)
    _, _, pixels, polarities = noise_of(camera)
    counts = np.bincount(pixels, minlength=camera.sensor.pixels)
    hot = camera.noise_rates(2) > 1
    assert hot.sum() == 5
    assert counts[hot].min() > 20 * counts[~hot].max()
    expected = 20 * camera.noise_rates(2)[hot]
    assert (np.abs(counts[hot] - expected) < 5 * np.sqrt(expected)).all()
    assert abs(counts[~hot].mean() - 10) < 0.15
    assert abs(counts[~hot].var() - 10) < 0.6
    assert abs(polarities.mean() - 0.5) < 0.01


def test_in_a_burst_most_pixels_fire_within_milliseconds():
    camera = Camera(noise_hz=0, hot_pixels=0, bursts_per_minute=30)
    noise, times, pixels, _ = noise_of(camera)
    assert 3 <= noise.burst_us.size <= 20
    for start in noise.burst_us:
        inside = (times >= start) & (times <= start + camera.burst_us)
        share = np.unique(pixels[inside]).size / camera.sensor.pixels
        assert share > 0.75
    assert times.size < 0.9 * noise.burst_us.size * camera.sensor.pixels


def test_a_camera_without_noise_makes_none():
    camera = Camera(noise_hz=0, hot_pixels=0, bursts_per_minute=0)
    _, times, pixels, polarities = noise_of(camera, duration_us=1_000_000)
    assert times.size == pixels.size == polarities.size == 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"contrast_on": 0.0},
        {"contrast_off": -0.2},
        {"field_of_view_deg": 180},
        {"hot_pixels": 1 << 20},
        {"burst_share": 1.5},
        {"noise_hz": -1},
        {"refractory_us": -1},
    ],
)
def test_an_impossible_camera_is_refused_with_the_value(wrong):
    ((name, value),) = wrong.items()
    with pytest.raises(UsageError, match=f"{name} is {value}"):
        Camera(**wrong)
