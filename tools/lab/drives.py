"""Pairs of drives: recorded ones that lie in a folder, published ones, simulated ones."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.published import PublishedWindows
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.ground_truth import Alignment, GroundTruth, from_alignment, load_alignment
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.events import Sensor
from edge_vpr.recordings import open_recording
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import QUERY, Drive, Light, SimulatedRecording, simulate_pair
from edge_vpr.simulation.drive import wheel_odometry
from lab.datasets import DATA_SETS, STAND_INS, Download, published_pairs, traverses_in
from lab.loop import Drives
from lab.pairs import (
    SIMULATED,
    CountedDrive,
    CountedPair,
    Kept,
    Pair,
    Times,
    Tracks,
    TruthOf,
    truths_of_tracks,
)

PAPER = PRESETS["paper"]
#: numbers of pixels with which each pair of drives is matched
NUMBERS = (25, PAPER.pixels)
INDOOR, WALKS, BRISBANE, LENS, DAY = (
    "speck_indoor",
    "speck_walks",
    "brisbane_sparse49",
    "brisbane_lens49",
    "brisbane_daytime",
)

# Pairs of recorded drives that lie in a folder: the stand-ins, and the published traverses.


def open_pairs(data: Path) -> Iterator[Pair]:
    """Open the pairs of drives in a folder, one after another, each with some numbers of pixels.

    Parameters
    ----------
    data : path
        Folder that holds the stand-ins, published traverses
        (`lab.datasets`), or some of them; or none.

    Raises
    ------
    GroundTruthError
        If the GPS log of a published traverse is missing.
    RecordingError
        If a recording cannot be read.
    """
    for folder, open_pair in _STAND_INS.items():
        if (data / folder).is_dir():
            yield from open_pair(data / folder)
    for published in published_pairs(data):
        tracks = Tracks(published.reference.track, published.query.track)
        metres = BRISBANE_M if published.tolerance_m == BRISBANE_M[0] else (published.tolerance_m,)
        yield from _with_numbers(
            Pair(
                published.name, published.reference.recording, published.query.recording, PAPER,
                truths_of_tracks(*tracks, *metres), tracks=tracks,
            )
        )  # fmt: skip


def _with_numbers(pair: Pair) -> Iterator[Pair]:
    for pixels in NUMBERS:
        yield replace(pair, settings=pair.settings.replaced({"pixels": pixels}, pair.drives))


@lru_cache(maxsize=1)
def _pairs(data: Path) -> tuple[Pair, ...]:
    """Open the pairs of a folder once, for as many draws of pixels as there are."""
    return tuple(open_pairs(data))


def whole_pairs(data: Path | None) -> list[Pair]:
    """Return the pairs of a folder of which all pixels were recorded, each once; perhaps none."""
    return [
        pair for pair in (_pairs(data) if data is not None else ())
        if pair.has_images and pair.settings.pixels == PAPER.pixels
    ]  # fmt: skip


def check_data(data: Path | None) -> None:
    """Check that a folder holds a pair of drives."""
    if data is not None:
        if any((data / folder).is_dir() for folder in _STAND_INS):
            return
        if any(len(traverses) > 1 for traverses in traverses_in(data).values()):
            return
    raise UsageError(without_pairs(data))


def check_logs(data: Path) -> None:
    """Check that the positions of every published traverse of a pair in a folder are there.

    Raises
    ------
    GroundTruthError
        If those of one are missing or cannot be read.
    """
    for traverses in traverses_in(data).values():
        for traverse, path in traverses:
            if len(traverses) > 1:
                traverse.origin(path.parent, 0)


def downloads(data: Path | None) -> list[Download]:
    """Return the files of all data sets, those of a traverse in the kind that a folder has."""
    chosen = []
    for traverses, _ in DATA_SETS.values():
        for traverse in traverses:
            kinds = traverse.downloads
            there = [one for one in kinds if data is not None and one.files[0].is_in(data)]
            chosen.append(there[0] if there else kinds[0])
    return [*chosen, *STAND_INS.values()]


def without_pairs(data: Path | None, folders: Collection[str] = tuple(STAND_INS)) -> str:
    """Return a sentence on why there is no pair of drives, and where drives come from."""
    where = "no folder was given with --data" if data is None else f"{data} holds no pair"
    lone = [] if data is None else [
        f"{title} {traverses[0][0].name}"
        for title, traverses in traverses_in(data).items()
        if len(traverses) == 1
    ]  # fmt: skip
    alone = f", only {' and '.join(lone)}" if lone else ""
    return (
        f"{where}{alone}: name a folder with two traverses or more of "
        f"{_published_text()} under their published names, or with one of the folders "
        f"{', '.join(folders)}; --dry-run lists all files, with sizes and addresses"
    )


def _published_text() -> str:
    """Return files of the first traverse of each data set, with sizes and addresses."""
    texts: dict[str, str] = {}
    for traverses, _ in DATA_SETS.values():
        one = traverses[0].downloads[0]
        texts.setdefault(one.title.partition(",")[0], one.text)
    return ", ".join(f"{title} (such as {files})" for title, files in texts.items())


# The stand-ins: short frames and counts that were made of published drives.


# No ground truth was published for speck_indoor. Matches of all pixels with long sequences show the
# query 8 frames ahead, from query frame 20 on (data set's README).
_INDOOR_LAG, _INDOOR_FROM, _INDOOR_TOLERANCE = 8, 20, 3
_INDOOR_PERIOD = Fraction(1)


def _indoor(folder: Path) -> Iterator[Pair]:
    first, second = (
        PublishedWindows(folder / f"{name}.npz", frame_period=_INDOOR_PERIOD)
        for name in ("reference", "query")
    )
    settings = PAPER.replaced({"sequence_length": 15}, "indoor")
    truths = {f"{_INDOOR_TOLERANCE} frames of 1 s": _truth_indoor}
    yield from _with_numbers(Pair("Speck indoor", first, second, settings, truths))


def _truth_indoor(places_us: Times, queries_us: Times) -> GroundTruth:
    # by the frames in which the windows lie, not by their centres
    period_us = int(_INDOOR_PERIOD * 1_000_000)
    places_us, queries_us = (times // period_us * period_us for times in (places_us, queries_us))
    first, last = _INDOOR_FROM, int(queries_us.max()) // period_us
    alignment = Alignment([[first, first - _INDOOR_LAG], [last, last - _INDOOR_LAG]], "frame")
    return from_alignment(
        alignment, places_us, queries_us, _INDOOR_TOLERANCE, frame_period=_INDOOR_PERIOD
    )


#: of the walks, not published with the data; windows have 30 frames whatever the period is
_FRAME_PERIOD = Fraction(1, 30)
_WALKS_TOLERANCE = 60.0
_WALKED = "Speck walks"
WALKS_SETTINGS = PAPER.replaced({"sequence_length": 10}, "speck walks")


def _walks(folder: Path) -> Iterator[Pair]:
    first, second = (
        Kept(open_recording(folder / f"{name}.npz", frame_period=_FRAME_PERIOD))
        for name in ("reference", "query")
    )
    truths = {f"{_WALKS_TOLERANCE:g} frames, about 2 s": truth_of_walks(folder)}
    yield from _with_numbers(Pair(_WALKED, first, second, WALKS_SETTINGS, truths))


def truth_of_walks(folder: Path) -> TruthOf:
    """Return the published alignment of the two walks as ground truth."""
    alignment = load_alignment(folder / "ground_truth.csv")

    def truth_of(places_us: Times, queries_us: Times) -> GroundTruth:
        return from_alignment(
            alignment, places_us, queries_us, _WALKS_TOLERANCE, frame_period=_FRAME_PERIOD
        )

    return truth_of


#: largest distances of a correct match on the streets of Brisbane, as in the literature
BRISBANE_M = (70.0, 25.0)
_BRISBANE_DRIVES = ("sunset2", "sunset1")
BRISBANE_SETTINGS = PAPER.replaced({"pixels": 49, "strategy": "top"}, "Brisbane")


def _brisbane(folder: Path) -> Iterator[Pair]:
    """Open counts at 49 published locations: a car, two drives of one route at sunset.

    Each value of this data sums a 3 x 3 patch in 8 bits and has wrapped past 255 in busy seconds.
    The route's start and end lie beside each other, so that the first queries may rightly match the
    last places.
    """
    first, second = (PublishedWindows(folder / f"{name}.npz") for name in _BRISBANE_DRIVES)
    tracks = Tracks(*(load_track(folder / f"{name}.nmea") for name in _BRISBANE_DRIVES))
    every = Pair(
        "Brisbane", first, second, BRISBANE_SETTINGS, truths_of_tracks(*tracks, *BRISBANE_M),
        drawn=False, tracks=tracks,
    )  # fmt: skip
    some = BRISBANE_SETTINGS.replaced({"pixels": 25, "strategy": "variance"}, "Brisbane")
    yield replace(every, settings=some, drawn=True)
    yield every


_STAND_INS = {INDOOR: _indoor, WALKS: _walks, BRISBANE: _brisbane}


# Simulated streets.


#: length of the streets whose windows are counted at every pixel, in metres
LENGTH_M = 450.0
#: of the streets from here on, which no parameter was chosen on
FIRST_SEED = 70


def simulated_pair(seed: int, **street: Any) -> Pair:
    """Simulate the pair of this seed; further arguments are those of `simulate_pair`."""
    reference, query = simulate_pair(seed, **street)
    return Pair.simulated(reference.keep(), query.keep())


def counted_street(seed: int) -> CountedPair:
    """Simulate the pair of this seed, and count it in windows of a number of events."""
    return simulated_pair(seed, length_m=LENGTH_M).counted(window="count")


class Second(NamedTuple):
    """A second drive along the street, and the contrast thresholds of its camera as a multiple."""

    drive: Drive
    contrast: float = 1.0


_LOW_SUN = replace(
    QUERY, light=Light(sun=0.2, ambient=0.15, azimuth_deg=110.0, elevation_deg=15.0, glare=0.06)
)
_HALF, _DOUBLE = (replace(QUERY, speed_mps=QUERY.speed_mps * times) for times in (0.5, 2))
#: as in the demo, in two other lights, with stops, at other speeds than the map's, with a camera
#: that fires sooner or later, and with two of these together
STREETS: Mapping[str, Second] = {
    "street": Second(QUERY),
    "street, low sun": Second(_LOW_SUN),
    "street, noon": Second(
        replace(
            QUERY,
            light=Light(sun=0.9, ambient=0.2, azimuth_deg=-160.0, elevation_deg=70.0, glare=0.0),
        )
    ),
    "street, 3 stops": Second(replace(QUERY, stops=3, stop_s=10.0)),
    "street, half speed": Second(_HALF),
    "street, quarter speed": Second(replace(QUERY, speed_mps=QUERY.speed_mps / 4)),
    "street, thresholds x 1.3": Second(QUERY, 1.3),
    "street, thresholds x 0.75": Second(QUERY, 0.75),
    "street, 3 stops of 2 min": Second(replace(QUERY, stops=3, stop_s=120.0)),
    "street, thresholds x 2": Second(QUERY, 2.0),
    "street, double speed": Second(_DOUBLE),
    "street, triple speed": Second(replace(QUERY, speed_mps=QUERY.speed_mps * 3)),
    "street, thresholds x 0.5": Second(QUERY, 0.5),
    "street, half speed, low sun": Second(replace(_LOW_SUN, speed_mps=_HALF.speed_mps)),
    "street, half speed, thresholds x 0.5": Second(_HALF, 0.5),
    "street, double speed, thresholds x 2": Second(_DOUBLE, 2.0),
}


def second_drive(query: SimulatedRecording, second: Second, offset: int = 0) -> SimulatedRecording:
    """Simulate a drive on the street of a query; an offset makes another traffic."""
    drive, contrast = second
    camera = replace(
        query.camera,
        contrast_on=contrast * query.camera.contrast_on,
        contrast_off=contrast * query.camera.contrast_off,
    )
    seed = query.seed + offset
    return SimulatedRecording(query.world, camera, drive, seed=seed, device=query.device).keep()


_WHEELS = 9  # random stream of the odometers


def street_pairs(seed: int, kinds: Mapping[str, str], **street: Any) -> Iterator[Pair]:
    """Simulate one street, and pairs of it with the same reference, all with odometers.

    Parameters
    ----------
    kinds : mapping of str to str
        Second drives, of `STREETS`, by the name of their pair.
    **street
        Of `simulate_pair`.
    """
    reference, query = simulate_pair(seed, **street)
    rng = np.random.default_rng((seed, _WHEELS))
    meter = wheel_odometry(reference.track, rng)
    for name, kind in kinds.items():
        pair = Pair.simulated(reference.keep(), second_drive(query, STREETS[kind]))
        assert pair.tracks is not None
        odometry = meter, wheel_odometry(pair.tracks.query, rng)
        yield replace(pair, drives=name, odometry=odometry)


# Drives as experiments declare them.


#: counts a pair, for as many draws of pixels as there are
_counted = lru_cache(maxsize=1)(Pair.counted)


def _declared(
    pairs: Collection[Pair],
    opened: Callable[[Pair], Any] = lambda pair: pair,
    named: Callable[[Pair], str] = lambda pair: pair.drives,
) -> list[Drives]:
    return [
        Drives(named(pair), lambda seed, pair=pair: opened(pair), drawn=pair.drawn)  # type: ignore[misc]
        for pair in pairs
    ]


def recorded_drives(
    data: Path | None, wanted: Callable[[Pair], bool] = lambda pair: True
) -> list[Drives]:
    """Return the recorded pairs of a folder that are wanted, each with some numbers of pixels."""
    check_data(data)
    assert data is not None
    return _declared(list(filter(wanted, _pairs(data))), named=lambda pair: pair.name)


def fullest_drives(data: Path | None) -> list[Drives]:
    """Return the recorded pairs; where only some pixels were published, with all of these."""
    return recorded_drives(data, lambda pair: pair.has_images or not pair.drawn)


def counted_drives(data: Path | None) -> list[Drives]:
    """Return streets, and the recorded pairs of a folder, as windows of all pixels."""
    streets = Drives(SIMULATED, counted_street, varied=True)
    return [streets, *_declared(whole_pairs(data), _counted)]


def event_drives(data: Path | None) -> list[Drives]:
    """Return streets, and the pairs of a folder whose events were recorded."""
    streets = Drives(SIMULATED, simulated_pair, varied=True)
    recorded = [pair for pair in whole_pairs(data) if pair.has_events]
    return [streets, *_declared(recorded)]


def walks(data: Path | None) -> Drives:
    """Return the walks in a folder."""
    if data is None or not (data / WALKS).is_dir():
        title, files = STAND_INS[WALKS].title, STAND_INS[WALKS].text
        raise UsageError(
            f"the folder {WALKS}, {title} ({files}), is not in {data or 'any folder given'}: name "
            "the folder that holds it with --data"
        )
    (pair,) = (pair for pair in whole_pairs(data) if pair.drives == _WALKED)
    return _declared([pair])[0]


def contests(data: Path | None) -> list[Drives]:
    """Return the drives of the experiment on rivals: streets, and recorded ones of a folder.

    Of Brisbane's drives, some pixels were published.
    """
    drives = [
        Drives(f"{SIMULATED}, windows of {name}", partial(_street_contest, window), varied=True)
        for window, name in (("time", "1 s"), ("count", "N events"))
    ]
    if data is None:
        return drives
    drives += _declared(whole_pairs(data), _counted)
    sparse = data / BRISBANE
    first, second = (sparse / name for name in _BRISBANE_DRIVES)
    day = data / DAY / "daytime_first_half"
    lens = [data / LENS / name for name in _BRISBANE_DRIVES]
    for title, counts, logs in (
        ("49 pixels, sunset1 on sunset2", (first, second), (first, second)),
        ("49 pixels, sunset2 on sunset1", (second, first), (second, first)),
        ("49 pixels, half a day on sunset2", (first, day), (first, day)),
        ("49 pixels, half a day on sunset1", (second, day), (second, day)),
        ("LENS's 49 pixels, sunset1 on sunset2", lens, (first, second)),
    ):
        if all(path.with_suffix(".npz").is_file() for path in counts) and sparse.is_dir():
            opened = partial(_brisbane_contest, counts, logs)
            drives.append(Drives(f"Brisbane, {title}", opened, drawn=False))
    return drives


def _street_contest(window: str, seed: int) -> CountedPair:
    return _kept_street(FIRST_SEED + seed).counted(window=window)


@lru_cache(maxsize=1)
def _kept_street(seed: int) -> Pair:
    """Simulate a street, which is counted in several ways."""
    return simulated_pair(seed, length_m=LENGTH_M)


def _brisbane_contest(counts: Sequence[Path], logs: Sequence[Path], seed: int) -> CountedPair:
    tracks = [load_track(path.with_suffix(".nmea")) for path in logs]
    first, second = (_published_counts(path.with_suffix(".npz")) for path in counts)
    weights = tuple(sorted(counts[0].parent.glob("*.pth")))
    truths = truths_of_tracks(tracks[0], tracks[1], *BRISBANE_M)
    return CountedPair("Brisbane", first, second, BRISBANE_SETTINGS, truths, False, weights)


def _published_counts(path: Path) -> CountedDrive:
    """Read counts of some pixels in windows of a second, as a square if they are in one.

    The places of the pixels of such a square are not published.
    """
    published = None
    with np.load(path) as arrays:
        if "frames" in arrays:
            counts = arrays["frames"]
        else:
            counts = arrays["counts"][:, None, :]
            sensor = Sensor(int(arrays["sensor_width"]), int(arrays["sensor_height"]))
            published = PixelMap(sensor, arrays["pixel_x"], arrays["pixel_y"])
    second = 1_000_000
    centre_us = np.arange(len(counts), dtype=np.int64) * second + second // 2
    return CountedDrive(counts.astype(np.uint16), centre_us, published)
