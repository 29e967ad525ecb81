"""Simulate the core with Icarus Verilog: replay a case of golden vectors, return its records."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from firmware_model.errors import ToolError, VectorError
from firmware_model.hardware import sources
from firmware_model.hardware.parameters import PACKAGE
from firmware_model.vectors.case import Record
from firmware_model.vectors.manifest import RTL_FOLDER, load_manifest
from firmware_model.vectors.verify import read_results

COMPILER, RUNTIME = "iverilog", "vvp"


class Replay(NamedTuple):
    """Results of a simulated core for one case.

    Attributes
    ----------
    records : list of (kind, values)
        In the form that `firmware_model.vectors.verify.verify` takes.
    least_cycles, most_cycles : int
        Clocks from the end of a window to its match; 0 if there was none.
    events_in_a_row : int
        Largest number of events that were taken in successive clocks.
    """

    records: list[Record]
    least_cycles: int
    most_cycles: int
    events_in_a_row: int


class Conditions(NamedTuple):
    """Conditions of a replay.

    Attributes
    ----------
    seed : int
        Seed of stalls and resets.
    stall : int
        Percentage of clocks in which each side waits.
    resets : int
        Number of resets, after each of which the case begins again.
    reset_at : int
        If not 0, there is one reset instead, of one clock, so many clocks after the first; the
        places stay.
    slow_blocks : bool
        Whether the core has registers for slow block memories, as on an ECP5.
    """

    seed: int = 1
    stall: int = 0
    resets: int = 0
    reset_at: int = 0
    slow_blocks: bool = False


UNDISTURBED = Conditions()


def available() -> bool:
    """Return whether Icarus Verilog is installed."""
    return all(shutil.which(tool) for tool in (COMPILER, RUNTIME))


def compile_bench(
    package: Path, program: Path, folder: Path = sources.FOLDER, *, slow_blocks: bool = False
) -> None:
    """Compile core and testbench for one design.

    Parameters
    ----------
    package : path
        Generated package of the design.
    program : path
        Program to be written.
    folder : path
        Folder of the core's sources.
    slow_blocks : bool
        Whether the core has registers for slow block memories, as on an ECP5.

    Raises
    ------
    ToolError
        If Icarus Verilog is not installed, or refuses the sources.
    """
    files = [folder / name for name in (*sources.DEVICE, sources.BENCH)]
    command = [COMPILER, "-g2012", "-Wall", "-Wno-timescale", "-s", "vpr_bench"]
    command.append(f"-Pvpr_bench.SLOW_BLOCKS={int(slow_blocks)}")
    _run([*command, "-o", str(program), str(package), *map(str, files)])


def replay(
    program: Path,
    case: Path,
    name: str,
    results: Path,
    conditions: Conditions = UNDISTURBED,
    *,
    seconds: int | None = None,
    trace: Path | None = None,
) -> Replay:
    """Replay a case of golden vectors.

    Parameters
    ----------
    program : path
        Program of `compile_bench` for the design of this case.
    case : path
        Folder of the case.
    name : str
        Suite and case, such as ``corners/tie_of_two``.
    results : path
        CSV file to be written.
    conditions : Conditions
        The program decides about `slow_blocks`.
    seconds : int, optional
        Processor seconds after which a simulation that has not ended is a fault.
    trace : path, optional
        VCD file of the testbench's signals to be written.

    Raises
    ------
    ToolError
        If Icarus Verilog is not installed, or the testbench ends with a fault.
    """
    arguments = {"case": name, "results": results.resolve(), **conditions._asdict()}
    del arguments["slow_blocks"]
    if trace is not None:
        arguments["trace"] = trace.resolve()
    words = [f"+{key}={value}" for key, value in arguments.items()]
    said = _run([RUNTIME, "-n", str(program.resolve()), *words], case, seconds)
    found = re.search(r"at most (\d+) in a row, cycles a match (\d+) to (\d+)", said)
    if found is None:
        raise ToolError(f"the testbench of {name} did not come to its end: {said.strip()}")
    in_a_row, least, most = map(int, found.groups())
    return Replay(read_results(results), least, most, in_a_row)


class Programs:
    """Simulations of the designs of some vectors, each of which is compiled once.

    Parameters
    ----------
    work : path
        Folder for the programs.
    rtl : path
        Folder of the core's sources.
    """

    def __init__(self, work: Path, rtl: Path) -> None:
        self._work, self._rtl = work, rtl
        self._known: dict[tuple[str, bool], Path] = {}

    def of(self, case: Path, *, slow_blocks: bool) -> Path:
        """Return the program for the design of a case; raises as `compile_bench`."""
        package = case / f"{PACKAGE}.sv"
        key = package.read_text(encoding="ascii"), slow_blocks
        if key not in self._known:
            self._known[key] = self._work / f"design_{len(self._known)}.vvp"
            compile_bench(package, self._known[key], self._rtl, slow_blocks=slow_blocks)
        return self._known[key]


def replay_vectors(
    vectors: Path,
    work: Path,
    conditions: Conditions = UNDISTURBED,
) -> Iterator[tuple[str, Replay]]:
    """Replay all cases of vectors that were made with ``rtl``, with the sources beside them.

    Parameters
    ----------
    vectors, work : path
        Folder of the vectors, and a folder for programs and results.
    conditions : Conditions
        Each case has its own random numbers.

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
    programs = Programs(work, vectors / RTL_FOLDER)
    for name, case in manifest.cases():
        program = programs.of(vectors / name, slow_blocks=conditions.slow_blocks)
        its_own = conditions._replace(seed=conditions.seed + case.number)
        yield name, replay(program, vectors / name, name, work / "results.csv", its_own)


def _run(command: Sequence[str], folder: Path | None = None, seconds: int | None = None) -> str:
    try:
        # processor time is limited, so that a busy computer does not cause a fault
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            cwd=folder,
            check=False,
            preexec_fn=None if seconds is None else partial(_limit, seconds),
        )
    except FileNotFoundError as error:
        raise ToolError(
            f"simulating the core needs {command[0]}, which is not installed: install Icarus "
            "Verilog, for example by apt install iverilog"
        ) from error
    if seconds is not None and done.returncode == -signal.SIGXCPU:
        raise ToolError(f"{command[0]} took more than {seconds} s of the processor")
    if done.returncode:
        raise ToolError(f"{command[0]}: {(done.stderr + done.stdout).strip()}")
    return done.stdout


def _limit(seconds: int) -> None:
    """Limit the processor time of the child process only."""
    import resource  # not available on Windows

    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
