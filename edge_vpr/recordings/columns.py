"""Raw events of a file, column by column."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy.typing as npt


class Columns(NamedTuple):
    """Raw events as four columns of one length, of any integer dtype (``p`` also boolean).

    Times are whole microseconds of the file's own clock without wraps. They may run backwards, and
    coordinates may lie off the sensor (or be negative): :mod:`edge_vpr.recordings.faults` handles
    such events. A column may be a view into a buffer that the next chunk overwrites.
    """

    t: npt.NDArray[Any]
    x: npt.NDArray[Any]
    y: npt.NDArray[Any]
    p: npt.NDArray[Any]
