"""One variant of the method on one pair of drives, and its spread over several trials."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.counting import EventSource, count_windows
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.ground_truth import GroundTruth, from_tracks
from edge_vpr.evaluation.metrics import Evaluation, evaluate
from edge_vpr.evaluation.tracks import Track
from edge_vpr.events import Events, Sensor
from edge_vpr.map_record import describe_query
from edge_vpr.matching.drive import anchor_offset, match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS, Settings
from edge_vpr_tools.research.baselines import map_all_pixels
from edge_vpr_tools.research.baselines.baseline import fastest
from edge_vpr_tools.research.experiments.experiment import CHOSEN_ON, Row
from edge_vpr_tools.research.experiments.nulls import BY_AUTHORS, BY_US, null_rows

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


def inner_windows(truth: GroundTruth, longest: int) -> GroundTruth:
    """Leave out the windows at both ends, which the longest sequences do not match.

    What is compared with sequences is then evaluated on the same windows.

    Parameters
    ----------
    longest : int
        Windows of the longest sequence, anchored as in the paper.
    """
    known = truth.known.copy()
    before = anchor_offset(longest, PRESETS["paper"].anchor)
    known[:before] = False
    known[len(known) - (longest - 1 - before) :] = False
    return GroundTruth(truth.correct & known, known, truth.description)


class Kept:
    """Recording whose events are held in memory from the first of many passes on."""

    def __init__(self, recording: EventSource) -> None:
        self.sensor: Sensor = recording.sensor
        self._recording = recording
        self._chunks: list[Events] | None = None

    def __iter__(self) -> Iterator[Events]:
        if self._chunks is None:
            self._chunks = list(self._recording)
        return iter(self._chunks)


@dataclass(frozen=True)
class Variant:
    """Variant of the method."""

    name: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    all_pixels: bool = False

    @property
    def chosen_on(self) -> str:
        """Data that chose the parameters: the filter's and the codes' are ours."""
        return BY_US if {"matching", "counter_code"} & self.changes.keys() else BY_AUTHORS


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

    def row(self) -> dict[str, Any]:
        """Return the measured columns of an experiment's table."""
        found = self.evaluation
        return {
            "P@100R": found.precision_at_100_recall,
            "R@99P": found.recall_at_99_precision,
            "Recall@5": found.recall_at[5],
            "bytes per place": self.reference.packed_bytes_per_place,
            "operations per query": self.operations,
            "time per query (us)": self.microseconds_per_match,
        }

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
    longest: int = 1,
) -> Trial:
    """Map, describe, match and evaluate; see `map_and_describe` and `match_trial`."""
    mapped, queries = map_and_describe(reference, query, settings, variant)
    return match_trial(mapped, queries, truth_of, longest)


def rows_of_variants(
    reference: EventSource,
    query: EventSource,
    truth_of: TruthOf,
    settings: Settings,
    variants: Sequence[Variant],
    default: str,
) -> Iterator[Row]:
    """Yield a row for each variant, and for the null baselines of the default.

    All are evaluated on the windows that the sequences of `settings` match.

    Parameters
    ----------
    default : str
        Name of the variant that the null baselines have the settings of.
    """
    for variant in variants:
        trial = run_trial(reference, query, truth_of, settings, variant, settings.sequence_length)
        yield {"variant": variant.name, CHOSEN_ON: variant.chosen_on, **trial.row()}
        if variant.name == default:
            mapped, rng = trial.reference, np.random.default_rng(settings.seed)
            counted = count_windows(query, mapped.pixel_map, mapped.settings)
            yield from null_rows(mapped, counted, trial.truth, rng, "variant")


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


def match_trial(
    mapped: ReferenceMap, queries: Descriptors, truth_of: TruthOf, longest: int = 1
) -> Trial:
    """Match, and evaluate the windows that sequences of `longest` windows match too."""
    matches, matching_s = fastest(
        lambda: match_descriptors(mapped.places, queries, mapped.settings)
    )
    truth = inner_windows(truth_of(mapped.places.centre_us, queries.centre_us), longest)
    return Trial(mapped, queries, matches, truth, evaluate(matches, truth), matching_s)
