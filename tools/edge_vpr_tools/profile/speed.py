"""The paper's speed claim, measured again: few pixels against all of them (Fischer & Milford, IV).

Counting and matching are timed separately. Measurements of the two variants alternate, so that
other work of the machine affects both.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.counting import DescriptorStream
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import FixedTime, collect
from edge_vpr.events import Events, Sensor
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr_tools.profile.measurement import interval_of_times

#: DAVIS346 of Brisbane-Event-VPR, and J of the paper; number of places and counts are invented
PAPER_SENSOR, PAPER_PIXELS, _PAPER_PLACES = Sensor(346, 260), 150, 500
_REPEATS = 31
#: enough for timing, and small enough to be held in memory beside the recording
_MOST_EVENTS, _MOST_COUNTS, _MOST_WINDOWS = 500_000, 1 << 25, 64
_LEAST_S = 2e-3

Counts = npt.NDArray[np.unsignedinteger]


class Timing(NamedTuple):
    """Median of repeated timings, with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Against:
    """Seconds of one unit of work with few pixels and with all, with 95 % intervals."""

    unit: str  #: Unit of work of the seconds.
    #: sparse_pixels, all_pixels, places: J of the two variants, and K; 0 places if none are
    #: matched.
    sparse_pixels: int
    all_pixels: int
    places: int
    #: sparse_s, all_s, times: `times` has the ratios of neighbouring measurements.
    sparse_s: Timing
    all_s: Timing
    times: Timing


@dataclass(frozen=True)
class SparseAgainstAll:
    """Few pixels against all of them: counting an event, and matching a query."""

    #: counting, matching: measured with the recording.
    counting: Against
    matching: Against
    matching_paper: Against  #: Measured at the paper's sizes, with invented counts.

    def parts(self) -> dict[str, Against]:
        """Return all three results by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def sparse_against_all(events: Events, pixel_map: PixelMap, places: int) -> SparseAgainstAll:
    """Time counting and matching of a recording, and matching at the paper's sizes.

    Parameters
    ----------
    places : int
        K; fewer are used if all pixels of this many places would need too much memory.
    """
    sensor = pixel_map.sensor
    events = events[:_MOST_EVENTS]
    everything = PixelMap.all_of(sensor)
    windows = max(2, min(_MOST_WINDOWS, _MOST_COUNTS // sensor.pixels))
    span = int(events["t"][-1]) - int(events["t"][0])
    tau = FixedTime(max(1, span // (windows + 1)))

    def count(pixels: PixelMap) -> Counts:
        stream = DescriptorStream(pixels, tau)
        return collect(stream.windows(events), len(pixels)).counts

    sparse, all_of_them = count(pixel_map), count(everything)
    places = max(2, min(places, _MOST_COUNTS // sensor.pixels))
    counting = _against(
        "per event", lambda: count(pixel_map), lambda: count(everything), events.size,
        (len(pixel_map), len(everything), 0),
    )  # fmt: skip
    rng = np.random.default_rng(0)
    made_up = rng.integers(0, 16, (_PAPER_PLACES, PAPER_SENSOR.pixels), dtype=np.uint8)
    return SparseAgainstAll(
        counting,
        _matching(sparse, all_of_them, places),
        _matching(made_up[:, :PAPER_PIXELS], made_up, _PAPER_PLACES),
    )


def _matching(sparse: Counts, everything: Counts, places: int) -> Against:
    """Time the distances of one query to every place."""
    both = (sparse, everything)
    indices = [ReferenceIndex(np.resize(counts, (places, counts.shape[1]))) for counts in both]
    queries = [counts[0] for counts in both]
    return _against(
        "per query",
        lambda: indices[0].distances(queries[0]),
        lambda: indices[1].distances(queries[1]),
        1,
        (sparse.shape[1], everything.shape[1], places),
    )


def _against(
    unit: str,
    sparse: Callable[[], object],
    dense: Callable[[], object],
    units: int,
    sizes: tuple[int, int, int],
) -> Against:
    rounds = [_rounds(work) for work in (sparse, dense)]
    took = np.empty((_REPEATS, 2))
    for i in range(_REPEATS):
        # the variant that goes first alternates
        for which in (0, 1) if i % 2 == 0 else (1, 0):
            took[i, which] = _time((sparse, dense)[which], rounds[which]) / units
    found = map(interval_of_times, (*took.T, took[:, 1] / took[:, 0]))
    return Against(unit, *sizes, *(Timing(one.value, one.low, one.high) for one in found))


def _rounds(work: Callable[[], object]) -> int:
    """Return how often work is repeated in one measurement; also compiles it and fills caches."""
    work()
    return max(1, round(_LEAST_S / max(_time(work, 1), 1e-9)))


def _time(work: Callable[[], object], rounds: int) -> float:
    start = time.perf_counter()
    for _ in range(rounds):
        work()
    return (time.perf_counter() - start) / rounds
