"""The memories that yosys makes of a design's core."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from firmware_model.cost import Memory
from firmware_model.design import Design
from firmware_model.hardware import sources
from firmware_model.hardware.formal import run_yosys
from firmware_model.hardware.parameters import PACKAGE
from firmware_model.hardware.report import write_tables


def netlist_memories(design: Design) -> list[Memory]:
    """Read the memories of a core from its netlist, before they are mapped to an FPGA's.

    Parameters
    ----------
    design : Design

    Returns
    -------
    list of Memory
        Sorted. The delay line of the search is one of them, though it is made of registers.

    Raises
    ------
    ToolError
        If yosys is missing, or refuses the core.
    """
    with tempfile.TemporaryDirectory() as name:
        folder, found = Path(name), Path(name) / "core.json"
        write_tables(design, folder)
        files = [folder / f"{PACKAGE}.sv", *(sources.FOLDER / file for file in sources.DEVICE)]
        run_yosys(
            [
                f"read_verilog -sv {' '.join(map(str, files))}",
                "hierarchy -check -top vpr_device; proc; flatten; opt_clean; memory_collect",
                f"write_json {found}",
            ],
            "core",
            folder,
        )
        core = json.loads(found.read_text(encoding="utf-8"))["modules"]["vpr_device"]
    memories = [
        Memory(*(int(cell["parameters"][size], 2) for size in ("SIZE", "WIDTH")))
        for cell in core["cells"].values()
        if cell["type"].startswith("$mem")
    ]
    delayed = [
        len(net["bits"])
        for net_name, net in core["netnames"].items()
        if net_name.endswith("search.delayed")
    ]
    bits = design.formats["sum"].width
    return sorted([*memories, *(Memory(taken // bits, bits) for taken in delayed)])
