"""The examples run: a notebook, and firmware from its reset on."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from edge_vpr_tools.estimate.of_map import design_of, memories_of

from edge_vpr import __version__
from edge_vpr.reference_map import ReferenceMap
from firmware_model import Design
from firmware_model.emulation.build import EMULATED, build
from firmware_model.emulation.emulator import Emulator
from firmware_model.image import image, kept_bytes, ram_bytes
from firmware_model.specification import MatchResult
from firmware_model.vectors import Case, in_order, records, to_binary
from firmware_model.vectors.formats import case_header
from firmware_model.vectors.random_cases import random_memories
from tests.firmware_model.designs import random_stream, told

EXAMPLES = Path(__file__).parents[2] / "examples"
M4 = EXAMPLES / "firmware-m4"
DESIGN = Design(width=64, height=48, pixels=25, places=40, length=4, code_bits=3)


@pytest.mark.slow
def test_the_notebook_runs_from_top_to_bottom(tmp_path, monkeypatch):
    nbclient = pytest.importorskip("nbclient", reason="nbclient runs notebooks: extra test")
    nbformat = pytest.importorskip("nbformat", reason="nbformat reads notebooks: extra test")
    pytest.importorskip("ipykernel", reason="ipykernel runs the cells: extra test")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path))
    notebook = nbformat.read(EXAMPLES / "street.ipynb", as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert sum("image/png" in str(cell.outputs) for cell in cells) == 2, (
        "run tools/site/tutorial.py"
    )
    for cell in cells:
        assert "error" not in {output.output_type for output in cell.outputs}
        cell.outputs = []
        cell.source = cell.source.replace("LENGTH_M = 120.0", "LENGTH_M = 60.0")
    assert "LENGTH_M = 60.0" in cells[0].source
    cells.append(nbformat.v4.new_code_cell("evaluation.precision_at_100_recall"))
    notebook.cells.append(cells[-1])
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(
        notebook, timeout=120, kernel_name="python3", resources=resources
    ).execute()
    shown = [output for cell in cells for output in cell.outputs if "data" in output]
    assert sum("image/png" in output.data for output in shown) == 2
    assert sum("data:image/svg" in output.data.get("text/html", "") for output in shown) == 1
    assert float(shown[-1].data["text/plain"]) > 0.5
    assert "places" in cells[1].outputs[0].text


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """A header with a map and events of chance, and the matches that the model accepts."""
    rng = np.random.default_rng(5)
    memories = random_memories(rng, DESIGN)
    case = Case("drive", memories, tuple(random_stream(rng, memories, 3_000)))
    trace = case.trace()
    header = tmp_path_factory.mktemp("map") / "case.h"
    header.write_text(
        case_header(
            case.name, case.start, ram_bytes(DESIGN), kept_bytes(DESIGN), image(memories),
            case.event_bytes(), to_binary(records(in_order(trace))),
        )
    )  # fmt: skip
    matches = [each for each in in_order(trace) if isinstance(each, MatchResult) and each.accepted]
    assert len(matches) > 20
    return header, len(matches), matches[-1].place


def need(*programs: str) -> None:
    for program in programs:
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")


def with_gcc(header: Path, folder: Path) -> list[list[str]]:
    return [["make", "-C", str(M4), f"MAP={header}", f"OUT={folder}"]]


def with_zig(header: Path, folder: Path) -> list[list[str]]:
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("ziglang is not installed")
    zig = f"CC={sys.executable} -m ziglang cc -target thumb-freestanding-eabi"
    return [[*with_gcc(header, folder)[0], zig, "CPU=-mcpu=cortex_m4", "LIBS="]]


def with_cmake(header: Path, folder: Path) -> list[list[str]]:
    words = [f"-DMAP={header}", "--toolchain", "arm-none-eabi.cmake"]
    return [["cmake", "-S", str(M4), "-B", str(folder), *words], ["cmake", "--build", str(folder)]]


@pytest.mark.parametrize("build", [with_gcc, with_zig, with_cmake])
def test_the_firmware_finds_the_models_matches_from_reset_on(build, expected, tmp_path):
    header, matches, place = expected
    commands = build(header, tmp_path)
    need(commands[0][0], *["arm-none-eabi-gcc"] * (build is not with_zig))
    for command in commands:
        done = subprocess.run(command, capture_output=True, text=True, cwd=M4, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "warning" not in done.stdout + done.stderr
    values = boot(tmp_path / "firmware.elf")
    assert values == {"refused": 0, "matches": matches, "place": place}


def test_the_firmware_is_built_of_the_map_that_is_named_also_of_an_older_one(expected, tmp_path):
    """And says in QEMU what it found there; a map that is not there is an error."""
    need("make", "arm-none-eabi-gcc", "qemu-system-arm")
    header, matches, place = expected
    damaged = tmp_path / "damaged.h"
    damaged.write_text(header.read_text().replace("0x49525056U", "0U", 1))
    assert damaged.read_text() != header.read_text()
    os.utime(damaged, (0, 0))

    def run(named: Path) -> subprocess.CompletedProcess[str]:
        (command,) = with_gcc(named, tmp_path / "build")
        return subprocess.run([*command, "run"], capture_output=True, text=True, check=False)

    other = tmp_path / "other.h"  # the last record, of a match, has another place
    before, last = header.read_text().rsplit(f"0x{place:08X}U", 1)
    other.write_text(f"{before}0x{place + 1:08X}U{last}")
    said = f"{matches} matches, the last one at place {place}"
    for named, refused, says in (
        (header, False, f"{said}, as in the vectors"), (damaged, True, "holds no map"),
        (header, False, said), (tmp_path / "none.h", True, "none.h is no file"),
        (other, True, f"{said}; the vectors have {matches} matches, the last one at"),
    ):  # fmt: skip
        done = run(named)
        assert (done.returncode != 0) == refused
        assert says in done.stdout + done.stderr


@pytest.mark.parametrize("generator", ["Unix Makefiles", "Ninja"])
def test_cmake_builds_of_the_map_as_it_is_and_only_what_changed(expected, tmp_path, generator):
    """Also of an older map, under the same name or under another."""
    need("cmake", "arm-none-eabi-gcc", *["ninja"] * (generator == "Ninja"))
    maps = [tmp_path / name for name in ("map.h", "older.h")]
    for path in maps:
        shutil.copy(expected[0], path)
    maps[1].write_text(maps[0].read_text().replace("0x49525056U", "0U", 1))
    os.utime(maps[1], (0, 0))
    built, program = tmp_path / "build", tmp_path / "build" / "firmware.elf"

    def build() -> tuple[int, bytes]:
        done = subprocess.run(
            ["cmake", "--build", str(built)], capture_output=True, text=True, check=True
        )
        return done.stdout.count("Building"), program.read_bytes()

    def name(path: Path) -> None:
        words = [*with_cmake(path, built)[0], "-G", generator]
        subprocess.run(words, capture_output=True, check=True, cwd=M4)

    name(maps[0])
    _, first = build()
    assert build() == (0, first)
    name(maps[1])
    one, second = build()
    assert one == 1 and second != first
    name(maps[0])
    assert build() == (1, first)
    shutil.copy2(maps[1], maps[0])
    assert build() == (1, second)


def boot(elf: Path, flash: int = 0, ram_bytes: int = 64 << 10) -> dict[str, int]:
    """Reset an emulated Cortex-M4 whose flash holds the program; RAM holds what nobody wrote."""
    unicorn = pytest.importorskip("unicorn", reason="unicorn emulates the processor")
    elffile = pytest.importorskip("elftools.elf.elffile", reason="pyelftools reads the program")
    board = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    board.ctl_set_cpu_model(unicorn.arm_const.UC_CPU_ARM_CORTEX_M4)
    board.mem_map(flash, 512 << 10)
    board.mem_map(0x2000_0000, ram_bytes)
    board.mem_write(0x2000_0000, b"\xa5" * ram_bytes)
    with elf.open("rb") as file:
        parsed = elffile.ELFFile(file)
        for segment in parsed.iter_segments("PT_LOAD"):
            board.mem_write(segment["p_paddr"], segment.data())
        symbols = {
            symbol.name: (symbol["st_value"], symbol["st_size"])
            for symbol in parsed.get_section_by_name(".symtab").iter_symbols()
        }
    stack, reset = struct.unpack("<2I", board.mem_read(flash, 8))
    assert (stack, reset & 1) == (0x2000_0000 + ram_bytes, 1)
    board.reg_write(unicorn.arm_const.UC_ARM_REG_SP, stack)
    board.emu_start(reset, symbols["finished"][0] & ~1, count=20_000_000)
    at = board.reg_read(unicorn.arm_const.UC_ARM_REG_PC)
    assert at & ~1 == symbols["finished"][0] & ~1
    return {
        name: int.from_bytes(board.mem_read(*symbols[name]), "little")
        for name in ("refused", "matches", "place")
    }


def test_a_map_is_put_into_the_flash_of_a_board_alone(street, tmp_path, run):
    """At its own address, by its .hex file; .bin and .h have the same bytes."""
    pytest.importorskip("ziglang", reason="ziglang is not installed (extra firmware)")
    pytest.importorskip("unicorn", reason="unicorn is not installed (extra firmware)")
    convert, hexed = ["convert", street / "map.npz"], tmp_path / "map.hex"
    shown = run(*convert, hexed, "--address", "0x08048010").out
    for name in ("map.bin", "map.h"):
        run(*convert, tmp_path / name)
    reference = ReferenceMap.load(street / "map.npz")
    memories = memories_of(reference, design_of(reference))
    flash, ram = image(memories), ram_bytes(memories.design)
    said = f"{len(flash):,} bytes of flash at 0x08048010; {ram + 252:,} bytes of RAM: {ram:,} for"
    assert said in shown
    # as a programmer reads the file
    board, upper = Emulator(EMULATED[1], build(EMULATED[1], tmp_path)), 0
    for line in hexed.read_text("ascii").split():
        size, at, kind = struct.unpack(">BHB", bytes.fromhex(line[1:9]))
        data = bytes.fromhex(line[9 : 9 + 2 * size])
        if kind == 4:
            upper = int.from_bytes(data, "big") << 16
        elif kind == 0:
            board.flash(upper + at, data)
    assert board.get(0x0804_8010, len(flash)) == flash == (tmp_path / "map.bin").read_bytes()
    stream = random_stream(np.random.default_rng(0), memories, 300, 0)
    case = Case("drive", memories, tuple(stream), 0)
    # the whole sector of the flash, of which the image is a part
    arguments = 0x0804_8010, 0x1_0000, board.put(case.event_bytes()), len(case.events), 1, 0
    out = board.put(bytes(1 << 20))
    words = board.call("vpr_replay", *arguments, board.put(bytes(ram)), ram, out, 1 << 18)
    assert board.get(out, 4 * words) == told(case)
    for suffix in ("c", "cpp"):
        source = tmp_path / f"print.{suffix}"
        source.write_text(
            '#include "map.h"\n#include <stdio.h>\nint main(void) '
            "{ return fwrite(map, 1, MAP_BYTES, stdout) == MAP_BYTES ? 0 : 1; }\n"
        )
        command = [sys.executable, "-m", "ziglang", "cc", str(source), "-Wall", "-Werror"]
        subprocess.run([*command, "-o", str(tmp_path / "print")], check=True)
        assert subprocess.check_output([tmp_path / "print"]) == flash
    assert f"#define MAP_RAM_BYTES {ram}U" in (tmp_path / "map.h").read_text("ascii")


def test_firmware_without_a_map_says_what_to_name(tmp_path):
    need("make")
    command = ["make", "-C", str(M4), f"OUT={tmp_path}"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode != 0
    assert "is no file: make MAP=" in run.stderr


def test_the_library_for_arduino_has_all_files_that_the_page_names(tmp_path):
    """The folder `src` that the page describes compiles by itself, also where `int` is short."""
    properties = (EXAMPLES / "arduino" / "library.properties").read_text("utf-8").splitlines()
    assert f"version={__version__}" in properties
    page = (EXAMPLES.parent / "docs" / "firmware.md").read_text(encoding="utf-8")
    (said,) = re.findall(r"(`vpr\.c`, `vpr\.h`.*?)in `firmware_model/c`", page, re.DOTALL)
    for name in re.findall(r"`(\w+\.[ch])`", said):
        shutil.copy(EXAMPLES.parent / "firmware_model" / "c" / name, tmp_path / name)
    for compiler in (["gcc"], ["avr-gcc", "-mmcu=atmega1284p"]):
        if shutil.which(compiler[0]) is None:
            continue
        words = [*compiler, "-std=gnu11", "-Os", "-Wall", "-Werror", "-c", "vpr.c"]
        done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, check=False)
        assert done.returncode == 0, done.stderr
