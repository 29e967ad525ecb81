"""What `in_debian.sh` runs on other processors and Pythons, and leaves out there."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
SCRIPT = Path(__file__).parents[1] / "in_debian.sh"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
# of a requirement, what is imported
MODULES = {"tonic": "tonic"}


def imported_at_once(path: Path) -> set[str]:
    """Return the packages that are imported with a module, and not by a function of it."""
    modules = set()
    waiting: list[ast.AST] = [ast.parse(path.read_text())]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.ImportFrom):
            modules.add(str(node.module))
        elif isinstance(node, ast.Import):
            modules.update(name.name for name in node.names)
        elif isinstance(node, ast.FunctionDef) or (
            isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        ):
            continue
        else:
            waiting.extend(ast.iter_child_nodes(node))
    return {name.partition(".")[0] for name in modules}


def test_what_cannot_be_installed_everywhere_is_imported_by_no_module_that_is_collected():
    extras = PROJECT["project"]["optional-dependencies"]
    needed = [Requirement(text) for text in extras["test"]]
    x86 = {
        extra for each in needed if "platform_machine" in str(each.marker) for extra in each.extras
    }
    names = {Requirement(text).name for extra in x86 for text in extras[extra]}
    assert names == set(MODULES)
    options = PROJECT["tool"]["pytest"]["ini_options"]
    left_out = [ROOT / path for path in re.findall(r"--ignore=(\S+)", options["addopts"])]
    importing = [
        path
        for folder in options["testpaths"]
        for path in (ROOT / folder).rglob("*.py")
        if any(name in path.read_text() for name in MODULES.values())
        and imported_at_once(path) & set(MODULES.values())
    ]
    assert importing, "nothing to leave out"
    for path in importing:
        assert any(path.is_relative_to(each) for each in left_out), path


def test_each_part_names_tests_that_there_are():
    text = SCRIPT.read_text()
    for variable in ("kernels", "elsewhere", "commands"):
        (names,) = re.findall(rf'^{variable}="([^"]*)"', text, re.MULTILINE)
        for name in names.split():
            assert list((ROOT / "tests").glob(f"*/test_{name}.py")), name


def test_every_python_that_is_promised_is_run_here_or_by_the_workflow():
    promised = {
        line.rpartition(" :: ")[2]
        for line in PROJECT["project"]["classifiers"]
        if re.search(r":: 3\.\d+$", line)
    }
    by_script = set(re.findall(r"^    (3\.\d+)\) suite=", SCRIPT.read_text(), re.MULTILINE))
    workflow = (ROOT / ".github/workflows/test.yml").read_text()
    assert promised == set(re.findall(r'"(3\.\d+)"', workflow))
    assert by_script < promised
    assert "-arm" in workflow
