"""`edge-vpr stream`: localise live from a camera on a line, or learn a map from it."""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edge_vpr_tools.setting_flags import add_map_flags

if TYPE_CHECKING:
    from edge_vpr.events import Events
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr.stream.intake import Intake
    from edge_vpr.stream.live import LiveLocaliser, Step
    from edge_vpr_tools.live_view import View
    from edge_vpr_tools.rerun_view import RerunView

HELP = "localise live from a camera on a serial line, TCP, UDP, a pipe or a file"
STALLED_S = 1.0


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


def run(args: argparse.Namespace) -> None:
    """Follow the stream to its end, or until Ctrl-C or SIGTERM.

    Raises
    ------
    EdgeVprError
        If an argument is wrong, the link cannot be opened, or a file cannot be written.
    """
    import tempfile

    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr_tools.setting_flags import map_settings

    _check(args)
    with ExitStack() as stack:
        learned: Path | None = None
        if args.learn:
            settings = map_settings(args)
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="edge-vpr-"))
            learned = Path(folder) / "drive.npz"
            _follow(args, None, learned)
            _learn(args, learned, settings)
            return
        reference = None if args.map is None else _with_flags(args, ReferenceMap.load(args.map))
        _follow(args, reference, None)


def _check(args: argparse.Namespace) -> None:
    from edge_vpr.errors import UsageError

    if args.learn == (args.output is None):
        raise UsageError("--learn and -o MAP.npz belong together: give both, or neither")
    if args.learn and args.map:
        raise UsageError("--learn makes a map and --map uses one: give one of them")
    if args.sensor is None and args.map is None:
        raise UsageError("the size of the sensor is not known: pass --sensor WIDTHxHEIGHT or --map")
    if sum(Path(name).suffix != ".bin" for name in args.record) > (0 if args.learn else 1):
        raise UsageError("one file of events can be recorded, and none with --learn: use .bin")
    saved = None if args.rerun == "viewer" else args.rerun
    for name in filter(None, [*args.record, args.log, args.output, saved]):
        path = Path(name)
        if path.exists() and not args.overwrite:
            raise UsageError(f"{path} exists: name another file, or replace it with --overwrite")
        if not path.absolute().parent.is_dir():
            raise UsageError(f"{path.absolute().parent} is not a folder: make it first")


def _with_flags(args: argparse.Namespace, reference: ReferenceMap) -> ReferenceMap:
    import dataclasses

    from edge_vpr_tools.setting_flags import match_flags

    given = {name: value for name, value in match_flags(args).items() if value is not None}
    settings = reference.settings.replaced(given, "the command line")
    return dataclasses.replace(reference, settings=settings)


def _learn(args: argparse.Namespace, drive: Path, settings: Any) -> None:
    from edge_vpr.pipeline import map_traverse
    from edge_vpr.recordings import open_recording

    reference = map_traverse(open_recording(drive), settings)
    reference.save(args.output)
    if not args.json:
        print(f"{args.output}: {len(reference)} places at {len(reference.pixel_map)} pixels")


def _follow(args: argparse.Namespace, reference: ReferenceMap | None, drive: Path | None) -> None:
    """Open everything, follow the stream, and close everything whatever happens."""
    from edge_vpr.events import Sensor
    from edge_vpr.recordings import write_recording
    from edge_vpr.stream.intake import Intake
    from edge_vpr.stream.links import open_link
    from edge_vpr.stream.live import LiveLocaliser
    from edge_vpr.stream.protocols import open_decoder
    from edge_vpr_tools.interrupt import stopped_by_signals
    from edge_vpr_tools.live_view import open_view
    from edge_vpr_tools.online import parse_every
    from edge_vpr_tools.rerun_view import open_rerun
    from edge_vpr_tools.setting_flags import duration_us

    sensor = Sensor.parse(args.sensor) if args.sensor else None
    if sensor is None:
        assert reference is not None
        sensor = reference.pixel_map.sensor
    decoder = open_decoder(args.protocol, sensor)
    baud = args.baud or decoder.baud
    decoder.warm_up()
    every = None if reference is None else parse_every(args.every, reference)
    live = LiveLocaliser(decoder, reference, every)
    with ExitStack() as stack:
        raw = [
            stack.enter_context(Path(name).open("wb"))
            for name in args.record
            if Path(name).suffix == ".bin"
        ]
        view = stack.enter_context(open_view(args.json, args.log, len(reference or ())))
        rerun = stack.enter_context(open_rerun(args.rerun, sensor))
        stopping = threading.Event()
        stack.enter_context(stopped_by_signals(stopping))
        intake = Intake(
            lambda: open_link(args.port, baud=baud, flow_control=args.flow_control),
            setup=decoder.setup(),
            teardown=decoder.teardown(),
            retry=not args.once,
            drop=None if args.on_overload is None else args.on_overload == "drop",
            max_lag_s=duration_us(args.max_lag) / 1e6,
        )
        stack.callback(intake.stop)
        events = _events(intake, live, view, raw, rerun, stopping)
        files = [Path(name) for name in args.record if Path(name).suffix != ".bin"]
        target = drive or (files[0] if files else None)
        try:
            if target is None:
                for _ in events:
                    pass
            else:
                write_recording(target, events, sensor=sensor, overwrite=args.overwrite)
        finally:
            view.summary(decoder.health, live.bursts_removed)
        if intake.error is not None:
            raise intake.error


def _events(
    intake: Intake,
    live: LiveLocaliser,
    view: View,
    raw: list[Any],
    rerun: RerunView | None,
    stopping: threading.Event,
) -> Iterator[Events]:
    """Yield the stream's events while it is matched and shown."""
    begin = heard = time.monotonic()
    silent = closed = False
    remark = ""
    while not (stopping.is_set() or intake.ended):
        piece = intake.take(live.decoder.tick_s)
        step: Step | None = None
        live.decoder.health.line_errors = intake.line_errors
        if piece is not None:
            heard, silent = piece.at_s, False
            for file in raw:
                file.write(piece.data)
            step = live.feed(
                piece.data,
                int((piece.at_s - begin) * 1e6),
                lost=piece.lost,
                reopened=piece.reopened,
            )
            view.matches(step, time.monotonic() - piece.at_s)
        elif bool(intake.lost_link) != closed:
            closed = not closed
            view.say("link", f"{intake.lost_link}; trying again" if closed else "open again")
        elif not (silent or closed or intake.ended) and time.monotonic() - heard > STALLED_S:
            silent = True
            live.decoder.health.stalls += 1
            view.say("stalled", f"no bytes for {STALLED_S:g} s from {intake.address}")
        intake.send(live.decoder.to_send(time.monotonic()))
        if live.decoder.remark != remark:
            remark = live.decoder.remark
            view.say("device", remark or "the device answers")
        if step is not None:
            if rerun is not None:
                rerun.show(step)
            if step.events.size:
                yield step.events
        view.tick(live)
    step = live.finish()
    view.matches(step, 0.0)
    if step.events.size:
        yield step.events
