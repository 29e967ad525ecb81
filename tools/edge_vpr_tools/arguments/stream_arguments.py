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
        help="where the camera is: a serial port such as /dev/ttyACM0, tcp://HOST:PORT, "
        "udp://:PORT, - for standard input, or a file of its bytes",
    )  # fmt: skip
    line.add_argument(
        "--protocol", required=True, metavar="P",
        help="protocol of the camera: evpr, edvs, evt3, ...",
    )  # fmt: skip
    line.add_argument("--sensor", metavar="WxH", help="size of the sensor (default: the map's)")
    line.add_argument(
        "--baud", type=int, metavar="N",
        help="bits per second of a serial port (default: the protocol's)",
    )  # fmt: skip
    line.add_argument(
        "--flow-control", action="store_true", help="use the RTS and CTS wires of a serial port"
    )
    line.add_argument(
        "--once", action="store_true",
        help="stop when the connection ends, instead of opening it again",
    )  # fmt: skip
    line.add_argument(
        "--on-overload", choices=("drop", "wait"),
        help="if bytes arrive faster than they can be processed: drop the oldest bytes and count "
        "them, or let the sender wait (default: wait for files and pipes, drop for others)",
    )  # fmt: skip
    line.add_argument(
        "--max-lag", default="500ms", metavar="TIME",
        help="with --on-overload drop: drop all waiting bytes as soon as the oldest of them have "
        "waited longer than this",
    )  # fmt: skip
    places = parser.add_argument_group("localising")
    places.add_argument("--map", metavar="MAP.npz", help="map to localise on")
    places.add_argument(
        "--every", metavar="WHEN",
        help="when to give a match: after a time such as 50ms, after N events, after each event or "
        "window, or after each change of the place (default: 50ms; window with --delay)",
    )  # fmt: skip
    places.add_argument(
        "--burst-filter", choices=("exact", "causal"), default="exact",
        help="exact: delay events by up to 4 ms and remove the same bursts as in a recording; "
        "causal: do not delay, and remove a burst only from the moment it is recognised",
    )  # fmt: skip
    line.add_argument(
        "--odometry", metavar="PORT",
        help="where the robot sends its odometer: a serial port of 115,200 baud, tcp://HOST:PORT, "
        "udp://:PORT, or - for standard input; each reading is a line of text with the metres "
        "driven from any zero",
    )  # fmt: skip
    output = parser.add_argument_group("output")
    output.add_argument("--log", metavar="RUN.jsonl", help="write matches and health as JSON lines")
    output.add_argument(
        "--record", action="append", default=[], metavar="FILE",
        help="save the raw bytes (.bin) or the events (.npz, .raw, ...); may be given twice",
    )  # fmt: skip
    output.add_argument(
        "--rerun", nargs="?", const="viewer", metavar="FILE.rrd",
        help="show events and matches in the Rerun viewer, or save them to a file for it",
    )  # fmt: skip
    output.add_argument(
        "--json", action="store_true", help="print matches and health as JSON lines"
    )
    output.add_argument(
        "--serve", metavar="[HOST:]PORT",
        help="send the same lines to every program that connects to this TCP port; without HOST, "
        "only programs on this machine can connect (default: none)",
    )  # fmt: skip
    output.add_argument(
        "--mqtt", metavar="mqtt://HOST/TOPIC", help="send the same lines to an MQTT broker"
    )
    output.add_argument("--overwrite", action="store_true", help="replace files that exist")
    learning = parser.add_argument_group("learning")
    learning.add_argument("--learn", action="store_true", help="make a map of this drive instead")
    learning.add_argument(
        "-o", "--output", metavar="MAP.npz", help="with --learn, the map to write"
    )
    add_map_flags(parser)
