"""How a claim about the core is proved: by yosys, and the model checker pdr of its yosys-abc."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from firmware_model.errors import ToolError
from firmware_model.hardware.parameters import PACKAGE, package_with
from firmware_model.hardware.sources import FOLDER, text_of

#: commands of yosys-abc that prove a claim for any number of clocks; the same where these give no
#: answer
UNBOUNDED, SIMPLIFIED = "fold; pdr", "fold; scorr; dc2; scorr; pdr"
#: time limits of yosys and of the model checker
_YOSYS_SECONDS, _SECONDS = 120, 3600


@dataclass(frozen=True)
class Claim:
    """Assertions of a file of properties in ``rtl/formal``, about units with some parameters."""

    name: str  #: The claim as a sentence.
    top: str  #: Module of the properties.
    files: tuple[str, ...]  #: Source files of the units, in the folder ``rtl``.
    define: str = "PROVE_UNIT"  #: Define of the assertions that are proved.
    #: Of the package of sizes and widths.
    constants: Mapping[str, int] = field(default_factory=dict)
    #: Parameters of `top`.
    parameters: Mapping[str, int] = field(default_factory=dict)
    #: Registers of the unit in the last file that `top` sees through ports.
    exposed: tuple[str, ...] = ()
    method: str = UNBOUNDED  #: `UNBOUNDED` or `SIMPLIFIED`.
    #: Number of the first clocks that it is about; None if it is about all.
    bound: int | None = None


def holds(claim: Claim, changed: Mapping[str, str] | None = None) -> bool:
    """Return whether a claim holds: for any number of clocks, unless it is of the first alone.

    Parameters
    ----------
    changed : mapping of str to str, optional
        Text of changed source files, by name.

    Raises
    ------
    ToolError
        If a tool is missing, refuses the source, or gives no answer in time.
    """
    with tempfile.TemporaryDirectory() as name:
        folder, model = Path(name), Path(name) / "model.aig"
        files = [folder / f"{PACKAGE}.sv"]
        files[0].write_text(package_with(claim.constants), encoding="ascii")
        for file in claim.files:
            text = text_of(file) if changed is None or file not in changed else changed[file]
            if file == "vpr_core.sv":
                inside = text_of("formal/vpr_core_inside.sv")
                text = text.replace("endmodule", f"{inside}endmodule")
            files.append(folder / Path(file).name)
            files[-1].write_text(text, encoding="ascii")
        parameters = [f"-set {name} {value}" for name, value in claim.parameters.items()]
        run_yosys(
            [
                f"read_verilog -formal -sv -D{claim.define} {' '.join(map(str, files))}",
                *(_exposing(files[-1].stem, claim.exposed) if claim.exposed else ()),
                f"read_verilog -formal -sv -D{claim.define} {FOLDER / 'formal' / claim.top}.sv",
                f"chparam {' '.join(parameters)} {claim.top}" if parameters else "",
                f"hierarchy -check -top {claim.top}",
                "proc; flatten; memory_map; opt -fast; async2sync; dffunmap; opt_clean",
                "formalff -clk2ff; setundef -anyseq -undriven",
                "opt -fast; techmap; opt -fast; abc -g AND -fast; opt_clean",
                # registers without an initial value begin with any value
                f"write_aiger -zinit -I -B {model}",
            ],
            claim.top,
        )
        # property directed reachability (pdr) finds an invariant and checks it
        bounded = f"fold; strash; bmc3 -F {claim.bound}"
        method = claim.method if claim.bound is None else bounded
        done = _run(["yosys-abc", "-c", f"read_aiger {model}; {method}"], _SECONDS)
    if "Property proved." in done.stdout or f"asserted in {claim.bound} frames" in done.stdout:
        return True
    if "was asserted in frame" in done.stdout:
        return False
    raise ToolError(f"yosys-abc gives no answer: {(done.stderr + done.stdout).strip()}")


def _exposing(unit: str, registers: Sequence[str]) -> list[str]:
    """Return the commands of yosys that make registers of a unit ports of it."""
    # those of an inner unit get names that ports can have
    ports = [register.rpartition(".")[2] for register in registers]
    renamed = [(old, new) for old, new in zip(registers, ports, strict=True) if old != new]
    return [
        f"hierarchy -top {unit}; proc; flatten; cd {unit}",
        *(f"rename {old} {new}" for old, new in renamed),
        f"cd; expose {' '.join(f'{unit}/w:{port}' for port in ports)}",
    ]


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
    done = _run(["yosys", "-q", "-p", "; ".join(commands)], _YOSYS_SECONDS, folder)
    if done.returncode:
        raise ToolError(f"yosys refuses the {what}: {(done.stderr + done.stdout).strip()}")


def _run(
    command: Sequence[str], seconds: int, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=seconds, check=False
        )
    except FileNotFoundError as error:
        raise ToolError(
            f"the proof needs {command[0]}, which is not installed: install yosys"
        ) from error
    except subprocess.TimeoutExpired as error:
        raise ToolError(f"{command[0]} took more than {seconds} s") from error
