"""Selection of pixels one after another, each by the information that it adds about the place.

The logarithms of the counts of a pixel are taken as a signal with noise of a fixed variance. The
information of a set S of pixels about the place is then ``log det(I + C_S / noise) / 2`` (the
capacity of a Gaussian channel), with the covariance C over the windows of the reference. The greedy
choice always takes the pixel with the largest variance that the pixels before it do not explain (a
Cholesky factorisation with pivots). Its information is at least 1 - 1/e of that of the best set.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from fixedpoint.own_mean import LEVEL_BITS, OwnMeanCode

#: variance of a logarithm between drives at the same place: half an octave squared
NOISE = 1 << (2 * LEVEL_BITS - 1)
#: largest numbers of pixels and of windows that are used; if there are more, a subset is taken
MOST_PIXELS, MOST_WINDOWS = 1 << 14, 1 << 11


def shortlist(saliency: npt.NDArray[np.float64], exclude: npt.NDArray[np.bool_]) -> PixelMap:
    """Choose candidates: the most salient pixel of each cell of the sensor.

    Parameters
    ----------
    saliency : ndarray of float64, shape (height, width)
        Not negative.
    exclude : ndarray of bool, shape (height, width)

    Returns
    -------
    PixelMap
        At most 16,384 pixels, of cells of 1 x 1 pixels or more. Pixels of saliency 0 are left out.
    """
    height, width = saliency.shape
    side = max(1, math.isqrt(height * width // MOST_PIXELS))
    while -(-height // side) * -(-width // side) > MOST_PIXELS:
        side += 1
    usable = np.where(exclude, 0.0, saliency)
    rows, columns = -(-height // side), -(-width // side)
    padded = np.zeros((rows * side, columns * side))
    padded[:height, :width] = usable
    cells = padded.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(rows, columns, -1)
    within = cells.argmax(axis=2)
    row, column = np.nonzero(cells.max(axis=2) > 0)
    down, right = np.divmod(within[row, column], side)
    return PixelMap(
        Sensor(width, height),
        (column * side + right).astype(np.uint16),
        (row * side + down).astype(np.uint16),
    )


def informative_pixels(
    pixel_map: PixelMap, counts: npt.NDArray[np.unsignedinteger], pixels: int
) -> PixelMap:
    """Choose J pixels from a shortlist.

    Parameters
    ----------
    pixel_map : PixelMap
        P pixels.
    counts : ndarray of uint, shape (n, P)
        Their counts in the windows of the reference.
    pixels : int
        J.

    Returns
    -------
    PixelMap
        In the order chosen; of equals, the first of the shortlist.

    Raises
    ------
    UsageError
        If fewer than J pixels say anything.
    """
    some = counts[:: -(-len(counts) // MOST_WINDOWS)]
    levels = np.ascontiguousarray(OwnMeanCode().level(some).T)
    chosen = np.empty(min(pixels, len(pixel_map)), dtype=np.int64)
    found = len(pixel_map)
    if found >= pixels:
        found = _choose(levels, float(NOISE), chosen)
    if found < pixels:
        raise UsageError(
            f"{found} pixels vary and {pixels} were asked for: ask for fewer pixels or map a "
            "longer traverse"
        )
    return PixelMap(pixel_map.sensor, pixel_map.x[chosen], pixel_map.y[chosen])


@kernel
def _choose(levels: npt.NDArray[np.int32], noise: float, chosen: npt.NDArray[np.int64]) -> int:
    """Write the chosen pixels, and return how many pixels have a variance above 0.

    Sums of products are exact integers, and all other sums have a fixed order, so that the choice
    is the same on every machine.
    """
    pixels, windows = levels.shape
    totals = np.zeros(pixels, dtype=np.int64)
    rest = np.empty(pixels, dtype=np.float64)  # variance that the chosen pixels do not explain
    for p in range(pixels):
        for w in range(windows):
            totals[p] += levels[p, w]
        rest[p] = _covariance(levels[p], levels[p], totals[p], totals[p])
    factors = np.zeros((pixels, chosen.size), dtype=np.float64)
    for n in range(chosen.size):
        best = 0
        for p in range(1, pixels):
            if rest[p] > rest[best]:
                best = p
        if not rest[best] > 0:
            return n
        chosen[n] = best
        scale = math.sqrt(rest[best] + noise)
        for p in range(pixels):
            shared = _covariance(levels[p], levels[best], totals[p], totals[best])
            for m in range(n):
                shared -= factors[p, m] * factors[best, m]
            factors[p, n] = shared / scale
            rest[p] -= factors[p, n] * factors[p, n]
        rest[best] = -1.0
    return chosen.size


@kernel
def _covariance(
    a: npt.NDArray[np.int32], b: npt.NDArray[np.int32], total_a: int, total_b: int
) -> float:
    products = np.int64(0)
    for w in range(a.size):
        products += np.int64(a[w]) * np.int64(b[w])
    return float(a.size * products - total_a * total_b) / float(a.size * a.size)
