"""NumPy arrays as count frames, one frame a file, and the ``metadata.json`` beside them."""

from __future__ import annotations

import json
import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, printable
from edge_vpr.events import TIME_LIMIT_US, Sensor
from edge_vpr.recordings.array_stream import ArrayStream
from edge_vpr.recordings.count_images import MOST_PIXELS, check_size

METADATA = "metadata.json"
_LONGEST_METADATA = 1 << 20


def read_array_frame(path: Path, sensor: Sensor | None) -> npt.NDArray[Any]:
    """Read one frame.

    Parameters
    ----------
    path : Path
        ``.npy`` of shape (height, width), or (height, width, 2) with separate ON and OFF counts.
    sensor : Sensor or None
        Size that the frame must have, if it is known.

    Returns
    -------
    ndarray of numbers, shape (height, width)
        ON and OFF added.

    Raises
    ------
    RecordingError
        If the file is damaged, or the array has another shape or kind of values.
    """
    with path.open("rb") as file:
        stream = ArrayStream(file, str(path))
        check_frame_shape(stream.shape, stream.dtype, str(path))
        frame = stream.load(MOST_PIXELS * 16)
    check_size(path, frame, sensor)
    return both_polarities(frame, 2)


def check_frame_shape(shape: tuple[int, ...], dtype: np.dtype[Any], name: str) -> None:
    """Raise RecordingError unless an array of this shape and dtype is a frame of counts."""
    fits = len(shape) == 2 or (len(shape) == 3 and shape[2] == 2)
    if not fits or 0 in shape or dtype.kind not in "biuf":
        raise RecordingError(
            f"{name} has shape {shape} and dtype {dtype}: a count frame is numbers of shape "
            "(height, width), or (height, width, 2) with ON and OFF counts"
        )


def both_polarities(frames: npt.NDArray[Any], plain_dimensions: int) -> npt.NDArray[Any]:
    """Add ON and OFF counts, if `frames` has a last axis beyond `plain_dimensions`.

    Parameters
    ----------
    frames : ndarray of numbers
        A last axis of length 2 may follow the usual axes.
    plain_dimensions : int
    """
    if frames.ndim == plain_dimensions:
        return frames
    wide = np.float64 if frames.dtype.kind == "f" else np.int64
    with np.errstate(invalid="ignore"):  # the reader refuses values that are not finite
        return np.asarray(frames.sum(axis=-1, dtype=wide))


def whole_counts(block: npt.NDArray[Any], begin: int, path: Path) -> npt.NDArray[Any]:
    """Return counts as integers.

    Parameters
    ----------
    block : ndarray of numbers, shape (f, J)
    begin : int
        Number of the first of these frames, named in the message.
    path : Path

    Returns
    -------
    ndarray of integers, shape (f, J)

    Raises
    ------
    RecordingError
        If a count is not a whole number from 0 up.
    """
    if block.dtype.kind == "u":
        return block
    if block.dtype.kind == "b":
        return block.view(np.uint8)
    with np.errstate(invalid="ignore", over="ignore"):
        bad = ~((block >= 0) & (block == np.floor(block)) & (block < 2.0**53))
    if bad.any():
        frame, pixel = (int(i) for i in np.argwhere(bad)[0])
        raise RecordingError(
            f"{path}: frame {begin + frame} counts {block[frame, pixel]} events at pixel "
            f"{pixel}: counts are whole numbers from 0 up"
        )
    return block.astype(np.int64)


def simplest_fraction(seconds: float, path: Path) -> Fraction:
    """Return the simplest fraction that equals a float: 1/30, not a multiple of 2**-57."""
    if not (math.isfinite(seconds) and seconds > 0):
        raise RecordingError(f"{path}: window_s is {seconds}: a frame lasts more than 0 s")
    simple = Fraction(seconds).limit_denominator(1_000_000)
    return simple if float(simple) == seconds else Fraction(seconds)


def frame_arrays(folder: Path) -> list[Path]:
    """Return the ``.npy`` frames of a folder, unordered.

    These are the files ``frame_*.npy`` if there are any, since other arrays (times of the frames)
    may lie beside them; otherwise all ``.npy`` files.
    """
    return list(folder.glob("frame_*.npy")) or list(folder.glob("*.npy"))


def read_metadata(folder: Path) -> tuple[Fraction | None, int]:
    """Read the duration of a frame, and the time at which the first one begins.

    Parameters
    ----------
    folder : Path
        Its ``metadata.json``, if present, may have ``timewindow_ns`` or ``timewindow_ms``; and
        ``start_time_ns``, or ``start_tick`` with ``ticks_per_second``.

    Returns
    -------
    period : Fraction or None
        In seconds; None if it is absent or 0, as for frames of a fixed number of events.
    start_us : int
        0 if it is absent.

    Raises
    ------
    RecordingError
        If the file exists and is damaged.
    """
    path = folder / METADATA
    if not path.is_file():
        return None, 0
    try:
        with path.open("rb") as file:
            return _times(json.loads(file.read(_LONGEST_METADATA)))
    except (ValueError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
        raise RecordingError(
            f"{path} is no readable metadata of frames ({printable(error, 200)}): write it again, "
            "or remove it and pass --frame-period"
        ) from error


def _times(values: dict[str, Any]) -> tuple[Fraction | None, int]:
    period = start = Fraction(0)
    for name, unit in (("timewindow_ms", 1000), ("timewindow_ns", 10**9)):
        if name in values:
            period = _number(values[name]).limit_denominator(1_000_000) / unit
    if "start_time_ns" in values:
        start = _number(values["start_time_ns"]) / 1000
    elif {"start_tick", "ticks_per_second"} <= values.keys():
        start = _number(values["start_tick"]) / _number(values["ticks_per_second"]) * 1_000_000
    if not 0 <= period < 1 << 31 or abs(start) > TIME_LIMIT_US:
        raise ValueError(f"a window of {float(period)} s, a start of {float(start)} us")
    return period or None, round(start)


def _number(value: object) -> Fraction:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{value!r} in the place of a number")
    return Fraction(value)
