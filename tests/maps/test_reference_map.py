"""The public way in: a map is built, matches, follows and is saved in a few lines."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import inspect
import json
import re
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_type_hints

import numpy as np
import pytest
from edge_vpr_tools.live_view import row_of

import edge_vpr as ev
from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr.events import join_events, make_events
from edge_vpr.live.protocols import open_encoder
from edge_vpr.live.session import LiveSession
from edge_vpr.matching.match import MATCH_DTYPE
from edge_vpr.matching.matches import TABLE
from edge_vpr.route import ALONG
from edge_vpr.simulation import simulate_pair
from firmware_model.design import Design
from firmware_model.errors import DesignError
from tests.streams import Drive, random_events

SENSOR = ev.Sensor(16, 12)
SMALL = {"pixels": 5, "sigma": 1.0, "tau": "100ms"}


def events_of(seed, seconds=2.0):
    n = int(2_000 * seconds)
    return random_events(np.random.default_rng(seed), n, SENSOR, int(1e6 * seconds))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two drives and their tracks."""
    folder = tmp_path_factory.mktemp("drives")
    for seed, name in enumerate(("monday", "tuesday")):
        ev.write_recording(folder / f"{name}.npz", events_of(seed), sensor=SENSOR)
        rows = "0,0\n2,20\n" if seed == 0 else "0,0\n1,10\n2,20\n"  # two logs of one pace
        (folder / f"{name}.csv").write_text(f"time_s,position_m\n{rows}")
    return folder


@pytest.fixture(scope="module")
def route(folder):
    return ev.ReferenceMap.build(folder / "monday.npz", track=folder / "monday.csv", **SMALL)


def test_settings_are_a_preset_settings_a_file_or_keywords(folder, route):
    (folder / "small.toml").write_text('pixels = 5\nsigma = 1.0\ntau = "100ms"\n')
    recording = ev.open_recording(folder / "monday.npz")
    settings = ev.resolve_settings("default", flags=SMALL)
    for chosen in (settings, folder / "small.toml", str(folder / "small.toml")):
        made = ev.ReferenceMap.build(recording, chosen, track=ev.load_track(folder / "monday.csv"))
        assert made == route
    plain = ev.ReferenceMap.build(recording, None, **SMALL)
    assert plain == ev.ReferenceMap.build(recording, **SMALL) != route
    paper = ev.ReferenceMap.build(recording, "paper", **SMALL)
    assert (paper.settings.matching, paper.settings.pixels) == ("sequence", 5)


def test_a_map_equals_itself_after_saving_and_no_other_map(folder, route, tmp_path):
    odometry = ev.load_odometry(folder / "monday.csv")
    full = ev.ReferenceMap.build(
        folder / "monday.npz", track=folder / "monday.csv", odometry=odometry, **SMALL
    )
    for made in (route, full):
        made.save(tmp_path / "map.npz", overwrite=True)
        assert ev.ReferenceMap.load(tmp_path / "map.npz") == made
    assert full != route
    saliency = full.saliency.copy()
    saliency[3, 3] += 1
    assert dataclasses.replace(full, saliency=saliency) != full
    matches = route.match(folder / "tuesday.npz").matches
    matches.save(tmp_path / "matches.npz")
    assert ev.Matches.load(tmp_path / "matches.npz") == matches


def test_the_page_has_every_array_of_a_map_with_its_type_and_the_checksum(folder, tmp_path):
    """A map that has most of them, read as somebody would who has the page alone."""
    full = ev.ReferenceMap.build(
        folder / "monday.npz", track=folder / "monday.csv",
        odometry=ev.load_odometry(folder / "monday.csv"), **SMALL,
    )  # fmt: skip
    learnt = full.update(folder / "tuesday.npz", track=folder / "tuesday.csv").reference
    learnt.save(tmp_path / "map.npz")
    page = (Path(__file__).parents[2] / "docs" / "outputs.md").read_text(encoding="utf-8")
    told = {}
    for row in re.findall(r"^\| (`.*)$", page.partition("## map.npz")[2], re.MULTILINE):
        names, types, _ = row.split(" | ", 2)
        names = re.findall(r"`(\w+)`", names)
        types = types.replace(" or ", "|").split(", ")
        told |= dict(zip(names, types * len(names) if len(types) == 1 else types, strict=True))
    with np.load(tmp_path / "map.npz", allow_pickle=False) as file:
        arrays = dict(file)
    header = json.loads(str(arrays.pop("edge_vpr")))
    assert len(arrays) > 14
    for name, array in arrays.items():
        assert str(array.dtype) in told[name].split("|"), name
    checksum = header.pop("checksum")
    digest = hashlib.sha256(json.dumps(header).encode())
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"\n{name} {array.dtype.str} {array.shape}\n".encode() + array.tobytes())
    assert digest.hexdigest() == checksum


@pytest.mark.parametrize("kind", ["map", "matches", "results", "design"])
def test_nothing_that_is_saved_replaces_a_file_silently(folder, route, tmp_path, kind):
    path = tmp_path / "saved.npz"
    save = {
        "map": lambda: route.save,
        "matches": lambda: route.match(folder / "tuesday.npz").matches.save,
        "results": lambda: route.match(folder / "tuesday.npz").save,
        "design": lambda: Design(width=4, height=4, pixels=2, places=3, length=1).save,
    }[kind]()
    save(path)
    before = path.stat()
    with pytest.raises((ev.UsageError, DesignError), match=r"saved.npz exists: .*overwrite=True"):
        save(path)
    assert path.stat() == before
    save(path, overwrite=True)
    assert [one.name for one in tmp_path.iterdir()] == ["saved.npz"]


def test_a_map_of_own_pixels_counts_those(folder):
    pixels = ev.PixelMap(SENSOR, np.array([3, 9, 1]), np.array([2, 11, 0]))
    made = ev.ReferenceMap.build(
        folder / "monday.npz", "paper", pixel_map=pixels, tau="100ms", bursts="keep"
    )
    assert made.pixel_map == pixels and made.settings.pixels == 3
    events = events_of(0)
    for j, (x, y) in enumerate(zip(pixels.x, pixels.y, strict=True)):
        times = events["t"][(events["x"] == x) & (events["y"] == y)]
        counts = np.bincount(times // 100_000, minlength=len(made))[: len(made)]
        assert made.places.counts[:, j].tolist() == counts.tolist()
    assert not made.hot[pixels.y, pixels.x].any()
    with pytest.raises(EdgeVprError, match="of a 16x12 sensor and the map of a 9x9 one"):
        ev.ReferenceMap.build(
            folder / "monday.npz",
            pixel_map=ev.PixelMap(ev.Sensor(9, 9), pixels.x[2:], pixels.y[2:]),
        )


def test_a_result_is_evaluated_by_tracks_or_by_a_truth(folder, route):
    result = route.match(folder / "tuesday.npz")
    tracks = [folder / "monday.csv", folder / "tuesday.csv"]
    evaluation = result.evaluate(tracks, tolerance_m=1.5)
    loaded = [ev.load_track(track) for track in tracks]
    truth = ev.from_tracks(
        *loaded, route.places.centre_us, result.queries.centre_us, tolerance_m=1.5
    )
    for other in (
        result.evaluate(loaded, 1.5),
        result.evaluate(truth),
        ev.evaluate(result.matches, truth),
    ):
        assert other.to_dict() == evaluation.to_dict()
    online = route.match(folder / "tuesday.npz", every="window")
    assert online.queries is None
    assert online.evaluate(tracks, 1.5).queries == len(online)


def test_a_saved_result_is_read_by_the_commands(folder, route, tmp_path, run):
    for name, every in (("windows", None), ("events", "20ms")):
        result = route.match(folder / "tuesday.npz", every=every, precision=0.3)
        assert result.reference.settings == route.settings  # those of one run are not the map's
        result.save(tmp_path / name)
        again = ev.MatchResult.load(tmp_path / name)
        assert (again.matches, again.queries) == (result.matches, result.queries)
        assert again.reference == result.reference
        truth = [folder / f"{day}.csv" for day in ("monday", "tuesday")]
        shown = run("evaluate", tmp_path / name, "--ground-truth", *truth, "--tolerance", 1.5).out
        assert f"P@100R {result.evaluate(truth, 1.5).precision_at_100_recall:.3f}" in shown


def test_matching_settings_are_keywords_and_others_are_refused(folder, route):
    plain = route.match(folder / "tuesday.npz", smooth=False).matches
    changed = dataclasses.replace(route.settings, smooth=False)
    assert route.match(folder / "tuesday.npz", settings=changed).matches == plain
    assert plain.settings == changed and route.settings.smooth
    with pytest.raises(UsageError, match=r"match: setting pixels = 6, and the map was made with 5"):
        route.match(folder / "tuesday.npz", pixels=6)


def test_a_camera_that_sees_a_quarter_of_the_events_is_matched_live_too():
    first, second = simulate_pair(0, "tiny", length_m=200)
    route = ev.ReferenceMap.build(first, track=first.track, pixels=100)
    events = join_events(list(second))
    few = events[np.random.default_rng(0).random(events.size) < 1 / 4]
    truth = (first.track, second.track)
    for how, begin in (({}, 0), ({"smooth": False}, 20), ({"every": "window"}, 20)):
        evaluation = route.match(few, **how).evaluate(truth, tolerance_m=10)
        assert evaluation.correct[begin:].mean() > 0.8  # live, once the gain is known


def test_another_street_shows_in_the_facts():
    first, _ = simulate_pair(0, "tiny", length_m=60)
    route = ev.ReferenceMap.build(first, pixels=50)
    _, other = simulate_pair(5, "tiny", length_m=60)
    result = route.match(other)
    told = re.fullmatch(r"(\d+) of (\d+) matches look unlike the map", result.facts()["views"])
    assert told is not None
    assert int(told[1]) > 0.25 * int(told[2]) and int(told[2]) == len(result)


@pytest.mark.parametrize("how", [{}, {"smooth": False}, {"every": "window"}])
def test_a_pixel_that_has_become_hot_is_a_fact_of_the_drive(how):
    first, second = simulate_pair(0, "tiny", length_m=60)
    route = ev.ReferenceMap.build(first, pixels=50)
    events = join_events(list(second))
    x, y = int(route.pixel_map.x[3]), int(route.pixel_map.y[3])
    times = np.arange(0, int(events.t[-1]), 1_000)  # 1,000 events/s
    hot = make_events(times, np.full(times.size, x), np.full(times.size, y))
    both = join_events([events, hot])
    both = both[np.argsort(both.t, kind="stable")]
    before, after = (
        float(route.match(each, **how).facts()["pixels"].partition("%")[0])
        for each in (events, both)
    )
    selected = route.match(both).queries.selected_events.sum()
    assert before < 20 and after > 90 * times.size / selected


def test_a_time_without_any_event_is_a_fact_of_the_drive(route):
    events = events_of(1)
    late = np.where(np.arange(events.size) < events.size // 2, 0, 20_000_000)
    jumped = with_times(events, events["t"] + late)
    assert "none from 1.1 to 21.0 s" in route.match(jumped).facts()["query"]
    assert "none from" not in route.match(with_times(events, events["t"])).facts()["query"]


def with_times(events, times):
    changed = events.copy()
    changed.t = times
    return ev.open_recording(changed, sensor=SENSOR)


def test_fewer_pixels_than_were_asked_for_are_named(tmp_path):
    counts = np.random.default_rng(0).poisson(20, (40, 9))
    x, y = np.divmod(np.arange(9), 3)
    np.savez(tmp_path / "few.npz", counts=counts, pixel_x=x, pixel_y=y, sensor=(64, 48))
    drive = ev.PublishedWindows(tmp_path / "few.npz", frame_period=1)
    with pytest.warns(ev.EdgeVprWarning, match="pixels=150, and .* events at 9 pixels alone"):
        assert ev.ReferenceMap.build(drive, pixels=150).settings.pixels == 9
    assert ev.ReferenceMap.build(drive).settings.pixels == 9
    # as of a sensor that has no others
    np.savez(tmp_path / "grid.npz", frames=counts.reshape(40, 3, 3))
    grid = ev.PublishedWindows(tmp_path / "grid.npz", frame_period=1)
    with pytest.raises(UsageError, match=r"only 9 of 9 pixels .* ask for at most 9"):
        ev.ReferenceMap.build(grid, pixels=150)


def test_settings_that_leave_the_places_open_take_those_of_the_map(folder, route):
    """Of a preset, `places_per_window` is auto: the map knows what that was."""
    auto = ev.resolve_settings("default", flags=SMALL)
    assert (auto.places_per_window, route.settings.places_per_window) == (None, 2)
    whole = ev.ReferenceMap.build(folder / "monday.npz", places_per_window=1, **SMALL)
    for made in (route, whole):
        drive = folder / "tuesday.npz"
        assert made.match(drive, settings=auto).matches == made.match(drive).matches
        assert made.localiser(settings=auto).settings.window_parts == made.settings.window_parts
        assert made.matched_with(auto) == made


def test_names_of_a_match_are_the_same_in_every_form(folder, route, tmp_path):
    """As docs/outputs.md lists them: arrays have whole microseconds, all else has seconds."""
    pytest.importorskip("pandas", reason="pandas is an extra")
    result = route.match(folder / "tuesday.npz", every="100ms", precision=0.2)
    result.save(tmp_path / "results")
    with (tmp_path / "results/matches.csv").open(newline="") as file:
        in_csv = list(csv.DictReader(file))
    frame = result.to_frame()
    assert frame["time_s"].tolist() == (result.matches.time_us / 1e6).tolist()
    (tmp_path / "sent.bin").write_bytes(open_encoder("evpr", SENSOR).encode(events_of(1)))
    with LiveSession(
        tmp_path / "sent.bin", protocol="evpr", reference=route, every="100ms", precision=0.2
    ) as session:
        lines = [json.loads(row_of(match, ["x_m"])) for match in session]
    shared = [name for name in TABLE if name != "query"]
    where = ["x_m", "along_m", "along_from_m", "along_to_m"]
    assert list(in_csv[0]) == [*TABLE, *where]
    assert {*TABLE, *where} <= set(frame.columns)
    assert {*shared, *where} <= set(lines[0])
    assert set(shared) <= {name.replace("_us", "_s") for name in MATCH_DTYPE.names}
    for name in TABLE:
        assert len(getattr(result.matches, name)) == len(result)
    assert [float(row["time_s"]) for row in in_csv] == (result.matches.time_us / 1e6).tolist()
    n = min(len(lines), len(in_csv))
    assert n > 10
    for name in ("place", "distance", "second", "second_distance", "ratio", "trust"):
        texts = ["-1" if name == "second" and not row[name] else row[name] for row in in_csv[:n]]
        in_json = [np.nan if line[name] is None else line[name] for line in lines[:n]]
        expected = pytest.approx(in_json, nan_ok=True)
        assert [float(text or "nan") for text in texts] == expected
        assert frame[name][:n].tolist() == expected


SPARSE = ev.Sensor(40, 30)


def sparse_drive():
    """Of a camera of which only few pixels fire, and those often."""
    rng = np.random.default_rng(5)
    n = 6_000
    pixel = rng.integers(0, 60, n)
    return ev.make_events(
        np.sort(rng.integers(0, 3_000_000, n)), pixel % 10 * 4, pixel // 10 * 5, None
    )


def test_no_hot_pixels_are_searched_where_most_pixels_never_fire():
    """Every pixel that fires would be above the mean and above its silent neighbours."""
    events = sparse_drive()
    totals = np.zeros((30, 40), dtype=np.int64)
    np.add.at(totals, (events["y"], events["x"]), 1)
    assert ev.find_hot_pixels(totals).sum() == np.count_nonzero(totals) == 60
    made = ev.ReferenceMap.build(Drive(events, SPARSE), pixels=40, sigma=0.5, tau="100ms")
    assert made.hot.sum() == 0 and len(made.pixel_map) == 40


def test_pixels_that_a_file_does_not_name_are_asked_for():
    """Of events at few pixels alone, nobody knows whether somebody has selected them."""
    drive = Drive(sparse_drive(), SPARSE)
    with pytest.raises(UsageError, match=r"only 60 of 1200 pixels .* and 150 were asked for"):
        ev.ReferenceMap.build(drive, tau="100ms", sigma=0.1)
    assert len(ev.ReferenceMap.build(drive, pixels=60, tau="100ms", sigma=0.1).pixel_map) == 60


def test_the_published_counts_make_a_map_with_all_defaults(shared_data, tmp_path):
    made = ev.ReferenceMap.build(shared_data / "brisbane_sparse49/sunset2.npz")
    assert len(made.pixel_map) == 49 and not made.hot.any()


def test_too_few_pixels_after_the_hot_ones_names_the_cause(tmp_path, refused):
    events = sparse_drive()
    hot = np.zeros((30, 40), dtype=np.bool_)
    hot[events["y"], events["x"]] = True
    hot[0, :20] = False
    with pytest.raises(UsageError, match=r"left out as hot: keep them \(hot_pixels='keep'"):
        ev.ReferenceMap.build(Drive(events, SPARSE), hot=hot, pixels=40, tau="100ms")
    with pytest.raises(UsageError, match="ask for fewer pixels or map a longer traverse"):
        ev.ReferenceMap.build(Drive(events[::10], SPARSE), pixels=400, tau="100ms")
    with pytest.raises(UsageError, match=r"ask for at most \d+$"):
        ev.ReferenceMap.build(Drive(events[::10], SPARSE), pixels=4_000, tau="100ms")
    ev.write_recording(tmp_path / "sparse.npz", events, sensor=SPARSE)
    np.savetxt(tmp_path / "hot.csv", np.argwhere(hot)[:, ::-1], fmt="%d", delimiter=",")
    flags = ["--pixels", 40, "--tau", "100ms", "--hot-pixels", tmp_path / "hot.csv"]
    said = refused("map", tmp_path / "sparse.npz", "-o", tmp_path / "map.npz", *flags)
    assert "left out as hot: keep them (--hot-pixels keep" in said


def test_map_prints_the_packed_size_and_records_every_input(folder, tmp_path, run):
    (tmp_path / "hot.csv").write_text("3,2\n")
    (tmp_path / "small.toml").write_text("pixels = 5\nsigma = 1.0\n")
    inputs = [folder / "monday.npz", folder / "monday.csv", tmp_path / "odometry.csv"]
    inputs += [tmp_path / "hot.csv", tmp_path / "small.toml"]
    inputs[2].write_text("time_s,speed_mps\n0,1\n2,1\n")
    recording, track, odometry, hot, config = inputs
    words = ["map", recording, "-o", tmp_path / "map.npz", "--track", track, "--tau", "100ms"]
    said = run(*words, "--odometry", odometry, "--hot-pixels", hot, "--config", config).out
    made = ev.ReferenceMap.load(tmp_path / "map.npz")
    # 5 codes of 3 bits, and the activity
    assert made.packed_bytes_per_place == 2 + 1 and made.bytes_per_place == 5
    assert made.packed_bytes_per_window == 6
    size = "60 bytes per second of the route, packed"
    assert f"{len(made)} places (at half windows) at 5 pixels of 16x12, {size}" in said
    # half windows overlap: their events are not counted twice, and the last one is not counted
    counted = made.places.events[::2].sum()
    assert len(made) % 2 == 0 and f"{counted:,} events in 1.9 s" in said
    record = json.loads((tmp_path / "map.run.json").read_text())
    assert {each["path"] for each in record["inputs"]} == set(map(str, inputs))
    assert all(len(each["sha256"]) == 64 for each in record["inputs"])


def test_odometry_is_read_from_the_tracks_that_simulate_writes(tmp_path, run):
    run("simulate", "-o", tmp_path / "pair", "--sensor", "tiny", "--length", 10)
    track = tmp_path / "pair/reference_track.csv"
    words = ["map", tmp_path / "pair/reference.npz", "-o", tmp_path / "map.npz", "--pixels", 10]
    run(*words, "--sigma", 1, "--tau", "200ms", "--odometry", track)
    made = ev.ReferenceMap.load(tmp_path / "map.npz")
    expected = ev.load_track(track).at(made.places.centre_us)[:, 0]
    assert np.abs(made.odometer_mm / 1e3 - expected).max() < 0.002


def test_a_map_of_odometry_alone_says_how_far_its_matches_are(folder, tmp_path):
    pytest.importorskip("pandas", reason="pandas is an extra")
    odometry = ev.load_odometry(folder / "monday.csv")
    made = ev.ReferenceMap.build(folder / "monday.npz", odometry=odometry, **SMALL)
    result = made.match(folder / "tuesday.npz")
    result.save(tmp_path / "results")
    with (tmp_path / "results/matches.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [*TABLE, *ALONG]
    driven, within = made.odometer_mm / 1e3, made.settings.exclusion_places
    for row, metres in zip(rows, result.along_m, strict=True):
        place = int(row["place"])
        ends = driven[max(place - within, 0)], driven[min(place + within, len(made) - 1)]
        assert [row[name] for name in ALONG] == [f"{at:.2f}" for at in (driven[place], *ends)]
        assert metres == driven[place]
    assert result.to_frame()["along_m"].tolist() == result.along_m.tolist()
    assert made.info().lines["positions"] == f"none; {made.info().route_m:,.0f} m by odometry"


def test_the_period_of_frames_is_kept_in_the_map(tmp_path, run, refused):
    rng = np.random.default_rng(2)
    for name in ("a", "b"):
        frames = rng.integers(0, 4, (30, 12, 16)).astype(np.uint8)
        np.savez(tmp_path / f"{name}.npz", frames=frames)
    first, second, mapped = (tmp_path / f"{name}.npz" for name in ("a", "b", "map"))
    words = ["map", first, "-o", mapped, "--pixels", 5, "--sigma", 1, "--tau", "100ms"]
    assert "pass --frame-period" in refused(*words)
    run(*words, "--frame-period", "1/10")
    result, live = tmp_path / "result", ["--online", "--every", "100ms", "-o", tmp_path / "live"]
    run("match", mapped, second, "--no-figures", "-o", result)
    run("match", mapped, second, "--no-figures", *live)
    matched = ev.ReferenceMap.load(mapped).match(second).matches
    assert matched == ev.MatchResult.load(result).matches
    (tmp_path / "truth.csv").write_text("query_frame,reference_frame\n0,0\n29,29\n")
    run("evaluate", result, "--ground-truth", tmp_path / "truth.csv", "--tolerance", 2)
    with pytest.raises(UsageError, match="pass frame_period="):
        ev.open_recording(first)
    opened = ev.open_recording(first, frame_period="1/10")
    assert opened.frame_period == ev.ReferenceMap.load(mapped).frame_period


def test_a_map_of_the_events_of_frames_differs_by_their_period_alone(tmp_path):
    """It cannot know how long a frame of the query lasts."""
    frames = np.random.default_rng(2).integers(0, 4, (100, 12, 16)).astype(np.uint8)
    np.savez(tmp_path / "frames.npz", frames=frames)
    drive = ev.open_recording(tmp_path / "frames.npz", frame_period="1/30")
    events, small = join_events(list(drive)), {"pixels": 5, "sigma": 1}
    of_frames = ev.ReferenceMap.build(drive, **small)
    of_events = ev.ReferenceMap.build(events, sensor=drive.sensor, **small)
    assert of_events != of_frames
    assert dataclasses.replace(of_events, frame_period=Fraction(1, 30)) == of_frames
    of_frames.match(tmp_path / "frames.npz")
    with pytest.raises(UsageError, match="pass frame_period="):
        of_events.match(tmp_path / "frames.npz")
    of_events.match(drive)


@pytest.mark.parametrize(("stated", "places"), [("1", 8), ("1/30", 15)])
def test_frames_as_long_as_a_window_have_places_at_whole_windows(stated, places, tmp_path):
    """The halves of such a frame were not measured; whether the file states its length or not."""
    period = float(Fraction(stated))
    frames = np.random.default_rng(1).integers(0, 4, (round(8 / period), 12, 16)).astype(np.uint8)
    np.savez(tmp_path / "given.npz", frames=frames)
    np.savez(tmp_path / "stated.npz", frames=frames, window_s=period)
    for name, frame_period in (("given", stated), ("stated", None)):
        drive = ev.open_recording(tmp_path / f"{name}.npz", frame_period=frame_period)
        assert drive.frame_period == Fraction(stated)
        assert len(ev.ReferenceMap.build(drive, pixels=5, sigma=1)) == places


def wrong_uses():
    """What a newcomer may do with a drive and a map, by the words that the message must have."""
    build, many = ev.ReferenceMap.build, {"pixels": 5}
    return {
        "pixls.*did you mean pixels": lambda d, r: build(d, pixls=5),
        "did you mean precision": lambda d, r: r.match(d, precison=0.9),
        "localiser has.*did you mean exclusion": lambda d, r: r.localiser(exlusion=1),
        "preset 'defualt' is unknown": lambda d, r: build(d, "defualt"),
        "settings is a dict: give Settings": lambda d, r: build(d, many),
        "setting pixels = 'many'": lambda d, r: build(d, pixels="many"),
        "tau = 0.5 has no unit": lambda d, r: build(d, tau=0.5),
        "tau = '0.5': expected a time such as 1s": lambda d, r: build(d, tau="0.5"),
        "the recording is None: give a path": lambda d, r: build(None),
        "event data does not say how large its sensor": lambda d, r: build(events_of(0)),
        "pixel_map is a list: give a PixelMap": lambda d, r: build(d, pixel_map=[(1, 2)]),
        "hot is a list: give an array of bool": lambda d, r: build(d, hot=[1]),
        "array of float64: give one of bool": lambda d, r: build(d, hot=np.zeros((12, 16))),
        "tau = 500 has no unit": lambda d, r: build(d, tau=500),
        "open_recording.recording, frame_period='1/30'": lambda d, r: build(d, frame_period="1/30"),
        "open_recording.recording, on_fault='drop'": lambda d, r: r.match(d, on_fault="drop"),
        "smooth=True needs all later": lambda d, r: r.localiser(smooth=True),
        "track is an int": lambda d, r: build(d, track=5),
        "path of odometry is a list": lambda d, r: build(d, odometry=[1, 2]),
        "every is an int .5.: give a text": lambda d, r: r.match(d, every=5),
        "expected event, a number": lambda d, r: r.match(d, every="often"),
        "settings is a str": lambda d, r: r.match(d, settings="default"),
        "path of a reference map is None": lambda d, r: ev.ReferenceMap.load(None),
        "path of a reference map is an int": lambda d, r: r.save(5),
        "path of a folder of results is None": lambda d, r: r.match(d).save(None),
        "truth is None: give the track": lambda d, r: r.match(d).evaluate(None),
        "give for example tolerance_m": lambda d, r: r.match(d).evaluate(("a.csv", "b.csv")),
        "matches is a MatchResult: give": lambda d, r: ev.evaluate(r.match(d), None),
        "truth is an Alignment, .* give from_alignment": lambda d, r: r.match(d).evaluate(
            ev.Alignment([[0, 0], [1, 1]], "s"), 1
        ),
        "path of count frames is an array": lambda d, r: ev.PublishedWindows(np.ones(3)),
        "track of the reference is a str": lambda d, r: ev.from_tracks("a", "b", [1], [1], 1),
        "the path of a recording is None": lambda d, r: ev.open_recording(None),
        "window is a str": lambda d, r: ev.DescriptorStream(r.pixel_map, "1s"),
        "sensor is None": lambda d, r: ev.BurstFilter(None),
        "events are None": lambda d, r: ev.BurstFilter(SENSOR).update(None),
        "reference is a str": lambda d, r: ev.Localiser("map.npz"),
        "events are a list": lambda d, r: r.localiser().update([1, 2]),
        "without the fields t, x, y": lambda d, r: r.localiser().update(np.zeros(3)),
        "column t holds <U1": lambda d, r: ev.make_events("a", "b", "c"),
        "places is None": lambda d, r: ev.match_descriptors(None, None, r.settings),
        "saliency has shape": lambda d, r: ev.select_pixels(None, 5, rng=None),
        "rng is an int .0.: give numpy": lambda d, r: ev.select_pixels(np.ones((5, 5)), 5, rng=0),
        "the recording is a bytes": lambda d, r: ev.describe(
            b"monday.raw", r.pixel_map, r.settings
        ),
        "events are None: make": lambda d, r: ev.crop(None, 0, 0, 5, 5),
        "table is None: give an array": lambda d, r: ev.count_events(None, None, None, None),
        "time_us is a float": lambda d, r: r.localiser().read_odometer(1e20, 0.0),
        "distance_m is None: give metres": lambda d, r: r.localiser().read_odometer(0, None),
        "flags is a str": lambda d, r: ev.resolve_settings(flags="pixels=4"),
    }


@pytest.mark.parametrize("words", wrong_uses())
def test_wrong_use_is_one_sentence_with_the_remedy(words, route):
    drive = Drive(events_of(0), SENSOR)
    with pytest.raises(EdgeVprError, match=words):
        wrong_uses()[words](drive, route)


def test_settings_may_be_numbers_of_numpy(folder, route):
    made = ev.ReferenceMap.build(
        folder / "monday.npz", track=folder / "monday.csv", **SMALL | {"pixels": np.int64(5)}
    )
    assert made == route
    result = route.match(folder / "tuesday.npz", precision=np.float64(0.5), smooth=np.False_)
    assert result.matches.settings == route.settings.replaced(
        {"precision": 0.5, "smooth": False}, "test"
    )


@pytest.mark.parametrize(
    ("from_s", "until_s", "says"),
    [
        (1.6e9, 1.6e9 + 40, r"covers 1,600,000,000 to .* recording's clock, shift it by -"),
        (50, 90, r"covers 50 to 90 s .*; or, if both begin together, shift it by -50 s \(Track"),
        (-50, -10, r"covers -50 to -10 s .* shift it by 50 s"),
        (0, 4e-5, r"covers 0 to 4e-05 s .*: give the log of this drive, with its .* stated$"),
    ],
)
def test_a_track_without_time_in_common_with_its_recording_is_refused(from_s, until_s, says):
    events = events_of(0, seconds=40.0)
    table = {name: events[name] for name in "xyp"} | {"t": events["t"] + round(1.6e15 + 5e6)}
    times = [round(from_s * 1e6), round(until_s * 1e6)]
    track = ev.Track(times, [[0.0], [100.0]], max_gap_us=10**8)
    with pytest.raises(EdgeVprError, match=says):
        ev.ReferenceMap.build(table, sensor=SENSOR, track=track, **SMALL)


def test_types_of_public_names_can_be_read():
    """As by programs that check arguments; pandas and Matplotlib are not loaded for it."""
    optional = {"pandas": SimpleNamespace(DataFrame=Any), "Axes": Any}
    optional |= {"ContrastCode": Any}
    # a map's methods take and return what later stages make
    inputs = ("AnyRecording", "AnyTrack", "AnyOdometry", "Removed")
    later = (*inputs, "MapUpdate", "MatchResult", "Localiser", "MatchSchedule")
    optional |= dict.fromkeys(later, Any)
    for public in (getattr(ev, name) for name in ev.__all__):
        members = [public]
        if isinstance(public, type):
            made = () if dataclasses.is_dataclass(public) else ("__init__",)
            members = [of for name, of in vars(public).items() if name[0] != "_" or name in made]
        for each in members:
            function = getattr(each, "fget", None) or getattr(each, "__func__", each)
            if inspect.isfunction(function):
                hints = get_type_hints(function, localns=optional)
                assert hints.keys() == function.__annotations__.keys()


def test_a_path_is_taken_where_a_recording_is(route, tmp_path):
    drive, path = Drive(events_of(0), SENSOR), tmp_path / "drive.npz"
    ev.write_recording(path, drive)
    counted = ev.describe(path, route.pixel_map, route.settings.uncoded)
    assert counted == ev.describe(drive, route.pixel_map, route.settings.uncoded)
    with pytest.raises(EdgeVprError, match="or counts with settings"):
        ev.describe(path, route.pixel_map, route.settings)


def test_a_map_says_what_its_windows_have(tmp_path, run):
    """5 pixels of a sensor of 4 x 3, which all fire alike: 0.8 events each in a window."""
    sensor = ev.Sensor(4, 3)
    events = random_events(np.random.default_rng(0), 2_000, sensor, 20_000_000)
    ev.write_recording(tmp_path / "slow.npz", events, sensor=sensor)
    words = ["map", tmp_path / "slow.npz", "-o", tmp_path / "map.npz", "--pixels", 5]
    said = re.search(
        r"window +0.1 s, (0\.\d+) events for each selected pixel; --tau auto makes it 0\.(\d) s",
        run(*words, "--sigma", 0.1, "--tau", "100ms").out,
    )
    assert said is not None
    window = ev.fitting_window(ev.ReferenceMap.load(tmp_path / "map.npz"))
    assert window.travel_m is None and f"{window.events_per_pixel:.2g}" == said[1]
    assert window.events_per_pixel == pytest.approx(0.8, abs=0.1)
    assert window.tau_us == int(said[2]) * 100_000 == pytest.approx(400_000, abs=100_000)


def test_only_windows_of_fixed_time_are_fitted():
    drive = Drive(events_of(0, 5.0), SENSOR)
    counted = ev.ReferenceMap.build(
        drive, pixels=5, sigma=0.1, window="count", events_per_pixel=2.0
    )
    with pytest.raises(UsageError, match="window=count"):
        ev.fitting_window(counted)
