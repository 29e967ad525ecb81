"""Running means of a device: events of a window, and the logarithm of each counter."""

from __future__ import annotations

from collections.abc import Sequence

from firmware_model.design import Design
from firmware_model.largest_values import ACTIVITY_BITS, EVENTS_TOP
from fixedpoint.own_mean import FIRST_SHIFT, LAST_SHIFT, LEVEL_BITS, MEAN_BITS

#: a window is quiet if it has no events, or less than 1/8 of the usual number
QUIET_SHIFT = 3
#: it is a pause if it has none, or less than 1/16
PAUSE_SHIFT = 4
#: the usual number moves by 1/64 of the difference in a window
ACTIVITY_SHIFT = 6


def moved(value: int, target: int, shift: int) -> int:
    """Move a value by ``1 / 2**shift`` of its difference to a target, rounded down.

    It stays between 0 and a limit if the target does. Downwards it moves by at least 1.
    """
    return value + ((target - value) >> shift)


class ActivityModel:
    """Usual number of events in a window, and whether a window has far fewer.

    Parameters
    ----------
    usual : int
        Where it starts, in units of 1/256 event.
    """

    def __init__(self, usual: int) -> None:
        self.usual = usual

    def is_quiet(self, events: int) -> bool:
        """Return whether a window with this many events at selected pixels is quiet."""
        return events == 0 or events << (ACTIVITY_BITS + QUIET_SHIFT) < self.usual

    def pauses(self, events: int) -> bool:
        """Return whether a window with this many events at selected pixels is a pause."""
        return events == 0 or events << (ACTIVITY_BITS + PAUSE_SHIFT) < self.usual

    def update(self, events: int) -> None:
        """Update by the number of events of a window, which saturates at 23 bits."""
        self.usual = moved(self.usual, min(events, EVENTS_TOP) << ACTIVITY_BITS, ACTIVITY_SHIFT)


class MeanModel:
    """Running mean of each counter's logarithm, and the code of a logarithm against it.

    Parameters
    ----------
    design : Design
    start : sequence of int, length slots
        In units of 1/256 octave.

    Attributes
    ----------
    total : list of int, length slots
        In units of 1/65,536 octave.
    windows : int
        How many it has taken; saturates where the shift is the last.
    """

    def __init__(self, design: Design, start: Sequence[int]) -> None:
        self._half = 1 << (design.code_bits - 1)
        self.total = [mean << MEAN_BITS for mean in start]
        self.windows = 0

    @property
    def shift(self) -> int:
        """Shift of the difference in the next window: 4 at first, 8 in the end."""
        return ((1 << FIRST_SHIFT) + self.windows).bit_length() - 1

    def code(self, slot: int, level: int) -> int:
        """Return the code of a logarithm: octaves above the mean, rounded and saturated."""
        mean = (self.total[slot] + (1 << (MEAN_BITS - 1))) >> MEAN_BITS
        octaves = (level - mean + (1 << (LEVEL_BITS - 1))) >> LEVEL_BITS
        return min(max(octaves, -self._half), self._half - 1) + self._half

    def update(self, levels: Sequence[int]) -> None:
        """Update by the logarithms of a window."""
        shift = self.shift
        self.total = [
            moved(total, level << MEAN_BITS, shift)
            for total, level in zip(self.total, levels, strict=True)
        ]
        self.windows = min(self.windows + 1, (1 << LAST_SHIFT) - (1 << FIRST_SHIFT))
