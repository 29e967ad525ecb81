"""The firmware by abstract interpretation: no alarm, and one for each of some mutants."""

from __future__ import annotations

import shutil

import pytest

from firmware_model.emulation.build import SOURCES
from firmware_model.verification.eva import SIZES, alarms

pytestmark = [
    pytest.mark.skipif(
        shutil.which("frama-c") is None, reason="Frama-C is not installed: apt install frama-c-base"
    ),
    pytest.mark.slow,
]

#: a part of the source, what it becomes, and the alarm
MUTANTS = {
    "counts beyond their tables": (
        "(count < count_max) ? (count + 1U) : count", "(count + 1U)", "assertion 'held'",
    ),
    "tables that are not checked": (
        "if (words[i] > most) {", "if (false) {", "assertion 'level'",
    ),
    "means that move ever more slowly": (
        "if (!s->paused && (s->mean_shift < LAST_SHIFT)) {", "if (!s->paused) {",
        "assertion 'held'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SIZES)
def test_no_state_table_or_event_leads_out_of_the_image_and_the_ram(name):
    assert alarms(SIZES[name]) == []


@pytest.mark.parametrize("fault", MUTANTS)
def test_a_mutant_has_an_alarm(fault, tmp_path):
    """What is analysed is the firmware."""
    right, wrong, told = MUTANTS[fault]
    sources = tmp_path / "c"
    shutil.copytree(SOURCES, sources)
    text = (sources / "vpr.c").read_text(encoding="ascii")
    assert text.count(right) == 1
    (sources / "vpr.c").write_text(text.replace(right, wrong), encoding="ascii")
    raised = alarms(SIZES["default"], sources)
    assert any(told in one for one in raised), raised
