"""The firmware by abstract interpretation: no alarm, and one for each of some mutants."""

from __future__ import annotations

import shutil

import pytest

from firmware_model.emulation.build import SOURCES
from firmware_model.verification.eva import SIZES, alarms
from firmware_model.verification.mutants import all_mutants

pytestmark = [
    pytest.mark.skipif(
        shutil.which("frama-c") is None,
        reason="Frama-C is not installed: apt install frama-c-base",
    ),
    pytest.mark.slow,
]

#: systematic mutants: the function, what its line becomes, and the alarm
MUTANTS = {
    "counts beyond their tables": (
        "vpr_events", "counts[slot] = (uint16_t)((count + 1U));", "assertion 'held'",
    ),
    "tables that are not checked": ("words_at_most", "if (false) {", "assertion 'level'"),
    "means that move ever more slowly": (
        "contrast_codes", "if (!s->paused && true) {", "assertion 'held'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ["sequences_of_one", "default"])
def test_no_state_table_or_event_leads_out_of_the_image_and_the_ram(name):
    """The command has other sizes too."""
    assert alarms(SIZES[name]) == []


@pytest.mark.parametrize("fault", MUTANTS)
def test_a_mutant_has_an_alarm(fault, tmp_path):
    """What is analysed is the firmware."""
    function, becomes, told = MUTANTS[fault]
    wrong = next(m for m in all_mutants() if (m.function, m.becomes) == (function, becomes))
    sources = tmp_path / "c"
    shutil.copytree(SOURCES, sources)
    (sources / wrong.file).write_text(wrong.text, encoding="ascii")
    found = alarms(SIZES["default"], sources=sources)
    assert any(told in one for one in found), found
