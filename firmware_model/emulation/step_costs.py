"""Costs of steps as a C header, from the table of `fixedpoint.activity`.

``python -m firmware_model.emulation.step_costs > firmware_model/c/step_costs.h`` writes it. The
core has the table of its design in its package.
"""

from __future__ import annotations

import sys

from fixedpoint.activity import ACTIVITY_COSTS, COSTS_BY_ACTIVITY

_HEAD = """\
/* Costs of steps with fraction bits, by the activity of the window less that of the place that is
 * reached: a row for each half octave from -6 to 2. Written by
 * `python -m firmware_model.emulation.step_costs`. Part of filter.h. */
#ifndef VPR_STEP_COSTS_H
#define VPR_STEP_COSTS_H

#include <stdint.h>

"""
_NAMES = {1: ("STEPS", "activity_costs"), 2: ("HALF_STEPS", "half_place_costs")}
_WHAT = {1: "with one place per window", 2: "with places at half windows"}


def header() -> str:
    """Return the source text of ``c/step_costs.h``."""
    parts = [f"#define ROWS {len(ACTIVITY_COSTS)}U\n"]
    for number, rows in COSTS_BY_ACTIVITY.items():
        size, name = _NAMES[number]
        parts.append(f"#define {size} {len(rows[0])}U /* of 0 places on, {_WHAT[number]} */\n")
    for number, rows in COSTS_BY_ACTIVITY.items():
        size, name = _NAMES[number]
        lines = ("    {" + ", ".join(f"{cost}U" for cost in row) + "}" for row in rows)
        body = ",\n".join(lines)
        parts.append(f"\nstatic const uint8_t {name}[ROWS][{size}] = {{\n{body}}};\n")
    return _HEAD + "".join(parts) + "\n#endif\n"


if __name__ == "__main__":
    sys.stdout.write(header())
