"""Faults that tools put into the firmware and the core: the vectors find them."""

from __future__ import annotations

import shutil

import pytest

from firmware_model.emulation.build import SOURCES
from firmware_model.verification import hardware_mutants

pytestmark = pytest.mark.slow


def test_mutants_of_the_firmware_are_found_but_for_equal_ones(capsys):
    pytest.importorskip(
        "universalmutator", reason="universalmutator is not installed: make test installs it"
    )
    from firmware_model.verification import mutants

    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    every = mutants.mutants("quotient.h")
    before = (SOURCES / "quotient.h").read_text(encoding="ascii").splitlines()
    for mutant in every:
        lines, at = mutant.text.splitlines(), mutant.number - 1
        assert lines[:at] == before[:at] and lines != before
    mutants.main(["quotient.h", "--number", "8"])
    *left, said = capsys.readouterr().out.splitlines()
    assert said == f"8 mutants, {len(left)} survive" and len(left) < 4
    # a file that only differs in its layout is the same program
    unchanged = mutants.Mutant("quotient.h", 1, "", (SOURCES / "quotient.h").read_text() + "\n")
    assert not mutants.survives(SOURCES, unchanged)


def test_the_core_without_a_mutant_passes_and_most_mutants_do_not(capsys, monkeypatch):
    for tool in ("yosys", "verilator"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    monkeypatch.setattr(hardware_mutants, "DESIGNS", hardware_mutants.DESIGNS[-1:])
    hardware_mutants.main(["--number", "12"])
    *left, said = capsys.readouterr().out.splitlines()
    assert said == f"7 gains: 12 mutants, {len(left)} survive" and len(left) < 6
    assert all(line.startswith("survives: -mode ") for line in left)
