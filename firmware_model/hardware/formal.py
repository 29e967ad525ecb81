"""Tools of the proofs: yosys, its yosys-smtbmc with the solver z3, and its model checker pdr."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from firmware_model.errors import ToolError
from firmware_model.hardware.parameters import PACKAGE, package_with
from firmware_model.hardware.sources import FOLDER

#: folder of properties, and of memories without contents
PROPERTIES = FOLDER / "formal"


def core_source(file: str) -> str:
    """Return the text of a source file of the core."""
    return (FOLDER / file).read_text(encoding="ascii")


def broken_source(file: str, old: str, new: str) -> str:
    """Return the text of a source file with one part replaced.

    Raises
    ------
    ToolError
        If the part to be replaced does not occur exactly once.
    """
    text = core_source(file)
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
    done = _run(["yosys", "-q", "-p", "; ".join(commands)], 120, folder)
    if done.returncode:
        raise ToolError(f"yosys refuses the {what}: {(done.stderr + done.stdout).strip()}")


def solve(model: Path, options: Sequence[str], seconds: int) -> bool:
    """Return whether the assertions of an SMT2 model hold, with yosys-smtbmc and z3.

    Parameters
    ----------
    options : sequence of str
        Options of yosys-smtbmc: the number of clocks, and ``-i`` for induction.
    seconds : int
        Time limit of the solver in seconds.

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


#: proof without a bound; the same, if it gives no answer; and of the first `CLOCKS` clocks alone
CLOCKS = 120
UNBOUNDED, SIMPLIFIED = "fold; pdr", "fold; scorr; dc2; scorr; pdr"
BOUNDED = f"fold; strash; bmc3 -F {CLOCKS}"
#: number of the first clocks that a bounded proof is of
_FRAMES = re.compile(r"bmc3 -F (\d+)")


def bounded_to(method: str) -> int | None:
    """Return the number of the first clocks that a method is about; None if it has no bound."""
    found = _FRAMES.search(method)
    return int(found[1]) if found else None


def model_check(model: Path, seconds: int, method: str = UNBOUNDED) -> bool:
    """Return whether the assertions of an AIGER model hold in every state that it can reach.

    The usual method is property directed reachability (pdr of yosys-abc), without a bound on the
    number of clocks; it finds an invariant and checks it.

    Parameters
    ----------
    method : str
        Commands of yosys-abc: `UNBOUNDED`, `SIMPLIFIED`, or `BOUNDED`, after which the assertions
        hold in the states of the first `CLOCKS` clocks; or of as many as it says.
    seconds : int
        Time limit of the model checker in seconds.

    Raises
    ------
    ToolError
        Same as for `solve`.
    """
    done = _run(["yosys-abc", "-c", f"read_aiger {model}; {method}"], seconds)
    bound = bounded_to(method)
    held = bound is not None and f"asserted in {bound} frames" in done.stdout
    if "Property proved." in done.stdout or held:
        return True
    if "was asserted in frame" in done.stdout:
        return False
    raise ToolError(f"yosys-abc gives no answer: {(done.stderr + done.stdout).strip()}")


def write_package(folder: Path, constants: Mapping[str, int]) -> Path:
    """Write the package of sizes and widths, with the values of some constants, into a folder."""
    file = folder / f"{PACKAGE}.sv"
    file.write_text(package_with(constants), encoding="ascii")
    return file


def chparam(parameters: Mapping[str, int], module: str) -> str:
    """Return the command of yosys that sets parameters of a module; empty without parameters."""
    chosen = " ".join(f"-set {name} {value}" for name, value in parameters.items())
    return f"chparam {chosen} {module}" if chosen else ""


def translate(
    folder: Path,
    unit: str,
    source: str | None,
    constants: Mapping[str, int],
    exposed: Sequence[str],
    claimed: Mapping[str, int],
    beside: Sequence[str],
) -> Path:
    """Write the SMT2 model of a unit and its properties.

    Parameters
    ----------
    unit : str
        Name of the module, and of its file.
    source : str or None
        Text of that file; None for the original.
    constants, exposed, claimed, beside
        Same as of `firmware_model.verification.unit_proof.Unit`.
    """
    file, model = folder / f"{unit}.sv", folder / f"{unit}.smt2"
    file.write_text(core_source(file.name) if source is None else source, encoding="ascii")
    properties = f"{unit}_properties"
    # wires of an inner unit get names that ports can have
    package = write_package(folder, constants)
    files = [package, file, *(PROPERTIES / name for name in beside)]
    inner = [name for name in exposed if "." in name]
    outer = [name.rpartition(".")[2] for name in exposed]
    run_yosys(
        [
            f"read_verilog -formal -sv {' '.join(map(str, files))}",
            f"hierarchy -top {unit}; proc; flatten; cd {unit}",
            *(f"rename {name} {name.rpartition('.')[2]}" for name in inner),
            "cd",
            f"expose {' '.join(f'{unit}/w:{name}' for name in outer)}",
            f"read_verilog -formal -sv {PROPERTIES / f'{properties}.sv'}",
            chparam(claimed, properties),
            f"hierarchy -top {properties}; proc; flatten; opt_clean",
            f"write_smt2 -wires {model}",
        ],
        unit,
    )
    return model


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
