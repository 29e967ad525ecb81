"""Sizes and widths of the core of a design, as a SystemVerilog package; the boards."""

from __future__ import annotations

import re
import shutil
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain

from firmware_model.design import FRACTION_BITS, Design
from firmware_model.errors import ToolError
from firmware_model.hardware import sources

#: name of the package, and of its file
PACKAGE = "vpr_pkg"
#: tables that the core reads from files, by their numbers; places are loaded at run time
TABLES = ("displacement", "lookup", "levels", "means", "place_activity", "limits", "place_bias")
#: bits of each cost in the table of step costs
COST_BITS = 7
#: places on each side of the best that may be told, of places at half windows
REACH = 4


def tables(design: Design) -> tuple[str, ...]:
    """Return those of `TABLES` that the core of a design has."""
    adaptive = {
        "levels": design.contrast, "means": design.contrast, "limits": design.contrast,
        "place_activity": design.filters, "place_bias": design.filters,
    }  # fmt: skip
    return tuple(name for name in TABLES if adaptive.get(name, True))


def constants(design: Design) -> dict[str, int]:
    """Return the constants of the package's first part, from which its second part follows."""
    numbers = {name.upper(): value for name, value in design.numbers.items()}
    del numbers["PLACES_PER_WINDOW"]
    return numbers | {
        "BY_TIME": int(design.window == "time"),
        "COUNT_MAX": design.count_max,
        "CONTRAST": int(design.contrast),
        "FILTER": int(design.filters),
        "STEPS": design.steps,
        # the first step of the first row in the lowest bits
        "STEP_COSTS": sum(
            cost << at * COST_BITS for at, cost in enumerate(chain(*design.step_costs))
        ),
        "RESTART": design.restart << FRACTION_BITS,
        "REACH": REACH if design.places_per_window == 2 else 0,
        "DESIGN_CRC": zlib.crc32(design.to_toml().encode("utf-8")),
    }


def package(design: Design) -> str:
    """Return the source text of the package of a design: ``vpr_pkg.sv`` with its constants."""
    return package_with(constants(design))


def package_with(values: Mapping[str, int]) -> str:
    """Return the source text of ``vpr_pkg.sv`` with other values of some of its constants.

    Parameters
    ----------
    values : mapping of str to int
        Values by name, also of what otherwise follows from the design.
    """
    text = sources.text_of(f"{PACKAGE}.sv")
    for name, value in values.items():
        pattern = rf"(localparam (int|bit|logic \[(\d+):0\])\s+{name}\s*=\s*)[^;]+;"
        match = re.search(pattern, text)
        if match is None:
            raise ToolError(f"{PACKAGE}.sv has no constant {name}: name one of its localparams")
        bits = int(match[3] or 0) + 1
        size = {"int": "", "bit": "1'd"}.get(match[2], f"{bits}'d")
        # tools read wide numbers in hexadecimal alone
        shown = f"{bits}'h{value:x}" if bits > 64 else f"{size}{value}"
        text = f"{text[: match.start()]}{match[1]}{shown};{text[match.end() :]}"
    return text


# Boards with open tools: top module, pins, and the commands for synthesis and placement.


@dataclass(frozen=True)
class Board:
    """Board, and the tools for it."""

    name: str
    fpga: str
    top: str  #: Top module, in the file of the same name.
    pins: str  #: Name of the file with its pins.
    synthesis: str  #: Command of yosys, without its output.
    place: tuple[str, ...]  #: Words of the place-and-route command, without design and output.
    placed: str  #: Suffix of the place-and-route output.
    pack: str  #: Program that makes the bitstream from this output.
    bitstream: str  #: Suffix of the bitstream.
    #: Kinds of cells: the name in tables, and the name in the log of place and route.
    resources: dict[str, str]
    megahertz: int  #: Clock of the top module.

    @property
    def sources(self) -> tuple[str, ...]:
        """Source files in addition to those of the device."""
        return (*sources.SPI, f"{self.top}.sv")

    @property
    def placer(self) -> str:
        """Program for place and route: that of the system, or else that of YoWASP."""
        program = self.place[0]
        return program if shutil.which(program) else f"yowasp-{program}"

    def place_words(self, pins: str) -> list[str]:
        """Return the words of the place-and-route command, with the file of the pins."""
        return [self.placer, *self.place[1:], pins, "--freq", str(self.megahertz)]


ICEBREAKER = Board(
    name="iCEBreaker",
    fpga="iCE40UP5K",
    top="vpr_up5k",
    pins="icebreaker.pcf",
    synthesis="synth_ice40 -top vpr_up5k -dsp -spram",
    place=("nextpnr-ice40", "--up5k", "--package", "sg48", "--pcf"),
    placed="asc",
    pack="icepack",
    bitstream="bin",
    resources={
        "logic cells": "ICESTORM_LC",
        "block memories": "ICESTORM_RAM",
        "SPRAM": "ICESTORM_SPRAM",
        "multipliers": "ICESTORM_DSP",
    },
    megahertz=48,
)
ULX3S = Board(
    name="ULX3S",
    fpga="ECP5-25F",
    top="vpr_ulx3s",
    pins="ulx3s.lpf",
    synthesis="synth_ecp5 -top vpr_ulx3s",
    place=("nextpnr-ecp5", "--25k", "--package", "CABGA381", "--lpf"),
    placed="config",
    pack="ecppack",
    bitstream="bit",
    resources={
        "logic cells": "TRELLIS_COMB",
        "block memories": "DP16KD",
        "multipliers": "MULT18X18D",
    },
    megahertz=100,
)
BOARDS = {board.name.lower(): board for board in (ICEBREAKER, ULX3S)}
