"""The main job, from events to matches, against the oracle from end to end."""

from __future__ import annotations

import itertools
from functools import partialmethod

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge_vpr.descriptors.cleaning import BURST_SHARE, BURST_SLOT_US, HOT_FACTOR
from edge_vpr.descriptors.counting import count_windows
from edge_vpr.descriptors.pixels import PixelMap, PixelStatistics
from edge_vpr.descriptors.published import PublishedWindows
from edge_vpr.descriptors.windows import WindowCounts
from edge_vpr.errors import EventError, MapError, UsageError
from edge_vpr.events import Sensor, join_events, make_events
from edge_vpr.map_making import describe
from edge_vpr.recordings import open_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from tests import naive
from tests.streams import Drive, as_tuples, random_events

SENSOR = Sensor(9, 7)
SMALL = Settings(pixels=6, sigma=2.0, tau_us=100_000, sequence_length=2, events_per_pixel=2.0)


def busy_drive(rng, n=3_000):
    """Random events, one hot pixel, one burst."""
    events = random_events(rng, n, SENSOR, 2_000_000)
    events.x[: n // 6], events.y[: n // 6] = 4, 3
    events.t[: n // 6] = np.sort(rng.integers(0, 2_000_000, n // 6))
    y, x = np.divmod(np.arange(SENSOR.pixels), SENSOR.width)
    burst = make_events(np.full(SENSOR.pixels, 950_000), x, y)
    both = join_events([events, burst])
    return both[np.argsort(both.t, kind="stable")]


def expected_map(events, chosen):
    """The oracle's pixels and descriptors of a drive."""
    kept = as_tuples(events)
    if chosen.remove_bursts:
        kept = naive.without_bursts(kept, BURST_SLOT_US, SENSOR.pixels, BURST_SHARE)
    grid = [(x, y) for y in range(SENSOR.height) for x in range(SENSOR.width)]
    images = [naive.count(w, grid) for w in naive.fixed_time_windows(kept, chosen.tau_us)]
    columns = list(zip(*images, strict=True))

    def as_image(values):
        rows = iter(values)
        return [[next(rows) for _ in range(SENSOR.width)] for _ in range(SENSOR.height)]

    saliency = as_image(naive.variance(column) for column in columns)
    hot = naive.hot_pixels(as_image(sum(column) for column in columns), HOT_FACTOR)
    for x, y in hot if chosen.remove_hot_pixels else []:
        saliency[y][x] = 0.0
    draws = np.random.default_rng(chosen.seed).random(chosen.pixels).tolist()
    pixels = naive.select_pixels(saliency, chosen.pixels, chosen.sigma, draws)
    return pixels, kept, hot


@given(
    seed=st.integers(0, 2**32),
    window=st.sampled_from(["time", "count"]),
    remove_bursts=st.booleans(),
    per_window=st.sampled_from([1, 2]),
    chunk=st.sampled_from([1, 100, 10_000]),
)
@settings(max_examples=15)
def test_a_map_equals_the_oracle_from_events_to_descriptors(
    seed, window, remove_bursts, per_window, chunk
):
    chosen = SMALL.replaced(
        {
            "window": window,
            "remove_bursts": remove_bursts,
            "seed": seed,
            **({} if per_window == 1 else {"matching": "filter", "places_per_window": 2}),
        },
        "test",
    )
    events = busy_drive(np.random.default_rng(seed), 600)
    reference = ReferenceMap.build(Drive(events, SENSOR, chunk), chosen)

    pixels, kept, hot = expected_map(events, chosen)
    map_pixels = zip(reference.pixel_map.x.tolist(), reference.pixel_map.y.tolist(), strict=True)
    assert list(map_pixels) == pixels
    assert {(int(x), int(y)) for y, x in np.argwhere(reference.hot)} == set(hot)
    if window == "time":
        parts = naive.fixed_time_windows(kept, chosen.tau_us // per_window)
    else:
        parts = naive.fixed_count_windows(kept, pixels, chosen.events_per_window // per_window)
    windows = parts
    if per_window == 2:
        windows = [first + second for first, second in itertools.pairwise(parts)]
    assert reference.places.counts.tolist() == [naive.count(w, pixels) for w in windows]
    assert reference.places.events.tolist() == [len(w) for w in windows]


@pytest.mark.parametrize("window", ["time", "count"])
@pytest.mark.parametrize("code", ["none", "linear", "contrast"])
def test_every_second_place_at_half_windows_is_one_of_whole_windows(tmp_path, window, code):
    """Of the codes, too: their means are those of windows that do not overlap."""
    changes = {"window": window, "matching": "filter", "counter_code": code}
    events = busy_drive(np.random.default_rng(5), 900)
    drive = Drive(events, SENSOR)
    whole = ReferenceMap.build(drive, SMALL, **changes)
    half = ReferenceMap.build(drive, SMALL, places_per_window=2, **changes)
    assert half.windows == whole.places
    assert len(half) in (2 * len(whole) - 1, 2 * len(whole))
    assert half.pixel_map == whole.pixel_map
    assert np.array_equal(half.mean, whole.mean) if whole.mean is not None else half.mean is None
    assert half.mean_activity == whole.mean_activity
    # a query is counted in whole windows, and coded as with the other map
    assert half.match(drive).queries == whole.match(drive).queries
    half.save(tmp_path / "half.npz")
    assert ReferenceMap.load(tmp_path / "half.npz") == half
    assert half.settings.exclusion_places == 2 * whole.settings.exclusion_places


def test_windows_by_count_are_of_an_even_number_where_it_is_taken_from_the_drive():
    drive = Drive(busy_drive(np.random.default_rng(4)), SENSOR)
    changes = {"window": "count", "events_per_pixel": None, "matching": "filter"}
    for seed in range(4):
        reference = ReferenceMap.build(drive, SMALL, seed=seed, places_per_window=2, **changes)
        number = reference.settings.events_per_window
        assert number % 2 == 0
        whole = ReferenceMap.build(drive, SMALL, seed=seed, **changes).settings.events_per_window
        assert abs(number - whole) <= 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tau_us": 100_001}, "windows of 100001 us: expected an even number of microseconds"),
        ({"window": "count", "events_per_pixel": 1.5}, "windows of 9 events: expected an even"),
        ({"tau_us": 3_000_000}, "shorter than one window of 3 s"),
        ({"tau_us": 2_000_000}, "shorter than one window of 2 s"),
    ],
)
def test_half_windows_that_cannot_be_are_refused(changes, message):
    drive = Drive(busy_drive(np.random.default_rng(4)), SENSOR)
    with pytest.raises(UsageError, match=message):
        ReferenceMap.build(drive, SMALL, matching="filter", places_per_window=2, **changes)


@pytest.mark.parametrize("per_window", [1, 2])
def test_a_temporary_file_that_is_too_small_costs_a_second_pass_and_changes_nothing(
    per_window, monkeypatch
):
    changes = {"places_per_window": per_window, "matching": "filter", "clip": 3}
    settings, passes = SMALL.replaced(changes, "test"), []

    class Counted(Drive):
        def __iter__(self):
            passes.append(self)
            return super().__iter__()

    drive = Counted(busy_drive(np.random.default_rng(1), 900), SENSOR)
    whole = ReferenceMap.build(drive, settings)
    assert len(passes) == 1
    original = PixelStatistics.__init__
    monkeypatch.setattr(PixelStatistics, "__init__", partialmethod(original, spool_bytes=100))
    assert ReferenceMap.build(drive, settings) == whole
    assert len(passes) == 3


@given(st.lists(st.lists(st.integers(0, 2**40), min_size=3, max_size=3), min_size=1, max_size=6))
def test_the_variance_is_exact_whatever_the_counts(rows):
    first = PixelStatistics(Sensor(3, 1))
    with first:
        for k, row in enumerate(rows):
            small = [c % 2**20 for c in row]
            first.add(WindowCounts(np.array(small), k, k + 1, sum(small)))
        columns = list(zip(*[[c % 2**20 for c in row] for row in rows], strict=True))
        assert first.variance().tolist() == [[naive.variance(column) for column in columns]]


@pytest.mark.parametrize(("matching", "per_window"), [("sequence", 1), ("filter", 2)])
def test_a_drive_matched_against_its_own_map_finds_each_place(matching, per_window):
    events = random_events(np.random.default_rng(2), 5_000, SENSOR, 2_000_000)
    changes = {"matching": matching, "places_per_window": per_window}
    reference = ReferenceMap.build(Drive(events, SENSOR), SMALL, **changes)
    result = reference.match(Drive(events, SENSOR, 7))
    matches, queries = result.matches, result.queries
    assert np.array_equal(queries.counts, reference.places.counts[::per_window])
    assert matches.place.tolist() == (per_window * matches.query).tolist()
    assert matching == "filter" or not matches.distance.any()


CODED = [
    {"counter_code": "linear", "counter_bits": 2},
    {"counter_code": "linear", "counter_bits": 9},
]


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32),
    code=st.sampled_from(CODED),
    window=st.sampled_from(["time", "count"]),
)
@settings(max_examples=30)
def test_a_coded_map_has_the_pixels_of_the_plain_one_and_the_codes_of_its_counts(
    seed, code, window
):
    events = busy_drive(np.random.default_rng(seed), 600)
    drive = Drive(events, SENSOR, 100)
    plain = SMALL.replaced({"window": window, "seed": seed}, "test")
    coded = plain.replaced(code, "test")
    counts = ReferenceMap.build(drive, plain)
    reference = ReferenceMap.build(drive, coded)
    assert reference.pixel_map == counts.pixel_map
    columns = counts.places.counts.T.tolist()
    most = 2**coded.counter_bits - 1
    expected = [[min(count, most) for count in column] for column in columns]
    assert reference.places.counts.T.tolist() == expected
    # a query is coded as the map is
    result = reference.match(drive)
    matches, queries = result.matches, result.queries
    assert np.array_equal(queries.counts, reference.places.counts)
    assert not matches.distance.any()
    assert counts.decoded(counts.places) is counts.places is counts.coded(counts.places)
    assert np.array_equal(reference.coded(counts.places).counts, reference.places.counts)
    assert reference.decoded(reference.places) is reference.places


def test_pixels_are_selected_by_clipped_counts_as_in_the_released_code():
    events = busy_drive(np.random.default_rng(0))
    chosen = SMALL.replaced({"strategy": "top", "remove_hot_pixels": False}, "test")
    clipped = ReferenceMap.build(Drive(events, SENSOR), chosen.replaced({"clip": 1}, "test"))
    plain = ReferenceMap.build(Drive(events, SENSOR), chosen)
    assert clipped.saliency.max() <= 0.25  # the variance of zeros and ones
    assert plain.saliency.max() > 1
    assert clipped.places.counts.max() == 1


def test_a_map_says_how_many_bytes_a_place_takes_here_and_packed():
    drive = Drive(busy_drive(np.random.default_rng(0)), SENSOR)
    coded = ReferenceMap.build(drive, SMALL.replaced({"counter_code": "contrast"}, "test"))
    assert (coded.counter_bits, coded.bytes_per_place, coded.packed_bytes_per_place) == (3, 6, 3)
    plain = ReferenceMap.build(drive, SMALL)
    assert (plain.counter_bits, plain.bytes_per_place, plain.packed_bytes_per_place) == (8, 6, 6)
    clipped = ReferenceMap.build(drive, SMALL.replaced({"clip": 10}, "test"))
    assert (clipped.counter_bits, clipped.packed_bytes_per_place) == (4, 3)


def test_n_from_the_reference_is_what_a_window_of_tau_holds_on_average():
    events = random_events(np.random.default_rng(2), 5_000, SENSOR, 2_000_000)
    by_time = ReferenceMap.build(Drive(events, SENSOR), SMALL)
    chosen = SMALL.replaced({"window": "count", "events_per_pixel": None}, "test")
    by_count = ReferenceMap.build(Drive(events, SENSOR), chosen)
    mean = by_time.places.counts.sum() / len(by_time)
    assert by_count.pixel_map == by_time.pixel_map
    assert by_count.settings.events_per_window == round(mean)
    assert set(by_count.places.counts.sum(axis=1)) == {round(mean)}


def test_a_recording_of_another_sensor_does_not_fit_the_map():
    events = random_events(np.random.default_rng(2), 5_000, SENSOR, 2_000_000)
    reference = ReferenceMap.build(Drive(events, SENSOR), SMALL)
    with pytest.raises(MapError, match="of a 10x7 sensor and the map of a 9x7 one"):
        reference.match(Drive(events, Sensor(10, 7)))


@pytest.mark.parametrize(
    ("number", "changes", "says"),
    [
        (0, {}, r"shorter than one window of 0.1 s"),
        (1, {"window": "count", "events_per_pixel": 100.0}, "shorter than one window of"),
        (963, {"tau_us": 10**9, "remove_bursts": False}, "its last event is at {} s"),
    ],
)
def test_a_window_longer_than_the_recording_is_wrong_use(number, changes, says):
    events = busy_drive(np.random.default_rng(1), 900)[:number]
    drive, settings = Drive(events, SENSOR), SMALL.replaced(changes, "")
    says = says.format(*(f"{t / 1e6:g}" for t in events["t"][-1:]))
    for use in (
        lambda: ReferenceMap.build(drive, settings),
        lambda: describe(drive, PixelMap.all_of(SENSOR), settings),
    ):
        with pytest.raises(UsageError, match=says):
            use()


def test_clipping_changes_neither_the_events_of_a_window_nor_the_hot_pixels():
    events = busy_drive(np.random.default_rng(0))
    chosen = SMALL.replaced({"window": "count", "events_per_pixel": None}, "test")
    chosen = chosen.replaced({"strategy": "random"}, "test")
    whole = ReferenceMap.build(Drive(events, SENSOR), chosen)
    clipped = ReferenceMap.build(Drive(events, SENSOR), chosen.replaced({"clip": 1}, "test"))
    assert clipped.settings.events_per_window == whole.settings.events_per_window
    assert np.array_equal(clipped.hot, whole.hot)
    assert clipped.places.counts.max() == 1


@given(
    seed=st.integers(0, 2**32),
    frames=st.integers(1, 9),
    quiet=st.integers(0, 3),
    per_window=st.integers(1, 3),
    end=st.none() | st.integers(1, 12),
    chunk=st.sampled_from([1, 10_000]),
)
def test_count_frames_read_as_events_fill_windows_to_the_end_of_the_last_frame(
    seed, frames, quiet, per_window, end, chunk, tmp_path_factory
):
    """No event comes after the last frame, whose end the file knows nevertheless."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 9, (frames, SENSOR.height, SENSOR.width), dtype=np.uint8)
    counts = np.concatenate([counts, np.zeros((quiet, *counts.shape[1:]), np.uint8)])
    path = tmp_path_factory.mktemp("frames") / "frames.npz"
    np.savez(path, frames=counts, window_s=0.1)
    drive = open_recording(path, end=None if end is None else end / 10, chunk_events=chunk)
    whole = counts[:end][: len(counts[:end]) // per_window * per_window]
    expected = whole.reshape(-1, per_window, SENSOR.pixels).sum(axis=1)
    plain = Settings(tau_us=100_000 * per_window, remove_bursts=False)
    every_pixel = PixelMap.all_of(SENSOR)
    for _ in range(2 if len(expected) else 0):  # a recording can be walked again
        windows = count_windows(drive, every_pixel, plain)
        assert windows.counts.tolist() == expected.tolist()
        assert windows.end_us[-1] == len(whole) * 100_000


def test_a_part_of_a_recording_fills_windows_up_to_its_end(tmp_path):
    times = np.arange(0, 1_000_000, 10_000)
    np.savez(tmp_path / "drive.npz", t=times, x=times % 9, y=times % 7, p=times % 2)
    plain = Settings(tau_us=100_000, remove_bursts=False)
    ends = {
        end: len(count_windows(part, PixelMap.all_of(SENSOR), plain))
        for end in (0.5, 0.55, 0.9, None, 7)
        if (part := open_recording(tmp_path / "drive.npz", sensor=SENSOR, end=end))
    }
    # where the file itself ends, nobody knows how much longer the camera saw nothing
    assert ends == {0.5: 5, 0.55: 5, 0.9: 9, None: 9, 7: 9}


@pytest.mark.parametrize("changes", [{"matching": "filter"}, {"preset": "paper"}])
def test_a_drive_of_count_frames_has_as_many_matches_as_frames(changes, tmp_path):
    """As events or windows, and event by event."""
    rng = np.random.default_rng(0)
    frames = rng.poisson(rng.uniform(0, 4, (1, SENSOR.height, SENSOR.width)), (30, 7, 9))
    np.savez(tmp_path / "frames.npz", frames=frames.astype(np.uint8), window_s=0.1)
    preset = changes.pop("preset", "default")
    route = ReferenceMap.build(
        PublishedWindows(tmp_path / "frames.npz"), preset, pixels=9, bursts=False, tau="100ms",
        sequence_length=1, **changes
    )  # fmt: skip
    assert len(route) == 30
    assert len(ReferenceMap.build(tmp_path / "frames.npz", route.settings)) == 30
    windows = route.match(PublishedWindows(tmp_path / "frames.npz"))
    events = route.match(tmp_path / "frames.npz")
    live = route.match(tmp_path / "frames.npz", every="window")
    assert windows.queries.counts.tolist() == events.queries.counts.tolist()
    assert len(events) == len(live) == len(live.windows) == 30


def wrongly_cut(events):
    """Arrays that a source of one's own must not yield, with what is wrong about them."""
    off = events.copy()
    off.x[7] = SENSOR.width
    wide = np.asarray(events).astype([("t", "f8"), ("x", "f8"), ("y", "i4"), ("p", "i1")])
    wide["x"][7] += 0.5
    early = events.copy()
    early.t -= events["t"][0] + 5
    return {
        "backwards, from": [events[100:], events[:100]],
        "from 0 to -5 us: .* times count from 0": [early],
        "backwards at event 1": [events[::-1]],
        "backwards, from [0-9]": [events[::2], events[1::2]],
        "off the 9x7 sensor": [off],
        "column x holds": [wide],
        "events are a tuple": [tuple(events[name] for name in "txyp")],
    }


def test_a_source_of_ones_own_is_held_to_order_and_sensor():
    events = busy_drive(np.random.default_rng(1), 900)
    route = ReferenceMap.build(Drive(events, SENSOR), SMALL)
    for words, chunks in wrongly_cut(events).items():
        own = Drive(events, SENSOR)
        own._chunks = chunks
        for use in (lambda drive: ReferenceMap.build(drive, SMALL), route.match):
            with pytest.raises(EventError, match=words):
                use(own)


def test_a_source_of_ones_own_may_yield_the_fields_of_events_in_any_type():
    events = busy_drive(np.random.default_rng(1), 900)
    wide = np.asarray(events).astype([("t", "f8"), ("x", "f8"), ("y", "i4"), ("p", "i1")])
    own = Drive(wide[["y", "x", "t"]], SENSOR)
    assert ReferenceMap.build(own, SMALL) == ReferenceMap.build(Drive(events, SENSOR), SMALL)
