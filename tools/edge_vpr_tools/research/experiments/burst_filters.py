"""What a live run gives up when it does not wait for the end of a burst."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np

from edge_vpr.descriptors.cleaning import BurstFilter, CausalBurstFilter
from edge_vpr.descriptors.counting import EventSource
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.events import Events, Sensor, make_events
from edge_vpr.matching.matches import Matches
from edge_vpr.online.localiser import Localiser, MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr_tools.research.experiments.drives import walks
from edge_vpr_tools.research.experiments.experiment import Draw, Experiment, Row
from edge_vpr_tools.research.experiments.pairs import Pair
from edge_vpr_tools.research.experiments.plots import dots

#: Flashes per second that are added to the query: from none over a failing lamp to a strobe.
RATES = (0.0, 0.1, 1.0, 10.0)
#: Duration of a flash, probability that a pixel fires in it, and most events of a pixel.
FLASH_US, SHARE, MOST_EVENTS = 3_000, 0.9, 3
EXACT = "exact"
FILTERS: Mapping[str, type[BurstFilter] | type[CausalBurstFilter] | None] = {
    EXACT: BurstFilter,
    "causal": CausalBurstFilter,
    "none": None,
}


RIGHT, SAME = "P@100R", "places as with the exact filter"


class Flashed:
    """Recording with added flashes at random times, which affect all pixels alike."""

    def __init__(self, recording: EventSource, rate: float, seed: int) -> None:
        self.sensor: Sensor = recording.sensor
        self._recording, self._rate, self._seed = recording, rate, seed

    def __iter__(self) -> Iterator[Events]:
        rng = np.random.default_rng(self._seed)
        for events in self._recording:
            start, end = int(events["t"][0]), int(events["t"][-1])
            number = rng.poisson(self._rate * (end - start) / 1e6)
            flashes = [self._flash(rng, int(t)) for t in rng.integers(start, end + 1, number)]
            joined = np.concatenate([events, *flashes])
            joined = joined[np.argsort(joined["t"], kind="stable")]
            # a flash at the end of a chunk is cut off, since the next chunk begins there
            yield joined[: np.searchsorted(joined["t"], end, side="right")]

    def _flash(self, rng: np.random.Generator, at_us: int) -> Events:
        fires = np.flatnonzero(rng.random(self.sensor.pixels) < SHARE)
        flat = np.repeat(fires, rng.integers(1, MOST_EVENTS + 1, fires.size))
        times = at_us + rng.integers(0, FLASH_US, flat.size)
        return make_events(times, flat % self.sensor.width, flat // self.sensor.width)


def matched(reference: ReferenceMap, query: EventSource, name: str) -> Matches:
    """Match a query window by window, after the filter of this name."""
    kind = FILTERS[name]
    bursts = None if kind is None else kind(query.sensor)
    localiser = Localiser(reference, every=MatchSchedule.window(reference.settings))
    rows = []
    for events in query:
        for piece in [events] if bursts is None else bursts.pieces(events):
            rows.append(localiser.update(piece))
    if bursts is not None:
        rows.append(localiser.update(bursts.finish()))
    return Matches.of_rows(np.concatenate(rows), reference.settings, len(reference))


def measure(draw: Draw) -> Iterator[Row]:
    """Match the query under flashes with each filter."""
    pair: Pair = draw.pair
    walked, query = pair.events
    settings = PRESETS["default"].replaced({"seed": draw.seed}, "seed")
    reference = ReferenceMap.build(walked, settings).causal()
    for rate in RATES:
        flashed = Flashed(query, rate, draw.seed)
        exact = None
        for name in FILTERS:
            matches = matched(reference, flashed, name)
            exact = matches if exact is None else exact
            truth = pair.truth_of(reference.places.centre_us, matches.time_us)
            yield {
                "flashes per second": f"{rate:g}",
                "burst filter": name,
                RIGHT: evaluate(matches, truth).precision_at_100_recall,
                SAME: float(np.mean(matches.place == exact.place)),
            }


EXPERIMENT = Experiment(
    drives=lambda data: [walks(data)],
    names=("flashes per second", "burst filter"),
    measure=measure,
    figure=partial(dots, measures=(RIGHT, SAME), row="flashes per second", series="burst filter"),
)
