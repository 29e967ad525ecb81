"""An estimate: counts as in the specification, instructions as emulated, energy never invented."""

from __future__ import annotations

import argparse
import csv
import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from edge_vpr_tools.cli import main
from edge_vpr_tools.commands import estimate as estimate_arguments
from edge_vpr_tools.commands.estimate import design_and_mission
from edge_vpr_tools.estimate import accuracy, emulation, figure, search, targets
from edge_vpr_tools.estimate import model as counts
from edge_vpr_tools.estimate.model import Mission, cost, firmware, instructions_of
from edge_vpr_tools.estimate.of_map import design_of
from edge_vpr_tools.estimate.search import (
    FIRMWARE_LIMITS,
    Budget,
    Limits,
    broken_by,
    fit,
    memory_bytes,
)
from edge_vpr_tools.estimate.show import busy
from edge_vpr_tools.report.page import quantity
from test_commands import drive  # noqa: F401

from edge_vpr.errors import MapError, UsageError
from edge_vpr.evaluation.tracks import Track, with_positions
from edge_vpr.matching.place_filter import TransitionCosts
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.results import to_json
from edge_vpr.settings import PRESETS
from firmware_model import Design
from firmware_model.cost import memories
from firmware_model.emulation.build import EMULATED, build
from firmware_model.emulation.emulator import Emulator
from firmware_model.emulation.instructions import DESIGN, FILTER, TABLE
from firmware_model.image import image
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
    found = search_sums(sequence_sums([newest, *history]), design.exclusion)
    accepts(design, found.sum, found.second_sum)
    expected = counts.match_work(design)
    assert Metered.tally["absolute_differences"] == expected.absolute_differences
    assert Metered.tally["additions"] == expected.additions
    asked = expected.multiplications if found.second_sum else 0
    assert Metered.tally["multiplications"] == asked


@pytest.mark.parametrize("seed", range(20))
def test_bytes_are_those_of_the_firmware_image(seed):
    """Without laying it out: flash to the byte, RAM as the C code asks for it."""
    rng = np.random.default_rng(seed)
    design = (random_design, random_adaptive_design)[seed % 2](rng)
    assert counts.flash_bytes(design) == len(image(random_memories(rng, design)))


@pytest.fixture(scope="module")
def m4(tmp_path_factory):
    """The firmware for a Cortex-M4."""
    pytest.importorskip("ziglang")
    pytest.importorskip("unicorn")
    return build(EMULATED[1], tmp_path_factory.mktemp("m4"))


@pytest.mark.parametrize("seed", range(10))
def test_bytes_are_those_that_the_firmware_asks_for(seed, m4):
    """Its own `vpr_ram_bytes` and the image that it opens, on an emulated Cortex-M4."""
    rng = np.random.default_rng(seed)
    design = (random_design, random_adaptive_design)[seed % 2](rng)
    emulator = Emulator(EMULATED[1], m4)
    flash = image(random_memories(rng, design))
    at_image, at_design = emulator.put(flash), emulator.put(bytes(512))
    size = counts.sizes(design)
    # a byte less is refused
    assert emulator.call("vpr_open", at_design, at_image, size.flash_bytes - 1) & 1 == 0
    assert emulator.call("vpr_open", at_design, at_image, size.flash_bytes) & 1 == 1
    assert emulator.call("vpr_ram_bytes", at_design) == size.ram_bytes


@pytest.mark.slow
def test_bytes_are_those_of_a_saved_map(drive):  # noqa: F811
    """A place of the map, packed; and the design says what the map says."""
    reference = ReferenceMap.load(drive / "map.npz")
    design = design_of(reference)
    size = counts.sizes(design)
    assert size.place_bytes == reference.packed_bytes_per_place
    assert (design.pixels, design.places) == (len(reference.pixel_map), len(reference))
    stored = counts.match_work(design).absolute_differences * reference.places.counts.itemsize
    assert stored == reference.places.counts.nbytes


def test_every_pixel_is_counted_as_a_design_is():
    """Where a device could hold as many, the counts are that device's but for the look-up."""
    design = Design(width=16, height=8, pixels=20, places=30, lookup_depth=512)
    every = counts.EveryPixel.beside(design)
    device = replace(design, pixels=128)
    assert (every.pixels, every.slots) == (128, 128)
    assert counts.match_work(every) == counts.match_work(device)
    assert counts.window_work(every) == counts.window_work(device)
    assert set(counts.event_work(every, selected=True).traffic) == {"counts"}
    sized = memories(device)
    look_up = sum(sized[name].bits for name in ("displacement", "lookup", "pixel_delay"))
    packed = sum(memory.bits for memory in sized.values()) - look_up
    assert counts.sizes(every).packed_bytes == -(-packed // 8)
    # more than a device may have
    whole = counts.EveryPixel.beside(Design(width=346, height=260, pixels=150, places=1000))
    assert counts.match_work(whole).absolute_differences == 346 * 260 * 1000


def test_two_designs_are_compared_in_every_layer(tmp_path, capsys):
    """Counts, bytes, instructions, time and energy of this design, and of another or all pixels."""
    other, out = tmp_path / "other.toml", tmp_path / "estimate.json"
    replace(SMALL, pixels=30).save(other)
    SMALL.save(tmp_path / "this.toml")
    this = ["estimate", "--design", str(tmp_path / "this.toml"), "--json", str(out)]
    for vs, slots in ((str(other), 30), ("all-pixels", 64 * 64)):
        assert main([*this, "--target", "cortex-m4", "--target", "ice40up5k", "--vs", vs]) == 0
        shown = " ".join(capsys.readouterr().out.split())
        found = json.loads(out.read_text())["vs"]
        assert found["counts"]["counters"] == [150, slots]
        assert found["counts"]["absolute differences per search"] == [150 * 200, slots * 200]
        assert found["counts"]["bytes per place"] == [57, -(-slots * 3 // 8)]
        for name in ("bytes read per search", "RAM of the firmware in C"):
            ours, theirs = found["counts"][name]
            assert (theirs > ours) == (slots > 150)
        ours, theirs = found["targets"]["Cortex-M4"]
        for one in ("instructions", "cycles", "seconds", "energy_j"):
            assert ours[one]["search"] != theirs[one]["search"]
        assert "energy of a match, modelled" in shown and "instructions of a search" in shown


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
@pytest.mark.parametrize("target", EMULATED, ids=lambda target: target.name)
def test_instructions_are_predicted_within_a_tenth(target, tmp_path):
    """Of those counted under emulation, for ten designs that the table was not fitted on."""
    pytest.importorskip("ziglang")
    pytest.importorskip("unicorn")
    elf = build(target, tmp_path)
    rng = np.random.default_rng(11)
    for seed in range(10):
        length = int(rng.integers(1, 16))
        design = Design(
            width=64, height=64, pixels=int(rng.integers(10, 300)), length=length,
            places=int(rng.integers(20, 40)), code_bits=int(rng.integers(1, 5)),
        )  # fmt: skip
        assert design not in emulation.FITTED_ON
        counted = emulation.count(target, elf, design, seed)
        told = emulation.predict(design, target.name)
        assert told.match == pytest.approx(counted.match, rel=0.1)
        assert told.window == pytest.approx(counted.window, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("target", EMULATED[:2] + EMULATED[3:4], ids=lambda target: target.name)
def test_instructions_of_the_filter_are_predicted_within_a_tenth(target, tmp_path):
    """Of those counted under emulation, for eight designs that the table was not fitted on."""
    pytest.importorskip("ziglang")
    pytest.importorskip("unicorn")
    elf = build(target, tmp_path)
    rng = np.random.default_rng(12)
    for seed in range(8):
        design = Design(
            width=64, height=64, pixels=int(rng.integers(10, 300)),
            code=("own-mean", "contrast")[seed % 2], activity_costs=seed % 2 == 1,
            places=int(rng.integers(30, 50)), code_bits=int(rng.integers(1, 5)),
            matching="filter", keep_distances=seed % 4 < 2,
        )  # fmt: skip
        counted = emulation.count(target, elf, design, seed)
        told = emulation.predict(design, target.name)
        assert told.match == pytest.approx(counted.match, rel=0.1), design
        assert told.window == pytest.approx(counted.window, rel=0.1)


def test_counts_of_a_filter_by_hand():
    """Four pixels, three places, steps of 0 and 1: distances, both sums, costs, evidence."""
    design = Design(
        width=8, height=8, pixels=4, places=3, matching="filter", steps=(1, 0), lanes=2,
        accept="margin", keep_distances=True,
    )  # fmt: skip
    work = counts.match_work(design)
    # 12 of distances, 3 of deviations; 9 in distances, 2 + 2 in sums over places, two each of the
    # 5 steps that lead from a place to a place, and two a place for the evidence
    assert (work.absolute_differences, work.additions) == (12 + 3, 9 + 4 + 2 * 5 + 2 * 3)
    # the least distance, costs, two limits and three of the search a place, and the acceptance;
    # the evidence and its weight
    assert (work.comparisons, work.multiplications) == (2 + 5 + 6 + 9 + 1, 3 + 3)
    # two steps more lead to one place and to none; the row of costs is a difference of two limits
    by_activity = counts.match_work(replace(design, activity_costs=True, steps=()))
    assert by_activity.additions == work.additions + 2 * 1 + 3
    assert by_activity.comparisons == work.comparisons + 1 + 2 * 3
    assert by_activity.traffic["place_activity"].reads == 3
    assert (work.traffic["metric"].reads, work.traffic["distance"].writes) == (3, 3)
    twice = counts.match_work(replace(design, keep_distances=False))
    assert twice.absolute_differences == 24 + 3 and "distance" not in twice.traffic
    assert twice.traffic["places"].reads == 2 * work.traffic["places"].reads == 12
    own = replace(design, code="own-mean", full_scales=(0,))
    assert counts.window_work(own).traffic["mean"].writes == 4
    contrast = counts.window_work(replace(own, code="contrast"))
    assert contrast.additions == counts.window_work(own).additions + 2 * 4


def test_instructions_agree_with_the_table_beside_the_sources():
    """The fitted table against the other one, which the firmware wrote for one design."""
    with TABLE.open(encoding="ascii", newline="") as file:
        rows = {row["target"]: row for row in csv.DictReader(file)}
    assert set(rows) == set(emulation.scaling())
    for core, row in rows.items():
        told = emulation.predict(DESIGN, core)
        assert told.window == pytest.approx(int(row["window_end"]), rel=0.1)
        assert told.match == pytest.approx(int(row["match"]), rel=0.1)
        for design, name in (
            (FILTER, "filter_match"),
            (replace(FILTER, keep_distances=True), "kept_match"),
        ):
            assert emulation.predict(design, core).match == pytest.approx(int(row[name]), rel=0.1)
        own = emulation.predict(FILTER, core).window
        assert own == pytest.approx(int(row["contrast_window_end"]), rel=0.1)
        each = instructions_of(DESIGN, core, replace(RATE, events_per_call=10**9))
        assert round(each["selected event"]) == int(row["event_selected"])
        assert firmware()[core].stack_bytes == int(row["stack_bytes"])


def test_energy_has_a_source_or_is_unknown():
    """Every target either cites constants in order, or says what is not known."""
    for name in targets.names():
        target = targets.find(name)
        found = cost(SMALL, target, RATE)
        if found.energy_j is None:
            assert target.unknown and found.marginal_w is None and found.per_match_j is None
        else:
            assert found.basis
            value = found.energy_j["search"]
            assert 0 < value.low <= value.central <= value.high
    for constant in targets.constants().values():
        assert constant.source and constant.node and constant.uncertainty
        assert 0 < constant.value.low <= constant.value.central <= constant.value.high


def test_every_constant_that_is_used_is_printed_with_its_name(capsys):
    """Several constants of one source are several lines; without --sources there is none."""
    assert main(["estimate", "--sources"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert main(["estimate"]) == 0
    short = " ".join(capsys.readouterr().out.split())
    for name in targets.constants():
        assert shown.count(f"modelled, {name}: ") == 1
        assert f"modelled, {name}: " not in short
    assert "--sources" in short


def words(text):
    """Words of a table: without its lines, and cells that were wrapped put together again."""
    return " ".join(re.sub("[\u2500-\u257f]", " ", text).split())


def rows_of(text):
    """Cells of the rows of the first table, each with its wrapped lines joined."""
    rows = []
    for line in text.splitlines():
        if line.startswith("\u2514"):
            return rows
        if line.startswith("\u2502"):
            cells = [cell.strip() for cell in line.strip("\u2502").split("\u2502")]
            if len(cells[1:]) and re.match(r"\d+ px|none of", cells[1]):
                rows.append(cells)
            else:
                rows[-1] = [f"{a} {b}".strip() for a, b in zip(rows[-1], cells, strict=True)]
    return rows


def test_the_answer_comes_first(capsys):
    """A table of the default and of sequences on each target, with what does not fit."""
    own = ["estimate", "--pixels", "83", "--places", "2000", "--target"]
    for flags, over in (
        (["cortex-m4"], "-"),
        (["cortex-m4", "--fit", "16KiB"], "16KiB"),
        (["cortex-m0plus", "--match-rate", "1e5"], "its speed"),
        (["ice40up5k", "--vs", "all-pixels"], "-"),
        (["ice40up5k", "--places", "200000"], "its block memories"),
    ):
        assert main([*own, *flags]) == 0
        shown = capsys.readouterr().out
        filters, sequences = rows_of(shown)
        assert filters[1].startswith("83 px, 3 bits contrast, ") and "filter" in filters[1]
        assert "3 bits log, " in sequences[1] and sequences[1].endswith("sequences of 5")
        assert filters[-1] == over
        assert "accuracy is not estimated" in shown.partition("\u250f")[2].rpartition("\u2514")[0]
        assert "83 pixels, 3 bits (contrast)" in shown
    # one way of matching if the user chooses it
    for flags, by in (
        (["--matching", "filter"], "filter"), (["-L", "7"], "sequences of 7"),
        (["--matching", "sequence"], "3 bits log"),
    ):  # fmt: skip
        assert main([*own, "cortex-m4", *flags]) == 0
        (row,) = rows_of(capsys.readouterr().out)
        assert by in row[1]


def test_counts_are_printed_only_if_more_is_wanted(capsys):
    """Time and load decide, and are always printed."""
    for flags in ([], ["--target", "cortex-m4"]):
        for more in ([], ["-v"]):
            assert main(["estimate", *flags, *more]) == 0
            shown = capsys.readouterr().out
            assert ("bytes read" in shown) == bool(more)
            assert ("-v prints the exact counts" in " ".join(shown.split())) == (not more)
            assert "a second of the mission" in shown or not (flags and more)
            assert "busy" in shown and "time of a" in shown


def test_targets_of_unknown_power_are_one_line_at_the_end(capsys):
    """They have no row, unless only one target is asked for."""
    assert main(["estimate"]) == 0
    shown = capsys.readouterr().out
    assert {row[0] for row in rows_of(shown)} == {
        "Cortex-M4", "Cortex-M7", "generic 45 nm datapath", "iCE40UP5K", "Raspberry Pi Zero 2 W"
    }  # fmt: skip
    line = "power unknown: Cortex-M0+, ECP5-25F, Raspberry Pi 4, Raspberry Pi 5 ("
    assert line in " ".join(shown.split())
    assert main(["estimate", "--target", "raspberry-pi-5"]) == 0
    assert rows_of(capsys.readouterr().out)[0][0] == "Raspberry Pi 5"


def test_the_default_design_is_that_of_the_default_settings():
    """Of the flags: pixels, bits, codes and matching of the product's default."""
    design = design_and_mission(parsed(["estimate"]))[0]
    default = PRESETS["default"]
    assert (design.pixels, design.code_bits) == (default.pixels, default.counter_bits)
    assert (design.matching, design.code) == (default.matching, default.counter_scaling)
    assert design.activity_costs and TransitionCosts.of(default).forward is None
    assert (design.places_per_window, design.exclusion) == (2, 2 * default.exclusion)
    by_count = design_and_mission(parsed(["estimate", "--window-events", "450"]))[0]
    assert by_count.steps == TransitionCosts.of(replace(default, window="count")).forward
    assert (design.restart, by_count.restart) == (default.filter_restart,) * 2


def test_a_route_has_as_many_places_as_its_map_would(drive, tmp_path, capsys):  # noqa: F811
    """Two per window by default; a map gives its own density, if it has positions."""
    for flags, places, filters in (
        ([], 1_600, True), (["--places-per-window", "1"], 800, True),
        (["--tau", "333333us"], 800, True), (["--window-events", "450"], 800, True),
        (["-L", "5"], 800, False),
    ):  # fmt: skip
        design = design_and_mission(parsed(["estimate", "--route-km", "8", *flags]))[0]
        assert (design.places, design.filters) == (places, filters)
        assert design.exclusion == 3 * design.places_per_window
    drives = (str(drive / "reference.npz"), str(drive / "map.npz"))
    reference = ReferenceMap.load(drives[1])
    half = ReferenceMap.build(
        drives[0],
        reference.settings,
        matching="filter",
        places_per_window=2,
        pixel_map=reference.pixel_map,
    )
    half.save(tmp_path / "half.npz")
    of_map = ["estimate", "--map", str(tmp_path / "half.npz"), "--route-km"]
    assert design_and_mission(parsed([*of_map, "8"]))[0].places == 1_600
    # a window each 2 m
    centre_us = half.places.centre_us
    track = Track(centre_us, (centre_us * 2 / half.settings.tau_us)[:, None])
    with_positions(half, track).save(tmp_path / "half.npz")
    design, _, density = design_and_mission(parsed([*of_map, "1"]))
    assert (design.places, density) == (1_000, pytest.approx(0.5))
    assert main([*of_map, "1", "--target", "cortex-m4"]) == 0
    assert "at 1 places per metre (1 km)" in " ".join(capsys.readouterr().out.split())
    wrong = ["estimate", "--places-per-window", "2", "--matching", "sequence"]
    with pytest.raises(UsageError, match="expected the filter"):
        design_and_mission(parsed(wrong))


def test_the_energy_of_a_match_is_one_number(capsys, tmp_path):
    """Of the table, the costs, the comparison and JSON: events, window's end and search."""
    out = tmp_path / "estimate.json"
    flags = ["--target", "cortex-m4", "--vs", "all-pixels", "--match-rate", "2"]
    assert main(["estimate", *flags, "--json", str(out), "-v"]) == 0
    shown = words(capsys.readouterr().out)
    of = json.loads(out.read_text())["targets"]["Cortex-M4"]
    rates = {"selected event": 166.7, "other event": 99833.3, "window": 2.0, "search": 2.0}
    by_hand = sum(of["energy_j"][unit]["central"] * rate for unit, rate in rates.items()) / 2
    assert of["per_match_j"]["central"] == pytest.approx(by_hand, rel=1e-3)
    told = quantity(of["per_match_j"]["central"], "J").split()[0]
    (compared,) = re.findall(r"energy of a match, modelled ([\d.,]+) ", shown)
    assert compared == told
    assert of["matches_per_joule"]["central"] == pytest.approx(1 / of["per_match_j"]["central"])
    assert of["matches_per_joule"]["low"] == pytest.approx(1 / of["per_match_j"]["high"])
    assert f" {of['matches_per_joule']['central']:,.0f} (" in shown
    search = quantity(of["energy_j"]["search"]["central"], "J").split()[0]
    assert shown.count(told) >= 2 and shown.count(f" {search} ") == 1


def test_distances_are_kept_where_the_memory_allows(capsys, tmp_path):
    """2 bytes of RAM a place, for two thirds of the search; a file of a design says which."""
    out = tmp_path / "estimate.json"
    found = {}
    for name, flags in (("kept", []), ("twice", ["--fit", "178.5KiB"])):
        assert main(["estimate", "--target", "cortex-m4", *flags, "--json", str(out)]) == 0
        found[name] = json.loads(out.read_text())["targets"]["Cortex-M4"]
        assert ("computed twice" in capsys.readouterr().out) == (name == "twice")
    assert found["kept"]["memory_bytes"] - found["twice"]["memory_bytes"] == 2 * 1000
    assert found["twice"]["limited_by"] == ""
    searches = [found[name]["instructions"]["search"] for name in ("kept", "twice")]
    assert searches[0] < 0.67 * searches[1]
    filters = replace(SMALL, matching="filter", length=0, accept="margin")
    filters.save(tmp_path / "mine.toml")
    assert main(["estimate", "--design", str(tmp_path / "mine.toml")]) == 0
    assert "computed twice" in capsys.readouterr().out


def test_a_target_that_may_not_keep_up_says_so():
    """At its assumed best, or at its worst, or in no case."""
    assert busy(targets.Spread(1.0, 1.5, 2.0)) == "overloaded"
    assert busy(targets.Spread(0.7, 0.9, 1.2)) == "90%: may be overloaded"
    assert busy(targets.Spread(0.01, 0.02, 0.04)) == "2.000%"


def test_a_route_goes_before_the_places_of_a_design(tmp_path, capsys):
    """0.7 km at a place each 10 m; without a route the design keeps its own."""
    SMALL.save(tmp_path / "mine.toml")
    own = ["estimate", "--target", "cortex-m4", "--design", str(tmp_path / "mine.toml")]
    for flags, places in ((["--route-km", "0.7"], 70), (["--places", "30"], 30), ([], 200)):
        assert main([*own, *flags]) == 0
        assert f" {places} places" in capsys.readouterr().out


def test_a_processor_never_gets_the_energy_of_an_operation_table():
    """1,000 places of 150 pixels: an M4 takes tens of microjoules, its arithmetic nanojoules."""
    design = replace(SMALL, places=1000)
    m4 = cost(design, targets.find("cortex-m4"), RATE)
    floor = cost(design, targets.find("generic"), RATE)
    assert m4.energy_j and floor.energy_j
    assert 50e-6 < m4.energy_j["search"].central < 300e-6
    assert m4.energy_j["search"].low > 10 * floor.energy_j["search"].high
    processors = [t for t in map(targets.find, targets.names()) if t.kind == "processor"]
    operations = {targets.constants()[n] for n in ("add-8", "add-16", "multiply-32", "sram-byte")}
    for target in processors:
        assert not operations & set(cost(design, target, RATE).basis)


def test_power_is_the_energy_of_the_rates():
    """Marginal power is each unit's energy times its rate; rest is added where it is known."""
    found = cost(SMALL, targets.find("ice40up5k"), RATE)
    assert found.energy_j and found.marginal_w and found.idle_w and found.whole_w
    by_hand = sum(found.energy_j[unit].central * rate for unit, rate in RATE.rates.items())
    assert found.marginal_w.central == pytest.approx(by_hand)
    assert found.whole_w.central == pytest.approx(by_hand + found.idle_w.central)


@pytest.mark.parametrize("name", ["cortex-m4", "ice40up5k"])
def test_a_fit_is_the_largest(name):
    """What fits keeps the budget, and one more breaks it."""
    target, budget = targets.find(name), Budget.parse("24KiB")
    found = [f for f in fit(SMALL, RATE, Limits(target, [budget])) if 0 < f.value < 1 << 15]
    assert {one.parameter for one in found} >= {"places"}
    for one in found:
        for more, within in ((0, True), (1, False)):
            values = SMALL.to_dict() | {
                "code_bits": one.code_bits, one.parameter: one.value + more, "lookup_depth": 0,
            }  # fmt: skip
            used = memory_bytes(Design.from_dict(values), target)
            assert (used <= budget.limit) == within


def test_a_fit_tells_the_most_bits_too():
    """With J and K as given: one more bit breaks the budget."""
    target, budget = targets.find("ice40up5k"), Budget.parse("16KiB")
    (most,) = (f for f in fit(SMALL, RATE, Limits(target, [budget])) if f.parameter == "code_bits")
    assert most.value == most.code_bits and most.limited_by == "16KiB"
    sizes = [memory_bytes(replace(SMALL, code_bits=most.value + n), target) for n in (0, 1)]
    assert sizes[0] <= budget.limit < sizes[1]


def test_a_design_over_the_firmwares_widths_does_not_fit():
    """Distances of 16 bits: 600 codes of 8 bits could be larger."""
    wide = Design(
        width=64, height=64, pixels=600, places=50, code="linear", code_bits=8, lookup_depth=2048
    )
    assert broken_by(wide, RATE, Limits(targets.find("cortex-m4"))) == FIRMWARE_LIMITS
    assert broken_by(wide, RATE, Limits(targets.find("ice40up5k"))) == ""
    assert broken_by(SMALL, RATE, Limits(targets.find("cortex-m4"))) == ""


def evaluated(folder, drive):  # noqa: F811
    """Two runs below a folder, one right and one wrong."""
    for name, right in (("good", 0.9), ("bad", 0.2)):
        run = folder / name
        run.mkdir()
        (run / "map.npz").write_bytes((drive / "map.npz").read_bytes())
        told = {"evaluation": {"precision_at_100_recall": right, "queries": 100}}
        (run / "metrics.json").write_text(json.dumps(told))
    return search.evaluated_runs(folder)


def test_evaluated_runs_are_set_against_their_cost(drive, tmp_path, capsys):  # noqa: F811
    """Accuracy of the run, cost of its design on the mission's route, and what limits it."""
    runs = evaluated(tmp_path, drive)
    m4, budget = targets.find("cortex-m4"), [Budget.parse("64KiB")]
    limits = Limits(m4, budget, choose_distances=True)
    short = search.candidates(runs, limits)
    assert [one.accuracy for one in short] == [0.9, 0.2]
    assert not any(one.limited_by for one in short)
    assert len(figure.frontier(short, lambda one: one.memory_bytes)) == 1
    chosen = search.recommend(short)
    assert chosen.design is short[0] and chosen.limit == ""
    long = search.candidates(runs, limits, places=10_000)
    assert {one.limited_by for one in long} == {"64KiB"}
    assert search.recommend(long) == (None, "64KiB")
    # the better one does not fit: its limit is what it costs to be better
    better = [replace(long[0], accuracy=0.99), short[1]]
    assert search.recommend(better) == (short[1], "64KiB")
    # a smaller one that is less accurate by less than the standard error is as good
    small = replace(short[0], accuracy=0.89, memory_bytes=short[0].memory_bytes - 1)
    assert search.recommend([short[0], small]).design is small
    assert search.recommend([short[0], replace(small, accuracy=0.86)]).design is short[0]
    rover = ["estimate", "--target", "cortex-m4", "--fit", "64KiB", "--route-km", "1"]
    assert main([*rover, "--pareto", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    (row,) = rows_of(shown)
    assert row[4] == "90.0% \u00b1 3.1%" and "each run on its own" in " ".join(shown.split())
    assert (tmp_path / "pareto.png").stat().st_size > 10_000
    with pytest.raises(UsageError, match="no evaluated run"):
        search.evaluated_runs(tmp_path / "good" / "empty")
    (tmp_path / "bad" / "metrics.json").write_text('{"evaluation": {"queries": 3}}')
    with pytest.raises(MapError, match="evaluation lacks precision_at_100_recall"):
        search.evaluated_runs(tmp_path)


@pytest.mark.parametrize("name", ["ice40up5k", "raspberry-pi-5"])
def test_accuracy_is_drawn_against_energy_and_against_bytes(name, drive, tmp_path):  # noqa: F811
    """Two panels; where energy is unknown, the one of energy says so and draws nothing."""
    target = targets.find(name)
    found = search.candidates(evaluated(tmp_path, drive), Limits(target, choose_distances=True))
    energy, memory = figure.draw(found, target).axes
    assert "modelled" in energy.get_xlabel() or "unknown" in energy.texts[0].get_text()
    assert bool(energy.lines) == (found[0].cost.per_match_j is not None)
    assert "bytes" in memory.get_xlabel() and memory.lines


def test_the_rovers_question_is_one_command(tmp_path, capsys, monkeypatch):
    """Without any results: designs are tried on the spot, and each target is answered."""
    from edge_vpr_tools.research.experiments.drives import simulated_pair

    def street():
        pair = simulated_pair(0, sensor="tiny", length_m=120.0)
        return accuracy.Drives("a short street", lambda draw: pair)

    monkeypatch.setattr(accuracy, "simulated", street)
    monkeypatch.setattr(accuracy, "PIXELS", (10, 25))
    out = tmp_path / "answer.json"
    rover = ["estimate", "--route-km", "8", "--fit", "64KiB", "--fit", "5mW", "--json", str(out)]
    assert main([*rover, "--accuracy-on", "simulated"]) == 0
    shown = capsys.readouterr().out
    told = json.loads(out.read_text())["answers"]
    unknown = {"Cortex-M0+", "ECP5-25F", "Raspberry Pi 4", "Raspberry Pi 5"}
    assert set(told["unknown"]) == unknown
    assert f"power unknown: {', '.join(sorted(unknown))} (" in " ".join(shown.split())
    rows = {row[0]: row for row in rows_of(shown)}
    assert set(rows) == {targets.find(name).name for name in targets.names()} - unknown
    assert "00 places" in rows["iCE40UP5K"][1] and "queries on a short street" in shown
    # at rest alone it takes more
    assert rows["Raspberry Pi Zero 2 W"][1] == "none of 36 fits"
    assert rows["Raspberry Pi Zero 2 W"][-1] == "5mW"
    tried = told["candidates"]["iCE40UP5K"]
    assert len(tried) == 3 * 2 * len(accuracy.BITS)
    # the same queries judge all, and all ways of matching are tried
    assert len({one["queries"] for one in tried}) == 1 and tried[0]["queries"] > 0
    ways = Counter(
        (one["design"]["matching"], one["design"]["places"], one["design"]["exclusion"])
        for one in tried
    )
    assert ways == {("filter", 800, 3): 12, ("filter", 1_600, 6): 12, ("sequence", 800, 3): 12}
    named = [one for one in tried if "places at half windows" in one["name"]]
    assert {one["design"]["activity_costs"] for one in named} == {2} and len(named) == 12
    chosen = told["recommended"]["iCE40UP5K"]["design"]
    best = max(one["accuracy"] for one in tried if not one["limited_by"])
    number = chosen["queries"]

    def error(accuracy):
        share = (accuracy * number + 1) / (number + 2)
        return (share * (1 - share) / (number + 3)) ** 0.5

    assert chosen["accuracy"] >= best - error(best) and error(1.0) > 0
    accuracy_text = f"{chosen['accuracy']:.1%} \u00b1 {error(chosen['accuracy']):.1%}"
    assert rows["iCE40UP5K"][4] == accuracy_text
    # with one target, the tables behind are of the design that is recommended
    alone = [*rover, "--accuracy-on", "simulated", "--target", "ice40up5k", "--vs", "all-pixels"]
    assert main(alone) == 0
    found = json.loads(out.read_text())
    assert found["design"] == found["answers"]["recommended"]["iCE40UP5K"]["design"]["design"]
    assert found["counts"]["search"] == to_json(counts.match_work(Design(**found["design"])))
    ours = found["vs"]["counts"]["counters"][0]
    assert ours == found["design"]["pixels"] in (10, 25)


def test_designs_are_tried_on_ones_own_drives(drive, tmp_path, capsys, monkeypatch):  # noqa: F811
    """Two recordings and a ground truth."""
    monkeypatch.setattr(accuracy, "PIXELS", (5,))
    truth = tmp_path / "truth.csv"
    truth.write_text("query_s,reference_s\n0,0\n1000,1000\n")
    pair = [str(drive / f"{name}.npz") for name in ("reference", "query")]
    flags = ["--tau", "100ms", "-L", "2", "--target", "cortex-m4"]
    trial = ["estimate", "--accuracy-on", *pair, *flags]
    assert main([*trial, "--ground-truth", str(truth), "--tolerance", "0.2"]) == 0
    assert "queries on" in " ".join(capsys.readouterr().out.split())
    assert main(trial) == 2
    assert "--ground-truth" in capsys.readouterr().err
    assert main([*trial, "--ground-truth", "matrix.npy"]) == 2
    assert "a matrix has rows" in capsys.readouterr().err


def test_a_match_is_as_often_as_it_is_asked_for():
    """After windows of time or count, numbers of events, and times."""
    base = ["estimate", "--event-rate", "1000", "--selected-share", "0.5", "--sensor", "64x64"]
    for flags, rate in (
        ([], 1.0),
        (["--tau", "100ms"], 10.0),
        (["--window-events", "50"], 10.0),
        (["--every", "event"], 500.0),
        (["--every", "25"], 20.0),
        (["--every", "10ms"], 100.0),
        (["--match-rate", "3"], 3.0),
    ):
        args = parsed([*base, *flags])
        assert design_and_mission(args)[1].matches_per_s == pytest.approx(rate)
    for flags in (["--every", "often"], ["--every", "event", "--match-rate", "3"]):
        with pytest.raises(UsageError):
            design_and_mission(parsed([*base, *flags]))


def parsed(words):
    """Arguments of the command."""
    parser = argparse.ArgumentParser()
    estimate_arguments.add_arguments(parser)
    return parser.parse_args(words[1:])


def test_a_budget_of_power_needs_a_power():
    """A target without a constant cannot be held against milliwatts."""
    with pytest.raises(UsageError, match="unknown"):
        fit(SMALL, RATE, Limits(targets.find("raspberry-pi-5"), [Budget.parse("10mW")]))
    assert Budget.parse("10mW").limit == pytest.approx(0.01)
    assert Budget.parse("500µW") == replace(Budget.parse("500uW"), text="500µW")
    for text in ("10", "mW", "-3KiB", "0KiB", "3 apples"):
        with pytest.raises(UsageError, match="expected memory or power"):
            Budget.parse(text)


def test_a_target_of_ones_own(tmp_path):
    """A TOML file is enough; what is wrong with it is said in one line."""
    path = tmp_path / "mine.toml"
    text = 'name = "mine"\nkind = "processor"\ncore = "cortex-m4"\nclock_hz = 1e6\n'
    path.write_text(text + "cpi = [1, 2, 3]\n")
    assert targets.find(str(path)).clock_hz == 1e6
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


def test_the_command_says_modelled_and_unknown(capsys, tmp_path, drive):  # noqa: F811
    """Of flags and of a map; the JSON holds what is shown."""
    out = tmp_path / "estimate.json"
    assert main(["estimate", "--vs", "all-pixels", "--json", str(out)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "modelled" in shown and "unknown" in shown and "89,960" in shown
    values = json.loads(out.read_text())
    assert values["targets"]["Raspberry Pi 5"]["energy_j"] is None
    assert values["counts"]["search"]["absolute_differences"] == 150 * 1000 + 1000
    assert main(["estimate", "--map", str(drive / "map.npz"), "--target", "cortex-m4"]) == 0
    assert "5 counters, of 16 x 12 pixels" in " ".join(capsys.readouterr().out.split())
    rover = ["estimate", "--route-km", "8", "--target", "ice40up5k", "--fit", "64KiB"]
    assert main([*rover, "--fit", "5mW"]) == 0
    assert "limited by" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--fit", "64KiB"], "one target"),
        (["--figure", "x.png"], "give --pareto or --accuracy-on"),
        (["--figure", "x.png", "--accuracy-on", "simulated"], "one target"),
        (["--ground-truth", "x.csv"], "--accuracy-on"),
        (["--map", "a.npz", "--pixels", "9"], "leave it out"),
        (["--route-km", "8", "--places", "9"], "give only one"),
        (["--places-per-metre", "nan"], "not a finite number"),
        (["--pareto", "nowhere"], "no evaluated run"),
        (["--accuracy-on", "one.npz"], "expected `simulated`"),
        (["--accuracy-on", "simulated", "--pareto", "x"], "give only one"),
        (["--pixels", "0"], "pixels = 0"),
        (["--places-per-metre", "0"], "positive"),
        (["--event-rate", "-1"], "expected a rate"),
        (["--map", "a.npz", "--design", "b.toml"], "give only one"),
        (["--target", "cortex-m4", "--calibrate", "nowhere.json"], "make one by"),
    ],
)
def test_bad_use_is_one_line(capsys, arguments, says):
    """What was wrong, with which value, and what to do."""
    assert main(["estimate", *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and says in lines[0]


def documented_row(found, name, clock):
    """Row of the table in docs/estimate.md for one target."""
    ours, theirs = next(pair for of, pair in found["vs"]["targets"].items() if of == name)
    energy = "unknown"
    if ours["per_match_j"] is not None:
        of = ours["per_match_j"]
        energy = quantity(of["central"], "J", of["low"], of["high"])
    taken = [one["seconds"]["search"]["central"] for one in (ours, theirs)]
    times = f"{taken[1] / taken[0]:,.3g}"
    return f"| {name}, {clock} | {quantity(taken[0], 's')} | {energy} | {times} |"


def test_the_figures_of_the_page_are_those_that_are_computed(tmp_path):
    """The table of docs/estimate.md."""
    page = (ROOT / "docs" / "estimate.md").read_text(encoding="utf-8")
    out = tmp_path / "estimate.json"
    assert main(["estimate", "--vs", "all-pixels", "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    for name, clock in (
        ("Cortex-M0+", "48 MHz"), ("Cortex-M4", "100 MHz"), ("Cortex-M7", "400 MHz"),
        ("iCE40UP5K", "12 MHz, 8 lanes"), ("Raspberry Pi Zero 2 W", "one core"),
        ("Raspberry Pi 4", "one core"),
    ):  # fmt: skip
        assert documented_row(found, name, clock) in page


def test_the_page_says_what_a_match_of_the_filter_takes():
    """Beside sequences of 5 on a Cortex-M4, for each further place: with distances kept, or not."""
    with TABLE.open(encoding="ascii", newline="") as file:
        m4 = next(row for row in csv.DictReader(file) if row["target"] == "cortex-m4")
    kept, twice = (
        f"{int(m4[name]) / int(m4['match_per_place']):.2f}"
        for name in ("kept_per_place", "filter_per_place")
    )
    half = replace(FILTER, activity_costs=2)
    of_half = []
    for design in (replace(half, keep_distances=True), half):
        few, many = (
            emulation.predict(replace(design, places=places), "cortex-m4").match
            for places in (1_000, 2_000)
        )
        of_half.append(f"{(many - few) / 1_000 / int(m4['match_per_place']):.2f}")
    text = " ".join((ROOT / "docs/firmware.md").read_text(encoding="utf-8").split())
    assert f"{kept} times the instructions of sequences of 5 if" in text
    assert f"{twice} times if" in text
    assert f"at half windows, {of_half[0]} and {of_half[1]} times" in text


@pytest.mark.slow
def test_the_default_is_recommended_where_it_is_better(tmp_path, capsys, monkeypatch):
    """On the simulated street: more often correct than sequences, in their best windows.

    It is the answer of docs/estimate.md, where more designs are tried.
    """
    monkeypatch.setattr(accuracy, "PIXELS", (10, 50, 250))
    monkeypatch.setattr(accuracy, "BITS", (1, 3))
    out = tmp_path / "answer.json"
    rover = ["estimate", "--route-km", "8", "--fit", "64KiB", "--fit", "5mW", "--json", str(out)]
    assert main([*rover, "--accuracy-on", "simulated", "--target", "ice40up5k"]) == 0
    told = json.loads(out.read_text())["answers"]
    chosen = told["recommended"]["iCE40UP5K"]["design"]
    assert (chosen["design"]["matching"], chosen["design"]["code"]) == ("filter", "contrast")
    assert chosen["design"]["places"] == 1_600
    sequences = [
        one for one in told["candidates"]["iCE40UP5K"] if one["design"]["matching"] == "sequence"
    ]
    assert {one["design"]["window"] for one in sequences} == {"count"}
    best = max(sequences, key=lambda one: one["accuracy"])
    assert 0.6 < best["accuracy"] < chosen["accuracy"]
    assert chosen["memory_bytes"] < best["memory_bytes"]
    # the table of designs marks it
    shown = capsys.readouterr().out
    assert "> " + chosen["name"].split(",")[0] in words(shown)
    (row,) = rows_of(shown)
    memory = row[2].split(":")[0]
    text = f"{row[0]}: {row[1]}; {memory}; {row[3]} modelled; correct {row[4]}"
    page = (ROOT / "docs" / "estimate.md").read_text(encoding="utf-8")
    assert text in page.replace("\n> ", " ")
