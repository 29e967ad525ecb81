"""Simulate the core: replay a case of golden vectors, return its records.

By Icarus Verilog; or by Verilator, whose programs take seconds to build and some hundredths of the
time to run. Verilator knows no undefined values: registers and memories begin with random ones.
"""

from __future__ import annotations

import contextlib
import re
import resource
import signal
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from firmware_model.errors import ToolError, VectorError
from firmware_model.hardware import sources
from firmware_model.hardware.parameters import PACKAGE
from firmware_model.vectors.case import Record
from firmware_model.vectors.manifest import RTL_FOLDER, load_manifest
from firmware_model.vectors.verify import read_results

COMPILER, RUNTIME, BUILDER = "iverilog", "vvp", "verilator"
#: suffix of programs that `RUNTIME` runs
INTERPRETED = ".vvp"


class Replay(NamedTuple):
    """Results of a simulated core for one case."""

    records: list[Record]
    #: least_cycles, most_cycles: clocks from the end of a window to its match; 0 if there was none.
    least_cycles: int
    most_cycles: int
    events_in_a_row: int  #: Largest number of events that were taken in successive clocks.


class Conditions(NamedTuple):
    """Conditions of a replay."""

    seed: int = 1  #: Seed of stalls and resets.
    stall: int = 0  #: Percentage of clocks in which each side waits.
    resets: int = 0  #: Number of resets, after each of which the case begins again.
    #: If not 0, there is one reset instead, of one clock, so many clocks after the first; the
    #: places stay.
    reset_at: int = 0
    #: Whether the core has registers for slow block memories, as on an ECP5.
    slow_blocks: bool = False


UNDISTURBED = Conditions()


def compile_bench(
    package: Path, program: Path, folder: Path = sources.FOLDER, *, slow_blocks: bool = False
) -> None:
    """Compile core and testbench, with the package of one design, for Icarus Verilog.

    Raises
    ------
    ToolError
        If Icarus Verilog is not installed, or refuses the sources.
    """
    files = [folder / name for name in (*sources.DEVICE, sources.BENCH)]
    command = [COMPILER, "-g2012", "-Wall", "-Wno-timescale", "-s", "vpr_bench"]
    command.append(f"-Pvpr_bench.SLOW_BLOCKS={int(slow_blocks)}")
    _run([*command, "-o", str(program), str(package), *map(str, files)])


def build_bench(
    package: Path,
    folder: Path,
    sources_folder: Path,
) -> Path:
    """Build core and testbench for one design with Verilator; return the program.

    Parameters
    ----------
    folder : path
        New folder, for the program.

    Raises
    ------
    ToolError
        If Verilator is not installed, or refuses the sources.
    """
    files = [package, *(sources_folder / name for name in sources.SIMULATED)]
    _run(
        [
            BUILDER, "--cc", "--exe", "--main", "--timing", "-Wno-lint", "-Wno-fatal",
            "--x-assign", "unique", "--x-initial", "unique", "--top-module", "vpr_bench",
            "--Mdir", str(folder), *map(str, files),
        ]
    )  # fmt: skip
    program = folder / "Vvpr_bench"
    # most of the time goes to the compiler
    options = ("OPT_FAST=-O1", "OPT_SLOW=-O0", "OPT_GLOBAL=-O1", "VM_PARALLEL_BUILDS=0")
    _run(["make", "-C", str(folder), "-f", f"{program.name}.mk", program.name, *options])
    return program


def replay(
    program: Path,
    case: Path,
    name: str,
    results: Path,
    conditions: Conditions = UNDISTURBED,
) -> Replay:
    """Replay a case of golden vectors: see `run_bench`.

    Raises
    ------
    ToolError
        If Icarus Verilog is not installed, or the testbench ends with a fault.
    """
    said = run_bench(program, case, name, results, conditions)
    match = re.search(r"at most (\d+) in a row, cycles a match (\d+) to (\d+)", said)
    if match is None:
        raise ToolError(f"the testbench of {name} did not come to its end: {said.strip()}")
    in_a_row, least, most = map(int, match.groups())
    return Replay(read_results(results), least, most, in_a_row)


def run_bench(
    program: Path,
    case: Path,
    name: str,
    results: Path,
    conditions: Conditions,
    more: Sequence[str] = (),
    *,
    seconds: int | None = None,
) -> str:
    """Run a case of golden vectors, and return what the testbench prints.

    Parameters
    ----------
    program : path
        Program of `compile_bench` or `build_bench` for the design of this case.
    case : path
        Folder of the case.
    name : str
        Suite and case, such as ``corners/tie_of_two``.
    results : path
        CSV file to be written.
    conditions : Conditions
        The program decides about `slow_blocks`.
    more : sequence of str
        Further words for the program.
    seconds : int, optional
        Processor seconds after which a simulation that has not ended is a fault.
    """
    arguments = {"case": name, "results": results.resolve(), **conditions._asdict()}
    del arguments["slow_blocks"]
    words = [*(f"+{key}={value}" for key, value in arguments.items()), *more]
    runtime = [RUNTIME, "-n"] if program.suffix == INTERPRETED else []
    return _run([*runtime, str(program.resolve()), *words], case, seconds)


def replay_vectors(
    vectors: Path,
    work: Path,
    conditions: Conditions = UNDISTURBED,
) -> Iterator[tuple[str, Replay]]:
    """Replay all cases of vectors that were made with ``rtl``, with the sources beside them.

    Each design is compiled once, and each case has its own random numbers. Programs and results are
    written into `work`.

    Yields
    ------
    str, Replay
        Suite and case, and the results of the core.

    Raises
    ------
    VectorError
        If the vectors have no sources.
    ToolError
        Same as for `replay`.
    """
    manifest = load_manifest(vectors)
    if not manifest.rtl:
        raise VectorError(f"{vectors} has no hardware sources: make it by edge-vpr golden --rtl")
    rtl, slow_blocks = vectors / RTL_FOLDER, conditions.slow_blocks
    programs: dict[str, Path] = {}
    for name, case in manifest.cases():
        package = vectors / name / f"{PACKAGE}.sv"
        design = package.read_text(encoding="ascii")
        if design not in programs:
            programs[design] = work / f"design_{len(programs)}{INTERPRETED}"
            compile_bench(package, programs[design], rtl, slow_blocks=slow_blocks)
        its_own = conditions._replace(seed=conditions.seed + case.number)
        yield name, replay(programs[design], vectors / name, name, work / "results.csv", its_own)


def _run(command: Sequence[str], folder: Path | None = None, seconds: int | None = None) -> str:
    pipe = subprocess.PIPE
    try:
        with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, cwd=folder) as program:
            if seconds is not None:
                _limit(program.pid, seconds)
            out, errors = program.communicate()
    except FileNotFoundError as error:
        suite = "Icarus Verilog, for example by apt install iverilog"
        if command[0] not in (COMPILER, RUNTIME):
            suite = "Verilator, for example by apt install verilator make g++"
        raise ToolError(
            f"simulating the core needs {command[0]}, which is not installed: install {suite}"
        ) from error
    if seconds is not None and program.returncode == -signal.SIGXCPU:
        raise ToolError(f"{command[0]} took more than {seconds} s of the processor")
    if program.returncode:
        raise ToolError(f"{command[0]}: {(errors + out).strip()}")
    return out


def _limit(process: int, seconds: int) -> None:
    """Limit the processor time of a process, so that a busy computer does not cause a fault."""
    with contextlib.suppress(ProcessLookupError):  # it has ended
        resource.prlimit(process, resource.RLIMIT_CPU, (seconds, seconds + 1))
