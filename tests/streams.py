"""Event streams and descriptors for tests: random ones, cut up, and as the oracle takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from edge_vpr.descriptors.counting import cleaned
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors, narrow
from edge_vpr.events import Events, Sensor, join_events, make_events
from edge_vpr.live.protocols import Health
from edge_vpr.map_making import coded_map
from edge_vpr.matching.match import MATCH_DTYPE, Match
from edge_vpr.online.localiser import Localiser
from edge_vpr.recordings import Recording, open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings


def random_events(rng: np.random.Generator, n: int, sensor: Sensor, duration_us: int) -> Events:
    """`n` events at random pixels and times, in time order."""
    return make_events(
        np.sort(rng.integers(0, duration_us, n)),
        rng.integers(0, sensor.width, n),
        rng.integers(0, sensor.height, n),
        rng.integers(0, 2, n),
    )


def centres(windows: int) -> np.ndarray:
    """Centres of consecutive windows of one second, in microseconds."""
    return np.arange(windows) * 1_000_000 + 500_000


def records(matches: Sequence[Match]) -> np.ndarray:
    """Live matches as a localiser returns them."""
    fields = len(MATCH_DTYPE.names)
    return np.array([match[:fields] for match in matches], dtype=MATCH_DTYPE)


def write_drives(folder: Path, n: int, sensor: Sensor, duration_us: int) -> None:
    """Write the random drives reference.npz and query.npz of `n` events each."""
    rng = np.random.default_rng(0)
    for name in ("reference", "query"):
        events = random_events(rng, n, sensor, duration_us)
        write_recording(folder / f"{name}.npz", [events], sensor=sensor)


def cut_up(rng: np.random.Generator, events: Events, pieces: int) -> list[Events]:
    """The same events in `pieces` chunks, some of them empty."""
    cuts = [0, *np.sort(rng.integers(0, len(events) + 1, pieces - 1)).tolist(), len(events)]
    return [events[begin:end] for begin, end in pairwise(cuts)]


def split_events(events: Events, cuts) -> list[Events]:
    """The same events cut before some of them, or into a number of parts of about one length."""
    parts = np.array_split(np.arange(len(events)), cuts)
    return [events[part[0] : part[-1] + 1] if part.size else events[:0] for part in parts]


def as_tuples(events: Events) -> list[tuple[int, int, int, bool]]:
    """Events as the oracle takes them."""
    return [(t, x, y, p) for t, x, y, p in events.tolist()]


def resumed(localiser: Localiser) -> Localiser:
    """Another localiser that goes on from the state of this one."""
    other = localiser.fresh()
    other.resume(localiser.to_arrays(), localiser.now_us, localiser.floor_us)
    return other


def descriptors(counts) -> Descriptors:
    """Windows of a millisecond with these counts, shape (n, J)."""
    counts = np.asarray(counts)
    start = np.arange(len(counts), dtype=np.int64) * 1_000
    events = counts.sum(axis=1).astype(np.int64)
    return Descriptors(narrow(counts), start, start + 1_000, events)


def map_of_counts(pixels: PixelMap, counts, settings: Settings, **more) -> ReferenceMap:
    """A map whose places have these counts, shape (K, J), coded as the settings say."""
    figures = np.zeros((pixels.sensor.height, pixels.sensor.width), dtype=np.float32)
    counted = ReferenceMap(settings.uncoded, pixels, descriptors(counts), figures, figures > 0)
    return replace(coded_map(counted, settings), **more)


def matched_live(reference: ReferenceMap, recording, every):
    """The matches that a localiser makes of a recording, cleaned as the map says."""
    localiser = Localiser(reference, every=every)
    parts = cleaned(recording, reference.settings)
    return np.concatenate([localiser.update(part) for part in parts])


def with_sums(matches, length: int = 1):
    """Records of MATCH_DTYPE with the exact sums over L windows that the distances are means of."""
    with_fields = matches.astype([(name, matches.dtype[name]) for name in matches.dtype.names])
    sums = {"distance": np.rint(matches["distance"] * length)}
    second = np.nan_to_num(matches["second_distance"], nan=-1 / length)
    sums["second_distance"] = np.rint(second * length)
    for name, values in sums.items():
        with_fields[name] = values
    return with_fields


def from_first(events: Events) -> Events:
    """The same events with times from the first one."""
    shifted = events.copy()
    shifted.t -= events.t[0]
    return shifted


def read_events(path, **options) -> Events:
    """All events of a recording."""
    return join_events(list(open_recording(path, **options)))


def absolute(path, **options) -> tuple[Events, Recording]:
    """Events of a recording with times on the file's own clock, and the recording."""
    recording = open_recording(path, **options)
    events = join_events(list(recording)).copy()
    events.t += recording.start_us
    return events, recording


class Drive:
    """Events in memory as a recording, in chunks of a given size."""

    def __init__(self, events: Events, sensor: Sensor, chunk: int = 1000) -> None:
        self.sensor = sensor
        self._chunks = [events[i : i + chunk] for i in range(0, events.size, chunk)]

    def __iter__(self):
        return iter(self._chunks)


def balanced(health: Health) -> bool:
    """Whether both sums of the health of a stream hold."""
    return (
        health.bytes == health.decoded_bytes + health.skipped_bytes + health.pending_bytes
        and health.decoded == health.events + health.rejected + health.held
    )
