"""Logic cells of the hardware core: the fit, the table it is made from, and the energy of them."""

from __future__ import annotations

import csv
import shutil

import pytest
from edge_vpr_tools.estimate import core_area, targets
from edge_vpr_tools.estimate.model import Mission, cost

from firmware_model.design import Design
from firmware_model.hardware.parameters import ICEBREAKER
from firmware_model.hardware.report import packed_cells

RATE = Mission(events_per_s=1e5, selected_share=0.01, matches_per_s=1)
DOCUMENTED = core_area.FITTED_ON["sequences, 8 lanes"]


def test_the_table_has_every_named_design_and_no_other():
    """Those that the fit is made of, and those that it is checked with, which differ."""
    assert set(core_area.read()) == set(core_area.FITTED_ON) | set(core_area.CHECKED_ON)
    fitted, checked = core_area.FITTED_ON.values(), core_area.CHECKED_ON.values()
    assert not set(fitted) & set(checked)
    with core_area.TABLE.open(encoding="ascii", newline="") as file:
        (available,) = {int(row["available"]) for row in csv.DictReader(file)}
    assert available == targets.find("ice40up5k").logic_cells


def test_the_fit_errs_by_a_tenth_at_most_on_netlists_that_it_was_not_fitted_on():
    assert set(core_area.errors()) == set(core_area.CHECKED_ON)
    assert all(abs(error) < 0.1 for error in core_area.errors().values())


def test_the_energy_of_a_cycle_is_that_of_the_clock_and_of_each_cell():
    """Low and high by hand."""
    target = targets.find("ice40up5k")
    clock, cell = (targets.constants()[f"ice40up5k-{name}"] for name in ("clock", "cell"))
    costs = cost(DOCUMENTED, target, RATE)
    assert costs.logic_cells == core_area.cells(DOCUMENTED)
    assert costs.energy_j is not None
    cycles = costs.cycles["search"].central
    for end in ("low", "central", "high"):
        picojoules = getattr(clock.value, end) + costs.logic_cells * getattr(cell.value, end)
        joules = getattr(costs.energy_j["search"], end)
        assert joules == pytest.approx(cycles * picojoules * 1e-12)


def test_the_answer_says_the_cells_and_that_there_are_too_few(tmp_path, run):
    """Predicted; no other target has any."""
    wide = Design(
        width=346, height=260, pixels=512, places=100, lanes=256, code_bits=8, lookup_depth=2048
    )
    wide.save(tmp_path / "wide.toml")
    words = ["estimate", "--design", tmp_path / "wide.toml", "--target"]
    told = " ".join(run(*words, "ice40up5k", "--sources").out.split())
    assert "5,280 logic cells" in told and "of 30 block memories" in told
    assert f"are predicted from {len(core_area.FITTED_ON)} netlists of the hardware core" in told
    assert "logic cells" not in run(*words, "cortex-m4").out


@pytest.mark.slow
@pytest.mark.skipif(
    not (shutil.which("yosys") and shutil.which("nextpnr-ice40")), reason="yosys or nextpnr missing"
)
def test_the_table_is_what_the_tools_say_of_the_core_as_it_is():
    """Within 2 %: another version of the tools packs a few cells more or less."""
    name = "single windows, 8 lanes"
    cells, _ = packed_cells(core_area.FITTED_ON[name], ICEBREAKER)["logic cells"]
    assert cells == pytest.approx(core_area.read()[name], rel=0.02)
