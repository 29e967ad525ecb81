"""Output of a live run in the Rerun viewer: events as pictures, matches as curves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from edge_vpr.errors import MissingExtraError
from edge_vpr.events import Sensor
from edge_vpr.stream.live import LiveResult

#: Time span of the events in a picture.
PICTURE_US = 33_000
_ON, _OFF, _NONE = (255, 255, 255), (70, 110, 255), (20, 20, 20)


class RerunView:
    """Sends pictures and matches, with times on the clock of the stream."""

    def __init__(self, recording: Any, sensor: Sensor) -> None:
        self._recording = recording
        self._blank = np.full((sensor.height, sensor.width, 3), _NONE, dtype=np.uint8)
        self._picture = self._blank.copy()
        self._begin_us = 0

    def show(self, result: LiveResult) -> None:
        """Send the events and matches of a chunk."""
        import rerun

        events = result.events
        slots = events["t"] // PICTURE_US
        for part in np.split(events, np.flatnonzero(np.diff(slots)) + 1) if events.size else []:
            begin_us = int(part["t"][0]) // PICTURE_US * PICTURE_US
            if begin_us != self._begin_us:
                self._send_picture(begin_us)
            colours = np.where(part["p"][:, None], _ON, _OFF)
            self._picture[part["y"], part["x"]] = colours
        matches = result.matches
        if matches.size:
            # only the newest match of a piece is visible
            match = matches[-1]
            self._recording.set_time("stream", duration=match["t"] / 1e6)
            self._recording.log("match/place", rerun.Scalars(float(match["place"])))
            if not np.isnan(match["ratio"]):
                self._recording.log("match/ratio", rerun.Scalars(float(match["ratio"])))
            if not np.isnan(match["probability"]):
                probability = rerun.Scalars(float(match["probability"]))
                self._recording.log("match/probability", probability)
            self._recording.log("match/incomplete", rerun.Scalars(float(result.incomplete)))

    def _send_picture(self, next_us: int) -> None:
        import rerun

        self._recording.set_time("stream", duration=(self._begin_us + PICTURE_US) / 1e6)
        self._recording.log("events", rerun.Image(self._picture))
        self._picture = self._blank.copy()
        self._begin_us = next_us


@contextmanager
def open_rerun(target: str | None, sensor: Sensor) -> Iterator[RerunView | None]:
    """Open a viewer, or a file for one.

    Parameters
    ----------
    target : str or None
        ``viewer``, or a file ``.rrd`` to look at later; None: nothing.
    sensor : Sensor

    Raises
    ------
    MissingExtraError
        If the library is not installed.
    """
    if target is None:
        yield None
        return
    try:
        import rerun
    except ImportError as error:
        raise MissingExtraError("--rerun", "rerun-sdk", "rerun") from error
    with rerun.RecordingStream("edge-vpr") as recording:
        if target == "viewer":
            recording.spawn()
        else:
            recording.save(target)
        yield RerunView(recording, sensor)
        recording.flush()
