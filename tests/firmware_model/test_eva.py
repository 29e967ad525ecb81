"""The firmware by abstract interpretation: no alarm, and one for each firmware that is broken."""

from __future__ import annotations

import shutil

import pytest

from firmware_model.emulation.build import SOURCES
from firmware_model.verification.eva import SIZES, alarms

pytestmark = [
    pytest.mark.skipif(
        shutil.which("frama-c") is None,
        reason="Frama-C is not installed: apt install frama-c-base",
    ),
    pytest.mark.slow,
]

#: file, code, what it becomes, and the alarm
BROKEN = {
    "a counter behind the last": (
        "vpr.c", "counts[slot] = (uint16_t)", "counts[slot + 4096U] = (uint16_t)", "out of bounds",
    ),
    "counts beyond their tables": (
        "vpr.c", "(count < count_max) ? (count + 1U)", "(count <= count_max) ? (count + 1U)",
        "assertion 'held'",
    ),
    "tables that are not checked": (
        "vpr.c", "at_most(d->code_table, d->slots, image[AT_CODES] - 1U) &&", "",
        "assertion 'code_table'",
    ),
    "a clock that is not checked": (
        "vpr.c", "{AT_TIMESTAMP_BITS, 2U, 32U}", "{AT_TIMESTAMP_BITS, 2U, 33U}", "shift",
    ),
    "means that move ever more slowly": (
        "vpr.c", "if (!s->paused && (shift < LAST_SHIFT)) {", "if (!s->paused) {",
        "assertion 'held'",
    ),
    "a search without an end": (
        "filter.h", "for (uint32_t place = 1U; place < d->place_count; place++) {",
        "for (uint32_t place = 1U; metric[place] > 0U; place++) {", "out of bounds",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ["sequences_of_one", "default"])
def test_no_state_table_or_event_leads_out_of_the_image_and_the_ram(name):
    """The command has other sizes too."""
    assert alarms(SIZES[name]) == []


@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_firmware_has_an_alarm(fault, tmp_path):
    file, old, new, told = BROKEN[fault]
    sources = tmp_path / "c"
    shutil.copytree(SOURCES, sources)
    text = (sources / file).read_text(encoding="ascii")
    assert text.count(old) == 1
    (sources / file).write_text(text.replace(old, new), encoding="ascii")
    found = alarms(SIZES["default"], sources=sources)
    assert any(told in one for one in found), found
