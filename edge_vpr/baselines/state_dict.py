"""Weights that PyTorch saved (``torch.save`` of a state dict), read without PyTorch.

Such a file is a ZIP with a pickle, and pickles can run code. No unpickler is used here: this module
executes only the few instructions and names that a state dict needs. Keys must be strings (tuples
within tuples would take extremely long to hash).
"""

from __future__ import annotations

import math
import pickletools
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import EdgeVprError, WeightsError, printable

#: most bytes of the pickle, which holds only names and shapes, and of one tensor's numbers
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


_ORDERED = ("collections", "OrderedDict")
_TENSOR = ("torch._utils", "_rebuild_tensor_v2")
_PARAMETER = ("torch._utils", "_rebuild_parameter")


class _Name(NamedTuple):
    """Class or function that the pickle names."""

    module: str
    name: str


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
        If the file is missing, damaged or of another kind, or holds anything other than tensors.
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
    except Exception as error:  # zipfile and pickle raise exceptions of many kinds
        raise WeightsError(
            f"{path} is damaged, or no state dict of PyTorch 1.6 or newer "
            f"({printable(error, 200)}): save it again with torch.save(model.state_dict(), ...)"
        ) from error
    if not isinstance(values, dict):
        raise WeightsError(
            f"{path} holds a {type(values).__name__} and no state dict: save it again with "
            "torch.save(model.state_dict(), ...)"
        )
    tensors = {name: v for name, v in values.items() if isinstance(v, np.ndarray)}
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

    def storage(kind: str, key: str, count: int) -> npt.NDArray[Any]:
        dtype = np.dtype(order + kind)
        octets = _member(archive, f"{folder}data/{key}", _LARGEST)
        if not 0 <= count * dtype.itemsize <= len(octets):
            raise ValueError(f"{len(octets):,} bytes for {count} numbers of {dtype}")
        return np.frombuffer(octets, dtype, count)

    return _Machine(storage).run(text)


def _member(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """Return a member of at most `most` bytes; PyTorch compresses no member."""
    member = archive.getinfo(name)
    if member.file_size > most or member.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{name} of {member.file_size:,} bytes, or compressed")
    return archive.read(member)


class _Machine:
    """Stack on which a pickle builds its objects.

    Parameters
    ----------
    storage : callable
        Function that maps ``(kind, key, count)`` to the numbers of a storage.
    """

    def __init__(self, storage: Callable[[str, str, int], npt.NDArray[Any]]) -> None:
        self._storage = storage
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}

    def run(self, text: bytes) -> Any:
        """Execute the instructions, and return the object that they build."""
        for operation, argument, _ in pickletools.genops(text):
            self._step(operation.name, argument)
        return self._stack[-1]

    def _step(self, name: str, argument: Any) -> None:
        stack = self._stack
        if name in ("PROTO", "FRAME", "STOP"):
            return
        if name in _LITERALS:
            stack.append(argument)
        elif name in _FIXED:
            stack.append(_FIXED[name])
        elif name == "EMPTY_DICT":
            stack.append({})
        elif name == "MARK":
            self._marks.append(len(stack))
        elif name == "TUPLE":
            stack.append(tuple(self._marked()))
        elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
            stack.append(tuple(self._popped(int(name[-1]))))
        elif name in ("BINPUT", "LONG_BINPUT"):
            self._memo[argument] = stack[-1]
        elif name == "MEMOIZE":
            self._memo[len(self._memo)] = stack[-1]
        elif name in ("BINGET", "LONG_BINGET"):
            stack.append(self._memo[argument])
        elif name == "GLOBAL":
            stack.append(_known(*argument.split(" ", 1)))
        elif name == "STACK_GLOBAL":
            stack.append(_known(*self._popped(2)))
        elif name == "BINPERSID":
            stack.append(self._persistent(stack.pop()))
        elif name == "REDUCE":
            function, arguments = self._popped(2)
            stack.append(_called(function, arguments))
        elif name == "BUILD":  # attributes of the dictionary, such as versions of layers
            stack.pop()
        elif name in ("SETITEM", "SETITEMS"):
            self._set(self._popped(2) if name == "SETITEM" else self._marked())
        else:
            raise ValueError(f"it has the instruction {name}, which no state dict needs")

    def _popped(self, count: int) -> list[Any]:
        """Remove the last values from the stack, and return them."""
        if len(self._stack) < count:
            raise ValueError("it takes values that it has not built")
        taken = self._stack[-count:]
        del self._stack[-count:]
        return taken

    def _marked(self) -> list[Any]:
        """Remove the values since the last mark from the stack, and return them."""
        first = self._marks.pop()
        taken = self._stack[first:]
        del self._stack[first:]
        return taken

    def _set(self, pairs: list[Any]) -> None:
        target = self._stack[-1]
        keys = pairs[::2]
        if not isinstance(target, dict) or any(type(key) is not str for key in keys):
            raise ValueError("a key that is no text, or no dictionary to put it into")
        target.update(zip(keys, pairs[1::2], strict=True))

    def _persistent(self, parts: Any) -> npt.NDArray[Any]:
        """Return the numbers of a storage: ("storage", kind, key, device, count)."""
        if not isinstance(parts, tuple) or len(parts) != 5:
            raise ValueError("a part that is no storage")
        tag, kind, key, _, count = parts
        known = isinstance(kind, _Name) and kind.module == "torch" and kind.name in _KINDS
        if type(tag) is not str or tag != "storage" or not known:
            raise ValueError("a part that is no storage of a known kind")
        if type(key) is not str or type(count) is not int:
            raise ValueError("a storage without a name or a length")
        return self._storage(_KINDS[kind.name], key, count)


#: instructions that contain a value, and those that stand for one
_LITERALS = ("BINUNICODE", "SHORT_BINUNICODE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT")
_FIXED: dict[str, Any] = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}


def _known(module: Any, name: Any) -> _Name:
    """Return a name if a state dict may have it; raise an error if not."""
    if type(module) is not str or type(name) is not str:
        raise ValueError("a name that is no text")
    found = _Name(module, name)
    if found not in (_ORDERED, _TENSOR, _PARAMETER) and not (module == "torch" and name in _KINDS):
        raise ValueError(f"it names {module}.{name}, which no state dict needs")
    return found


def _called(function: Any, arguments: Any) -> Any:
    """Return the object that a call of `function` would make."""
    if isinstance(function, _Name) and isinstance(arguments, tuple):
        if function == _ORDERED and not arguments:
            return {}
        if function == _TENSOR and len(arguments) >= 4:
            return _tensor(*arguments[:4])
        if function == _PARAMETER and arguments and isinstance(arguments[0], np.ndarray):
            return arguments[0]
    raise ValueError("a call of what is no function, or with other arguments")


def _tensor(storage: Any, offset: Any, shape: Any, strides: Any) -> npt.NDArray[Any]:
    """Return a tensor of a storage as an array of its own, in native byte order."""
    if (
        not (isinstance(storage, np.ndarray) and isinstance(shape, tuple))
        or not (isinstance(strides, tuple) and len(shape) == len(strides) <= _MOST_DIMENSIONS)
        or any(type(number) is not int for number in (offset, *shape, *strides))
    ):
        raise ValueError("a tensor without a storage, a shape or strides")
    if min((offset, *shape, *strides)) < 0:
        raise ValueError(f"a tensor of shape {shape} and strides {strides}")
    size = math.prod(shape)
    last = offset + sum((n - 1) * step for n, step in zip(shape, strides, strict=True))
    # a stride of 0 could repeat a number without limit
    if size and (last >= storage.size or size > storage.size):
        raise ValueError(f"a tensor of shape {shape} in {storage.size} numbers")
    if not size:
        return np.empty(shape, storage.dtype.newbyteorder("="))
    steps = [step * storage.itemsize for step in strides]
    view = np.lib.stride_tricks.as_strided(storage[offset:], shape, steps, writeable=False)
    return view.astype(storage.dtype.newbyteorder("="))
