"""Boards with open tools: top module, pins, and the commands for synthesis and placement."""

from __future__ import annotations

import shutil
from dataclasses import dataclass

from firmware_model.hardware import sources


@dataclass(frozen=True)
class Board:
    """Board, and the tools for it.

    Attributes
    ----------
    name, fpga : str
        Common names of the board and its FPGA.
    top : str
        Top module, in the file of the same name.
    pins : str
        Name of the file with its pins.
    synthesis : str
        Command of yosys, without its output.
    place : tuple of str
        Words of the place-and-route command, without design and output.
    placed : str
        Suffix of the place-and-route output.
    pack : str
        Program that makes the bitstream from this output.
    bitstream : str
        Suffix of the bitstream.
    resources : dict of str to str
        Kinds of cells: the name in tables, and the name in the log of place and route.
    megahertz : int
        Clock of the top module.
    """

    name: str
    fpga: str
    top: str
    pins: str
    synthesis: str
    place: tuple[str, ...]
    placed: str
    pack: str
    bitstream: str
    resources: dict[str, str]
    megahertz: int

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
