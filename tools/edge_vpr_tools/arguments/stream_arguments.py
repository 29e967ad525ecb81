"""Arguments of `edge-vpr stream`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.setting_flags import add_map_flags

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
    line.add_argument(
        "--odometry", metavar="PORT",
        help="where the robot's odometer is read: a serial port of 115,200 baud, tcp://HOST:PORT, "
        "udp://:PORT, or - for standard input; a line of text for each reading, in metres driven "
        "from any zero",
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
