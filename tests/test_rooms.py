"""Who may import whom: arrows run downwards only."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = {
    "fixedpoint": set(),
    "firmware_model": {"fixedpoint"},
    "edge_vpr": {"fixedpoint"},
    "tools/edge_vpr_tools": {"fixedpoint", "firmware_model", "edge_vpr"},
}
OURS = {"fixedpoint", "firmware_model", "edge_vpr", "edge_vpr_tools", "tests"}


def imported(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module.split(".")[0]


@pytest.mark.parametrize("room", [room for room in ROOMS if (ROOT / room).is_dir()])
def test_a_room_imports_only_the_rooms_below_it(room):
    modules = list((ROOT / room).rglob("*.py"))
    assert modules
    allowed = ROOMS[room] | {Path(room).name}
    for module in modules:
        wrong = set(imported(module)) & OURS - allowed
        assert not wrong, f"{module.relative_to(ROOT)} imports {', '.join(wrong)}"


def test_help_loads_neither_numba_nor_matplotlib():
    code = (
        "import sys, contextlib, edge_vpr\n"
        "from edge_vpr_tools.cli import main\n"
        "with contextlib.suppress(SystemExit): main(['--help'])\n"
        "print(sorted({'numba', 'matplotlib', 'pyarrow', 'h5py'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "[]"


def test_every_public_name_is_there():
    import edge_vpr

    for name in edge_vpr.__all__:
        assert getattr(edge_vpr, name) is not None
    with pytest.raises(AttributeError):
        _ = edge_vpr.nothing
