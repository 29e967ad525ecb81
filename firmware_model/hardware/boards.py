"""Boards with open tools: the top of each, its pins, and how it is synthesized and placed."""

from __future__ import annotations

import shutil
from dataclasses import dataclass

from firmware_model.hardware import sources


@dataclass(frozen=True)
class Board:
    """A board, and the tools for it.

    Attributes
    ----------
    name, fpga : str
        As people write them.
    top : str
        Module, in the file of its name.
    pins : str
        File of its pins.
    synthesis : str
        Command of yosys, without its output.
    place : tuple of str
        Place and route, without design and output.
    placed : str
        Suffix of what it writes.
    pack : str
        Program that makes the bitstream of it.
    bitstream : str
        Suffix of the bitstream.
    resources : dict of str to str
        What a table calls a kind of cell, and its name in the log of place and route.
    megahertz : int
        Clock of the top.
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
        """Files beside those of the device."""
        return (*sources.SPI, f"{self.top}.sv")

    @property
    def placer(self) -> str:
        """Program that places and routes: from the system, or else of YoWASP."""
        program = self.place[0]
        return program if shutil.which(program) else f"yowasp-{program}"

    def place_words(self, pins: str) -> list[str]:
        """Words of place and route, with the file of the pins."""
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
