"""Source files of the core, in an order in which each follows the modules that it uses."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "rtl"

MEMORIES = ("vpr_rom.sv", "vpr_ram.sv", "vpr_ram_single.sv")
UNITS = (
    "vpr_delay.sv", "vpr_pixel_lookup.sv", "vpr_window_timer.sv", "vpr_window_quota.sv",
    "vpr_counters.sv", "vpr_events.sv", "vpr_logarithm.sv", "vpr_activity.sv", "vpr_sums.sv",
    "vpr_running_mean.sv", "vpr_contrast.sv", "vpr_encoder.sv", "vpr_place_memory.sv",
    "vpr_sad_lanes.sv", "vpr_distance.sv", "vpr_sequence.sv", "vpr_see.sv", "vpr_speed.sv",
    "vpr_spread.sv", "vpr_evidence.sv", "vpr_step_costs.sv", "vpr_prediction.sv", "vpr_middle.sv",
    "vpr_filter.sv", "vpr_bank.sv", "vpr_trust.sv", "vpr_search.sv", "vpr_core.sv",
)  # fmt: skip
#: the core; the package of a design comes first
DEVICE = (*MEMORIES, *UNITS)
#: testbench that replays a case of golden vectors
BENCH = "vpr_bench.sv"
#: files for a simulation, in addition to the package and the case
SIMULATED = (*DEVICE, BENCH)
#: device behind SPI, as in the top modules of boards
SPI = ("vpr_spi.sv", "vpr_spi_device.sv")
#: device behind registers on AXI4-Lite, and their addresses, also for C
REGISTERS, AXI, HEADER = "vpr_registers.sv", "vpr_axi_lite.sv", "vpr_registers.h"
#: testbench that replays a case over AXI4-Lite
AXI_BENCH = "vpr_axi_bench.sv"
#: testbench that replays a case through the SPI of a board with an iCE40UP5K
UP5K_BENCH = "vpr_up5k_bench.sv"
#: testbench that replays cases with cocotb, in Python
COCOTB_BENCH = FOLDER / "cocotb" / "vpr_cocotb.py"


def text_of(name: str) -> str:
    """Return the text of a source file."""
    return (FOLDER / name).read_text(encoding="ascii")


def copy_sources(folder: Path, names: Sequence[str]) -> None:
    """Copy source files into a new folder."""
    folder.mkdir()
    for name in names:
        shutil.copyfile(FOLDER / name, folder / name)
