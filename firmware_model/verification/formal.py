"""What proofs share: sources and their broken versions, and the programs of yosys."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from firmware_model.errors import ToolError
from firmware_model.hardware.parameters import PACKAGE, package_with
from firmware_model.hardware.sources import FOLDER, text_of

#: folder of properties, and of memories without contents
PROPERTIES = FOLDER / "formal"


def broken_source(file: str, old: str, new: str) -> str:
    """Return the text of a source file with one part replaced.

    Raises
    ------
    ToolError
        If the part to be replaced does not occur exactly once.
    """
    text = text_of(file)
    if text.count(old) != 1:
        raise ToolError(f"{file} has {text.count(old)} times {old!r}: mend the proof's list")
    return text.replace(old, new)


def run_yosys(commands: Sequence[str], what: str, folder: Path | None = None) -> None:
    """Run commands of yosys, in a folder with the tables that the sources read.

    Raises
    ------
    ToolError
        If yosys is missing, or refuses the sources of `what`.
    """
    done = run(["yosys", "-q", "-p", "; ".join(commands)], 120, folder)
    if done.returncode:
        raise ToolError(f"yosys refuses the {what}: {(done.stderr + done.stdout).strip()}")


def write_package(folder: Path, constants: Mapping[str, int]) -> Path:
    """Write the package of sizes and widths, with the values of some constants, into a folder."""
    file = folder / f"{PACKAGE}.sv"
    file.write_text(package_with(constants), encoding="ascii")
    return file


def chparam(parameters: Mapping[str, int], module: str) -> str:
    """Return the command of yosys that sets parameters of a module; empty without parameters."""
    chosen = " ".join(f"-set {name} {value}" for name, value in parameters.items())
    return f"chparam {chosen} {module}" if chosen else ""


def run(
    command: Sequence[str], seconds: int, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program of the proofs.

    Raises
    ------
    ToolError
        If it is missing, or takes more seconds.
    """
    try:
        return subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=seconds, check=False
        )
    except FileNotFoundError as error:
        raise ToolError(
            f"the proof needs {command[0]}, which is not installed: install yosys and z3"
        ) from error
    except subprocess.TimeoutExpired as error:
        raise ToolError(f"{command[0]} took more than {seconds} s") from error
