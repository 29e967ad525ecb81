"""File formats of memories and tables, whose words are packed as the manifest describes."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from firmware_model.vectors.manifest import FieldPlace

#: name and bits of each field of a word, the first in the least significant bits
Fields = tuple[tuple[str, int], ...]


class Table(NamedTuple):
    """Words of a memory, all of the same fields."""

    fields: Fields
    words: tuple[int, ...]

    @property
    def bits(self) -> int:
        """Width of a word in bits."""
        return sum(bits for _, bits in self.fields)

    def places(self) -> tuple[FieldPlace, ...]:
        """Return the name and place of each field."""
        lowest = accumulate((bits for _, bits in self.fields), initial=0)
        return tuple(
            FieldPlace(name, at, bits)
            for (name, bits), at in zip(self.fields, lowest, strict=False)
        )


def pack(fields: Fields, rows: Iterable[Sequence[int]]) -> Table:
    """Pack each row, of a value for each field, into a word."""
    words = []
    for row in rows:
        packed, at = 0, 0
        for value, (name, bits) in zip(row, fields, strict=True):
            if not 0 <= value < 1 << bits:
                raise ValueError(f"{name} = {value} does not fit {bits} bits")
            packed |= int(value) << at
            at += bits
        words.append(packed)
    return Table(fields, tuple(words))


def readmemh(table: Table) -> str:
    """Format a table for Verilog's ``$readmemh``: a hexadecimal word a line, from address 0."""
    digits = -(-table.bits // 4)
    return "".join(f"{word:0{digits}x}\n" for word in table.words)


def coe(table: Table) -> str:
    """Format a table as AMD's initialisation file of block memories."""
    words = ",\n".join(readmemh(table).split())
    return f"memory_initialization_radix=16;\nmemory_initialization_vector=\n{words};\n"


def mif(table: Table) -> str:
    """Format a table as Intel's memory initialisation file."""
    lines = [
        f"DEPTH = {len(table.words)};",
        f"WIDTH = {table.bits};",
        "ADDRESS_RADIX = HEX;",
        "DATA_RADIX = HEX;",
        "CONTENT BEGIN",
        *(f"{address:x} : {word};" for address, word in enumerate(readmemh(table).split())),
        "END;",
    ]
    return "\n".join(lines) + "\n"


def intel_hex(data: bytes, address: int = 0) -> str:
    """Format bytes as Intel HEX: 16 bytes a line, 32-bit addresses from a multiple of 16 on."""
    lines = []
    for at in range(0, len(data), 16):
        upper, lower = divmod(address + at, 0x10000)
        if at == 0 or lower == 0:
            lines.append(_hex_line(0, 4, upper.to_bytes(2, "big")))
        lines.append(_hex_line(lower, 0, data[at : at + 16]))
    return "\n".join([*lines, ":00000001FF\n"])


def _hex_line(address: int, kind: int, data: bytes) -> str:
    body = bytes([len(data), address >> 8, address & 0xFF, kind]) + data
    return f":{(body + bytes([-sum(body) & 0xFF])).hex().upper()}"


def csv_text(names: Iterable[str], rows: Iterable[Sequence[object]]) -> str:
    """Format rows as comma-separated values under a line of names."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([names, *rows])
    return text.getvalue()


def c_array(name: str, data: bytes) -> str:
    """Write a constant array of 32-bit words for C and C++, aligned to 16 bytes, and its bytes."""
    words = np.frombuffer(data, dtype="<u4").tolist()
    lines = [
        "    " + ", ".join(f"0x{word:08X}U" for word in words[i : i + 6]) + ","
        for i in range(0, len(words), 6)
    ]
    # C has no empty arrays
    body = "\n".join(lines) or "    0U,"
    return (
        f"#define {name.upper()}_BYTES {len(data)}U\n"
        "#ifdef __cplusplus\nalignas(16)\n#else\n_Alignas(16)\n#endif\n"
        f"static const uint32_t {name}[] = {{\n{body}\n}};\n"
    )


def case_header(
    name: str, start: int, ram: int, kept: int, flash: bytes, events: bytes, expected: bytes
) -> str:
    """Write a C header with the inputs and the expected output of `vpr_replay`.

    Parameters
    ----------
    ram : int
        Bytes of the state's arrays, as `vpr_ram_bytes` returns them.
    kept : int
        Bytes of it in which the filter keeps distances; 0 if it computes them twice.
    """
    guard = f"VPR_CASE_{name.upper()}_H"
    return "\n".join(
        [
            f"/* Case {name}: the arguments of vpr_replay, and the records that it writes. */",
            f"#ifndef {guard}\n#define {guard}\n\n#include <stdint.h>\n",
            f"#define CASE_START {start}U",
            "/* of the state; in so many of them the filter keeps the distances of a window */",
            f"#define CASE_RAM_BYTES {ram}U",
            f"#define CASE_KEPT_DISTANCES_BYTES {kept}U\n",
            c_array("case_image", flash),
            c_array("case_events", events),
            c_array("case_expected", expected),
            "#endif\n",
        ]
    )


def image_header(flash: bytes, ram: int) -> str:
    """Write a C header with an image for `vpr_open`, and the bytes of RAM that its state takes."""
    return (
        "/* A map for vpr_open. */\n#ifndef VPR_MAP_H\n#define VPR_MAP_H\n\n#include <stdint.h>\n\n"
        f"#define MAP_RAM_BYTES {ram}U /* of the state's arrays */\n\n"
        f"{c_array('map', flash)}\n#endif\n"
    )
