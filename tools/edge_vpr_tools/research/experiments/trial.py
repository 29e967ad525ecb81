"""One variant of the method on one pair of drives, and its spread over several trials."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.ground_truth import GroundTruth, from_tracks
from edge_vpr.evaluation.metrics import Evaluation, evaluate
from edge_vpr.evaluation.tracks import Track
from edge_vpr.events import Events, Sensor
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.pipeline import EventSource, describe_query
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS, Settings
from edge_vpr_tools.research.baselines import map_all_pixels
from edge_vpr_tools.research.baselines.baseline import fastest

#: matching of the default: the place filter with contrast codes
DEFAULT_MATCHING = {
    name: getattr(PRESETS["default"], name)
    for name in ("matching", "smooth", "counter_code", "counter_scaling", "anchor", "score")
}
Times = npt.NDArray[np.int64]
#: maps the centre times of places and query windows to their ground truth
TruthOf = Callable[[Times, Times], GroundTruth]


def truth_of_tracks(reference: Track, query: Track, tolerance_m: float) -> TruthOf:
    """Return the ground truth by the distances between two tracks."""
    return partial(from_tracks, reference, query, tolerance_m=tolerance_m)


class Kept:
    """Recording whose events are held in memory, for the many passes of an experiment."""

    def __init__(self, recording: EventSource) -> None:
        self.sensor: Sensor = recording.sensor
        self._chunks = list(recording)

    def __iter__(self) -> Iterator[Events]:
        return iter(self._chunks)


@dataclass(frozen=True)
class Variant:
    """Variant of the method.

    Parameters
    ----------
    name : str
        Name in tables and figures.
    changes : mapping
        Settings that differ from the experiment's.
    all_pixels : bool
        Use every pixel instead of a selection.
    """

    name: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    all_pixels: bool = False


@dataclass(frozen=True, eq=False)
class Trial:
    """Result of one variant on one pair of drives."""

    reference: ReferenceMap
    queries: Descriptors
    matches: Matches
    truth: GroundTruth
    evaluation: Evaluation
    matching_s: float

    @property
    def microseconds_per_match(self) -> float:
        """Time to match one query window against the whole map, when compiled and cached."""
        return 1e6 * self.matching_s / len(self.matches)

    @property
    def operations(self) -> int:
        """Number of differences of counters to compare one query window with the whole map."""
        return self.reference.places.counts.size

    def to_json(self) -> dict[str, Any]:
        """Return the figures as values that JSON can hold."""
        return {
            **self.evaluation.to_dict(),
            "bytes_per_place": self.reference.packed_bytes_per_place,
            "microseconds_per_match": self.microseconds_per_match,
            "places": len(self.reference),
        }


def run_trial(
    reference: EventSource,
    query: EventSource,
    truth_of: TruthOf,
    settings: Settings,
    variant: Variant,
) -> Trial:
    """Map, describe, match and evaluate; see `map_and_describe`."""
    mapped, queries = map_and_describe(reference, query, settings, variant)
    return match_trial(mapped, queries, truth_of)


def map_and_describe(
    reference: EventSource, query: EventSource, settings: Settings, variant: Variant
) -> tuple[ReferenceMap, Descriptors]:
    """Map a reference drive, and describe a query drive.

    A fixed-count window holds the average number of events of a fixed-time window of the reference
    at the same pixels, so that the two kinds of window are compared fairly (paper, IV-C).
    """
    # for windows by count, N is taken from the reference
    settings = settings.replaced({"events_per_pixel": None, **variant.changes}, variant.name)
    mapped = ReferenceMap.build(reference, settings)
    if variant.all_pixels:
        mapped = map_all_pixels(reference, settings, mapped.hot)
    return mapped, describe_query(mapped, query)


def match_trial(mapped: ReferenceMap, queries: Descriptors, truth_of: TruthOf) -> Trial:
    """Match and evaluate."""
    matches, matching_s = fastest(
        lambda: match_descriptors(mapped.places, queries, mapped.settings)
    )
    truth = truth_of(mapped.places.centre_us, queries.centre_us)
    return Trial(mapped, queries, matches, truth, evaluate(matches, truth), matching_s)


@dataclass(frozen=True, eq=False)
class Summary:
    """One figure over several trials."""

    values: Sequence[float]

    def __str__(self) -> str:
        mean = float(np.mean(self.values))
        if len(self.values) == 1:
            return f"{mean:.3f}"
        # standard deviation of the sample of trials, and not of their mean
        return f"{mean:.3f} ± {float(np.std(self.values, ddof=1)):.3f}"


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a table as Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
