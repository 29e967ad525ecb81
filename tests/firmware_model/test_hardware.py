"""The hardware core: it returns the golden vectors, and its parameters are those of the model."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from bisect import bisect_left
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from firmware_model import Design, ToolError, VectorError, cost
from firmware_model.design import MARGIN_TOP, RESIDUAL_TOP, formats_of
from firmware_model.hardware import parameters as boards
from firmware_model.hardware import replay, report, simulation, sources
from firmware_model.hardware.parameters import PACKAGE, constants, package, package_with, tables
from firmware_model.hardware.simulation import Conditions
from firmware_model.specification import (
    Event,
    Filter,
    FilterMap,
    activity_of,
    ilog,
    is_pause,
    mean_activity_after,
    row_of,
    see,
)
from firmware_model.vectors import (
    check_files,
    load_manifest,
    read_results,
    standard_suites,
    verify,
    write_suites,
)
from firmware_model.vectors.case import Stream
from firmware_model.vectors.random_cases import (
    random_adaptive_design,
    random_cases,
    random_design,
    random_memories,
)
from firmware_model.verification import proof
from fixedpoint.activity import BANK_COSTS

#: full scale and events of a window are small, so that a simulation of all corners is short
DESIGN = Design(
    width=24, height=16, pixels=9, places=20, length=3, code_bits=3, window_events=12, lanes=4
)
FILTER = replace(DESIGN, matching="filter", length=1)
ADAPTIVE = replace(FILTER, code="contrast")
#: what a map has by default
GAINS = replace(ADAPTIVE, gains=7)


def needs(*tools):
    missing = [tool for tool in tools if not shutil.which(tool)]
    return pytest.mark.skipif(bool(missing), reason=f"{', '.join(missing)} not installed")


needs_iverilog = needs("iverilog", "vvp")


def write_vectors(folder, design, seed=3, suite="corners", cases=slice(None)):
    suites = {suite: standard_suites(design, seed, suite)[suite][cases]}
    write_suites(folder, design, suites, seed, rtl=True)
    return folder


def ran(*command, cwd=None, code=0):
    """Run a program, check its exit code, and return it with what it printed."""
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done


def held(folder, design, suites, *conditions):
    """Hold the core to cases under each of some conditions; return the verdicts."""
    write_suites(folder / "v", design, suites, 3, rtl=True)
    verdicts = [replay.hold(folder / "v", each) for each in conditions]
    assert [verdict.differences for verdict in verdicts] == [[] for _ in conditions]
    return verdicts


@pytest.fixture(scope="module")
def vectors(tmp_path_factory):
    """Vectors of a small design, with the core's sources."""
    return write_vectors(tmp_path_factory.mktemp("hardware") / "vectors", DESIGN)


@pytest.mark.slow
@needs_iverilog
def test_the_core_returns_every_corner_under_stalls_and_a_reset(vectors):
    """Memories and registers start undefined; both sides wait in four clocks of ten."""
    outcome = replay.hold(vectors, Conditions(seed=5, stall=40, resets=1))
    assert outcome.differences == []
    assert outcome.cases == len(load_manifest(vectors).suites[0].cases) > 30
    assert min(outcome.compared.values()) > 200


@needs_iverilog
def test_icarus_compiles_the_core_and_its_bench_without_a_warning(vectors, tmp_path):
    """As docs/hardware.md does it, without Python."""
    files = [vectors / "corners" / "tie_of_two" / "vpr_pkg.sv", *(vectors / "rtl").glob("*.sv")]
    command = ["iverilog", "-g2012", "-s", "vpr_bench", "-o", tmp_path / "core.vvp"]
    done = ran(*command, *files)
    assert (done.stdout, done.stderr) == ("", "")


@needs_iverilog
def test_a_case_is_verified_as_the_page_does_it_without_python(vectors, tmp_path):
    """In the folder of a case; the exit code says that all is equal."""
    page = (Path(__file__).parents[2] / "docs" / "hardware.md").read_text(encoding="utf-8")
    commands = page.partition("Without Python")[2].split("```")[1]
    shutil.copytree(vectors, tmp_path / "vectors")
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    done = subprocess.run(
        ["sh", "-e", "-c", commands], cwd=tmp_path / "vectors" / "corners" / "tie_of_two",
        env=os.environ | {"PATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "results.csv: 1 of " in done.stdout


def drawn_design(seed):
    """One of sequences, of the place filter, contrast codes or both, or of seven gains."""
    rng = np.random.default_rng(seed)
    if seed < 30:
        return random_design(rng)
    if seed < 34:
        return random_adaptive_design(rng)
    drawn = iter(lambda: random_adaptive_design(rng, gains=(7,)), None)
    design = next(design for design in drawn if design.gains > 1)
    return replace(design, places=[1, design.places, 8][seed % 3])


@needs_iverilog
@pytest.mark.parametrize("seed", [21, 22, *range(31, 37)])
def test_the_core_returns_random_cases_of_random_designs(tmp_path, seed):
    """Both kinds of window, lanes that do not divide the slots, down to one place."""
    design = drawn_design(seed)
    cases = {"random": standard_suites(design, seed, "random")["random"][:1]}
    (outcome,) = held(tmp_path, design, cases, Conditions(seed=seed, stall=30, resets=2))
    assert outcome.compared["event"] == 2000


@needs_iverilog
@pytest.mark.parametrize("design", [replace(DESIGN, length=1), FILTER, ADAPTIVE, GAINS])
def test_the_first_windows_may_end_before_all_counters_are_drained(tmp_path, design):
    """Its clock starts sooner than it drains 20 counters, and at once comes an event of later."""
    design = replace(
        design, pixels=20, places=2, lookup_depth=0, window="time", tau_us=20, timestamp_bits=7
    )
    stream = Stream(design)
    stream.skip(2)
    for window in range(3):
        stream.fill([(slot + window) % 3 for slot in range(design.slots)])
    stream.close()
    case = stream.case("silent", [[slot % 3 + k for slot in range(design.slots)] for k in range(2)])
    conditions = (Conditions(), Conditions(reset_at=700), Conditions(5, stall=40, resets=1))
    for outcome in held(tmp_path, design, {"silent": [case]}, *conditions):
        assert outcome.compared["window"] == 5


@needs_iverilog
@pytest.mark.parametrize(("length", "lanes"), [(5, 9), (3, 2), (1, 4)])
def test_registers_behind_slow_memories_change_no_record(tmp_path, length, lanes):
    """Places that take as many clocks as a sequence has windows, and more; and single windows."""
    design = replace(DESIGN, length=length, lanes=lanes, window="count")
    cases = random_cases(design, np.random.default_rng(length), 1, 600)
    conditions = [Conditions(5, stall=stall, resets=2, slow_blocks=True) for stall in (0, 40)]
    for outcome in held(tmp_path, design, {"random": cases}, *conditions):
        assert outcome.compared["match"] > 10


def short_filter_cases(design, most_events=700):
    """Cases of the suite `filter` whose simulation is short: most of them, of all kinds."""
    cases = standard_suites(design, 3, "filter")["filter"]
    return [case for case in cases if len(case.events) <= most_events]


@pytest.mark.slow
@needs_iverilog
def test_the_core_returns_the_place_filters_corners_under_stalls_and_a_reset(tmp_path):
    """Counts and contrast codes, pauses, places at half windows; the command has all cases."""
    cases = short_filter_cases(FILTER)
    kinds = {(case.design.code, case.design.places_per_window) for case in cases}
    assert kinds == {("counts", 1), ("counts", 2), ("contrast", 1), ("contrast", 2)}
    (outcome,) = held(tmp_path, FILTER, {"filter": cases}, Conditions(seed=5, stall=40, resets=1))
    assert outcome.cases == len(cases)
    assert min(outcome.compared.values()) > 100


@pytest.mark.slow
@needs_iverilog
def test_the_core_returns_the_corners_of_seven_gains_under_stalls_and_a_reset(tmp_path):
    """Each fact of them, such as a change of gain or a window in which gains look at all sums."""
    cases = short_filter_cases(GAINS, most_events=1500)
    assert {case.design.places_per_window for case in cases} == {1, 2}
    (stalled,) = held(
        tmp_path / "all", GAINS, {"filter": cases}, Conditions(seed=5, stall=40, resets=1)
    )
    assert min(stalled.compared.values()) > 200
    # what does not wait takes as long as all others: every fourth case
    others = Conditions(slow_blocks=True), Conditions(reset_at=1900)
    for outcome in held(tmp_path / "some", GAINS, {"filter": cases[::4]}, *others):
        assert min(outcome.compared.values()) > 50


@pytest.mark.slow
@needs_iverilog
@pytest.mark.parametrize("design", [DESIGN, GAINS], ids=["sequences", "seven gains"])
def test_a_core_of_one_size_returns_the_cases_of_its_own(tmp_path, design):
    """All of one program, as of one bitstream."""
    cases = [c for c in standard_suites(design, 3, "own")["own"] if len(c.events) <= 1500]
    (outcome,) = held(tmp_path, design, {"own": cases}, Conditions(seed=5, stall=40, resets=2))
    assert len({p.read_bytes() for p in (tmp_path / "v").rglob(f"{PACKAGE}.sv")}) == 1
    assert outcome.cases == len(cases) > 4


@pytest.mark.slow
@needs_iverilog
@pytest.mark.parametrize("suite", ["corners", "filter", "random"])
def test_registers_behind_slow_memories_change_no_corner(tmp_path, suite):
    """Sequences, the place filter and contrast codes, under stalls and resets."""
    names = ("tie_of_three", "events_by_time", "all_places_equal", "random_0")
    design = random_adaptive_design(np.random.default_rng(36)) if suite == "random" else ADAPTIVE
    if suite == "filter":
        cases = short_filter_cases(design)[::3]
    else:
        cases = [case for case in standard_suites(design, 3, suite)[suite] if case.name in names]
    assert cases
    conditions = Conditions(seed=5, stall=40, resets=2, slow_blocks=True)
    (outcome,) = held(tmp_path, design, {suite: cases}, conditions)
    assert min(outcome.compared[kind] for kind in ("event", "window", "match")) > 5


#: clocks from a window's end until its activity stands, in which no event is counted
SETTLING = 10 * 32 + 3


def steps_to_a_code(design):
    """Clocks of encoding beyond those of the model."""
    return 5 * design.contrast


def core_cycles(design, slow_blocks=False):
    """Clocks from a window's end to its match, as docs/hardware.md says."""
    if design.filters:
        return filter_cycles(design, slow_blocks)
    model = cost.cycles(design)
    period = max(design.words, design.length, 2)
    added = (design.places - 1) * (period - max(design.words, design.length))
    levels = (design.lanes - 1).bit_length()
    around = (9 if design.length == 1 else 10) + steps_to_a_code(design)
    slow = slow_blocks * (1 + (design.length > 1))
    return model.match + added + levels - design.words + around + slow


def filter_cycles(design, slow_blocks=False):
    """Clocks of the filter after its first window, which takes a pass and two divisions more."""
    levels = (design.lanes - 1).bit_length() + slow_blocks
    distances = (design.places - 1) * max(design.words, 2) + levels
    metrics = 2 * design.places - 4
    # the middle of the places that may be told takes longer than the trust
    around = (30 if design.places_per_window == 2 else 28) + design.steps.bit_length()
    # the metrics wait for the activity, which takes longer than the mean of small maps
    encoded = cost.encoding_cycles(design) + steps_to_a_code(design)
    mean = max(encoded + distances + 7, SETTLING)
    return mean + formats_of(design)["distance_total"].width + metrics + around


def replayed(folder, case, conditions=simulation.UNDISTURBED):
    """Replay one case, hold the core to it, and return what the simulation noted."""
    vectors = folder / f"vectors-{conditions.slow_blocks}"
    write_suites(vectors, case.design, {"random": [case]}, 1, rtl=True)
    ((_, done),) = simulation.replay_vectors(vectors, folder, conditions)
    assert verify(vectors, done.records).differences == []
    return done


@needs_iverilog
@pytest.mark.parametrize("slow_blocks", [False, True])
def test_an_event_is_taken_in_each_clock(tmp_path, slow_blocks):
    """All of a window, often of the same pixel; none is taken while its end is set."""
    design = replace(DESIGN, tau_us=1000)
    (case,) = random_cases(design, np.random.default_rng(7), 1, 10)
    rng = np.random.default_rng(8)
    pixels = [*case.memories.pixels[:3], (0, 0)]
    times = (*range(300), *range(2000, 2100))
    events = [Event(t, *pixels[rng.integers(4)], bool(rng.integers(2))) for t in times]
    case = replace(case, events=tuple(events), start=0)
    done = replayed(tmp_path, case, Conditions(slow_blocks=slow_blocks))
    # the first of the next window is taken, and waits in the first stage
    assert done.events_in_a_row == 300 + 1


@needs_iverilog
@pytest.mark.parametrize(
    "design",
    [
        DESIGN,
        replace(DESIGN, length=1),
        replace(DESIGN, lanes=1, places=6),
        replace(DESIGN, lanes=9, length=1, places=9),
        replace(DESIGN, lanes=16, length=4),
        replace(DESIGN, code="contrast"),
        replace(FILTER, window="count"),
        replace(ADAPTIVE, window="count", lanes=9, places=9),
        replace(ADAPTIVE, window="count", places=90, lanes=2),
        replace(FILTER, window="count", places_per_window=2),
        replace(ADAPTIVE, window="count", places=70),
        replace(ADAPTIVE, window="count", places=120, places_per_window=2),
    ],
)
def test_a_match_takes_the_clocks_that_the_documentation_says(tmp_path, design):
    """Every match of a case, where nothing waits, and with registers behind memories."""
    case = standard_suites(design, 1, "random")["random"][0]
    short = replace(case, events=case.events[:600])
    assert len(short.trace().matches) > 5
    for slow_blocks in (False, True):
        done = replayed(tmp_path, short, Conditions(slow_blocks=slow_blocks))
        stated = core_cycles(design, slow_blocks)
        assert done.least_cycles == stated
        # of a filter, the first window needs its own spread
        assert done.most_cycles > stated if design.filters else done.most_cycles == stated


@needs_iverilog
@pytest.mark.parametrize("places", [20, 150])
def test_a_match_of_seven_gains_takes_the_clocks_of_the_model_and_some_hundred(tmp_path, places):
    """Which counts all sums of windows, and the changes of gain behind the match."""
    design = replace(GAINS, places=places, lanes=2)
    case = standard_suites(design, 1, "random")["random"][0]
    case = replace(case, events=case.events[:600])
    # a third of the reference's events, so that gains look at all sums
    counted = [state.counted for state in case.trace().states]
    activity = 3 * 256 * sum(counted) // len(counted)
    case = replace(case, memories=replace(case.memories, activity=activity))
    assert 7 in {state.sums for state in case.trace().states if not state.paused}
    done = replayed(tmp_path, case)
    changes = 2 * (places + 1) * (design.gains + 1)  # behind the match
    over = done.most_cycles - (cost.cycles(design).match - changes)
    assert 0 < over < 450


def test_the_page_has_the_clocks_of_a_window_of_seven_gains():
    page = (Path(__file__).parents[2] / "docs" / "hardware.md").read_text(encoding="utf-8")
    (design,) = (design for design in report.KINDS.values() if design.gains > 1)
    clocks = cost.cycles(design).match
    design_of = f"{design.pixels} pixels, {design.places} places and {design.lanes} lanes"
    assert f"the longest, of {design_of}, takes {clocks:,} clocks" in " ".join(page.split())
    assert clocks < 48e6 / 500


def test_a_match_takes_at_most_eight_clocks_more_than_the_model_says():
    """Of maps of usual size: the first place is compared while the descriptor is encoded."""
    robot = replace(report.DOCUMENTED, matching="filter", length=1, code="contrast")
    for design in (report.DOCUMENTED, robot):
        for lanes in (1, 2, 4, 8, 16):
            laned = replace(design, lanes=lanes)
            assert core_cycles(laned) - cost.cycles(laned).match <= 8


def values_of_package(tmp_path, design):
    """Value of each constant of a design's package, as Icarus Verilog has it."""
    text = package(design)
    names = re.findall(r"localparam (?:int|bit|logic \[\d+:0\])\s+(\w+)", text)
    shown = "".join(f'$display("%0d", {PACKAGE}::{name});' for name in names)
    bench = f"{text}\nmodule bench; initial begin {shown} end endmodule\n"
    values = [value for (value,) in simulated(tmp_path, bench, [])]
    return dict(zip(names, values, strict=True))


#: quantities of the model that the package has by another name, and those that are made of others
SAME = {"sequence": "sum", "prediction": "metric", "limit": "count"}
INNER = {"event_log", "weight", "place_activity", "level_total", "cost"}


@needs_iverilog
def test_the_packages_widths_are_those_of_the_model(tmp_path):
    """Of designs of several kinds, and of random ones; its constants are those of the design."""
    rng = np.random.default_rng(11)
    drawn = [draw(rng) for draw in (random_design, random_adaptive_design) for _ in range(8)]
    wide = replace(DESIGN, tau_us=5_000_000_000, timestamp_bits=40)
    for design in (*KINDS, *drawn, wide, report.DOCUMENTED):
        values = values_of_package(tmp_path, design)
        assert values.items() >= constants(design).items()
        assert (values["SLOTS"], values["WORDS"]) == (design.slots, design.words)
        assert values["RESIDUAL_TOP"] == RESIDUAL_TOP == MARGIN_TOP
        assert values["EVENT_TIME_BITS"] == (32 if design.timestamp_bits <= 32 else 64)
        for name, form in formats_of(design).items():
            if name not in INNER:
                assert values[f"{SAME.get(name, name).upper()}_BITS"] == form.width, name


def test_the_package_has_no_constant_that_a_design_leaves_out():
    """A name that it does not have is refused."""
    text = (sources.FOLDER / f"{PACKAGE}.sv").read_text(encoding="ascii")
    first = re.search(r"// The design(.*)// What follows", text, re.S)[1]
    declared = re.findall(r"localparam (?:int|bit|logic \[\d+:0\])\s+(\w+)", first)
    assert declared == list(constants(ADAPTIVE))
    assert declared == list(constants(DESIGN))
    with pytest.raises(ToolError, match="no constant WIDHT"):
        package_with({"WIDHT": 3})


@needs_iverilog
def test_the_words_of_a_case_have_the_widths_of_the_cores_ports(tmp_path):
    """Of a match with its trust, and of the mean activity; all tables are there."""
    folder = write_vectors(tmp_path / "v", ADAPTIVE, 3, "random", slice(1))
    (case,) = load_manifest(folder).suites[0].cases
    last = case.words["expected_matches"][-1]
    assert last.field == "trust"
    values = values_of_package(tmp_path, ADAPTIVE)
    assert last.lowest_bit + last.bits == values["MATCH_BITS"]
    assert case.words["activity"][0].bits == values["ACTIVITY_BITS"]
    assert {f"{name}.mem" for name in (*tables(ADAPTIVE), "activity")} <= set(case.files)


@pytest.mark.slow
def test_golden_vectors_with_hardware_are_told_by_their_manifest(tmp_path, run):
    """Sources beside the suites, parameters in each case."""
    DESIGN.save(tmp_path / "d.toml")
    run("golden", "--design", tmp_path / "d.toml", "-o", tmp_path / "v", "--rtl")
    written = {str(p.relative_to(tmp_path / "v")) for p in (tmp_path / "v").rglob("*.*")}
    assert written == set(load_manifest(tmp_path / "v").files())
    assert {f"rtl/{name}" for name in sources.SIMULATED} <= written
    assert check_files(tmp_path / "v") > 0


@pytest.mark.slow
@needs_iverilog
def test_the_bench_in_python_replays_a_case_and_finds_a_fault(tmp_path):
    """By cocotb, under stalls and a reset, in a project's folder."""
    pytest.importorskip(
        "cocotb", reason="cocotb is not installed: pip install 'edge-vpr[hardware]'"
    )
    write_vectors(tmp_path / "vectors", DESIGN, 3, "corners", slice(1))
    shutil.copytree(tmp_path / "vectors" / "rtl", tmp_path / "src")
    (tmp_path / "cocotb").mkdir()
    shutil.copy(sources.COCOTB_BENCH, tmp_path / "cocotb")
    command = [sys.executable, f"cocotb/{sources.COCOTB_BENCH.name}", "--stall", 30]
    assert "1 cases, 0 differ" in ran(*command, cwd=tmp_path).stdout
    check_files(tmp_path / "vectors")  # nothing is left beside them
    file = tmp_path / "src" / "vpr_counters.sv"
    text = file.read_text("ascii")
    assert text.count("} + 1") == 1
    file.write_text(text.replace("} + 1", "} - 1"), "ascii")
    broken = ran(*command, cwd=tmp_path, code=1)
    assert "1 cases, 1 differ" in broken.stdout
    assert "m_event 0 is" in broken.stdout + broken.stderr


@pytest.mark.slow
@needs("yosys", "make")
def test_a_project_is_written_and_read_by_yosys(tmp_path, run, refused):
    """All that its Makefile names is there; a folder with something in it is refused."""
    DESIGN.save(tmp_path / "d.toml")
    core = tmp_path / "core"
    run("hardware", "--design", tmp_path / "d.toml", "-o", core)
    assert check_files(core / "vectors") > 0
    plan = ran("make", "-n", cwd=core).stdout
    script = re.search(r'-p "(read_verilog .*); synth_ice40', plan)[1]
    other = ran("make", "-n", "ulx3s", cwd=core).stdout
    assert "synth_ecp5 -top vpr_ulx3s" in other
    assert "--lpf ulx3s.lpf --freq 100 --json ulx3s.json --textcfg ulx3s.config" in other
    assert (core / "src" / "vpr_ulx3s.sv").exists()
    check = f"read_verilog -lib +/ice40/cells_sim.v; {script}; hierarchy -check -top vpr_up5k; proc"
    ran("yosys", "-q", "-p", check, cwd=core)
    assert "icepack icebreaker.asc icebreaker.bin" in plan
    bench = ran("make", "-n", "--no-print-directory", "cocotb", cwd=core).stdout
    assert (core / bench.split()[1]).read_bytes() == sources.COCOTB_BENCH.read_bytes()
    said = refused("hardware", "--design", tmp_path / "d.toml", "-o", core)
    assert "not an empty folder" in said


def test_vectors_without_sources_are_refused_in_one_line(tmp_path):
    write_suites(
        tmp_path / "v", DESIGN, {"random": standard_suites(DESIGN, 0, "random")["random"][:1]}, 0
    )
    with pytest.raises(VectorError, match="golden --rtl"):
        next(simulation.replay_vectors(tmp_path / "v", tmp_path))


KINDS = [
    DESIGN,
    replace(DESIGN, window="count", lanes=5),
    replace(DESIGN, timestamp_bits=40, length=1, lanes=1),
    replace(ADAPTIVE, trust=100),
    replace(FILTER, window="count", places=1, lanes=9),
    replace(DESIGN, code="contrast", code_bits=8),
    replace(ADAPTIVE, restart=16),
    replace(ADAPTIVE, places_per_window=2),
    replace(DESIGN, code="contrast"),
    GAINS,
    replace(GAINS, places_per_window=2, lanes=9, places=32),
]


@needs("yosys")
@pytest.mark.parametrize(
    ("design", "slow_blocks"), [*((design, False) for design in KINDS), (KINDS[2], True)]
)
def test_the_memories_of_the_core_are_those_of_the_cost_model(design, slow_blocks, tmp_path):
    """Depth and width of each, of the netlist; a single window needs none for past distances."""
    sized = cost.memories(design, slow_blocks)
    if design.length == 1:
        sized.pop("history", None)
    stated = sorted(memory for memory in sized.values() if memory.bits)
    assert netlist_memories(design, slow_blocks, tmp_path) == stated


def netlist_memories(design: Design, slow_blocks: bool, folder: Path) -> list[cost.Memory]:
    """The memories of a core, sorted, before they are mapped to those of an FPGA."""
    report.write_tables(design, folder)
    files = [folder / f"{PACKAGE}.sv", *(sources.FOLDER / file for file in sources.DEVICE)]
    proof.run_yosys(
        [
            f"read_verilog -sv {' '.join(map(str, files))}",
            f"chparam -set SLOW_BLOCKS {int(slow_blocks)} vpr_core",
            "hierarchy -check -top vpr_core; proc; flatten; opt_clean; memory_collect",
            f"write_json {folder / 'core.json'}",
        ],
        "core",
        folder,
    )
    written = json.loads((folder / "core.json").read_text(encoding="utf-8"))
    core = written["modules"]["vpr_core"]
    memories = [
        cost.Memory(*(int(cell["parameters"][size], 2) for size in ("SIZE", "WIDTH")))
        for cell in core["cells"].values()
        if cell["type"].startswith("$mem")
    ]
    # the delay line of an exclusion of 0 is a register
    registers = [
        cost.Memory(1, len(core["netnames"][name]["bits"]))
        for name in core["netnames"]
        if name.endswith("search.delay.oldest_o") and design.exclusion == 0
    ]
    return sorted([*memories, *registers])


@needs("verilator")
@pytest.mark.parametrize("design", KINDS)
def test_the_sources_are_free_of_lint(tmp_path, design):
    """All of Verilator's warnings, for designs of several kinds, with slow block memories too."""
    (tmp_path / f"{PACKAGE}.sv").write_text(package(design), encoding="ascii")
    files = [tmp_path / f"{PACKAGE}.sv", *(sources.FOLDER / name for name in sources.DEVICE)]
    axi = [*files, *(sources.FOLDER / name for name in (sources.REGISTERS, sources.AXI))]
    spi = [sources.FOLDER / "vpr_spi.sv"]
    slow = ["-GSLOW_BLOCKS=1'b1", *files]
    tops = (("vpr_core", files), ("vpr_core", slow), ("vpr_spi", spi), ("vpr_axi_lite", axi))
    for top, chosen in tops:
        done = ran("verilator", "--lint-only", "-Wall", "--top-module", top, *chosen)
        assert done.stderr == ""


def matches_of_bench(tmp_path, suite, case, top, names, *plus):
    """Hold the matches that a testbench of the core's surroundings writes to those of a case."""
    write_suites(tmp_path / "v", case.design, {suite: [case]}, 3, rtl=True)
    folder = tmp_path / "v" / suite / case.name
    files = [folder / f"{PACKAGE}.sv"]
    files += [sources.FOLDER / name for name in (*sources.DEVICE, *names)]
    ran("iverilog", "-g2012", "-s", top, "-o", tmp_path / "bench.vvp", *files)
    words = [f"+case={suite}/{case.name}", f"+results={tmp_path / 'results.csv'}", *plus]
    said = ran("vvp", "-n", tmp_path / "bench.vvp", *words, cwd=folder).stdout
    verdict = verify(tmp_path / "v", read_results(tmp_path / "results.csv"), kinds=("match",))
    assert (verdict.differences, said) == ([], "")
    assert verdict.compared["match"] == len(case.trace().matches) > 0


def first_events(design, suite, name, number):
    """A case of a suite, of which the first events are taken."""
    (whole,) = [c for c in standard_suites(design, 3, suite)[suite] if c.name == name]
    return replace(whole, events=whole.events[:number])


@pytest.mark.slow
@needs_iverilog
@pytest.mark.parametrize(("suite", "name"), [("corners", "tie_of_three"), ("random", "windows_0")])
def test_the_board_returns_matches_through_its_spi(tmp_path, suite, name):
    """Start time, mean activity, places and events as bytes in, status and matches out."""
    case = first_events(ADAPTIVE, suite, name, 150)
    names = (*boards.ICEBREAKER.sources, sources.UP5K_BENCH)
    matches_of_bench(tmp_path, suite, case, "vpr_up5k_bench", names)
    assert len(case.trace().matches) >= 3


@needs_iverilog
@pytest.mark.parametrize(
    ("suite", "name", "design"),
    [
        ("corners", "tie_of_three", replace(DESIGN, lanes=13)),
        ("random", "windows_0", ADAPTIVE),
        ("random", "windows_1", replace(ADAPTIVE, places_per_window=2)),
        ("random", "windows_1", GAINS),
        ("random", "random_0", replace(FILTER, timestamp_bits=40, places=5)),
    ],
)
def test_a_map_is_loaded_and_matches_are_read_over_axi_lite(tmp_path, suite, name, design):
    """Tables that start undefined, places of one and two parts, and events, as a driver writes."""
    case = first_events(design, suite, name, 600)
    names = (sources.REGISTERS, sources.AXI, sources.AXI_BENCH)
    matches_of_bench(tmp_path, suite, case, "vpr_axi_bench", names, "+stall=30")


def test_package_and_header_have_the_same_registers():
    package, header = (
        (sources.FOLDER / name).read_text(encoding="ascii")
        for name in (sources.REGISTERS, sources.HEADER)
    )
    rows = re.findall(r"^#define VPR_(\w+) 0x(\w\w)U /\* (?:read|write)", header, re.MULTILINE)
    addresses = dict(rows)
    assert len(addresses) == len(rows) > 20
    assert dict(re.findall(r"\[7:0\] (\w+) += 8'h(\w\w);", package)) == addresses
    used = set(re.findall(r"vpr_registers::(\w+)", (sources.FOLDER / sources.AXI).read_text()))
    assert used == {*addresses, "ID_VALUE"}


#: a line for each window: whether it pauses, the mean activity behind it, its activity, and clocks
ACTIVITY_BENCH = """
module bench;
    logic clk = 0, load = 1, counted = 0, window_end = 0;
    logic settled, pauses;
    logic [9:0] activity_inverse;
    logic [8:0] events[WINDOWS];
    int clocks;
    vpr_activity activity (
        .clk_i(clk), .load_i(load), .start_activity_i(14'd START), .counted_i(counted),
        .window_end_i(window_end), .settled_o(settled), .pauses_o(pauses),
        .activity_inverse_o(activity_inverse)
    );
    always #1 clk = !clk;
    initial begin
        $readmemh("events.mem", events);
        // a reset while the mean activity moves
        @(negedge clk) load = 0;
        window_end = 1;
        @(negedge clk) window_end = 0;
        repeat (STOP) @(negedge clk);
        load = 1;
        @(negedge clk) load = 0;
        for (int window = 0; window < WINDOWS; window++) begin
            for (int event_ = 0; event_ < events[window]; event_++) begin
                counted = 1;
                @(negedge clk) if ($urandom % 4 == 0) begin
                    counted = 0;
                    @(negedge clk);
                end
            end
            counted = 0;
            @(negedge clk);
            $write("%0d ", pauses);
            window_end = 1;
            clocks = 0;
            @(negedge clk) window_end = 0;
            while (!settled) @(negedge clk) clocks++;
            $display("%0d %0d %0d", activity.mean_q, $signed(~activity_inverse), clocks);
        end
        $finish;
    end
endmodule
"""


def simulated(tmp_path, bench, units, **values):
    """Lines of numbers that a testbench of some units prints, with these values of constants."""
    (tmp_path / "bench.sv").write_text(bench, encoding="ascii")
    files = ["bench.sv"]
    if units:
        files.insert(0, f"{PACKAGE}.sv")
        (tmp_path / files[0]).write_text(package_with(values), encoding="ascii")
    files += [sources.FOLDER / unit for unit in units]
    ran("iverilog", "-g2012", "-s", "bench", "-o", "bench.vvp", *files, cwd=tmp_path)
    said = ran("vvp", "-n", "bench.vvp", cwd=tmp_path).stdout
    lines = (line.split() for line in said.splitlines() if re.match(r"-?\d", line))
    return [[int(word) for word in line] for line in lines]


@needs_iverilog
@pytest.mark.parametrize(("filters", "gains"), [(1, 1), (1, 7), (0, 1)])
def test_the_activity_is_that_of_the_model_though_the_number_of_events_saturates(
    tmp_path, filters, gains
):
    """At 63, in a unit of 6 bits, by one event too many up to nearly eight times as many."""
    rng = np.random.default_rng(5)
    # the first window is at a threshold, or one below it, or between both
    cases = [
        (0, [1]), (1, [0]), (0, [0, 0]), (2 << 11, [2]), ((2 << 11) + 1, [2]),
        ((2 << 11) + (1 << 10), [2]), (63 << 8, [500]),
        # by its last event no pause, whose mean activity would lose more by rounding
        ((2 << 11) + (1 << 8), [3]),
    ]  # fmt: skip
    # or the second one is, behind one that moves the mean activity there, a pause or none
    for mean_activity, second in ((1 << 11, 1), (2 << 11, 2), (3 << 11, 3)):
        for counted, pause in ((1, True), (5, False)):
            starts = (n for n in range(1 << 14) if mean_activity_after(n, counted) == mean_activity)
            start = next(starts)
            assert is_pause(counted, start) == pause
            cases.append((start, [counted, second]))
    for start, first in cases:
        events = rng.choice([0, 1, 2, 3, 4, 5, 6, 7, 40, 62, 63, 64, 65, 127, 128, 300, 500], 120)
        events[: len(first)] = first
        numbers = "\n".join(f"{n:x}" for n in events)
        (tmp_path / "events.mem").write_text(numbers, encoding="ascii")
        text = ACTIVITY_BENCH.replace("WINDOWS", str(len(events))).replace("START", str(start))
        text = text.replace("STOP", str(rng.integers(153)))
        units = ("vpr_rom.sv", "vpr_logarithm.sv", "vpr_activity.sv")
        small = {"WINDOW_EVENTS_BITS": 6, "FILTER": filters, "GAINS": gains}
        returned_lines = simulated(tmp_path, text, units, **small)
        mean_activity, expected = start, []
        for counted in events.tolist():
            number = min(counted, 63)
            pauses = int(is_pause(number, mean_activity))
            relative = activity_of(number, start if gains > 1 else mean_activity) if filters else 0
            mean_activity = mean_activity_after(mean_activity, number)
            expected.append([pauses, mean_activity, relative, (10 if filters else 1) * 15 + 3])
        assert returned_lines == expected
        assert {pauses for pauses, *_ in expected} == {0, 1}


#: a line for each number: its logarithm
LOGARITHM_BENCH = """
module bench;
    logic clk = 0, valid = 0, number = 0, decide = 0;
    logic [4:0] round;
    logic [8:0] inverse;
    logic [22:0] n, numbers[0:NUMBERS-1];
    vpr_logarithm logarithm (
        .clk_i(clk), .round_i(round), .valid_i(valid), .number_i(number),
        .decide_i(decide), .inverse_o(inverse)
    );
    always #1 clk = !clk;
    initial begin
        $readmemh("numbers.mem", numbers);
        for (int at = 0; at < NUMBERS; at++) begin
            n = numbers[at];
            round = 16;
            for (int turn = 0; turn < 5; turn++) begin
                repeat (1 + $urandom % 3) @(negedge clk);
                for (int place = 0; place < 24; place++) begin
                    valid = 1;
                    number = place < 23 && n[place < 23 ? place : 0];
                    @(negedge clk);
                end
                valid = 0;
                round = {round[0], round[4:1]};
                @(negedge clk) decide = 1;
                @(negedge clk) decide = 0;
            end
            $display("%0d", 511 - inverse);
        end
        $finish;
    end
endmodule
"""


@needs_iverilog
def test_a_logarithm_is_exact_about_every_power_of_two(tmp_path):
    """On both sides of each of 368, of the largest and the least number, and of others."""
    # the least number whose logarithm is so large, by its definition
    steps = [bisect_left(range(1 << 23), step, key=ilog) for step in range(1, 369)]
    numbers = {0, (1 << 23) - 1, *steps, *(step - 1 for step in steps)}
    chosen = np.random.default_rng(3).permutation(sorted(numbers)).tolist()
    (tmp_path / "numbers.mem").write_text("\n".join(f"{n:x}" for n in chosen), encoding="ascii")
    text = LOGARITHM_BENCH.replace("NUMBERS", str(len(chosen)))
    assert simulated(tmp_path, text, ["vpr_logarithm.sv"]) == [[ilog(n)] for n in chosen]


#: a line for each window: the rank of the highest gain
SPEED_BENCH = """
module bench;
    logic clk = 0, rst = 1, settled = 1, has_few = 0, ready;
    logic [9:0] windows[0:WINDOWS-1];
    logic [9:0] activity;
    logic [3:0] rank;
    vpr_speed speed (
        .clk_i(clk), .rst_i(rst), .settled_i(settled), .has_few_i(has_few),
        .activity_inverse_i(~activity), .ready_o(ready), .rank_o(rank)
    );
    always #1 clk = !clk;
    initial begin
        $readmemh("windows.mem", windows);
        @(negedge clk) rst = 0;
        for (int window = 0; window < WINDOWS; window++) begin
            settled = 0;
            repeat (6) @(negedge clk);
            settled = 1;
            activity = windows[window];
            // it stands two clocks behind
            repeat (2) @(negedge clk);
            has_few = window % 5 == 3;
            @(negedge clk);
            while (!ready) @(negedge clk);
            $display("%0d", rank);
        end
        $finish;
    end
endmodule
"""


@needs_iverilog
@pytest.mark.parametrize("spread", [4, 40, 400])
def test_sums_of_the_gains_are_those_of_the_model(tmp_path, spread):
    """Of any mean speed; windows with few events do not move it."""
    rng = np.random.default_rng(spread)
    drawn = np.clip(np.cumsum(rng.integers(-spread, spread + 1, 300)), -368, 368)
    activities = [-368, *drawn.tolist(), *[368] * 90]
    numbers = "\n".join(f"{activity % 1024:x}" for activity in activities)
    (tmp_path / "windows.mem").write_text(numbers, encoding="ascii")
    text = SPEED_BENCH.replace("WINDOWS", str(len(activities)))
    printed = simulated(tmp_path, text, ["vpr_speed.sv"])
    filter_map = FilterMap.of(random_memories(rng, GAINS))
    state = Filter([[0] * GAINS.places] * GAINS.gains)
    for window, (activity, (rank,)) in enumerate(zip(activities, printed, strict=True)):
        seen = see(filter_map, state, activity, window % 5 == 3)
        state = state._replace(speed=seen.speed, moved=seen.moved)
        ranks = [max(rank - lower, 0) for lower in reversed(range(GAINS.gains))]
        assert list(seen.looks) == [(rank > 0) + (rank > 2) for rank in ranks]


#: a line for each activity of a place and of a window, and whether the robot stands: the costs of
#: steps of 0, 1 ... places
COSTS_BENCH = """
module bench;
    logic clk = 0;
    logic stands;
    logic [9:0] activity;
    logic [7:0] of_place;
    logic [7*STEPS-1:0] costs;
    vpr_step_costs #(.LOADABLE(1)) step_costs (
        .clk_i(clk), .load_i(1'b0), .load_address_i(20'd0), .load_word_i(32'd0),
        .activity_inverse_i(~activity), .stands_i(stands), .place_i(1'b1), .of_place_o(of_place),
        .costs_o(costs)
    );
    always #1 clk = !clk;
    initial begin
        for (int place = -128; place < 128; place += 17)
            for (int window = -368; window <= 368; window++) begin
                step_costs.place_activity.memory[1] = place;
                activity = window;
                stands = $urandom % 8 == 0;
                repeat (3) @(negedge clk);
                $write("%0d %0d %0d", $signed(of_place), window, stands);
                for (int step = 0; step < STEPS; step++) $write(" %0d", costs[7*step+:7]);
                $display("");
            end
        $finish;
    end
endmodule
"""


@needs_iverilog
@pytest.mark.parametrize("restart", [120, 20, 0])
@pytest.mark.parametrize("table", BANK_COSTS.values(), ids=BANK_COSTS)
def test_step_costs_are_those_of_the_models_table(tmp_path, table, restart):
    """Of any activity of a window and of some of a place; none is above that of a restart."""
    units, steps = ("vpr_rom.sv", "vpr_step_costs.sv"), len(table[0])
    packed = sum(cost << 7 * at for at, cost in enumerate(chain(*table)))
    values = {"PLACES": 2, "STEPS": steps, "STEP_COSTS": packed, "RESTART": restart}
    rows = simulated(tmp_path, COSTS_BENCH.replace("STEPS", str(steps)), units, **values)
    assert len(rows) == 16 * 737
    for place, window, stands, *costs in rows:
        row = table[0 if stands else row_of(window - place)]
        assert costs == [min(cost, restart) for cost in row]
    moving = {row_of(window - place) for place, window, stands, *_ in rows if not stands}
    assert moving == set(range(19))


@needs_iverilog
def test_a_core_that_stands_still_is_a_fault_after_so_many_clocks(tmp_path):
    """However busy the computer is: a slow simulation of a sound core is none."""
    folder = write_vectors(tmp_path / "v", DESIGN, 3, "random", slice(1))
    file = folder / "rtl" / "vpr_events.sv"
    text = file.read_text(encoding="ascii")
    still = re.sub(r"assign s_event_tready = .*;", "assign s_event_tready = 1'b0;", text)
    assert still != text
    file.write_text(still, encoding="ascii")
    with pytest.raises(ToolError, match="neither takes an event nor comes to an end, after 0"):
        replay.hold(folder, Conditions(seed=5, stall=0, resets=0))


@needs_iverilog
def test_a_simulation_without_an_end_is_ended_by_the_processors_time(tmp_path):
    """A loop that takes no clock, which the testbench cannot count."""
    (tmp_path / "loop.sv").write_text("module loop; initial while (1) ; endmodule", "ascii")
    ran("iverilog", "-g2012", "-o", tmp_path / "loop.vvp", tmp_path / "loop.sv")
    with pytest.raises(ToolError, match="more than 1 s of the processor"):
        simulation.run_bench(
            tmp_path / "loop.vvp", tmp_path, "loop", tmp_path / "results.csv",
            simulation.UNDISTURBED, seconds=1,
        )  # fmt: skip


@pytest.mark.slow
@needs_iverilog
@pytest.mark.parametrize(
    ("words", "cases"),
    [
        (["--events", "3000", "--slow-blocks"], 1),
        (["--designs", "1", "--suite", "random", "--seed", "4"], 5),
    ],
)
def test_the_replay_command_makes_its_own_cases(capsys, words, cases):
    """One of many events, or the random cases of random designs."""
    assert replay.main([*words, "--stall", "10"]) == 0
    told = rf"^{cases} cases, 0 differ; equal: [\d,]+ event"
    assert re.search(told, capsys.readouterr().out, re.M)


def test_the_replay_command_takes_one_source_of_cases(capsys):
    with pytest.raises(SystemExit):
        replay.main(["--designs", "1", "--events", "5"])
    assert "--designs, or one of --events" in capsys.readouterr().err


#: in place of a tool: it counts its runs, and says what the report looks for
TOOL = """#!/bin/sh
echo "$@" >> {log}
case "$*" in *"-json core.json"*) touch core.json; esac
echo "Yosys 0.1" "Version 0.2"
for cell in LC RAM SPRAM DSP; do echo "ICESTORM_$cell: 7/ 10" >&2; done
echo "Max frequency for clock 'clk': 5$(wc -l < {log}).0 MHz" >&2
"""


@needs("sh")
def test_the_report_has_the_cells_of_a_design_and_the_clocks_of_its_seeds(
    tmp_path, monkeypatch, capsys
):
    """A design is synthesized once, and placed for each seed."""
    log = tmp_path / "runs"
    for name in ("yosys", "nextpnr-ice40"):
        (tmp_path / name).write_text(TOOL.format(log=log), "ascii")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    DESIGN.save(tmp_path / "d.toml")
    command = ["--design", str(tmp_path / "d.toml"), "--board", "icebreaker"]
    assert report.main([*command, "--seeds", "2"]) == 0
    runs = log.read_text("ascii")
    assert (runs.count("synth_ice40"), runs.count("--seed")) == (1, 2)
    assert 'iCE40UP5K,7 of 10,7 of 10,7 of 10,7 of 10,"52.0 to 53.0, 2 seeds"' in (
        capsys.readouterr().out
    )


def test_each_claim_has_a_line_and_one_without_an_answer_does_not_end_the_others(
    monkeypatch, capsys
):
    """By name, with the seconds."""

    def answer(claim):
        if claim is proof.PREDICTION:
            raise ToolError("yosys-abc took more than 5 s")
        return claim is not proof.DELAY

    monkeypatch.setattr(proof, "holds", answer)
    assert proof.main([]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(": ", 1)[0] for line in lines] == [claim.name for claim in proof.CLAIMS]
    assert f"{proof.PREDICTION.name}: NO ANSWER, yosys-abc took more than 5 s, 0 s" in lines
    assert f"{proof.DELAY.name}: NOT PROVED, 0 s" in lines
    assert proof.main(["--only", "best and second"]) == 0


def test_each_claim_is_about_constants_that_there_are():
    """Those of the long ones too, which only the command proves."""
    for claim in proof.CLAIMS:
        assert (package_with(claim.constants) == package_with({})) == (not claim.constants)


#: claims that take seconds; the command has all
QUICK_CLAIMS = (proof.SMALL_SEARCH, proof.PREDICTION, proof.DELAY)


@needs("yosys", "yosys-abc")
@pytest.mark.parametrize("claim", QUICK_CLAIMS, ids=lambda claim: claim.top)
def test_the_search_the_prediction_and_the_delay_are_proved(claim):
    """Of small sizes, for any number of clocks."""
    assert proof.holds(claim)


#: a part of each unit's source, and what makes its claim wrong
WRONG = {
    proof.SMALL_SEARCH.top: (
        "nearer_q ? oldest_place_q : left_q",
        "leaves ? oldest_place_q : left_q",
    ),
    proof.PREDICTION.top: ("right < left ? right : left", "right < left ? left : right"),
    proof.DELAY.top: (".read_address_i(push_i ? at_d : at_q)", ".read_address_i(at_q)"),
}


@pytest.mark.slow
@needs("yosys", "yosys-abc")
@pytest.mark.parametrize("claim", QUICK_CLAIMS, ids=lambda claim: claim.top)
def test_a_claim_does_not_hold_of_a_wrong_unit(claim):
    file, (right, wrong) = claim.files[-1], WRONG[claim.top]
    text = sources.text_of(file)
    assert text.count(right) == 1
    assert not proof.holds(claim, {file: text.replace(right, wrong)})


@needs("yosys")
@pytest.mark.parametrize("board", boards.BOARDS)
@pytest.mark.parametrize("design", KINDS)
def test_yosys_reads_the_board_design(tmp_path, design, board):
    """Modules, parameters and processes; `firmware_model.hardware.report` does all of it."""
    report.write_tables(design, tmp_path)
    chosen = boards.BOARDS[board]
    files = " ".join(map(str, report.source_files(tmp_path, chosen)))
    script = f"read_verilog -sv {files}; hierarchy -check -top {chosen.top}; proc; check -assert"
    cells = {"icebreaker": "ice40/cells_sim.v", "ulx3s": "ecp5/cells_bb.v"}[board]
    done = ran("yosys", "-q", "-p", f"read_verilog -lib +/{cells}; {script}", cwd=tmp_path)
    assert "ERROR" not in done.stderr + done.stdout


def test_missing_tools_are_told_in_one_line(tmp_path, monkeypatch, capsys):
    """Each command names what to install."""
    folder = write_vectors(tmp_path / "v", DESIGN, 3, "random", slice(1))
    monkeypatch.setenv("PATH", str(tmp_path))
    for run, words, remedy in (
        (replay.main, [str(folder)], "install iverilog"),
        (proof.main, [], "install yosys"),
        (report.main, ["--seeds", "1"], "apt install yosys"),
    ):
        assert run(words) == 1
        said = capsys.readouterr().err
        assert remedy in said
        assert said.count("\n") == 1
