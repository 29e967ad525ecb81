"""The simulated camera: its size, its lens, and the imperfections of its pixels."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import radians, tan

import numpy as np
import numpy.typing as npt

from edge_vpr.events import Sensor
from edge_vpr.simulate.ranges import check_range

_THRESHOLDS, _HOT = 1, 2  # one random stream each, so that one setting does not disturb the other


@dataclass(frozen=True)
class Camera:
    """An event camera.

    The defaults lie in the published range for such sensors; they are not those of a certain
    device.

    Parameters
    ----------
    sensor : Sensor
        Size in pixels.
    field_of_view_deg : float
        Horizontal angle that the lens sees, in degrees.
    contrast_on, contrast_off : float
        Change of the natural logarithm of the light that makes an ON or an OFF event.
    contrast_spread : float
        Standard deviation of both from pixel to pixel, in the same unit. It is a property of the
        device: every drive with this camera and seed meets the same thresholds.
    refractory_us : int
        Time after an event during which its pixel is blind, in microseconds.
    dark : float
        Dark current as a share of the light of a white surface: lowers contrast in the dark.
    noise_hz : float
        Background activity of each pixel, in events per second.
    hot_pixels : int
        Number of pixels that fire by themselves.
    hot_hz : float
        Mean rate of a hot pixel, in events per second; theirs spread around it by a factor of 3.
    bursts_per_minute : float
        Mean number of bursts, in which most pixels fire within a few milliseconds, as a DAVIS does
        when sunlight reaches its bias generator.
    burst_us : int
        Length of a burst, in microseconds.
    burst_share : float
        Share of the pixels that fire in a burst.
    """

    sensor: Sensor = field(default=Sensor(128, 128))
    field_of_view_deg: float = 75.0
    contrast_on: float = 0.25
    contrast_off: float = 0.25
    contrast_spread: float = 0.03
    refractory_us: int = 500
    dark: float = 0.01
    noise_hz: float = 0.1
    hot_pixels: int = 6
    hot_hz: float = 150.0
    bursts_per_minute: float = 1.0
    burst_us: int = 3000
    burst_share: float = 0.8

    def __post_init__(self) -> None:
        contrasts = ("contrast_on", "contrast_off")
        check_range(self, contrasts, "name a contrast of at least 0.02, for example 0.25", 0.02)
        check_range(self, ("field_of_view_deg",), "name an angle from 5 to 140", 5, 140)
        most = self.sensor.pixels
        check_range(self, ("hot_pixels",), f"a {self.sensor} sensor has 0 to {most}", 0, most)
        check_range(self, ("burst_share",), "name a share from 0 to 1", 0, 1)
        others = (
            "contrast_spread", "refractory_us", "dark", "noise_hz", "hot_hz", "bursts_per_minute",
            "burst_us",
        )  # fmt: skip
        check_range(self, others, "name 0 or more")

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return self.sensor.width / 2 / tan(radians(self.field_of_view_deg) / 2)

    def thresholds(self, seed: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Draw the ON and the OFF threshold of each pixel.

        Parameters
        ----------
        seed : int
            Which device of this kind.

        Returns
        -------
        on, off : ndarray of float64, shape (pixels,)
            In row-major order; never below a tenth of the nominal contrast.
        """
        rng = np.random.default_rng((seed, _THRESHOLDS))
        spread = rng.normal(0.0, self.contrast_spread, (2, self.sensor.pixels))
        on, off = (
            np.maximum(nominal + deviation, nominal / 10)
            for nominal, deviation in zip(
                (self.contrast_on, self.contrast_off), spread, strict=True
            )
        )
        return on, off

    def noise_rates(self, seed: int) -> npt.NDArray[np.float64]:
        """Draw the rate at which each pixel fires without a cause.

        Parameters
        ----------
        seed : int
            Which device of this kind.

        Returns
        -------
        ndarray of float64, shape (pixels,)
            Events per second, in row-major order.
        """
        rng = np.random.default_rng((seed, _HOT))
        rates = np.full(self.sensor.pixels, float(self.noise_hz))
        hot = rng.choice(self.sensor.pixels, self.hot_pixels, replace=False)
        rates[hot] += self.hot_hz * 3.0 ** rng.uniform(-1, 1, self.hot_pixels)
        return rates


#: Cameras by name.
CAMERAS = {
    "default": Camera(),
    "tiny": Camera(sensor=Sensor(32, 32), hot_pixels=1),
    "davis346": Camera(
        sensor=Sensor(346, 260),
        contrast_on=0.22,
        contrast_off=0.22,
        refractory_us=300,
        noise_hz=0.1,
        hot_pixels=25,
        bursts_per_minute=2.0,
    ),
    "speck": Camera(
        field_of_view_deg=70.0,
        contrast_on=0.3,
        contrast_off=0.3,
        contrast_spread=0.05,
        refractory_us=1000,
        noise_hz=0.3,
        hot_pixels=20,
        bursts_per_minute=0.0,
    ),
}
