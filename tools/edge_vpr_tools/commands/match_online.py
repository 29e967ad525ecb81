"""`edge-vpr match --online`: a match after every event, as the board would give it."""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.matching.matches import Matches
from edge_vpr.online.localiser import Localiser
from edge_vpr.pipeline import Removed, check_sensor, cleaned
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.arguments.reading import describe_faults, fault_counts, open_from
from edge_vpr_tools.arguments.schedule import parse_every
from edge_vpr_tools.output import results
from edge_vpr_tools.output.cleaning import describe_removed, removed_record, warn_if_much
from edge_vpr_tools.output.messages import summary
from edge_vpr_tools.output.progress import tracked
from edge_vpr_tools.output.provenance import run_record, write_json

ONLINE_FIGURE = "online.png"


def match_online(args: argparse.Namespace, reference: ReferenceMap) -> None:
    """Feed the recording to a localiser and write what it said.

    Parameters
    ----------
    args : argparse.Namespace
        Of `edge-vpr match`.
    reference : ReferenceMap
        With the settings to use.

    Raises
    ------
    EdgeVprError
        If an argument is wrong or the recording cannot be matched.
    """
    if args.frames_as_windows:
        raise UsageError("--online needs events: leave --frames-as-windows out")
    if args.anchor is not None:
        raise UsageError("--online matches belong to the newest window: leave --anchor out")
    # the mean over the whole drive is known only when it is over
    settings = replace(reference.settings, query_mean="running")
    output, reference = Path(args.output), replace(reference, settings=settings)
    recording = open_from(args, args.recording)
    check_sensor(recording.sensor, reference.pixel_map.sensor)
    every = parse_every(args.every or "event", reference)
    localiser = Localiser(reference, every=every)
    found: list[npt.NDArray[np.void]] = []
    events_fed, busy_s = 0, 0.0
    removed = Removed()
    for events in cleaned(tracked(recording, "localising"), settings, removed):
        if not found:  # compiled before the clock runs
            Localiser(reference, every=every).update(events[:1])
        start = time.perf_counter()
        found.append(localiser.update(events))
        busy_s += time.perf_counter() - start
        events_fed += events.size
    rows = np.concatenate(found)
    if rows.size == 0:
        raise UsageError(
            f"the recording ended before a sequence of {settings.windows_per_match} windows was "
            "complete: take shorter windows or a longer drive"
        )
    matches = Matches.of_rows(rows, settings, len(reference))
    duration_s = rows["t"][-1] / 1e6
    metrics = {
        "matches": len(matches),
        "events": events_fed,
        "every": args.every or "event",
        "localising_s": busy_s,
        "times_real_time": duration_s / busy_s,
        "faults_dropped": fault_counts(recording),
    }
    with results.results_folder(output, args.overwrite) as folder:
        reference.save(folder / results.MAP)
        matches.save(folder / results.MATCHES)
        matches.save_csv(folder / results.MATCHES_CSV, reference.route)
        left_out = removed_record(removed, int(reference.hot.sum()))
        record = run_record(settings.to_dict(), [args.map, args.recording], left_out)
        write_json(folder / results.RUN, record)
        write_json(folder / results.METRICS, metrics)
        if not args.no_figures:
            from edge_vpr_tools.report.figures import online_places
            from edge_vpr_tools.report.style import save

            save(online_places(matches), folder / ONLINE_FIGURE)
    summary(
        f"{output}: {len(matches):,} matches of {events_fed:,} events over {duration_s:.1f} s"
        f"{describe_removed(removed, settings)}{describe_faults(recording)}"
    )
    summary(f"localising took {busy_s:.2f} s, {duration_s / busy_s:,.0f} times real time")
    warn_if_much(removed, args.recording, "make the map with --bursts keep")
