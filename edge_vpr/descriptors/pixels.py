"""Selection of a few pixels by their saliency."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.settings import STRATEGIES, Strategy

#: strategies that use one number for each pixel; the other one uses all windows
BY_SALIENCY = tuple(name for name in STRATEGIES if name != "information")

#: smallest distance of two pixels in the released code (Euclidean, in pixels)
REJECTION_RADIUS = 7
#: largest sensor: ten times the pixels of any event camera; the look-up table takes 2 bytes of each
MAX_SENSOR_PIXELS = 1 << 25


@dataclass(frozen=True)
class PixelMap:
    """The J selected pixels of a sensor; slot j of a descriptor counts pixel ``(x[j], y[j])``.

    Parameters
    ----------
    sensor : Sensor
    x, y : ndarray of uint16, shape (J,)
        Columns and rows, all pixels distinct and on the sensor.

    Raises
    ------
    UsageError
        If the sensor has a side outside 1 to 65,536 or too many pixels, or a pixel lies off the
        sensor or occurs twice.
    """

    sensor: Sensor
    x: npt.NDArray[np.uint16]
    y: npt.NDArray[np.uint16]

    def __post_init__(self) -> None:
        _check_sensor(self.sensor)
        x, y = np.asarray(self.x), np.asarray(self.y)
        if x.dtype.kind not in "iu" or y.dtype.kind not in "iu":
            raise UsageError(
                f"pixel map has columns of {x.dtype} and rows of {y.dtype}: expected whole numbers"
            )
        if x.ndim != 1 or x.shape != y.shape or x.size == 0:
            raise UsageError(f"pixel map has {x.shape} columns and {y.shape} rows: give J of each")
        if x.min() < 0 or y.min() < 0 or x.max() >= self.sensor.width or y.max() >= self.sensor[1]:
            raise UsageError(
                f"pixel map reaches column {x.max()} and row {y.max()}, off the {self.sensor} "
                "sensor: name the sensor that the pixels were selected on"
            )
        flat = y.astype(np.int64) * self.sensor.width + x
        if np.unique(flat).size != flat.size:
            raise UsageError("pixel map names a pixel twice: each slot needs a pixel of its own")
        for name, column in (("x", x), ("y", y)):
            column = column.astype(np.uint16)
            column.setflags(write=False)
            object.__setattr__(self, name, column)

    def __len__(self) -> int:
        return self.x.size

    def __repr__(self) -> str:
        return f"PixelMap({len(self)} pixels of {self.sensor})"

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, PixelMap)
            and self.sensor == other.sensor
            and np.array_equal(self.x, other.x)
            and np.array_equal(self.y, other.y)
        )

    __hash__ = None  # type: ignore[assignment]  # holds arrays

    def table(self) -> npt.NDArray[np.int16 | np.int32]:
        """Look-up from pixel to slot.

        Returns
        -------
        ndarray of int16 (int32 from 32,768 pixels on), shape (height, width)
            The slot of a selected pixel, -1 elsewhere.
        """
        dtype = np.int16 if len(self) <= np.iinfo(np.int16).max else np.int32
        table = np.full((self.sensor.height, self.sensor.width), -1, dtype=dtype)
        table[self.y, self.x] = np.arange(len(self), dtype=dtype)
        return table

    @classmethod
    def all_of(cls, sensor: Sensor) -> PixelMap:
        """Every pixel of a sensor, row by row: the paper's dense baseline."""
        y, x = np.divmod(np.arange(sensor.pixels), sensor.width)
        return cls(sensor, x.astype(np.uint16), y.astype(np.uint16))


def _check_sensor(sensor: Sensor) -> None:
    sides = all(
        isinstance(side, int | np.integer) and not isinstance(side, bool) and 1 <= side <= 65_536
        for side in sensor
    )
    if not sides or sensor.pixels > MAX_SENSOR_PIXELS:
        raise UsageError(
            f"a sensor of {sensor} pixels: expected sides of 1 to 65536 and at most "
            f"{MAX_SENSOR_PIXELS} pixels in all"
        )


def select_pixels(
    saliency: npt.NDArray[np.float64],
    pixels: int,
    *,
    strategy: Strategy = "variance",
    sigma: float = 7.0,
    rng: np.random.Generator,
    exclude: npt.NDArray[np.bool_] | None = None,
) -> PixelMap:
    """Choose J pixels of the reference traverse (paper, section III-B).

    ``variance`` draws with a probability proportional to the saliency, and after each draw
    multiplies the probabilities by the inverse of a Gaussian around the drawn pixel, 0 at the pixel
    itself and 1 far away. ``random`` draws in the same way from equal probabilities, and
    ``random-upper`` from those of the upper two thirds of the rows. ``top`` takes the most salient
    pixels (ties: lowest row, then lowest column). ``seed-code`` is the released code's variant:
    saliency above mean + 2 std is replaced by 0.01, and no pixel lies within 7 px of another.

    Parameters
    ----------
    saliency : ndarray of float64, shape (height, width)
        Not negative; for example the variance of each pixel's count over the reference windows.
    pixels : int
        J, the number of pixels to choose.
    strategy : {"variance", "seed-code", "random", "random-upper", "top"}
        For "information", see `informative_pixels`.
    sigma : float
        Standard deviation of the suppressed surround, in pixels; 0 suppresses the pixel alone. The
        paper states no value; 7 is the radius of its released code.
    rng : numpy.random.Generator
        The only source of randomness.
    exclude : ndarray of bool, shape (height, width), optional
        True where a pixel must not be chosen (hot pixels).

    Returns
    -------
    PixelMap
        In the order drawn.

    Raises
    ------
    UsageError
        If fewer than `pixels` pixels can be drawn, or an argument is out of range.
    """
    weights = np.array(saliency, dtype=np.float64)
    if weights.ndim != 2 or weights.size == 0:
        raise UsageError(f"saliency has shape {weights.shape}: expected (height, width)")
    if not (np.isfinite(weights).all() and (weights >= 0).all()):
        raise UsageError(
            "saliency holds negative or non-finite values: expected variances or means"
        )
    if pixels < 1:
        raise UsageError(f"cannot select {pixels} pixels: ask for at least 1")
    if not (math.isfinite(sigma) and (sigma == 0 or sigma >= 0.01)):
        raise UsageError(
            f"surround suppression sigma = {sigma} px: expected 0 or more, and 0.01 if not 0"
        )
    height, width = weights.shape
    sensor = Sensor(width, height)

    if strategy == "seed-code":
        # If all means are below 0.01, this makes an outlier the most probable pixel. It is kept
        # because this strategy has to give the results of the released code.
        weights[weights > weights.mean() + 2 * weights.std()] = 0.01
    elif strategy in ("random", "random-upper"):
        weights[:] = 1.0
        if strategy == "random-upper":
            weights[height - height // 3 :] = 0.0
    elif strategy not in ("variance", "top"):
        raise UsageError(
            f"strategy {strategy!r} does not select by saliency: choose from "
            f"{', '.join(BY_SALIENCY)}"
        )
    if exclude is not None:
        weights[exclude] = 0.0

    drawable = int(np.count_nonzero(weights))
    if drawable < pixels:
        raise UsageError(
            f"only {drawable} of {sensor.pixels} pixels can be drawn and {pixels} were asked for: "
            "ask for fewer pixels or map a longer traverse"
        )
    if strategy == "top":
        flat = np.argsort(-weights, axis=None, kind="stable")[:pixels]
    elif strategy == "seed-code":
        flat = _draw(weights, pixels, _disc_complement, rng)
    else:
        flat = _draw(weights, pixels, _inverse_gaussian(sigma, max(height, width)), rng)
    y, x = np.divmod(flat, width)
    return PixelMap(sensor, x.astype(np.uint16), y.astype(np.uint16))


_Suppression = Callable[[npt.NDArray[np.int64], npt.NDArray[np.int64]], npt.NDArray[np.float64]]


def _draw(
    weights: npt.NDArray[np.float64],
    pixels: int,
    suppression: _Suppression,
    rng: np.random.Generator,
) -> npt.NDArray[np.int64]:
    """Draw flat indices one after another; the weights need not be normalised."""
    height, width = weights.shape
    rows, columns = np.arange(height), np.arange(width)
    flat = np.empty(pixels, dtype=np.int64)
    for j in range(pixels):
        running = np.cumsum(weights, axis=None)
        total = running[-1]
        if not total > 0:
            raise UsageError(
                f"only {j} pixels can be drawn before the surrounds cover the sensor and {pixels} "
                "were asked for: ask for fewer pixels, or for a smaller suppression sigma"
            )
        flat[j] = np.searchsorted(running, rng.random() * total, side="right")
        y, x = divmod(int(flat[j]), width)
        weights *= suppression(columns - x, rows - y)
    return flat


def _inverse_gaussian(sigma: float, reach: int) -> _Suppression:
    # a table by math.exp, because NumPy's exp can differ in the last bit between machines
    if sigma == 0:
        table = np.zeros(reach)
        table[0] = 1.0
    else:
        table = np.array([math.exp(-d * d / (2.0 * sigma * sigma)) for d in range(reach)])

    def suppress(dx: npt.NDArray[np.int64], dy: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        return 1.0 - table[np.abs(dy)][:, None] * table[np.abs(dx)][None, :]

    return suppress


def _disc_complement(
    dx: npt.NDArray[np.int64], dy: npt.NDArray[np.int64]
) -> npt.NDArray[np.float64]:
    # Setting the weights inside the radius to zero gives the same distribution as rejecting draws,
    # and does not fail after 100 rejections as the released code does.
    outside = dy[:, None] ** 2 + dx[None, :] ** 2 > REJECTION_RADIUS**2
    return outside.astype(np.float64)
