"""Maps, states and other files of ours, changed at random; and what they must give if accepted."""

from __future__ import annotations

import contextlib
import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import naive
import numpy as np
from streams import descriptors, random_events

from edge_vpr.archive import read_archive, read_members
from edge_vpr.descriptors.codes import codes_of
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import LONGEST_MESSAGE, EdgeVprError
from edge_vpr.evaluation.jump_files import load_jumps
from edge_vpr.evaluation.odometry_files import load_odometry
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.evaluation.truth_from_alignment import load_alignment
from edge_vpr.evaluation.truth_from_matrix import load_matrix
from edge_vpr.events import Sensor, make_events
from edge_vpr.matching.drive_matching import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.odometry import Odometry
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.pipeline import coded_map, match_query, window_of
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings, resolve_settings

SENSOR = Sensor(6, 5)
PIXELS = PixelMap(SENSOR, np.array([0, 5, 2, 1]), np.array([0, 4, 3, 0]))
#: settings that the originals have: both windows, polarity, and each way to code a count
VARIANTS: tuple[dict[str, object], ...] = (
    {},
    {"window": "count", "events_per_pixel": 2.0},
    {"polarity": True, "clip": 3},
    {"counter_code": "log", "counter_bits": 2, "counter_scaling": "per-pixel"},
    {"counter_code": "sqrt", "counter_bits": 4, "window": "count", "polarity": True},
    {"matching": "filter"},
    {"matching": "filter", "counter_code": "log", "counter_scaling": "own-mean"},
)
#: what a number in a header, or in an array, becomes
ODD = (0, 1, -1, 2, 5, 255, 256, 65_535, 65_536, 2**31, 2**32, 2**60, 2**63 - 1, -(2**63), 10**30)
ODDITIES = (*ODD, True, None, "", "time", "count", [], {}, [1, 2], 0.5, float("nan"), float("inf"))
DTYPES = ("u1", "u2", "u4", "u8", "i1", "i4", "i8", "f4", "f8", "?", ">u2", ">i8", "U3")


def map_of(variant: dict[str, object], rng: np.random.Generator) -> ReferenceMap:
    """Make a map of a few places at four pixels."""
    settings = Settings(pixels=4, tau_us=100, sequence_length=2, remove_bursts=False)
    settings = settings.replaced(variant, "test")
    counters = 8 if settings.polarity else 4
    largest = int(rng.choice([3, 20, 300, 70_000]))
    places = descriptors(rng.integers(0, largest + 1, (int(rng.integers(3, 12)), counters)))
    figures = np.zeros((SENSOR.height, SENSOR.width), dtype=np.float32)
    counted = ReferenceMap(settings.uncoded, PIXELS, places, figures, figures > 0)
    return coded_map(counted, settings)


def write_originals(folder: Path) -> dict[str, list[Path]]:
    """Write unspoilt files of every kind, the same each time."""
    rng = np.random.default_rng(0)
    files: dict[str, list[Path]] = {kind: [] for kind in LOADERS}

    def new(kind: str, suffix: str) -> Path:
        files[kind].append(folder / f"{kind}{len(files[kind])}{suffix}")
        return files[kind][-1]

    for variant in VARIANTS:
        reference = map_of(variant, rng)
        if variant == VARIANTS[-1]:  # with all that a map may have
            way = np.arange(len(reference), dtype=np.int64) * 700
            pairs = np.array([[2, 0], [0, 2]], dtype=np.int32)
            reference = replace(reference, jumps=pairs, odometer_mm=way)
        reference.save(new("map", ".npz"))
        for every in (MatchSchedule(events=1), MatchSchedule(interval_us=30, change=True)):
            localiser = Localiser(reference, every=every)
            localiser.update(random_events(rng, 60, SENSOR, 500))
            if reference.odometer_mm is not None:
                for i in range(5):  # in this window and the one before
                    localiser.read_odometer(501 + 50 * i, 0.2 * i)
            localiser.save(new("state", ".npz"))
        queries = descriptors(reference.places.counts[1:])
        match_descriptors(reference.places, queries, reference.settings).save(
            new("matches", ".npz")
        )
        toml = [f"{name} = {json.dumps(value)}" for name, value in variant.items()]
        new("settings", ".toml").write_text('preset = "tiny"\n' + "\n".join(toml))
    rmc = "GPRMC,120000.00,A,2730.39720,S,15254.66132,E,10.0,90.0,010124,,"
    sentences = [rmc.replace("120000", f"12000{i}") for i in range(5)]
    new("track", ".nmea").write_text("".join(f"${s}*{checksum(s):02X}\r\n" for s in sentences))
    points = "".join(
        f'<trkpt lat="-27.50{i}" lon="152.9"><time>2024-01-01T12:00:0{i}Z</time></trkpt>'
        for i in range(5)
    )
    new("track", ".gpx").write_text(f"<?xml version='1.0'?><gpx><trk>{points}</trk></gpx>")
    new("track", ".csv").write_text("time_s,x_m,y_m\n0,0,0\n1,2.5,0\n2,5,1\n")
    new("odometry", ".csv").write_text("time_s,distance_m\n0,0\n0.5,1.5\n1,3.5\n")
    new("odometry", ".csv").write_text("time_s,speed_mps\n0,0\n0.5,1.5\n1,3.5\n")
    new("jumps", ".csv").write_text("from,to\n0,5\n3,1\n")
    new("alignment", ".csv").write_text("query_s,reference_s\n0,0\n1.5,2\n4,5\n")
    truth = np.eye(4, dtype=np.uint8)
    np.save(new("matrix", ".npy"), truth)
    np.savez(new("matrix", ".npz"), gt=truth)
    np.savetxt(new("matrix", ".csv"), truth, delimiter=",")
    return files


def checksum(body: str) -> int:
    """Give the checksum of an NMEA sentence."""
    total = 0
    for byte in body.encode():
        total ^= byte
    return total


def mutant(original: Path, rng: np.random.Generator) -> bytes:
    """Change a file: its bytes, its arrays and header, or the header of one array."""
    raw = original.read_bytes()
    if original.suffix != ".npz" or rng.random() < 0.3:
        return _other_bytes(raw, rng)
    if rng.random() < 0.25:
        return _other_npy(raw, rng)
    arrays = read_members(original)
    for _ in range(int(rng.integers(1, 3))):
        name = str(rng.choice(list(arrays)))
        if name == "edge_vpr":
            arrays[name] = np.array(json.dumps(_other_meta(json.loads(str(arrays[name])), rng)))
        else:
            arrays[name] = _other_array(arrays, name, rng)
        if rng.random() < 0.05:
            del arrays[name]
        if not arrays:
            break
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _other_bytes(raw: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(raw)
    for _ in range(int(rng.integers(1, 4))):
        if not changed:
            break
        at, what = int(rng.integers(len(changed))), rng.integers(6)
        end = min(len(changed), at + int(rng.integers(1, 40)))
        if what == 0:
            changed[at] ^= 1 << int(rng.integers(8))
        elif what == 1:
            changed[at] = int(rng.choice([0, 1, 9, 10, 27, 34, 44, 48, 57, 91, 123, 127, 255]))
        elif what == 2:
            del changed[at:end]
        elif what == 3:
            changed[at:at] = changed[at:end] * int(rng.choice([1, 2, 300]))
        elif what == 4:
            changed[at:end] = rng.bytes(end - at)
        else:
            del changed[at:]
    return bytes(changed)


def _other_npy(raw: bytes, rng: np.random.Generator) -> bytes:
    """Change one member and write the archive with checksums that are right."""
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = str(rng.choice(list(members)))
    member = members[name]
    if rng.random() < 0.5:
        old, new = (
            [b"'<", b"|u", b"False", b"(", b",)", b"i8", b"u1", b"shape"],
            [b"'>", b"|O", b"True", b"(-", b",9999999999)", b"f8", b"u8", b"x"],
        )
        i = int(rng.integers(len(old)))
        members[name] = member.replace(old[i], new[i], 1)
    else:
        members[name] = _other_bytes(member[:128], rng) + member[128:]
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, value in members.items():
            archive.writestr(key, value)
    return file.getvalue()


def _other_meta(meta: dict[str, object], rng: np.random.Generator) -> dict[str, object]:
    inner: object = meta
    for _ in range(int(rng.integers(1, 3))):
        owner = inner
        if not isinstance(owner, dict) or not owner:
            break
        key = str(rng.choice(list(owner)))
        inner = owner[key]
        if isinstance(inner, dict) and rng.random() < 0.9:
            continue
        if isinstance(inner, list) and inner and rng.random() < 0.8:
            inner[int(rng.integers(len(inner)))] = _odd(inner[0], rng)
        elif rng.random() < 0.05:
            del owner[key]
        else:
            owner[key] = _odd(inner, rng)
        break
    return meta


def _odd(value: object, rng: np.random.Generator) -> object:
    """Give a value of the same type most of the time."""
    if isinstance(value, bool) and rng.random() < 0.7:
        return not value
    if isinstance(value, int | float) and rng.random() < 0.6:
        return value + int(rng.choice([-3, -1, 1, 2, 40]))
    return ODDITIES[int(rng.integers(len(ODDITIES)))]


def _other_array(arrays: dict[str, np.ndarray], name: str, rng: np.random.Generator) -> np.ndarray:
    array = arrays[name]
    what = rng.integers(8)
    if what == 0:
        return array.astype(str(rng.choice(DTYPES)))
    if what == 1 and array.ndim:
        axis = int(rng.integers(array.ndim))
        keep = int(rng.integers(array.shape[axis] + 1))
        return array.take(range(keep), axis=axis)
    if what == 2 and array.ndim:
        return np.repeat(array, 2, axis=int(rng.integers(array.ndim)))
    if what == 3:
        return array.reshape(-1) if rng.random() < 0.5 else array[None]
    if what == 4 and array.ndim == 2:
        return array.T
    if what == 5:
        return arrays[str(rng.choice([key for key in arrays if key != "edge_vpr"]))]
    changed = array.copy()
    if changed.size and changed.dtype.kind in "iuf":
        at = int(rng.integers(changed.size))
        flat = changed.reshape(-1)
        if what == 6:
            flat[at] = np.array([int(rng.choice(ODD[:9]))]).astype(changed.dtype)[0]
        else:
            flat[at] = flat[at] + np.array([int(rng.choice([-1, 1]))]).astype(changed.dtype)[0]
    return changed


def outcome(kind: str, path: Path) -> bool:
    """Load a file and hold what it gives to the oracle; False if it was refused.

    Raises
    ------
    Exception
        Anything but an error of ours, or an `AssertionError`: a find.
    """
    try:
        loaded = LOADERS[kind](path)
    except EdgeVprError as error:
        text = str(error)
        assert text.isprintable(), text
        assert 0 < len(text) <= LONGEST_MESSAGE, text
        return False
    if isinstance(loaded, ReferenceMap):
        check_loaded_map(loaded)
    elif isinstance(loaded, Localiser):
        check_loaded_state(loaded, path)
    return True


LOADERS: dict[str, Callable[[Path], object]] = {
    "map": ReferenceMap.load,
    "state": Localiser.load,
    "matches": Matches.load,
    "settings": lambda path: resolve_settings(config=path),
    "track": load_track,
    "alignment": load_alignment,
    "matrix": load_matrix,
    "odometry": load_odometry,
    "jumps": lambda path: load_jumps(path, 6),
}


def _beyond_the_oracle(settings: Settings) -> bool:
    """Whether matches are the place filter's, or codes change as a drive goes on."""
    return settings.matching == "filter" or settings.own_mean_code is not None


def _drive_on(localiser: Localiser, floor_us: int) -> None:
    """Feed random events, and nothing but errors of ours may come of it."""
    events = random_events(np.random.default_rng(3), 60, SENSOR, 800)
    events["t"] += floor_us
    with contextlib.suppress(EdgeVprError):
        localiser.update(events[:30])
        localiser.verify()
    with contextlib.suppress(EdgeVprError):
        localiser.read_odometer(int(events["t"][29]), 3.5)
    with contextlib.suppress(EdgeVprError):
        localiser.update(events[30:])
        localiser.verify()


def check_loaded_map(reference: ReferenceMap) -> None:
    """Match made-up windows and events, and compare with plain Python."""
    settings = reference.settings
    if _beyond_the_oracle(settings):
        with contextlib.suppress(EdgeVprError):
            match_query(reference, reference.places)
            times = np.arange(20, dtype=np.int64) * 35
            match_query(reference, reference.places, Odometry(times, times * 10))
        with contextlib.suppress(EdgeVprError):
            _drive_on(Localiser(reference), 0)
        return
    places = reference.places.counts.tolist()
    length = settings.sequence_length
    rng = np.random.default_rng(1)
    counters = reference.places.counts.shape[1]
    queries = rng.integers(0, 6, (4, counters)).tolist()
    coded = [_coded(reference, query) for query in queries]
    try:
        found = match_descriptors(reference.places, descriptors(coded), settings)
    except EdgeVprError:
        assert length > min(len(places), len(queries))
    else:
        sums = naive.sequence_sums(naive.distance_matrix(places, coded), length)
        offset = length // 2 if settings.anchor == "middle" else length - 1
        for i in range(len(found)):
            column = [row[i] for row in sums]
            best, second, ties = naive.best_and_second(column, settings.exclusion)
            assert (found.place[i], found.ties[i]) == (best + offset, ties)
            assert found.distance_sum[i] == column[best]
            assert found.second[i] == (-1 if second < 0 else second + offset)
    try:
        localiser = Localiser(reference)
    except EdgeVprError:
        return
    _follow(localiser, reference, [], 0, 0, rng)


def check_loaded_state(localiser: Localiser, path: Path) -> None:
    """Go on from a state, and compare with plain Python."""
    arrays, meta = read_archive(path, "localiser state")
    if _beyond_the_oracle(localiser.settings):
        _drive_on(localiser, meta["floor_us"])
        return
    selected = list(zip(arrays["time"].tolist(), arrays["slot"].tolist(), strict=True))
    reference = ReferenceMap(
        localiser.settings,
        PixelMap(Sensor(*meta["sensor"]), arrays["pixel_x"], arrays["pixel_y"]),
        _as_places(arrays["places"]),
        np.zeros(meta["sensor"][::-1], dtype=np.float32),
        np.zeros(meta["sensor"][::-1], dtype=np.bool_),
        arrays.get("full_scale"),
    )
    before = int(arrays["bound"][0]) - len(selected)
    _compare(localiser, reference, selected, meta["now_us"])
    rng = np.random.default_rng(2)
    _follow(localiser, reference, selected, meta["floor_us"], before, rng, meta["recent"])


def _follow(
    localiser: Localiser,
    reference: ReferenceMap,
    selected: list[tuple[int, int]],
    floor_us: int,
    before: int,
    rng: np.random.Generator,
    recent: int = 0,
) -> None:
    """Feed events at selected pixels one by one, each compared with the oracle's."""
    pixels = reference.pixel_map
    settings = reference.settings
    window = window_of(settings)
    tau = getattr(window, "tau_us", 0)
    step = min(max(tau // 3, 1), 10**6)
    t = floor_us
    for _ in range(10):
        t += int(rng.integers(0, step + 1))
        j, p = int(rng.integers(len(pixels))), bool(rng.integers(2))
        try:
            matches = localiser.update(make_events([t], [pixels.x[j]], [pixels.y[j]], [p]))
        except EdgeVprError:
            assert t > 2**59 or localiser.every.interval_us
            return
        selected.append((t, j if p or not settings.polarity else j + len(pixels)))
        lags = _compare(localiser, reference, selected, t + 1)
        every, length = localiser.every, settings.sequence_length
        if every.interval_us or every.change:
            continue
        number = before + len(selected)
        whole = t + 1 >= length * tau if tau else number >= length * window.events  # type: ignore[union-attr]
        assert len(matches) == (whole and number % every.events == 0)
        if len(matches):
            places = reference.places.counts.tolist()
            expected = naive.online_match(places, lags, settings.exclusion, recent)
            names = ("place", "distance_sum", "second", "second_sum")
            assert tuple(int(matches[0][name]) for name in names) == expected


def _compare(
    localiser: Localiser, reference: ReferenceMap, selected: list[tuple[int, int]], until: int
) -> list[list[int]]:
    """Hold counters and all distances to the oracle; returns the coded counters."""
    settings, places = reference.settings, reference.places.counts.tolist()
    length, window = settings.sequence_length, window_of(settings)
    tau = getattr(window, "tau_us", 0)
    lags = naive.lagged_counts(
        selected,
        until,
        length,
        len(places[0]),
        tau,
        0 if tau else window.events,  # type: ignore[union-attr]
    )
    assert localiser.counts.tolist() == lags
    coded = [_coded(reference, lag) for lag in lags]
    sums = [
        sum(naive.sad(places[k - i], coded[i]) for i in range(length))
        for k in range(length - 1, len(places))
    ]
    assert localiser.distance_sums.tolist() == sums
    return coded


def _coded(reference: ReferenceMap, counts: list[int]) -> list[int]:
    """Code counts by the oracle; by the tables where it would take minutes."""
    settings = reference.settings
    if settings.counter_code == "none":
        return [min(c, settings.clip) for c in counts] if settings.clip else counts
    codes = codes_of(settings, len(counts), reference.full_scale)
    assert codes is not None
    if settings.counter_bits > 6 or max(code.full_scale for code in codes.codes) > 300:
        return codes.encode(np.array(counts)).tolist()
    scales = [codes.codes[row].full_scale for row in codes.row.tolist()]
    return [
        naive.counter_code(settings.counter_code, settings.counter_bits, scale, count)
        for scale, count in zip(scales, counts, strict=True)
    ]


def _as_places(counts: np.ndarray) -> Descriptors:
    nothing = np.zeros(len(counts), dtype=np.int64)
    return Descriptors(counts, nothing, nothing, nothing)
