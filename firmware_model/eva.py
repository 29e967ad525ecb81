"""No undefined behaviour, by abstract interpretation: ``python -m firmware_model.eva``.

Frama-C's Eva (``apt install frama-c-base``) runs the firmware on all values at once: for each image
below, any start and any endless stream of events. An alarm is an access outside the image or the
RAM, a read of what was not written, a division by zero or an overflow that it cannot exclude. The
command fails if there is one.
"""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from firmware_model.emulation.build import SOURCES
from firmware_model.errors import ToolError
from firmware_model.image import HEADER_WORDS, TABLES, image, ram_bytes, stride
from firmware_model.model.design import Design
from firmware_model.model.memories import Memories
from firmware_model.vectors.case import Case
from firmware_model.vectors.corners import corner_cases, filter_cases

#: counters end so low that Eva sees their largest value before it gives up counting iterations
_DESIGN = Design(
    width=16, height=12, pixels=9, places=12, length=3, code_bits=3, full_scales=(15,)
)  # fmt: skip
_FILTER = replace(_DESIGN, matching="filter", length=1, code="own-mean")
#: cases whose images are analysed
CASES = (
    "tie_of_two", "events_by_count", "walk", "backwards_of_kept_distances", "own_means",
    "by_activity", "contrasts",
)  # fmt: skip
_OPTIONS = (
    "-eva", "-machdep", "x86_32", "-eva-precision", "2", "-eva-auto-loop-unroll", "300",
    "-eva-slevel", "60", "-eva-widening-delay", "18",
    "-eva-widening-period", "8",
)  # fmt: skip
#: types of the entries of the tables, in their order in the image
_TYPES = ("H", "IHH", "B", "B", "B", "H", "H", "b")
_C_TYPES = {"B": "uint8_t", "b": "int8_t", "H": "uint16_t", "I": "uint32_t", "IHH": "vpr_entry_t"}
_DRIVER = """
static vpr_design_t design;
static vpr_state_t state;
static vpr_match_t match;

static void take(const vpr_event_t *event)
{
    const vpr_event_t *next = event;
    while (next == event) {
        if (vpr_events(&design, &state, &next, event + 1) != VPR_WINDOW_ENDS) {
            break;
        }
        vpr_window_end(&design, &state);
        //@ split state.newest;
        //@ split state.seen;
        (void)vpr_match_places(&design, &state, &match);
    }
}

int main(void)
{
    if (!vpr_open(&design, (const uint32_t *)(const void *)&flash, sizeof flash)) {
        //@ assert opens: \\false;
        return 1;
    }
    vpr_reset(&design, &state, (uint32_t *)(void *)&ram, Frama_C_unsigned_int_interval(0U, ~0U));
    for (;;) {
        vpr_event_t event;
        event.t = Frama_C_unsigned_int_interval(0U, ~0U);
        if (Frama_C_nondet(0, 1)) {
            event.pixel = Frama_C_unsigned_int_interval(0U, 0x7FFFFFFFU);
            take(&event);
        } else {
            event.pixel = Frama_C_unsigned_int_interval(0x80000000U, ~0U);
            take(&event);
        }
    }
}
"""


def driver(memories: Memories) -> str:
    """Return the program that is analysed.

    Events of both polarities are followed apart, so that Eva knows which slot they take.

    Flash and RAM have the types that the firmware reads them by: of an array of words, Eva would
    have to take apart sets of words, and lose what they have in common.
    """
    flash = image(memories)
    words = struct.unpack_from(f"<{HEADER_WORDS}I", flash)
    offsets = [words[word] for word in TABLES]
    own = memories.design.own_mean
    parts = [("I", list(words))]
    for at, end, kind in zip(offsets, [*offsets[1:], len(flash)], _TYPES, strict=True):
        form = "H" if kind == "B" and own and at == offsets[2] else kind
        size = struct.calcsize(f"<{form}")
        whole = flash[at : at + (end - at) // size * size]
        rows = list(struct.iter_unpack(f"<{form}", whole))
        parts.append((form, rows if len(form) > 1 else [row[0] for row in rows]))
    fields, values = [], []
    for number, (form, rows) in enumerate(parts):
        if rows:
            fields.append(f"    {_C_TYPES[form]} part_{number}[{len(rows)}];")
            values.append("{" + ", ".join(map(_c_value, rows)) + "}")
    return "\n".join(
        [
            '#include "__fc_builtin.h"', '#include "vpr.h"',
            "static const struct {", *fields, "} flash = {", ",\n".join(values), "};",
            "static struct {", *_ram(memories.design), "} ram;", _DRIVER,
        ]
    )  # fmt: skip


def _c_value(value: int | tuple[int, int, int]) -> str:
    if isinstance(value, int):
        return f"{value}U" if value >= 0 else str(value)
    return f"{{{value[0]}U, {{{value[1]}U, {value[2]}U}}}}"


def _ram(design: Design) -> list[str]:
    """Return the arrays that `vpr_reset` cuts the RAM into."""

    def room(size: int) -> int:
        return -(-size // 16) * 16

    arrays = [
        ("uint8_t", "query", stride(design)),
        ("uint16_t", "counts", room(2 * design.slots)),
        ("uint16_t", "history", room(2 * design.length * design.places)),
        ("uint32_t", "delay", 0 if design.filters else room(4 * (design.exclusion + 1))),
        ("uint16_t", "distance", room(2 * design.places) if design.keep_distances else 0),
        ("uint32_t", "mean", room(4 * design.slots) if design.own_mean else 0),
    ]
    assert sum(size for *_, size in arrays) == ram_bytes(design), "the RAM is laid out otherwise"
    bytes_of = {"uint8_t": 1, "uint16_t": 2, "uint32_t": 4}
    return [f"    {kind} {name}[{n // bytes_of[kind]}];" for kind, name, n in arrays if n]


def alarms(memories: Memories, *, sources: Path = SOURCES, seconds: int = 600) -> list[str]:
    """Return the alarms of Eva for an image, each as its line and what may happen.

    Parameters
    ----------
    sources : path
        Folder of the firmware.
    seconds : int
        Time limit.

    Raises
    ------
    ToolError
        If Frama-C is missing, or does not analyse the program.
    """
    if shutil.which("frama-c") is None:
        raise ToolError("the analysis needs frama-c: run apt install frama-c-base")
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "driver.c"
        program.write_text(driver(memories), encoding="ascii")
        # Frama-C does not know _Alignas, and aligns nothing
        include = f"-cpp-extra-args=-I{sources} -D'_Alignas(n)='"
        command = ["frama-c", *_OPTIONS, include, str(program), str(sources / "vpr.c")]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=seconds, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise ToolError(f"frama-c took more than {seconds} s") from error
    summary = re.search(r"(\d+) alarms? generated", done.stdout)
    if done.returncode or "ANALYSIS SUMMARY" not in done.stdout:
        raise ToolError(f"frama-c does not analyse the firmware: {done.stdout[-500:]}")
    found = re.findall(r"\[eva:alarm\] \S*?(\w+\.[ch]:\d+): Warning:\s+(.*?)\n", done.stdout)
    told = [f"{where}: {' '.join(what.split())}" for where, what in found]
    if summary is None or (int(summary[1]) > 0) != bool(told):
        raise ToolError(f"frama-c tells of alarms in another way: {done.stdout[-500:]}")
    return told


def cases() -> dict[str, Case]:
    """Return the cases whose images are analysed, by name; windows by count end soon."""
    found = {}
    for case in (*corner_cases(_DESIGN), *filter_cases(_FILTER)):
        if case.name in CASES:
            short = replace(case.design, window_events=3)
            found[case.name] = replace(case, memories=replace(case.memories, design=short))
    return found


def main() -> int:
    """Analyse the image of each case; return 1 if there is an alarm."""
    failures = 0
    try:
        for name, case in cases().items():
            found = alarms(case.memories)
            failures += bool(found)
            print(f"{name}: {len(found)} alarms", *found, sep="\n    ", flush=True)
    except ToolError as error:
        print(f"eva: {error}", file=sys.stderr)
        return 1
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
