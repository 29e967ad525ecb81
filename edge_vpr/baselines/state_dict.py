"""Weights that PyTorch saved (``torch.save`` of a state dict), read without PyTorch.

Such a file is a ZIP with a pickle, and pickles run code: only the few names that a state dict
needs are known here, and nothing of them is called but to make an array (as ``weights_only`` does).
"""

from __future__ import annotations

import io
import math
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import EdgeVprError, WeightsError, printable

#: most bytes of the pickle, which holds names and shapes alone, and of one tensor's numbers
_LONGEST_PICKLE, _LARGEST = 1 << 22, 1 << 30
_KINDS = {
    "FloatStorage": "f4",
    "DoubleStorage": "f8",
    "HalfStorage": "f2",
    "LongStorage": "i8",
    "IntStorage": "i4",
    "ShortStorage": "i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
    "BoolStorage": "?",
}
_MOST_DIMENSIONS = 16


class _Kind(NamedTuple):
    """Numbers of a storage."""

    code: str


def read_state_dict(path: str | Path) -> dict[str, npt.NDArray[Any]]:
    """Read the tensors of a state dict.

    Parameters
    ----------
    path : str or Path
        A ``.pth`` or ``.pt`` file of PyTorch 1.6 or newer.

    Returns
    -------
    dict of str to ndarray

    Raises
    ------
    WeightsError
        If the file is missing, damaged or of another kind, or holds anything but tensors.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            values = _read(archive)
    except EdgeVprError:
        raise
    except OSError as error:
        raise WeightsError(
            f"{path} cannot be read: {error.strerror or error}: check the path"
        ) from error
    except MemoryError as error:
        raise WeightsError(f"{path} needs more memory than there is: give it more") from error
    except Exception as error:  # zipfile and pickle raise what they come across
        raise WeightsError(
            f"{path} is damaged, or no state dict of PyTorch 1.6 or newer "
            f"({printable(error, 200)}): save it again with torch.save(model.state_dict(), ...)"
        ) from error
    if not isinstance(values, Mapping):
        raise WeightsError(
            f"{path} holds a {type(values).__name__} and no state dict: save it again with "
            "torch.save(model.state_dict(), ...)"
        )
    tensors = {str(name): v for name, v in values.items() if isinstance(v, np.ndarray)}
    if not tensors:
        raise WeightsError(f"{path} holds no tensors: save the state dict of a trained network")
    return tensors


def _read(archive: zipfile.ZipFile) -> Any:
    names = [name for name in archive.namelist() if name.endswith("/data.pkl")]
    if len(names) != 1:
        raise ValueError(f"{len(names)} files data.pkl")
    folder = names[0].removesuffix("data.pkl")
    order = "<"
    if f"{folder}byteorder" in archive.namelist():
        order = ">" if _member(archive, f"{folder}byteorder", 16) == b"big" else "<"
    text = _member(archive, names[0], _LONGEST_PICKLE)
    return _StateDict(io.BytesIO(text), archive, folder, order).load()


def _member(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """Return a member of at most so many bytes; PyTorch compresses none."""
    member = archive.getinfo(name)
    if member.file_size > most or member.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{name} of {member.file_size:,} bytes, or compressed")
    return archive.read(member)


class _StateDict(pickle.Unpickler):
    """An unpickler that knows ordered dictionaries, tensors and the kinds of their numbers."""

    def __init__(self, file: io.BytesIO, archive: zipfile.ZipFile, folder: str, order: str) -> None:
        super().__init__(file)
        self._archive, self._folder, self._order = archive, folder, order

    def find_class(self, module: str, name: str) -> Any:
        """Return what stands for a name; all others are refused."""
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if (module, name) == ("torch._utils", "_rebuild_parameter"):
            return _parameter
        if module == "torch" and name in _KINDS:
            return _Kind(_KINDS[name])
        raise ValueError(f"it names {module}.{name}, which no state dict needs")

    def persistent_load(self, pid: Any) -> npt.NDArray[Any]:
        """Return the numbers of a storage."""
        tag, kind, key, _, count = pid
        if tag != "storage" or not isinstance(kind, _Kind) or not isinstance(key, str):
            raise ValueError(f"a part of kind {tag!r}")
        dtype = np.dtype(self._order + kind.code)
        octets = _member(self._archive, f"{self._folder}data/{key}", _LARGEST)
        if type(count) is not int or len(octets) < count * dtype.itemsize:
            raise ValueError(f"{len(octets):,} bytes for {count} numbers of {dtype}")
        return np.frombuffer(octets, dtype, count)


def _tensor(storage: Any, offset: Any, shape: Any, strides: Any, *_: Any) -> npt.NDArray[Any]:
    """Return a tensor of a storage, as an own array in native byte order."""
    numbers = [offset, *shape, *strides]
    if (
        not isinstance(storage, np.ndarray)
        or any(type(number) is not int or number < 0 for number in numbers)
        or len(shape) != len(strides)
        or len(shape) > _MOST_DIMENSIONS
    ):
        raise ValueError(f"a tensor of shape {shape} and strides {strides}")
    size = math.prod(shape)
    last = offset + sum((n - 1) * step for n, step in zip(shape, strides, strict=True))
    # a stride of 0 would repeat a number without end
    if size and (last >= storage.size or size > storage.size):
        raise ValueError(f"a tensor of shape {shape} in {storage.size} numbers")
    if not size:
        return np.empty(shape, storage.dtype.newbyteorder("="))
    steps = [step * storage.itemsize for step in strides]
    view = np.lib.stride_tricks.as_strided(storage[offset:], shape, steps, writeable=False)
    return view.astype(storage.dtype.newbyteorder("="))


def _parameter(tensor: Any, *_: Any) -> Any:
    """Return the tensor of a parameter."""
    return tensor
