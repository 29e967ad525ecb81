"""Golden vectors on a board over its serial port: an emulated one, and boards that go wrong."""

from __future__ import annotations

import os
import pty
import re
import shutil
import struct
import subprocess
import sys
import threading
import tty
from dataclasses import replace
from pathlib import Path

import pytest
import serial
from edge_vpr_tools.commands import golden_verify

from firmware_model import Design, VectorError
from firmware_model.vectors import cases_within, run_on_board, standard_suites, write_suites
from firmware_model.vectors.board import MAGIC, READY, REFUSED
from firmware_model.vectors.manifest import load_manifest

M4 = Path(__file__).parents[2] / "examples" / "firmware-m4"
DESIGN = Design(width=64, height=48, pixels=25, places=40, length=4, code_bits=3)
FILTER = replace(DESIGN, matching="filter", length=1, code="contrast")


@pytest.fixture(scope="module")
def vectors(tmp_path_factory) -> Path:
    """Some small cases of the filter."""
    folder = tmp_path_factory.mktemp("vectors") / "v"
    write_suites(folder, FILTER, cases_within(standard_suites(FILTER, 0, "filter"), 6e5), 0)
    return folder


def program(folder: Path, sources: Path | None = None) -> Path:
    """The example's program, of changed sources of the firmware if they are given."""
    zig = f"CC={sys.executable} -m ziglang cc -target thumb-freestanding-eabi"
    compiler = [] if shutil.which("arm-none-eabi-gcc") else [zig, "CPU=-mcpu=cortex_m4", "LIBS="]
    of_sources = [] if sources is None else [f"VPR={sources}"]
    command = ["make", "-C", str(M4), "vectors", f"OUT={folder}", *of_sources, *compiler]
    subprocess.run(command, check=True, capture_output=True)
    return folder / "vectors.elf"


@pytest.fixture
def board():
    """Start QEMU's MPS2 board with a program; return the pseudo-terminal that is its port."""
    if shutil.which("qemu-system-arm") is None:
        pytest.skip("qemu-system-arm is not installed: apt install qemu-system-arm")
    pytest.importorskip("ziglang", reason="ziglang is not installed (extra firmware)")
    running = []

    def start(elf: Path) -> str:
        command = ["qemu-system-arm", "-M", "mps2-an386", "-kernel", str(elf)]
        command += ["-display", "none", "-monitor", "none", "-serial", "pty"]
        running.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        return re.search(r"/dev/\S+", running[-1].stdout.readline())[0]

    yield start
    for process in running:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_board_runs_the_vectors_over_its_port(board, vectors, tmp_path, run):
    """Whole cases, then one alone, without a reset between them."""
    port = board(program(tmp_path))
    verify = ["golden", "verify", vectors, "--port", port]
    cases = len(list((vectors / "filter").iterdir()))
    assert f"{port}: {cases} of {cases} cases, equal records:" in run(*verify).out
    one, _ = first_case(vectors)
    assert f"{port}: 1 of {cases} cases" in run(*verify, "--case", one).out


def test_a_board_with_a_fault_is_found(board, vectors, tmp_path, run):
    """Ties are not counted."""
    sources = tmp_path / "c"
    shutil.copytree(M4.parents[1] / "firmware_model" / "c", sources)
    text = (sources / "filter.h").read_text("ascii")
    wrong = text.replace("m->ties = ties;", "m->ties = ties + 1U;")
    assert wrong != text
    (sources / "filter.h").write_text(wrong, "ascii")
    port = board(program(tmp_path / "out", sources))
    said = run("golden", "verify", vectors, "--port", port, code=1).out
    assert re.search(r"ties: expected \d+, got \d+", said)


def first_case(vectors):
    """Name and number of a case."""
    name = f"filter/{next((vectors / 'filter').iterdir()).name}"
    return name, dict(load_manifest(vectors).cases())[name].number


class Scripted:
    """A line whose board says these words to the first case, and nothing more."""

    def __init__(self, *words: int) -> None:
        self.said = struct.pack(f"<{len(words)}I", *words)
        self.heard = b""

    def read(self, size: int) -> bytes:
        data, self.said = self.said[:size], self.said[size:]
        return data

    def write(self, data: bytes) -> None:
        self.heard += data


@pytest.mark.parametrize(
    ("words", "says"),  # None is the number of the case
    [
        ((), "the board is silent"),
        ((0, 1, None, READY, 1, 64), "the board is silent"),
        ((0x0D0A_0D0A, 7), "begin no record: reset it, and check --baud"),
        ((0, 0x1000_0000), "begin no record"),
        ((0, 1, None, REFUSED, 1, 0), "the board refuses the image"),
        ((0, 0) * 9, "begin no record"),
        ((0, 1, None, READY, 0), "begin no record"),
        ((0, 1, 7), "the number of the case, "),
        ((0, 1, None, 0, 1, 0), "or begins twice"),
        ((READY, 1, 0), "the number of the case"),
        ((0, 1, None, READY, 1, 1 << 30), "asks for more bytes than the case has"),
        ((0, 1, None, *(1, 2, 3, 4) * 10_000), "sends more records"),
        ((0, 1, None, 1, 4), "sent 0x1 and 0x4, which begin no record of its kind, .* 3 values"),
        ((0, 1, None, 2, 28), "which has 27 values"),
        ((0, 1, None, 3, 9), "which has 8 values"),
    ],
)
def test_a_board_that_goes_wrong_is_named_with_its_case(vectors, words, says):
    name, number = first_case(vectors)
    line = Scripted(*(number if word is None else word for word in words))
    with pytest.raises(VectorError, match=f"^{name}: .*{says}") as raised:
        run_on_board(line, vectors, name)
    assert raised.value.exit_code == 1
    assert line.heard[:4] == struct.pack("<I", MAGIC)


@pytest.fixture
def port():
    """Give the port of a board, and a function that starts what the board does."""
    board, host = pty.openpty()
    tty.setraw(host)
    over = threading.Event()
    threads = []

    def start(does) -> str:
        threads.append(threading.Thread(target=does, args=(board, over), daemon=True))
        threads[-1].start()
        return os.ttyname(host)

    yield start
    over.set()
    for thread in threads:
        thread.join(10)
    os.close(board)
    os.close(host)


def case_wanted(board: int) -> int:
    """Read how a case begins; return its number."""
    head = b""
    while len(head) < 20:
        head += os.read(board, 20 - len(head))
    return struct.unpack("<5I", head)[1]


def test_a_board_that_asks_and_does_not_read_is_given_up(vectors, port, run, refused, monkeypatch):
    """It asks for all bytes of a case whose image no line buffers."""
    design = Design(width=64, height=48, pixels=250, places=600, length=4, code_bits=3)
    suites = {"random": standard_suites(design, 0, "random")["random"][:1]}
    write_suites(vectors.parent / "large", design, suites, 0)
    (name, entry), *_ = load_manifest(vectors.parent / "large").cases()
    takes = entry.files["image.bin"].bytes + 8 * entry.events

    def does(board: int, over: threading.Event) -> None:
        os.write(board, struct.pack("<6I", 0, 1, case_wanted(board), READY, 1, takes))
        over.wait()

    opened = serial.serial_for_url

    def patient(*words, timeout, write_timeout):  # it takes its time to ask
        return opened(*words, timeout=60, write_timeout=write_timeout)

    monkeypatch.setattr(serial, "serial_for_url", patient)
    words = ["golden", "verify", vectors.parent / "large", "--timeout"]
    said = run(*words, 0.5, "--port", port(does), code=1).err
    assert f"{name}: the board asks for bytes and does not take them" in said
    assert "--timeout 0: expected seconds above 0" in refused(*words, 0, "--port", "none")


def test_a_board_without_room_for_any_case_is_an_error(vectors, port, run, monkeypatch):
    """And what it does is told in lines where there is no terminal."""
    monkeypatch.setattr(golden_verify, "_PROGRESS_S", 0.0)
    number = len(list((vectors / "filter").iterdir()))

    def does(board: int, over: threading.Event) -> None:
        for case in range(number):
            os.write(board, struct.pack("<6I", 0, 1, case_wanted(board), REFUSED, 1, 70_000 + case))

    said = run("golden", "verify", vectors, "--port", port(does), code=1).err
    assert re.search(rf"no case was run: {number} cases of more memory.*70,000 bytes", said)
    assert f"case {number} of {number}, filter/" in said


def test_each_step_of_a_case_is_shown(vectors):
    (name, number), shown = first_case(vectors), []
    taken = len((vectors / name / "image.bin").read_bytes())
    taken += len((vectors / name / "events.bin").read_bytes())
    half = Scripted(0, 1, number, READY, 1, taken // 2, READY, 1, taken - taken // 2, READY, 1, 0)
    run_on_board(half, vectors, name, shown.append)
    shares = ("", ": 0% sent", ": 50% sent")
    assert shown == [f"case 1 of 1, {name}{share}" for share in shares]


def test_a_case_too_large_for_the_board_is_left_out_and_said(vectors):
    name, number = first_case(vectors)
    returned = run_on_board(Scripted(0, 1, number, REFUSED, 1, 70_000), vectors, name)
    assert returned.too_large == {name: 70_000} and returned.records == []


def test_a_port_that_is_none_is_said(vectors, tmp_path, refused):
    words = ["golden", "verify", vectors, "--port", tmp_path / "none"]
    assert "cannot talk to a board at" in refused(*words, code=1)
    assert "not allowed with argument --port" in refused(*words, "--results", "a.csv")
