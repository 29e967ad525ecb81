"""A live run with a camera on a line: matching with a map, or recording to make one."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from io import FileIO
from itertools import count
from pathlib import Path

import numpy as np

from edge_vpr.errors import RecordingError, printable
from edge_vpr.evaluation.tracks import save_odometry
from edge_vpr.events import Events, Sensor
from edge_vpr.files import work_folder
from edge_vpr.live.health import Health
from edge_vpr.live.links import MAX_LAG_S, LinkReader, open_link
from edge_vpr.live.odometer import OdometerLine
from edge_vpr.live.protocols import open_decoder
from edge_vpr.live.session import LiveLocaliser, LiveResult
from edge_vpr.online.state import MatchSchedule
from edge_vpr.pipeline import Removed
from edge_vpr.recordings import open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Odometry
from edge_vpr.settings import Settings
from edge_vpr_tools.console import stopped_by_signals
from edge_vpr_tools.live_view import SILENT_S, RerunView, View, ends_early, open_rerun, open_view
from edge_vpr_tools.progress import warn_if_much
from edge_vpr_tools.publish import open_publishers
from edge_vpr_tools.runs.mapping import map_recording

# The robot's odometer in a live run: reads it and reports its silence.


#: Interval of readings, which gives some ten of them in a window.
_LOOK_S = 0.01
#: Silence that is reported, because windows pass without a reading.
ODOMETER_SILENT_S = 2.0
_BAUD = 115_200


class OdometerReader:
    """Reads the line of an odometer.

    Parameters
    ----------
    address : str
        See `open_link`.
    retry : bool
        Open the line again when it is lost.
    readings : dict of int to int, optional
        Gets the readings, in millimetres, by their time in microseconds.

    Raises
    ------
    LinkError
        If it cannot be opened.
    """

    def __init__(
        self, address: str, *, retry: bool, readings: dict[int, int] | None = None
    ) -> None:
        self._readings = readings
        self._reader = LinkReader(lambda: open_link(address, baud=_BAUD), retry=retry, drop=True)
        self._line = OdometerLine()
        self._look_s = self._heard_s = time.monotonic()
        self._silent = False
        self._refused = 0

    def look(self, live: LiveLocaliser, view: View) -> None:
        """Pass the newest reading to the localiser, if there is one."""
        now = time.monotonic()
        if now < self._look_s:
            return
        self._look_s = now + _LOOK_S
        line = self._line
        while (chunk := self._reader.take(0)) is not None:
            anew = bool(chunk.lost) or chunk.reopened
            if line.feed(chunk.data, chunk.at_s, anew=anew):
                self._heard_s = now
        if self._heard_s == now:
            # whole millimetres, for the localiser and the log
            distance_mm = round(1e3 * line.metres)
            time_us = live.read_odometer(distance_mm / 1e3)
            view.odometry(time_us, distance_mm / 1e3)
            if self._readings is not None:
                self._readings[time_us] = distance_mm
        self._tell(view, now)

    def stop(self) -> None:
        """Close the line."""
        self._reader.stop()

    def _tell(self, view: View, now: float) -> None:
        if self._line.refused > self._refused == 0:
            view.say(
                "odometer",
                f"{self._reader.address} brings lines that are no readings of an odometer: send "
                "metres, such as 12.345, one reading a line",
            )
        self._refused = self._line.refused
        silent = now - self._heard_s > ODOMETER_SILENT_S
        if silent != self._silent:
            self._silent = silent
            why = f" ({self._reader.lost_link})" if self._reader.lost_link else ""
            view.say(
                "odometer",
                f"no reading of the odometer for {ODOMETER_SILENT_S:g} s{why}: going on without"
                if silent
                else "the odometer is read again",
                over=not silent,
            )


# The loop of a live run: takes bytes, matches them, shows results, and watches the line.


#: Bytes and events before a warning: more than the start of a protocol, or chance on a bad line,
#: can make undecodable.
SENSELESS_BYTES, SENSELESS_EVENTS = 8_192, 1_000


class LineWatch:
    """Reports once when a line becomes silent, is lost, or sends bytes that cannot be decoded.

    Parameters
    ----------
    reader : LinkReader
    live : LiveLocaliser
    view : View
        Is told.
    """

    def __init__(self, reader: LinkReader, live: LiveLocaliser, view: View) -> None:
        self._reader, self._decoder, self._view = reader, live.decoder, view
        self._heard_s = time.monotonic()
        self._silent = self._closed = False
        self._remark = self._senseless = self._stranger = ""

    def heard(self, at_s: float) -> None:
        """Note that bytes have arrived."""
        self._heard_s, self._silent = at_s, False

    def look(self, *, nothing_came: bool) -> None:
        """Report what has changed since the last call."""
        if nothing_came:
            self._look_at_silence()
        decoder, reader, view = self._decoder, self._reader, self._view
        if not self._senseless and (senseless := _senseless(decoder.health)):
            self._senseless = senseless
            view.say("senseless", senseless)
        if decoder.remark != self._remark:
            self._remark = decoder.remark
            view.say("device", self._remark or "the device answers", over=not self._remark)
        if reader.remark != self._stranger:
            self._stranger = reader.remark
            view.say("sender", self._stranger or "another sender is heard", over=not self._stranger)

    def _look_at_silence(self) -> None:
        reader, view = self._reader, self._view
        if bool(reader.lost_link) != self._closed:
            self._closed = not self._closed
            said = f"{reader.lost_link}; trying again" if self._closed else "open again"
            view.say("link", said, over=not self._closed)
        elif not (self._silent or self._closed or reader.ended) and (
            time.monotonic() - self._heard_s > SILENT_S
        ):
            self._silent = True
            self._decoder.health.stalls += 1
            view.say("stalled", f"no bytes for {SILENT_S:g} s from {reader.address}")


def live_events(
    reader: LinkReader,
    live: LiveLocaliser,
    view: View,
    raw: Sequence[FileIO],
    rerun: RerunView | None,
    odometer: OdometerReader | None,
    stopping: threading.Event,
) -> Iterator[Events]:
    """Yield the stream's events while it is matched and shown.

    Parameters
    ----------
    reader : LinkReader
    live : LiveLocaliser
    view : View
    raw : sequence of file
        Get the bytes as they came.
    rerun : RerunView or None
    odometer : OdometerReader or None
    stopping : threading.Event
        Ends the run when it is set.

    Yields
    ------
    Events
        As decoded.
    """
    begin_s, files = time.monotonic(), list(raw)
    watch = LineWatch(reader, live, view)
    health = live.decoder.health
    while not (stopping.is_set() or reader.ended or view.unread):
        chunk = reader.take(live.decoder.tick_s)
        result: LiveResult | None = None
        health.line_errors = reader.line_errors
        if chunk is not None:
            _write_raw(files, chunk.data, view)  # first, so that errors can be reproduced
            came_us = int((chunk.at_s - begin_s) * 1e6)
            result = live.feed(chunk.data, came_us, lost=chunk.lost, reopened=chunk.reopened)
            view.matches(result, time.monotonic() - chunk.at_s)
            watch.heard(chunk.at_s)
        if odometer is not None:
            odometer.look(live, view)
        watch.look(nothing_came=chunk is None)
        reader.send(live.decoder.to_send(time.monotonic()))
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
    """Write bytes to all files; close a file that cannot be written."""
    for file in list(raw):
        left = memoryview(data)
        try:
            while left:
                left = left[file.write(left) :]
        except OSError as error:
            raw.remove(file)
            view.give_up(ends_early(str(file.name), error))


# A live run with a camera on a line: matching with a map, or recording to make one.


@dataclass(frozen=True, kw_only=True)
class Line:
    """A line to a camera.

    Attributes
    ----------
    port : str
        See `open_link`.
    protocol : str
        See `open_decoder`.
    sensor : Sensor
    baud : int or None
        Of a serial port; None: the protocol's.
    flow_control : bool
    once : bool
        End when the link ends, instead of opening it again.
    drop : bool or None
        See `LinkReader`.
    max_lag_s : float
    """

    port: str
    protocol: str
    sensor: Sensor
    baud: int | None = None
    flow_control: bool = False
    once: bool = False
    drop: bool | None = None
    max_lag_s: float = MAX_LAG_S


@dataclass(frozen=True, kw_only=True)
class LiveOutput:
    """Outputs of a live run.

    Attributes
    ----------
    as_json : bool
        JSON lines on standard output.
    log : str or None
        File of the same lines.
    record : tuple of str
        Files of bytes (``.bin``), and at most one of events.
    rerun, serve, mqtt : str or None
        See `open_rerun` and `open_publishers`.
    overwrite : bool
    """

    as_json: bool = False
    log: str | None = None
    record: tuple[str, ...] = ()
    rerun: str | None = None
    serve: str | None = None
    mqtt: str | None = None
    overwrite: bool = False


def follow_line(
    line: Line,
    output: LiveOutput,
    reference: ReferenceMap | None = None,
    every: MatchSchedule | None = None,
    *,
    causal_bursts: bool = False,
    odometry: str | None = None,
    readings: dict[int, int] | None = None,
    drive: Path | None = None,
) -> None:
    """Open everything, process the stream to its end, and close everything in any case.

    Parameters
    ----------
    line : Line
    output : LiveOutput
    reference : ReferenceMap, optional
        Without one, nothing is matched.
    every : MatchSchedule, optional
        When to give a match.
    causal_bursts : bool
        See `LiveLocaliser`.
    odometry : str, optional
        Where the robot's odometer is read, see `open_link`.
    readings : dict of int to int, optional
        Gets the odometer's readings, in millimetres, by their time in microseconds.
    drive : path, optional
        File of events that the run is there for: its failure is the run's.

    Raises
    ------
    EdgeVprError
        If the link cannot be opened or fails, or a file cannot be written.
    """
    decoder = open_decoder(line.protocol, line.sensor)
    live = LiveLocaliser(
        decoder, reference, every, causal_bursts=causal_bursts, odometry=odometry is not None
    )
    decoder.warm_up()
    with ExitStack() as stack:
        rerun = stack.enter_context(open_rerun(output.rerun, line.sensor))
        stopping = threading.Event()
        stack.enter_context(stopped_by_signals(stopping))
        reader = LinkReader(
            lambda: open_link(
                line.port, baud=line.baud or decoder.baud, flow_control=line.flow_control
            ),
            setup=decoder.setup(),
            teardown=decoder.teardown(),
            retry=not line.once,
            drop=line.drop,
            max_lag_s=line.max_lag_s,
        )
        stack.callback(reader.stop)
        odometer = None
        if odometry is not None:
            odometer = OdometerReader(odometry, retry=not line.once, readings=readings)
            stack.callback(odometer.stop)
        # files are opened last, so that a missing camera does not overwrite the run before
        publishers = stack.enter_context(open_publishers(output.serve, output.mqtt))
        view = stack.enter_context(open_view(output.as_json, output.log, reference, publishers))
        raw = [
            stack.enter_context(Path(name).open("wb", buffering=0))
            for name in output.record
            if Path(name).suffix == ".bin"
        ]
        events = live_events(reader, live, view, raw, rerun, odometer, stopping)
        files = [Path(name) for name in output.record if Path(name).suffix != ".bin"]
        try:
            if drive is not None:
                _record(events, drive, line, output, live)
            elif files:
                try:
                    _record(events, files[0], line, output, live)
                except RecordingError as error:
                    if live.decoder.health.events == 0:
                        raise
                    view.give_up(str(error))
            for _ in events:
                pass
        finally:
            view.summary(decoder.health, live.bursts_removed)
            if reference is not None:
                removed = Removed(decoder.health.events, live.bursts_removed)
                warn_if_much(removed, line.port, "make the map with --bursts keep")
        if reader.error is not None:
            raise reader.error
        if view.unwritten:
            raise RecordingError(view.unwritten)


def _record(
    events: Iterator[Events], target: Path, line: Line, output: LiveOutput, live: LiveLocaliser
) -> None:
    try:
        write_recording(target, events, sensor=line.sensor, overwrite=output.overwrite)
    except RecordingError as error:
        if live.decoder.health.events == 0:
            raise RecordingError(
                f"no events came from {line.port}: check --protocol and --baud"
            ) from error
        raise


def learn_map(
    line: Line, output: LiveOutput, settings: Settings, target: Path, odometry: str | None = None
) -> tuple[ReferenceMap, Removed]:
    """Record a drive and make its map; keep the drive if it gives no map.

    Parameters
    ----------
    line : Line
    output : LiveOutput
    settings : Settings
        Of the map.
    target : path
        File of the map.
    odometry : str, optional
        Where the robot's odometer is read; the map has the distances between its places then.

    Raises
    ------
    EdgeVprError
        As `follow_line`, and if the drive makes no map.
    """
    readings: dict[int, int] = {}
    with work_folder(target) as folder:
        drive = folder / "drive.npz"
        try:
            follow_line(line, output, odometry=odometry, readings=readings, drive=drive)
            reference, removed, _ = map_recording(
                open_recording(drive), settings, odometry=_odometry_of(readings)
            )
            reference.save(target)
            drive.unlink()
        finally:
            if drive.exists():
                _keep_drive(drive, target, _odometry_of(readings))
    return reference, removed


def _odometry_of(readings: dict[int, int]) -> Odometry | None:
    if not readings:
        return None
    return Odometry(
        np.array(list(readings), dtype=np.int64), np.array(list(readings.values()), dtype=np.int64)
    )


def _keep_drive(drive: Path, target: Path, odometry: Odometry | None) -> None:
    """Keep a drive that gave no map, and print how to continue with it."""
    stems = (target.with_name(f"{target.stem}_drive{n or ''}") for n in count())
    kept = next(stem.with_suffix(".npz") for stem in stems if not stem.with_suffix(".npz").exists())
    drive.replace(kept)
    words = ["edge-vpr", "map", printable(kept), "-o", printable(target)]
    if odometry is not None:
        table = kept.with_suffix(".csv")
        save_odometry(table, odometry)
        words += ["--odometry", printable(table)]
    print(f"the drive is kept: {' '.join(words)}", file=sys.stderr)
