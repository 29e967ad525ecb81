"""Project for boards: sources, parameters, tables, pins, vectors, benches and a Makefile."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from pathlib import Path

from firmware_model.hardware import sources
from firmware_model.hardware.parameters import (
    BOARDS,
    PACKAGE,
    Board,
    constants,
    package,
    tables,
)
from firmware_model.memories import Memories
from firmware_model.vectors import formats
from firmware_model.vectors.suite import cases_within, memory_words, standard_suites, write_suites

_MAKEFILE = """\
# make BOARD: a board's bitstream, by yosys, nextpnr and its packer; boards: {boards}
# make test: the core returns the golden vectors, by Icarus Verilog and edge-vpr
# make cocotb: the same by a bench in Python (pip install cocotb) and Icarus Verilog
SOURCES = src/{package}.sv {sources}
TABLES = {tables}
YOSYS = yosys
PYTHON = python3
# folders of cases, such as vectors/corners/tie_of_two; by default all
CASES =

.PHONY: all test cocotb clean {boards}
all: {first}
{rules}
test:
\tpython -m firmware_model.hardware.replay vectors

cocotb:
	$(PYTHON) cocotb/{bench} $(CASES)

clean:
	rm -rf sim_build
\trm -f $(foreach end,json asc config bin bit,$(addsuffix .$(end),{boards}))
"""
_README = """\
# Hardware core of {pixels} pixels and {places} places, {lanes} lanes

    make {board}    a bitstream, by yosys, nextpnr and the packer; boards: {boards}
    make test          the core returns the golden vectors (Icarus Verilog and edge-vpr)
    make cocotb        the same by a bench in Python (pip install cocotb) and Icarus Verilog

- src: the core in SystemVerilog, its parameters, the systems of the boards, and benches
- *.mem: tables of the device; the places (places.mem) are loaded over SPI
- vpr_registers.h: registers on AXI4-Lite, for a program in C; DESIGN reads {crc:#010x}
- design.toml: the design; `edge-vpr estimate --design design.toml` tells what it costs
- vectors: {kept} cases of golden vectors, see vectors/README.md; `edge-vpr hardware --vectors` sets
  their size
"""
_RULES = """
{board}: {board}.{bitstream}

{board}.json: $(SOURCES) {sources} $(TABLES)
\t$(YOSYS) -q -p "read_verilog -sv $(SOURCES) {sources}; {synthesis} -json $@"

{board}.{placed}: {board}.json {pins}
\t{place} --json $< {output} $@

{board}.{bitstream}: {board}.{placed}
\t{pack} $< $@
"""


def _rules(board: Board, name: str) -> str:
    return _RULES.format(
        board=name,
        sources=" ".join(f"src/{source}" for source in board.sources),
        synthesis=board.synthesis,
        pins=board.pins,
        # the program of the system, on the computer on which the project is built
        place=" ".join((board.place[0], *board.place_words(board.pins)[1:])),
        output="--asc" if board.placed == "asc" else "--textcfg",
        placed=board.placed,
        pack=board.pack,
        bitstream=board.bitstream,
    )


def write_project(
    folder: Path,
    memories: Memories,
    seed: int,
    *,
    most_bytes: float = math.inf,
    on_case: Callable[[str], None] = lambda name: None,
) -> None:
    """Write a project for boards.

    Parameters
    ----------
    folder : path
        Empty folder.
    memories : Memories
        Tables of the device, and its places, which are loaded over SPI.
    seed : int
        Seed of the random vectors.
    most_bytes : float
        Size of the golden vectors, see `vectors.suite.cases_within`.
    on_case : callable, optional
        Called with the name of each case before it is computed.
    """
    design = memories.design
    text = package(design)
    beside = dict.fromkeys(name for board in BOARDS.values() for name in board.sources)
    benches = (sources.BENCH, sources.UP5K_BENCH, sources.AXI_BENCH)
    names = (*sources.DEVICE, *beside, sources.REGISTERS, sources.AXI, *benches)
    sources.copy_sources(folder / "src", names)
    (folder / "src" / f"{PACKAGE}.sv").write_text(text, encoding="ascii")
    (folder / "cocotb").mkdir()
    shutil.copyfile(sources.COCOTB_BENCH, folder / "cocotb" / sources.COCOTB_BENCH.name)
    shutil.copyfile(sources.FOLDER / sources.HEADER, folder / sources.HEADER)
    for board in BOARDS.values():
        shutil.copyfile(sources.FOLDER / board.pins, folder / board.pins)
    for name, words in memory_words(memories).items():
        (folder / f"{name}.mem").write_text(formats.readmemh(words), encoding="ascii")
    design.save(folder / "design.toml")
    makefile = _MAKEFILE.format(
        package=PACKAGE,
        bench=sources.COCOTB_BENCH.name,
        tables=" ".join(f"{name}.mem" for name in tables(design)),
        sources=" ".join(f"src/{name}" for name in sources.DEVICE),
        boards=" ".join(BOARDS),
        first=next(iter(BOARDS)),
        rules="".join(_rules(board, name) for name, board in BOARDS.items()),
    )
    (folder / "Makefile").write_text(makefile, encoding="ascii")
    suites = cases_within(standard_suites(design, seed), most_bytes)
    readme = _README.format(
        pixels=design.pixels, places=design.places, lanes=design.lanes, boards=" or ".join(BOARDS),
        board=next(iter(BOARDS)), crc=constants(design)["DESIGN_CRC"],
        kept=sum(map(len, suites.values())),
    )  # fmt: skip
    (folder / "README.md").write_text(readme, encoding="ascii")
    if suites:
        write_suites(folder / "vectors", design, suites, seed, rtl=True, on_case=on_case)
