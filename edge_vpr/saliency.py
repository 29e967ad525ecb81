"""The first pass over a reference traverse: how much every pixel's count varies from window to window."""

from __future__ import annotations

import tempfile

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.pixels import PixelMap
from edge_vpr.windows import Descriptors, narrow


class SaliencyPass:
    """Adds up the windows of a traverse over all pixels, in memory independent of their number.

    Each window's image also goes to a temporary file, so that the descriptors at the pixels which
    are selected afterwards need no second decoding of the recording.

    Parameters
    ----------
    sensor : Sensor
    spool_bytes : int
        Size up to which the temporary file may grow; above it `descriptors` returns None and the
        recording must be read again.
    """

    def __init__(self, sensor: Sensor, *, spool_bytes: int = 2 << 30) -> None:
        self._sensor = sensor
        self._sum = np.zeros(sensor.pixels, dtype=np.int64)
        self._sum_of_squares = np.zeros(sensor.pixels, dtype=np.int64)
        self._spans: list[tuple[int, int]] = []
        self._room = spool_bytes
        self._dtypes: list[np.dtype[np.unsignedinteger]] = []
        self._spool = tempfile.TemporaryFile(prefix="edge-vpr-")  # noqa: SIM115  # closed by close()

    def __enter__(self) -> SaliencyPass:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def close(self) -> None:
        """Delete the temporary file."""
        self._spool.close()

    def add(self, counts: npt.NDArray[np.integer], start_us: int, end_us: int) -> None:
        """Take one window.

        Parameters
        ----------
        counts : ndarray of int, shape (height * width,)
            Events of each pixel, row by row.
        start_us, end_us : int
        """
        wide = counts.astype(np.int64, copy=False)
        self._sum += wide
        self._sum_of_squares += wide * wide
        self._spans.append((start_us, end_us))
        if self._room >= 0:
            image = narrow(wide)
            self._room -= image.nbytes
            self._dtypes.append(image.dtype)
            self._spool.write(image.data)

    @property
    def windows(self) -> int:
        """Number of windows taken, K."""
        return len(self._spans)

    @property
    def totals(self) -> npt.NDArray[np.int64]:
        """Events of each pixel over all windows, shape (height, width)."""
        return self._sum.reshape(self._sensor.height, self._sensor.width)

    def mean(self) -> npt.NDArray[np.float64]:
        """Mean count of each pixel, shape (height, width): the released code's saliency."""
        return self.totals / self._checked_windows()

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
        """Counts at the selected pixels in every window; None if the temporary file was too small.

        Parameters
        ----------
        pixel_map : PixelMap

        Returns
        -------
        Descriptors or None
        """
        if self._room < 0:
            return None
        flat = pixel_map.y.astype(np.int64) * self._sensor.width + pixel_map.x
        counts = np.empty((self.windows, len(pixel_map)), dtype=np.uint64)
        self._spool.seek(0)
        for k, dtype in enumerate(self._dtypes):
            image = self._spool.read(self._sensor.pixels * dtype.itemsize)
            counts[k] = np.frombuffer(image, dtype=dtype)[flat]
        spans = np.array(self._spans, dtype=np.int64).reshape(-1, 2)
        return Descriptors(narrow(counts), spans[:, 0], spans[:, 1])

    def _checked_windows(self) -> int:
        if self.windows == 0:
            raise UsageError(
                "the traverse is shorter than one window: take a shorter window or a longer drive"
            )
        return self.windows
