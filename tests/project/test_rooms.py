"""Who may import whom: arrows run downwards only."""

from __future__ import annotations

import ast
import graphlib
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = {
    "fixedpoint": set(),
    "firmware_model": {"fixedpoint"},
    "edge_vpr": {"fixedpoint"},
    "tools/edge_vpr_tools": {"fixedpoint", "firmware_model", "edge_vpr"},
    "tools/lab": {"fixedpoint", "firmware_model", "edge_vpr", "edge_vpr_tools"},
}
OURS = {"fixedpoint", "firmware_model", "edge_vpr", "edge_vpr_tools", "lab", "tests"}


@cache
def nodes(path):
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def imported(path):
    for node in nodes(path):
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


def test_edge_vpr_imports_neither_firmware_model_nor_tools():
    """Also not when it runs: of the tools, `MatchResult.plot` and `report` alone load a module."""
    by_name = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "edge_vpr").rglob("*.py")
        for node in nodes(path)
        if isinstance(node, ast.Call)
        and re.search(r"import_module\(f?'(edge_vpr_tools|firmware_model|lab)\b", ast.unparse(node))
    }
    assert by_name == {"edge_vpr/match_result.py"}
    code = (
        "import importlib, pkgutil, edge_vpr\n"
        "for each in pkgutil.walk_packages(edge_vpr.__path__, 'edge_vpr.'):\n"
        "    importlib.import_module(each.name)\n"
    )
    assert loaded_by(code, {"edge_vpr_tools", "firmware_model", "lab"}) == "[]"


#: stages of the pipeline; each imports only those before it
STAGES = [
    *("errors", "run_log", "files", "records", "plugins", "compiling", "archive"),
    *("settings", "events", "results"),
    *("confidence", "route", "odometry", "recordings", "descriptors", "reference_map", "matching"),
    *("evaluation", "simulation", "online", "learning"),
    *("drive_inputs", "map_making", "match_result", "live"),
]


def test_a_stage_imports_only_the_stages_before_it():
    for path in (ROOT / "edge_vpr").rglob("*.py"):
        stage = path.relative_to(ROOT / "edge_vpr").parts[0].removesuffix(".py")
        if stage == "__init__":  # exports the names of all stages
            continue
        allowed = STAGES[: STAGES.index(stage) + 1]
        for node in _always_run(path):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("edge_vpr."):
                target = node.module.split(".")[1]
                assert target in allowed, f"{path.relative_to(ROOT)} imports edge_vpr.{target}"


def test_no_circle_of_imports():
    """What a module imports, also in a function or for its types alone, never leads back to it.

    A package's names that are loaded when they are first used do not count, and neither do the
    methods of a map, each of which calls the module that does the work.
    """
    roots = {"edge_vpr": ROOT, "firmware_model": ROOT, "fixedpoint": ROOT}
    roots |= {"edge_vpr_tools": ROOT / "tools", "lab": ROOT / "tools"}
    files = {}
    for package, parent in roots.items():
        for path in (parent / package).rglob("*.py"):
            name = ".".join(path.relative_to(parent).with_suffix("").parts)
            files[name.removesuffix(".__init__")] = path
    arrows = {name: set(_loads(path, files)) - {name} for name, path in files.items()}
    graphlib.TopologicalSorter(arrows).prepare()


def _always_run(path):
    """Return the nodes of a module; of the map's, without its methods and what is for types."""
    if path != ROOT / "edge_vpr" / "reference_map.py":
        return nodes(path)
    return ast.parse(path.read_text(encoding="utf-8")).body


def _loads(path, files):
    if path.name == "__init__.py" and "__getattr__" in path.read_text(encoding="utf-8"):
        return
    for node in _always_run(path):
        if isinstance(node, ast.ImportFrom) and not node.level:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                if inner in files:
                    yield inner
                elif node.module in files:
                    yield node.module


def loaded_by(code: str, modules: set[str]) -> str:
    """Return which of these modules a process has loaded after the code."""
    code += f"import sys\nprint(sorted({modules} & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return run.stdout.splitlines()[-1]


def test_help_loads_neither_numpy_nor_numba_nor_matplotlib_nor_readers():
    """So that it stays under 0.25 s."""
    slow = {"numpy", "numba", "matplotlib", "pyarrow", "h5py", "edge_vpr.recordings", "socket"}
    code = (
        "import contextlib, edge_vpr\n"
        "from edge_vpr_tools.cli import VERBS, main\n"
        "for verb in ('', *VERBS):\n"
        "    with contextlib.suppress(SystemExit): main([*verb.split(), '--help'])\n"
    )
    assert loaded_by(code, slow) == "[]"


def test_what_a_robot_runs_loads_no_pictures_and_no_tables():
    """A session, the map behind it, and `stream` without a terminal: quick to start, and small."""
    unneeded = {"matplotlib", "PIL", "pandas", "pyarrow", "h5py", "rosbags"}
    code = (
        "from edge_vpr import LiveSession, Localiser, ReferenceMap\n"
        "import edge_vpr_tools.live_view, edge_vpr_tools.commands.stream\n"
    )
    assert loaded_by(code, unneeded) == "[]"


def test_parsed_arguments_do_not_leave_the_commands():
    """What takes a namespace cannot be called from Python."""
    tools = ROOT / "tools/edge_vpr_tools"
    for path in tools.rglob("*.py"):
        if path.relative_to(tools).parts[0] not in ("commands", "flags.py"):
            text = path.read_text(encoding="utf-8")
            assert path.name == "cli.py" or "argparse.Namespace" not in text, path
            if path.name != "cli.py":
                assert "edge_vpr_tools.flags" not in text, path
                assert "edge_vpr_tools.commands" not in text, path


def test_commands_stand_side_by_side():
    """What two of them share, or a program could want, is a function of a library."""
    folder = ROOT / "tools/edge_vpr_tools/commands"
    for path in folder.glob("*.py"):
        names = set(re.findall(r"edge_vpr_tools\.commands\.(\w+)", path.read_text("utf-8")))
        assert not names, path


def test_every_public_name_is_there():
    import edge_vpr

    for name in edge_vpr.__all__:
        assert getattr(edge_vpr, name) is not None
    with pytest.raises(AttributeError):
        _ = edge_vpr.nothing


def test_inner_kernels_are_called_by_kernels_alone():
    """They have no wrapper for Python, so that such a call would end the process."""
    files = {
        path: path.read_text(encoding="utf-8")
        for room in (*ROOMS, "tests", "tools/bench")
        for path in (ROOT / room).rglob("*.py")
    }
    functions = {
        path: [node for node in nodes(path) if _decorated_by_kernel(node)]
        for path, text in files.items()
        if "@kernel" in text
    }
    inner = {
        (".".join(path.relative_to(ROOT).with_suffix("").parts), each.name)
        for path, of_file in functions.items()
        for each in of_file
        if "inner=True" in ast.unparse(each.decorator_list[0])
    }
    assert inner
    for path, text in files.items():
        if not any(name in text for _, name in inner):
            continue
        own = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        names = {name for module, name in inner if module == own} | {
            alias.name
            for node in nodes(path)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
            if (node.module, alias.name) in inner
        }
        kernels = (ast.walk(each) for each in functions.get(path, []))
        of_kernels = {call for each in kernels for call in _calls(each, names)}
        assert set(_calls(nodes(path), names)) == of_kernels, path


def _decorated_by_kernel(node):
    return isinstance(node, ast.FunctionDef) and any(
        ast.unparse(each).startswith("kernel") for each in node.decorator_list
    )


def _calls(nodes, names):
    for node in nodes:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in names:
            yield node
