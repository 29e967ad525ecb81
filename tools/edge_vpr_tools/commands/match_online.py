"""`edge-vpr match --online`: match a recording event by event, as a device does."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.odometry import Odometry
from edge_vpr.pipeline import check_sensor
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.arguments.reading import describe_faults, open_from
from edge_vpr_tools.output import results
from edge_vpr_tools.output.cleaning import describe_removed, warn_if_much
from edge_vpr_tools.output.messages import summary
from edge_vpr_tools.output.progress import tracked
from edge_vpr_tools.report.formats import read_formats
from edge_vpr_tools.runs.match_folder import write_match_folder
from edge_vpr_tools.runs.online import localise, made_causal
from edge_vpr_tools.runs.registration import registered
from edge_vpr_tools.runs.schedule import every_of, parse_every


def match_online(
    args: argparse.Namespace, reference: ReferenceMap, odometry: Odometry | None
) -> None:
    """Feed the recording to a localiser and write its matches.

    Parameters
    ----------
    args : argparse.Namespace
        Of `edge-vpr match`.
    reference : ReferenceMap
        With the settings to use.
    odometry : Odometry or None
        Of the query drive.

    Raises
    ------
    EdgeVprError
        If an argument is wrong or the recording cannot be matched.
    """
    if args.frames_as_windows:
        raise UsageError("--online needs events: leave --frames-as-windows out")
    if args.anchor is not None:
        raise UsageError("--online matches belong to the newest window: leave --anchor out")
    output, reference = Path(args.output), made_causal(reference)
    settings, every = (
        reference.settings,
        every_of(args.every, "event", reference),
    )
    recording = open_from(args, args.recording)
    check_sensor(recording.sensor, reference.pixel_map.sensor)
    reference, shift = registered(reference, recording, args.register)
    schedule = parse_every(every, reference)
    found = localise(reference, tracked(recording, "localising"), schedule, odometry)
    matches = found.matches
    metrics = found.metrics(every, recording.faults, shift)
    with results.results_folder(output, args.overwrite) as folder:
        inputs = list(filter(None, (args.map, args.recording, args.odometry)))
        write_match_folder(folder, reference, matches, found.removed, metrics, inputs)
        if not args.no_figures:
            from edge_vpr_tools.report.traverse import write_online_figure

            write_online_figure(folder, reference, matches, read_formats(args.figures))
    summary(
        f"{output}: {len(matches):,} matches of {found.events:,} events over "
        f"{found.duration_s:.1f} s{describe_removed(found.removed, settings)}"
        f"{describe_faults(recording)}"
    )
    times = found.duration_s / found.busy_s
    summary(f"localising took {found.busy_s:.2f} s, {times:,.0f} times real time")
    warn_if_much(found.removed, args.recording, "make the map with --bursts keep")
