"""Checks of the arguments of `edge-vpr stream`."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.recordings.registry import FORMATS
from edge_vpr.whole_files import check_output
from edge_vpr_tools.arguments.setting_flags import given_map_flags
from edge_vpr_tools.publishing.line_server import parse_address
from edge_vpr_tools.publishing.mqtt import parse_url


def check_arguments(args: argparse.Namespace) -> None:
    """Check the arguments before the camera is opened or a file is written.

    Raises
    ------
    UsageError
        If arguments contradict each other, or a file could not be written as asked.
    """
    if args.learn == (args.output is None):
        raise UsageError("--learn and -o MAP.npz belong together: give both, or neither")
    if args.learn and args.map:
        raise UsageError("--learn makes a map and --map uses one: give one of them")
    if args.sensor is None and args.map is None:
        raise UsageError("the size of the sensor is not known: pass --sensor WIDTHxHEIGHT or --map")
    if not args.learn and (flags := given_map_flags(args)):
        raise UsageError(
            f"{flags[0]} belongs to making a map, and --map has one already: leave it out, or make "
            "a new map with --learn"
        )
    if args.baud is not None and args.baud < 1:
        raise UsageError(f"--baud {args.baud}: expected the speed of a serial port, such as 921600")
    _check_odometry(args)
    if args.serve is not None:
        parse_address(args.serve)
    if args.mqtt is not None:
        parse_url(args.mqtt)
    _check_files(args)


def _check_odometry(args: argparse.Namespace) -> None:
    if args.odometry is None:
        return
    if args.map is None and not args.learn:
        raise UsageError("--odometry is for --map and --learn: give one of them, or leave it out")
    if args.odometry == args.port:
        raise UsageError(
            f"--odometry {args.odometry} is the camera's --port: give the odometer one of its own"
        )
    if Path(args.odometry).is_file():
        raise UsageError(
            f"--odometry {args.odometry} is a file, and stream reads the odometer as the robot "
            "drives: match a recording with edge-vpr match --odometry"
        )


def _check_files(args: argparse.Namespace) -> None:
    known = [suffix for entry in FORMATS.values() if entry.writable for suffix in entry.suffixes]
    of_events = [name for name in args.record if Path(name).suffix != ".bin"]
    if len(of_events) > (0 if args.learn else 1):
        raise UsageError(
            "--record can write one file of events, and none with --learn: record bytes (.bin)"
        )
    for name in of_events:
        if Path(name).suffix not in known:
            raise UsageError(f"--record {name}: expected .bin for bytes, or {', '.join(known)}")
    saved = None if args.rerun == "viewer" else args.rerun
    seen = {Path(name).resolve() for name in (args.port, args.map) if name}
    for name in filter(None, [*args.record, args.log, args.output, saved]):
        path = Path(name)
        if path.resolve() in seen:
            raise UsageError(f"{path} is named twice: give each file another name")
        seen.add(path.resolve())
        check_output(path, (args.port, args.map))
        if path.exists() and not args.overwrite:
            raise UsageError(f"{path} exists: name another file, or replace it with --overwrite")
        if not path.absolute().parent.is_dir():
            raise UsageError(f"{path.absolute().parent} is not a folder: make it first")
