"""How kernels are compiled: without the interpreter's lock, and kept from run to run.

Numba keeps compiled code beside the sources until the kernel's own module changes. The code
however also contains the kernels that it calls and the constants that it uses, from other modules.
`kernel` therefore makes them a part of what Numba compares before it loads the code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numba import njit
from numba.core.dispatcher import Dispatcher

_CONSTANTS = (bool, int, float, tuple, np.dtype, np.integer, np.floating)


def kernel(
    function: Callable[..., Any] | None = None, *, inline: Literal["never", "always"] = "never"
) -> Any:
    """Compile a function when it is first called, and keep the code for later runs.

    Parameters
    ----------
    function : callable
    inline : {"never", "always"}
        "always": its code is copied into the kernels that call it.

    Returns
    -------
    callable
        The compiled function; the function itself where the compiler is off (NUMBA_DISABLE_JIT).
    """
    if function is None:
        return lambda given: kernel(given, inline=inline)
    compiled = njit(cache=True, nogil=True, inline=inline)(function)
    file = _cache_file(compiled)
    if file is not None:
        file._source_stamp = (file._source_stamp, _imported(function))
    return compiled


def entry(kernel: Callable[..., Any], *given: object) -> Callable[..., Any]:
    """Return the compiled code of a kernel for arguments of the types of these.

    A kernel finds the types of its arguments at each call, which takes 1 us for a box, and longer
    than the rest of a call when other work has used the caches. The code must never be called with
    arguments of other types.
    """
    if not isinstance(kernel, Dispatcher):
        return kernel
    code: Callable[..., Any] = kernel.compile(tuple(map(kernel.typeof_pyval, given)))
    return code


def _imported(function: Callable[..., Any]) -> str:
    """Return a digest of the kernels and constants that the function's module has so far.

    A kernel counts with the stamp of its source, which holds those that it calls in turn.
    """
    found: list[tuple[Any, ...]] = []
    for name, value in sorted(function.__globals__.items()):
        file = _cache_file(value)
        if file is not None:
            found.append((name, file._source_stamp))
        elif isinstance(value, type) and issubclass(value, tuple):
            found.append((name, getattr(value, "_fields", ())))
        elif isinstance(value, np.ndarray):
            found.append((name, value.dtype, value.shape, value.tobytes()))
        elif isinstance(value, _CONSTANTS):
            found.append((name, value))
    return hashlib.sha256(repr(found).encode()).hexdigest()


def _cache_file(value: object) -> Any:
    """Return Numba's record of where a kernel is kept; None for anything else."""
    return getattr(getattr(value, "_cache", None), "_cache_file", None)
