"""A tuple of arrays as one argument of a kernel, which Numba unpacks only once.

Numba unpacks a tuple of arrays at every call, in 0.2 to 0.3 us per array, which is longer than the
processing of an event. A tuple in a box is unpacked once, so that the time of a call does not
depend on its size.
"""

from __future__ import annotations

import copy
from typing import Any, Generic, TypeVar

from numba import config, types

from edge_vpr.compiling import kernel

if config.DISABLE_JIT:

    class Boxed:
        """Box without the compiler; the classes below are the same for compiled code."""

        def __init__(self, value: Any) -> None:
            self.value = value

    boxed = Boxed

else:
    from numba.experimental import structref

    @structref.register
    class BoxedType(types.StructRef):
        """Numba type of a box, which holds the type of its tuple."""

    class Boxed(structref.StructRefProxy):  # type: ignore[no-redef]
        """Box that compiled code holds by its address; only kernels may read `value`."""

        # the same without a call of Python, which Numba makes twice for each argument
        _numba_type_ = structref.StructRefProxy._type

    structref.define_proxy(Boxed, BoxedType, ["value"])

    @kernel  # type: ignore[no-redef]
    def boxed(value):
        """Put a tuple into a box, which keeps its arrays alive."""
        return Boxed(value)


Tuple = TypeVar("Tuple", bound=tuple[Any, ...])


class Box(Generic[Tuple]):
    """A tuple of arrays in two forms: for Python and for kernels.

    Both forms share the same arrays.

    Parameters
    ----------
    value : tuple
        Of arrays, numbers, and such tuples.

    Attributes
    ----------
    value : tuple
    boxed : Boxed
        What kernels take as an argument. Its `value` is of plain tuples, also where names were: a
        kernel gives them back, ``Followed(*box.value)``. A cache that knew the class by its name
        could not be read, nor thrown away, by a later version without that name.
    """

    __slots__ = ("boxed", "value")

    def __init__(self, value: Tuple) -> None:
        self.value = value
        self.boxed = boxed(_plain(value))

    def __deepcopy__(self, memo: dict[int, Any]) -> Box[Tuple]:
        """Copy the arrays, and box the copies."""
        return Box(copy.deepcopy(self.value, memo))


def _plain(value: Any) -> Any:
    return tuple(map(_plain, value)) if isinstance(value, tuple) else value
