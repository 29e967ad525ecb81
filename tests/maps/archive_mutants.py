"""Maps, states and other files of ours, changed at random; and what they must give if accepted."""

from __future__ import annotations

import io
import json
import re
import tomllib
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import numpy as np
from archive_oracle import check_layout, check_loaded_map, check_loaded_state
from edge_vpr_tools.commands.estimate import calibrated
from edge_vpr_tools.estimate import targets
from edge_vpr_tools.profile.conditions import Conditions
from edge_vpr_tools.profile.meter_trace import read_csv
from edge_vpr_tools.profile.profiling import SCHEMA, Profile
from edge_vpr_tools.profile.show import check_shown
from streams import descriptors, random_events

from edge_vpr.archive import read_members
from edge_vpr.confidence import Confidence
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.errors import LONGEST_MESSAGE, EdgeVprError, printable
from edge_vpr.evaluation.ground_truth import load_alignment, load_matrix
from edge_vpr.evaluation.tables import load_jumps, load_odometry
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.events import Sensor
from edge_vpr.live.protocols.aer import Layout, read_layout
from edge_vpr.map_record import coded_map
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.online.localiser import Localiser, MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Route
from edge_vpr.settings import Settings, resolve_settings
from firmware_model.design import Design
from firmware_model.errors import DesignError

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
    {"matching": "filter", "counter_code": "log", "counter_scaling": "contrast"},
    {"matching": "filter", "counter_code": "log", "counter_scaling": "contrast", "smooth": True},
    {
        "matching": "filter",
        "counter_code": "log",
        "counter_scaling": "own-mean",
        "counter_bits": 2,
        "query_mean": "running",
        "window": "count",
        "polarity": True,
        "precision": 0.9,
    },
)
#: what a number in a header, or in an array, becomes
ODD = (0, 1, -1, 2, 5, 255, 256, 65_535, 65_536, 2**31, 2**32, 2**60, 2**63 - 1, -(2**63), 10**30)
ODDITIES = (*ODD, True, None, "", "time", "count", [], {}, [1, 2], 0.5, float("nan"), float("inf"))
DTYPES = ("u1", "u2", "u4", "u8", "i1", "i4", "i8", "f4", "f8", "?", ">u2", ">i8", "U3")


def map_of(
    variant: dict[str, object], rng: np.random.Generator, largest: int | None = None
) -> ReferenceMap:
    """Make a map of a few places at four pixels, with a table of probabilities and a route."""
    settings = Settings(pixels=4, tau_us=100, sequence_length=2, remove_bursts=False)
    settings = settings.replaced(variant, "test")
    counters = 8 if settings.polarity else 4
    if largest is None:
        largest = int(rng.choice([3, 20, 300, 70_000]))
    places = descriptors(rng.integers(0, largest + 1, (int(rng.integers(3, 12)), counters)))
    figures = np.zeros((SENSOR.height, SENSOR.width), dtype=np.float32)
    counted = ReferenceMap(settings.uncoded, PIXELS, places, figures, figures > 0)
    confidence = Confidence(
        np.array([-5, 40, 2_000]), np.array([0.2, 0.5, 0.95]), np.array([9, 8, 200])
    )
    along = np.where(rng.random(len(places)) < 0.8, np.arange(len(places)) * 2.5, np.nan)
    along[0] = 0.0
    position = np.stack([along, -along], axis=1)
    route = Route(position, along, "metric")
    return replace(coded_map(counted, settings), confidence=confidence, route=route)


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
        match_descriptors(reference.places, queries, reference.settings, reference.confidence).save(
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
    _write_plain_values(new)
    return files


def _write_plain_values(new: Callable[[str, str], Path]) -> None:
    """Write a layout, designs, targets, a profile and a meter's trace."""
    new("layout", ".toml").write_text(
        'bytes = 5\nendian = "big"\nx = { shift = 1, bits = 7 }\ny = { shift = 8, bits = 6 }\n'
        "p = { shift = 0, on = 0 }\nt = { shift = 16, bits = 20, tick_us = 2 }\n"
        "sync = { mask = 0x8000, value = 0x8000 }\n"
    )
    new("layout", ".toml").write_text(
        'bytes = 2\nendian = "little"\nx = {shift = 0, bits = 5}\ny = {shift = 5, bits = 5}\n'
    )
    Design(width=40, height=30, pixels=20, places=50).save(new("design", ".toml"))
    Design(width=40, height=30, pixels=20, places=50, matching="filter", code="own-mean").save(
        new("design", ".toml")
    )
    for name in targets.names():
        path = Path(targets.__file__).with_name("targets") / f"{name}.toml"
        new("target", ".toml").write_bytes(path.read_bytes())
    new("profile", ".json").write_text(json.dumps(plain_profile()))
    lines = "".join(f"{i / 10},{2 + i % 7 / 10},{0.5 + i % 3}\n" for i in range(40))
    new("meter", ".csv").write_text("time_s,voltage_v,current_a\n" + lines)


def plain_profile() -> dict[str, object]:
    """Give what `edge-vpr profile` writes, with joules."""
    interval = [0.9, 1.2]
    sensor = {
        "name": "meter.csv", "kind": "power", "scope": "the board", "period_s": 0.1,
        "resolution": 0.01, "gain_error": 0.01, "detail": "made up",
    }  # fmt: skip
    energy = {
        "measured": True, "resolved": True, "quick": True, "pairs": 5, "window_s": 10.0,
        "pairs_needed": None, "native_samples_per_window": 100, "cpu_s_per_match": 0.001,
        "marginal_j_per_match": 1.0, "marginal_j_per_match_interval": interval,
        "marginal_j_per_match_interval_with_gain": interval, "saturated_matches_per_s": 9.0,
        "saturated_j_per_match": 2.0, "saturated_j_per_match_interval": [1.5, 2.5],
        "mission_matches_per_s": 1.0, "mission_j_per_match": 3.0,
        "mission_j_per_match_interval": [2.5, 3.5], "matches_per_joule": 1.0,
        "matches_per_joule_interval": interval, "idle_w": 2.0, "idle_w_interval": [1.9, 2.1],
        "load_w": 3.0, "differences_w": [1.0], "windows": [], "sampler_cpu_share": 0.01,
        "trace": {"time_s": [0.5], "watts": [2.0]}, "sensor": sensor,
    }  # fmt: skip
    known = {"frequency_hz": 1e9, "temperature_c": 50.0}
    conditions = {field.name: known.get(field.name) for field in fields(Conditions)}
    speed = {
        "seconds": 1.0, "events_per_s": 1e6, "matches_per_s": 1e3, "times_real_time": 9.0,
        "latency_p50_s": 1e-4, "latency_p99_s": 1e-3, "calls_with_a_match": 99,
        "cpu_s_per_match": 1e-3, "cpu_share": 1.0, "peak_memory_bytes": 10**8,
        "events_a_round": 1000,
    }  # fmt: skip
    moments = dict.fromkeys(("before", "loaded", "after"), conditions)
    versions = {"python": "3.11"}
    return {
        "schema": SCHEMA, "quick": True, "throughput": speed, "energy": energy,
        "map": {"places": 19, "pixels": 25, "bytes_per_place": 60, "sequence_length": 5},
        "conditions": {**moments, "void_because": ""},
        "load": {"recording": "query.npz", "packet": 512, "every": "window"},
        "provenance": {
            "board": None, "processor": "x86", "kernel": "6", "clock_hz": 1e9, "governor": None,
            "sensor": None, "shunt_mohm": None, "versions": versions,
        },
        "run": {
            "schema": 1, "command": ["edge-vpr"], "finished_utc": "2026-01-01T00:00:00Z",
            "settings": {}, "versions": versions, "inputs": [],
            "machine": {"system": "Linux", "processor": "x86"},
        },
    }  # fmt: skip


def checksum(body: str) -> int:
    """Give the checksum of an NMEA sentence."""
    total = 0
    for byte in body.encode():
        total ^= byte
    return total


@cache
def _members(original: Path) -> dict[str, np.ndarray]:
    return read_members(original)


def mutant(original: Path, rng: np.random.Generator) -> bytes:
    """Change a file: its bytes, its arrays and header, or the header of one array."""
    raw = original.read_bytes()
    if original.suffix != ".npz" or rng.random() < 0.2:
        return _other_bytes(raw, rng)
    if rng.random() < 0.25:
        return _other_npy(raw, rng)
    arrays = dict(_members(original))
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
        at, what = int(rng.integers(len(changed))), rng.integers(8)
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
        elif what > 5 and (numbers := list(re.finditer(rb"\d+", changed[:20_000]))):
            number = numbers[int(rng.integers(len(numbers)))]
            near = int(number[0][:20]) + int(rng.choice([-1, 1, 7]))
            value = near if rng.random() < 0.7 else int(ODD[int(rng.integers(len(ODD)))])
            changed[number.start() : number.end()] = str(value).encode()
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
    what = rng.integers(14)
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
        if what < 9:
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
    except (EdgeVprError, DesignError) as error:
        text = printable(error) if isinstance(error, DesignError) else str(error)
        assert text.isprintable(), text
        assert 0 < len(text) <= LONGEST_MESSAGE, text
        return False
    if isinstance(loaded, ReferenceMap):
        check_loaded_map(loaded)
    elif isinstance(loaded, Localiser):
        check_loaded_state(loaded, path)
    elif isinstance(loaded, Layout):
        check_layout(loaded)
    elif isinstance(loaded, Design):
        assert Design.from_dict(tomllib.loads(loaded.to_toml())) == loaded
    return True


def _shown_profile(path: Path) -> object:
    found = Profile.load_file(path)
    check_shown(found, path)
    return calibrated(path)


def load_map(path: Path) -> ReferenceMap:
    """Read a map; that its table is of an earlier version is a warning here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return ReferenceMap.load(path)


LOADERS: dict[str, Callable[[Path], object]] = {
    "map": load_map,
    "state": Localiser.load,
    "matches": Matches.load,
    "settings": lambda path: resolve_settings(config=path),
    "track": load_track,
    "alignment": load_alignment,
    "matrix": load_matrix,
    "odometry": load_odometry,
    "jumps": lambda path: load_jumps(path, 6),
    "layout": read_layout,
    "design": Design.load,
    "target": targets.Target.load,
    "profile": _shown_profile,
    "meter": read_csv,
}
