"""A project for a board with an iCE40UP5K: sources, parameters, tables, vectors and a Makefile."""

from __future__ import annotations

from pathlib import Path

from firmware_model.hardware import sources
from firmware_model.hardware.parameters import PACKAGE, package, tables
from firmware_model.memories import Memories
from firmware_model.vectors import formats
from firmware_model.vectors.memory_words import memory_words
from firmware_model.vectors.suite import standard_suites, write_suites

_MAKEFILE = """\
# make: the bitstream of the board, by yosys, nextpnr-ice40 and icestorm
# make test: the core returns the golden vectors, by Icarus Verilog and edge-vpr
SOURCES = src/{package}.sv {sources}
TABLES = {tables}

.PHONY: all test clean
all: core.bin

core.json: $(SOURCES) $(TABLES)
\tyosys -q -p "read_verilog -sv $(SOURCES); synth_ice40 -top vpr_up5k -dsp -spram -json $@"

core.asc: core.json {pins}
\tnextpnr-ice40 --up5k --package sg48 --freq 48 --pcf {pins} --json $< --asc $@

core.bin: core.asc
\ticepack $< $@

test:
\tpython -m firmware_model.hardware.replay vectors

clean:
\trm -f core.json core.asc core.bin
"""


def write_project(folder: Path, memories: Memories, seed: int) -> None:
    """Write a project.

    Parameters
    ----------
    folder : path
        An empty folder.
    memories : Memories
        The device's tables, and its places, which are loaded over SPI.
    seed : int
        Of the random vectors.
    """
    design = memories.design
    names = (*sources.DEVICE, *sources.UP5K)
    sources.copy_sources(folder / "src", (*names, sources.BENCH, sources.UP5K_BENCH))
    (folder / "src" / f"{PACKAGE}.sv").write_text(package(design), encoding="ascii")
    pins = (sources.FOLDER / sources.UP5K_PINS).read_text(encoding="ascii")
    (folder / sources.UP5K_PINS).write_text(pins, encoding="ascii")
    for name, (_, words) in memory_words(memories).items():
        (folder / f"{name}.mem").write_text(formats.readmemh(words), encoding="ascii")
    design.save(folder / "design.toml")
    makefile = _MAKEFILE.format(
        package=PACKAGE,
        tables=" ".join(f"{name}.mem" for name in tables(design)),
        sources=" ".join(f"src/{name}" for name in names),
        pins=sources.UP5K_PINS,
    )
    (folder / "Makefile").write_text(makefile, encoding="ascii")
    write_suites(folder / "vectors", design, standard_suites(design, seed), seed, rtl=True)
