"""Part of a recording between two moments."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr.events import TIME_LIMIT_US, Events


@dataclass(frozen=True, kw_only=True)
class TimeCrop:
    """Part of a recording that is read: from `start_us` up to, but without, `end_us`.

    Attributes
    ----------
    start_us : int
        Counted from the recording's first moment, or from `offset_us`.
    end_us : int or None
        Counted likewise; None for the recording's end.
    offset_us : int or None
        Moment on the file's own clock from which the two count; None for the recording's first one.
    """

    start_us: int = 0
    end_us: int | None = None
    offset_us: int | None = None

    def __post_init__(self) -> None:
        for value in (self.start_us, self.end_us, self.offset_us):
            if value is not None and abs(value) > TIME_LIMIT_US:
                raise UsageError(f"{value} us is beyond 2**60 us: give start and end in seconds")
        if self.start_us < 0:
            raise UsageError(
                f"the start {self.start_us / 1e6:g} s is negative: give seconds from the "
                "recording's beginning"
            )
        if self.end_us is not None and self.end_us <= self.start_us:
            raise UsageError(
                f"the end {self.end_us / 1e6:g} s is not after the start "
                f"{self.start_us / 1e6:g} s: give a later end"
            )

    def span(self, recording_start_us: int) -> tuple[int, int | None]:
        """Return start and end in microseconds from the first moment of a recording.

        Parameters
        ----------
        recording_start_us : int
            That moment on the file's own clock.

        Returns
        -------
        start_us : int
            0 if the part begins before the recording.
        end_us : int or None

        Raises
        ------
        UsageError
            If the part ends before the recording begins.
        """
        shift = 0 if self.offset_us is None else self.offset_us - recording_start_us
        start = max(0, self.start_us + shift)
        if self.end_us is None:
            return start, None
        end = self.end_us + shift
        if end <= start:
            raise UsageError(
                f"the part to read ends {-end / 1e6:g} s before the recording begins "
                f"({recording_start_us / 1e6:.6f} s on its own clock): check start offset and end"
            )
        return start, end


def seconds_us(text: str, name: str) -> int:
    """Read seconds exactly, such as ``1587452582.35`` or ``1/30``, as microseconds.

    Parameters
    ----------
    text : str
    name : str
        Named in the message.

    Returns
    -------
    int
        Rounded to the nearest, halves to even.

    Raises
    ------
    UsageError
        If it is not a number.
    """
    # 1e999999999 would fill the memory
    if len(text) <= 40 and "e" not in text.lower():
        with suppress(ValueError, ZeroDivisionError):
            return round(Fraction(text) * 1_000_000)
    raise UsageError(f"{name} {text[:40]!r} is no number of seconds: write for example 12.5")


def cropped_events(chunks: Iterator[Events], start_us: int, end_us: int | None) -> Iterator[Events]:
    """Yield the events from `start_us` up to `end_us`, with times counted from `start_us`.

    Parameters
    ----------
    chunks : iterator of ndarray of EVENT_DTYPE
        In time order. No further chunk is read after one that reaches `end_us`.
    start_us : int
    end_us : int or None

    Yields
    ------
    ndarray of EVENT_DTYPE, shape (n,)
        Copies; never empty.
    """
    for events in chunks:
        times = events["t"]
        begin = int(np.searchsorted(times, start_us))
        end = times.size if end_us is None else int(np.searchsorted(times, end_us))
        if end > begin:
            part = events[begin:end].copy()
            part["t"] -= start_us
            yield part
        if end < times.size:
            return
