"""What docs/testing.md promises of every kernel."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def modules_with_kernels():
    """Modules with a function that Numba compiles without checks of its indices."""
    for package in ("edge_vpr", "fixedpoint", "firmware_model"):
        for path in (ROOT / package).rglob("*.py"):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
            names |= {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
            if path.name == "compiling.py":  # what others are compiled by
                continue
            if names & {"kernel", "njit", "jit", "intrinsic", "vectorize", "guvectorize"}:
                name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
                yield name.removesuffix(".__init__")


def test_every_kernel_has_a_door_with_a_name():
    page = (ROOT / "docs/testing.md").read_text(encoding="utf-8").split("## Kernels")[1]
    named = set()
    for row in page.splitlines():
        if row.startswith("| `"):
            named |= set(re.findall(r"`((?:edge_vpr|fixedpoint)\.[\w.]+)`", row.split("|")[1]))
    with_kernels = set(modules_with_kernels())
    assert with_kernels == named
