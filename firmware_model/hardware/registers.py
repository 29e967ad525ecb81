"""Registers on AXI4-Lite, from a design: ``python -m firmware_model.hardware.registers``.

A SystemVerilog package, a C header and the table of docs/hardware.md are made from one list.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from firmware_model.design import Design
from firmware_model.errors import DesignError
from firmware_model.hardware.parameters import TABLES

#: name of the generated package, and of its file
PACKAGE = "vpr_registers"
#: file of the generated C header
HEADER = "vpr_registers.h"
#: value of the register `ID`: "VPR1"
ID_VALUE = 0x56505231


class Register(NamedTuple):
    """Register of 32 bits: its byte address, and the allowed accesses."""

    name: str
    address: int
    access: Literal["read", "write", "read, write"]
    text: str


REGISTERS = (
    Register("ID", 0x00, "read", f"{ID_VALUE:#x}"),
    Register("DESIGN", 0x04, "read", "CRC-32 of the design's file: whether a map is for it"),
    Register("CONTROL", 0x08, "write", "bit 0: restart at the start below; places are kept"),
    Register(
        "STATUS",
        0x0C,
        "read",
        "bit 0 `PLACE` can be written, bit 1 `EVENT_PIXEL` can be, bit 2 there is a match",
    ),
    Register("START", 0x10, "read, write", "time at which the first window opens"),
    Register("START_HIGH", 0x14, "read, write", "its upper bits, of clocks above 32 bits"),
    Register("ACTIVITY", 0x18, "read, write", "mean number of events in a window, times 256"),
    Register("EVENT_TIME", 0x20, "write", "time of the next event"),
    Register("EVENT_TIME_HIGH", 0x24, "write", "its upper bits, of clocks above 32 bits"),
    Register("EVENT_PIXEL", 0x28, "write", "column (16 bits), row (15), ON (1); sends the event"),
    Register("PLACE", 0x30, "write", "next 32 bits of a word of `places.mem`, the lowest first"),
    Register(
        "TABLE_ADDRESS",
        0x34,
        "write",
        "bits 24 to 26 the table ("
        + ", ".join(f"{number} {name}" for number, name in enumerate(TABLES))
        + "), bits 0 to 19 the word",
    ),
    Register("TABLE_WORD", 0x38, "write", "word of that table; the address then moves by one"),
    Register("MATCH_WINDOW", 0x40, "read", "number of the window"),
    Register("MATCH_PLACE", 0x44, "read", "best place"),
    Register("MATCH_SUM", 0x48, "read", "its sum, or metric"),
    Register("MATCH_SECOND", 0x4C, "read", "second best place; 0xFFFFFFFF if there is none"),
    Register("MATCH_SECOND_SUM", 0x50, "read", "its sum; 0xFFFFFFFF if there is none"),
    Register("MATCH_TIES", 0x54, "read", "other places with the best's sum"),
    Register("MATCH_ACCEPTED", 0x58, "read", "1 if it is accepted"),
    Register("MATCH_TRUST", 0x5C, "read", "trust of the place filter; 0 of sequences"),
    Register("MATCH_TAKE", 0x60, "write", "any value: the match was read, and the next may come"),
)


def constants(design: Design) -> dict[str, int]:
    """Return the constants of a design that a driver needs.

    Returns
    -------
    dict of str to int
        ``PLACE_PARTS`` is the number of writes to `PLACE` for one word of ``places.mem``.
    """
    names = ("pixels", "slots", "places", "words", "lanes", "code_bits", "timestamp_bits")
    return {
        "ID_VALUE": ID_VALUE,
        "DESIGN_VALUE": zlib.crc32(design.to_toml().encode("utf-8")),
        "PLACE_PARTS": -(-design.lanes * design.code_bits // 32),
        **{name.upper(): getattr(design, name) for name in names},
        "FILTER": int(design.filters),
    }


def package(design: Design) -> str:
    """Return a SystemVerilog package of addresses and constants, for ``vpr_axi_lite.sv``."""
    found = constants(design)
    lines = [
        "// Registers of one design, made by edge-vpr from its design.toml: do not edit.",
        f"package {PACKAGE};",
        *(f"    localparam logic [7:0] {r.name} = 8'h{r.address:02x};" for r in REGISTERS),
        *(
            f"    localparam logic [31:0] {name} = 32'h{found[name]:08x};"
            for name in ("ID_VALUE", "DESIGN_VALUE")
        ),
        f"    localparam int PLACE_PARTS = {found['PLACE_PARTS']};",
        "endpackage",
    ]
    return "\n".join([*lines, ""])


def header(design: Design) -> str:
    """Return a C header of addresses and constants."""
    guard = HEADER.upper().replace(".", "_")
    lines = [
        "/* Registers of one design, made by edge-vpr from its design.toml: do not edit. */",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        *(f"#define VPR_{r.name} {r.address:#04x}U /* {r.access}: {r.text} */" for r in REGISTERS),
        "",
        *(f"#define VPR_{name} {value}U" for name, value in constants(design).items()),
        "",
        *(f"#define VPR_TABLE_{name.upper()} {at}U" for at, name in enumerate(TABLES)),
        "",
        "#endif",
    ]
    return "\n".join([*lines, ""])


def table() -> str:
    """Return the registers as a Markdown table."""
    lines = ["| address | register | | |", "| --- | --- | --- | --- |"]
    lines += [f"| {r.address:#04x} | `{r.name}` | {r.access} | {r.text} |" for r in REGISTERS]
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> int:
    """Print the registers; return 1 if the design cannot be read."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--design", type=Path, metavar="FILE.toml", help="of the header")
    parser.add_argument("--header", action="store_true", help="as a C header; needs --design")
    args = parser.parse_args(words)
    if args.header and args.design is None:
        parser.error("--header needs --design")
    try:
        print(header(Design.load(args.design)) if args.header else table())
    except DesignError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
