"""Model of a conventional sensor: automatic exposure, read noise, and 8 bits."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.simulate import SimulatedRecording

#: mean of an image after exposure, and standard deviation of the noise of each pixel, both in grey
#: levels from 0 to 255
MEAN_GREY, NOISE_GREY = 90.0, 2.0


def exposed(light: npt.NDArray[np.floating], rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Return an image whose mean is `MEAN_GREY` before clipping.

    Parameters
    ----------
    light : ndarray of float, shape (height, width)
        Linear, 0 or more, in any unit.
    rng : Generator
        Source of the noise.

    Returns
    -------
    ndarray of uint8, shape (height, width)
    """
    gain = MEAN_GREY / max(float(light.mean()), 1e-9)
    grey = light * gain + rng.normal(0.0, NOISE_GREY, light.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def simulated_images(
    drive: SimulatedRecording, time_us: npt.NDArray[np.int64], rng: np.random.Generator
) -> npt.NDArray[np.uint8]:
    """Take intensity images during a simulated drive, at the position of the event camera.

    Each image has its own exposure, which is short enough for a sharp image.

    Parameters
    ----------
    drive : SimulatedRecording
    time_us : ndarray of int64, shape (n,)
        Ascending, within the drive.
    rng : Generator
        Source of the noise.

    Returns
    -------
    ndarray of uint8, shape (n, height, width)

    Raises
    ------
    UsageError
        If a time lies outside the drive.
    """
    images = np.empty((len(time_us), drive.sensor.height, drive.sensor.width), np.uint8)
    for image, light in zip(images, drive.light_at(time_us), strict=True):
        image[:] = exposed(light, rng)
    return images
