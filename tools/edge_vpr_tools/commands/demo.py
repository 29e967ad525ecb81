"""`edge-vpr demo`: simulate, map, match and evaluate a street, in half a minute."""

from __future__ import annotations

import argparse
import math
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, NamedTuple

from edge_vpr_tools.console import say, status, table
from edge_vpr_tools.flags import add_output_flags

if TYPE_CHECKING:
    from edge_vpr.descriptors.counting import EventSource
    from edge_vpr.evaluation.tracks import Track
    from edge_vpr.online.localiser import MatchSchedule
    from edge_vpr.reference_map import ReferenceMap

EXAMPLES = """\
  edge-vpr demo
  edge-vpr demo --seed 3 -o results/street3"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_output_flags(parser, help="folder for the report", required=False, default="results/demo")
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulated street")


_WIDTH = 100


def run(args: argparse.Namespace) -> None:
    """Simulate, try every variant, print the table and write the report."""
    from edge_vpr import results
    from edge_vpr.online.localiser import MatchSchedule
    from edge_vpr.results import run_record, write_json
    from edge_vpr.simulation import simulate_pair
    from edge_vpr_tools.inputs import tracked
    from edge_vpr_tools.report.demo_page import HEADER, remarks, rows, write_report
    from edge_vpr_tools.research.experiments import simulated
    from edge_vpr_tools.research.experiments.pairs import Pair
    from edge_vpr_tools.research.experiments.variants import VariantResult

    output = Path(args.output)
    output.absolute().parent.mkdir(parents=True, exist_ok=True)
    results.check_output_folder(output, args.overwrite)
    reference, query = simulate_pair(args.seed)
    reference.keep(partial(tracked, label="simulating the reference drive"))
    label = "simulating the query drive: other speed, other light, other traffic"
    query.keep(partial(tracked, label=label))
    pair, trials = Pair.simulated(reference, query), {}
    with status("mapping and matching") as show:
        for variant in simulated.VARIANTS:
            show(variant.name)
            trials[variant.name] = VariantResult.of(variant.of(pair, args.seed))
        show("matching event by event")
        tracks = reference.track, query.track
        mapped = trials[simulated.DEFAULT].reference
        latencies = {
            name: _latency(mapped, query, tracks, every)
            for name, every in (
                ("event by event", MatchSchedule(events=1)),
                ("window by window", MatchSchedule.window(mapped.settings)),
            )
        }
        found = "; ".join(f"{name} {latency}" for name, latency in latencies.items())
        first = f"From entering a place to its first correct match, median: {found}."
        lines = [*remarks(trials), first]
        show("drawing the report")
        with results.results_folder(output, args.overwrite) as folder:
            metrics = {
                "variants": trials,
                "latency_median_s": {name: found.median_s for name, found in latencies.items()},
            }
            settings = pair.drawn_with(args.seed)
            write_json(folder / results.RUN, run_record(settings.to_dict(), []))
            write_json(folder / results.METRICS, metrics)
            write_report(folder, trials, lines, reference.track)
    title = "One street, driven twice, the second time at half to double the speed"
    table(HEADER, rows(trials), title=title, width=_WIDTH)
    for line in lines:
        say(line, width=_WIDTH, markup=True)
    film = f"edge-vpr replay {quote(str(output))} -o match.gif"
    say(f"See {output / results.REPORT}; as a film: {film}", width=_WIDTH)


class _Latency(NamedTuple):
    """Time from entering a place to its first correct match."""

    median_s: float  #: Median over the recognised places in seconds; NaN if there are none.
    #: Number of places that were recognised before the drive was too far past their end.
    recognised: int
    places: int  #: Number of places entered while matches were given.

    def __str__(self) -> str:
        return f"{self.median_s:.2f} s ({self.recognised} of {self.places} places recognised)"


def _latency(
    reference: ReferenceMap, query: EventSource, tracks: tuple[Track, Track], every: MatchSchedule
) -> _Latency:
    """Run the query online, and measure the time to each place's first correct match.

    A place is entered when the query reaches the position at which the reference's window began. It
    is recognised by the first later match with this place, or with a later place whose window began
    within `TOLERANCE_M` of the query's position, while the query is not yet so far past the
    window's end.

    Parameters
    ----------
    tracks : (Track, Track)
        Of the reference and of the query, with one coordinate: the distance along the route, which
        does not decrease.
    """
    import numpy as np

    from edge_vpr.descriptors.counting import cleaned
    from edge_vpr.online.localiser import Localiser
    from edge_vpr_tools.research.experiments.pairs import TOLERANCE_M

    reference_track, query_track = tracks
    localiser = Localiser(reference, every=every)
    given = [localiser.update(events) for events in cleaned(query, reference.settings)]
    matches = np.concatenate(given)
    start_m = reference_track.at(reference.places.start_us)[:, 0]
    end_m = reference_track.at(reference.places.end_us)[:, 0]
    at_m = query_track.at(matches["time_us"])[:, 0]
    along_m = query_track.position[:, 0]
    entered_us = np.interp(start_m, along_m, query_track.time_us, left=np.nan, right=np.nan)

    named = matches["place"]
    near = np.abs(start_m[named] - at_m) <= TOLERANCE_M
    seconds, places = [], 0
    for k in range(reference.settings.windows_per_match - 1, len(reference)):
        if not (np.isfinite(entered_us[k]) and matches["time_us"][0] <= entered_us[k]):
            continue
        places += 1
        first, last = np.searchsorted(matches["time_us"], [entered_us[k], np.inf])
        last = first + np.searchsorted(at_m[first:last], end_m[k] + TOLERANCE_M)
        correct = (named[first:last] == k) | ((named[first:last] > k) & near[first:last])
        if correct.any():
            seconds.append((matches["time_us"][first + np.argmax(correct)] - entered_us[k]) / 1e6)
    return _Latency(float(np.median(seconds)) if seconds else math.nan, len(seconds), places)
