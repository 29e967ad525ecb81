"""The robot's odometer on a line: one line of text for each reading."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable

from edge_vpr.live.links import LinkReader, open_link
from edge_vpr.route import MOST_MM

#: Largest length of a reading, in bytes.
MOST_BYTES = 64
#: A faster change is a leap: a damaged line, or an odometer that started again.
MOST_MPS = 100.0
#: Readings may come in a bunch after a pause of the line.
_LEAST_GAP_S = 0.1
#: Interval of readings, which gives some ten of them in a window.
_LOOK_S = 0.01
#: Silence of the odometer that is reported, because windows pass without a reading.
ODOMETER_SILENT_S = 2.0
_BAUD = 115_200


class OdometerLine:
    """Decodes readings in metres, and adds up the distances between them.

    A leap adds nothing: neither a digit that was lost on the line nor an odometer that starts
    again from zero moves the robot.

    Attributes
    ----------
    metres : float
        Distance since the first reading; it falls where the robot drives backwards.
    readings : int
        Lines that were a reading, leaps included.
    leaps : int
        Readings that no robot could have driven to.
    refused : int
        Lines that were no reading.
    """

    def __init__(self) -> None:
        self.metres = 0.0
        self.readings = self.leaps = self.refused = 0
        self._rest = b""
        self._value: float | None = None
        self._at_s = 0.0

    def feed(self, data: bytes, at_s: float, *, after_loss: bool = False) -> bool:
        """Take the next bytes.

        Parameters
        ----------
        data : bytes
            Lines such as ``12.345``, metres from any zero, each ended by a line feed.
        at_s : float
            When they came, in seconds.
        after_loss : bool
            Whether bytes are missing before them; the line that had begun is then dropped.

        Returns
        -------
        bool
            Whether there was a reading.
        """
        before = self.readings
        lines = ((b"" if after_loss else self._rest) + data).split(b"\n")
        self._rest = lines.pop()[: MOST_BYTES + 1]
        for line in lines:
            if line.strip():
                self._take(line, at_s)
        return self.readings > before

    def _take(self, line: bytes, at_s: float) -> None:
        try:
            value = float(line.decode("ascii")) if len(line) <= MOST_BYTES else math.nan
        except ValueError:
            value = math.nan
        if not abs(value) * 1e3 <= MOST_MM:
            self.refused += 1
            return
        self.readings += 1
        if self._value is not None:
            step = value - self._value
            if abs(step) <= MOST_MPS * max(at_s - self._at_s, _LEAST_GAP_S):
                self.metres += step
            else:
                self.leaps += 1
        self._value, self._at_s = value, at_s


#: Time over which an odometer is judged; so many leaps in it are a wrong unit.
JUDGED_S, MOST_LEAPS = 2.0, 3
#: It is wrong if it shows this many times the speed of the map's drive, or, while the camera sees
#: as much as on that drive, less than this share of it.
FASTEST, SLOWEST = 8.0, 0.02
#: It is used again when it shows no more than this many times that speed.
PLAUSIBLE = 2.0


class OdometerCheck:
    """Finds out that an odometer cannot be right: its unit is wrong, or it stands.

    Parameters
    ----------
    usual_mps : float
        Mean speed of the drive that the map was made of, in metres per second.

    Attributes
    ----------
    wrong : str
        Why it is not used now; empty if it is.
    """

    def __init__(self, usual_mps: float) -> None:
        self.wrong = ""
        self._usual_mps = usual_mps
        # time, metres, leaps until then, and whether the camera saw as much as on that drive
        self._seen: deque[tuple[float, float, int, bool]] = deque()

    def judge(self, now_s: float, metres: float, leaps: int, *, moving: bool) -> None:
        """Take a reading.

        Parameters
        ----------
        now_s : float
            When it came.
        metres : float
            Distance so far, without leaps.
        leaps : int
            Readings so far that no robot could have driven to.
        moving : bool
            Whether the camera sees as much as while the map was made.
        """
        seen = self._seen
        seen.append((now_s, metres, leaps, moving))
        while len(seen) > 2 and now_s - seen[1][0] >= JUDGED_S:
            seen.popleft()
        first_s, first_m, first_leaps, _ = seen[0]
        leapt, passed_s = leaps - first_leaps, now_s - first_s
        if leapt >= MOST_LEAPS:
            self.wrong = f"{leapt} of its readings leap: send metres, not millimetres or ticks"
        elif passed_s < JUDGED_S:
            return
        elif abs(mps := (metres - first_m) / passed_s) > FASTEST * self._usual_mps:
            self.wrong = (
                f"it shows {abs(mps):,.0f} m/s, and the drive of the map had "
                f"{self._usual_mps:.1f}: send metres"
            )
        elif abs(mps) < SLOWEST * self._usual_mps and all(each[3] for each in seen):
            self.wrong = f"it stands at {metres:,.2f} m while the camera moves: check the encoder"
        elif not leapt and SLOWEST <= abs(mps) / self._usual_mps <= PLAUSIBLE:
            self.wrong = ""


class OdometerReader:
    """Reads the line of an odometer, and reports its silence.

    Parameters
    ----------
    say : callable
        Takes the kind and the text of a message, and `over`.
    retry : bool
        Open the line again when it is lost.

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

    def look(self) -> float | None:
        """Return the newest reading in metres, if there is one."""
        now = time.monotonic()
        if now < self._look_s:
            return None
        self._look_s = now + _LOOK_S
        line = self._line
        while (chunk := self._reader.take(0)) is not None:
            after_loss = bool(chunk.lost) or chunk.reopened
            if line.feed(chunk.data, chunk.at_s, after_loss=after_loss):
                self._heard_s = now
        self._report(now)
        return line.metres if self._heard_s == now else None

    @property
    def leaps(self) -> int:
        """Readings that no robot could have driven to."""
        return self._line.leaps

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
