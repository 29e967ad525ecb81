"""`edge-vpr stream`: localise live with a camera on a line, or make a map with it."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import printable
from edge_vpr.events import Sensor
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import duration_us
from edge_vpr_tools.arguments.setting_flags import map_settings, with_match_flags
from edge_vpr_tools.arguments.stream_checks import check_arguments
from edge_vpr_tools.output.cleaning import warn_if_much
from edge_vpr_tools.output.messages import summary
from edge_vpr_tools.runs.live import Line, LiveOutput, follow_line, learn_map
from edge_vpr_tools.runs.schedule import every_of, parse_every


def run(args: argparse.Namespace) -> None:
    """Follow the stream to its end, or until Ctrl-C or SIGTERM.

    Raises
    ------
    EdgeVprError
        If an argument is wrong, the link cannot be opened, or a file cannot be written.
    """
    check_arguments(args)
    output = LiveOutput(
        as_json=args.json, log=args.log, record=tuple(args.record), rerun=args.rerun,
        serve=args.serve, mqtt=args.mqtt, overwrite=args.overwrite,
    )  # fmt: skip
    if args.learn:
        _learn(args, output)
        return
    reference = None if args.map is None else _with_flags(args, ReferenceMap.load(args.map))
    every = None
    if reference is not None:
        every = parse_every(every_of(args.every, "50ms", reference), reference)
    causal = args.burst_filter == "causal"
    follow_line(
        _line(args, reference), output, reference, every,
        causal_bursts=causal, odometry=args.odometry,
    )  # fmt: skip


def _learn(args: argparse.Namespace, output: LiveOutput) -> None:
    settings, target = map_settings(args), Path(args.output)
    reference, removed = learn_map(_line(args, None), output, settings, target, args.odometry)
    warn_if_much(removed, args.port, "keep them with --bursts keep")
    if not args.json:
        summary(
            f"{printable(target)}: {len(reference)} places at {len(reference.pixel_map)} pixels"
        )


def _line(args: argparse.Namespace, reference: ReferenceMap | None) -> Line:
    sensor = Sensor.parse(args.sensor) if args.sensor else None
    if sensor is None:
        assert reference is not None
        sensor = reference.pixel_map.sensor
    return Line(
        port=args.port, protocol=args.protocol, sensor=sensor, baud=args.baud,
        flow_control=args.flow_control, once=args.once,
        drop=None if args.on_overload is None else args.on_overload == "drop",
        max_lag_s=duration_us(args.max_lag) / 1e6,
    )  # fmt: skip


def _with_flags(args: argparse.Namespace, reference: ReferenceMap) -> ReferenceMap:
    return reference.matched_with(with_match_flags(args, reference.settings, online=True))
