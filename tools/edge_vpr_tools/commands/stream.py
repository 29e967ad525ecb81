"""`edge-vpr stream`: match live with a camera on a line, or make a map with it."""

from __future__ import annotations

import argparse
import os
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from edge_vpr.errors import RecordingError, UsageError, printable
from edge_vpr.settings import duration_us
from edge_vpr_tools.console import (
    error_line,
    places_text,
    stopped_by_signals,
    summary,
    warn_of_few_places,
)
from edge_vpr_tools.flags import (
    DEFAULT_PRESET,
    add_map_flags,
    add_protocol_flag,
    map_flags,
    map_settings,
    match_flags,
    warn_of_no_effect,
)

if TYPE_CHECKING:
    from edge_vpr.live.session import LiveSession, Message
    from edge_vpr_tools.live_view import View

#: Interval in seconds at which the service manager is notified that the run is alive.
_ALIVE_S = 5.0

EXAMPLES = """\
  edge-vpr stream --port /dev/ttyUSB1 --protocol evpr --map monday.npz --precision 0.99
  edge-vpr stream --port tcp://pi:5000 --protocol evt3 --map monday.npz --precision 0.99 --http 7000
  edge-vpr stream --port /dev/ttyACM0 --protocol evpr --sensor 64x64 --learn -o new.npz"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    line = parser.add_argument_group("line")
    line.add_argument(
        "--port", required=True,
        help="where the camera is: a serial port such as /dev/ttyACM0, tcp://HOST:PORT, "
        "udp://:PORT, - for standard input, or a file of its bytes",
    )  # fmt: skip
    add_protocol_flag(line, "protocol of the camera: evpr, edvs, evt3, ...", required=True)
    line.add_argument("--sensor", metavar="WxH", help="size of the sensor (default: the map's)")
    line.add_argument(
        "--baud", type=int, metavar="N",
        help="bits per second of a serial port (default: 115200, or that of your own protocol)",
    )  # fmt: skip
    line.add_argument(
        "--flow-control", action="store_true", help="use the RTS and CTS wires of a serial port"
    )
    line.add_argument(
        "--once", action="store_true",
        help="stop when the connection ends or is not there, instead of opening it again",
    )  # fmt: skip
    line.add_argument(
        "--on-overload", choices=("drop", "wait"),
        help="if bytes arrive faster than they can be processed: drop and count the waiting ones, "
        "or make the sender wait (default: wait for files and pipes, drop for others)",
    )  # fmt: skip
    line.add_argument(
        "--max-lag", default="500ms", metavar="TIME",
        help="with --on-overload drop: drop the waiting bytes once the oldest has waited longer "
        "than this",
    )  # fmt: skip
    line.add_argument(
        "--max-age", metavar="TIME",
        help="reject a match that is older than this when it is printed (default: two windows)",
    )  # fmt: skip
    places = parser.add_argument_group("map and matches")
    places.add_argument("--map", metavar="MAP.npz", help="map to match with")
    places.add_argument(
        "--every", metavar="WHEN",
        help="when stream gives a match: a time such as 50ms, event (after each event at a "
        "selected pixel), N (after N of them), window (at the end of each window), or change (when "
        "the place changes) (default: 50ms); by events, matches come more often where the camera "
        "sees more",
    )  # fmt: skip
    places.add_argument(
        "--state", metavar="RUN.state",
        help="keep the state of the drive in this file, and resume from it if stream starts again "
        "within a minute (with evpr, within ten)",
    )  # fmt: skip
    line.add_argument(
        "--odometry", metavar="PORT",
        help="where the robot sends its odometry: a serial port of 115,200 baud, tcp://HOST:PORT, "
        "udp://:PORT, or - for standard input; each reading is a line of text with the metres "
        "driven from any zero",
    )  # fmt: skip
    output = parser.add_argument_group("output")
    output.add_argument("--log", metavar="RUN.jsonl", help="write matches and health as JSON lines")
    output.add_argument(
        "--record", action="append", default=[], metavar="FILE",
        help="save the raw bytes (.bin) or the events (.npz, .raw, ...); may be repeated",
    )  # fmt: skip
    output.add_argument(
        "--json", action="store_true", help="print matches and health as JSON lines"
    )
    output.add_argument(
        "--status-every", metavar="TIME",
        help="without --json and without a terminal, print a line of status this often, and "
        "whenever the link goes or returns, or matches begin to be rejected or accepted "
        "(default: 1s)",
    )  # fmt: skip
    output.add_argument(
        "--http", metavar="[HOST:]PORT",
        help="show the run on a page for a browser, and send the lines of --json to other "
        "programs; without HOST, only this machine can connect (default: none)",
    )  # fmt: skip
    output.add_argument("--overwrite", action="store_true", help="replace files that exist")
    learning = parser.add_argument_group("learning")
    learning.add_argument(
        "--learn", action="store_true",
        help="make a map of this drive; with --map, and without a preset or settings of a new map, "
        "add this drive to the map of --map",
    )  # fmt: skip
    learning.add_argument(
        "-o", "--output", metavar="MAP.npz",
        help="with --learn, the map to write; stream meanwhile matches with that of --map",
    )  # fmt: skip
    add_map_flags(parser, live=True)


def check_arguments(args: argparse.Namespace) -> None:
    """Check what a session does not, before the camera is opened or a file is written."""
    from edge_vpr.files import check_new_file
    from edge_vpr_tools.publish import parse_address

    if args.learn == (args.output is None):
        raise UsageError("--learn and -o MAP.npz belong together: give both, or neither")
    if not args.learn and (flags := map_flags(args)):
        raise UsageError(
            f"{flags[0]} belongs to making a map, and --map has one already: leave it out, or make "
            "a new map with --learn"
        )
    if args.odometry is not None:
        if args.map is None and not args.learn:
            raise UsageError(
                "--odometry is for --map and --learn: give one of them, or leave it out"
            )
        if args.odometry == args.port:
            raise UsageError(
                f"--odometry {args.odometry} is the camera's --port: give the odometer one of its "
                "own"
            )
    if args.http is not None:
        parse_address(args.http)
    if args.log is not None:
        log = Path(args.log)
        others = filter(None, (*args.record, args.output, args.state))
        if log.resolve() in {Path(name).resolve() for name in others}:
            raise UsageError(f"{log} is named twice: give each file another name")
        check_new_file(log, (args.port, args.map), args.overwrite)


def run(args: argparse.Namespace) -> None:
    """Follow the stream to its end, or until Ctrl-C or SIGTERM."""
    from edge_vpr.live.links import Line
    from edge_vpr.live.session import LiveSession
    from edge_vpr.live.session_files import SessionFiles

    check_arguments(args)
    new = args.map is None or args.preset != DEFAULT_PRESET or map_flags(args)
    line = Line(
        args.port, baud=args.baud, flow_control=args.flow_control, reconnect=not args.once,
        on_overload=args.on_overload, max_lag=args.max_lag,
    )  # fmt: skip
    files = SessionFiles(
        record=args.record, learn=args.output, state=args.state, overwrite=args.overwrite,
        settings=map_settings(args) if args.learn and new else None,
    )  # fmt: skip
    session = LiveSession(
        line, protocol=args.protocol, reference=args.map, every=args.every, sensor=args.sensor,
        odometry=args.odometry, max_age=args.max_age, files=files,
        **({} if args.map is None and args.learn else match_flags(args)),
    )  # fmt: skip
    if session.reference is not None:
        warn_of_no_effect(args, session.reference.settings)
    _show(args, session)
    if files.learnt is not None:
        learnt, update = files.learnt, files.update
        pixels = len(learnt.pixel_map)
        text = f"{printable(args.output)}: {places_text(learnt)} at {pixels} pixels"
        summary(text if update is None else f"{text}; {update}")
        warn_of_few_places(args.output, learnt)


def _show(args: argparse.Namespace, session: LiveSession) -> None:
    """Open a session, show it to its end, and close everything in any case, the session last."""
    from edge_vpr_tools.live_view import open_view
    from edge_vpr_tools.publish import MatchServer

    line_s = duration_us(args.status_every) / 1e6 if args.status_every else None
    try:
        with ExitStack() as stack:
            stack.enter_context(stopped_by_signals(session.stopping))
            server = None
            if args.http is not None:
                server = stack.enter_context(MatchServer(args.http))

            def show_stage(message: Message) -> None:
                if server is not None and message.kind == "compiling":
                    server.stage = message.text

            session.on_message = show_stage  # the command itself notes that it compiles
            session.open()
            if session.reference is not None:
                warn_of_few_places(args.map, session.reference)
            # opened last, so that a missing camera does not overwrite the run before
            view = stack.enter_context(
                open_view(args.json, args.log, session.reference, server, line_s)
            )
            tell_systemd("READY=1")
            _show_steps(session, view)
    finally:
        session.on_message = lambda message: error_line(message.text)
        session.close()


def tell_systemd(state: str) -> None:
    """Send a state to the service manager, if it has started this program and waits for one."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if address:
        import socket

        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
            sock.sendto(state.encode(), address.replace("@", "\0", 1))


def _show_steps(session: LiveSession, view: View) -> None:
    """Show each step of a session, and then what it lost."""
    from edge_vpr.live.watches import nothing_valid

    session.on_message = lambda message: view.say(message.kind, message.text, over=message.over)
    alive_s = 0.0
    try:
        for step in session.steps():
            for reading in step.odometry:
                view.odometry(*reading)
            view.matches(step)
            view.tick(session.status)
            if time.monotonic() >= alive_s:
                alive_s = time.monotonic() + _ALIVE_S
                tell_systemd("WATCHDOG=1")
            if view.unread:
                session.stop()
    finally:
        status = session.status
        view.summary(status)
    if text := session.files.unwritten or view.unwritten:
        raise RecordingError(text)
    if text := nothing_valid(session.health):
        raise RecordingError(f"{session.address}: {text}")
