"""The robot's odometer in a live run: reads it and reports its silence."""

from __future__ import annotations

import time

from edge_vpr.stream.link_reader import LinkReader
from edge_vpr.stream.links import open_link
from edge_vpr.stream.live import LiveLocaliser
from edge_vpr.stream.odometer_line import OdometerLine
from edge_vpr_tools.output.live_view import View

#: Interval of readings, which gives some ten of them in a window.
_LOOK_S = 0.01
#: Silence that is reported, because windows pass without a reading.
SILENT_S = 2.0
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
        silent = now - self._heard_s > SILENT_S
        if silent != self._silent:
            self._silent = silent
            why = f" ({self._reader.lost_link})" if self._reader.lost_link else ""
            view.say(
                "odometer",
                f"no reading of the odometer for {SILENT_S:g} s{why}: going on without"
                if silent
                else "the odometer is read again",
                over=not silent,
            )
