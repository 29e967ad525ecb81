"""Count the instructions of an emulated processor, and its stack, by a compiled callback.

Unicorn's binding to Python calls a Python function for each instruction, at 10 us each. The same
few operations as machine code take 30 ns.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numba import carray, cfunc, types  # type: ignore[attr-defined]

from firmware_model.errors import ToolError

# of the array that callback and counter share
_INSTRUCTIONS, _LOWEST, _POINTER, _REGISTER = range(4)


class InstructionCounter:
    """Instructions that a processor executes, and how far its stack grows.

    The callback stays for good: code that was translated without it would not be counted.

    Parameters
    ----------
    uc : unicorn.Uc
    stack_pointer : int
        Unicorn's number of the register.

    Raises
    ------
    ToolError
        If Unicorn does not take the callback.
    """

    def __init__(self, uc: Any, stack_pointer: int) -> None:
        from unicorn import UC_HOOK_CODE
        from unicorn.unicorn_py3.unicorn import uclib

        self._shared = np.zeros(4, np.int64)
        self._shared[_REGISTER] = stack_pointer
        uc.ctl_flush_tb()
        handle = ctypes.c_size_t()
        # the binding's hook_add takes Python functions alone
        everywhere = 1, 0
        refused = uclib.uc_hook_add(
            uc._uch,
            ctypes.byref(handle),
            UC_HOOK_CODE,
            ctypes.c_void_p(_callback().address),
            ctypes.c_void_p(self._shared.ctypes.data),
            *everywhere,
        )
        if refused:
            raise ToolError(f"unicorn does not count instructions (error {refused}): reinstall it")

    def restart(self, stack_pointer: int) -> None:
        """Count from zero, and from this address of the stack downwards."""
        self._shared[_INSTRUCTIONS] = 0
        self._shared[_LOWEST] = stack_pointer

    @property
    def instructions(self) -> int:
        """Executed since `restart`."""
        return int(self._shared[_INSTRUCTIONS])

    @property
    def lowest(self) -> int:
        """Lowest stack pointer since `restart`, before an instruction."""
        return int(self._shared[_LOWEST])


@cache
def _callback() -> Any:
    from unicorn.unicorn_py3.unicorn import uclib

    prototype = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)
    read = prototype(ctypes.cast(uclib.uc_reg_read, ctypes.c_void_p).value or 0)
    counts = types.CPointer(types.int64)  # type: ignore[no-untyped-call]

    @cfunc(types.void(types.voidptr, types.uint64, types.uint32, counts))
    def step(uc: Any, _address: Any, _size: Any, shared: Any) -> None:
        state = carray(shared, 4)
        state[_INSTRUCTIONS] += 1
        # a register of 32 bits fills the lower half of the word, which is zero before
        pointer = state[_POINTER:]
        read(uc, np.int32(state[_REGISTER]), pointer.ctypes)
        state[_LOWEST] = min(state[_LOWEST], pointer[0])

    return step
