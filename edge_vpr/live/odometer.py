"""The robot's odometer on a line: one line of text for each reading."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from edge_vpr.errors import number_in
from edge_vpr.live.links import open_link
from edge_vpr.live.reader import LinkReader
from edge_vpr.odometry import MOST_MM

#: Largest length of a reading, in bytes.
MOST_BYTES = 64
#: Interval of readings, which gives some ten of them in a window.
_LOOK_S = 0.01
#: Most pieces of bytes in a look: an odometer that never pauses must not keep matching waiting.
_MOST_PIECES = 2
#: Silence of the odometer that is reported, because windows pass without a reading.
ODOMETER_SILENT_S = 2.0
_BAUD = 115_200


class OdometerLine:
    """Decodes readings in metres.

    Attributes
    ----------
    distance_mm : int
        Newest reading.
    readings, refused : int
        Newest lines that were a reading, and that were none.
    """

    def __init__(self) -> None:
        self.distance_mm = 0
        self.readings = self.refused = 0
        self._rest = b""

    def feed(self, data: bytes, *, after_loss: bool = False) -> bool:
        """Take the next bytes, of which only the newest line counts.

        Parameters
        ----------
        data : bytes
            Lines such as ``12.345``, metres from any zero, each ended by a line feed.
        after_loss : bool
            Whether bytes are missing before them; the line that had begun is then dropped.

        Returns
        -------
        bool
            Whether there was a reading.
        """
        before = self.readings
        lines, _, rest = ((b"" if after_loss else self._rest) + data).rpartition(b"\n")
        self._rest = rest[: MOST_BYTES + 1]
        if newest := lines.rstrip().rpartition(b"\n")[2]:
            self._take(newest)
        return self.readings > before

    def _take(self, line: bytes) -> None:
        try:
            value = number_in(line.decode("ascii")) if len(line) <= MOST_BYTES else math.nan
        except ValueError:
            value = math.nan
        if abs(value) * 1e3 <= MOST_MM:
            self.readings += 1
            self.distance_mm = round(1e3 * value)
        else:
            self.refused += 1


class OdometerReader:
    """Reads the line of an odometer, and reports its silence.

    Parameters
    ----------
    say : callable
        Takes the kind and the text of a message, and `over`.
    retry : bool
        Open the line again when it is disconnected.

    Raises
    ------
    LinkError
        If it cannot be opened.
    """

    def __init__(self, address: str, say: Callable[..., None], *, retry: bool) -> None:
        self._say = say
        self._reader = LinkReader(lambda: open_link(address, baud=_BAUD), retry=retry, drop=True)
        self._line = OdometerLine()
        self._look_s = self._heard_s = time.monotonic()
        self._silent = False
        self._refused = 0

    def look(self) -> int | None:
        """Return the newest reading in millimetres, if there is one."""
        now = time.monotonic()
        if now < self._look_s:
            return None
        self._look_s = now + _LOOK_S
        line = self._line
        for _ in range(_MOST_PIECES):  # the rest waits for the next look
            chunk = self._reader.take(0)
            if chunk is None:
                break
            after_loss = bool(chunk.dropped) or chunk.reopened
            if line.feed(chunk.data, after_loss=after_loss):
                self._heard_s = now
        self._report(now)
        return line.distance_mm if self._heard_s == now else None

    def stop(self) -> None:
        """Close the line."""
        self._reader.stop()

    def _report(self, now: float) -> None:
        if self._line.refused > self._refused == 0:
            self._say(
                "odometer",
                f"{self._reader.address} brings lines that are no readings of an odometer: send "
                "metres, such as 12.345, one reading a line",
            )
        self._refused = self._line.refused
        silent = now - self._heard_s > ODOMETER_SILENT_S
        if silent != self._silent:
            self._silent = silent
            why = f" ({self._reader.lost_link})" if self._reader.lost_link else ""
            self._say(
                "odometer",
                f"no reading of the odometer for {ODOMETER_SILENT_S:g} s{why}: going on without"
                if silent
                else "the odometer is read again",
                over=not silent,
            )
