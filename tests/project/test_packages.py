"""Sdist and wheel can be built, and hold all that an installed edge-vpr needs."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from edge_vpr import __version__

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PACKAGES = {
    "edge_vpr": "edge_vpr",
    "firmware_model": "firmware_model",
    "fixedpoint": "fixedpoint",
    "tools/edge_vpr_tools": "edge_vpr_tools",
}


def run(*words: str | Path, cwd: Path) -> str:
    """Run a program that sees nothing of this checkout but what it is given."""
    hidden = {"PYTHONPATH", "PYTHONHOME", "COVERAGE_PROCESS_START"}
    environment = {name: text for name, text in os.environ.items() if name not in hidden}
    done = subprocess.run(
        [str(word) for word in words], cwd=cwd, env=environment,
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Build an sdist of the checkout, and a wheel of the sdist."""
    for library in ("build", "hatchling"):
        if importlib.util.find_spec(library) is None:
            pytest.skip(f"{library} is not installed")
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT, cwd=folder)
    return folder


@pytest.fixture(scope="module")
def environment(built, tmp_path_factory):
    """Install the wheel into a new environment, which borrows the libraries that it needs."""
    folder = tmp_path_factory.mktemp("fresh")
    run(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder)
    (wheel,) = built.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "--python", folder / "bin/python", "--quiet"]
    run(*pip, "install", "--no-deps", "--no-index", "--no-compile", wheel, cwd=folder)
    own = run(
        folder / "bin/python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))",
        cwd=folder,
    )  # fmt: skip
    # a path in a .pth file is only searched: the checkout that is installed there stays unseen
    (Path(own.strip()) / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder


def test_the_wheel_holds_every_file_of_the_packages(built):
    (wheel,) = built.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    tracked = subprocess.run(
        ["git", "ls-files", *PACKAGES], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if tracked.returncode:
        pytest.skip("this is no git checkout")
    wanted = set()
    for name in tracked.stdout.splitlines():
        for folder, package in PACKAGES.items():
            if name.startswith(f"{folder}/") and (ROOT / name).exists():
                wanted.add(package + name.removeprefix(folder))
    verifying = {name for name in wanted if name.startswith("firmware_model/verification/")}
    assert len(wanted) > 200 and verifying
    assert wanted - verifying <= names
    assert not verifying & names
    assert (ROOT / "tools/lab/loop.py").exists()
    assert not [name for name in names if "lab/" in name or "experiments" in name]
    assert {name.split("/")[0] for name in names} == {
        *PACKAGES.values(), f"edge_vpr-{__version__}.dist-info",
    }  # fmt: skip


def test_the_sdist_holds_tests_and_docs_and_nothing_that_was_made(built):
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"tests/naive.py", "docs/method.md", "CITATION.cff", "tools/board/install.sh"} <= names
    assert not [name for name in names if name.endswith((".pyc", ".nbi", ".npz"))]


def test_the_installed_command_runs_without_the_checkout(environment):
    program = environment / "bin/edge-vpr"
    assert f"edge-vpr {__version__}" in run(program, "--version", cwd=environment)
    assert "usage: edge-vpr demo" in run(program, "demo", "--help", cwd=environment)
    where = run(
        environment / "bin/python", "-c",
        "import edge_vpr, edge_vpr_tools.cli; print(edge_vpr.__file__)", cwd=environment,
    )  # fmt: skip
    assert where.startswith(str(environment))


def test_what_the_command_needs_is_what_the_wheel_asks_for(environment):
    names = run(
        environment / "bin/python", "-c",
        "from importlib.metadata import requires\nprint('\\n'.join(requires('edge-vpr')))",
        cwd=environment,
    ).splitlines()  # fmt: skip
    needed = {each.name for each in map(Requirement, names) if each.marker is None}
    modules = {"pyserial": "serial", "pillow": "PIL"}
    allowed = {modules.get(name, name.replace("-", "_")) for name in needed}
    ours = {*PACKAGES.values(), "fixedpoint"}
    code = (
        "import sys, importlib, edge_vpr_tools.cli as cli\n"
        "from edge_vpr_tools.cli import VERBS\n"
        "for verb in VERBS:\n"
        "    importlib.import_module('edge_vpr_tools.commands.' + verb.replace(' ', '_'))\n"
        "import contextlib, pkgutil, edge_vpr, edge_vpr_tools\n"
        "for package in (edge_vpr, edge_vpr_tools):\n"
        "    for each in pkgutil.walk_packages(package.__path__, package.__name__ + '.'):\n"
        "        importlib.import_module(each.name)\n"
        "from sys import modules\n"
        "for name, module in list(modules.items()):\n"
        "    if name.startswith(('edge_vpr', 'firmware_model', 'fixedpoint')):\n"
        "        for value in list(vars(module).values()):\n"
        "            other = getattr(value, '__module__', None) or getattr(value, '__name__', '')\n"
        "            print(str(other).split('.')[0])\n"
    )
    used = set(run(environment / "bin/python", "-c", code, cwd=environment).split())
    third = used - set(sys.stdlib_module_names) - ours - {"__main__"}
    assert {"numpy", "numba", "serial"} <= third
    assert third <= allowed | {"llvmlite"}  # numba's own, which kernels are made of


def test_the_citation_is_of_this_version():
    yaml = pytest.importorskip("ruamel.yaml", reason="a parser of YAML")
    citation = yaml.YAML(typ="safe").load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == __version__
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= set(citation)
