"""Checks of arrays and numbers from files, before they are used as indices or sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import MapError


def check_array(
    array: object, name: str, dtypes: Sequence[npt.DTypeLike], shape: tuple[int | None, ...]
) -> None:
    """Check that an array has one of these dtypes, native byte order, and this shape.

    Parameters
    ----------
    array : object
    name : str
        What the message calls it.
    dtypes : sequence of dtype
    shape : tuple of int or None
        None stands for any length.

    Raises
    ------
    MapError
        If it is something else.
    """
    wanted = f"{' or '.join(np.dtype(dtype).name for dtype in dtypes)} of shape {_shown(shape)}"
    if not isinstance(array, np.ndarray):
        raise MapError(f"{name} is a {type(array).__name__}: expected {wanted}")
    fits = len(array.shape) == len(shape) and all(
        length in (None, found) for length, found in zip(shape, array.shape, strict=True)
    )
    if not fits or all(array.dtype != np.dtype(dtype) for dtype in dtypes):
        raise MapError(f"{name} is {array.dtype} of shape {array.shape}: expected {wanted}")


def check_range(array: npt.NDArray[Any], name: str, least: int, most: int) -> None:
    """Raise MapError unless every value lies between `least` and `most`, both allowed."""
    if array.size and not (array.min() >= least and array.max() <= most):
        raise MapError(
            f"{name} holds {array.min()} to {array.max()}: expected values from {least} to {most}"
        )


def whole_number(values: Mapping[str, Any], name: str, least: int, most: int) -> int:
    """Read an integer from a header.

    Raises
    ------
    MapError
        If it is missing, of another type (a truth value is), or out of range.
    """
    value = values.get(name)
    if type(value) is not int or not least <= value <= most:
        raise MapError(f"{name} is {value!r}: expected a whole number from {least} to {most}")
    return value


def _shown(shape: tuple[int | None, ...]) -> str:
    lengths = ", ".join("n" if length is None else str(length) for length in shape)
    return f"({lengths},)" if len(shape) == 1 else f"({lengths})"
