"""What a docstring lists, it describes."""

from __future__ import annotations

import ast
import itertools
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("edge_vpr", "fixedpoint", "firmware_model", "tools/edge_vpr_tools")


def undescribed(source):
    """Yield parameters and attributes that have a heading and no word below it."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        lines, section = [*(ast.get_docstring(node) or "").splitlines(), ""], ""
        for line, after in itertools.pairwise(lines):
            if re.fullmatch("-+", after):
                section = line
            listed = section in ("Parameters", "Attributes") and " : " in line
            if listed and not line.startswith(" ") and not after.startswith(" "):
                yield f"{node.name}: {line}"


@pytest.mark.parametrize("room", ROOMS)
def test_each_listed_parameter_is_described(room):
    listed = '"""Do.\n\n    Parameters\n    ---\n    x : int\n    y : int\n        Why.\n    """'
    assert list(undescribed(f"def do(x, y):\n    {listed}")) == ["do: x : int"]
    found = [
        f"{path.relative_to(ROOT)}: {each}"
        for path in (ROOT / room).rglob("*.py")
        for each in undescribed(path.read_text(encoding="utf-8"))
    ]
    assert found == []
