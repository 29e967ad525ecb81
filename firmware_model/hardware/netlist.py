"""Results of yosys and nextpnr for a design: memories of the core, and cells of a board's top."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from firmware_model.cost import Memory
from firmware_model.design import Design
from firmware_model.hardware import sources
from firmware_model.hardware.boards import Board
from firmware_model.hardware.formal import run_yosys
from firmware_model.hardware.parameters import PACKAGE
from firmware_model.hardware.report import pack, synthesize, write_tables


def netlist_memories(design: Design, slow_blocks: bool = False) -> list[Memory]:
    """Read the memories of a core from its netlist, before they are mapped to those of an FPGA.

    Parameters
    ----------
    design : Design
    slow_blocks : bool
        Whether the core has registers for slow block memories, as on an ECP5.

    Returns
    -------
    list of Memory
        Sorted by depth and width.

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
                f"chparam -set SLOW_BLOCKS {int(slow_blocks)} vpr_device",
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
    # the delay line of an exclusion of 0 is a register
    registers = [
        Memory(1, len(core["netnames"][name]["bits"]))
        for name in core["netnames"]
        if name.endswith("search.delay.oldest") and design.exclusion == 0
    ]
    return sorted([*memories, *registers])


def packed_cells(
    design: Design, board: Board, written: Path | None = None
) -> dict[str, tuple[int, int]]:
    """Count the cells of a board design, packed but not placed, and the cells of the FPGA.

    Parameters
    ----------
    design : Design
    board : Board
    written : path, optional
        JSON file of the packed netlist to be written.

    Returns
    -------
    dict of str to (int, int)
        Used and available cells, by the name of the kind of cell in ``board.resources``.

    Raises
    ------
    ToolError
        If a tool is missing, or refuses the design.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_tables(design, folder)
        synthesize(folder, board)
        return pack(folder, board, written)
