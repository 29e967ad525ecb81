"""Accuracy of designs of several sizes on two drives, which are mapped, matched and evaluated."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import GroundTruthError, UsageError
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr_tools.estimate.search import Evaluated
from edge_vpr_tools.estimate.show import matching
from edge_vpr_tools.research.experiments.drives import simulated_pair
from edge_vpr_tools.research.experiments.experiment import Drives
from edge_vpr_tools.research.experiments.pairs import TOLERANCE_M, Pair
from firmware_model.design import Design

#: J and bits that are tried, as far as the sensor has pixels and the code bits
PIXELS = (10, 25, 50, 75, 100, 150, 250, 400)
BITS = (1, 2, 3, 4, 6, 8)
#: draws of pixels, each on a street of its own where streets are simulated; the accuracy is their
#: mean
DRAWS = 3
#: of the first street: it and those that follow chose no parameter
FIRST_SEED = 10


def simulated() -> Drives:
    """Return simulated streets that are driven twice, for use without recordings."""
    seeds = f"seeds {FIRST_SEED} to {FIRST_SEED + DRAWS - 1}"
    name = f"each of {DRAWS} simulated streets ({seeds}, within {TOLERANCE_M:g} m)"
    return Drives(name, lambda draw: simulated_pair(FIRST_SEED + draw), varied=True)


@dataclass(frozen=True, eq=False)
class _Run:
    """One design on one draw of pixels, with every match whose truth is known."""

    name: str
    reference: ReferenceMap
    #: start_us, end_us, shape (n,): of the query windows, in order.
    start_us: npt.NDArray[np.int64]
    end_us: npt.NDArray[np.int64]
    correct: npt.NDArray[np.bool_]  #: Shape (n,): whether each match is correct.

    def rows_at(self, times_us: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Return the match whose window each time lies in, -1 where there is none."""
        rows = np.searchsorted(self.start_us, times_us, side="right") - 1
        inside = (rows >= 0) & (times_us < self.end_us[rows])
        return np.where(inside, rows, -1)

    def correct_at(self, times_us: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Return whether the match at each of these times is correct; each has one."""
        return self.correct[self.rows_at(times_us)]


def try_designs(
    drives: Drives, designs: Sequence[Design], on_start: Callable[[str], None]
) -> list[Evaluated]:
    """Evaluate designs at several numbers of pixels and bits, all on the same queries.

    Windows of a fixed number of events hold as many as a window of the design's tau does on average
    in the reference drive. A query is the moment in the middle of a window of the first design; of
    each design, the match counts whose window that moment lies in. Moments for which a design has
    no match, as sequences have none in the first windows of a drive, count for none of them.

    Parameters
    ----------
    drives : Drives
        Open a `Pair` for the n-th draw of pixels; their name is for the answer.
    designs : sequence of Design
        All but their pixels, bits and places is their own.
    on_start : callable
        Called with the name of each stage before it begins.

    Returns
    -------
    list of Evaluated
        The accuracy is the mean over the draws of pixels.

    Raises
    ------
    UsageError
        If not even the fewest pixels can be drawn.
    GroundTruthError
        If the truth is known at no moment for which all designs have a match.
    """
    tried: list[list[_Run]] = []
    for draw in range(DRAWS):
        pair, runs = drives.open(draw), []
        for pixels in PIXELS:
            on_start(f"{pixels} pixels ({draw + 1} of {DRAWS})")
            try:
                runs += [run for of in designs for run in _draw(pair, of, pixels, draw)]
            except UsageError:
                if not runs:
                    raise
                break  # the sensor has no more
        tried.append(runs)
    known = [_moments(runs) for runs in tried]
    return [
        Evaluated(
            of[0].name,
            float(np.mean([run.correct_at(at).mean() for run, at in zip(of, known, strict=True)])),
            min(at.size for at in known),
            of[0].reference,
        )
        for of in zip(*tried, strict=True)
    ]


def _moments(runs: Sequence[_Run]) -> npt.NDArray[np.int64]:
    """Return the middles of windows of the first run at which all runs have a match."""
    found = (runs[0].start_us + runs[0].end_us) // 2
    for run in runs:
        found = found[run.rows_at(found) >= 0]
    if not found.size:
        raise GroundTruthError(
            "the truth is known for no query that all designs match: check that it covers the time "
            "of the query drive"
        )
    return found


def _draw(pair: Pair, design: Design, pixels: int, seed: int) -> Iterator[_Run]:
    """Map and match one draw of pixels with codes of each width, as a device does."""
    changes: dict[str, Any] = {
        "matching": design.matching,
        "places_per_window": design.places_per_window,
        "smooth": False,
        "query_mean": "running",
        "exclusion": design.exclusion // design.places_per_window,
        "window": design.window,
        "tau_us": design.tau_us,
        "events_per_pixel": None,
        "polarity": design.polarity,
        "pixels": pixels,
        "seed": seed,
    }
    if design.filters:
        changes |= {
            "filter_steps": None if design.activity_costs else design.steps,
            "filter_back": design.back,
            "filter_restart": max(design.restart, 1),
        }
    else:
        # the middle of a sequence is most often within the tolerance
        changes |= {"sequence_length": design.length, "anchor": "middle"}
    mapped = pair.mapped(PRESETS["default"].replaced(changes, "the design").uncoded)
    queries, truth = mapped.counted, mapped.truth
    code = {
        "counter_code": "log" if design.own_mean else design.code,
        "counter_scaling": design.code if design.own_mean else "shared",
    }
    for bits in BITS:
        coded = mapped.coded(code | {"counter_bits": bits})
        matches = coded.match()
        known = truth.known[matches.query]
        query = matches.query[known]
        yield _Run(
            f"{pixels} px, {bits} bit{'s' * (bits > 1)} {design.code}, {matching(design)}",
            coded.reference,
            queries.start_us[query],
            queries.end_us[query],
            truth.correct[matches.place[known], query],
        )
