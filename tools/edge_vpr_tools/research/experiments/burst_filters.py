"""What a live run gives up when it does not wait for the end of a burst."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from edge_vpr.descriptors.cleaning import BurstFilter, CausalBurstFilter
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.events import Events, Sensor, make_events
from edge_vpr.matching.matches import Matches
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.state import MatchSchedule
from edge_vpr.pipeline import EventSource
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr_tools.report.style import dot_plot, save
from edge_vpr_tools.research.experiments.speck_walks import FOLDER, open_walks, truth_of_walks
from edge_vpr_tools.research.experiments.trial import Summary, markdown_table

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


#: values of each draw, by flashes per second and name of the filter
Scores = dict[tuple[float, str], list[float]]
RIGHT, SAME = "P@100R", "places as with the exact filter"


class Flashed:
    """Recording with added flashes at random times, which affect all pixels alike.

    Parameters
    ----------
    recording : EventSource
    rate : float
        Flashes per second.
    seed : int
    """

    def __init__(self, recording: EventSource, rate: float, seed: int) -> None:
        self.sensor: Sensor = recording.sensor
        self._recording, self._rate, self._seed = recording, rate, seed

    def __iter__(self) -> Iterator[Events]:
        rng = np.random.default_rng(self._seed)
        for events in self._recording:
            begin, end = int(events["t"][0]), int(events["t"][-1])
            number = rng.poisson(self._rate * (end - begin) / 1e6)
            flashes = [self._flash(rng, int(t)) for t in rng.integers(begin, end + 1, number)]
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
    """Match a query window by window, after the filter of this name.

    Parameters
    ----------
    reference : ReferenceMap
    query : EventSource
    name : str
        Name of one of `FILTERS`.
    """
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


def run(data: Path, seeds: int, on_start: Callable[[str], None], *figures: Path) -> str:
    """Match the query under flashes with each filter, and return a Markdown table."""
    on_start("reading the walks")
    folder = data / FOLDER
    walked, query = open_walks(folder)
    truth_of = truth_of_walks(folder)
    scores: dict[str, Scores] = {RIGHT: {}, SAME: {}}
    for seed in range(seeds):
        settings = PRESETS["default"].replaced({"seed": seed}, "seed")
        reference = ReferenceMap.build(walked, settings).causal()
        for rate in RATES:
            on_start(f"{rate:g} flashes a second, draw {seed + 1} of {seeds}")
            flashed = Flashed(query, rate, seed)
            exact = None
            for name in FILTERS:
                matches = matched(reference, flashed, name)
                exact = matches if exact is None else exact
                truth = truth_of(reference.places.centre_us, matches.time_us)
                found = evaluate(matches, truth)
                equal = float(np.mean(matches.place == exact.place))
                for measure, value in ((RIGHT, found.precision_at_100_recall), (SAME, equal)):
                    scores[measure].setdefault((rate, name), []).append(value)
    if figures:
        save(draw(scores), *figures)
    rows = [
        [f"{rate:g}", name, *(str(Summary(found[rate, name])) for found in scores.values())]
        for rate in RATES
        for name in FILTERS
    ]
    return markdown_table(("flashes a second", "burst filter", *scores), rows)


def draw(scores: Mapping[str, Scores]) -> Figure:
    """Draw each measure against the flashes, for each filter."""
    return dot_plot(
        {
            measure: {
                f"filter: {name}": {
                    f"flashes a second: {rate:g}": found[rate, name] for rate in RATES
                }
                for name in FILTERS
            }
            for measure, found in scores.items()
        }
    )


__all__ = ["FOLDER", "run"]
