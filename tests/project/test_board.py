"""The installer's files fit each other, the command line and systemd."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from edge_vpr_tools.cli import parser_of

BOARD = Path(__file__).parents[2] / "tools/board"
SCRIPTS = sorted(BOARD.glob("*.sh"))
UNIT = (BOARD / "edge-vpr.service").read_text()


def tool(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


def of_unit(key: str) -> list[str]:
    return re.findall(rf"^{key}=(.*)$", UNIT, re.MULTILINE)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_shellcheck_finds_nothing_in_a_script(script):
    run = subprocess.run([tool("shellcheck"), str(script)], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_every_shell_of_posix_reads_a_script(script):
    assert subprocess.run([tool("sh"), "-n", str(script)]).returncode == 0


def test_systemd_finds_nothing_in_the_unit(tmp_path):
    unit = tmp_path / "edge-vpr.service"
    # systemd looks whether the program is there
    unit.write_text(UNIT.replace("/opt/edge-vpr/bin/edge-vpr", sys.executable))
    command = [tool("systemd-analyze"), "verify", "--man=no", str(unit)]
    run = subprocess.run(command, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
    unit.write_text(unit.read_text().replace("KillSignal=SIGTERM", "KillSignal=SIGNOTHING"))
    assert "SIGNOTHING" in subprocess.run(command, capture_output=True, text=True).stderr


def test_what_the_unit_runs_is_a_command():
    (line,) = of_unit("ExecStart")
    (given,) = re.findall(r'^STREAM="(.*)"$', (BOARD / "edge-vpr.conf").read_text(), re.MULTILINE)
    program, verb, *words = shlex.split(line.replace("$STREAM", given))
    assert program == "/opt/edge-vpr/bin/edge-vpr"
    arguments = parser_of(verb).parse(words)
    assert arguments.map == "/var/lib/edge-vpr/map.npz"
    assert of_unit("ConditionPathExists") == [arguments.map]
    assert 'SYMLINK+="event-camera"' in (BOARD / "90-edge-vpr.rules").read_text()
    assert arguments.port == "/dev/event-camera"


def test_the_installer_makes_what_the_unit_needs():
    text = (BOARD / "install.sh").read_text()
    (environment,) = of_unit("Environment")
    for variable in environment.split():
        assert variable in text, f"kernels are compiled without {variable}"
    for path in ("/var/lib/edge-vpr", "/var/cache/edge-vpr", "/etc/default/edge-vpr"):
        assert path in text
    (wanted_by,) = of_unit("WantedBy")
    assert wanted_by.replace("\\", "\\\\") + ".wants" in text


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_a_wrong_argument_changes_nothing_and_is_an_error(script, tmp_path):
    run = subprocess.run(
        [tool("sh"), str(script), "--nothing"], capture_output=True, text=True, cwd=tmp_path
    )
    assert run.returncode != 0
    assert run.stderr.startswith(("error: unknown argument --nothing", "usage: "))


@pytest.fixture
def stand_in(tmp_path):
    """Install into an empty folder by a chroot that runs nothing, and fails at some commands."""
    tools, root = tmp_path / "bin", tmp_path / "root"
    tools.mkdir()
    for folder in ("opt", "tmp", "var/tmp"):
        (root / folder).mkdir(parents=True)

    def install(*words: str, fails_at: str = "nothing", free_mib: int = 5000):
        for name, text in {
            "id": "echo 0",
            "chroot": f'echo "$@" >>{tmp_path}/done\ncase "$*" in *"{fails_at}"*) exit 1;; esac',
            "df": f"echo titles; echo disk 0 0 {free_mib * 1024}",
        }.items():
            (tools / name).write_text(f"#!/bin/sh\n{text}\n")
            (tools / name).chmod(0o755)
        return subprocess.run(
            [tool("sh"), str(BOARD / "install.sh"), "--root", str(root), *words],
            env={"PATH": f"{tools}:{os.environ['PATH']}"}, capture_output=True, text=True,
        )  # fmt: skip

    return install, root, tmp_path / "done"


@pytest.mark.parametrize(
    ("failing", "error"),
    [
        ({"fails_at": "ensurepip"}, "error: Python 3.11 or newer with venv is needed: apt install"),
        ({"free_mib": 30}, "error: ROOT/opt has 30 MiB free, and 1000 are needed"),
        ({"fails_at": "pip install"}, "error: pip could not install edge-vpr"),
    ],
    ids=["without Python", "on a full card", "without a network"],
)
def test_an_installation_that_fails_says_why_last_and_starts_no_service(stand_in, failing, error):
    install, root, _ = stand_in
    run = install(**failing)
    assert run.returncode == 1
    assert run.stderr.splitlines()[-1].startswith(error.replace("ROOT", str(root)))
    assert not (root / "etc/systemd").exists()
    assert not list((root / "tmp").iterdir()), "the copy of the checkout is left"


def test_a_second_installation_keeps_arguments_and_needs_no_space_and_uninstalling_keeps_maps(
    stand_in,
):
    install, root, done = stand_in
    assert install().returncode == 0
    assert "doctor --compile" in done.read_text()
    program = root / "opt/edge-vpr/bin/edge-vpr"
    program.parent.mkdir(parents=True)
    program.touch(0o755)
    (root / "etc/default/edge-vpr").write_text("mine")
    (root / "var/lib/edge-vpr").mkdir(parents=True)
    (root / "var/lib/edge-vpr/map.npz").touch()
    assert install(free_mib=30).returncode == 0
    assert (root / "etc/default/edge-vpr").read_text() == "mine"
    for _ in range(2):
        assert install("--uninstall", fails_at=" id ").returncode == 0
    left = sorted(str(path.relative_to(root)) for path in root.rglob("*") if path.is_file())
    assert left == ["etc/default/edge-vpr", "var/lib/edge-vpr/map.npz"]


def test_udev_finds_nothing_in_the_rule():
    udevadm = tool("udevadm")
    if "verify" not in subprocess.run([udevadm, "--help"], capture_output=True, text=True).stdout:
        pytest.skip("udevadm verify came with systemd 254")
    run = subprocess.run([udevadm, "verify", str(BOARD / "90-edge-vpr.rules")])
    assert run.returncode == 0
