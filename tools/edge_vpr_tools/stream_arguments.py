"""What `edge-vpr stream` can be told, and what of it makes no sense together."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr_tools.setting_flags import add_map_flags, given_map_flags


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "--port", required=True,
        help="/dev/ttyACM0, tcp://HOST:PORT, udp://:PORT, - for standard input, or a file of bytes",
    )  # fmt: skip
    parser.add_argument("--protocol", required=True, metavar="P", help="evpr, edvs, evt3, ...")
    parser.add_argument("--sensor", metavar="WxH", help="size of the sensor (default: the map's)")
    parser.add_argument("--baud", type=int, help="of a serial port (default: the protocol's)")
    parser.add_argument("--flow-control", action="store_true", help="use RTS and CTS")
    parser.add_argument("--map", metavar="MAP.npz", help="map to localise on")
    parser.add_argument(
        "--every", default="50ms", metavar="WHEN",
        help="when to match: a time, N events, event, window or change (default 50ms)",
    )  # fmt: skip
    parser.add_argument(
        "--burst-filter", choices=("exact", "causal"), default="exact",
        help="wait up to 4 ms to know a burst, as with a recording, or remove what is known of it "
        "at once (default exact)",
    )  # fmt: skip
    parser.add_argument(
        "--once", action="store_true", help="end when the link ends, instead of opening it again"
    )
    parser.add_argument(
        "--on-overload", choices=("drop", "wait"),
        help="drop the oldest bytes and count them, or let the sender wait (default: drop, but for "
        "files and pipes)",
    )  # fmt: skip
    parser.add_argument(
        "--max-lag", default="500ms", metavar="TIME",
        help="on overload, drop everything that waits once its oldest bytes have waited so long "
        "(default 500ms)",
    )  # fmt: skip
    parser.add_argument("--log", metavar="RUN.jsonl", help="write matches and health as JSON lines")
    parser.add_argument(
        "--record", action="append", default=[], metavar="FILE",
        help="write raw bytes (.bin) or events (.npz, .raw, ...); may be given twice",
    )  # fmt: skip
    parser.add_argument(
        "--rerun", nargs="?", const="viewer", metavar="FILE.rrd",
        help="show events and matches in the Rerun viewer, or save them for it",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="JSON lines on standard output")
    parser.add_argument("--learn", action="store_true", help="make a map of this drive")
    parser.add_argument("-o", "--output", metavar="MAP.npz", help="with --learn, the map to write")
    parser.add_argument("--overwrite", action="store_true", help="replace files that exist")
    add_map_flags(parser)


def check_arguments(args: argparse.Namespace) -> None:
    """Refuse what cannot be, before the camera is opened or a file is touched.

    Raises
    ------
    UsageError
        If arguments contradict each other, or a file could not be written as asked.
    """
    from edge_vpr.errors import UsageError

    if args.learn == (args.output is None):
        raise UsageError("--learn and -o MAP.npz belong together: give both, or neither")
    if args.learn and args.map:
        raise UsageError("--learn makes a map and --map uses one: give one of them")
    if args.sensor is None and args.map is None:
        raise UsageError("the size of the sensor is not known: pass --sensor WIDTHxHEIGHT or --map")
    if not args.learn and (flags := given_map_flags(args)):
        raise UsageError(f"{flags[0]} is decided when a map is made: leave it out, or --learn anew")
    if args.baud is not None and args.baud < 1:
        raise UsageError(f"--baud {args.baud}: expected the speed of a serial port, such as 921600")
    _check_files(args)


def _check_files(args: argparse.Namespace) -> None:
    from edge_vpr.errors import UsageError
    from edge_vpr.recordings.registry import FORMATS

    known = [suffix for entry in FORMATS.values() if entry.writable for suffix in entry.suffixes]
    of_events = [name for name in args.record if Path(name).suffix != ".bin"]
    if len(of_events) > (0 if args.learn else 1):
        raise UsageError("one file of events can be recorded, and none with --learn: use .bin")
    for name in of_events:
        if Path(name).suffix not in known:
            raise UsageError(f"--record {name}: expected .bin for bytes, or {', '.join(known)}")
    saved = None if args.rerun == "viewer" else args.rerun
    seen = {Path(name).resolve() for name in (args.port, args.map) if name}
    for name in filter(None, [*args.record, args.log, args.output, saved]):
        path = Path(name)
        if path.resolve() in seen:
            raise UsageError(f"{path} is named twice: give each file a name of its own")
        seen.add(path.resolve())
        if path.exists() and not args.overwrite:
            raise UsageError(f"{path} exists: name another file, or replace it with --overwrite")
        if not path.absolute().parent.is_dir():
            raise UsageError(f"{path.absolute().parent} is not a folder: make it first")
