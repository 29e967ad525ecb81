"""What the shipped probabilities are worth on real drives that they were not learnt on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from edge_vpr.confidence import SMOOTHED, Confidence, default_confidence
from edge_vpr.evaluation.calibration import learn_confidence, reliability
from edge_vpr.evaluation.metrics import Rejection, judge_rejection
from edge_vpr.evaluation.tracks import distances, with_positions
from edge_vpr.pipeline import count_windows
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr_tools.report.figures import reliability_diagram
from edge_vpr_tools.report.style import save
from edge_vpr_tools.report.tables import markdown_table
from edge_vpr_tools.research.experiments.calibration import (
    HEADER,
    MATCHINGS,
    PAST_THE_EDGE,
    Case,
    Sample,
    accepted_past_the_edge,
    carried_off,
    described,
    first_row,
    joined,
    sample,
    with_settings,
    without_places,
)
from edge_vpr_tools.research.experiments.drives import Pair, Tracks, check_data, pairs
from edge_vpr_tools.research.experiments.trial import Summary

__all__ = ["check_data", "run"]

PRECISION = 0.99
#: of `MATCHINGS`, those that are judged, and those that a robot can use
LIVE = ("4", "0")
JUDGED = (SMOOTHED, *LIVE)
#: places that are cut out of the map of Brisbane's counts; of other maps, it is the third quarter
_CUT = (220, 330)


def run(data: Path, seeds: int, on_start: Callable[[str], None], *figures: Path) -> str:
    """Judge the shipped table on every pair of real drives, and return Markdown tables."""
    rows = {name: _Rows() for name in JUDGED}
    first, everything, intervals = [], [], []
    for pair in pairs(data):
        if pair.has_images or not pair.drawn:  # 49 of 49 pixels represent the counts of Brisbane
            on_start(pair.name)
            drawn = list(cases(pair, seeds))
            if pair.tracks is not None:
                intervals.append(_intervals(pair.name, pair.tracks, drawn[0]))
            for name, tables in rows.items():
                found = tables.add(pair, [with_settings(case, **MATCHINGS[name]) for case in drawn])
                everything += found if name == SMOOTHED else []
            for name in LIVE:
                live = [with_settings(case, **MATCHINGS[name]) for case in drawn[: min(seeds, 2)]]
                table = default_confidence(late=int(name))
                first.append(first_row(f"{pair.name}, {described(name).lower()}", table, live))
    if figures:
        save(draw(joined(everything)), *figures)
    parts = []
    for name, tables in rows.items():
        how = described(name).lower()
        parts += [
            f"Whole drives, {how}:",
            markdown_table(
                ("drives", "right", "mean probability", "error, all draws", "error, one draw",
                 "error, halves", "accepted at 0.99", "precision", "recall"), tables.whole),
            f"A piece of the map cut out, {how}:", markdown_table(_REJECTED, tables.cut),
            f"Carried off twice, {how}:", markdown_table(_REJECTED, tables.carried),
        ]  # fmt: skip
    parts += ["Switched on in mid-route:", markdown_table(HEADER, first), *intervals]
    return "\n\n".join(parts)


def draw(smoothed: Sample) -> Figure:
    """Draw how often smoothed matches of each probability are right."""
    given = default_confidence(smoothed=True).probability_of(smoothed.trust)
    return reliability_diagram({"Smoothed": reliability(given, smoothed.correct)})


_REJECTED = ("drives", "right of those on the map", "found at 99 % precision over all",
             "AUROC off the map", "error, all draws", "accepted", "precision",
             "recall", PAST_THE_EDGE)  # fmt: skip


class _Rows:
    """Rows of the tables of one way to match."""

    def __init__(self) -> None:
        self.whole: list[list[str]] = []
        self.cut: list[list[str]] = []
        self.carried: list[list[str]] = []

    def add(self, pair: Pair, drawn: list[Case]) -> list[Sample]:
        """Judge the shipped table on a pair, and return the matches of its whole drives."""
        settings = drawn[0].reference.settings
        table = default_confidence(settings.smooth, settings.late)
        found = [sample(case) for case in drawn]
        self.whole.append(_whole_row(pair.name, table, found))
        pieces = [sample(without_places(case, *_piece(case, pair))) for case in drawn]
        self.cut.append(_rejection_row(pair.name, table, pieces))
        jumps = [sample(_carried(case)) for case in drawn]
        self.carried.append(_rejection_row(pair.name, table, jumps))
        return found


def _intervals(name: str, tracks: Tracks, case: Case) -> str:
    """Describe how often the interval along the route holds the true position."""
    route = with_positions(case.reference, tracks.reference).route
    assert route is not None
    matches = case.match()
    known = case.truth.known[matches.query]
    gaps = distances(
        tracks.query.kind, tracks.query.at(matches.time_us)[known, None], route.position[None]
    )
    true_m = route.along_m[np.nanargmin(gaps, axis=1)]  # the nearest place of the map
    located = route.locate(matches.place[known], matches.settings.exclusion)
    inside = (located.from_m <= true_m) & (true_m <= located.to_m)
    width = np.nanmedian(located.to_m - located.from_m)
    return (
        f"Intervals along the route of {name} hold {inside.mean():.3f} of the true positions, at "
        f"a mean probability of {matches.probability[known].mean():.3f}; their median length is "
        f"{width:.0f} m."
    )


def cases(pair: Pair, seeds: int) -> Iterator[Case]:
    """Map and describe a pair with the default settings, once for each draw of pixels.

    Parameters
    ----------
    seeds : int
        Number of draws of pixels.
    """
    for seed in range(seeds if pair.drawn else 1):
        settings = PRESETS["default"].replaced(
            {
                "pixels": pair.settings.pixels,
                "strategy": pair.settings.strategy,
                "seed": seed,
            },
            "trust",
        )
        mapped = ReferenceMap.build(pair.reference, settings)
        counted = count_windows(pair.query, mapped.pixel_map, settings)
        truth = pair.truth_of(mapped.places.centre_us, counted.centre_us)
        yield Case(mapped, counted, truth)


def _piece(case: Case, pair: Pair) -> tuple[int, int]:
    places = len(case.reference)
    return (places // 2, 3 * places // 4) if pair.has_images else _CUT


def _carried(case: Case) -> Case:
    windows = len(case.counted)
    return carried_off(case, windows // 3, 2 * windows // 3)


def _whole_row(name: str, table: Confidence, found: list[Sample]) -> list[str]:
    pooled = joined(found)
    given = table.probability_of(pooled.trust)
    single = [_error(table, each) for each in found]
    counts = _rejection(table, pooled)
    return [
        name,
        f"{pooled.correct.mean():.3f}",
        f"{given.mean():.3f}",
        f"{_error(table, pooled):.3f}",
        str(Summary(single)),
        f"{_halves(found):.3f}",
        f"{(counts.accepted or 0) / pooled.trust.size:.3f}",
        _shown(counts.precision),
        _shown(counts.recall),
    ]


def _halves(found: list[Sample]) -> float:
    """Return the error of probabilities that were learnt on the other half of the same drives."""
    errors = []
    for each in found:
        middle = each.trust.size // 2
        first, last = (
            Sample(each.trust[part], each.correct[part], each.has_place[part])
            for part in (slice(None, middle), slice(middle, None))
        )
        for learnt, judged in ((first, last), (last, first)):
            errors.append(_error(learn_confidence(learnt.trust, learnt.correct), judged))
    return float(np.mean(errors))


def _error(table: Confidence, found: Sample) -> float:
    given = table.probability_of(found.trust)
    return reliability(given, found.correct).expected_calibration_error


def _rejection(table: Confidence, found: Sample) -> Rejection:
    return judge_rejection(*found, found.trust >= table.least_trust(PRECISION))


def _rejection_row(name: str, table: Confidence, found: list[Sample]) -> list[str]:
    each = [_rejection(table, some) for some in found]
    pooled = joined(found)
    counts = _rejection(table, pooled)
    aurocs = [some.off_map_auroc for some in each if some.off_map_auroc is not None]
    return [
        name,
        str(Summary([some.right_on_map or 0.0 for some in each])),
        str(Summary([some.found_at_99_precision or 0.0 for some in each])),
        str(Summary(aurocs)) if aurocs else "-",
        f"{_error(table, pooled):.3f}",
        f"{(counts.accepted or 0) / pooled.trust.size:.3f}",
        _shown(counts.precision),
        _shown(counts.recall),
        accepted_past_the_edge(found, table.least_trust(PRECISION)),
    ]


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
