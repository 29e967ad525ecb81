"""The simulated street and its drives: geometry, light, motion, and the same events every time."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor, check_events, join_events
from edge_vpr.simulation import (
    CAMERAS,
    QUERY,
    REFERENCE,
    Camera,
    Drive,
    Light,
    SimulatedRecording,
    World,
    simulate_pair,
)
from edge_vpr.simulation.drive import drive_motion, frame_times, shake
from edge_vpr.simulation.view import CAMERA_M, Mover, View, cut, illuminate, paint_traffic
from edge_vpr.simulation.world import (
    COLUMN_M,
    FAR_M,
    GROUND_ROW_M,
    NEAR_M,
    NEAR_ROW_M,
    Surface,
    paint,
    park_cars,
)

QUIET = Camera(noise_hz=0, hot_pixels=0, bursts_per_minute=0, contrast_spread=0)
STILL_IMAGE = Drive(shake_px=0, traffic_per_km=0, parked_per_km=0)


def short(seed=3, drive=QUERY, camera=CAMERAS["tiny"], length_m=12, **kwargs):
    return SimulatedRecording(World(length_m=length_m), camera, drive, seed=seed, **kwargs)


def joined(recording):
    return join_events(list(recording))


# ------------------------------------------------------------------ the recording


def test_events_are_those_of_the_sensor_in_time_order_from_the_start():
    for sensor in ("tiny", "default", "speck", "davis346"):
        recording = short(camera=CAMERAS[sensor], length_m=10)
        last = 0
        for events in recording:
            assert events.packed
            check_events(events, recording.sensor, after=last)
            last = int(events["t"][-1])
        assert 0.9 * recording.duration_us < last <= recording.duration_us
        if "NUMBA_DISABLE_JIT" in os.environ:
            break  # without the compiler one camera is enough


def test_the_same_seed_gives_the_same_events():
    """A second iteration, another object, and events kept in memory: all equal."""
    recording = short()
    events = joined(recording)
    assert len(events) > 1000
    assert np.array_equal(joined(recording), events)
    assert all(part.size for part in short())
    kept = short().keep()
    assert np.array_equal(joined(kept), events)
    assert np.array_equal(joined(kept), events)


def test_another_seed_is_another_drive_and_another_device_another_camera():
    events = joined(short())
    assert not np.array_equal(joined(short(seed=4)), events)
    assert not np.array_equal(joined(short(device=1)), events)


def test_the_noise_of_a_camera_is_another_in_each_drive():
    """Two drives alike in motion, seen by pixels that no light can move."""
    camera = Camera(
        sensor=Sensor(16, 16), contrast_on=50, contrast_off=50, noise_hz=5, hot_pixels=0
    )
    drive = replace(STILL_IMAGE, speed_range=1)
    one, other = (joined(short(seed=seed, drive=drive, camera=camera)) for seed in (1, 2))
    assert min(len(one), len(other)) > 1000
    same = min(len(one), len(other))
    assert (one["x"][:same] == other["x"][:same]).mean() < 0.2


@pytest.mark.slow
@pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="compares with the compiled code")
def test_compiled_and_plain_python_make_the_same_events():
    program = (
        "import hashlib, numpy as np\n"
        "from edge_vpr.simulation import *\n"
        "drive = SimulatedRecording(World(length_m=10), CAMERAS['tiny'], QUERY, seed=3)\n"
        "print(hashlib.sha256(np.concatenate(list(drive)).tobytes()).hexdigest())"
    )
    plain = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    events = joined(short(length_m=10))
    assert plain.stdout.strip() == hashlib.sha256(np.asarray(events).tobytes()).hexdigest()


def test_progress_runs_from_nothing_to_all():
    recording = short()
    seen = []
    for _ in recording:
        seen.append(recording.position)
    assert seen == sorted(seen)
    assert 0 < seen[0] < 1
    assert recording.position == 1.0
    assert (recording.format, recording.start_us) == ("simulated", 0)


def test_a_camera_at_rest_in_a_still_street_sees_nothing():
    """Events come from change alone: nothing fires during a halt without noise, shake, traffic."""
    drive = replace(STILL_IMAGE, stops=1, stop_s=3.0)
    recording = short(camera=replace(QUIET, sensor=CAMERAS["tiny"].sensor), drive=drive)
    events = joined(recording)
    time, place = recording.track.time_us, recording.track.position[:, 0]
    begin = time[np.flatnonzero(np.diff(place) == 0)[0]]
    halt = (events["t"] > begin) & (events["t"] < begin + 3_000_000)
    assert not halt.any()
    assert len(events) > 300


def test_the_bonnet_never_fires_by_itself():
    """It moves with the camera, so that neither the way nor the shaking changes its light."""
    recording = short(camera=replace(QUIET, sensor=Sensor(40, 40)))
    events = joined(recording)
    bonnet = recording.view().fixed > 0
    assert 0.05 < bonnet.mean() < 0.3
    assert not bonnet[events["y"], events["x"]].any()


def test_a_pair_shares_the_world_and_the_camera_and_differs_in_the_drive():
    reference, query = simulate_pair(seed=2, sensor="tiny", length_m=60)
    assert reference.world == query.world
    assert reference.device == query.device
    assert reference.seed != query.seed
    assert reference.track.position[-1] == query.track.position[-1] == 60
    other, _ = simulate_pair(seed=1, sensor="tiny", length_m=60)
    assert {other.seed, other.seed + 1}.isdisjoint({reference.seed, query.seed})


# ------------------------------------------------------------------ motion


@pytest.mark.parametrize("seed", range(5))
def test_the_reference_is_nearly_constant_and_the_query_goes_from_half_to_double_speed(seed):
    for drive, slowest, fastest in ((REFERENCE, 0.92, 1.09), (QUERY, 0.5, 2.0)):
        motion = drive_motion(drive, 900, seed)
        speed = np.diff(motion.position_m) / np.diff(motion.time_us) * 1e6 / drive.speed_mps
        assert speed.min() > 0.999 * slowest
        assert speed.max() < 1.001 * fastest
        assert speed.max() / speed.min() > (1.1 if drive is REFERENCE else 2.5)


def test_a_track_goes_from_start_to_end_and_waits_at_its_stops():
    motion = drive_motion(Drive(stops=3, stop_s=7.5), 500, seed=1)
    assert (motion.time_us[0], motion.position_m[0], motion.position_m[-1]) == (0, 0, 500)
    assert (np.diff(motion.time_us) > 0).all()
    assert np.diff(motion.time_us).max() <= 1_000_000  # no gap that a reader would distrust
    still = np.diff(motion.position_m) == 0
    assert (np.diff(motion.position_m) >= 0).all()
    assert np.isclose(np.diff(motion.time_us)[still].sum(), 3 * 7_500_000, atol=100)


def test_the_camera_looks_at_least_every_step_of_way_and_of_time():
    motion = drive_motion(Drive(stops=1), 50, seed=0)
    seen = frame_times(motion, 0.05, 20_000)
    assert (seen.time_us[0], seen.time_us[-1]) == (0, motion.time_us[-1])
    assert np.diff(seen.time_us).min() > 0
    assert np.diff(seen.time_us).max() <= 20_002
    assert np.diff(seen.position_m).max() < 0.0501


def test_shake_stays_within_the_margin_that_the_image_is_cut_from():
    time = np.arange(0, 60_000_000, 10_000)
    shift = shake(Drive(shake_px=0.4), time, seed=0)
    assert np.abs(shift).max() <= 0.8
    assert 0.2 < shift.std() < 0.6
    with pytest.raises(UsageError, match="shake_px is 2"):
        Drive(shake_px=2)


# ------------------------------------------------------------------ what is seen


def empty_scene(length_m=60):
    """A street of white ground under the sky, without walls."""
    scene = paint(World(length_m=length_m))
    nothing = lambda s: Surface(np.zeros_like(s.cover), np.zeros_like(s.cover))  # noqa: E731
    ground = Surface(np.ones_like(scene.ground.cover), scene.ground.cover)
    return scene._replace(
        near=tuple(map(nothing, scene.near)), far=tuple(map(nothing, scene.far)), ground=ground
    )


def seen_from(scene, position_m, drive=STILL_IMAGE):
    view = View(QUIET, drive, illuminate(scene, drive.light))
    frame = np.zeros((1, *view.shape), np.float32)
    view.render(np.array([float(position_m)]), frame)
    return view, frame[0]


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("ahead", [6.5, 10.0, 20.0])
@pytest.mark.parametrize("lateral", [0.0, 0.5])
def test_a_post_is_seen_where_the_pinhole_puts_it(side, ahead, lateral):
    """Column = centre + f X / Z, and its top at centre + f (camera height - its height) / Z."""
    scene = empty_scene()
    height, at = 2.4, 30.0
    rows, columns = int(height / NEAR_ROW_M), slice(int((at - 0.2) / COLUMN_M),
                                                    int((at + 0.2) / COLUMN_M))  # fmt: skip
    scene.near[side].cover[:rows, columns] = 1
    drive = replace(STILL_IMAGE, lateral_m=lateral, light=Light(sun=0, ambient=1))
    view, frame = seen_from(scene, at - ahead, drive)
    _, bare = seen_from(empty_scene(), at - ahead, drive)
    dark = bare - frame
    y, x = np.nonzero(dark > dark.max() / 2)
    expected_x = (view.shape[1] - 1) / 2 + view.focal * (
        (NEAR_M if side else -NEAR_M) - view.lane_m
    ) / ahead
    expected_y = (view.shape[0] - 1) / 2 + view.focal * (CAMERA_M - height) / ahead
    assert abs(x.mean() - expected_x) < 1.0
    assert abs(y.min() - expected_y) < 1.5 + view.focal * NEAR_ROW_M / ahead


def test_near_things_hide_far_ones_and_far_ones_hide_the_sky():
    scene = empty_scene()
    scene.far[1].cover[:50] = 1
    scene.far[1].reflectance[:50] = 0.5
    _, far = seen_from(scene, 10)
    scene.near[1].cover[:30] = 1
    scene.near[1].reflectance[:30] = 0.1
    view, both = seen_from(scene, 10)
    row, column = view.shape[0] // 2 - 2, view.shape[1] - 5  # a ray a little above the horizon
    right = Light().ambient  # the sun stands on the right, so that these walls are in its shade
    assert far[row, column] == pytest.approx(0.5 * right, abs=0.01)
    assert both[row, column] == pytest.approx(0.1 * right, abs=0.01)
    assert far[row, 4] > 0.7


def test_a_mounting_turned_to_the_right_moves_the_image_to_the_left():
    """By f tan(angle) at the centre; the same for a camera that looks down and the rows."""
    scene = empty_scene()
    straight, _ = seen_from(scene, 10)
    turned, _ = seen_from(scene, 10, replace(STILL_IMAGE, yaw_deg=2.0))
    lowered, _ = seen_from(scene, 10, replace(STILL_IMAGE, pitch_deg=2.0))
    middle = straight.shape[0] // 2, straight.shape[1] // 2
    assert turned.across[middle] - straight.across[middle] == pytest.approx(np.tan(np.radians(2)),
                                                                            rel=0.01)  # fmt: skip
    assert lowered.down[middle] - straight.down[middle] == pytest.approx(np.tan(np.radians(2)),
                                                                         rel=0.01)  # fmt: skip


def test_the_sun_on_the_right_throws_the_shadow_of_a_wall_to_its_left():
    """At 45 degrees a wall throws a shadow as long as it is high; the rest lies in the sun."""
    scene = empty_scene(20)
    height = 2.4
    scene.near[1].cover[: int(height / NEAR_ROW_M)] = 1
    light = Light(azimuth_deg=90, elevation_deg=45)
    textures = illuminate(scene, light)
    rows = scene.ground.cover.shape[0]
    first = int(textures.start[4, 0])
    lit = textures.texels[first : first + 2 * rows * int(textures.columns[0])]
    across = lit.reshape(rows, -1, 2)[:, 50, 0] / 255
    x = (np.arange(rows) + 0.5) * GROUND_ROW_M - FAR_M
    shaded = (x > NEAR_M - height + 0.1) & (x < NEAR_M - 0.1)
    sunny = (x < NEAR_M - height - 0.1) | (x > NEAR_M + 0.1)
    assert across[shaded] == pytest.approx(light.ambient, abs=0.01)
    assert across[sunny] == pytest.approx(light.ambient + light.sun * np.sqrt(0.5), abs=0.01)


def test_a_passing_figure_covers_what_is_behind_it_at_its_place():
    view, frame = seen_from(empty_scene(), 10)
    bare = frame.copy()
    picture = np.zeros((12, 12, 2), np.float32)
    picture[1:-1, 1:-1, 1] = 1  # black
    mover = Mover(picture, 1.0, 2.0, position_m=20.0, speed_mps=-3.0, x_m=0.0, x_mps=0.5)
    paint_traffic([mover], view, 1_000_000, 10.0, frame)  # now 7 m ahead, 0.5 m right of the middle
    y, x = np.nonzero(bare - frame > 0.3)
    assert x.mean() == pytest.approx(
        (view.shape[1] - 1) / 2 + view.focal * (0.5 - view.lane_m) / 7, abs=0.6
    )
    assert np.ptp(x) == pytest.approx(view.focal * 1.0 * 10 / 12 / 7, abs=2)
    assert y.max() == pytest.approx(
        (view.shape[0] - 1) / 2 + view.focal * (CAMERA_M - 2.0 / 12) / 7, abs=1.5
    )
    paint_traffic([mover], view, 9_000_000, 10.0, bare)  # behind the camera by now
    assert np.array_equal(bare, seen_from(empty_scene(), 10)[1])


def test_the_image_is_cut_out_at_a_fraction_of_a_pixel():
    """On a linear ramp, a shift by s pixels changes every value by s times the slope."""
    frame = np.add.outer(3.0 * np.arange(16), np.arange(16)).astype(np.float32)
    image = np.zeros((8, 8), np.float32)
    fixed = np.zeros_like(image)
    cut(frame, 4, 0.0, 0.0, fixed, 0.5, image)
    assert np.array_equal(image, frame[4:12, 4:12] + np.float32(0.5))
    moved = np.zeros_like(image)
    fixed[7] = 0.25
    cut(frame, 4, 0.25, -1.5, fixed, 0.5, moved)
    assert (moved - image)[:7] == pytest.approx(np.full((7, 8), -0.25 + 3 * 1.5))
    assert (moved[7] == 0.75).all()


def test_the_world_is_drawn_anew_for_each_seed_and_parked_cars_for_each_drive():
    world = World(length_m=100, seed=1)
    scene = paint(world)
    assert all(
        np.array_equal(a.reflectance, b.reflectance)
        for a, b in zip(scene.near + scene.far, paint(world).near + paint(world).far, strict=True)
    )
    assert not np.array_equal(scene.far[0].cover, paint(replace(world, seed=2)).far[0].cover)
    for surface in (*scene.near, *scene.far, scene.ground):
        assert surface.reflectance.min() >= 0
        assert surface.reflectance.max() <= 1.0
        assert set(np.unique(surface.cover)) <= {0.0, 1.0}
    before = scene.near[0].cover.copy()
    parked = park_cars(scene.near[0], 300, np.random.default_rng(0))
    assert parked.cover.sum() > before.sum()
    assert np.array_equal(scene.near[0].cover, before)


# ------------------------------------------------------------------ bad use


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: simulate_pair(sensor="nokia"), "sensor 'nokia' is unknown: choose from default"),
        (lambda: simulate_pair(seed=-1), "seed is -1"),
        (lambda: World(length_m=1), "length_m is 1"),
        (lambda: Drive(speed_mps=0), "speed of 0 m/s"),
        (lambda: Drive(speed_range=0.5), "within a factor of 0.5"),
        (lambda: Drive(stops=-1), "stops is -1"),
        (lambda: Drive(yaw_deg=40), "yaw_deg is 40"),
        (lambda: Drive(lateral_m=3), "lateral_m is 3"),
        (lambda: Light(ambient=0), "ambient 0"),
        (lambda: Light(elevation_deg=0), "elevation_deg is 0"),
        (lambda: short(seed=-2), "seed -2 is negative"),
    ],
)
def test_values_that_make_no_sense_are_refused_in_one_line(make, message):
    with pytest.raises(UsageError, match=message) as refused:
        make()
    assert "\n" not in str(refused.value)
