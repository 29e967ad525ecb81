"""Decoding of odometer readings from the bytes of a line, one line of text for each reading."""

from __future__ import annotations

import math

from edge_vpr.route import MOST_MM

#: Largest length of a reading, in bytes.
MOST_BYTES = 64
#: A faster change is a leap: a damaged line, or an odometer that started again.
MOST_MPS = 100.0
#: Readings may come in a bunch after a pause of the line.
_LEAST_GAP_S = 0.1


class OdometerLine:
    """Decodes readings in metres, and adds up the distances between them.

    A leap adds nothing: neither a digit that was lost on the line nor an odometer that starts
    again from zero moves the robot.

    Attributes
    ----------
    metres : float
        Way since the first reading; it falls where the robot drives backwards.
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

    def feed(self, data: bytes, at_s: float, *, anew: bool = False) -> bool:
        """Take the next bytes.

        Parameters
        ----------
        data : bytes
            Lines such as ``12.345``, metres from any zero, each ended by a line feed.
        at_s : float
            When they came, in seconds.
        anew : bool
            Whether bytes are missing before them: what was begun is no line.

        Returns
        -------
        bool
            Whether there was a reading.
        """
        before = self.readings
        lines = ((b"" if anew else self._rest) + data).split(b"\n")
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
            way = value - self._value
            if abs(way) <= MOST_MPS * max(at_s - self._at_s, _LEAST_GAP_S):
                self.metres += way
            else:
                self.leaps += 1
        self._value, self._at_s = value, at_s
