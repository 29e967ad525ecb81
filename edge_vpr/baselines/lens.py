"""LENS (Hines, Milford and Fischer, 2025): a spiking network with one output neuron a place.

Written from the description and the released code (https://github.com/AdamDHines/LENS,
``lens/run_model.py``, off the chip), for the weights that its training saves. Pixels on a grid are
converted to random spikes. A hidden layer and an output layer of integrate-and-fire neurons (those
of sinabs: the membrane may fall to -1, several spikes a step, reset by subtraction) count the
spikes over a number of steps. The place with the most spikes is the match. Membranes are not reset
between windows.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.baselines.baseline import Described, Images
from edge_vpr.baselines.state_dict import read_state_dict
from edge_vpr.errors import UsageError, WeightsError

#: steps of a window, as in the released code (``timebin``)
STEPS = 1000
#: lowest value of a membrane, as in sinabs
LOWEST = -1.0
_LAYERS = ("feature_layer.w.weight", "output_layer.w.weight")

Floats = npt.NDArray[np.float32]


class LensWeights(NamedTuple):
    """Weights of the two layers.

    Attributes
    ----------
    feature : ndarray of float32, shape (F, side * side)
    output : ndarray of float32, shape (K, F)
        One row for each place.
    """

    feature: Floats
    output: Floats


def load_lens(path: str | Path) -> LensWeights:
    """Read the weights that LENS saved after its training.

    Parameters
    ----------
    path : str or Path
        For example ``NAME_LENS_IN100_FN200_DB80.pth``.

    Raises
    ------
    WeightsError
        If the weights cannot be read, or are not those of LENS.
    """
    found = read_state_dict(path)
    missing = [name for name in _LAYERS if name not in found]
    if missing:
        raise WeightsError(
            f"{path} has no {' and no '.join(missing)}; it has {', '.join(found)}: give weights "
            "that LENS saved"
        )
    feature, output = (found[name] for name in _LAYERS)
    fits = feature.ndim == output.ndim == 2 and feature.shape[0] == output.shape[1]
    if not fits or math.isqrt(feature.shape[1]) ** 2 != feature.shape[1] or not output.size:
        raise WeightsError(
            f"{path} has layers of shape {feature.shape} and {output.shape}: expected "
            "(features, side * side) and (places, features)"
        )
    if not (np.isfinite(feature).all() and np.isfinite(output).all()):
        raise WeightsError(f"{path} has weights that are not finite: train the network again")
    return LensWeights(feature.astype(np.float32), output.astype(np.float32))


class Lens:
    """LENS as a baseline; its places are the windows with which it was trained.

    Parameters
    ----------
    weights : LensWeights
    seed : int
        Seed of the input's random spikes.
    steps : int
        Number of steps of a window.
    thresholds : tuple of float
        Thresholds of the membranes of the hidden and of the output layer. They are (1, 1) in the
        released code, and (10, 2) in its first edition, for the Speck.
    """

    title = "LENS"

    def __init__(
        self,
        weights: LensWeights,
        seed: int = 0,
        steps: int = STEPS,
        thresholds: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        self._weights, self._seed, self._steps = weights, seed, steps
        self._thresholds = thresholds

    def prepare(self, reference: Images) -> None:
        """Check that there is an output neuron for each window of the reference.

        Raises
        ------
        UsageError
            If there are more or fewer.
        """
        places = len(self._weights.output)
        if places != len(reference):
            raise UsageError(
                f"the weights are of {places} places, and the reference has {len(reference)} "
                "windows: train LENS with these windows"
            )

    def describe(self, images: Images) -> Described:
        """Return the spikes of each place's neuron during each window, shape (n, K), float32."""
        # as in the released code, all windows use the same random numbers
        shape = (self._steps, self._weights.feature.shape[1])
        draws = np.random.default_rng(self._seed).random(shape, np.float32)
        share = grid_pixels(images, math.isqrt(self._weights.feature.shape[1]))
        feature = np.zeros(len(self._weights.feature), np.float32)
        output = np.zeros(len(self._weights.output), np.float32)
        counts = np.zeros((len(images), output.size), np.float32)
        for window, row in zip(counts, share, strict=True):
            driven = (draws < row).astype(np.float32) @ self._weights.feature.T
            hidden = np.empty_like(driven)
            for step, current in enumerate(driven):
                hidden[step] = fire(feature, current, self._thresholds[0])
            for current in hidden @ self._weights.output.T:
                window += fire(output, current, self._thresholds[1])
        return counts

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return the difference of each place's spikes from the largest number, shape (K, Q).

        The places' own spikes are not used, since the weights are the map.
        """
        spikes = queries.T.astype(np.float64)
        return np.asarray(spikes.max(initial=0.0) - spikes)

    def bits_per_place(self, places: Described) -> int:
        """Return the bits of both layers' weights for each place, rounded up."""
        bits = 32 * (self._weights.feature.size + self._weights.output.size)
        return -(-bits // len(self._weights.output))

    def operations_per_place(self, places: Described) -> int:
        """Return the products of both layers in all steps for each place, rounded up."""
        products = self._weights.feature.size + self._weights.output.size
        return -(-self._steps * products // len(self._weights.output))


def fire(membrane: Floats, current: Floats, threshold: float) -> Floats:
    """Advance integrate-and-fire neurons by a step, and return their spikes.

    Parameters
    ----------
    membrane : ndarray of float32, shape (n,)
        Changed in place.
    current : ndarray of float32, shape (n,)
    threshold : float
    """
    membrane += current
    spikes = np.maximum(np.trunc(membrane / np.float32(threshold)), np.float32(0))
    membrane -= spikes * np.float32(threshold)
    np.maximum(membrane, np.float32(LOWEST), out=membrane)
    return np.asarray(spikes)


def grid_pixels(images: Images, side: int) -> Floats:
    """Return one pixel of each cell of a grid over the middle of the image, from 0 to 1.

    Parameters
    ----------
    images : ndarray of int, shape (n, height, width)
    side : int
        Number of cells in a row and in a column.

    Returns
    -------
    ndarray of float32, shape (n, side * side)
        Count of the pixel to the upper left of each cell's centre, as a share of 255 events.

    Raises
    ------
    UsageError
        If the image is smaller than the grid.
    """
    _, height, width = images.shape
    cell = min(height, width) // side
    if cell < 1:
        raise UsageError(
            f"images of {width}x{height} pixels for weights of a grid of {side}x{side}: give "
            "weights of a smaller grid"
        )
    first = max(cell // 2 - 1, 0) + cell * np.arange(side)
    top, left = ((length - side * cell) // 2 for length in (height, width))
    taken = images[:, (top + first)[:, None], left + first].reshape(len(images), -1)
    return np.asarray(np.minimum(taken, 255).astype(np.float32) / np.float32(255))


def lens(seed: int, path: Path) -> Lens:
    """Make the baseline with the weights of a file."""
    return Lens(load_lens(path), seed)
