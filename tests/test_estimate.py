"""An estimate: counts as in a metered oracle, instructions as emulated, energy never invented."""

from __future__ import annotations

import csv
import json
from collections import Counter, deque
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from designs import random_design, random_memories, random_stream, wrapped
from edge_vpr_tools.cli import main
from edge_vpr_tools.estimate import counts, emulation, pareto, targets
from edge_vpr_tools.estimate.fit import FIRMWARE_LIMITS, Budget, broken_by, fit, memory_bytes
from edge_vpr_tools.estimate.model import Mission, cost, firmware, instructions_of
from edge_vpr_tools.estimate.of_map import design_of
from naive import sad
from test_commands import drive  # noqa: F401

from edge_vpr.errors import UsageError
from edge_vpr.reference_map import ReferenceMap
from firmware_model import Design, EventResult, Machine, WindowResult
from firmware_model.build import EMULATED, build
from firmware_model.comparator import ComparatorModel, SearchModel
from firmware_model.descriptor import DescriptorModel
from firmware_model.image import image
from firmware_model.instructions import DESIGN, TABLE
from firmware_model.memories import Lookup

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


class Shelf(list):
    """A memory that counts its accesses, under the name of its own tally."""

    def __init__(self, values, tally):
        super().__init__(values)
        self.tally = tally

    def __getitem__(self, at):
        self.tally["reads"] += 1
        return super().__getitem__(at)

    def __iter__(self):
        for value in super().__iter__():
            self.tally["reads"] += 1
            yield value

    def __setitem__(self, at, value):
        self.tally["writes"] += 1
        super().__setitem__(at, value)


class Line(deque):
    """The search's delay line, which counts its accesses."""

    tally: ClassVar[Counter[str]] = Counter()

    def append(self, value):
        Line.tally["writes"] += 1
        super().append(value)

    def popleft(self):
        Line.tally["reads"] += 1
        return super().popleft()


class MeteredDescriptor(DescriptorModel):
    """Every memory that an event and a window's end touch, metered by name."""

    def __init__(self, memories, tallies):
        self._tallies = tallies
        super().__init__(memories)
        lookup = self.lookup
        self.lookup = Lookup(
            Shelf(lookup.displacement, tallies["displacement"]),
            # row and slot stand in one entry: it is read once for both
            Shelf(lookup.owner, tallies["lookup"]),
            lookup.slot,
        )

    @property
    def counts(self):
        return self._counts

    @counts.setter
    def counts(self, values):
        """The counters of a window just begun: each is cleared."""
        self._counts = Shelf(values, self._tallies["counts"])
        self._tallies["counts"]["writes"] += len(values)


class MeteredComparator(ComparatorModel):
    """Counts the words of a place and of the query that are compared."""

    words = 0

    def steps(self, place, query):
        for accumulated in super().steps(place, query):
            MeteredComparator.words += 1
            yield accumulated


class MeteredSearch(SearchModel):
    """A search with a metered delay line, that counts the sums it takes."""

    sums = 0

    def __init__(self, design):
        super().__init__(design)
        self.delay = Line()

    def take(self, place, total):
        MeteredSearch.sums += 1
        super().take(place, total)


def metered(design, memories):
    """A machine whose every memory counts its accesses, and the tallies by name."""
    names = ("displacement", "lookup", "counts", "code", "table", "history")
    tallies = {name: Counter() for name in names}
    # a frozen design and its tables are wrapped in place
    design.__dict__["tables"] = tuple(Shelf(table, tallies["code"]) for table in design.tables)
    object.__setattr__(memories, "tables", Shelf(memories.tables, tallies["table"]))
    machine = Machine(memories)
    machine.descriptor = MeteredDescriptor(memories, tallies)
    machine.comparator = MeteredComparator(memories)
    machine.comparator._places = [[Metered(code) for code in place] for place in memories.places]
    history = machine.sequence.history
    machine.sequence.history = [Shelf(row, tallies["history"]) for row in history]
    return machine, tallies


def same(tallies, work, names):
    """Reads and writes of these memories are those that were counted without looking."""
    for name in names:
        told = work.traffic.get(name)
        expected = (told.reads, told.writes) if told else (0, 0)
        assert (tallies[name]["reads"], tallies[name]["writes"]) == expected, name


@pytest.mark.parametrize("seed", range(25))
def test_counts_are_those_of_a_metered_oracle(seed, monkeypatch):
    """Every event, window's end and complete match of a random device and a random stream."""
    monkeypatch.setattr("firmware_model.machine.SearchModel", MeteredSearch)
    rng = np.random.default_rng(seed)
    design = random_design(rng)
    memories = random_memories(rng, design)
    events = wrapped(random_stream(rng, memories, 300), design)
    machine, tallies = metered(design, memories)
    expected, ends = counts.match_work(design), counts.window_work(design)

    def clear():
        for tally in (*tallies.values(), Metered.tally, Line.tally):
            tally.clear()
        MeteredSearch.sums = MeteredComparator.words = 0

    for event in events:
        on_sensor = event.x < design.width and event.y < design.height
        ended = False
        clear()
        for result in machine.descriptor.take(event):
            if isinstance(result, EventResult):
                hit = result.slot is not None
                work = counts.event_work(design, selected=hit)
                assert work.counter_updates == int(hit)
                if on_sensor:
                    same(tallies, work, ("displacement", "lookup"))
                if not ended:
                    # the oracle reads the counter once more, to tell it
                    assert tallies["counts"]["reads"] == 2 * int(hit)
                    assert tallies["counts"]["writes"] == int(hit)
            if not isinstance(result, WindowResult):
                continue
            ended = True
            clear()
            codes = tuple(Metered(code) for code in result.codes)
            match = machine.match(result._replace(codes=codes))
            assert Metered.tally["absolute_differences"] == expected.absolute_differences
            for name in ("query", "places"):
                assert MeteredComparator.words == expected.traffic[name].reads
            assert tallies["history"]["writes"] == expected.traffic["history"].writes
            if match is not None:
                assert Metered.tally["additions"] == expected.additions
                assert 3 * MeteredSearch.sums + 1 == expected.comparisons
                asked = expected.multiplications if match.second_sum else 0
                assert Metered.tally["multiplications"] == asked
                same(tallies, expected, ["history"])
                for name, count in (("writes", MeteredSearch.sums), ("reads", None)):
                    of_delay = getattr(expected.traffic["delay"], name)
                    assert Line.tally[name] == of_delay
                    assert count is None or count == of_delay
            clear()
    # at a window's end each counter is read, coded and cleared, and the codes written as words
    clear()
    ((*_, codes),) = machine.descriptor._end_window()
    of_several = ["table"] * (len(design.full_scales) > 1)
    same(tallies, ends, ["counts", "code", *of_several])
    words = [codes[i : i + design.lanes] for i in range(0, len(codes), design.lanes)]
    assert ends.traffic["query"].writes == len(words)
    assert ends.traffic["query"].bytes_written >= len(codes) * design.code_bits / 8


def test_a_window_touches_each_counter_once():
    """Read, coded and cleared; the code table is read once for each."""
    work = counts.window_work(SMALL)
    assert (work.traffic["counts"].reads, work.traffic["counts"].writes) == (150, 150)
    assert work.traffic["code"].reads == 150
    assert "table" not in work.traffic  # a single table need not be told
    two = replace(SMALL, full_scales=(10, 20))
    assert counts.window_work(two).traffic["table"].reads == 150


def test_absolute_differences_are_the_places_times_the_pixels_of_the_oracle():
    """As many as `naive.sad` takes over a whole map, by hand: 3 places, 4 pixels."""
    design = Design(width=8, height=8, pixels=4, places=3, length=1)
    found = [sad([1, 2, 3, 4], place) for place in ([0, 0, 0, 0], [1, 2, 3, 4], [4, 3, 2, 1])]
    assert len(found) * 4 == counts.match_work(design).absolute_differences
    assert counts.match_work(design).additions == 3 * 3


@pytest.mark.parametrize("seed", range(20))
def test_bytes_are_those_of_the_firmware_image(seed):
    """Without laying it out: flash to the byte, RAM as the C code asks for it."""
    rng = np.random.default_rng(seed)
    design = random_design(rng)
    assert counts.flash_bytes(design) == len(image(random_memories(rng, design)))


def test_bytes_are_those_of_a_saved_map(drive):  # noqa: F811
    """A place of the map, packed; and the design says what the map says."""
    reference = ReferenceMap.load(drive / "map.npz")
    design = design_of(reference)
    size = counts.sizes(design)
    assert size.place_bytes == reference.packed_bytes_per_place
    assert (design.pixels, design.places) == (len(reference.pixel_map), len(reference))
    stored = counts.match_work(design).absolute_differences * reference.places.counts.itemsize
    assert stored == reference.places.counts.nbytes


def test_a_headline_is_the_count_of_a_design():
    """What is compared with all pixels is what is counted elsewhere."""
    found, work = counts.headline(SMALL.slots, SMALL, 10.0), counts.match_work(SMALL)
    assert found.absolute_differences == work.absolute_differences
    assert (found.additions, found.comparisons) == (work.additions, work.comparisons)


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
            places=int(rng.integers(20, 60)), code_bits=int(rng.integers(1, 5)),
        )  # fmt: skip
        assert design not in emulation.FITTED_ON
        counted = emulation.count(target, elf, design, seed)
        told = emulation.predict(design, target.name)
        assert told.match == pytest.approx(counted.match, rel=0.1)
        assert told.window == pytest.approx(counted.window, rel=0.1)


def test_instructions_agree_with_the_table_beside_the_sources():
    """The fitted table against the other one, which the firmware wrote for one design."""
    with TABLE.open(encoding="ascii", newline="") as file:
        rows = {row["target"]: row for row in csv.DictReader(file)}
    assert set(rows) == set(emulation.scaling())
    for core, row in rows.items():
        told = emulation.predict(DESIGN, core)
        assert told.window == pytest.approx(int(row["window_end"]), rel=0.1)
        assert told.match == pytest.approx(int(row["match"]), rel=0.1)
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
            value = found.energy_j["match"]
            assert 0 < value.low <= value.central <= value.high
    for constant in targets.constants().values():
        assert constant.source and constant.node and constant.uncertainty
        assert 0 < constant.value.low <= constant.value.central <= constant.value.high


def test_a_processor_never_gets_the_energy_of_an_operation_table():
    """1,000 places of 150 pixels: an M4 takes tens of microjoules, its arithmetic nanojoules."""
    design = replace(SMALL, places=1000)
    m4 = cost(design, targets.find("cortex-m4"), RATE)
    floor = cost(design, targets.find("generic"), RATE)
    assert m4.energy_j and floor.energy_j
    assert 50e-6 < m4.energy_j["match"].central < 300e-6
    assert m4.energy_j["match"].low > 10 * floor.energy_j["match"].high
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
    found = [f for f in fit(SMALL, target, RATE, [budget]) if 0 < f.value < 1 << 15]
    assert found
    for one in found:
        for more, within in ((0, True), (1, False)):
            values = SMALL.to_dict() | {
                "code_bits": one.code_bits, one.parameter: one.value + more, "lookup_depth": 0,
            }  # fmt: skip
            used = memory_bytes(Design.from_dict(values), target)
            assert (used <= budget.limit) == within


def test_a_design_over_the_firmwares_widths_does_not_fit():
    """Distances of 16 bits: 600 codes of 8 bits could be larger."""
    wide = Design(
        width=64, height=64, pixels=600, places=50, code="linear", code_bits=8, lookup_depth=2048
    )
    assert broken_by(wide, targets.find("cortex-m4"), RATE, ()) == FIRMWARE_LIMITS
    assert broken_by(wide, targets.find("ice40up5k"), RATE, ()) == ""
    assert broken_by(SMALL, targets.find("cortex-m4"), RATE, ()) == ""


def test_evaluated_runs_are_set_against_their_cost(drive, tmp_path, capsys):  # noqa: F811
    """Accuracy of the run, cost of its design on the mission's route, and what limits it."""
    for name, accuracy in (("good", 0.9), ("bad", 0.2)):
        run = tmp_path / name
        run.mkdir()
        (run / "map.npz").write_bytes((drive / "map.npz").read_bytes())
        told = {"evaluation": {"precision_at_100_recall": accuracy}}
        (run / "metrics.json").write_text(json.dumps(told))
    m4, budget = targets.find("cortex-m4"), [Budget.parse("64KiB")]
    short = pareto.candidates(tmp_path, m4, budget)
    assert [one.accuracy for one in short] == [0.9, 0.2]
    assert not any(one.limited_by for one in short) and len(pareto.frontier(short)) == 1
    long = pareto.candidates(tmp_path, m4, budget, places=10_000)
    assert {one.limited_by for one in long} == {"64KiB"}
    drawn = tmp_path / "pareto.png"
    asked = ["estimate", "--target", "cortex-m4", "--fit", "64KiB", "--route-km", "1"]
    assert main([*asked, "--pareto", str(tmp_path), "--figure", str(drawn)]) == 0
    assert "90.0% right" in " ".join(capsys.readouterr().out.split())
    assert drawn.stat().st_size > 1_000
    with pytest.raises(UsageError, match="no evaluated run"):
        pareto.candidates(tmp_path / "good" / "empty", m4, budget)


def test_a_budget_of_power_needs_a_power():
    """A target without a constant cannot be held against milliwatts."""
    with pytest.raises(UsageError, match="unknown"):
        fit(SMALL, targets.find("raspberry-pi-5"), RATE, [Budget.parse("10mW")])
    assert Budget.parse("10mW").limit == pytest.approx(0.01)
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
    assert values["counts"]["match"]["absolute_differences"] == 150 * 1000
    assert main(["estimate", "--map", str(drive / "map.npz"), "--target", "cortex-m4"]) == 0
    assert "5 of 16 x 12 pixels" in capsys.readouterr().out
    rover = ["estimate", "--route-km", "8", "--target", "ice40up5k", "--fit", "64KiB"]
    assert main([*rover, "--fit", "5mW"]) == 0
    assert "limited by" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--fit", "64KiB"], "one target"),
        (["--pareto", "results"], "one target"),
        (["--pixels", "0"], "pixels = 0"),
        (["--places-per-metre", "0"], "positive"),
        (["--event-rate", "-1"], "expected a rate"),
        (["--map", "a.npz", "--design", "b.toml"], "name one"),
        (["--target", "cortex-m4", "--calibrate", "nowhere.json"], "not a profile"),
    ],
)
def test_bad_use_is_one_line(capsys, arguments, says):
    """What was wrong, with which value, and what to do."""
    assert main(["estimate", *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and says in lines[0]
