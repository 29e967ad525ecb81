"""Parts shared by readers: clocks that wrap, and files of records behind a header."""

from __future__ import annotations

import os
import re
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from edge_vpr.recordings.reading import FaultLog

# Conversion of times that wrap into times that never wrap.


def clock_step(step: Any, period: int, back: int) -> Any:
    """Return the step of a clock, given modulo its period: at most `back` backwards, else forwards.

    A period of 0 is that of a clock that never wraps. Decoders with kernels compile this for
    themselves; other formats need no compiler.
    """
    return ((step + back) & (period - 1)) - back if period else step


class Unwrapper:
    """Continue a clock of `bits` bits beyond its wraps, chunk by chunk.

    A step between two events goes in the shorter direction, forwards or backwards: slightly late
    events stay late, also across a wrap. So a pause of more than half a period looks like a step
    back, and whole periods of a longer one are lost. EVT 3.0 has a rule of its own (`prophesee`),
    and a live clock goes back less far (`TimestampFilter`).

    Examples
    --------
    >>> Unwrapper(8).unwrap(np.array([250, 3, 254, 5], np.uint8))
    array([250, 259, 254, 261])
    """

    def __init__(self, bits: int) -> None:
        self._period = 1 << bits
        self._last: int | None = None

    def unwrap(self, times: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        """Return the times of one chunk, int64, continued from the chunk before."""
        raw = times.astype(np.int64)
        if raw.size == 0:
            return raw
        first = int(raw[0]) if self._last is None else self._last
        steps = np.diff(raw, prepend=first)
        unwrapped = first + np.cumsum(clock_step(steps, self._period, self._period // 2))
        self._last = int(unwrapped[-1])
        return unwrapped


# Files that are records of one size behind a header.


def is_text(line: bytes) -> bool:
    """Return whether bytes are a line of a header, in ASCII, UTF-8 or Latin-1."""
    return line.endswith(b"\n") and not re.search(rb"[\0-\x08\x0b\x0c\x0e-\x1f\x7f]", line)


Header = TypeVar("Header")


class RecordFile(Generic[Header]):
    """A file of records behind a header, which is opened once for header and records.

    Parameters
    ----------
    read_header : callable
        Takes the open file, and returns the header and its length in bytes.

    Attributes
    ----------
    header : object
        As `read_header` returns it.
    """

    def __init__(self, path: Path, read_header: Callable[[BinaryIO], tuple[Header, int]]) -> None:
        self._path = path
        self._opened = path.open("rb")
        # closed with this object, if no pass takes it
        self._close = weakref.finalize(self, self._opened.close)
        self.header, self._skip = read_header(self._opened)

    def blocks(
        self, dtype: np.dtype[Any], number: int, log: FaultLog, what: str = "an event"
    ) -> Iterator[tuple[npt.NDArray[Any], float]]:
        """Yield the records, up to `number` at a time.

        Beside each part is the share of the file up to its end. `what` names a record in the report
        of a last one that is cut off.
        """
        file = self._opened if self._close.detach() else self._path.open("rb")
        with file:
            size = max(1, os.fstat(file.fileno()).st_size)
            file.seek(self._skip)
            while data := file.read(number * dtype.itemsize):
                yield np.frombuffer(data, dtype, len(data) // dtype.itemsize), file.tell() / size
                if leftover := len(data) % dtype.itemsize:
                    log.truncated(leftover, f"byte {size - leftover:,}, within {what}")
