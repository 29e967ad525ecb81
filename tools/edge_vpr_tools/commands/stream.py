"""`edge-vpr stream`: localise live from a camera on a line, or learn a map from it."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from io import FileIO
from itertools import count
from pathlib import Path

from edge_vpr.errors import RecordingError, printable
from edge_vpr.events import Events, Sensor
from edge_vpr.pipeline import Removed
from edge_vpr.recordings import open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings, duration_us
from edge_vpr.stream.health import Health
from edge_vpr.stream.link_reader import LinkReader
from edge_vpr.stream.links import open_link
from edge_vpr.stream.live import LiveLocaliser, LiveResult
from edge_vpr.stream.protocols import open_decoder
from edge_vpr.whole_files import work_folder
from edge_vpr_tools.arguments.setting_flags import check_not_smooth, map_settings, with_match_flags
from edge_vpr_tools.arguments.stream_checks import check_arguments
from edge_vpr_tools.output.cleaning import warn_if_much
from edge_vpr_tools.output.interrupt import stopped_by_signals
from edge_vpr_tools.output.live_view import SILENT_S, View, ends_early, open_view
from edge_vpr_tools.output.messages import summary
from edge_vpr_tools.output.rerun_view import RerunView, open_rerun
from edge_vpr_tools.publishing.publisher import open_publishers
from edge_vpr_tools.runs.mapping import map_recording
from edge_vpr_tools.runs.schedule import parse_every

#: More than a protocol's beginning takes, and than a bad line puts together by chance.
SENSELESS_BYTES, SENSELESS_EVENTS = 8_192, 1_000


def run(args: argparse.Namespace) -> None:
    """Follow the stream to its end, or until Ctrl-C or SIGTERM.

    Raises
    ------
    EdgeVprError
        If an argument is wrong, the link cannot be opened, or a file cannot be written.
    """
    check_arguments(args)
    if args.learn:
        _learn(args, map_settings(args))
        return
    reference = None if args.map is None else _with_flags(args, ReferenceMap.load(args.map))
    _follow(args, reference, None)


def _with_flags(args: argparse.Namespace, reference: ReferenceMap) -> ReferenceMap:
    check_not_smooth(args.smooth)
    settings = with_match_flags(args, reference.settings)
    return reference.matched_with(replace(settings, smooth=False))


def _learn(args: argparse.Namespace, settings: Settings) -> None:
    """Record a drive beside the map that is to be, and make it; a drive without a map is kept."""
    output = Path(args.output)
    with work_folder(output) as folder:
        drive = folder / "drive.npz"
        try:
            _follow(args, None, drive)
            reference, removed, _ = map_recording(open_recording(drive), settings)
            reference.save(output)
            drive.unlink()
        finally:
            if drive.exists():
                names = (output.with_name(f"{output.stem}_drive{n or ''}.npz") for n in count())
                kept = next(name for name in names if not name.exists())
                drive.replace(kept)
                kept_as = f"edge-vpr map {printable(kept)} -o {printable(output)}"
                print(f"the drive is kept: {kept_as}", file=sys.stderr)
    warn_if_much(removed, args.port, "keep them with --bursts keep")
    if not args.json:
        summary(
            f"{printable(output)}: {len(reference)} places at {len(reference.pixel_map)} pixels"
        )


def _follow(args: argparse.Namespace, reference: ReferenceMap | None, drive: Path | None) -> None:
    """Open everything, follow the stream, and close everything whatever happens."""
    sensor = Sensor.parse(args.sensor) if args.sensor else None
    if sensor is None:
        assert reference is not None
        sensor = reference.pixel_map.sensor
    decoder = open_decoder(args.protocol, sensor)
    max_lag_s = duration_us(args.max_lag) / 1e6
    every = None if reference is None else parse_every(args.every, reference)
    causal = args.burst_filter == "causal"
    live = LiveLocaliser(decoder, reference, every, causal_bursts=causal)
    decoder.warm_up()
    with ExitStack() as stack:
        rerun = stack.enter_context(open_rerun(args.rerun, sensor))
        stopping = threading.Event()
        stack.enter_context(stopped_by_signals(stopping))
        reader = LinkReader(
            lambda: open_link(
                args.port, baud=args.baud or decoder.baud, flow_control=args.flow_control
            ),
            setup=decoder.setup(),
            teardown=decoder.teardown(),
            retry=not args.once,
            drop=None if args.on_overload is None else args.on_overload == "drop",
            max_lag_s=max_lag_s,
        )
        stack.callback(reader.stop)
        # files only now, or a camera that is not there would cost the run before
        publishers = stack.enter_context(open_publishers(args.serve, args.mqtt))
        view = stack.enter_context(open_view(args.json, args.log, reference, publishers))
        raw = [
            stack.enter_context(Path(name).open("wb", buffering=0))
            for name in args.record
            if Path(name).suffix == ".bin"
        ]
        events = _events(reader, live, view, raw, rerun, stopping)
        files = [Path(name) for name in args.record if Path(name).suffix != ".bin"]
        try:
            _record(events, drive or (files[0] if files else None), args, live, view)
        finally:
            view.summary(decoder.health, live.bursts_removed)
            if reference is not None:
                removed = Removed(decoder.health.events, live.bursts_removed)
                warn_if_much(removed, args.port, "make the map with --bursts keep")
        if reader.error is not None:
            raise reader.error
        if view.unwritten:
            raise RecordingError(view.unwritten)


def _record(
    events: Iterator[Events],
    target: Path | None,
    args: argparse.Namespace,
    live: LiveLocaliser,
    view: View,
) -> None:
    """Follow events to their end, and write them if there is a target."""
    if target is not None:
        sensor = live.decoder.sensor
        try:
            write_recording(target, events, sensor=sensor, overwrite=args.overwrite)
        except RecordingError as error:
            if live.decoder.health.events == 0:
                raise RecordingError(
                    f"no events came from {args.port}: check --protocol and --baud"
                ) from error
            if args.learn:
                raise
            view.give_up(str(error))
    for _ in events:
        pass


def _events(
    reader: LinkReader,
    live: LiveLocaliser,
    view: View,
    raw: list[FileIO],
    rerun: RerunView | None,
    stopping: threading.Event,
) -> Iterator[Events]:
    """Yield the stream's events while it is matched and shown."""
    begin = heard = time.monotonic()
    silent = closed = False
    remark = senseless = stranger = ""
    health = live.decoder.health
    while not (stopping.is_set() or reader.ended or view.unread):
        chunk = reader.take(live.decoder.tick_s)
        result: LiveResult | None = None
        health.line_errors = reader.line_errors
        if chunk is not None:
            heard, silent = chunk.at_s, False
            _write_raw(raw, chunk.data, view)
            result = live.feed(
                chunk.data,
                int((chunk.at_s - begin) * 1e6),
                lost=chunk.lost,
                reopened=chunk.reopened,
            )
            view.matches(result, time.monotonic() - chunk.at_s)
        elif bool(reader.lost_link) != closed:
            closed = not closed
            said = f"{reader.lost_link}; trying again" if closed else "open again"
            view.say("link", said, over=not closed)
        elif not (silent or closed or reader.ended) and time.monotonic() - heard > SILENT_S:
            silent = True
            health.stalls += 1
            view.say("stalled", f"no bytes for {SILENT_S:g} s from {reader.address}")
        if not senseless and (senseless := _senseless(health)):
            view.say("senseless", senseless)
        reader.send(live.decoder.to_send(time.monotonic()))
        if live.decoder.remark != remark:
            remark = live.decoder.remark
            view.say("device", remark or "the device answers", over=not remark)
        if reader.remark != stranger:
            stranger = reader.remark
            view.say("sender", stranger or "another sender is heard", over=not stranger)
        if result is not None:
            if rerun is not None:
                rerun.show(result)
            if result.events.size:
                yield result.events
        view.tick(live)
    result = live.finish()
    view.matches(result, 0.0)
    if result.events.size:
        yield result.events


def _senseless(health: Health) -> str:
    """Warn if most bytes do not decode, or most events are off the sensor."""
    if health.skipped_bytes > SENSELESS_BYTES and (
        health.decoded == 0 or health.skipped_bytes > 9 * health.decoded_bytes
    ):
        return (
            f"{health.skipped_bytes:,} of {health.bytes:,} bytes are not of this protocol: check "
            "--protocol and --baud"
        )
    if health.off_sensor > max(SENSELESS_EVENTS, health.events):
        return (
            f"{health.off_sensor:,} of {health.decoded:,} events are not on this sensor: check "
            "--sensor, or the map"
        )
    return ""


def _write_raw(raw: list[FileIO], data: bytes, view: View) -> None:
    """Write bytes to all files; one that cannot be written is given up."""
    for file in list(raw):
        left = memoryview(data)
        try:
            while left:
                left = left[file.write(left) :]
        except OSError as error:
            raw.remove(file)
            view.give_up(ends_early(str(file.name), error))
