"""A live run with a camera on a line: matching with a map, or recording to make one."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np

from edge_vpr.errors import RecordingError, printable
from edge_vpr.evaluation.odometry_files import save_odometry
from edge_vpr.events import Events, Sensor
from edge_vpr.odometry import Odometry
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.pipeline import Removed
from edge_vpr.recordings import open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from edge_vpr.stream.link_reader import MAX_LAG_S, LinkReader
from edge_vpr.stream.links import open_link
from edge_vpr.stream.live import LiveLocaliser
from edge_vpr.stream.protocols import open_decoder
from edge_vpr.whole_files import work_folder
from edge_vpr_tools.output.cleaning import warn_if_much
from edge_vpr_tools.output.interrupt import stopped_by_signals
from edge_vpr_tools.output.live_view import open_view
from edge_vpr_tools.output.rerun_view import open_rerun
from edge_vpr_tools.publishing.publisher import open_publishers
from edge_vpr_tools.runs.live_events import live_events
from edge_vpr_tools.runs.live_odometer import OdometerReader
from edge_vpr_tools.runs.mapping import map_recording


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
