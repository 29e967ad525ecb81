"""An estimate: counts as in the specification, instructions as emulated, energy never invented."""

from __future__ import annotations

import argparse
import csv
import json
import re
import shutil
from collections import Counter
from dataclasses import fields, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from edge_vpr_tools.commands import estimate as estimate_arguments
from edge_vpr_tools.commands.estimate import workload_of
from edge_vpr_tools.estimate import emulation, fitting, targets
from edge_vpr_tools.estimate import model as counts
from edge_vpr_tools.estimate.fitting import FIRMWARE_LIMITS, Budget, Tried, on_target, recommend
from edge_vpr_tools.estimate.model import Mission, cost, firmware, instructions_of
from edge_vpr_tools.estimate.of_map import design_of, event_rates

from edge_vpr.errors import UsageError
from edge_vpr.recordings import open_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from firmware_model import Design
from firmware_model.cost import memories
from firmware_model.emulation.build import COUNTED, EMULATED, GCC, build
from firmware_model.emulation.emulator import Emulator
from firmware_model.emulation.instructions import DESIGN, FILTER, TABLE
from firmware_model.image import STRUCT_BYTES, image, image_bytes
from firmware_model.specification import accepts, distance, sequence_sums
from firmware_model.specification import search as search_sums
from firmware_model.vectors.random_cases import (
    random_adaptive_design,
    random_design,
    random_memories,
)

ROOT = Path(__file__).parents[2]
SMALL = Design(width=64, height=64, pixels=150, places=200)
RATE = Mission(events_per_s=1e5, selected_share=0.01, matches_per_s=1.0)


class Metered(int):
    """An integer that counts what is done with it; adding it to a plain 0 is no addition."""

    tally: ClassVar[Counter[str]] = Counter()

    def __sub__(self, other):
        return Metered(int(self) - int(other))

    def __abs__(self):
        Metered.tally["absolute_differences"] += 1
        return Metered(abs(int(self)))

    def __add__(self, other):
        Metered.tally["additions"] += isinstance(other, Metered)
        return Metered(int(self) + int(other))

    def __radd__(self, other):
        return Metered(int(self) + int(other))

    def __mul__(self, other):
        Metered.tally["multiplications"] += 1
        return Metered(int(self) * int(other))


def metered(rng, design, rows):
    """Random codes that count what is done with them."""
    drawn = rng.integers(0, design.code_max + 1, (rows, design.slots)).tolist()
    return [list(map(Metered, row)) for row in drawn]


@pytest.mark.parametrize("seed", range(25))
def test_operations_are_those_that_the_specification_does(seed):
    """Of a match of a random device, when the windows before have been compared."""
    rng = np.random.default_rng(seed)
    design = random_design(rng)
    query, *before = metered(rng, design, design.length)
    places = metered(rng, design, design.places)
    history = [[distance(codes, place) for place in places] for codes in before]
    Metered.tally.clear()
    newest = [distance(query, place) for place in places]
    best = search_sums(sequence_sums([newest, *history]), design.exclusion)
    assert accepts(design, best, 0) == (best.sum <= design.largest_sum)
    expected = counts.search_work(design)
    assert Metered.tally["absolute_differences"] == expected.absolute_differences
    assert Metered.tally["additions"] == expected.additions
    assert Metered.tally["multiplications"] == expected.multiplications == 0


def drawn_design(seed):
    """A random design of one of both profiles, and the generator that drew it."""
    rng = np.random.default_rng(seed)
    return (random_design, random_adaptive_design)[seed % 2](rng), rng


@pytest.mark.parametrize("seed", range(20))
def test_bytes_are_those_of_the_firmware_image(seed):
    """Without laying it out: flash to the byte, RAM as the C code asks for it."""
    design, rng = drawn_design(seed)
    assert image_bytes(design) == len(image(random_memories(rng, design)))


@pytest.fixture(scope="module")
def m4(tmp_path_factory):
    """The firmware for a Cortex-M4."""
    pytest.importorskip("ziglang")
    pytest.importorskip("unicorn")
    return build(EMULATED[1], tmp_path_factory.mktemp("m4"))


@pytest.mark.parametrize("seed", range(10))
def test_bytes_are_those_that_the_firmware_asks_for(seed, m4):
    """Its own `vpr_ram_bytes` and the image that it opens, on an emulated Cortex-M4."""
    design, rng = drawn_design(seed)
    emulator = Emulator(EMULATED[1], m4)
    flash = image(random_memories(rng, design))
    at_image, at_design = emulator.put(flash), emulator.put(bytes(512))
    size = counts.sizes(design)
    # a byte less is refused
    assert emulator.call("vpr_open", at_design, at_image, size.image_bytes - 1) & 1 == 0
    assert emulator.call("vpr_open", at_design, at_image, size.image_bytes) & 1 == 1
    assert emulator.call("vpr_ram_bytes", at_design) == size.state_bytes


@pytest.mark.slow
def test_bytes_are_those_of_a_saved_map(drive):
    """A place of the map, packed; and the design says what the map says."""
    reference = ReferenceMap.load(drive / "map.npz")
    design = design_of(reference)
    size = counts.sizes(design)
    assert size.place_bytes == reference.packed_bytes_per_place
    assert (design.pixels, design.places) == (len(reference.pixel_map), len(reference))
    stored = counts.search_work(design).absolute_differences * reference.places.counts.itemsize
    assert stored == reference.places.counts.nbytes


def test_block_memories_are_whole():
    """One bit more than a block holds takes another block."""
    design = Design(width=64, height=8, pixels=16, places=256, lanes=4, code_bits=4)
    one = counts.block_memories(design, [(256, 16)])
    more = counts.block_memories(replace(design, places=257), [(256, 16)])
    # the places' words, a word of 16 bits each 4 codes, and one block of history more
    assert more > one
    assert counts.block_memories(design, [(256, 16), (512, 8)]) <= one


def test_large_blocks_take_the_places_alone():
    """Of 16384 x 16: 1,000 places of 19 words of 32 bits take four, as one word takes two."""
    design = Design(width=346, height=260, pixels=150, places=1000)
    shapes = [(256, 16), (512, 8), (1024, 4), (2048, 2)]
    large, small = counts.large_and_small_blocks(design, [(16384, 16)], shapes)
    assert large == 4
    assert small < counts.block_memories(design, shapes)


@pytest.mark.slow
@pytest.mark.parametrize("target", COUNTED, ids=lambda target: target.name)
def test_instructions_are_predicted_as_well_as_the_page_says(target, tmp_path):
    """Of those counted under emulation, for designs of both profiles that were not fitted."""
    pytest.importorskip("ziglang")
    pytest.importorskip("unicorn")
    if target == GCC and shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("arm-none-eabi-gcc is not installed")
    elf = build(target, tmp_path)
    with (ROOT / "docs" / "results" / "instruction-errors.csv").open(newline="") as file:
        (row,) = (one for one in csv.DictReader(file) if one["target"] == target.name)
    for seed, design in enumerate(emulation.random_designs(8, 77)):
        assert design not in emulation.FITTED_ON
        off = 100 * emulation.error(target, elf, design, 77)
        assert -float(row["too few (%)"]) - 0.1 <= off <= float(row["too many (%)"]) + 0.1, seed


def test_counts_of_a_filter_by_hand():
    """Four pixels, three places, steps of 0 to 3: distances, both sums, costs, evidence."""
    design = Design(width=8, height=8, pixels=4, places=3, matching="filter", lanes=2)
    work = counts.search_work(design)
    # 12 of distances, 3 of deviations; 9 in distances, 2 + 2 in sums over places, two each of the
    # 6 steps that lead from a place to a place, two a place for the evidence, and one for the row
    # of the costs
    assert (work.absolute_differences, work.additions) == (12 + 3, 9 + 4 + 2 * 6 + 2 * 3 + 3)
    # the least distance, costs, two limits and three of the search a place, two limits of the row,
    # and the acceptance; the evidence and its weight
    assert (work.comparisons, work.multiplications) == (2 + 6 + 6 + 9 + 6 + 1, 3 + 3)
    # two words of codes a place and of the query, an activity, a metric and a distance that are
    # read and written, and a sum that none is far enough away to take back
    bits = memories(design)
    moved = 3 * (2 * bits["places"].width + 2 * bits["query"].width)
    moved += 3 * (bits["place_activity"].width + 2 * bits["metric"].width)
    moved += 3 * 2 * bits["distance"].width + 3 * bits["delay"].width
    assert work.bytes_moved == moved / 8


def test_instructions_agree_with_the_table_beside_the_sources():
    """The fitted table against the other one, which the firmware wrote for one design."""
    with TABLE.open(encoding="ascii", newline="") as file:
        rows = {row["target"]: row for row in csv.DictReader(file)}
    assert set(rows) == set(emulation.scaling())
    for core, row in rows.items():
        told = emulation.predict(DESIGN, core)
        assert told.window == pytest.approx(int(row["window_end"]), rel=0.1)
        assert told.match == pytest.approx(int(row["match"]), rel=0.1)
        predicted = emulation.predict(FILTER, core).match
        assert predicted == pytest.approx(int(row["filter_match"]), rel=0.1)
        own = emulation.predict(FILTER, core).window
        assert own == pytest.approx(int(row["contrast_window_end"]), rel=0.1)
        each = instructions_of(DESIGN, core, 10**9)
        assert round(each["selected event"]) == int(row["event_selected"])
        assert firmware()[core].stack_bytes == int(row["stack_bytes"])


def test_energy_has_a_source_or_is_unknown():
    """Every target either cites constants in order, or says what is not known."""
    for name in targets.names():
        target = targets.find(name)
        costs = cost(SMALL, target, RATE)
        if costs.energy_j is None:
            assert target.unknown and costs.per_match_j is None
        else:
            value = costs.energy_j["search"]
            assert 0 < value.low <= value.central <= value.high
    for constant in targets.constants().values():
        assert constant.source and constant.node and constant.uncertainty
        assert 0 < constant.value.low <= constant.value.central <= constant.value.high


def test_every_constant_that_is_used_is_printed_with_its_name(run):
    """Several constants of one source are several lines; without --sources there is none."""
    shown, short = (joined(run("estimate", *more).out) for more in (["--sources"], []))
    for name in targets.constants():
        assert shown.count(f"modelled, {name}: ") == 1
        assert f"modelled, {name}: " not in short
    assert "--sources" in short


def rows_of(text):
    """Cells of the rows of the table, by the target; no line is wider than 80 columns."""
    assert max(map(len, text.splitlines())) <= 80
    rows = [line.strip("\u2502").split("\u2502") for line in text.splitlines() if "\u2502" in line]
    return {row[0].strip(): [cell.strip() for cell in row[1:]] for row in rows}


def joined(text):
    return " ".join(text.split())


def test_one_table_has_matches_per_joule_by_the_rate_of_events(run):
    """Each target; what they include and at which rate time and energy are is said below."""
    printed = json.loads(run("estimate", "--json").out)
    shown = run("estimate").out
    rows = rows_of(shown)
    assert set(rows) == set(targets.names())
    assert rows["pi-5"][4:] == ["-"] * 4 and rows["cortex-m0plus"][4:] == ["-"] * 3 + ["slow"]
    for name, told in printed["targets"].items():
        clock, flash, ram, time = rows[name][:4]
        assert float(clock) == told["clock_hz"] / 1e6 == targets.find(name).clock_hz / 1e6
        memory = told["memory"]
        assert float(flash.replace("-", "0")) == pytest.approx(memory["flash_bytes"] / 1024, 6e-3)
        assert float(ram) == pytest.approx(memory["ram_bytes"] / 1024, 6e-3)
        assert float(time) == pytest.approx(1e3 * told["load"]["central"], 6e-3)
        by_rate = told["matches_per_joule_at_events_per_s"]
        assert list(by_rate) == ["10000", "100000", "1000000"]
        if told["energy_j"] is None:
            assert set(by_rate.values()) == {None}
            continue
        values = [of["central"] for of in by_rate.values()]
        assert values[0] > 1.5 * values[1] > 7 * values[2]
        cells = [cell.replace(",", "").replace("k", "e3") for cell in rows[name][4:]]
        values.insert(0, 1e6 * told["per_match_j"]["central"])
        if name == "ice40up5k":  # at 48 MHz / 6 bits a second on its SPI line, 64 of an event
            assert told["spi_events_per_s"] == 125_000
            assert told["limited_by"] == "33 of 30 block memories, 5 of 4 large ones"
            assert cells[3:] == ["slow"]
            del cells[3:], values[3:]
        assert [float(cell) for cell in cells] == pytest.approx(values, rel=6e-3)
    text = joined(shown)
    assert "the work alone, without the camera and the board at rest" in text
    assert "at 100,000 events/s of the whole sensor (an assumption)" in text and "modelled" in text
    shown = run("estimate", "--event-rate", "2e6", "--target", "cortex-m0plus").out
    assert "at 2,000,000 events/s of the whole sensor (as given)" in joined(shown)
    assert float(rows_of(shown)["cortex-m0plus"][3].replace(",", "")) > 1_000
    assert "cortex-m0plus (its speed: busy 1.4 to 2.7 of the time)" in joined(shown)
    shown = run("estimate", "--places", 60_000, "--target", "cortex-m0plus").out
    assert rows_of(shown)["cortex-m0plus"][5:] == ["slow"] * 3 and "slow: the" in joined(shown)


def test_windows_of_a_number_of_events_end_more_often_at_a_higher_rate():
    """The energy of a match is then that of as many events."""
    design = replace(SMALL, window="count", window_events=100)
    mission, faster = (Mission.of(design, rate, 0.01) for rate in (1e5, 1e6))
    assert (mission.matches_per_s, faster.matches_per_s) == (10.0, 100.0)
    m4 = targets.find("cortex-m4")
    a, b = (cost(design, m4, one).per_match_j.central for one in (mission, faster))
    assert a == pytest.approx(b)
    assert Mission.of(SMALL, 1e6, 0.01).matches_per_s == 1e6 / SMALL.tau_us


def test_the_default_design_is_that_of_the_default_settings():
    """Of the flags: pixels, bits, codes and matching of the product's default."""
    design = workload_of(parsed([])).design
    default = PRESETS["default"]
    assert (design.pixels, design.code_bits) == (default.pixels, default.counter_bits)
    assert (design.matching, design.code) == (default.matching, default.counter_code)
    assert design.restart == default.filter_restart
    assert (design.places_per_window, design.exclusion) == (2, 2 * default.exclusion)


def test_a_map_gives_the_design_and_its_rate_of_events(drive):
    path = str(drive / "map.npz")
    mapped = ReferenceMap.load(path)
    workload = workload_of(parsed(["--map", path]))
    assert workload.design.places == len(mapped) and workload.rate_is == "as in the map's drive"
    seconds = (mapped.places.end_us - mapped.places.start_us).sum() / 1e6
    assert workload.mission.events_per_s == pytest.approx(mapped.places.events.sum() / seconds)


def test_a_map_of_frames_of_its_pixels_has_no_rate_of_events(drive, tmp_path, run):
    """Counts at the selected pixels say nothing about the other ones."""
    mapped = ReferenceMap.load(drive / "map.npz")
    assert event_rates(mapped) is not None
    alone = replace(mapped, places=replace(mapped.places, events=mapped.places.selected_events))
    assert event_rates(alone) is None
    alone.save(tmp_path / "frames.npz")
    text = joined(run("estimate", "--map", tmp_path / "frames.npz").out)
    assert "an assumption: the map counts events at its pixels alone" in text
    text = joined(run("estimate", "--map", drive / "map.npz").out)
    assert "(as in the map's drive)" in text
    differences = len(mapped.pixel_map) * len(mapped)  # as `compare` shows them
    assert f" operations, {differences:,} of them differences of codes, and moves " in text


def test_a_map_of_frames_of_chosen_pixels_alone_has_no_rate_either(shared_data):
    """All pixels of the frame are those of the map, and not those of the camera."""
    counts = shared_data / "brisbane_lens49/sunset2.npz"
    mapped = ReferenceMap.build(open_recording(counts, frame_period=1), pixels=49)
    assert len(mapped.pixel_map) == mapped.pixel_map.sensor.pixels
    assert event_rates(mapped) is None


def test_given_places_go_before_those_of_a_design(tmp_path):
    SMALL.save(tmp_path / "mine.toml")
    own = ["--target", "cortex-m4", "--design", str(tmp_path / "mine.toml")]
    for flags, places in ((["--places", "30"], 30), ([], SMALL.places)):
        assert workload_of(parsed([*own, *flags])).design.places == places


def test_power_is_the_energy_of_the_rates():
    """The work's is each unit's energy times its rate; at rest an FPGA's clock runs on."""
    costs = cost(SMALL, targets.find("ice40up5k"), RATE)
    assert costs.energy_j and costs.per_match_j and costs.idle_w and costs.whole_w
    by_hand = sum(costs.energy_j[unit].central * rate for unit, rate in RATE.rates.items())
    assert costs.per_match_j.central * RATE.matches_per_s == pytest.approx(by_hand)
    assert costs.matches_per_joule.central == pytest.approx(1 / costs.per_match_j.central)
    assert costs.matches_per_joule.low == pytest.approx(1 / costs.per_match_j.high)
    assert costs.whole_w.central == pytest.approx(by_hand + costs.idle_w.central)
    # 46.6 uA/MHz at 1.219 V and 48 MHz in the cycles that the work leaves
    clock_w = 46.6e-6 * 48 * 1.219 * (1 - costs.load.central)
    assert costs.idle_w.central == pytest.approx(104e-6 + clock_w, rel=1e-3)
    zero = cost(SMALL, targets.find("pi-zero-2w"), RATE)
    assert zero.idle_w == targets.constants()["pi-zero-2w-idle"].value


def test_a_load_that_may_not_keep_up_does_not_fit():
    """By the most cycles per instruction; an FPGA by its SPI line, with 12 bytes of long clocks."""
    m0, ice = targets.find("cortex-m0plus"), targets.find("ice40up5k")
    load = cost(SMALL, m0, RATE).load
    between = replace(RATE, events_per_s=RATE.events_per_s * 2 / (load.low + load.high))
    device = on_target(SMALL, between, m0)
    assert device.cost.load.low < 1 < device.cost.load.high
    assert device.limited_by.startswith("its speed: busy 0.")
    slow = replace(RATE, events_per_s=83_333)
    long = replace(SMALL, timestamp_bits=40)
    assert on_target(long, slow, ice).limited_by == ""
    slow = replace(RATE, events_per_s=83_334)
    assert on_target(long, slow, ice).limited_by == "its SPI line: 83,333 events/s"
    assert on_target(SMALL, slow, ice).limited_by == ""


def test_a_design_over_the_firmwares_widths_does_not_fit():
    """Distances of 16 bits: 600 codes of 8 bits could be larger."""
    wide = Design(
        width=64, height=64, pixels=600, places=50, code="counts", code_bits=8, lookup_depth=2048
    )
    for design, name, limit in (
        (wide, "cortex-m4", FIRMWARE_LIMITS), (wide, "ice40up5k", ""), (SMALL, "cortex-m4", ""),
        (
            replace(SMALL, places=200_000), "ice40up5k",
            "2939 of 30 block memories, 464 of 4 large ones",
        ),
    ):  # fmt: skip
        slow = replace(RATE, events_per_s=1e4)
        assert on_target(design, slow, targets.find(name)).limited_by == limit


def test_the_smallest_design_that_is_as_good_is_recommended(monkeypatch):
    """Within a standard error of the best that fits; what keeps a better one from fitting."""
    design, mission = workload_of(parsed(["--places", "2000"]))[:2]
    m4 = targets.find("cortex-m4")

    def recommended(budget, *tried):
        monkeypatch.setattr(fitting, "tried_designs", lambda: tried)
        return recommend(design, mission, m4, [Budget.parse(budget)])

    small, large = Tried(25, 3, 1, 0.90, 0.03), Tried(150, 3, 2, 0.95, 0.02)
    best, limit, _ = recommended("1MiB", small, large)
    assert (best.tried, limit) == (large, "")
    assert (best.device.design.pixels, best.device.design.places) == (150, 2_000)
    assert best.device.design.exclusion == 2 * PRESETS["default"].exclusion
    # as good by less than the error of the best
    best, _, most_correct = recommended("1MiB", small._replace(accuracy=0.94), large)
    assert most_correct.tried == large
    assert best.tried.pixels == 25 and best.device.design.places == 1_000
    assert best.device.mission.selected_share == pytest.approx(25 / (346 * 260))
    # the better one does not fit
    best, limit, most_correct = recommended("64KiB", small, large)
    assert best.tried == small and limit.startswith("64KiB: ") and most_correct is best
    best, limit, most_correct = recommended("1KiB", small, large)
    assert best is most_correct is None and limit.startswith("1KiB: ")


def test_the_rovers_question_is_one_command(tmp_path, run):
    """A recommended design for each target, by the table of the page."""
    rover = ["estimate", "--places", 1600, "--event-rate", "3e4"]
    rover += ["--fit", "flash=256KiB", "--fit", "ram=32KiB"]
    shown = run(*rover).out
    rows, text = rows_of(shown), joined(shown)
    _, named = text.split("Most correct of those that fit: ")
    assert named.startswith("ecp5-25f ")
    share = named[named.index("(") + 1 : named.index(")")]
    assert float(share) > float(rows["ecp5-25f"][-1])
    tried = f"The smallest of {len(fitting.tried_designs())} designs"
    assert f"{tried} within flash=256KiB and ram=32KiB" in text
    chosen = json.loads(run(*rover, "--json").out)["recommended"]["ice40up5k"]["best"]
    device = chosen["device"]
    assert device["memory"]["ram_bytes"] <= 32 * 1024
    energy = 1e6 * device["cost"]["per_match_j"]["central"]
    assert float(rows["ice40up5k"][-2]) == pytest.approx(energy, rel=6e-3)
    assert device["design"]["places"] in (800, 1_600) and device["limited_by"] == ""
    places = device["design"]["places"]
    assert rows["ice40up5k"][2] == f"{places:,}, {chosen['tried']['places_per_window']}"
    assert rows["ice40up5k"][-1] == f"{chosen['tried']['accuracy']:.3f}"
    assert chosen["tried"]["error"] > 0
    # a design that is given is held against the limits
    SMALL.save(tmp_path / "mine.toml")
    own = ["estimate", "--design", tmp_path / "mine.toml", "--target", "cortex-m4", "--fit"]
    assert "Over its limits: cortex-m4 (8KiB: " in joined(run(*own, "8KiB").out)
    assert "Within the limits." in joined(run(*own, "8MiB").out)


def test_places_at_whole_windows_alone_are_no_silent_answer():
    """Those at half windows, which are more correct, need too many block memories."""
    design, mission = workload_of(parsed(["--places", "1334", "--event-rate", "3e4"]))[:2]
    recommended = recommend(design, mission, targets.find("ice40up5k"))
    assert recommended.best.device.design.places == 667
    assert recommended.limit == "34 of 30 block memories, 2 of 4 large ones"


def test_where_no_design_fits_no_better_one_is_named(run):
    shown = joined(run("estimate", "--fit", "1KiB").out)
    assert shown.startswith("No design fits: cortex-m0plus (1KiB: ") and "better" not in shown


def test_the_page_names_every_target_and_key():
    """Of costs, memory, and what is recommended by which share of correct matches."""
    page = (ROOT / "docs" / "estimate.md").read_text(encoding="utf-8")
    assert [name for name in targets.names() if f"`{name}`" not in page] == []
    keys = {*(each.name for each in fields(counts.Cost)), *(e.name for e in fields(counts.Sizes))}
    keys |= {*fitting.DeviceMemory._fields, *fitting.Recommendation._fields, "limited_by"}
    keys |= {"accuracy", "error", "selected_share"}
    assert [key for key in sorted(keys) if not re.search(rf"`([\w.]+\.)?{key}`", page)] == []


def parsed(words):
    """Arguments of the command."""
    parser = argparse.ArgumentParser()
    estimate_arguments.add_arguments(parser)
    return parser.parse_args(words)


def test_flash_and_ram_are_limits_apart():
    """Each to the byte, alone and together; an FPGA has RAM alone."""
    m4, ice = targets.find("cortex-m4"), targets.find("ice40up5k")
    flash, ram, program = on_target(SMALL, RATE, m4).memory
    size, row = counts.sizes(SMALL), firmware()["cortex-m4"]
    assert (flash, program) == (size.image_bytes + row.code_bytes, row.code_bytes)
    assert ram == size.state_bytes + STRUCT_BYTES + row.stack_bytes

    def broken(target, *texts):
        budgets = [Budget.parse(text) for text in texts]
        return on_target(SMALL, replace(RATE, events_per_s=1e4), target, budgets).limited_by

    assert broken(m4, f"flash={flash}B", f"ram={ram}B", f"{flash + ram}B") == ""
    assert broken(m4, f"flash={flash}B", f"RAM={ram - 1}B") == f"RAM={ram - 1}B: {ram:,} bytes"
    less = f"flash={flash - 1}B"
    assert broken(m4, less, f"ram={ram}B") == f"{less}: {flash:,} bytes"
    assert broken(m4, f"{flash + ram - 1}B") == f"{flash + ram - 1}B: {flash + ram:,} bytes"
    both = f"flash=1B: {flash:,} bytes and ram=1B: {ram:,} bytes"
    assert broken(m4, "flash=1B", "ram=1B") == both
    packed = size.packed_bytes
    assert broken(ice, "flash=1B", f"ram={packed}B", f"{packed}B") == ""
    assert broken(ice, f"ram={packed - 1}B") == f"ram={packed - 1}B: {packed:,} bytes"


def test_a_target_of_ones_own(tmp_path):
    """A TOML file is enough; what is wrong with it is said in one line."""
    path = tmp_path / "mine.toml"
    text = 'kind = "processor"\ncore = "cortex-m4"\nclock_hz = 1e6\n'
    path.write_text(text + "cpi = [1, 2, 3]\n")
    target = targets.find(str(path))
    assert (target.name, target.clock_hz) == ("mine", 1e6)
    for wrong, says in (
        ("cpi = [3, 2, 1]\n", "low, central and high"),
        ("", "low, central and high"),
        ("cpi = [1, 2, 3]\nspeed = 3\n", "unknown name"),
        ('cpi = [1, 2, 3]\ncycle_energy = "guess"\n', "no constant"),
    ):
        path.write_text(text + wrong)
        with pytest.raises(UsageError, match=says):
            targets.find(str(path))
    with pytest.raises(UsageError, match="choose from"):
        targets.find("cray-1")


def test_the_page_says_what_the_ice40_takes_besides_the_work():
    """Static power and a running clock, and what its SPI line carries."""
    design, mission = workload_of(parsed([]))[:2]
    costs = cost(design, targets.find("ice40up5k"), mission)
    static = targets.constants()["ice40up5k-static"].value.central
    parts = f"{1e3 * static:.2f} and {1e3 * (costs.idle_w.central - static):.2f} mW"
    whole = f"{mission.matches_per_s / costs.whole_w.central:,.0f} matches per joule"
    text = " ".join((ROOT / "docs/results.md").read_text(encoding="utf-8").split())
    assert f"{parts}: with both" in text
    assert f"there are {whole} instead of {costs.matches_per_joule.central:,.0f}" in text
    assert f"[{costs.spi_events_per_s:,.0f} events/s]" in text
