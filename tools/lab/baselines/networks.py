"""Baselines with a network: LENS from its published weights, and any network as ONNX."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import EdgeVprError, UsageError, import_extra, printable
from edge_vpr.files import check_is_file, open_input
from lab.baselines.baseline import Described, Images
from lab.baselines.dense import CosineBaseline, mean_cells


class WeightsError(EdgeVprError):
    """The weights of a network cannot be read, or do not fit the images or the places."""


# Weights, each read by the library of its format.


def read_state_dict(path: str | Path) -> dict[str, npt.NDArray[Any]]:
    """Read the tensors of a state dict.

    Parameters
    ----------
    path : str or Path
        A ``.safetensors`` file, or what ``torch.save`` wrote. Neither can run code.

    Returns
    -------
    dict of str to ndarray

    Raises
    ------
    MissingExtraError
        If the library of the format is not installed.
    WeightsError
        If the file is missing, damaged or of another kind, or holds anything other than tensors.
    """
    path = Path(path)
    read = _read_safetensors if path.suffix == ".safetensors" else _read_torch
    try:
        check_is_file(path)
        values = read(path)
    except EdgeVprError:
        raise
    except OSError as error:
        raise WeightsError(
            f"{path} cannot be read: {error.strerror or error}: check the path"
        ) from error
    except Exception as error:  # the libraries raise classes of their own
        raise WeightsError(
            f"{path} is damaged, or no state dict ({printable(error, 200)}): save it again with "
            "torch.save(model.state_dict(), ...)"
        ) from error
    if not values:
        raise WeightsError(f"{path} holds no tensors: save the state dict of a trained network")
    return values


def _read_safetensors(path: Path) -> dict[str, npt.NDArray[Any]]:
    what = "weights in a .safetensors file"
    return dict(import_extra("safetensors.numpy", what, "safetensors", "lab").load_file(path))


def _read_torch(path: Path) -> dict[str, npt.NDArray[Any]]:
    torch = import_extra("torch", f"weights in a {path.suffix or 'PyTorch'} file", "torch", "torch")
    values = torch.load(path, map_location="cpu", weights_only=True)
    if not isinstance(values, dict):
        raise WeightsError(
            f"{path} holds a {type(values).__name__} and no state dict: save it again with "
            "torch.save(model.state_dict(), ...)"
        )
    return {
        str(name): tensor.detach().numpy()
        for name, tensor in values.items()
        if isinstance(tensor, torch.Tensor)
    }


# LENS (Hines, Milford and Fischer, 2025): a spiking network with one output neuron a place.
#
# Written from the description and the released code (https://github.com/AdamDHines/LENS,
# ``lens/run_model.py``, off the chip), for the weights that its training saves. Pixels on a grid
# are converted to random spikes. A hidden layer and an output layer of integrate-and-fire neurons
# (those of sinabs: the membrane may fall to -1, several spikes a step, reset by subtraction) count
# the spikes over a number of steps. The place with the most spikes is the match. Membranes are not
# reset between windows.


#: steps of a window, as in the released code (``timebin``)
STEPS = 1000
#: lowest value of a membrane, as in sinabs
LOWEST = -1.0
_LAYERS = ("feature_layer.w.weight", "output_layer.w.weight")

Floats = npt.NDArray[np.float32]


class LensWeights(NamedTuple):
    """Weights of the two layers."""

    feature: Floats  #: Shape (F, side * side): weights from each input to each of F features.
    output: Floats  #: Shape (K, F): one row for each place.


def load_lens(path: str | Path) -> LensWeights:
    """Read the weights that LENS saved after its training.

    Raises
    ------
    WeightsError
        If the weights cannot be read, or are not those of LENS.
    """
    weights = read_state_dict(path)
    missing = [name for name in _LAYERS if name not in weights]
    if missing:
        raise WeightsError(
            f"{path} has no {' and no '.join(missing)}; it has {', '.join(weights)}: give weights "
            "that LENS saved"
        )
    feature, output = (weights[name] for name in _LAYERS)
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
        """Check that there is an output neuron for each window of the reference."""
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
        Input of each neuron.
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
        Counts of events at each pixel.
    side : int
        Number of cells in a row and in a column.

    Returns
    -------
    ndarray of float32, shape (n, side * side)
        Count of the pixel to the upper left of each cell's centre, as a share of 255 events.
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


def lens(seed: int, file: str) -> Lens:
    """Make the baseline with the weights of a file."""
    return Lens(load_lens(Path(file)), seed)


# Descriptors of a network that the user exported to ONNX: NetVLAD, EventVLAD, or any other.
#
# The model maps images, float32 of shape (n, channels, height, width), to vectors, which are
# compared by their cosine. Its input is from 0 to 1: intensities divided by 255, or the logarithms
# of event counts divided by the largest one of the window. Any other preprocessing (means and
# deviations of ImageNet) must be part of the exported model.


#: number of images in one call of a model that takes any number
BATCH = 8


class ModelDescriptor(CosineBaseline):
    """Vectors of an ONNX model; distance is 1 less the cosine.

    Images are resized to the model's height and width by the mean of the pixels in each cell
    (smaller images repeat pixels), and repeated for its channels. A model of variable size gets the
    images as they are. The model runs on one core.

    Raises
    ------
    MissingExtraError
        If ONNX Runtime is not installed.
    WeightsError
        If the file cannot be read, or the model does not take images.
    """

    def __init__(self, path: str | Path) -> None:
        runtime = import_extra("onnxruntime", "a baseline model:FILE", "onnxruntime", "lab")
        path = Path(path)
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        self._path = path
        try:
            with open_input(path) as file:
                model = file.read()
            self._session = runtime.InferenceSession(
                model, options, providers=["CPUExecutionProvider"]
            )
        except OSError as error:
            raise WeightsError(
                f"{path} cannot be read: {error.strerror}: check the path"
            ) from error
        except Exception as error:  # the runtime raises classes of its own
            raise WeightsError(
                f"{path} is no model that ONNX Runtime reads ({printable(error, 300)}): export it "
                "again, weights included"
            ) from error
        inputs = self._session.get_inputs()
        shape = list(inputs[0].shape) if inputs else []
        if len(inputs) != 1 or len(shape) != 4 or inputs[0].type != "tensor(float)":
            listed = ", ".join(f"{each.name} {each.type} {each.shape}" for each in inputs)
            raise WeightsError(
                f"{path} takes {listed or 'nothing'}: export a model of one input, float32 of "
                "shape (n, channels, height, width)"
            )
        self._name = str(inputs[0].name)
        # an axis whose length is not a number has any length
        self._size = [length if isinstance(length, int) else None for length in shape]
        self.title = f"{path.stem}, cosine"

    def describe(self, images: Images) -> Described:
        """Return the vectors, shape (n, D), float32.

        Raises
        ------
        WeightsError
            If the model fails, or does not return a finite vector for each image.
        """
        batch = self._size[0] or BATCH
        rows = []
        for first in range(0, len(images), batch):
            part = self._input(images[first : first + batch])
            wanted = len(part)
            if self._size[0]:  # a model of a fixed number always gets that number
                part = np.concatenate([part, np.repeat(part[-1:], batch - wanted, axis=0)])
            rows.append(self._run(part)[:wanted])
        return np.concatenate(rows)

    def _run(self, part: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        try:
            vectors = np.asarray(self._session.run(None, {self._name: part})[0])
        except Exception as error:  # the runtime raises classes of its own
            raise WeightsError(
                f"{self._path} fails on images of shape {part.shape} ({printable(error, 300)}): "
                "export it for this shape"
            ) from error
        if vectors.ndim < 2 or len(vectors) != len(part) or vectors.dtype.kind != "f":
            raise WeightsError(
                f"{self._path} gives {vectors.dtype} of shape {vectors.shape} for {len(part)} "
                "images: export a model that gives a vector an image"
            )
        if not np.isfinite(vectors).all():
            raise WeightsError(f"{self._path} gives values that are not finite: check its weights")
        return vectors.reshape(len(vectors), -1).astype(np.float32)

    def _input(self, images: Images) -> npt.NDArray[np.float32]:
        _, channels, height, width = self._size
        size = (height or images.shape[1], width or images.shape[2])
        values = images if size == images.shape[1:] else mean_cells(images, *size)
        if images.dtype == np.uint8:  # intensities; counts have more bits
            scaled = values / 255.0
        else:
            logarithms = np.log1p(values)
            most = logarithms.max(axis=(1, 2), keepdims=True)
            scaled = np.divide(logarithms, most, out=np.zeros_like(logarithms), where=most > 0)
        return np.repeat(scaled[:, None].astype(np.float32), channels or 1, axis=1)


def model(seed: int, file: str) -> ModelDescriptor:
    """Make the baseline of a model's file; it draws no random numbers."""
    return ModelDescriptor(Path(file))
