"""What `edge-vpr doctor` says of a machine is so."""

from __future__ import annotations

import json
import subprocess
import sys
from types import SimpleNamespace

import pytest
from edge_vpr_tools import doctor
from edge_vpr_tools.commands import ports
from edge_vpr_tools.doctor import CHECKS
from serial.tools import list_ports, list_ports_common

from edge_vpr import __version__


def requiring(monkeypatch, *lines):
    metadata = SimpleNamespace(get_all=lambda name: ["hdf5", "dask", "parquet", "formats"])
    stand_in = SimpleNamespace(requires=lines, metadata=metadata)
    monkeypatch.setattr(doctor, "distribution", lambda name: stand_in)


def test_facts_of_this_machine_are_a_line_each_and_json(run):
    lines = run("doctor").out.splitlines()
    assert [line.split("  ")[0] for line in lines] == list(CHECKS)
    assert f"edge-vpr {__version__} has all that it requires" in lines[0]
    facts = json.loads(run("doctor", "--json").out)
    assert list(facts) == list(CHECKS)
    assert not any("check fails" in text for text in facts.values())


def test_libraries_that_are_too_old_or_missing_are_told(monkeypatch):
    requiring(
        monkeypatch, "numpy>=99", "edge-vpr-no-such-library>=2", 'no-such-2; extra == "hdf5"',
        'numpy>=99; extra == "dask"', 'numpy>=2; extra == "parquet"',
        'edge-vpr[hdf5,parquet]; extra == "formats"',
    )  # fmt: skip
    assert "needs numpy>=99, edge-vpr-no-such-library>=2; Python" in doctor.versions()
    assert doctor.extras() == "parquet; not installed: dask, formats, hdf5"


def test_a_check_that_fails_leaves_the_others(monkeypatch, run):
    def fails():
        raise ValueError("boom\nand more")

    monkeypatch.setitem(CHECKS, "memory", fails)
    out = run("doctor").out
    assert "the check fails: ValueError: boom" in out and "serial ports" in out


def test_without_a_folder_for_kernels_doctor_says_so_and_all_else_works():
    """Numba refuses to compile with a cache then, at the import of the first kernel."""
    script = (
        "from numba.core import caching\n"
        "(getattr(caching, 'CacheImpl', None) or caching._CacheImpl)._locator_classes = []\n"
        "from edge_vpr_tools.cli import main\n"
        "import sys\n"
        "sys.exit(main(['doctor']))\n"
    )
    words = [sys.executable, "-c", script]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert "set NUMBA_CACHE_DIR" in done.stdout and "serial ports" in done.stdout


@pytest.mark.parametrize("is_open", [True, False])
def test_a_port_that_may_not_be_opened_is_told(monkeypatch, is_open):
    port = SimpleNamespace(device="/dev/ttyUSB0")
    monkeypatch.setattr(list_ports, "comports", lambda: [port])
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: is_open)
    told = "/dev/ttyUSB0" if is_open else "/dev/ttyUSB0 (not open to this user)"
    assert doctor.ports() == told


def test_ports_are_listed_with_the_names_that_stay_and_nothing_raw(monkeypatch, tmp_path, run):
    """/dev/ttyUSB0 is another device after the next start; a device calls itself anything."""
    usb, link = tmp_path / "ttyUSB0", tmp_path / "by-id/usb-Maker_1.2-if00-port0"
    link.parent.mkdir()
    usb.touch()
    link.symlink_to(usb)
    monkeypatch.setattr(ports, "LINKS", str(tmp_path))
    names = [str(usb), "/dev/ttyACM0", "/dev/tty\x1b[31mX"]
    attached = [list_ports_common.ListPortInfo(name) for name in names]
    attached[1].vid, attached[1].pid, attached[1].description = 0x37C5, 0x1206, "OpenMV N6"
    attached[2].description = "\x1b]0;mine\x07[red]\u202ename" + "y" * 1_000
    monkeypatch.setattr(list_ports, "comports", lambda: attached)
    rows = json.loads(run("ports", "--json").out)
    assert [(row["port"], row["always"], row["usb"]) for row in rows] == [
        (names[2], None, None), (names[1], None, "37c5:1206"), (names[0], str(link), None),
    ]  # fmt: skip
    odd, openmv, _, always = run("ports").out.splitlines()
    assert r"\x1b[31mX  -  \x1b]0;mine\x07[red]\u202ename" in odd
    assert odd.isprintable() and len(odd) < 150
    assert openmv == "/dev/ttyACM0  37c5:1206  OpenMV N6"
    assert always == f"    always {link}"
    monkeypatch.setattr(list_ports, "comports", list)
    assert "no serial ports" in run("ports").out
