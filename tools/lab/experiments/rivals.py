"""Every system beside the default, on the same windows: accuracy and cost.

All systems get the same counted and cleaned windows and the same truth. The distances of each are
matched by sequences and by the place filter, so that the choice of pixels is apart from the
matching. Each row is evaluated on every window that it matches, and on those that all match. The
``null`` rows are the place filter on a query whose windows or pixels were shuffled, and a constant
speed that does not use the query: their correct matches come from assumptions alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from edge_vpr_tools.console import warning
from edge_vpr_tools.sweep.trial import fastest
from matplotlib.figure import Figure

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import MissingExtraError, UsageError
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.matching.matches import Matches
from edge_vpr.matching.sequences import middle_window
from edge_vpr.settings import PRESETS, Settings
from lab.baselines import Baseline, baseline_names, compare, open_baseline
from lab.baselines.selected_pixels import SelectedPixels
from lab.drives import contests
from lab.loop import CHOSEN_ON, Draw, Experiment, Row, Rows
from lab.nulls import BY_AUTHORS, BY_NOBODY, BY_US, CONSTANT_SPEED, constant_speed, null_queries
from lab.pairs import INNER, CountedPair, inner_share, rates
from lab.plots import dots
from lab.tables import TableView

# How a matrix of distances becomes matches.


#: wanted share of correct matches among the accepted ones
PRECISION = 0.99
#: sequences that are compared beside those of the drives; windows that the longest one does not
#: match are not evaluated
LENGTHS = (1, 10, 20)
LONGEST = max(LENGTHS)
_DEFAULT = PRESETS["default"].replaced({"precision": PRECISION}, "rivals")


class Decoder(NamedTuple):
    """Settings that match windows, given their distances."""

    settings: Settings  #: Of sequences or of the filter.
    lag: int | None  #: Windows after each one that it needs; None needs the whole drive.


def decoders(length: int) -> dict[str, Decoder]:
    """Return the decoders by name."""
    by_name = {}
    for windows in sorted({length, *LENGTHS}):
        sequences = PRESETS["paper"].replaced({"sequence_length": windows}, "rivals")
        lag = windows - 1 - middle_window(windows)
        name = "single windows" if windows == 1 else f"sequences of {windows}"
        by_name[name] = Decoder(sequences, lag)
    for name, changes, filter_lag in (
        ("place filter, live", {"smooth": False}, 0),
        ("place filter, recorded", {}, None),
    ):
        by_name[name] = Decoder(_DEFAULT.replaced(changes, name), filter_lag)
    return by_name


# What is matched: the default, a rival, or nothing.


@dataclass(frozen=True, eq=False)
class System:
    """A system on one pair of drives."""

    name: str
    chosen_on: str  #: Data that chose its parameters.
    #: Maps settings, and a part of the query's windows, to the matches of this part, whose windows
    #: count from 0.
    match: Callable[[Settings, slice], Matches]
    #: bytes_per_place, operations: of `Compared`.
    bytes_per_place: int | None = None
    operations: int | None = None
    query_us: float | None = None  #: Time to describe one query and to compare it.
    only: Sequence[str] | None = None  #: Decoders to match it with, if not all.


OURS = "edge-vpr, places at whole windows"


#: of a `Decoder`, the settings that match the default's own distances
_DECODED = ("matching", "smooth", "precision", "sequence_length")


def our_systems(pair: CountedPair, seed: int) -> Iterator[System]:
    """Yield the default, and the default on queries that show nothing of the route."""
    pixels = min(_DEFAULT.pixels, pair.pixels)
    every = {"strategy": "top"} if pixels == pair.pixels else {}
    settings = _DEFAULT.replaced({"pixels": pixels, "seed": seed, **every}, OURS)
    chosen = SelectedPixels(OURS, settings)
    chosen.prepare(pair.reference.images)
    mapped = pair.mapped(chosen.pixel_map, settings)

    def match(shown: Descriptors, settings: Settings, part: slice) -> Matches:
        changed = mapped.with_settings({each: getattr(settings, each) for each in _DECODED})
        return replace(changed, counted=shown.take(part)).match()

    reference, counted = mapped.reference, mapped.counted
    _, coding_s = fastest(lambda: reference.coded(counted))
    yield System(
        OURS,
        BY_US,
        partial(match, counted),
        reference.packed_bytes_per_place,
        reference.places.counts.size,
        1e6 * coding_s / len(counted),
    )
    filters = [name for name in decoders(LONGEST) if "filter" in name]
    for name, shown in null_queries(counted, np.random.default_rng(seed)):
        yield System(name, BY_US, partial(match, shown), only=filters)


def rivals_of(draw: Draw) -> Iterator[System]:
    """Yield the rivals that these drives and this seed make a difference to."""
    pair: CountedPair = draw.pair
    drives = (pair.reference, pair.query)
    for rival in _baselines(pair, draw):
        images = (one.on_sensor if rival.of_images else one.images for one in drives)
        try:
            compared = compare(rival.baseline, *images)
        except UsageError as error:  # as where the surrounds of the pixels do not fit the sensor
            if rival.by_user:
                warning(f"{rival.title} is left out of {pair.name}: {error}")
            continue
        yield System(
            rival.title, BY_AUTHORS, partial(pair.match, compared.distances),
            compared.bytes_per_place, compared.operations, compared.query_us,
        )  # fmt: skip


#: baselines that draw pixels, so that several draws differ
DRAWN = ("paper", "seed-code")
#: rivals on drives of which only some pixels were published: those that take each pixel by itself,
#: and those that compare neighbours, and therefore get images of the sensor
_BY_PIXEL = ("all-pixels", "all-pixels@1,2,4", "active-pixels")
_OF_IMAGES = ("patch-normalised", "hog")


class _Rival(NamedTuple):
    title: str
    baseline: Baseline
    of_images: bool = False  #: Whether it gets images of the sensor, not of the given pixels.
    by_user: bool = False  #: Whether the user added it.


def _baselines(pair: CountedPair, draw: Draw) -> Iterator[_Rival]:
    names = baseline_names() if pair.laid_out else (*_BY_PIXEL, *_OF_IMAGES)
    for name in dict.fromkeys((*names, *draw.systems)):
        if draw.is_new or name in DRAWN:
            baseline = open_baseline(name, draw.seed)
            yield _Rival(baseline.title, baseline, name not in _BY_PIXEL, name in draw.systems)
    if not draw.is_new:
        return
    if not pair.laid_out:
        changes = {"pixels": pair.pixels, "strategy": "top"}
        settings = PRESETS["seed-code"].replaced(changes, "released code")
        title = "seed-code: the given pixels, clipped at 10, SAD"
        yield _Rival(title, SelectedPixels(title, settings))
    for path in pair.weights:
        try:
            baseline = open_baseline(f"lens:{path}", draw.seed)
        except MissingExtraError as error:
            warning(f"LENS is left out: {error}")
            continue
        yield _Rival(f"LENS, {path.name.split('_')[0]}", baseline)


# What is measured of each row.


#: windows between two starts in mid-route, most windows after a start, and least to the end
START_EVERY, MOST, LEFT = 20, 120, 20
#: measured columns, in their order
_NOT_MEASURED: dict[str, Any] = dict.fromkeys(
    (
        "P@100R", INNER, "R@99P", "accepted at 0.99", "correct of accepted",
        "first right match (s)", "starts with a right match", "bytes per place",
        "operations per query", "time per query (us)",
    )
)  # fmt: skip


def measure(draw: Draw) -> Iterator[Row]:
    """Match a pair of drives by every system with every decoder, and evaluate the matches."""
    pair: CountedPair = draw.pair
    matchings = decoders(pair.settings.sequence_length)
    truths = {
        tolerance: truth_of(pair.reference.centre_us, pair.query.centre_us)
        for tolerance, truth_of in pair.truths.items()
    }
    windows = len(pair.query.centre_us)
    for system in (*our_systems(pair, draw.seed), *rivals_of(draw)):
        for matching, decoder in matchings.items():
            if system.only is not None and matching not in system.only:
                continue
            matches, matching_s = fastest(partial(system.match, decoder.settings, slice(None)))
            starts = _starts(system, decoder, windows) if decoder.lag is not None else None
            for tolerance, truth in truths.items():
                row = {
                    "system": system.name,
                    "matching": matching,
                    "tolerance": tolerance,
                    CHOSEN_ON: _chosen_on(system, decoder),
                    **_NOT_MEASURED,
                    **rates(matches, truth),
                    INNER: inner_share(matches, truth, LONGEST),
                }
                if starts is not None:
                    row |= first_correct(starts, decoder, pair.query.centre_us, truth)
                if system.query_us is not None:
                    row |= {
                        "bytes per place": system.bytes_per_place,
                        "operations per query": system.operations,
                        "time per query (us)": system.query_us + 1e6 * matching_s / windows,
                    }
                yield row
    for tolerance, truth in truths.items():
        yield {
            "system": CONSTANT_SPEED,
            "matching": "none",
            "tolerance": tolerance,
            CHOSEN_ON: BY_NOBODY,
            **_NOT_MEASURED,
            "P@100R": constant_speed(truth),
        }


def _chosen_on(system: System, decoder: Decoder) -> str:
    """Return the data that chose the parameters of a system, and of the filter on top of it."""
    if system.chosen_on == BY_US or decoder.settings.matching == "sequence":
        return system.chosen_on
    return f"{system.chosen_on}; filter: {BY_US}"


class _Start(NamedTuple):
    """Matches from a window on, as after switching on there."""

    first: int
    matches: Matches


def _starts(system: System, decoder: Decoder, windows: int) -> list[_Start]:
    """Match from many windows on."""
    return [
        _Start(first, system.match(decoder.settings, slice(first, first + MOST)))
        for first in range(0, windows - LEFT, START_EVERY)
    ]


def first_correct(
    starts: Sequence[_Start], decoder: Decoder, centre_us: npt.NDArray[np.int64], truth: GroundTruth
) -> dict[str, Any]:
    """Return the median time from switching on to the first correct match, and its frequency.

    The time ends when the match is given: with the last window that it needs.
    """
    assert decoder.lag is not None
    window_us = float(np.median(np.diff(centre_us)))
    waits = []
    for first, matches in starts:
        at = first + matches.query
        correct = np.flatnonzero(truth.correct[matches.place, at])
        if not truth.has_truth[at].any():
            continue
        if not correct.size:
            waits.append(np.inf)
            continue
        last = min(int(at[correct[0]]) + decoder.lag, len(centre_us) - 1)
        waits.append((centre_us[last] - centre_us[first] + window_us) / 1e6)
    median = float(np.median(waits)) if waits else np.inf
    return {
        "first right match (s)": median if np.isfinite(median) else None,
        "starts with a right match": float(np.isfinite(waits).mean()) if waits else None,
    }


def figure(rows: Rows) -> Figure:
    """Draw correct matches of each system, at each pair's first tolerance."""
    first: dict[str, str] = {}
    for row in rows:
        first.setdefault(row["drives"], row["tolerance"])
    shown = [
        row
        for row in rows
        if row["bytes per place"]
        and row["matching"] in SHOWN
        and row["tolerance"] == first[row["drives"]]
    ]
    return dots(shown, INNER, "system", "matching")


#: decoders in the figure
SHOWN = ("sequences of 20", "place filter, live", "place filter, recorded")
EXPERIMENT = Experiment(
    drives=contests,
    names=("system", "matching", "tolerance", CHOSEN_ON),
    measure=measure,
    figure=figure,
    view=TableView({}),
    takes_systems=True,
)
