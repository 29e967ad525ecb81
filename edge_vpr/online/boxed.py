"""Many arrays as one argument of a kernel.

Numba takes a tuple of arrays apart at every call, for 0.2 to 0.3 us an array: longer than an event
takes. A tuple in a box is taken apart once, and a call costs the same whatever is in it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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
        """Put a tuple of arrays and numbers into a box, which keeps the arrays alive.

        Parameters
        ----------
        value : tuple
            The arrays are shared: what one side writes, the other one reads.

        Returns
        -------
        Boxed
            Kernels take it as an argument, and read `value`.
        """
        return Boxed(value)
