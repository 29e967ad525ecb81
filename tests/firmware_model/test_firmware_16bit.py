"""The reference firmware where `int` has 16 bits: an ATmega1284P, simulated by simavr."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_model import Design
from firmware_model.emulation.build import SOURCES
from firmware_model.image import image, ram_bytes
from firmware_model.vectors import Case, corner_cases, in_order, records
from firmware_model.vectors.filter_suite import filter_cases
from firmware_model.vectors.random_cases import window_cases

pytestmark = [
    pytest.mark.skipif(
        any(shutil.which(tool) is None for tool in ("avr-gcc", "simavr")),
        reason="avr-gcc or simavr is not installed: apt install gcc-avr avr-libc simavr",
    ),
    pytest.mark.slow,
]
DESIGN = Design(width=24, height=16, pixels=9, places=20, length=3, code_bits=3, tau_us=1000)
FILTER = replace(DESIGN, matching="filter", length=1, code="contrast")
BY_COUNT = replace(DESIGN, window="count")
CASES = {
    "by_count": window_cases(BY_COUNT, np.random.default_rng(0), 1)[0],
    **{f"corners/{case.name}": case for case in corner_cases(DESIGN)},
    **{f"filter/{case.name}": case for case in filter_cases(FILTER)},
    **{f"gains/{case.name}": case for case in filter_cases(replace(FILTER, gains=7))},
}
#: bytes of RAM and flash that are left for a case; short addresses reach 64 KiB of the flash
RAM, FLASH = 14_000, 50_000
MCU = "atmega1284p"


def flash_header(case: Case) -> str:
    def words(name: str, data: bytes) -> str:
        listed = ",".join(f"0x{word:x}UL" for (word,) in struct.iter_unpack("<I", data))
        return f"static const uint32_t {name}[] PROGMEM = {{{listed}}};\n"

    flash, events = image(case.memories), case.event_bytes()
    return (
        "#include <stdint.h>\n"
        f"#define CASE_START {case.start}UL\n#define EVENTS {len(case.events)}UL\n"
        f"#define IMAGE_BYTES {len(flash)}UL\n#define RAM_BYTES {ram_bytes(case.design)}UL\n"
        + words("case_image", flash)
        + words("case_events", events)
    )


def replayed(case: Case, folder: Path) -> list[tuple[str, tuple[int, ...]]]:
    """Return the records of windows and matches that the simulated processor sends."""
    (folder / "case_flash.h").write_text(flash_header(case), encoding="ascii")
    elf = folder / "case.elf"
    warnings = ("-Wall", "-Wextra", "-Wconversion", "-Werror")
    sources = [str(SOURCES / "vpr.c"), str(Path(__file__).with_name("avr_replay.c"))]
    command = ["avr-gcc", f"-mmcu={MCU}", "-std=gnu11", "-Os", *warnings, f"-I{SOURCES}"]
    subprocess.run([*command, f"-I{folder}", *sources, "-o", str(elf)], check=True)
    done = subprocess.run(
        ["simavr", "-m", MCU, "-f", "16000000", str(elf)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    text = re.sub(r"\x1b\[\d*m", "", done.stdout + done.stderr)
    # the simulator marks the end of a line by a dot
    lines = [line.rstrip(".") for line in text.splitlines()]
    records = [line for line in lines if re.fullmatch(r"[wm][0-9a-f ]+", line)]
    assert "refused" not in text and records, text[-300:]
    kinds = {"w": "window", "m": "match"}
    return [(kinds[x[0]], tuple(int(word, 16) for word in x[1:].split())) for x in records]


@pytest.mark.parametrize(
    "name",
    [
        "corners/events_by_time", "corners/narrow_clock", "by_count",
        "corners/tie_across_zone",
        *(name for name in CASES if name.startswith(("filter/drive", "gains/drive"))),
    ],
)  # fmt: skip
def test_windows_and_matches_are_those_of_the_vectors(name, tmp_path):
    """With a clock of 12 bits no window ended where shifts of `1U` lost what is above 16 bits."""
    case = CASES[name]
    assert len(image(case.memories)) + ram_bytes(case.design) < RAM
    assert len(image(case.memories)) + 8 * len(case.events) < FLASH
    expected = [one for one in records(in_order(case.trace())) if one[0] != "event"]
    assert replayed(case, tmp_path) == expected
