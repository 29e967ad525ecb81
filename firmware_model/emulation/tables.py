"""What the firmware shares with Python as a C header: the image's layout, and costs of steps.

``python -m firmware_model.emulation.tables > firmware_model/c/tables.h`` writes it, from
`firmware_model.image` and the table of `fixedpoint.activity`. The core has the costs of its design
in its package.
"""

from __future__ import annotations

import argparse
import struct
import sys
from textwrap import fill

from firmware_model.image import HEADER_WORDS, MAGIC, Table, Word
from fixedpoint.activity import BANK_COSTS, GAINS, SAME_ROW

_HEAD = """\
/* Layout of the image, and costs of steps. Written by `python -m firmware_model.emulation.tables`:
 * do not edit. Part of vpr.c and filter.h. */
#ifndef VPR_TABLES_H
#define VPR_TABLES_H

#include <stdint.h>

"""
_NAMES = {1: ("STEPS", "whole_costs"), 2: ("HALF_STEPS", "half_costs")}
#: gains of a place in memory: a word more than one is not used
_LANES = len(GAINS) + 1
_WHAT = {1: "with one place per window", 2: "with places at half windows"}


def header() -> str:
    """Return the source text of ``c/tables.h``."""
    return "\n".join([_HEAD + _layout(), _step_costs(), "#endif\n"])


def _layout() -> str:
    """Return the words of the image's header, their ranges, and the sizes of its tables."""
    words = ",\n".join(f"    AT_{word.name}" for word in Word)
    ranges = ",\n".join(
        f"    {{AT_{word.name}, {word.least}U, {word.most}U}}"
        for word in Word
        if word.least <= 0xFF and word.most <= 0xFFFF
    )
    tables = "".join(f"    TABLE_{table.name},\n" for table in Table)
    sizes = "".join(f"    bytes[TABLE_{table.name}] = {_size(table)};\n" for table in Table)
    return f"""\
#define IMAGE_MAGIC {MAGIC:#010x}U
#define HEADER_WORDS {HEADER_WORDS}U

/* words of the header */
enum {{
{words}
}};

/* ranges of those that have at most 16 bits */
static const struct {{
    uint8_t word;
    uint8_t least;
    uint16_t most;
}} image_range[] = {{
{ranges}}};

/* tables, in the order in which they lie behind the header */
enum {{
{tables}    TABLES
}};

/* Bytes of each table, without padding. */
static inline void table_bytes(const uint32_t *image, uint32_t bytes[TABLES])
{{
{sizes}}}
"""


def _size(table: Table) -> str:
    factors = [
        f"image[AT_{factor.name}]" if isinstance(factor, Word) else f"{factor}U"
        for factor in table.factors
    ]
    entry = struct.calcsize(f"<{table.entry}")
    size = " * ".join([*factors, f"{entry}U"] if entry > 1 else factors)
    if table.where is None:
        return size
    return f"(image[AT_{table.where.name}] != 0U) ? ({size}) : 0U"


def _step_costs() -> str:
    """Return the costs of steps, with fraction bits.

    Those of a step stand together, the highest row first, so that those of the gains of a place
    are neighbours: a gain of half an octave more is the next row.
    """
    highest = len(BANK_COSTS[1]) - 1 - SAME_ROW
    # of the lowest gain in the first column; with the last lane in the highest row
    first = highest + _LANES - 1
    columns = first + SAME_ROW + _LANES
    parts = [f"#define COLUMNS {columns}U /* rows of costs of a step, the highest first */\n"]
    for number, rows in BANK_COSTS.items():
        size, name = _NAMES[number]
        parts.append(f"#define {size} {len(rows[0])}U /* of 0 places on, {_WHAT[number]} */\n")
    for number, rows in BANK_COSTS.items():
        size, name = _NAMES[number]
        order = [min(max(first - c, -SAME_ROW), highest) + SAME_ROW for c in range(columns)]
        steps = [", ".join(f"{rows[row][i]}U" for row in order) for i in range(len(rows[0]))]
        indent = " " * 4
        body = ",\n".join(fill(step, 100, initial_indent=indent, subsequent_indent=indent)
                          for step in steps)  # fmt: skip
        parts.append(f"\nstatic const uint8_t {name}[{size} * COLUMNS] = {{\n{body}}};\n")
    return "".join(parts)


if __name__ == "__main__":
    argparse.ArgumentParser(description="Print c/tables.h.").parse_args()
    sys.stdout.write(header())
