"""Compile the reference firmware for this computer and for microcontrollers with Zig.

Zig comes as a Python package (extra ``firmware``), with everything that it needs for all targets.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
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
        As Zig names them; empty for this computer.
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
        If Zig is not installed, or refuses the code; its message is part of the error.
    """
    if importlib.util.find_spec("ziglang") is None:
        raise ToolError(
            "compiling the firmware needs the library ziglang, which is not installed: run pip "
            "install 'edge-vpr[firmware]'"
        )
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    out = folder / f"{name}-{target.name}.elf"
    if target.triple:
        freestanding = ["-ffreestanding", "-fno-builtin", "-nostdlib", "-Wl,--no-gc-sections"]
        chosen = ["-target", target.triple, f"-mcpu={target.cpu}", *freestanding]
        chosen.append("-Wl,--entry,0")  # no entry point: functions are called by address
    else:
        chosen, files = [], [*files, program]
    command = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-std=c11",
        *OPTIMISATION,
        *WARNINGS,
        *chosen,
        *options,
    ]
    command += [str(sources / file) for file in files] + ["-o", str(out)]
    environment = {"ZIG_LOCAL_CACHE_DIR": str(folder / "zig")} | os.environ
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        raise ToolError(f"the firmware does not compile for {target.name}: {done.stderr.strip()}")
    return out


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
