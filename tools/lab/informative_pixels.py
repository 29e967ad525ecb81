"""Pixels chosen one after another, each by the information that it adds about the place.

The logarithms of the counts of a pixel are taken as a signal with noise of a fixed variance. The
information of a set S of pixels about the place is then ``log det(I + C_S / noise) / 2`` (the
capacity of a Gaussian channel), with the covariance C over the windows of the reference. The
greedy choice always takes the pixel with the largest variance that the pixels before it do not
explain (a Cholesky factorisation with pivots). Its information is at least 1 - 1/e of that of
the best set.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from fixedpoint.own_mean import LEVEL_FRACTION_BITS, ContrastCode

#: variance of a logarithm between drives at the same place: half an octave squared
NOISE = 1 << (2 * LEVEL_FRACTION_BITS - 1)
#: largest numbers of pixels and of windows that are used; if there are more, a subset is taken
MOST_PIXELS, MOST_WINDOWS = 1 << 14, 1 << 11


def shortlist(saliency: npt.NDArray[np.float64]) -> PixelMap:
    """Choose candidates: the most salient pixel of each cell of the sensor.

    Parameters
    ----------
    saliency : ndarray of float64, shape (height, width)
        Not negative.

    Returns
    -------
    PixelMap
        At most 16,384 pixels, of cells of 1 x 1 pixels or more. Pixels of saliency 0 are left out.
    """
    height, width = saliency.shape
    side = max(1, math.isqrt(height * width // MOST_PIXELS))
    while -(-height // side) * -(-width // side) > MOST_PIXELS:
        side += 1
    rows, columns = -(-height // side), -(-width // side)
    padded = np.zeros((rows * side, columns * side))
    padded[:height, :width] = saliency
    cells = padded.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(rows, columns, -1)
    row, column = np.nonzero(cells.max(axis=2) > 0)
    down, right = np.divmod(cells.argmax(axis=2)[row, column], side)
    return PixelMap(Sensor(width, height), column * side + right, row * side + down)


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
    """
    some = counts[:: -(-len(counts) // MOST_WINDOWS)]
    # sums of products are whole numbers below 2**53, and so the same in any order
    levels = ContrastCode().level(some).T.astype(np.float64)
    windows, totals = len(some), levels.sum(axis=1)
    # variance that the chosen pixels do not explain
    rest = (windows * (levels * levels).sum(axis=1) - totals * totals) / windows**2
    factors: list[npt.NDArray[np.float64]] = []
    chosen: list[int] = []
    while len(chosen) < pixels and rest.max() > 0:
        best = int(rest.argmax())
        products = levels @ levels[best]
        shared = (windows * products - totals * totals[best]) / windows**2
        for factor in factors:
            shared -= factor * factor[best]
        factors.append(shared / math.sqrt(rest[best] + NOISE))
        rest -= factors[-1] ** 2
        rest[best] = -1.0
        chosen.append(best)
    if len(chosen) < pixels:
        raise UsageError(
            f"{len(chosen)} pixels vary and {pixels} were asked for: ask for fewer pixels or map "
            "a longer traverse"
        )
    return PixelMap(pixel_map.sensor, pixel_map.x[chosen], pixel_map.y[chosen])
