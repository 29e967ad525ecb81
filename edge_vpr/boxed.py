"""Many arrays as one argument of a kernel.

Numba takes a tuple of arrays apart at every call, for 0.2 to 0.3 us an array: longer than an event
takes. A tuple in a box is taken apart once, and a call costs the same whatever is in it.
"""

from __future__ import annotations

import copy
from typing import Any, Generic, NamedTuple, TypeVar

from numba import config, njit, types

if config.DISABLE_JIT:

    class Boxed(NamedTuple):
        """A box of plain Python; what follows below is its like for compiled code."""

        value: Any

    boxed = Boxed

else:
    from numba.experimental import structref

    @structref.register
    class BoxedType(types.StructRef):
        """What a kernel knows of a box: the type of its tuple."""

    class Boxed(structref.StructRefProxy):  # type: ignore[no-redef]
        """A box that compiled code holds by its address; `value` is for kernels alone."""

    structref.define_proxy(Boxed, BoxedType, ["value"])

    @njit(cache=True)  # type: ignore[no-redef]
    def boxed(value):
        """Put a plain tuple into a box that keeps its arrays alive."""
        return Boxed(value)


Tuple = TypeVar("Tuple", bound=tuple[Any, ...])


class Box(Generic[Tuple]):
    """A tuple of arrays as Python has it, and as kernels do.

    The arrays are shared: what one side writes, the other one reads.

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
