"""Saliency of each pixel: how much its count varies over the windows of a reference traverse."""

from __future__ import annotations

import tempfile

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.descriptors import Descriptors, collect, narrow
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import WindowCounts
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor


class SaliencyPass:
    """Sums over the windows of a traverse, for all pixels; memory does not grow with the windows.

    The image of each window is also written to a temporary file, from which the descriptors are
    read when pixels have been selected. The recording is thus decoded only once.

    Parameters
    ----------
    sensor : Sensor
    clip : int, optional
        Largest count that mean and variance see (the released code: 10).
    spool_bytes : int
        Size up to which the temporary file may grow; above it `descriptors` returns None and the
        recording must be read again.

    Attributes
    ----------
    windows : int
        Number of windows taken, K.
    """

    def __init__(
        self, sensor: Sensor, *, clip: int | None = None, spool_bytes: int = 2 << 30
    ) -> None:
        self._sensor = sensor
        self._clip = clip
        self._events = np.zeros(sensor.pixels, dtype=np.int64)
        self._sum = np.zeros(sensor.pixels, dtype=np.int64)
        self._sum_of_squares = np.zeros(sensor.pixels, dtype=np.int64)
        self._spooled: list[tuple[np.dtype[np.unsignedinteger], tuple[int, int, int]]] = []
        self._room = spool_bytes
        self.windows = 0
        self._spool = tempfile.TemporaryFile(prefix="edge-vpr-")  # noqa: SIM115  # closed by close()

    def __enter__(self) -> SaliencyPass:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def close(self) -> None:
        """Delete the temporary file."""
        self._spool.close()

    def add(self, window: WindowCounts) -> None:
        """Add one window, counted at every pixel of the sensor, row by row."""
        self._events += window.counts
        counts = window.counts if self._clip is None else np.minimum(window.counts, self._clip)
        self._sum += counts
        self._sum_of_squares += counts * counts
        self.windows += 1
        if self._room >= 0:
            image = narrow(window.counts)
            self._room -= image.nbytes
            self._spooled.append((image.dtype, window[1:]))
            self._spool.write(image.data)

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
        """Return the counts of the selected pixels in every window.

        Returns
        -------
        Descriptors or None
            None if the temporary file would have grown too large.
        """
        if self._room < 0:
            return None
        flat = pixel_map.y.astype(np.int64) * self._sensor.width + pixel_map.x
        self._spool.seek(0)
        return collect(
            (
                WindowCounts(self._read_image(dtype)[flat].astype(np.int64), *span)
                for dtype, span in self._spooled
            ),
            len(pixel_map),
        )

    def _read_image(self, dtype: np.dtype[np.unsignedinteger]) -> npt.NDArray[np.unsignedinteger]:
        return np.frombuffer(self._spool.read(self._sensor.pixels * dtype.itemsize), dtype=dtype)

    def _checked_windows(self) -> int:
        if self.windows == 0:
            raise UsageError(
                "the traverse is shorter than one window: take a shorter window or a longer drive"
            )
        return self.windows
