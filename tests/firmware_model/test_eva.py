"""The firmware by abstract interpretation: no alarm, and one for a firmware that is broken."""

from __future__ import annotations

import shutil

import pytest

from firmware_model.emulation.build import SOURCES
from firmware_model.eva import alarms, cases

pytestmark = [
    pytest.mark.skipif(
        shutil.which("frama-c") is None,
        reason="Frama-C is not installed: apt install frama-c-base",
    ),
    pytest.mark.slow,
]


def test_no_event_makes_sequences_read_or_write_elsewhere():
    """For any start and any endless stream; the command has the filter too."""
    assert alarms(cases()["events_by_count"].memories) == []


def test_a_firmware_that_writes_behind_its_counters_has_an_alarm(tmp_path):
    sources = tmp_path / "c"
    shutil.copytree(SOURCES, sources)
    text = (sources / "vpr.c").read_text(encoding="ascii")
    broken = text.replace("counts[slot] = (uint16_t)", "counts[slot + 4096U] = (uint16_t)")
    assert broken != text
    (sources / "vpr.c").write_text(broken, encoding="ascii")
    assert any(
        "vpr.c" in one for one in alarms(cases()["events_by_count"].memories, sources=sources)
    )
