"""What `edge-vpr doctor` says of a machine is so, and it compiles all that a live run needs."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from edge_vpr_tools import doctor
from edge_vpr_tools.cli import main
from edge_vpr_tools.commands import ports
from edge_vpr_tools.doctor import CHECKS, Finding, Found, as_text, examine
from serial.tools import list_ports, list_ports_common


def only(findings) -> Found:
    (finding,) = findings
    return finding


def requiring(monkeypatch, *lines: str) -> None:
    monkeypatch.setattr(doctor, "distribution", lambda name: SimpleNamespace(requires=lines))


def test_this_installation_is_sound():
    finding = only(doctor.check_versions())
    assert finding.state == "good"
    assert "numpy" in finding.text and "all else" in finding.text


def test_a_library_that_is_too_old_or_missing_is_wrong_and_told_with_its_command(monkeypatch):
    requiring(monkeypatch, "numpy>=99", "edge-vpr-no-such-library>=2", 'h5py; extra == "hdf5"')
    old, missing, others = doctor.check_versions()
    assert old.state == missing.state == "wrong"
    assert old.remedy.endswith("-m pip install 'numpy>=99'")
    assert "edge-vpr-no-such-library is missing" in missing.text
    assert "all else" not in others.text


def test_extras_whose_library_is_missing_are_told_with_one_command(monkeypatch):
    requiring(
        monkeypatch, "numpy>=2", 'edge-vpr-no-such-library; extra == "hdf5"',
        'numpy>=99; extra == "dask"', 'numpy>=2; extra == "parquet"',
    )  # fmt: skip
    here, absent = doctor.check_extras()
    assert here.state == "good" and "parquet" in here.text and "hdf5," not in here.text
    assert absent.state == "absent" and "hdf5 (HDF5 recordings), dask (" in absent.text
    assert absent.text.endswith(f"numpy is {np.__version__}, needed is >=99")
    assert "[hdf5,dask]" in absent.remedy


def test_an_extra_without_wheels_for_this_processor_is_not_offered(monkeypatch):
    requiring(monkeypatch, 'edge-vpr-no-such-library; extra == "tonic"')
    monkeypatch.setattr(doctor.platform, "machine", lambda: "aarch64")
    (found,) = (each for each in doctor.check_extras() if each.state == "absent")
    assert "expelliarmus, which has no wheel for aarch64" in found.text and not found.remedy
    monkeypatch.setattr(doctor.platform, "machine", lambda: "x86_64")
    (found,) = (each for each in doctor.check_extras() if each.state == "absent")
    assert "[tonic]" in found.remedy


def test_the_findings_of_a_machine_fit_on_one_screen():
    lines = as_text(examine()).splitlines()
    assert len(lines) <= 30
    assert sum(line.startswith(("ok ", "-- ", "!! ")) for line in lines) >= len(CHECKS)


def test_every_extra_is_checked_but_those_for_work_on_the_project():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]
    assert set(extras) == {*doctor.EXTRAS, *doctor.NOT_CHECKED}


def test_a_check_that_fails_leaves_the_others(monkeypatch, capsys):
    """What it had found stays; its failure is a finding, in one line."""

    def fails():
        yield Found("good", "right so far")
        raise ValueError("boom\nand more")

    checks = {"clock": fails, "memory": lambda: [Found("good", "enough")]}
    found = examine(checks)
    assert [one.topic for one in found] == ["clock", "clock", "memory"]
    assert [one.state for one in found] == ["good", "wrong", "good"]
    assert "ValueError: boom" in found[1].text and "\n" not in found[1].text
    monkeypatch.setitem(CHECKS, "memory", fails)
    assert main(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "the check fails: ValueError" in out and "serial ports" in out


def test_sensors_are_shown_by_name_and_scope(tmp_path, capsys, monkeypatch):
    """Of a Raspberry Pi 5's power chip, and of a monitor."""
    (tmp_path / "proc/device-tree").mkdir(parents=True)
    (tmp_path / "proc/device-tree/model").write_text("Raspberry Pi 5 Model B Rev 1.0\0")
    command = tmp_path / "usr/bin/vcgencmd"
    command.parent.mkdir(parents=True)
    command.write_text(
        "#!/bin/sh\n"
        "echo ' VDD_CORE_A current(7)=1.11625000A'\n"
        "echo ' VDD_CORE_V volt(15)=0.74944980V'\n"
    )
    command.chmod(0o755)
    found = [one for one in doctor.check_sensors(tmp_path) if one.state == "good"]
    assert only(found).text.startswith("pmic: rails behind the power chip")


def test_without_a_folder_for_kernels_doctor_says_so_and_all_else_works(tmp_path):
    """Numba refuses to compile with a cache then, at the import of the first kernel."""
    script = (
        "from numba.core import caching\n"
        "(getattr(caching, 'CacheImpl', None) or caching._CacheImpl)._locator_classes = []\n"
        "from edge_vpr_tools.cli import main\n"
        "import sys\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )

    def run(*words):
        return subprocess.run(
            [sys.executable, "-c", script, *words], capture_output=True, text=True, check=False
        )

    done = run("doctor")
    assert done.returncode == 1 and "!!  compiled kernels" in done.stdout
    assert "serial ports" in done.stdout and "Traceback" not in done.stderr
    assert "NUMBA_CACHE_DIR" in done.stdout


@pytest.mark.parametrize(("kilobytes", "state"), [(900_000, "good"), (100_000, "wrong")])
def test_too_little_memory_for_a_live_run_is_wrong(tmp_path, kilobytes, state):
    (tmp_path / "proc").mkdir()
    (tmp_path / "proc/meminfo").write_text(f"MemTotal: 1 kB\nMemAvailable: {kilobytes} kB\n")
    assert only(doctor.check_memory(tmp_path)).state == state


def test_a_throttled_board_is_wrong(tmp_path, monkeypatch):
    throttled = doctor.Conditions("performance", 1.5e9, 80.0, 0b101, None)
    monkeypatch.setattr(doctor.Conditions, "now", classmethod(lambda cls, root: throttled))
    finding = only(doctor.check_processor(tmp_path))
    assert finding.state == "wrong"
    assert "under-voltage, throttled" in finding.text


@pytest.mark.parametrize(("vid", "state"), [(0x403, "wrong"), (None, "absent")])
def test_a_port_that_may_not_be_opened_is_told_with_its_group(tmp_path, monkeypatch, vid, state):
    port = tmp_path / "ttyUSB0"
    port.touch()
    found = SimpleNamespace(device=str(port), vid=vid)
    monkeypatch.setattr(list_ports, "comports", lambda: [found])
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: False)
    finding = only(doctor.check_ports())
    assert finding.state == state
    assert f"-aG {port.group()} " in finding.remedy
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: True)
    assert only(doctor.check_ports()).state == "good"


def test_kernels_are_kept_once_a_live_run_has_compiled_them(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor, "_cache_folder", lambda: None)
    assert only(doctor.check_kernels()).state == "wrong"
    monkeypatch.setattr(doctor, "_cache_folder", lambda: tmp_path)
    (tmp_path / "kernels.another-1.py311.nbi").touch()
    finding = only(doctor.check_kernels())
    assert finding.state == "absent" and "the first run takes longer" in finding.text
    (tmp_path / f"kernels.{doctor.process_events.__name__}-966.py311.nbi").touch()
    assert only(doctor.check_kernels()) == Found("good", f"kept in {tmp_path}")


def test_something_wrong_is_marked_and_ends_with_an_error(monkeypatch, capsys):
    found = [Finding("ports", "wrong", "closed", "open it"), Finding("clock", "good", "right", "")]
    monkeypatch.setattr("edge_vpr_tools.doctor.examine", lambda: found)
    assert main(["doctor"]) == 1
    said = capsys.readouterr()
    assert said.out.splitlines()[0].startswith("!!  ports")
    assert "1 of 2 findings" in said.err
    assert main(["doctor", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)[0]["remedy"] == "open it"
    assert as_text([]) == ""


def test_a_port_is_shown_with_the_name_that_stays(monkeypatch, tmp_path, capsys):
    """/dev/ttyUSB0 is another device after the next start."""
    port, link = tmp_path / "ttyUSB0", tmp_path / "by-id/usb-Maker_1.2-if00-port0"
    link.parent.mkdir()
    port.touch()
    link.symlink_to(port)
    monkeypatch.setattr(ports, "LINKS", str(tmp_path))
    found = [list_ports_common.ListPortInfo(str(each)) for each in (port, tmp_path / "ttyS0")]
    monkeypatch.setattr(list_ports, "comports", lambda: found)
    assert main(["ports"]) == 0
    (stays,) = (line for line in capsys.readouterr().out.splitlines() if "always" in line)
    assert stays == f"    always {link}"
