"""Files of every kind that edge-vpr reads beside recordings, and their readers."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
from edge_vpr_tools.estimate import targets
from edge_vpr_tools.profile.conditions import Conditions
from edge_vpr_tools.profile.meter_trace import read_meter
from edge_vpr_tools.profile.profiling import SCHEMA, Profile
from edge_vpr_tools.profile.show import check_shown

from edge_vpr.archive import Arrays
from edge_vpr.confidence import Confidence
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.evaluation.ground_truth import load_alignment, load_matrix
from edge_vpr.evaluation.tables import load_odometry
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.events import Sensor
from edge_vpr.live.protocols.aer import read_layout
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Route
from edge_vpr.settings import Settings, resolve_settings
from firmware_model.design import Design
from tests.streams import descriptors, map_of_counts

SENSOR = Sensor(6, 5)
PIXELS = PixelMap(SENSOR, np.array([0, 5, 2, 1]), np.array([0, 4, 3, 0]))
#: settings of the saved maps: sequences, clipped counts, the place filter, and the default codes
VARIANTS: tuple[dict[str, object], ...] = (
    {},
    {"window": "count", "events_per_pixel": 2.0, "clip": 3},
    {"matching": "filter", "precision": 0.9},
    {"matching": "filter", "counter_code": "contrast"},
)


def map_of(
    variant: dict[str, object], rng: np.random.Generator, largest: int | None = None
) -> ReferenceMap:
    """Make a map of a few places at four pixels, with a table of probabilities and a route."""
    settings = Settings(pixels=4, tau_us=100, sequence_length=2, remove_bursts=False)
    settings = settings.replaced(variant, "test")
    if largest is None:
        largest = int(rng.choice([3, 20, 300, 70_000]))
    places = rng.integers(0, largest + 1, (int(rng.integers(3, 12)), 4))
    confidence = Confidence(
        np.array([-5, 40, 2_000]), np.array([0.2, 0.5, 0.95]), np.array([9, 8, 200])
    )
    along = np.where(rng.random(len(places)) < 0.8, np.arange(len(places)) * 2.5, np.nan)
    along[0] = 0.0
    position = np.stack([along, -along], axis=1)
    route = Route(position, along, "metric")
    return map_of_counts(PIXELS, places, settings, confidence=confidence, route=route)


def same_contents(read: tuple[Arrays, object], expected: tuple[Arrays, object]) -> bool:
    """Whether two archives hold the same, to the bit."""
    (arrays, meta), (whole, whole_meta) = read, expected

    def plain(arrays: Arrays) -> dict[str, object]:
        return {name: (a.dtype.str, a.shape, a.tobytes()) for name, a in arrays.items()}

    return meta == whole_meta and plain(arrays) == plain(whole)


def write_originals(folder: Path) -> dict[str, list[Path]]:
    """Write whole files of every kind, the same each time."""
    rng = np.random.default_rng(0)
    files: dict[str, list[Path]] = {kind: [] for kind in LOADERS}

    def new(kind: str, suffix: str) -> Path:
        files[kind].append(folder / f"{kind}{len(files[kind])}{suffix}")
        return files[kind][-1]

    for variant in VARIANTS:
        reference = map_of(variant, rng)
        if variant == VARIANTS[-1]:  # with all that a map may have
            way = np.arange(len(reference), dtype=np.int64) * 700
            reference = replace(reference, odometer_mm=way)
        reference.save(new("map", ".npz"))
        queries = descriptors(reference.places.counts[1:])
        settings = reference.settings.replaced({"gains": 1}, "codes of single windows")
        match_descriptors(reference.places, queries, settings, reference.confidence).save(
            new("matches", ".npz")
        )
        toml = [f"{name} = {json.dumps(value)}" for name, value in variant.items()]
        new("settings", ".toml").write_text('preset = "tiny"\n' + "\n".join(toml))
    rmc = "GPRMC,120000.00,A,2730.39720,S,15254.66132,E,10.0,90.0,010124,,"
    sentences = [rmc.replace("120000", f"12000{i}") for i in range(5)]
    new("track", ".nmea").write_text("".join(map(sentence, sentences)))
    points = "".join(
        f'<trkpt lat="-27.500{i}" lon="152.9"><time>2024-01-01T12:00:0{i}Z</time></trkpt>'
        for i in range(5)
    )
    new("track", ".gpx").write_text(f"<?xml version='1.0'?><gpx><trk>{points}</trk></gpx>")
    new("track", ".csv").write_text("time_s,x_m,y_m\n0,0,0\n1,2.5,0\n2,5,1\n")
    new("odometry", ".csv").write_text("time_s,distance_m\n0,0\n0.5,1.5\n1,3.5\n")
    new("odometry", ".csv").write_text("time_s,speed_mps\n0,0\n0.5,1.5\n1,3.5\n")
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
    Design(width=40, height=30, pixels=20, places=50, matching="filter", code="contrast").save(
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
    figures = {
        "pairs": 5, "window_s": 10.0, "pairs_needed": None,
        "marginal_j_per_match": 1.0, "marginal_j_per_match_interval": interval,
        "matches_per_joule": 1.0, "matches_per_joule_interval": interval,
        "idle_w": 2.0, "idle_w_interval": [1.9, 2.1], "load_w": 3.0,
    }  # fmt: skip
    windows = [
        {"load": load, "start_s": 10.0 * load, "end_s": 10.0 * load + 10, "matches": 9 * load}
        for load in (False, True)
    ]
    energy = {
        "figures": figures, "windows": windows, "sensor": sensor,
        "trace": {"time_s": [0.5], "watts": [2.0]},
    }  # fmt: skip
    measured = {"frequency_hz": 1e9, "temperature_c": 50.0}
    conditions = {field.name: measured.get(field.name) for field in fields(Conditions)}
    speed = {
        "events_per_s": 1e6, "matches_per_s": 1e3, "times_real_time": 9.0,
        "latency_p50_s": 1e-4, "latency_p99_s": 1e-3,
        "cpu_s_per_match": 1e-3, "peak_memory_bytes": 10**8,
    }  # fmt: skip
    moments = dict.fromkeys(("before", "loaded", "after"), conditions)
    versions = {"python": "3.11"}
    return {
        "schema": SCHEMA, "quick": True, "throughput": speed, "energy": energy,
        "conditions": {**moments, "void_because": ""},
        "recording": "query.npz", "board": None, "kernel": "6",
        "run": {
            "schema": 1, "command": ["edge-vpr"], "finished_utc": "2026-01-01T00:00:00Z",
            "settings": {}, "versions": versions, "inputs": [],
            "machine": {"system": "Linux", "processor": "x86"},
        },
    }  # fmt: skip


def sentence(body: str) -> str:
    """Give a sentence of NMEA with its checksum."""
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n"


def _shown_profile(path: Path) -> object:
    profile = Profile.load_file(path)
    check_shown(profile, path)
    return profile


LOADERS: dict[str, Callable[[Path], object]] = {
    "map": ReferenceMap.load,
    "matches": Matches.load,
    "settings": lambda path: resolve_settings(config=path),
    "track": load_track,
    "alignment": load_alignment,
    "matrix": load_matrix,
    "odometry": load_odometry,
    "layout": read_layout,
    "design": Design.load,
    "target": targets.Target.load,
    "profile": _shown_profile,
    "meter": read_meter,
}
