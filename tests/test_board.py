"""The installer's files fit each other, the command line and systemd."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from edge_vpr_tools.cli import parser_of

BOARD = Path(__file__).parents[1] / "tools/board"
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
