"""Descriptors of a network that the user exported to ONNX: NetVLAD, EventVLAD, or any other.

The model maps images, float32 of shape (n, channels, height, width), to vectors, which are compared
by their cosine. Its input is from 0 to 1: intensities divided by 255, or the logarithms of event
counts divided by the largest one of the window. Any other preprocessing (means and deviations of
ImageNet) must be part of the exported model.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.baselines.baseline import Described, Images
from edge_vpr.baselines.cosine import CosineBaseline
from edge_vpr.baselines.dense import mean_cells
from edge_vpr.errors import MissingExtraError, WeightsError, printable

#: number of images in one call of a model that takes any number
BATCH = 8


def load_runtime() -> Any:
    """Import ONNX Runtime, or raise an error that names the extra with it."""
    try:
        import onnxruntime
    except ImportError as error:
        raise MissingExtraError("a baseline model:FILE", "onnxruntime", "models") from error
    return onnxruntime


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
        path = Path(path)
        runtime = load_runtime()
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        self._path = path
        try:
            self._session = runtime.InferenceSession(
                path.read_bytes(), options, providers=["CPUExecutionProvider"]
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


def model(seed: int, path: Path) -> ModelDescriptor:
    """Make the baseline of a model's file; it draws no random numbers."""
    return ModelDescriptor(path)
