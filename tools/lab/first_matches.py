"""How long a robot that is switched on in mid-route waits for its first matches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from edge_vpr.matching.matches import Matches
from lab.pairs import MappedPair

#: windows between two starts in mid-route, and most windows after a start
START_EVERY, MOST = 10, 120
#: least number of windows from a start to the end of the drive
_LEFT = 20


def first_matches(
    pairs: Sequence[MappedPair], accepted: Callable[[Matches], npt.NDArray[np.bool_]]
) -> dict[str, float | int | None]:
    """Switch on at many windows, and measure the time to the first correct and accepted matches.

    The time to the first correct match is the measure of Flash [1]_. Both times end with the window
    of the match, and their medians are over all starts: None, if fewer than half of them have such
    a match within `MOST` windows and before the end of the drive.

    Parameters
    ----------
    accepted : callable
        Which matches are accepted.

    References
    ----------
    .. [1] V. Ramanathan, M. Milford, T. Fischer, "Prepare for Warp Speed: Sub-millisecond Visual
       Place Recognition Using Event Cameras", arXiv:2509.24094.
    """
    correct_s: list[float] = []
    accepted_s: list[float] = []
    accepted_rightly: list[bool] = []
    for pair in pairs:
        windows = len(pair.counted)
        for start in range(0, windows - _LEFT, START_EVERY):
            if not pair.truth.has_truth[start]:
                continue
            part = slice(start, min(start + MOST, windows))
            rest = replace(pair, counted=pair.counted.take(part))
            matches = rest.match()
            seconds = (rest.counted.end_us - rest.counted.start_us[0]) / 1e6
            correct = pair.truth.correct[matches.place, start + matches.query]
            shown = accepted(matches)
            for times, reached in ((correct_s, correct), (accepted_s, shown)):
                times.append(float(seconds[np.argmax(reached)]) if reached.any() else np.inf)
            if shown.any():
                accepted_rightly.append(bool(correct[np.argmax(shown)]))
    return {
        "starts": len(correct_s),
        **_time_to("correct", correct_s),
        **_time_to("accepted", accepted_s),
        "correct of the first accepted": mean_of(accepted_rightly),
    }


def _time_to(name: str, seconds: Sequence[float]) -> dict[str, float | None]:
    """Return the share of the starts that have such a match, and the median time to it."""
    reached = mean_of(np.isfinite(seconds))
    late = reached is None or reached <= 0.5
    return {
        f"starts with a match {name}": reached,
        f"median time to the first {name} (s)": None if late else float(np.median(seconds)),
    }


def mean_of(values: Sequence[bool] | npt.NDArray[np.bool_]) -> float | None:
    """Return the share of true values; None of none."""
    return float(np.mean(values)) if len(values) else None
