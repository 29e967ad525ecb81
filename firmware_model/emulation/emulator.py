"""Run the compiled firmware on an emulated processor, and count its instructions."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numba import carray, cfunc, types  # type: ignore[attr-defined]

from firmware_model.emulation.build import Target
from firmware_model.errors import ToolError

# Instructions are counted by a compiled callback.
#
# Unicorn's binding to Python calls a Python function for each instruction, at 10 us each. The same
# few operations as machine code take 30 ns.
#
# Unicorn does not call it for an instruction of a Thumb-2 IT block whose condition is false, though
# a Cortex-M issues that one too and a debugger steps over it. So the callback counts a block, of
# one to four instructions, at its IT, and none until the block's end; only the last one may jump.


# of the array that callback and counter share
_INSTRUCTIONS, _LOWEST, _POINTER, _REGISTER, _THUMB, _BLOCK, _BLOCK_END, _READ, _SHARED = range(9)
_32_BITS = 0b11101 << 11  # of a halfword: the least that begins an instruction of 32 bits


class InstructionCounter:
    """Instructions that a processor issues, and how far its stack grows.

    The callback stays for good: code that was translated without it would not be counted.

    Parameters
    ----------
    stack_pointer : int
        Unicorn's number of the register.
    thumb : bool
        It executes Thumb, which has IT blocks.

    Raises
    ------
    ToolError
        If Unicorn does not take the callback.
    """

    def __init__(self, uc: Any, stack_pointer: int, thumb: bool) -> None:
        from unicorn import UC_HOOK_CODE
        from unicorn.unicorn_py3.unicorn import uclib

        self._shared = np.zeros(_SHARED, np.int64)
        self._shared[_REGISTER] = stack_pointer
        self._shared[_THUMB] = thumb
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
        self._shared[_BLOCK_END] = 0

    @property
    def instructions(self) -> int:
        """Issued since `restart`, with those whose condition was false."""
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
    memory = ctypes.CFUNCTYPE(
        ctypes.c_int, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_void_p, ctypes.c_size_t
    )
    fetch = memory(ctypes.cast(uclib.uc_mem_read, ctypes.c_void_p).value or 0)
    counts = types.CPointer(types.int64)  # type: ignore[no-untyped-call]

    @cfunc(types.void(types.voidptr, types.uint64, types.uint32, counts))
    def step(uc: Any, address: Any, size: Any, shared: Any) -> None:
        state = carray(shared, _SHARED)
        at = np.int64(address)
        if not state[_BLOCK] < at < state[_BLOCK_END]:
            state[_INSTRUCTIONS] += 1
        if state[_THUMB] and size == 2:
            halfword = state[_READ:]
            fetch(uc, address, halfword.ctypes, 2)
            mask = halfword[0] & 0xF
            if halfword[0] >> 8 == 0xBF and mask:
                end = at + 2
                # the lowest bit of the mask that is set ends the block
                while mask & 0xF:
                    fetch(uc, np.uint64(end), halfword.ctypes, 2)
                    end += 4 if halfword[0] >= _32_BITS else 2
                    state[_INSTRUCTIONS] += 1
                    mask <<= 1
                state[_BLOCK], state[_BLOCK_END] = at, end
        # a register of 32 bits fills the lower half of the word, which is zero before
        pointer = state[_POINTER:]
        read(uc, np.int32(state[_REGISTER]), pointer.ctypes)
        state[_LOWEST] = min(state[_LOWEST], pointer[0])

    return step


# Unicorn executes instructions, and knows no clock, caches or buses. The counts are exact, but they
# are instructions, not cycles.


# addresses of data, outside those of the firmware, in the regions that Cortex-M uses for memory and
# not for devices
_STACK = 0x2000_0000
_STACK_BYTES = 0x1_0000
_RETURN = 0x3000_0000
_HEAP = 0x6000_0000
_OUT = 0x9000_0000
_PAGE = 0x1_0000

#: largest number of words of results
OUT_WORDS = 1 << 22


class Emulator:
    """A processor with the firmware in its memory.

    Parameters
    ----------
    elf : path
        What `firmware_model.emulation.build.build` made for it.

    Attributes
    ----------
    symbols : dict of str to (address, bytes)
        Functions.
    code_bytes : int
        Functions and constants.
    instructions : int
        Issued by the last counted call, with those whose condition was false.
    stack : int
        Bytes of stack, the most that a counted call used.
    patience_s : float
        After which a call that has not returned is given up.

    Raises
    ------
    ToolError
        If the emulator is not installed.
    """

    def __init__(self, target: Target, elf: str | Path) -> None:
        try:
            import unicorn
            from elftools.elf.elffile import ELFFile
        except ImportError as error:
            raise ToolError(
                f"emulating a processor needs the library {error.name}, which is not installed: "
                "run pip install unicorn pyelftools"
            ) from error
        self.target = target
        self._wide = target.triple.startswith("aarch64")
        #: of the first arguments; the first of them has the result
        self._registers = [f"X{i}" for i in range(8)] if self._wide else [f"R{i}" for i in range(4)]
        self._uc: Any = _processor(unicorn, target)
        with Path(elf).open("rb") as file:
            parsed = ELFFile(file)
            for segment in parsed.iter_segments("PT_LOAD"):
                self._load(segment["p_vaddr"], segment["p_memsz"], segment.data())
            table: Any = parsed.get_section_by_name(".symtab")
            sections = (parsed.get_section_by_name(name) for name in (".text", ".rodata"))
            self.code_bytes = sum(section["sh_size"] for section in sections if section)
            self.symbols = {
                symbol.name: (symbol["st_value"], symbol["st_size"])
                for symbol in table.iter_symbols()
                if symbol["st_info"]["type"] == "STT_FUNC"
            }
        for start, size in ((_STACK, _STACK_BYTES), (_RETURN, _PAGE)):
            self._uc.mem_map(start, size)
        self._free = self._mapped = _HEAP
        self._written: int | None = None
        self.instructions = self.stack = 0
        self._counted: InstructionCounter | None = None
        self.patience_s = 120.0

    def _load(self, address: int, size: int, data: bytes) -> None:
        first, last = address & ~0xFFF, -(-(address + size) // 0x1000) * 0x1000
        mapped = [(low, high) for low, high, _ in self._uc.mem_regions()]
        for page in range(first, last, 0x1000):
            if not any(low <= page <= high for low, high in mapped):
                self._uc.mem_map(page, 0x1000)
        self._uc.mem_write(address, data)

    def flash(self, address: int, data: bytes) -> None:
        """Write data to a memory of its own, which `release` leaves as it is."""
        self._load(address, len(data), data)

    def put(self, data: bytes) -> int:
        """Copy data to new memory, aligned to 16 bytes; return its address."""
        address = self._free
        self._free += -(-max(len(data), 1) // 16) * 16
        if self._free > self._mapped:
            grown = -(-(self._free - self._mapped) // _PAGE) * _PAGE
            self._uc.mem_map(self._mapped, grown)
            self._mapped += grown
        self._uc.mem_write(address, data)
        return address

    def release(self) -> None:
        """Release all memory of `put`."""
        self._free = _HEAP

    def get(self, address: int, size: int) -> bytes:
        """Read memory."""
        return bytes(self._uc.mem_read(address, size))

    def call(self, function: str, *arguments: int, count: bool = False) -> int:
        """Call a C function of integer and pointer arguments.

        Parameters
        ----------
        count : bool
            Count `instructions` and `stack`. From the first counted call on, all calls are slower.

        Returns
        -------
        int
            Its result, 32 bits.

        Raises
        ------
        ToolError
            If there is no such function, or the processor faults.
        """
        import unicorn

        if function not in self.symbols:
            raise ToolError(f"the firmware has no function {function}")
        address = self.symbols[function][0]
        stack = self._pass(arguments)
        if count and self._counted is None:
            self._counted = InstructionCounter(self._uc, self._number("SP"), thumb=not self._wide)
        if self._counted is not None:
            self._counted.restart(stack)
        try:
            self._uc.emu_start(address, _RETURN, timeout=int(self.patience_s * 1e6))
        except unicorn.UcError as error:  # type: ignore[attr-defined]
            raise ToolError(f"{function} on {self.target.name}: {error}") from error
        if self._uc.reg_read(self._number("PC")) & ~1 != _RETURN:
            raise ToolError(
                f"{function} on {self.target.name} has not returned after {self.patience_s} s: it "
                "loops for ever, or patience_s is too little"
            )
        if count and self._counted is not None:
            self.instructions = self._counted.instructions
            self.stack = max(self.stack, stack - self._counted.lowest)
        return int(self._uc.reg_read(self._number(self._registers[0]))) & 0xFFFF_FFFF

    def _number(self, register: str) -> int:
        """Return Unicorn's number of a register."""
        from unicorn import arm64_const, arm_const

        if self._wide:
            return int(getattr(arm64_const, f"UC_ARM64_REG_{register}"))
        return int(getattr(arm_const, f"UC_ARM_REG_{register}"))

    def _pass(self, arguments: Sequence[int]) -> int:
        """Set registers and stack by the procedure call standard; return the stack pointer."""
        for register, value in zip(self._registers, arguments, strict=False):
            self._uc.reg_write(self._number(register), value)
        word = "Q" if self._wide else "I"
        rest = arguments[len(self._registers) :]
        spilled = struct.pack(f"<{len(rest)}{word}", *rest)
        stack = (_STACK + _STACK_BYTES - 256 - len(spilled)) & ~15
        self._uc.mem_write(stack, spilled)
        self._uc.reg_write(self._number("SP"), stack)
        # bit 0 of a return address keeps the Thumb state
        self._uc.reg_write(self._number("LR"), _RETURN if self._wide else _RETURN | 1)
        return stack

    def replay(
        self,
        image: bytes,
        events: bytes,
        start: int,
        ram_bytes: int,
        batch: int = 1,
        out_words: int = OUT_WORDS,
    ) -> bytes:
        """Run a case, as ``c/replay.c`` does.

        Parameters
        ----------
        image : bytes
            See `firmware_model.image.image`.
        events : bytes
            Eight each.
        start : int
            Time at which the first window opens.
        batch : int
            Events that are handed over at a time; their records are written only one by one.
        out_words : int
            Words of results, at most `OUT_WORDS`; if they do not suffice, the run ends as refused.

        Returns
        -------
        bytes
            Records of results.

        Raises
        ------
        ToolError
            If the firmware refuses the image, or faults.
        """
        self.release()
        # not zeros, to detect reads of memory that the firmware has not written
        ram = self.put(b"\xa5" * ram_bytes)
        image_at, events_at = self.put(image), self.put(events)
        stimulus = (image_at, len(image), events_at, len(events) // 8, batch, start)
        self._clear_results()
        words = self.call("vpr_replay", *stimulus, ram, ram_bytes, _OUT, out_words)
        self._written = words * 4 if words <= OUT_WORDS else None
        if words == 0:
            raise ToolError(
                f"the firmware on {self.target.name} refuses the image or the RAM, or has more "
                f"results than {out_words} words"
            )
        return self.get(_OUT, words * 4)

    def _clear_results(self) -> None:
        """Clear what the last replay has written: all, if it did not say how much."""
        if self._written is None:
            if any(low == _OUT for low, _, _ in self._uc.mem_regions()):
                self._uc.mem_unmap(_OUT, OUT_WORDS * 4)
            self._uc.mem_map(_OUT, OUT_WORDS * 4)
        else:
            self._uc.mem_write(_OUT, bytes(self._written))
        self._written = None


def _processor(unicorn: Any, target: Target) -> Any:
    from unicorn import arm64_const, arm_const

    if target.triple.startswith("aarch64"):
        uc = unicorn.Uc(unicorn.UC_ARCH_ARM64, unicorn.UC_MODE_ARM)
        models = {
            "cortex_a53": arm64_const.UC_CPU_ARM64_A53,
            "cortex_a72": arm64_const.UC_CPU_ARM64_A72,
            "cortex_a76": arm64_const.UC_CPU_ARM64_MAX,
        }
        uc.ctl_set_cpu_model(models[target.cpu])
        # vector registers are off after a reset
        uc.reg_write(arm64_const.UC_ARM64_REG_CPACR_EL1, 3 << 20)
        return uc
    uc = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    models = {
        "cortex_m0plus": arm_const.UC_CPU_ARM_CORTEX_M0,
        "cortex_m4": arm_const.UC_CPU_ARM_CORTEX_M4,
        "cortex_m7": arm_const.UC_CPU_ARM_CORTEX_M7,
    }
    uc.ctl_set_cpu_model(models[target.cpu])
    return uc
