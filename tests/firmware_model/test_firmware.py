"""The reference firmware on every target: it does what the vectors say, at the stated cost."""

from __future__ import annotations

import csv
import re
import shutil
import socket
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from firmware_model import Design, DesignError, Event, Memories, ToolError
from firmware_model.emulation import tables
from firmware_model.emulation.build import COUNTED, EMULATED, GCC, HOST, SOURCES, Target, build
from firmware_model.emulation.emulator import OUT_WORDS, Emulator
from firmware_model.emulation.instructions import (
    FILTER,
    GAINS,
    TABLE,
    FirmwareRun,
    Instructions,
    measure,
    table,
)
from firmware_model.image import STRUCT_BYTES, Word, image, page, ram_bytes, sealed
from firmware_model.specification import Machine, MatchResult, WindowResult
from firmware_model.vectors import (
    Case,
    corner_cases,
    filter_cases,
    from_binary,
    standard_suites,
)
from firmware_model.vectors.case import choose_pixels
from firmware_model.vectors.random_cases import random_design, random_memories
from firmware_model.verification.images import image_cases
from tests.firmware_model.designs import drawn_drive, run_host, told, wrapped

pytest.importorskip("ziglang", reason="ziglang is not installed (extra firmware)")
pytest.importorskip("unicorn", reason="unicorn is not installed (extra firmware)")
pytest.importorskip("elftools", reason="pyelftools is not installed (extra firmware)")

DESIGN = Design(width=64, height=48, pixels=25, places=40, length=4, code_bits=3)
IMAGES = image_cases()


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """One folder for all that is compiled, and the compiler's cache."""
    return tmp_path_factory.mktemp("firmware")


@pytest.fixture(scope="session")
def cases() -> dict[str, list[Case]]:
    """The suites that any design has, and that of the filter and contrast codes."""
    adaptive = replace(DESIGN, matching="filter", length=1, code="contrast")
    several = replace(adaptive, gains=7)
    suites = {
        "corners": corner_cases(DESIGN),
        "random": standard_suites(DESIGN, 0, "random")["random"],
        "filter": filter_cases(adaptive),
        "gains": [
            replace(case, name=f"{case.name}_of_seven_gains") for case in filter_cases(several)
        ],
    }
    for design in (DESIGN, several):
        suites[f"own of {design.gains}"] = [
            replace(case, name=f"{case.name}_of_{design.gains}_of_its_own")
            for case in standard_suites(design, 0, "own")["own"]
        ]
    return suites


@pytest.fixture(scope="session")
def expected(cases) -> dict[str, bytes]:
    """What the model says to each case."""
    return {c.name: told(c) for suite in cases.values() for c in suite}


def emulated(emulator: Emulator, case: Case) -> bytes:
    flash, ram = image(case.memories), ram_bytes(case.design)
    return emulator.replay(flash, case.event_bytes(), case.start, ram, out_words=OUT_WORDS)


@pytest.fixture(scope="session", params=EMULATED, ids=lambda target: target.name)
def emulator(request, folder) -> Emulator:
    return Emulator(request.param, build(request.param, folder))


def test_every_suite_passes_on_every_emulated_processor(emulator, cases, expected):
    """Records of every event, window and match are the model's, to the byte."""
    for suite in cases.values():
        for case in suite:
            assert emulated(emulator, case) == expected[case.name], case.name


def test_every_suite_passes_on_this_computer(folder, cases, expected):
    """The same sources as an ordinary program."""
    program = build(HOST, folder)
    for suite in cases.values():
        for case in suite:
            assert run_host(program, case, folder) == expected[case.name], case.name
    (folder / "us.mem").write_text("us\n")
    for wrong in (folder / "none.mem", "", folder / "us.mem"):
        words = [program, folder / "image", folder / "events", wrong, folder / "out"]
        assert subprocess.run(words, capture_output=True, check=False).returncode == 2


@pytest.mark.slow
def test_events_may_be_handed_over_in_batches(emulator, cases, expected):
    """The same windows and matches for 2, 7 or all events at a time."""
    for case in (*cases["corners"], *cases["filter"]):
        whole = [r for r in from_binary(expected[case.name]) if r[0] != "event"]
        for batch in (2, 7, 1 << 20):
            flash, ram = image(case.memories), ram_bytes(case.design)
            records = emulator.replay(flash, case.event_bytes(), case.start, ram, batch)
            assert list(from_binary(records)) == whole, (case.name, batch)


def test_a_saved_state_goes_on_where_it_was(emulator, cases, expected):
    """After each window it is saved, all memory is lost, and it is restored at another address."""
    for case in (*cases["corners"], *cases["filter"]):
        flash, ram = image(case.memories), ram_bytes(case.design)
        records = emulator.replay(flash, case.event_bytes(), case.start, 2 * ram)
        assert records == expected[case.name], case.name


class Running(NamedTuple):
    """A design on an emulated processor, from the beginning on."""

    emulator: Emulator
    design: int
    state: int
    ram: int

    @classmethod
    def of(cls, emulator: Emulator, memories: Memories) -> Running:
        emulator.release()
        flash = image(memories)
        at, design, state, ram = map(
            emulator.put, (flash, bytes(512), bytes(512), bytes(ram_bytes(memories.design)))
        )
        assert emulator.call("vpr_open", design, at, len(flash)) & 1
        emulator.call("vpr_reset", design, state, ram, 0)
        return cls(emulator, design, state, ram)


def test_a_device_that_is_told_the_time_loses_no_window_in_a_silence(folder):
    """Of many periods of its clock; without it, all but the windows of half a period are lost."""
    emulator = Emulator(EMULATED[1], build(EMULATED[1], folder))
    for changes in ({}, {"matching": "filter", "length": 1, "code": "contrast"}):
        design = replace(DESIGN, timestamp_bits=12, tau_us=100, **changes)
        memories = random_memories(np.random.default_rng(0), design)
        device, machine = Running.of(emulator, memories), Machine(memories)
        match, windows = emulator.put(bytes(64)), 0
        for now in range(0, 50_000, 97):
            due = emulator.call("vpr_time", device.design, device.state, now % (1 << 12))
            # an event off the sensor ends windows, and does nothing else
            results = list(machine.take(Event(now % (1 << 12), 99, 99, True)))
            assert due == sum(isinstance(result, WindowResult) for result in results) <= 1
            windows += due
            for _ in range(due):
                emulator.call("vpr_window_end", device.design, device.state)
                emulator.call("vpr_match_places", device.design, device.state, match)
        assert windows == now // 100
        matches = [result for result in results if isinstance(result, MatchResult)]
        assert not matches or emulator.get(match, 8) == struct.pack("<II", *matches[-1][:2])


@pytest.mark.parametrize("late", [-1, 0, 99, 100, (1 << 31) - 1, 1 << 31, (1 << 31) + 1])
def test_the_time_ends_as_many_windows_as_an_event_would(folder, late):
    """Up to half a period after the open window's end, that included; before it, none."""
    emulator = Emulator(EMULATED[1], build(EMULATED[1], folder))
    memories = random_memories(np.random.default_rng(0), replace(DESIGN, tau_us=100))
    device = Running.of(emulator, memories)
    now = (100 + late) % (1 << 32)
    left = (100 - now + (1 << 31)) % (1 << 32) - (1 << 31)  # section 2 of the specification
    expected = 0 if left > 0 else -left // 100 + 1
    assert emulator.call("vpr_time", device.design, device.state, now) == expected
    by_count = random_memories(np.random.default_rng(0), replace(DESIGN, window="count"))
    device = Running.of(emulator, by_count)
    assert emulator.call("vpr_time", device.design, device.state, now) == 0


def test_a_state_of_another_map_is_not_resumed(folder):
    """Its arrays would be of another size."""
    emulator = Emulator(EMULATED[1], build(EMULATED[1], folder))
    rng = np.random.default_rng(0)
    device = Running.of(emulator, random_memories(rng, DESIGN))
    state = emulator.get(device.state, 512)
    assert emulator.call("vpr_resume", device.design, device.state, device.ram) & 1
    device = Running.of(emulator, random_memories(rng, DESIGN))
    other = emulator.put(state)
    assert not emulator.call("vpr_resume", device.design, other, device.ram) & 1
    assert emulator.get(other, 512) == state


def test_the_header_is_for_cpp_and_the_sources_for_little_endian(tmp_path):
    """A program in C++ links the C functions; a big-endian compiler refuses them."""
    (tmp_path / "main.cpp").write_text(
        '#include "vpr.h"\n'
        "int main() { vpr_design_t d; uint32_t none = 0; return vpr_open(&d, &none, 0) ? 1 : 0; }\n"
    )
    zig = [sys.executable, "-m", "ziglang"]
    program, files = tmp_path / "program", [tmp_path / "main.o", tmp_path / "vpr.o"]
    for language, source, out in zip(
        ("c++", "cc"), (tmp_path / "main.cpp", SOURCES / "vpr.c"), files, strict=True
    ):
        command = [*zig, language, f"-I{SOURCES}", "-c", str(source), "-o", str(out)]
        subprocess.run(command, check=True)
    subprocess.run([*zig, "cc", *map(str, files), "-o", str(program)], check=True)
    assert subprocess.run([program], check=False).returncode == 0
    big = [*zig, "cc", "-target", "mips-freestanding-eabi", "-c", str(SOURCES / "vpr.c")]
    done = subprocess.run([*big, "-o", str(tmp_path / "big.o")], capture_output=True, check=False)
    assert done.returncode and b"the image is little-endian" in done.stderr


@pytest.mark.parametrize("adaptive", [False, True])
def test_random_designs_on_every_emulated_processor(emulator, adaptive):
    """60 of sequences; 60 with the place filter, contrast codes, or both, and with pauses."""
    paused = 0
    for seed in range(60):
        memories, start, events = drawn_drive(seed, adaptive=adaptive)
        case = Case(str(seed), memories, tuple(wrapped(events, memories.design)), start)
        assert emulated(emulator, case) == told(case), seed
        paused += sum(state.paused for state in case.trace().states)
    assert (paused > 100) == adaptive


ODD_DESIGNS = [
    *(random_design(np.random.default_rng(seed)) for seed in range(8)),
    Design(width=1, height=1, pixels=1, places=1, length=1, code="counts", code_bits=1),
    Design(width=3, height=1, pixels=3, places=1, length=1, exclusion=0, lanes=1, tau_us=1),
]


@pytest.mark.slow
@pytest.mark.parametrize("design", ODD_DESIGNS, ids=lambda d: f"{d.width}x{d.height}-{d.pixels}")
def test_suites_can_be_made_for_any_design_and_pass(design, folder):
    """Narrow clocks, one pixel, one bit: the cases that such a design has room for."""
    target = EMULATED[1]
    emulator = Emulator(target, build(target, folder))
    suites = standard_suites(design, seed=1)
    assert len(suites["corners"]) > 15
    for case in (*suites["corners"], *suites["random"]):
        assert emulated(emulator, case) == told(case), case.name


def test_ram_is_what_the_model_says_and_no_more(emulator, cases):
    """With 16 bytes less than `ram_bytes` the firmware refuses; with it, nothing beyond is hurt."""
    case = cases["corners"][0]
    flash, events, ram = image(case.memories), case.event_bytes(), ram_bytes(case.design)
    with pytest.raises(ToolError, match="refuses"):
        emulator.replay(flash, events, case.start, ram - 16)


@pytest.mark.slow
def test_a_firmware_that_writes_behind_its_ram_is_found(folder, tmp_path, cases):
    """By the program of this computer, which fills the memory there with a pattern."""
    sources = tmp_path / "c"
    shutil.copytree(SOURCES, sources)
    text = (sources / "vpr.c").read_text(encoding="ascii")
    behind = "s->windows++;\n    s->query[vpr_ram_bytes(d)] = 0U;"
    (sources / "vpr.c").write_text(text.replace("s->windows++;", behind), encoding="ascii")
    program, case = build(HOST, folder, sources=sources, name="behind"), cases["corners"][0]
    with pytest.raises(ToolError, match="byte 0 behind the RAM was written"):
        run_host(program, case, tmp_path)


def opens(emulator: Emulator, flash: bytes) -> bool:
    emulator.release()
    design, at = emulator.put(bytes(512)), emulator.put(flash)
    return bool(emulator.call("vpr_open", design, at, len(flash)) & 1)


def test_images_are_opened_up_to_their_limits_and_refused_beyond(emulator):
    """Every word of the header, every kind of entry of the tables, and how they are laid out."""
    wrong = [c.name for c in IMAGES if opens(emulator, c.image) != c.opens]
    assert wrong == []


def test_no_word_of_an_image_may_be_large(emulator, cases):
    """Any word of the header but times, the largest sum and what is reserved."""
    flash = bytearray(image(cases["corners"][0].memories))
    for word in set(Word) - {Word.WINDOW_KIND, Word.WINDOW, Word.LARGEST_SUM}:
        broken = flash.copy()
        broken[word * 4 : word * 4 + 4] = (0x7FFF_FFF0).to_bytes(4, "little")
        changed = sealed(bytes(broken)) if word != Word.CRC else bytes(broken)
        assert opens(emulator, bytes(flash)) and not opens(emulator, changed), word


def test_the_replay_ends_when_its_results_are_full(emulator, cases):
    """A window of a microsecond, and an event half an hour later: 2^31 windows otherwise."""
    memories = cases["corners"][0].memories
    design = replace(memories.design, tau_us=1)
    short = Memories(design, memories.pixels, memories.places)
    case = Case("long", short, (Event((1 << 31) - 1, 0, 0, True),))
    flash, events, size = image(short), case.event_bytes(), ram_bytes(design)
    emulator.release()
    stimulus = emulator.put(flash), len(flash), emulator.put(events), 1, 1, 0
    emulator.patience_s = 5
    memory = emulator.put(bytes(size)), size, emulator.put(bytes(4000)), 1000
    assert emulator.call("vpr_replay", *stimulus, *memory) == 0


def test_designs_beyond_the_firmware_are_refused():
    """Wide codes and clocks, and sums that would not fit, each named."""
    for changes, message in (
        ({"code_bits": 9}, "codes up to 511"),
        ({"timestamp_bits": 40}, "timestamps"),
        ({"pixels": 3000, "code_bits": 5}, "a distance up to"),
    ):
        design = replace(DESIGN, **({"lookup_depth": 0} | changes))
        memories = random_memories(np.random.default_rng(0), design)
        with pytest.raises(DesignError, match=message):
            image(memories)


@pytest.fixture(scope="session")
def measured(folder) -> dict[str, Instructions]:
    """Counted anew on every processor, by each compiler that is here."""
    with_gcc = shutil.which("arm-none-eabi-gcc") is not None
    return {one.name: measure(one, folder) for one in COUNTED if one != GCC or with_gcc}


@pytest.mark.slow
def test_the_table_of_instructions_is_true(measured):
    """Every figure beside the sources, if they are compiled by the version that it names."""
    told = TABLE.read_text(encoding="ascii").splitlines()
    counted = table(list(measured.values())).splitlines()
    assert told[0] == counted[0]
    assert [row["target"] for row in csv.DictReader(told)] == [one.name for one in COUNTED]
    for name in ("cortex-m0plus", "cortex-m4", "cortex-m7"):
        assert measured[name].filter_ram_bytes == ram_bytes(FILTER) + STRUCT_BYTES
    compilers = {row.compiler for row in measured.values()}
    same = [row for row in told[1:] if row.split(",")[2] in compilers]
    if not same:
        pytest.skip(f"the table is not of {compilers}")
    assert set(same) <= set(counted)


@pytest.mark.slow
def test_instructions_stay_within_their_limits(measured):
    """Per byte of a distance, and per event at a selected pixel and elsewhere."""
    for core in ("cortex-m4", "cortex-m7"):
        assert measured[core].sad_per_byte <= 2.0 and measured[core].event_selected <= 26
        assert measured[core].event_unselected <= 16
    for core in ("cortex-a53", "cortex-a72", "cortex-a76"):
        assert measured[core].sad_per_byte <= 0.7
    for row in measured.values():
        assert row.event_unselected < row.event_selected and row.code_bytes < 16_384
        assert row.stack_bytes < 512


@pytest.mark.slow
def test_the_filter_takes_less_than_sequences_of_five(measured):
    """A place and window, beside the distance that both need; its RAM grows by 3 bytes, or 10."""
    for core in ("cortex-m4", "cortex-m7"):
        row = measured[core]
        distance = row.sad_per_byte * 150
        assert row.filter_per_place - distance <= 0.95 * (row.match_per_place - distance), core
        # seven gains at half places, of which one looks at the sum of two windows
        assert row.gains_per_place <= 1.5 * row.half_per_place, core
    for design, bytes_a_place in ((FILTER, 3), (GAINS, 10)):
        more = replace(design, places=design.places + 800)
        assert ram_bytes(more) - ram_bytes(design) == bytes_a_place * 800


def test_counted_instructions_are_those_of_a_loop_by_hand(folder):
    """Of n rounds of three instructions, between one before and one behind; counted or not before.

    `movs r1, #0; again: adds r1, #1; cmp r1, r0; bne again; bx lr`
    """
    target = EMULATED[0]
    emulator = Emulator(target, build(target, folder, name="by-hand"))
    code = bytes.fromhex("0021 0131 8142 fcd1 7047")
    emulator.symbols["loop"] = (emulator.put(code) | 1, len(code))
    emulator.call("loop", 5)
    for rounds in (1, 2, 100):
        emulator.call("loop", rounds, count=True)
        assert emulator.instructions == 2 + 3 * rounds


@pytest.mark.parametrize(
    ("code", "instructions"),
    [
        # cmp r0, #1; ite eq; moveq r0, #2; movne r0, #3; bx lr
        ("0128 0cbf 0220 0320 7047", 5),
        # cmp r0, #1; itte ne; addwne r1, r1, #4095; movne r0, #0; moveq r0, #1; bx lr
        ("0128 1abf 01f6ff71 0020 0120 7047", 6),
        # cmp r0, #1; it eq; bxeq lr; movs r0, #0; cmp r0, #0; it eq; bxeq lr
        ("0128 08bf 7047 0020 0028 08bf 7047", {1: 3, 0: 7}),
    ],
)
def test_skipped_instructions_of_an_it_block_are_counted(folder, code, instructions):
    """A Cortex-M issues them too: as many whichever the condition is, but for a jump."""
    target = EMULATED[1]
    emulator = Emulator(target, build(target, folder, name="by-hand"))
    emulator.symbols["block"] = (emulator.put(bytes.fromhex(code)) | 1, len(code))
    for argument in (0, 1, 0):
        emulator.call("block", argument, count=True)
        expected = instructions if isinstance(instructions, int) else instructions[argument]
        assert emulator.instructions == expected


class Stepped:
    """A Cortex-M4 of QEMU, stepped through its port for debuggers; as `Emulator` for a run."""

    _RAM, _STACK, _RETURN = 0x2100_0000, 0x2040_8000, 0x3F_0000
    _SP, _LR, _PC, _XPSR = 13, 14, 15, 25

    def __init__(self, target: Target, elf: Path, folder: Path) -> None:
        self.symbols = Emulator(target, elf).symbols
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(str(folder / "gdb"))
            server.listen()
            command = ["qemu-system-arm", "-M", "mps2-an386", "-display", "none", "-S"]
            command += ["-monitor", "none", "-serial", "none", "-device", f"loader,file={elf}"]
            command += ["-chardev", f"socket,id=gdb,path={folder / 'gdb'}", "-gdb", "chardev:gdb"]
            self.process = subprocess.Popen(command)
            self._line, _ = server.accept()
        self._answers = self._line.makefile("rb")
        self._ask("qXfer:features:read:target.xml:0,ffb")  # before it, registers are not written
        self.release()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._answers.close()
        self._line.close()

    def _ask(self, text: str) -> str:
        self._line.sendall(b"$%s#%02x" % (text.encode(), sum(text.encode()) & 255))
        answer = b""
        while not answer.endswith(b"#"):
            answer += self._answers.read(1)
        self._answers.read(2)
        self._line.sendall(b"+")
        return answer.rpartition(b"$")[2][:-1].decode()

    def _write(self, register: int, value: int) -> None:
        assert self._ask(f"P{register:x}={value.to_bytes(4, 'little').hex()}") == "OK"

    def _read(self, register: int) -> int:
        return int.from_bytes(bytes.fromhex(self._ask(f"p{register:x}")), "little")

    def release(self) -> None:
        self._free = self._RAM

    def put(self, data: bytes) -> int:
        address = self._free
        self._free += -(-max(len(data), 1) // 16) * 16
        for at in range(0, len(data), 1_000):
            part = data[at : at + 1_000]
            assert self._ask(f"M{address + at:x},{len(part):x}:{part.hex()}") == "OK"
        return address

    def call(self, function: str, *arguments: int, count: bool = False) -> int:
        registers = {**dict(enumerate(arguments)), self._SP: self._STACK, self._XPSR: 1 << 24}
        registers |= {self._LR: self._RETURN | 1, self._PC: self.symbols[function][0] & ~1}
        for register, value in registers.items():
            self._write(register, value)
        self.instructions = 0
        if not count:
            assert self._ask(f"Z0,{self._RETURN:x},2") == "OK"
            self._ask("c")
            self._ask(f"z0,{self._RETURN:x},2")
        while self._read(self._PC) != self._RETURN:
            self._ask("s")
            self.instructions += 1
        return self._read(0)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("qemu-system-arm") is None, reason="apt install qemu-system-arm")
@pytest.mark.parametrize("design", [DESIGN, FILTER], ids=["sequences", "filter"])
def test_instructions_are_those_of_the_single_steps_of_another_emulator(folder, tmp_path, design):
    """The end of a window and a match."""
    target = EMULATED[1]
    elf = build(target, folder)
    stepped = Stepped(target, elf, tmp_path)
    try:
        small = Memories(design, choose_pixels(design), [[1] * design.slots] * design.places)
        counted, steps = (FirmwareRun(on, small) for on in (Emulator(target, elf), stepped))
        windows = 2 if design.filters else design.length
        assert counted.match(windows) == steps.match(windows)
    finally:
        stepped.close()


def test_a_firmware_that_does_not_return_is_given_up(folder):
    """`b .` in the place of a function."""
    emulator = Emulator(EMULATED[0], build(EMULATED[0], folder, name="by-hand"))
    emulator.symbols["loop"] = (emulator.put(bytes.fromhex("fee7")) | 1, 2)
    emulator.patience_s = 0.1
    with pytest.raises(ToolError, match="has not returned"):
        emulator.call("loop")


def test_the_header_is_written_from_the_layout_and_the_costs_of_steps():
    """The firmware has no number of its own of either; the core has the costs in its package."""
    assert (SOURCES / "tables.h").read_text(encoding="ascii") == tables.header()


def test_the_page_has_the_layout_of_the_image():
    """Words and tables, as `image` lays them out."""
    page_file = Path(__file__).parents[2] / "docs" / "firmware.md"
    assert page() in page_file.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="apt install cppcheck")
def test_the_page_names_every_rule_of_misra_that_the_firmware_deviates_from():
    """As cppcheck reports them."""
    command = ["cppcheck", "-q", "--enable=style", "--addon=misra", str(SOURCES / "vpr.c")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    rules = set(re.findall(r"misra-c2012-([\d.]+)", done.stderr))
    text = (Path(__file__).parents[2] / "docs" / "firmware.md").read_text(encoding="utf-8")
    (said,) = re.findall(r"\*\*MISRA C:2012\*\*.*?\n\n", text, re.DOTALL)
    assert rules and rules <= set(re.findall(r"\b\d+\.\d+\b", said))
