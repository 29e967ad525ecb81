"""Ablation of the place filter: the filter, its code and its measure of trust, each on its own.

Parameters were chosen on the real drives and on simulated streets of the seeds 0 to 4 and 30 to 49.
The streets here have other seeds, and light that was not tried before. Each row is evaluated on
every window that it matches, and on those that sequences of 10 match. Where events were recorded,
the robot's and the default's maps have places at half windows, as by default; all other rows have
places at whole windows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from edge_vpr.odometry import Odometry
from lab.codes import Code, OwnMean, TableCode
from lab.drives import STREETS, recorded_drives, street_pairs
from lab.loop import CHOSEN_ON, DRIVES, Draw, Drives, Experiment, Row
from lab.nulls import BY_AUTHORS, BY_US, null_rows
from lab.pairs import INNER, MappedPair, Pair, inner_share, rates
from lab.tables import TableView

# Settings that the place filter is compared by.


_FILTER = {"matching": "filter"}
_ROBOT = {**_FILTER, "counter_code": "contrast"}
_LOG, _OWN = TableCode("log"), OwnMean()
PAPER = "sequences of 5, counts (the paper)"
VARIANTS: Mapping[str, tuple[Mapping[str, Any], Code | None]] = {
    PAPER: ({"sequence_length": 5}, None),
    "sequences of 5, 3-bit log": ({"sequence_length": 5}, _LOG),
    "sequences of 10, 3-bit log": ({"sequence_length": 10}, _LOG),
    "sequences of 10, own mean": ({"sequence_length": 10}, _OWN),
    "place filter, counts": (_FILTER, None),
    "place filter, 3-bit log": (_FILTER, _LOG),
}
ROBOT = "place filter, running mean (robot)"
BEST = "place filter, contrast, smoothed (default)"
#: the same with the default's places, which are at half windows where events were recorded
DEFAULTS: Mapping[str, Mapping[str, Any]] = {ROBOT: _ROBOT, BEST: {**_ROBOT, "smooth": True}}
AT_WHOLE = ", places at whole windows"
#: windows of the longest sequences
LONGEST = 10
FIRST_SEED = 10
PIXELS = (25, 150)
PRECISION = 0.99
_HALF = {"matching": "filter", "places_per_window": 2}


def driven(draw: Draw) -> Iterable[Pair]:
    """Return a recorded pair with this draw of pixels, or the pairs of a street as they are."""
    if isinstance(draw.pair, Pair):
        return [replace(draw.pair, settings=draw.pair.drawn_with(draw.seed))]
    streets: Iterable[Pair] = draw.pair
    return streets


def driven_street(seed: int, kinds: Sequence[str] = tuple(STREETS)) -> Iterator[Pair]:
    """Simulate one street with some of its drives, each with some numbers of pixels."""
    for pair in street_pairs(seed, {kind: kind for kind in kinds}):
        for pixels in PIXELS:
            settings = pair.settings.replaced({"pixels": pixels, "seed": seed}, "street")
            yield replace(pair, settings=settings)


def measure(draw: Draw) -> Iterator[Row]:
    """Match with every variant, and with the filter on what shows nothing of the route."""
    for drive in driven(draw):
        name, settings, odometry = drive.name, drive.settings, drive.odometry
        at_whole, at_half = drive.mapped(settings), None
        if drive.has_events:
            at_half = drive.mapped(settings.replaced(_HALF, "half"))
        default = at_half or at_whole
        tried: list[tuple[str, MappedPair, Mapping[str, Any], Code | None, Odometry | None]] = [
            *((method, at_whole, *variant, None) for method, variant in VARIANTS.items()),
            *((method, default, changes, None, None) for method, changes in DEFAULTS.items()),
        ]
        if at_half is not None:
            tried += [(each + AT_WHOLE, at_whole, DEFAULTS[each], None, None) for each in DEFAULTS]
        if odometry is not None:
            tried += [
                (f"{each}, odometry", default, DEFAULTS[each], None, odometry[1])
                for each in (ROBOT, BEST)
            ]
        for method, pair, changes, code, along in tried:
            promised = {"precision": PRECISION} if changes.get("matching") == "filter" else {}
            coded = pair.coded({**changes, **promised}, code)
            matches = coded.match(along)
            yield {
                DRIVES: name,
                "method": method,
                CHOSEN_ON: BY_AUTHORS if method == PAPER else BY_US,
                INNER: inner_share(matches, pair.truth, LONGEST),
                **rates(matches, pair.truth, coded.score),
            }
        for variant, ending in ((ROBOT, ""), (BEST, ", smoothed")):
            rng = np.random.default_rng(draw.seed)
            for row in null_rows(default.coded(DEFAULTS[variant]), rng, "method", ending):
                yield {DRIVES: name, **row}


def drives(data: Path | None) -> list[Drives]:
    """Return the recorded pairs of a folder if one is given, and streets that chose nothing."""
    streets = Drives("streets", lambda seed: driven_street(FIRST_SEED + seed), varied=True)
    return [*(recorded_drives(data) if data is not None else ()), streets]


EXPERIMENT = Experiment(
    drives=drives,
    names=("method", CHOSEN_ON),
    measure=measure,
    view=TableView({}, ("method", "P@100R", "R@99P")),
)
