"""Hot pixels, which fire without a cause: found by counts, or read from a list."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import Sensor

#: a pixel is hot if it has more than this many times the events of its neighbourhood
HOT_FACTOR = 5
#: largest size of a list of hot pixels, in bytes
_LONGEST_LIST = 1 << 26


def find_hot_pixels(
    totals: npt.NDArray[np.integer], *, factor: int = HOT_FACTOR
) -> npt.NDArray[np.bool_]:
    """Find the pixels with far more events than their neighbours (method.md section 1).

    A pixel is hot if it has more than `factor` times the events of its 5 x 5 neighbourhood (the
    upper median of the others, plus one) and more than `factor` times the sensor's mean.

    Parameters
    ----------
    totals : ndarray of int, shape (height, width)
        Events of each pixel over the whole traverse.
    factor : int
        1 or more.

    Returns
    -------
    ndarray of bool, shape (height, width)

    Raises
    ------
    UsageError
        If `factor` is below 1 or `totals` is not an image.
    """
    if totals.ndim != 2:
        raise UsageError(f"totals have shape {totals.shape}: expected (height, width)")
    if factor < 1:
        raise UsageError(f"hot-pixel factor {factor} is below 1: every pixel would be hot")
    totals = np.ascontiguousarray(totals, dtype=np.int64)
    # above the mean, in integers: n * size > factor * sum
    candidates = totals * totals.size > factor * int(totals.sum())
    return candidates & _above_neighbours(totals, factor)


@kernel
def _above_neighbours(totals, factor):  # type: ignore[no-untyped-def]
    height, width = totals.shape
    above = np.zeros((height, width), dtype=np.bool_)
    around = np.empty(24, dtype=np.int64)
    for y in range(height):
        for x in range(width):
            n = 0
            for v in range(max(0, y - 2), min(height, y + 3)):
                for u in range(max(0, x - 2), min(width, x + 3)):
                    if u != x or v != y:
                        around[n] = totals[v, u]
                        n += 1
            median = np.sort(around[:n])[n // 2] if n > 0 else 0
            above[y, x] = totals[y, x] > factor * (median + 1)
    return above


def load_hot_pixels(path: str | Path, sensor: Sensor) -> npt.NDArray[np.bool_]:
    """Read a list of hot pixels, ``x, y`` in each line, as in the data set Brisbane-Event-VPR.

    Parameters
    ----------
    path : path
        Text file; empty lines, lines that start with ``#``, and a header are skipped.
    sensor : Sensor

    Returns
    -------
    ndarray of bool, shape (height, width)

    Raises
    ------
    RecordingError
        If the file cannot be read or is larger than 64 MiB, or a line is not a pixel of the sensor.
    """
    try:
        if Path(path).stat().st_size > _LONGEST_LIST:
            raise RecordingError(
                f"{path} has more than {_LONGEST_LIST:,} bytes: name a file with a line x, y for "
                "each hot pixel"
            )
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(
            f"cannot read hot pixels from {path}: {error}: name a file with a line x, y for each"
        ) from error
    hot = np.zeros((sensor.height, sensor.width), dtype=np.bool_)
    for number, line in enumerate(lines, 1):
        fields = line.replace(",", " ").split()
        if not fields or fields[0].startswith("#") or (number == 1 and fields[0].isalpha()):
            continue
        try:
            x, y = (_whole(field) for field in fields)
        except (ValueError, OverflowError) as error:
            raise RecordingError(
                f"line {number} of {path} is {line!r}: expected the column and row of a hot pixel"
            ) from error
        if not (0 <= x < sensor.width and 0 <= y < sensor.height):
            raise RecordingError(
                f"line {number} of {path} names the pixel ({x}, {y}), off the {sensor} sensor: "
                "give the list that belongs to this camera"
            )
        hot[y, x] = True
    return hot


def _whole(text: str) -> int:
    number = float(text)
    if not number.is_integer():  # infinity too
        raise ValueError(text)
    return int(number)
