"""Area and speed of the core on an iCE40UP5K: ``python -m firmware_model.hardware.report``.

By yosys and nextpnr-ice40 (``apt install yosys nextpnr-ice40``), of the whole board design with its
SPI slave, as a Markdown table.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from firmware_model.design import Design
from firmware_model.errors import DesignError, ToolError
from firmware_model.hardware import sources
from firmware_model.hardware.parameters import PACKAGE, package, tables
from firmware_model.memories import Memories
from firmware_model.vectors import formats
from firmware_model.vectors.memory_words import memory_words
from firmware_model.vectors.stimulus import choose_pixels

#: the design of the documented figures
DOCUMENTED = Design(
    width=346, height=260, pixels=150, places=860, length=5, lanes=8, code="log", code_bits=4
)
TARGET_MHZ = 48


class Netlist(NamedTuple):
    """What the board design takes of the device."""

    logic_cells: int
    block_memories: int
    large_memories: int
    multipliers: int


class Report(NamedTuple):
    """Area, and the highest clock frequency of each seed of place and route, in MHz."""

    netlist: Netlist
    megahertz: dict[int, float]
    tools: tuple[str, str]


def measure(design: Design, seeds: Sequence[int]) -> Report:
    """Synthesize, place and route the board design.

    Parameters
    ----------
    design : Design
    seeds : sequence of int
        Of place and route, at least one.

    Returns
    -------
    Report

    Raises
    ------
    ToolError
        If a tool is missing, or the design does not fit.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_tables(design, folder)
        files = " ".join(map(str, source_files(folder)))
        _run(
            ["yosys", "-q", "-p", f"read_verilog -sv {files}; {SYNTHESIS} -json core.json"], folder
        )
        logs = {seed: _place(folder, seed) for seed in seeds}
    utilisation = next(iter(logs.values()))
    netlist = Netlist(
        *(
            int(re.search(rf"ICESTORM_{kind}:\s*(\d+)/", utilisation)[1])  # type: ignore[index]
            for kind in ("LC", "RAM", "SPRAM", "DSP")
        )
    )
    return Report(
        netlist,
        {seed: float(_FREQUENCY.findall(log)[-1]) for seed, log in logs.items()},
        (_version("yosys", "-V"), _version("nextpnr-ice40", "--version")),
    )


SYNTHESIS = "synth_ice40 -top vpr_up5k -dsp -spram"
_FREQUENCY = re.compile(r"Max frequency for clock\s+'clk': ([\d.]+) MHz")


def source_files(folder: Path) -> list[Path]:
    """List all files of the board design, the package in `folder` first."""
    names = (*sources.DEVICE, *sources.UP5K)
    return [folder / f"{PACKAGE}.sv", *(sources.FOLDER / name for name in names)]


def write_tables(design: Design, folder: Path) -> None:
    """Write the package and the tables that synthesis reads, for pixels of no meaning."""
    blank = [[0] * design.slots] * design.places
    chosen = [slot % len(design.full_scales) for slot in range(design.slots)]
    words = memory_words(Memories(design, choose_pixels(design), blank, chosen))
    (folder / f"{PACKAGE}.sv").write_text(package(design), encoding="ascii")
    for name in tables(design):
        (folder / f"{name}.mem").write_text(formats.readmemh(words[name][1]), encoding="ascii")


def _place(folder: Path, seed: int) -> str:
    pins = sources.FOLDER / sources.UP5K_PINS
    command = ["nextpnr-ice40", "--up5k", "--package", "sg48", "--json", "core.json", "--pcf"]
    command += [str(pins), "--freq", str(TARGET_MHZ), "--seed", str(seed), "--timing-allow-fail"]
    return _run(command, folder).stderr


def _run(command: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    except FileNotFoundError as error:
        raise ToolError(
            f"the report needs {command[0]}, which is not installed: run apt install yosys "
            "nextpnr-ice40"
        ) from error
    if done.returncode:
        lines = (done.stderr + done.stdout).strip().splitlines()
        raise ToolError(f"{command[0]}: {lines[-1] if lines else 'failed without a message'}")
    return done


def _version(tool: str, flag: str) -> str:
    done = subprocess.run([tool, flag], capture_output=True, text=True, check=False)
    said = (done.stdout + done.stderr).strip()
    found = re.search(r"(?:Yosys|Version) ([\w.+~-]+)", said)
    return f"{tool} {found[1].rstrip(')') if found else said}"


def to_markdown(design: Design, report: Report) -> str:
    """Write a report as Markdown."""
    worst, best = min(report.megahertz.values()), max(report.megahertz.values())
    net = report.netlist
    return "\n".join(
        [
            f"J = {design.pixels}, K = {design.places}, L = {design.length}, {design.lanes} lanes,"
            f" codes of {design.code_bits} bits, with the SPI slave, by "
            f"{' and '.join(report.tools)}:",
            "",
            "| logic cells | block memories | SPRAM | DSP | MHz, worst and best of "
            f"{len(report.megahertz)} seeds |",
            "| --- | --- | --- | --- | --- |",
            f"| {net.logic_cells:,} of 5,280 | {net.block_memories} of 30 | "
            f"{net.large_memories} of 4 | {net.multipliers} of 8 | {worst:.1f} to {best:.1f} |",
        ]
    )


def main(words: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    words : sequence of str, optional
        The command line.

    Returns
    -------
    int
        1 if a tool fails, or some seed misses the board's 48 MHz.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--design", metavar="FILE.toml", help="in place of the documented one")
    parser.add_argument("--seeds", type=int, default=8, metavar="N", help="of place and route")
    args = parser.parse_args(words)
    try:
        design = DOCUMENTED if args.design is None else Design.load(args.design)
        report = measure(design, range(1, max(1, args.seeds) + 1))
    except (DesignError, ToolError) as error:
        print(error, file=sys.stderr)
        return 1
    print(to_markdown(design, report))
    return int(min(report.megahertz.values()) < TARGET_MHZ)


if __name__ == "__main__":
    sys.exit(main())
