"""What `edge-vpr stream` can be told, and what of it makes no sense together."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.recordings.registry import FORMATS
from edge_vpr.whole_files import check_output
from edge_vpr_tools.arguments.setting_flags import add_map_flags, given_map_flags
from edge_vpr_tools.publishing.line_server import parse_address
from edge_vpr_tools.publishing.mqtt import parse_url

EXAMPLES = """\
  edge-vpr stream --port /dev/ttyACM0 --protocol openmv --map monday.npz
  edge-vpr stream --port tcp://board:7000 --protocol evt3 --map monday.npz --log run.jsonl
  edge-vpr stream --port /dev/ttyACM0 --protocol evpr --sensor 64x64 --learn -o new.npz"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    line = parser.add_argument_group("line")
    line.add_argument(
        "--port", required=True,
        help="/dev/ttyACM0, tcp://HOST:PORT, udp://:PORT, - for standard input, or a file of bytes",
    )  # fmt: skip
    line.add_argument("--protocol", required=True, metavar="P", help="evpr, edvs, evt3, ...")
    line.add_argument("--sensor", metavar="WxH", help="size of the sensor (default: the map's)")
    line.add_argument(
        "--baud", type=int, metavar="N", help="of a serial port (default: the protocol's)"
    )
    line.add_argument("--flow-control", action="store_true", help="use RTS and CTS")
    line.add_argument(
        "--once", action="store_true", help="end when the link ends, instead of opening it again"
    )
    line.add_argument(
        "--on-overload", choices=("drop", "wait"),
        help="drop the oldest bytes and count them, or let the sender wait (default: drop, but for "
        "files and pipes)",
    )  # fmt: skip
    line.add_argument(
        "--max-lag", default="500ms", metavar="TIME",
        help="on overload, drop everything that waits once its oldest bytes have waited so long",
    )  # fmt: skip
    places = parser.add_argument_group("localising")
    places.add_argument("--map", metavar="MAP.npz", help="map to localise on")
    places.add_argument(
        "--every", default="50ms", metavar="WHEN",
        help="when to match: a time, N events, event, window or change",
    )  # fmt: skip
    places.add_argument(
        "--burst-filter", choices=("exact", "causal"), default="exact",
        help="wait up to 4 ms to know a burst, as with a recording, or remove what is known of it "
        "at once",
    )  # fmt: skip
    output = parser.add_argument_group("output")
    output.add_argument("--log", metavar="RUN.jsonl", help="write matches and health as JSON lines")
    output.add_argument(
        "--record", action="append", default=[], metavar="FILE",
        help="write raw bytes (.bin) or events (.npz, .raw, ...); may be given twice",
    )  # fmt: skip
    output.add_argument(
        "--rerun", nargs="?", const="viewer", metavar="FILE.rrd",
        help="show events and matches in the Rerun viewer, or save them for it",
    )  # fmt: skip
    output.add_argument("--json", action="store_true", help="JSON lines on standard output")
    output.add_argument(
        "--serve", metavar="[HOST:]PORT",
        help="the same lines for every program that connects to this TCP port; a port alone is of "
        "this machine only (default: none)",
    )  # fmt: skip
    output.add_argument(
        "--mqtt", metavar="mqtt://HOST/TOPIC", help="send the same lines to a broker of MQTT"
    )
    output.add_argument("--overwrite", action="store_true", help="replace files that exist")
    learning = parser.add_argument_group("learning")
    learning.add_argument("--learn", action="store_true", help="make a map of this drive")
    learning.add_argument(
        "-o", "--output", metavar="MAP.npz", help="with --learn, the map to write"
    )
    add_map_flags(parser)


def check_arguments(args: argparse.Namespace) -> None:
    """Refuse what cannot be, before the camera is opened or a file is touched.

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
        raise UsageError(f"{flags[0]} is decided when a map is made: leave it out, or --learn anew")
    if args.baud is not None and args.baud < 1:
        raise UsageError(f"--baud {args.baud}: expected the speed of a serial port, such as 921600")
    if args.serve is not None:
        parse_address(args.serve)
    if args.mqtt is not None:
        parse_url(args.mqtt)
    _check_files(args)


def _check_files(args: argparse.Namespace) -> None:

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
        check_output(path, [given for given in (args.port, args.map) if given])
        if path.exists() and not args.overwrite:
            raise UsageError(f"{path} exists: name another file, or replace it with --overwrite")
        if not path.absolute().parent.is_dir():
            raise UsageError(f"{path.absolute().parent} is not a folder: make it first")
