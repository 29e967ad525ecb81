"""What windows of equal distance are worth: each place looks back over as many events as it has.

The reference is cut into windows of equal distance (fixed tau at its nearly constant speed); place
k then holds N_k events. At query time place k is compared with the newest N_k events, place k - 1
with the N_{k-1} before them, and so on, whatever the speed. Since places of few events have small
distances to anything, a sequence's distance is divided by its number of events.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.counters import select_events
from edge_vpr.pipeline import cleaned, map_traverse
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulate import SimulatedRecording, simulate_pair
from edge_vpr_tools.experiments.simulated import SETTINGS, TOLERANCE_M, truth_of_pair
from edge_vpr_tools.experiments.trial import Summary, Variant, markdown_table, run_trial

Counts = npt.NDArray[np.int64]


def run(data: object, seeds: int, on_start: Callable[[str], None]) -> str:
    """Compare adaptive windows with fixed N and fixed tau, as a Markdown table.

    Parameters
    ----------
    data : object
        Not used: the pairs are simulated.
    seeds : int
        Number of pairs.
    on_start : callable
        Told which pair begins.
    """
    shares: dict[str, list[float]] = {"fixed N": [], "fixed tau": [], "adaptive": []}
    for seed in range(seeds):
        on_start(f"pair {seed + 1} of {seeds}")
        reference, query = (drive.keep() for drive in simulate_pair(seed))
        settings = SETTINGS.replaced({"seed": seed}, "seed")
        truth_of = truth_of_pair(reference, query)
        for name, window in (("fixed N", "count"), ("fixed tau", "time")):
            variant = Variant(name, {"window": window})
            trial = run_trial(reference, query, truth_of, settings, variant)
            shares[name].append(trial.evaluation.precision_at_100_recall)
        mapped = map_traverse(reference, settings)
        shares["adaptive"].append(right_share(mapped, reference, query))
    rows = [[name, str(Summary(values))] for name, values in shares.items()]
    return markdown_table(("windows", "P@100R"), rows)


def right_share(
    mapped: ReferenceMap, reference: SimulatedRecording, query: SimulatedRecording
) -> float:
    """Match with adaptive windows, as often as fixed N would, and tell the share of right ones."""
    slots, times = _selected_events(mapped, query)
    counts = mapped.places.counts.astype(np.int64)
    events = counts.sum(axis=1)
    seen = np.zeros((slots.size + 1, counts.shape[1]), dtype=np.int32)
    seen[np.arange(slots.size) + 1, slots] = 1
    np.cumsum(seen, axis=0, out=seen)
    length, step = mapped.settings.sequence_length, round(events.mean())
    right = []
    for now in range((length + 1) * step, slots.size, step):
        place = best_place(counts, events, seen, now, length)
        begin = max(0, now - int(events[place]))
        middle = np.array([(times[begin] + times[now]) // 2])
        at = query.track.at(middle)[0, 0]
        mapped_at = reference.track.at(mapped.places.centre_us[place : place + 1])[0, 0]
        right.append(abs(at - mapped_at) <= TOLERANCE_M)
    return float(np.mean(right))


def best_place(
    counts: Counts, events: Counts, seen: npt.NDArray[np.int32], now: int, length: int
) -> int:
    """Find the place whose sequence of windows, each of its own length, is nearest.

    Parameters
    ----------
    counts : ndarray of int64, shape (K, J)
        Reference descriptors.
    events : ndarray of int64, shape (K,)
        N_k, their sums.
    seen : ndarray of int32, shape (n + 1, J)
        Selected events of the query up to each, by slot.
    now : int
        Number of events so far.
    length : int
        L.

    Returns
    -------
    int
        A place from L - 1 on; the lowest of equals.
    """
    ends = np.arange(length - 1, len(counts))
    end = np.full(ends.size, now)
    distance = np.zeros(ends.size, dtype=np.int64)
    total = np.zeros(ends.size, dtype=np.int64)
    for lag in range(length):
        begin = end - events[ends - lag]
        window = seen[np.maximum(end, 0)] - seen[np.maximum(begin, 0)]
        distance += np.abs(counts[ends - lag] - window).sum(axis=1)
        total += events[ends - lag]
        end = begin
    score = np.where(end < 0, np.inf, distance / np.maximum(total, 1))
    return int(ends[np.argmin(score)])


def _selected_events(
    mapped: ReferenceMap, query: SimulatedRecording
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64]]:
    table = mapped.pixel_map.table()
    slots, times = [], []
    for events in cleaned(query, mapped.settings):
        index, found = select_events(table, events["x"], events["y"])
        slots.append(found)
        times.append(events["t"][index])
    return np.concatenate(slots), np.concatenate(times)
