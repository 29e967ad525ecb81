"""No undefined behaviour, by abstract interpretation: ``make eva``.

Frama-C's Eva (``apt install frama-c-base``) runs the firmware on all values at once. An alarm is an
access outside the image or the RAM, a read of what was not written, a division by zero, a shift by
too much or an overflow that it cannot exclude. The command fails if there is one.

It is an induction over the calls. `vpr_reset` leaves a state that passes `check` of the driver; of
any such state, with any contents of the RAM, `vpr_events` with any events, `vpr_window_end` and
`vpr_match_places` lead to one that passes it again. No end of a stream, no start, and no content of
a metric, a mean or a distance is left out.

In images of `SIZES` the sizes alone are given. All tables are any bytes, and so are the words of
the header in `FREE`: what `vpr_open` lets through is what Eva goes on with. For the look-up this
takes two parts, because Eva does not know which words of an entry go together: no entry is of a
pixel, and has any slots; or any is, and has slots that are counters. An event reads one entry.
"""

from __future__ import annotations

import argparse
import re
import resource
import shutil
import struct
import subprocess
import sys
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

from firmware_model.design import LEVEL_TOP, LEVELS, Design
from firmware_model.emulation.build import SOURCES
from firmware_model.errors import ToolError
from firmware_model.image import ALIGNMENT, HEADER_WORDS, Table, Word, image, ram_arrays
from firmware_model.memories import Memories
from firmware_model.vectors.case import choose_pixels

_DESIGN = Design(
    width=16, height=12, pixels=9, places=12, length=3, code_bits=3
)  # fmt: skip
_FILTER = replace(_DESIGN, matching="filter", length=1, code="contrast")
#: sizes of which every content of the tables is analysed, one of each profile
SIZES = {"sequences": _DESIGN, "default": replace(_FILTER, places=20)}
#: words of the header that may be any; the others are sizes
FREE = (
    Word.MAGIC, Word.VERSION, Word.BYTES, Word.CRC, Word.WIDTH, Word.WINDOW, Word.TIMESTAMP_BITS,
    Word.LARGEST_SUM, Word.RESTART, Word.TRUST, Word.ACTIVITY,
)  # fmt: skip
#: functions after which Eva goes on apart with what they let through, and what they refuse
_APART = (
    "vpr_open", "undamaged", "within_limits", "adaptive_within_limits", "laid_out", "lookup_sound",
    "levels_sound", "places_sound", "at_most", "words_at_most",
)  # fmt: skip
_OPTIONS = (
    "-eva", "-machdep", "x86_32",
    "-eva-plevel", "2000", "-eva-ilevel", "64", "-eva-split-return-function",
    ",".join([*(f"{name}:0" for name in _APART), "vpr_slot:4294967295"]),
    "-eva-slevel-function", "lookup_sound:0,event_log:64", "-eva-slevel", "64",
    "-eva-auto-loop-unroll", "1100", "-eva-domains", "cvalue,symbolic-locations,equality",
)  # fmt: skip
_C_TYPES = {"B": "uint8_t", "b": "int8_t", "H": "uint16_t", "I": "uint32_t", "II": "vpr_entry_t"}
_DRIVER = """
static vpr_design_t design;
static vpr_state_t state;
static vpr_match_t match;
static vpr_event_t event;

#define ANY Frama_C_unsigned_int_interval(0U, ~0U)
#define UP_TO(most) Frama_C_unsigned_int_interval(0U, (most))

/* what every call leaves */
static void check(void)
{
    const uint32_t i = UP_TO(SLOTS - 1U);
    //@ assert held: ram.counts[i] <= COUNT_MAX;
    //@ assert held: state.seen <= LENGTH && state.newest < LENGTH;
    //@ assert held: 4 <= state.mean_shift <= 8;
}

/* whatever passes check, with the arrays where vpr_reset has put them */
static void any_state(void)
{
    const vpr_state_t was = state;
    Frama_C_make_unknown((char *)&state, sizeof state);
    state.counts = was.counts;
    state.query = was.query;
    state.history = was.history;
    state.delay = was.delay;
    state.mean = was.mean;
    state.before = was.before;
    state.metric = was.metric;
    state.bank = was.bank;
    state.place = Frama_C_nondet(0, 1) ? 0xFFFFFFFFU : UP_TO(PLACES - 1U);
    state.gain = UP_TO(6U);
    state.distance = was.distance;
    state.seen = UP_TO(LENGTH);
    state.newest = UP_TO(LENGTH - 1U);
    state.paused = UP_TO(1U) != 0U;
    state.mean_shift = 4U + UP_TO(4U);
}

/* an event of pixels and a polarity */
static void take(uint32_t from, uint32_t most)
{
    const vpr_event_t *next = &event;
    event.t = ANY;
    event.pixel = Frama_C_unsigned_int_interval(from, most);
    const uint32_t slot = vpr_slot(&design, &event);
    //@ assert slot: slot < SLOTS || slot == 0xFFFFFFFF;
    if (design.tau != 0U) {
        (void)vpr_time(&design, &state, event.t);
    }
    if (vpr_events(&design, &state, &next, &event + 1) == VPR_WINDOW_ENDS) {
        vpr_window_end(&design, &state);
        if (vpr_match_places(&design, &state, &match)) {
            Frama_C_show_each_matched();
            //@ assert match: match.place < PLACES;
            //@ assert match: match.second < PLACES || match.second == 0xFFFFFFFF;
        }
    }
    check();
}

/* Eva does not know which words of an entry go together, unless the polarities come apart */
static void take_any(void)
{
    if (Frama_C_nondet(0, 1)) {
        take(0U, 0x7FFFFFFFU);
    } else {
        take(0x80000000U, ~0U);
    }
}

int main(void)
{
HEADER
    if (!vpr_open(&design, flash.header, sizeof flash)) {
        return 1;
    }
RANGES
    const uint32_t room = vpr_ram_bytes(&design);
    //@ assert room: room == sizeof(ram);
    vpr_reset(&design, &state, (uint32_t *)(void *)&ram, ANY);
    check();

    //@ loop unroll SLOTS;
    for (uint32_t i = 0U; i < SLOTS; i++) {
        ram.counts[i] = (uint16_t)UP_TO(COUNT_MAX);
    }
    any_state();
    //@ split state.newest;
    if (Frama_C_nondet(0, 1)) {
        //@ loop unroll DEPTH;
        for (uint32_t i = 0U; i < DEPTH; i++) {
            flash.lookup[i].pixel = VPR_NONE;
            flash.lookup[i].slot = UP_TO(0xFFFFFFFFU);
        }
        take_any();
    } else {
        //@ loop unroll DEPTH;
        for (uint32_t i = 0U; i < DEPTH; i++) {
            flash.lookup[i].pixel = ANY;
            flash.lookup[i].slot = UP_TO(SLOTS - 1U);
        }
        take_any();
    }
    return 0;
}
"""


def driver(design: Design) -> str:
    """Return the program that is analysed.

    Flash and RAM have the types that the firmware reads them by: of an array of words, Eva would
    have to take apart sets of words, and lose what they have in common.
    """
    pixels = choose_pixels(design)
    places = [[0] * design.slots] * design.places
    flash = image(Memories(design, pixels, places))
    words = list(struct.unpack_from(f"<{HEADER_WORDS}I", flash))
    fields = [f"    uint32_t header[{HEADER_WORDS}];"]
    for table in Table:
        padded = -(-table.size(dict(enumerate(words))) // ALIGNMENT) * ALIGNMENT
        if padded:
            entries = padded // struct.calcsize(f"<{table.entry}")
            fields.append(f"    {_C_TYPES[table.entry]} {table.name.lower()}[{entries}];")
    header = [
        f"    flash.header[{at}] = {word}U;" for at, word in enumerate(words)
        if at not in list(FREE)
    ]  # fmt: skip
    sizes = {
        "SLOTS": design.slots, "COUNT_MAX": design.count_max, "LENGTH": design.length,
        "PLACES": design.places, "DEPTH": design.lookup_depth,
    }  # fmt: skip
    ranges = [_range(*one) for one in _ranges(design)]
    text = _DRIVER.replace("HEADER", "\n".join(header)).replace("RANGES", "\n".join(ranges))
    return "\n".join(
        [
            '#include "__fc_builtin.h"', '#include "vpr.h"',
            "extern struct {", *fields, "} flash;",
            "extern struct {", *_ram(design), "} ram;",
            _numbered(text, sizes),
        ]
    )  # fmt: skip


def _numbered(text: str, sizes: dict[str, int]) -> str:
    """Put numbers in the place of names; annotations know no macros."""
    for name, size in sizes.items():
        text = re.sub(rf"\b{name}\b", f"{size}U", text)
    return text


def _ranges(design: Design) -> list[tuple[str, int, int]]:
    """Return each table whose entries have a range, the number of entries, and the largest one."""
    ranges = [("displacement", design.height, design.lookup_depth - 1)]
    if design.contrast:
        ranges += [("level", len(LEVELS), LEVEL_TOP), ("mean", design.slots, LEVEL_TOP)]
        ranges.append(("limits", design.slots, design.count_max))
    return ranges


def _range(name: str, entries: int, most: int) -> str:
    """Return code that checks the range of the entries that `vpr_open` lets through."""
    return (
        f"    const uint32_t at_{name} = UP_TO({entries - 1}U);\n"
        f"    //@ assert {name}: flash.{name}[at_{name}] <= {most};"
    )


def _ram(design: Design) -> list[str]:
    """Return the arrays that `vpr_reset` cuts the RAM into."""
    bits = {
        "query": 8, "counts": 16, "before": 16, "history": 16, "delay": 32,
        "metric": 32 if design.gains > 1 else 8, "distance": 16, "mean": 32,
    }  # fmt: skip
    return [
        f"    uint{bits[name]}_t {name}[{size * 8 // bits[name]}];"
        for name, size in ram_arrays(design).items()
        if size
    ]


#: time limit of the processor
_SECONDS = 600


def alarms(design: Design, sources: Path = SOURCES) -> list[str]:
    """Return the alarms of Eva for images of a design, each as its line and what may happen.

    Parameters
    ----------
    sources : path
        Folder of the firmware.

    Raises
    ------
    ToolError
        If Frama-C is missing, or does not analyse the program to its end.
    """
    if shutil.which("frama-c") is None:
        raise ToolError("the analysis needs frama-c: run apt install frama-c-base")
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "driver.c"
        program.write_text(driver(design), encoding="ascii")
        # Frama-C knows neither _Static_assert nor _Alignas, and aligns nothing
        include = f"-cpp-extra-args=-I{sources} -D'_Alignas(n)=' -D'_Static_assert(...)='"
        command = ["frama-c", *_OPTIONS, include, str(program), str(sources / "vpr.c")]
        limit = partial(resource.setrlimit, resource.RLIMIT_CPU, (_SECONDS, _SECONDS))
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, preexec_fn=limit
        )
    if done.returncode < 0:
        raise ToolError(f"frama-c took more than {_SECONDS} s")
    summary = re.search(r"(\d+) alarms? generated", done.stdout)
    if done.returncode or summary is None or "ANALYSIS SUMMARY" not in done.stdout:
        raise ToolError(f"frama-c does not analyse the firmware: {done.stdout[-500:]}")
    if "show_each_matched" not in done.stdout:
        raise ToolError("frama-c finds no way to a match: what it analyses is empty")
    matches = re.findall(r"\[eva:alarm\] \S*?(\w+\.[ch]:\d+): Warning:\s+(.*?)\n", done.stdout)
    told = [f"{where}: {' '.join(what.split())}" for where, what in matches]
    if int(summary[1]) > len(told):
        raise ToolError(f"frama-c tells of alarms in another way: {done.stdout[-500:]}")
    return told


def main() -> int:
    """Analyse images of all sizes; return 1 if there is an alarm."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    failures = 0
    try:
        for name, design in SIZES.items():
            before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            raised = alarms(design)
            took = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
            failures += bool(raised)
            print(f"{name}: {len(raised)} alarms, {took:.0f} s", *raised, sep="\n    ", flush=True)
    except ToolError as error:
        print(f"eva: {error}", file=sys.stderr)
        return 1
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
