"""Grey PNG images as count frames."""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError
from edge_vpr.events import Sensor

#: Most pixels of a frame: four times as many as the largest event camera has.
MOST_PIXELS = 1 << 22
_LARGEST_IMAGE = 1 << 26


def read_image(path: Path, sensor: Sensor | None) -> npt.NDArray[Any]:
    """Read one 8- or 16-bit grey PNG; its values are counts.

    Parameters
    ----------
    path : Path
    sensor : Sensor or None
        Size that the image must have, if it is known.

    Returns
    -------
    ndarray of uint16, shape (height, width)

    Raises
    ------
    RecordingError
        If it is damaged, of another mode or size, or larger than :data:`MOST_PIXELS`.
    """
    pixels, mode = _open_png(path)
    if not (mode == "L" or mode.startswith("I")) or pixels.ndim != 2:
        raise RecordingError(
            f"{path} has mode {mode}: count frames are 8- or 16-bit grey without alpha or palette"
        )
    check_size(path, pixels, sensor)
    if pixels.min(initial=0) < 0 or pixels.max(initial=0) > 0xFFFF:
        raise RecordingError(f"{path} has values outside 0 to 65,535: write 8- or 16-bit grey")
    return pixels.astype(np.uint16)


def check_size(path: Path, frame: npt.NDArray[Any], first: Sensor | None) -> None:
    """Raise RecordingError if a frame has another size than the first one."""
    if first is not None and frame.shape[:2] != (first.height, first.width):
        raise RecordingError(
            f"{path} has {frame.shape[1]}x{frame.shape[0]} pixels and the first frame {first}: "
            "all frames need one size"
        )


def read_png(path: Path) -> npt.NDArray[np.uint8]:
    """Read a grey or coloured PNG as an image of 8 bits a channel.

    Returns
    -------
    ndarray of uint8, shape (height, width) or (height, width, 3 or 4)
        Red, green, blue and alpha; the upper 8 bits of 16-bit values.

    Raises
    ------
    RecordingError
        If it is damaged, of another mode, or larger than :data:`MOST_PIXELS`.
    """
    pixels, mode = _open_png(path)
    if mode in ("L", "RGB", "RGBA"):
        return pixels.astype(np.uint8)
    if mode.startswith("I") and pixels.min(initial=0) >= 0 and pixels.max(initial=0) <= 0xFFFF:
        return (pixels >> 8).astype(np.uint8)
    raise RecordingError(
        f"{path} has mode {mode}: write 8- or 16-bit grey, or RGB without a palette"
    )


def _open_png(path: Path) -> tuple[npt.NDArray[Any], str]:
    """Return the pixels of a PNG and Pillow's name of their mode."""
    from PIL import Image

    if path.stat().st_size > _LARGEST_IMAGE:
        raise RecordingError(f"{path} has more than {_LARGEST_IMAGE:,} bytes: write it again")
    # not from the file: Pillow would ask it for as many bytes as a damaged chunk claims
    content = io.BytesIO(path.read_bytes())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the size is checked below
            with Image.open(content, formats=("PNG",)) as image:
                mode, size = image.mode, Sensor(*image.size)
                fits = size.possible and size.pixels <= MOST_PIXELS
                pixels = np.asarray(image) if fits else np.empty(0)
    except MemoryError:
        raise
    except Exception as error:  # Pillow passes on exceptions of any kind from its parser
        raise RecordingError(f"{path} is damaged or no PNG ({error}): write it again") from error
    if not fits:
        raise RecordingError(
            f"{path} claims {size} pixels; there is one at least, and the most is "
            f"{MOST_PIXELS:,}: write it again"
        )
    return pixels, mode


def number_key(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts ``frame_2`` before ``frame_10``."""
    return [
        (int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.stem)
    ]
