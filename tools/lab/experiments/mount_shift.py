"""A camera whose mounting moved: matches at each shift, of counts and codes, registered and not.

The images of real drives are shifted, and pixels that leave the sensor are lost. Fixed patterns of
the sensor move along, which they would not do in reality; the registration cancels them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.windows import FixedTime, WindowCounts
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.recordings import Faults
from lab.codes import TableCode
from lab.drives import INDOOR, PAPER, WALKS, recorded_drives, without_pairs
from lab.loop import Draw, Drives, Experiment, Row
from lab.pairs import MappedPair, Pair, count_drive
from lab.registration import register
from lab.variants import DEFAULT_MATCHING, Variant

#: shifts to the right and downwards, in pixels
SHIFTS = (0, 1, 2, 4, 8)
_LOG = TableCode("log")


@dataclass(frozen=True)
class Method(Variant):
    """Variant by which a shifted drive is matched."""

    registered: bool = False


METHODS = (
    Method("counts"),
    Method("counts, registered", registered=True),
    Method("3-bit logarithms", code=_LOG),
    Method("3-bit logarithms, registered", code=_LOG, registered=True),
    Method("place filter (default)", DEFAULT_MATCHING),
    Method("place filter, registered", DEFAULT_MATCHING, registered=True),
    Method("all pixels, counts", all_pixels=True),
    Method("all pixels, 3-bit logarithms", all_pixels=True, code=_LOG),
)


class CountedWindows:
    """Windows of a drive that were counted at every pixel, as a recording.

    Parameters
    ----------
    images : ndarray of int, shape (n, height, width)
        Counts of events at each pixel, for n windows.
    """

    def __init__(self, images: npt.NDArray[np.integer], window_us: int) -> None:
        self.sensor = Sensor(images.shape[2], images.shape[1])
        self.window_us = window_us
        self.counted = np.ones(images.shape[1:], dtype=np.bool_)
        self.start_us = self.cropped_us = 0
        self.frame_period: Fraction | None = None
        self.faults = Faults()
        self._images = images

    def windows(self) -> Iterator[WindowCounts]:
        """Yield one window an image from the first one on, over all pixels, row by row."""
        for k, image in enumerate(self._images):
            counts = image.astype(np.int64).ravel()
            start = k * self.window_us
            yield WindowCounts(counts, start, start + self.window_us, int(counts.sum()))


def shifted(images: npt.NDArray[np.integer], dx: int, dy: int) -> npt.NDArray[np.integer]:
    """Shift images to the right and downwards; zeros fill the gap, and other pixels are lost.

    Parameters
    ----------
    images : ndarray of int, shape (n, height, width)
    dx, dy : int
        In pixels.
    """
    _, height, width = images.shape
    moved = np.zeros_like(images)
    moved[:, max(dy, 0) : height + min(dy, 0), max(dx, 0) : width + min(dx, 0)] = images[
        :, max(-dy, 0) : height + min(-dy, 0), max(-dx, 0) : width + min(-dx, 0)
    ]
    return moved


def measure(draw: Draw) -> Iterator[Row]:
    """Shift the query, and match it by every method.

    Those that draw no pixels are matched once, beside the largest number of pixels.
    """
    pair: Pair = draw.pair
    window_us = pair.settings.tau_us
    first, second = (
        count_drive(drive, FixedTime(window_us), bursts=True).images
        for drive in (pair.reference, pair.query)
    )
    reference = CountedWindows(first, window_us)
    every = draw.is_new and pair.settings.pixels == PAPER.pixels
    for method in METHODS:
        if not (method.drawn or every):
            continue
        mapped = method.map(reference, pair.drawn_with(draw.seed))
        if method.code is not None:  # registered by what the code left of the counts
            mapped = method.code.blurred(mapped)
        for shift in SHIFTS:
            row: dict[str, Any] = {"way": method.name, "shift": shift}
            images, used = shifted(second, shift, shift), mapped
            if method.registered:
                used, dx, dy = register(mapped, images)
                row[OFF] = max(abs(dx - shift), abs(dy - shift))
            moved = MappedPair.of(used, CountedWindows(images, window_us), pair.truth_of)
            yield {**row, "P@100R": replace(moved, code=method.code).correct()}


#: error of the estimated shift
OFF = "shift estimated wrongly by (pixels)"


def drives(data: Path | None) -> list[Drives]:
    """Return the recorded pairs whose images can be shifted."""
    pairs = recorded_drives(data, lambda pair: pair.has_images)
    if not pairs:
        raise UsageError(
            f"no drive with counts at every pixel: {without_pairs(data, [INDOOR, WALKS])}"
        )
    return pairs


EXPERIMENT = Experiment(drives=drives, names=("way", "shift"), measure=measure)
