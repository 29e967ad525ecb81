"""Prove what the core must do: ``python -m firmware_model.verification.proof``.

The files of ``rtl/formal`` state what must hold at the ports of a unit. Yosys and the model
checkers of its yosys-abc (``apt install yosys``) prove it for any number of clocks: of the search,
with its delay line, and of the prediction.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from firmware_model.errors import ToolError
from firmware_model.hardware.parameters import PACKAGE, package_with
from firmware_model.hardware.sources import FOLDER, text_of

#: commands of yosys-abc that prove a claim for any number of clocks; the same where these give no
#: answer. Property directed reachability (pdr) finds an invariant and checks it
UNBOUNDED, SIMPLIFIED = "fold; pdr", "fold; scorr; dc2; scorr; pdr"
#: time limits of yosys and of the model checker
_YOSYS_SECONDS, _SECONDS = 120, 3600


@dataclass(frozen=True)
class Claim:
    """Assertions of a file of properties in ``rtl/formal``, about units with some parameters."""

    name: str  #: The claim as a sentence.
    top: str  #: Module of the properties.
    files: tuple[str, ...]  #: Source files of the units, in the folder ``rtl``.
    #: Of the package of sizes and widths.
    constants: Mapping[str, int] = field(default_factory=dict)
    #: Parameters of `top`.
    parameters: Mapping[str, int] = field(default_factory=dict)
    #: Registers of the unit in the last file that `top` sees through ports.
    exposed: tuple[str, ...] = ()
    method: str = UNBOUNDED  #: `UNBOUNDED` or `SIMPLIFIED`.


_REGISTERS_OF_SEARCH = (
    *("delay.delayed_q", "filled_q", "behind_q", "has_left_q", "left_q", "left_sum_q", "update_q"),
    *("becomes_q", "sum_equal_q", "becomes_second_q", "nearer_q", "oldest_place_q"),
)


def search(exclusion: int, sum_bits: int, place_bits: int, *, invariant: bool = True) -> Claim:
    """Return the claim that the search of one size finds the best and the second best.

    `invariant` adds assertions about its registers, with which pdr finds an invariant sooner.
    """
    return Claim(
        f"best and second best, exclusion {exclusion}, sums of {sum_bits} bits, "
        f"{1 << place_bits} places",
        "vpr_search_properties",
        ("formal/vpr_shift_delay.sv", "vpr_search.sv"),
        constants={"EXCLUSION": exclusion, "SUM_BITS": sum_bits, "PLACE_BITS": place_bits},
        parameters={"INVARIANT": int(invariant)},
        exposed=_REGISTERS_OF_SEARCH,
        method=SIMPLIFIED,
    )


#: the smallest search, by its outputs alone
SMALL_SEARCH = search(1, 2, 3, invariant=False)
#: with steps of 0, 1 and 2 places of any costs
PREDICTION = Claim(
    "each prediction is the cost of the cheapest path, and at most that of a restart",
    "vpr_prediction_properties",
    ("vpr_prediction.sv",),
    constants={"STEPS": 3, "COST_BITS": 4, "RESTART": 9, "METRIC_BITS": 4},
    exposed=("entries_q",),
)  # fmt: skip
#: which the proof of the search takes for granted
DELAY = Claim(
    "a delay line returns each word so many pushes later",
    "vpr_delay_properties",
    ("vpr_ram.sv", "vpr_delay.sv"),
)


CLAIMS = (
    SMALL_SEARCH,
    *(search(*size) for size in ((0, 4, 4), (1, 3, 3), (2, 3, 4), (3, 4, 4))),
    PREDICTION,
    DELAY,
)


def holds(claim: Claim, changed: Mapping[str, str] | None = None) -> bool:
    """Return whether a claim holds, for any number of clocks.

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
            text = (changed or {}).get(file) or text_of(file)
            files.append(folder / Path(file).name)
            files[-1].write_text(text, encoding="ascii")
        parameters = [f"-set {name} {value}" for name, value in claim.parameters.items()]
        run_yosys(
            [
                f"read_verilog -formal -sv {' '.join(map(str, files))}",
                *(_exposing(files[-1].stem, claim.exposed) if claim.exposed else ()),
                f"read_verilog -formal -sv {FOLDER / 'formal' / claim.top}.sv",
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
        done = _run(["yosys-abc", "-c", f"read_aiger {model}; {claim.method}"], _SECONDS)
    if "Property proved." in done.stdout:
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


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return 1 if a claim is not proved, or has no answer."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--only", metavar="TEXT", default="", help="claims whose name has this text alone"
    )
    args = parser.parse_args(words)
    failures = 0
    for claim in CLAIMS:
        if args.only not in claim.name:
            continue
        begun = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        try:
            said = "proved" if holds(claim) else "NOT PROVED"
        except ToolError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                print(error, file=sys.stderr)
                return 1
            said = f"NO ANSWER, {error}"
        failures += said != "proved"
        took = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - begun
        print(f"{claim.name}: {said}, {took:.0f} s", flush=True)
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
