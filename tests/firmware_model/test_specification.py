"""docs/specification.md and the modules that are the same as a program."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import firmware_model
from fixedpoint.activity import COSTS_BY_ACTIVITY

ROOM = Path(firmware_model.__file__).parent


def test_the_costs_of_steps_on_the_page_are_those_of_the_table():
    page = (Path(__file__).parents[2] / "docs/specification.md").read_text(encoding="utf-8")
    lines = re.findall(r"^ *\d+(?: +\d+){11}$", page, re.MULTILINE)
    rows = [tuple(map(int, line.split())) for line in lines]
    both = zip(*COSTS_BY_ACTIVITY.values(), strict=True)
    assert rows == [(row, *one, *two) for row, (one, two) in enumerate(both)]


def test_the_specification_imports_tables_alone():
    """It can be read by itself: no kernel and no NumPy computes anything of it."""
    may = {"design", "memories", "specification"}
    for name in ("specification", "specification_drive"):
        for node in ast.walk(ast.parse((ROOM / f"{name}.py").read_text(encoding="utf-8"))):
            modules = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            for module in modules:
                room, _, inside = module.partition(".")
                assert room not in ("numpy", "edge_vpr"), module
                assert room != "firmware_model" or inside in may, module
                assert room != "fixedpoint" or inside == "activity", module
