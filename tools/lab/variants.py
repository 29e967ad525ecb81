"""Variants of the method on one pair of drives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from edge_vpr_tools.sweep.trial import fastest

from edge_vpr.descriptors.published import WindowSource
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.recordings.reading import EventSource
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS, Settings
from lab.baselines import map_all_pixels
from lab.codes import TableCode
from lab.loop import CHOSEN_ON, Draw, Drives, Experiment, Row
from lab.nulls import BY_AUTHORS, BY_US, null_rows
from lab.pairs import INNER, MappedPair, Pair, inner_share

#: matching of the default: the place filter with contrast codes
DEFAULT_MATCHING = {
    name: getattr(PRESETS["default"], name)
    for name in ("matching", "smooth", "counter_code", "places_per_window")
}


@dataclass(frozen=True)
class Variant:
    """Variant of the method: settings that differ, at selected pixels or at all, and a code."""

    name: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    all_pixels: bool = False
    code: TableCode | None = None  #: In place of that of the settings.

    @property
    def chosen_on(self) -> str:
        """Data that chose the parameters: the filter's and the codes' are ours."""
        ours = self.code is not None or {"matching", "counter_code"} & self.changes.keys()
        return BY_US if ours else BY_AUTHORS

    @property
    def drawn(self) -> bool:
        """Whether the pixels are drawn, so that several draws differ."""
        return not self.all_pixels and self.changes.get("strategy") != "top"

    def map(self, reference: EventSource | WindowSource, settings: Settings) -> ReferenceMap:
        """Map a reference drive with the variant's changes of some settings.

        A fixed-count window holds the average number of events of a fixed-time window of the
        reference at the same pixels, so that the two kinds of window are compared fairly (paper,
        IV-C).
        """
        settings = settings.replaced({"events_per_pixel": None, **self.changes}, self.name)
        mapped = ReferenceMap.build(reference, settings)
        return map_all_pixels(reference, settings, mapped.hot) if self.all_pixels else mapped

    def of(self, pair: Pair, seed: int) -> MappedPair:
        """Map the reference of a pair with one draw of pixels, and count its query."""
        mapped = self.map(pair.reference, pair.drawn_with(seed))
        return replace(MappedPair.of(mapped, pair.query, pair.truth_of), code=self.code)


def variants_experiment(
    drives: Callable[[Path | None], Sequence[Drives]],
    variants: Sequence[Variant],
    default: str,
    **more: Any,
) -> Experiment:
    """Declare an experiment that compares variants, and null baselines of one of them.

    Each is evaluated on every window that it matches, and on those that the sequences of the pair's
    settings match.

    Parameters
    ----------
    drives : callable
        As of `Experiment`, which `more` is given to; each opens a `Pair`.
    default : str
        Name of the variant that the null baselines have the settings of.
    """
    return Experiment(
        drives=drives,
        names=("variant", CHOSEN_ON),
        measure=partial(_measure, variants, default),
        **more,
    )


def _measure(variants: Sequence[Variant], default: str, draw: Draw) -> Iterator[Row]:
    """Run the variants on a pair, those that draw no pixels once."""
    pair: Pair = draw.pair
    for variant in variants:
        if not (draw.is_new or variant.drawn):
            continue
        mapped = variant.of(pair, draw.seed)
        matches, matching_s = fastest(partial(mapped.match_coded, *mapped.described()))
        evaluation = evaluate(matches, mapped.truth, score=mapped.score)
        yield {
            "variant": variant.name,
            CHOSEN_ON: variant.chosen_on,
            "P@100R": evaluation.precision_at_100_recall,
            "R@99P": evaluation.recall_at_99_precision,
            "Recall@5": evaluation.recall_at[5],
            "bytes per window": mapped.packed_bytes_per_window,
            # differences of counters to compare one window with the whole map
            "operations per query": mapped.reference.places.counts.size,
            "time per query (us)": 1e6 * matching_s / len(matches),
            INNER: inner_share(matches, mapped.truth, pair.settings.sequence_length),
        }
        if variant.name == default:
            yield from null_rows(mapped, np.random.default_rng(draw.seed), "variant")
