"""Parameters of the core from a design: all sizes and widths, as in the model; the boards."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass

from firmware_model.hardware import sources
from firmware_model.model.design import ACTIVITY_COSTS, FRACTION_BITS, Design, widths_of

# Parameters of the core from a design: all sizes and widths, as in the model.


#: name of the generated package, and of its file
PACKAGE = "vpr_design"
#: tables that the core reads from files; places are loaded at run time
_TABLES = ("displacement", "lookup", "codes", "code_tables")

#: quantities of every design whose widths are parameters
_WIDTHS = (
    "timestamp", "column", "row", "address", "owner", "slot", "count", "window_count", "table",
    "entry", "code", "distance", "sum", "product", "place",
)  # fmt: skip
#: quantities that a design with fixed codes and sequences does not have
_ADAPTIVE = (
    "window_events", "activity", "mean", "distance_total", "reciprocal", "evidence", "trust",
)  # fmt: skip
#: bits of a price in a list of prices
PRICE_BITS = 10


def tables(design: Design) -> tuple[str, ...]:
    """Return the tables that the core of a design reads from files; places are loaded."""
    adaptive = {"means": design.own_mean, "place_activity": design.activity_costs}
    return (*_TABLES, *(name for name, there in adaptive.items() if there))


def match_bits(design: Design) -> int:
    """Return the number of bits of a match's word, as in ``expected_matches.mem``."""
    bits = widths_of(design)
    # window, place, sum, has_second, second, second_sum, ties, accepted, trust
    return 32 + 3 * bits["place"] + 2 * bits["sum"] + 2 + bits.get("trust", 0)


def parameters(design: Design) -> dict[str, tuple[str, int]]:
    """Return the parameters of ``vpr_core``.

    Returns
    -------
    dict of str to (str, int)
        SystemVerilog type and value by name, in the order of the core's declaration.
    """
    bits = widths_of(design)
    return {
        "HEIGHT": ("int", design.height),
        "PIXELS": ("int", design.pixels),
        "POLARITY": ("bit", int(design.polarity)),
        "LOOKUP_DEPTH": ("int", design.lookup_depth),
        "SLOTS": ("int", design.slots),
        "TABLES": ("int", len(design.full_scales)),
        "COUNT_MAX": ("int", design.count_max),
        "BY_TIME": ("bit", int(design.window == "time")),
        "TAU_US": ("logic [63:0]", design.tau_us),
        "WINDOW_EVENTS": ("logic [31:0]", design.window_events),
        "PLACES": ("int", design.places),
        "WORDS": ("int", design.words),
        "LANES": ("int", design.lanes),
        "LENGTH": ("int", design.length),
        "OWN_MEAN": ("bit", int(design.own_mean)),
        "CONTRAST": ("bit", int(design.contrast)),
        "FILTER": ("bit", int(design.filters)),
        "KEEP_DISTANCES": ("bit", int(design.keep_distances)),
        "STEPS": ("int", len(ACTIVITY_COSTS[0]) if design.activity_costs else len(design.steps)),
        "BACK": ("int", len(design.back)),
        "ACTIVITY_COSTS": ("bit", int(design.activity_costs)),
        "STEP_PRICES": ("logic [159:0]", _prices(design.steps)),
        "BACK_PRICES": ("logic [159:0]", _prices(design.back)),
        "RESTART": ("logic [9:0]", design.restart << FRACTION_BITS),
        "TRUST": ("logic [8:0]", design.trust),
        "EXCLUSION": ("int", design.exclusion),
        "BY_MARGIN": ("bit", int(design.accept == "margin")),
        "MARGIN": ("logic [31:0]", design.margin),
        "NUMERATOR": ("logic [15:0]", design.ratio[0]),
        "DENOMINATOR": ("logic [15:0]", design.ratio[1]),
        "EVENT_TIME_BITS": ("int", 32 if design.timestamp_bits <= 32 else 64),
        **{f"{name.upper()}_BITS": ("int", bits[name]) for name in _WIDTHS},
        **{f"{name.upper()}_BITS": ("int", bits.get(name, 1)) for name in _ADAPTIVE},
        "MATCH_BITS": ("int", match_bits(design)),
    }


def package(design: Design) -> str:
    """Write the parameters as a SystemVerilog package.

    Returns
    -------
    str
        Source text of `PACKAGE`, which ``vpr_device.sv`` passes to the core.
    """
    lines = [
        "// Parameters of one design, made by edge-vpr from its design.toml: do not edit.",
        f"package {PACKAGE};",
    ]
    for name, (kind, value) in parameters(design).items():
        lines.append(f"    localparam {kind} {name} = {_literal(kind, value)};")
    return "\n".join([*lines, "endpackage", ""])


def _literal(kind: str, value: int) -> str:
    width = re.fullmatch(r"logic \[(\d+):0\]", kind)
    if kind == "int":
        return str(value)
    return f"{1 if width is None else int(width[1]) + 1}'d{value}"


def _prices(prices: tuple[int, ...]) -> int:
    shifts = ((price << FRACTION_BITS, at * PRICE_BITS) for at, price in enumerate(prices))
    return sum(price << shift for price, shift in shifts)


# Boards with open tools: top module, pins, and the commands for synthesis and placement.


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
