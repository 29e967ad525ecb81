"""Compile the reference firmware for this computer and for microcontrollers.

With Zig, which comes as a Python package (extra ``firmware``) and has everything that it needs for
all targets; for a Cortex-M4 also with the GCC that ``examples/firmware-m4`` is built with.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from firmware_model.errors import ToolError

SOURCES = Path(__file__).parents[1] / "c"
FIRMWARE = ("vpr.c", "replay.c")
OPTIMISATION = ("-O2", "-fomit-frame-pointer")
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wsign-conversion", "-pedantic", "-Werror")


@dataclass(frozen=True)
class Target:
    """A processor to compile for.

    Attributes
    ----------
    triple, cpu : str
        As Zig names them; empty for this computer. Of `GCC`, the prefix of its programs.
    sad : str
        How the distance is computed there.
    """

    name: str
    triple: str = ""
    cpu: str = ""
    sad: str = "portable"


HOST = Target("host")
EMULATED = (
    Target("cortex-m0plus", "thumb-freestanding-eabi", "cortex_m0plus"),
    Target("cortex-m4", "thumb-freestanding-eabi", "cortex_m4", "usada8"),
    Target("cortex-m7", "thumb-freestanding-eabi", "cortex_m7", "usada8"),
    Target("cortex-a53", "aarch64-freestanding", "cortex_a53", "NEON"),
    Target("cortex-a72", "aarch64-freestanding", "cortex_a72", "NEON"),
    Target("cortex-a76", "aarch64-freestanding", "cortex_a76", "NEON"),
)
#: compiled by arm-none-eabi-gcc
GCC = Target("cortex-m4-gcc", "arm-none-eabi", "cortex_m4", "usada8")
#: those whose instructions the tables have
COUNTED = (*EMULATED, GCC)


def build(
    target: Target,
    folder: str | Path,
    *,
    sources: Path = SOURCES,
    files: Sequence[str] = FIRMWARE,
    program: str = "replay_main.c",
    name: str = "firmware",
    options: Sequence[str] = (),
) -> Path:
    """Compile and link the firmware.

    Parameters
    ----------
    target : Target
        For the host, a program; for the others, an image of all functions.
    folder : path
        Where the result goes, and the compiler's cache unless ``ZIG_LOCAL_CACHE_DIR`` is set; made
        if absent.
    program : str
        C file with the program, which is added for the host.
    options : sequence of str
        Further ones for the compiler.

    Returns
    -------
    path
        ELF file.

    Raises
    ------
    ToolError
        If the compiler is not installed, or refuses the code; its message is part of the error.
    """
    command = _compiler(target)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    out = folder / f"{name}-{target.name}.elf"
    if target.triple:
        freestanding = ["-ffreestanding", "-fno-builtin", "-nostdlib", "-Wl,--no-gc-sections"]
        chosen = [*freestanding, "-Wl,--entry,0"]  # functions are called by address
        if target == GCC:
            chosen += [f"-mcpu={target.cpu.replace('_', '-')}", "-mthumb"]
        else:
            chosen += ["-target", target.triple, f"-mcpu={target.cpu}"]
    else:
        chosen, files = [], [*files, program]
    command += ["-std=c11", *OPTIMISATION, *WARNINGS, *chosen, *options]
    command += [str(sources / file) for file in files] + ["-o", str(out)]
    command += ["-lgcc"] * (target == GCC)
    environment = {"ZIG_LOCAL_CACHE_DIR": str(folder / "zig")} | os.environ
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        raise ToolError(f"the firmware does not compile for {target.name}: {done.stderr.strip()}")
    return out


def compiler(target: Target) -> str:
    """Name the compiler of a target, its version and its optimisation.

    Raises
    ------
    ToolError
        If it is not installed.
    """
    command = _compiler(target)
    if target == GCC:
        told = subprocess.run([*command, "-dumpfullversion"], capture_output=True, check=True)
        name = f"{command[0]} {told.stdout.decode('ascii').strip()}"
    else:
        name = f"ziglang {version('ziglang')}"
    return " ".join((name, *OPTIMISATION))


def _compiler(target: Target) -> list[str]:
    if target == GCC:
        program = f"{GCC.triple}-gcc"
        if shutil.which(program) is None:
            raise ToolError(f"{program} is not installed: apt install gcc-arm-none-eabi")
        return [program]
    if importlib.util.find_spec("ziglang") is None:
        raise ToolError(
            "compiling the firmware needs the library ziglang, which is not installed: run pip "
            "install 'edge-vpr[firmware]'"
        )
    return [sys.executable, "-m", "ziglang", "cc"]


def build_sanitized(folder: str | Path, files: Sequence[str], name: str) -> Path:
    """Compile a program for this computer under AddressSanitizer and UndefinedBehaviorSanitizer.

    Zig's compiler has no AddressSanitizer, so that the compiler of the system is used (gcc or
    clang, with its sanitizer libraries).

    One of the files has the program, which ends by SIGABRT at the first fault.

    Raises
    ------
    ToolError
        If no compiler of this computer has both sanitizers, or they refuse the code.
    """
    sanitizers = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
    refusals = []
    for compiler in filter(None, map(shutil.which, ("gcc", "clang", "cc"))):
        out = Path(folder) / name
        command = [compiler, "-std=c11", "-O1", *WARNINGS, *sanitizers]
        command += [str(SOURCES / file) for file in files] + ["-o", str(out)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return out
        refusals.append(f"{compiler}: {done.stderr.strip()}")
    raise ToolError(
        "no compiler with AddressSanitizer and UndefinedBehaviorSanitizer: install gcc, or clang "
        f"with its sanitizer libraries {refusals or ''}".rstrip()
    )
