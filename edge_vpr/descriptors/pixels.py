"""Selection of a few pixels by their saliency, such as the variance of their counts."""

from __future__ import annotations

import math
import tempfile
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import EqualByValue
from edge_vpr.descriptors.cleaning import load_pixels
from edge_vpr.descriptors.windows import (
    Descriptors,
    WindowCounts,
    collect,
    narrow,
    overlapping,
)
from edge_vpr.errors import UsageError, expect, kind_of
from edge_vpr.events import Sensor
from edge_vpr.settings import STRATEGIES

# Selection of a few pixels by their saliency.


#: smallest distance of two pixels in the released code (Euclidean, in pixels)
REJECTION_RADIUS = 7
#: largest sensor: ten times the pixels of any event camera; the look-up table takes 2 bytes of each
MAX_SENSOR_PIXELS = 1 << 25


@dataclass(frozen=True, eq=False)
class PixelMap(EqualByValue):
    """The J selected pixels of a sensor; slot j of a descriptor counts pixel ``(x[j], y[j])``.

    >>> two = PixelMap(Sensor(4, 4), x=np.array([1, 2]), y=np.array([0, 3]))
    >>> two, two.table()[3].tolist()
    (PixelMap(2 pixels of 4x4), [-1, -1, 1, -1])

    Parameters
    ----------
    x, y : ndarray of uint16, shape (J,)
        Columns and rows, all pixels distinct and on the sensor.
    """

    sensor: Sensor
    x: npt.NDArray[np.uint16]
    y: npt.NDArray[np.uint16]

    def __post_init__(self) -> None:
        expect(self.sensor, Sensor, "sensor", "the size of the camera, as Sensor(346, 260)")
        if Sensor.of(self.sensor).pixels > MAX_SENSOR_PIXELS:
            raise UsageError(
                f"a sensor of {self.sensor} pixels: expected at most {MAX_SENSOR_PIXELS} in all"
            )
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


def select_pixels(
    saliency: npt.NDArray[np.float64],
    pixels: int,
    *,
    strategy: str = "variance",
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
    """
    weights = np.array(saliency, dtype=np.float64)
    if weights.ndim != 2 or weights.size == 0:
        raise UsageError(f"saliency has shape {weights.shape}: expected (height, width)")
    if not (np.isfinite(weights).all() and (weights >= 0).all()):
        raise UsageError(
            "saliency holds negative or non-finite values: expected variances or means"
        )
    expect(pixels, (int, np.integer), "pixels", "a whole number")
    if not hasattr(rng, "random"):
        raise UsageError(f"rng is {kind_of(rng)}: give numpy.random.default_rng(seed)")
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
        raise UsageError(f"strategy {strategy!r} is unknown: choose from {', '.join(STRATEGIES)}")
    if exclude is not None:
        weights[exclude] = 0.0

    drawable = int(np.count_nonzero(weights))
    if drawable < pixels:
        excluded = 0 if exclude is None else int(np.count_nonzero(np.asarray(saliency)[exclude]))
        raise _too_few_pixels(drawable, excluded, pixels, sensor)
    if strategy == "top":
        flat = np.argsort(-weights, axis=None, kind="stable")[:pixels]
    elif strategy == "seed-code":
        flat = _draw(weights, pixels, _disc_complement, rng)
    else:
        flat = _draw(weights, pixels, _inverse_gaussian(sigma, max(height, width)), rng)
    y, x = np.divmod(flat, width)
    return PixelMap(sensor, x.astype(np.uint16), y.astype(np.uint16))


def _too_few_pixels(drawable: int, excluded: int, pixels: int, sensor: Sensor) -> UsageError:
    """Return the error that fewer pixels can be selected than were asked for, with the cause.

    Parameters
    ----------
    drawable : int
        Pixels that vary and are not excluded.
    excluded : int
        Pixels that vary and are excluded, as hot.
    pixels : int
        Asked for.
    """
    begin = f"only {drawable} of {sensor.pixels} pixels can be drawn and {pixels} were asked for"
    if excluded and drawable + excluded >= pixels:
        return UsageError(
            f"{begin}: {excluded} others vary, but were left out as hot: keep them "
            "(hot_pixels='keep'), or give a list of the hot ones"
        )
    if pixels > sensor.pixels:
        return UsageError(f"{begin}: ask for at most {drawable}")
    return UsageError(f"{begin}: ask for fewer pixels or map a longer traverse")


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


# Saliency of each pixel: how much its count varies over the windows of a reference traverse.


class PixelStatistics:
    """Sums over the windows of a traverse, for all pixels; memory does not grow with the windows.

    The image of each window is also written to a temporary file, from which the descriptors are
    read when pixels have been selected. The recording is thus decoded only once.

    Parameters
    ----------
    clip : int, optional
        Counts above this are clipped for mean and variance (the released code: 10).
    parts : int
        Successive parts that a window is added in.
    spool_bytes : int
        Size up to which the temporary file may grow; above it `pieces` and `descriptors` return
        None, and the recording must be read again.

    Attributes
    ----------
    windows : int
        Number of windows taken, K.
    """

    def __init__(
        self,
        sensor: Sensor,
        *,
        clip: int | None = None,
        parts: int = 1,
        spool_bytes: int = 2 << 30,
    ) -> None:
        self._sensor = sensor
        self._clip = clip
        self._parts = parts
        self._open: list[npt.NDArray[np.int64]] = []  # parts of the window that is not complete
        self._events = np.zeros(sensor.pixels, dtype=np.int64)
        self._sum = np.zeros(sensor.pixels, dtype=np.int64)
        self._sum_of_squares = np.zeros(sensor.pixels, dtype=np.int64)
        #: of each part in the temporary file: bytes of a count, start, end and events
        self._spooled = array("q")
        self._room = spool_bytes
        self.windows = 0
        self._spool = tempfile.TemporaryFile(prefix="edge-vpr-")  # noqa: SIM115  # closed by close()

    def __enter__(self) -> PixelStatistics:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def close(self) -> None:
        """Delete the temporary file."""
        self._spool.close()

    def add(self, window: WindowCounts) -> None:
        """Add a window or the next part of one, counted at every pixel, row by row."""
        if self._room >= 0:
            image = narrow(window.counts)
            self._room -= image.nbytes
            self._spooled.extend((image.itemsize, *window[1:4]))
            self._spool.write(image.data)
        self._open.append(window.counts)
        if len(self._open) < self._parts:
            return
        first, *others = self._open
        counts = sum(others, start=first)
        self._open = []
        self._events += counts
        if self._clip is not None:
            counts = np.minimum(counts, self._clip)
        self._sum += counts
        self._sum_of_squares += counts * counts
        self.windows += 1

    @property
    def totals(self) -> npt.NDArray[np.int64]:
        """Events of each pixel over all windows, shape (height, width)."""
        return self._events.reshape(self._sensor.height, self._sensor.width)

    def mean(self) -> npt.NDArray[np.float64]:
        """Mean count of each pixel, shape (height, width): the released code's saliency."""
        return self._sum.reshape(self.totals.shape) / self._checked_windows()

    def variance(self) -> npt.NDArray[np.float64]:
        """Variance of each pixel's count over the windows (paper, eq. 3), shape (height, width).

        The numerator ``K * sum(c^2) - sum(c)^2`` is exact in integers; one division rounds.
        """
        k = self._checked_windows()
        if k * int(self._sum_of_squares.max()) < 2**53:
            numerator = k * self._sum_of_squares - self._sum**2
            return (numerator / (k * k)).reshape(self.totals.shape)
        exact = [
            (k * squares - total**2) / (k * k)
            for squares, total in zip(
                self._sum_of_squares.tolist(), self._sum.tolist(), strict=True
            )
        ]
        return np.array(exact).reshape(self.totals.shape)

    def descriptors(self, pixel_map: PixelMap) -> Descriptors | None:
        """Return the counts of the selected pixels in every window; see `pieces`."""
        pieces = self.pieces(pixel_map)
        if pieces is None or self._parts == 1:
            return pieces
        return overlapping(pieces, self._parts).take(slice(None, None, self._parts))

    def pieces(self, pixel_map: PixelMap) -> Descriptors | None:
        """Return the counts of the selected pixels in every part of a window.

        Returns
        -------
        Descriptors or None
            None if the temporary file would have grown too large.
        """
        if self._room < 0:
            return None
        flat = pixel_map.y.astype(np.int64) * self._sensor.width + pixel_map.x
        self._spool.seek(0)
        spooled = iter(self._spooled)
        return collect(
            (
                WindowCounts(self._read_image(size)[flat].astype(np.int64), *span)
                for size, *span in zip(spooled, spooled, spooled, spooled, strict=True)
            ),
            len(pixel_map),
        )

    def _read_image(self, item_bytes: int) -> npt.NDArray[np.unsignedinteger]:
        image = self._spool.read(self._sensor.pixels * item_bytes)
        return np.frombuffer(image, dtype=f"u{item_bytes}")

    def _checked_windows(self) -> int:
        if self.windows == 0:
            raise UsageError(
                "the traverse is shorter than one window: take a shorter window or a longer drive"
            )
        return self.windows


# Pixels of a file.


def load_pixel_map(path: str | Path, sensor: Sensor) -> PixelMap:
    """Read a list of pixels, ``x, y`` in each line, in the order of their slots.

    Parameters
    ----------
    path : str or Path
        Text as `edge_vpr.descriptors.cleaning.load_pixels` reads it.

    Raises
    ------
    RecordingError
        If the file cannot be read, or a line is not a pixel of the sensor.
    UsageError
        If it names no pixel, or one twice.
    """
    listed = load_pixels(path, sensor, "pixel map")
    if not len(listed):
        raise UsageError(f"{path} names no pixel: give a line x, y for each")
    x, y = listed.T
    return PixelMap(Sensor.of(sensor), x, y)
