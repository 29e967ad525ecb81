"""The installer's files fit each other, the command line and systemd."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from edge_vpr_tools.cli import VerbParser
from edge_vpr_tools.commands import stream
from packaging.requirements import Requirement

BOARD = Path(__file__).parents[2] / "tools/board"
SCRIPTS = sorted(BOARD.glob("*.sh"))
UNIT = (BOARD / "edge-vpr.service").read_text()


def tool(name: str) -> str:
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed")
    return path


def ran(name: str, *words: object, **more: Any) -> subprocess.CompletedProcess[str]:
    command = [tool(name), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, **more)


def of_unit(key: str) -> list[str]:
    return re.findall(rf"^{key}=(.*)$", UNIT, re.MULTILINE)


@pytest.mark.parametrize(
    "script", [*SCRIPTS, Path(__file__).parents[1] / "in_debian.sh"], ids=lambda path: path.name
)
def test_shellcheck_finds_nothing_in_a_script(script):
    run = ran("shellcheck", script)
    assert run.returncode == 0, run.stdout


def test_systemd_finds_nothing_in_the_unit(tmp_path):
    unit = tmp_path / "edge-vpr.service"
    # systemd looks whether the program is there
    unit.write_text(UNIT.replace("/opt/edge-vpr/current/bin/edge-vpr", sys.executable))
    command = "systemd-analyze", "verify", "--man=no", unit
    run = ran(*command)
    assert (run.returncode, run.stderr) == (0, "")
    unit.write_text(unit.read_text().replace("KillSignal=SIGTERM", "KillSignal=SIGNOTHING"))
    assert "SIGNOTHING" in ran(*command).stderr


def test_systemd_rates_the_service_as_hardly_exposed(tmp_path):
    unit = tmp_path / "edge-vpr.service"
    unit.write_text(UNIT)
    run = ran("systemd-analyze", "security", "--offline=true", "--no-pager", unit)
    if "unrecognized option" in run.stderr:
        pytest.skip("systemd-analyze security --offline came with systemd 251")
    (level,) = re.findall(r"Overall exposure level for edge-vpr.service: ([\d.]+)", run.stdout)
    assert float(level) < 3


def test_actions_of_other_people_are_pinned_by_commit():
    """A tag can be moved to other code."""
    for workflow in (BOARD.parents[1] / ".github/workflows").glob("*.yml"):
        for action in re.findall(r"uses: *(\S+)", workflow.read_text()):
            assert re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", action), action


def test_what_the_unit_runs_is_a_command():
    (line,) = of_unit("ExecStart")
    variables = dict(
        re.findall(r"^(\w+)=(.*)$", (BOARD / "edge-vpr.conf").read_text(), re.MULTILINE)
    )
    line = line.replace("$STREAM", shlex.split(variables["STREAM"])[0])
    program, verb, *words = shlex.split(line.replace("${PORT}", variables["PORT"]))
    assert program == "/opt/edge-vpr/current/bin/edge-vpr"
    arguments = VerbParser(verb).parse(words)
    assert arguments.map == "/var/lib/edge-vpr/map.npz"
    assert of_unit("ConditionPathExists") == [arguments.map]
    assert arguments.port == variables["PORT"]


def test_the_installer_makes_what_the_unit_needs():
    text = (BOARD / "install.sh").read_text()
    (environment,) = of_unit("Environment")
    for variable in environment.split():
        assert variable in text, f"kernels are compiled without {variable}"
    for path in ("/var/lib/edge-vpr", "/var/cache/edge-vpr", "/etc/default/edge-vpr"):
        assert path in text
    (wanted_by,) = of_unit("WantedBy")
    assert f"{wanted_by}.wants" in text


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_a_wrong_argument_changes_nothing_and_is_an_error(script, tmp_path):
    run = ran("sh", script, "--nothing", cwd=tmp_path)
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
        path = {"PATH": f"{tools}:{os.environ['PATH']}"}
        return ran("sh", BOARD / "install.sh", "--root", root, *words, env=path)

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
    assert "doctor" in done.read_text()
    program = root / "opt/edge-vpr/b/bin/edge-vpr"
    program.parent.mkdir(parents=True)
    program.touch(0o755)
    (root / "etc/default/edge-vpr").write_text("mine")
    (root / "var/lib/edge-vpr").mkdir(parents=True)
    (root / "var/lib/edge-vpr/map.npz").touch()
    assert install(free_mib=30).returncode == 0
    assert (root / "etc/default/edge-vpr").read_text() == "mine"
    for _ in range(2):
        assert install("--uninstall", fails_at="edge-vpr id ").returncode == 0
    left = sorted(str(path.relative_to(root)) for path in root.rglob("*") if path.is_file())
    assert left == ["etc/default/edge-vpr", "var/lib/edge-vpr/map.npz"]


def test_an_update_is_put_beside_the_running_version_and_there_is_a_way_back(stand_in):
    install, root, done = stand_in
    current = root / "opt/edge-vpr/current"

    def of_version(slot):
        program = root / "opt/edge-vpr" / slot / "bin/edge-vpr"
        program.parent.mkdir(parents=True, exist_ok=True)
        program.touch(0o755)

    refused = install("--back")
    assert (refused.returncode, "no version to go back to" in refused.stderr) == (1, True)
    assert install().returncode == 0
    assert str(current.readlink()) == "a"
    of_version("a")
    # an update that fails leaves the running version as it is
    done.unlink()
    assert install(fails_at="pip install").returncode == 1
    assert str(current.readlink()) == "a"
    assert (root / "opt/edge-vpr/a/bin/edge-vpr").exists()
    assert "/opt/edge-vpr/a" not in done.read_text()
    assert install().returncode == 0
    assert str(current.readlink()) == "b"
    of_version("b")
    for slot in ("a", "b"):
        assert install("--back").returncode == 0
        assert str(current.readlink()) == slot


@pytest.mark.parametrize("words", [[], ["--uninstall"], ["--back"]])
@pytest.mark.parametrize(
    "path",
    ["opt", "opt/edge-vpr", "var", "var/cache", "var/lib/edge-vpr", "var/tmp", "tmp", "etc",
     "etc/default/edge-vpr", "etc/systemd/system", "etc/udev/rules.d",
     "etc/systemd/system/multi-user.target.wants"],
)  # fmt: skip
def test_links_of_a_card_do_not_lead_into_this_machine(stand_in, tmp_path, path, words):
    """`--root CARD --uninstall` deleted /opt/edge-vpr of the machine as root."""
    install, root, done = stand_in
    host = tmp_path / "host"
    for inner in ("edge-vpr/bin", "cache/edge-vpr", "tmp"):
        (host / inner).mkdir(parents=True)
    (host / "edge-vpr/bin/edge-vpr").touch(0o755)
    before = sorted(host.rglob("*"))
    if (root / path).is_dir():
        shutil.rmtree(root / path)
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).symlink_to(host)
    run = install(*words)
    assert run.returncode == 1
    assert f"error: {root}/{path} is a link, which may lead out of {root}" in run.stderr
    assert sorted(host.rglob("*")) == before
    assert not done.exists()


def test_no_file_of_a_freed_user_id_is_left(stand_in):
    install, _, done = stand_in
    assert install("--uninstall").returncode == 0
    find, userdel = (done.read_text().index(name) for name in ("find / ", "userdel edge-vpr"))
    assert find < userdel
    assert (
        r"( -user edge-vpr -o -group edge-vpr ) -exec chown -h root:root {} +" in done.read_text()
    )


def test_everything_that_is_installed_is_pinned_by_hash():
    """For Linux on x86-64 and aarch64 and each version of Python, and what builds edge-vpr too."""
    project = tomllib.loads((BOARD.parents[1] / "pyproject.toml").read_text())
    text = (BOARD / "requirements.txt").read_text()
    pinned = [
        Requirement(line.split("\\")[0]) for line in re.findall(r"^\w.*$", text, re.MULTILINE)
    ]
    for python in ("3.11", "3.12", "3.13", "3.14"):
        environment = {"python_full_version": f"{python}.0", "python_version": python}
        named = {
            each.name: next(iter(each.specifier)).version
            for each in pinned
            if each.marker is None or each.marker.evaluate(environment)
        }
        wanted = project["project"]["dependencies"] + project["build-system"]["requires"]
        for each in map(Requirement, wanted):
            assert each.specifier.contains(named[each.name]), each
    assert all(each.url is None for each in pinned)
    assert len(re.findall(r"^\w", text, re.MULTILINE)) == text.count("==")
    install = (BOARD / "install.sh").read_text()
    assert re.findall(r"run_pip (.*)", install) == [
        '--require-hashes --only-binary :all: -r "${staged#"$root"}/requirements.txt"',
        '--no-deps --no-build-isolation "$source"',
    ]


def test_the_service_waits_for_its_camera_and_is_started_again_when_it_stands_still():
    """Bound to a device, it ended at each glitch of the bus, and lost what it knew."""
    assert "BindsTo" not in UNIT
    assert of_unit("Restart") == ["always"]
    assert of_unit("Type") == ["notify"]
    (watchdog_s,) = map(float, of_unit("WatchdogSec"))
    assert watchdog_s > 2 * stream._ALIVE_S


def test_the_installer_removes_the_rule_that_claimed_every_bridge(stand_in):
    install, root, _ = stand_in
    rule = root / "etc/udev/rules.d/90-edge-vpr.rules"
    rule.parent.mkdir(parents=True)
    rule.write_text("")
    assert install().returncode == 0
    assert not rule.exists()
