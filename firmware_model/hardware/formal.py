"""Tools of the proofs: yosys, its yosys-smtbmc with the solver z3, and its model checker pdr."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from firmware_model.errors import ToolError
from firmware_model.hardware.sources import FOLDER

#: properties, and memories without contents
PROPERTIES = FOLDER / "formal"


def core_source(file: str) -> str:
    """Return the text of a source file of the core."""
    return (FOLDER / file).read_text(encoding="ascii")


def broken_source(file: str, old: str, new: str) -> str:
    """Return the text of a source file with one place replaced.

    Raises
    ------
    ToolError
        If the text that is replaced does not occur once.
    """
    text = core_source(file)
    if text.count(old) != 1:
        raise ToolError(f"{file} has {text.count(old)} times {old!r}: mend the proof's list")
    return text.replace(old, new)


def run_yosys(commands: Sequence[str], what: str, folder: Path | None = None) -> None:
    """Run commands of yosys, in a folder that has the tables which the sources read.

    Raises
    ------
    ToolError
        If yosys is missing, or refuses the sources of `what`.
    """
    done = _run(["yosys", "-q", "-p", "; ".join(commands)], 120, folder)
    if done.returncode:
        raise ToolError(f"yosys refuses the {what}: {(done.stderr + done.stdout).strip()}")


def solve(model: Path, options: Sequence[str], seconds: int) -> bool:
    """Return whether the assertions of an SMT2 model hold, by yosys-smtbmc and z3.

    Parameters
    ----------
    model : path
    options : sequence of str
        Of yosys-smtbmc: the number of clocks, and ``-i`` for induction.
    seconds : int
        After which the solver is ended.

    Raises
    ------
    ToolError
        If a tool is missing, or gives no answer in time.
    """
    done = _run(["yosys-smtbmc", "-s", "z3", *options, str(model)], seconds)
    if "Status: PASSED" in done.stdout:
        return True
    if "Status: FAILED" in done.stdout:
        return False
    raise ToolError(f"yosys-smtbmc gives no answer: {(done.stderr + done.stdout).strip()}")


def model_check(model: Path, seconds: int) -> bool:
    """Return whether the assertions of an AIGER model hold in every state that it reaches.

    By property directed reachability (pdr of yosys-abc), without a bound on the number of clocks;
    it finds its own invariant and checks it.

    Parameters
    ----------
    model : path
    seconds : int
        After which the model checker is ended.

    Raises
    ------
    ToolError
        As of `solve`.
    """
    done = _run(["yosys-abc", "-c", f"read_aiger {model}; fold; pdr"], seconds)
    if "Property proved." in done.stdout:
        return True
    if "was asserted in frame" in done.stdout:
        return False
    raise ToolError(f"yosys-abc gives no answer: {(done.stderr + done.stdout).strip()}")


def _run(
    command: Sequence[str], seconds: int, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
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
