"""Golden vectors: what is on disk, how it is verified, and that real drives agree with them."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from edge_vpr_tools.cli import main

from edge_vpr.events import Sensor
from edge_vpr.match_result import describe_query
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.recordings import open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from firmware_model import Design, VectorError
from firmware_model.design import page
from firmware_model.emulation.build import EMULATED, SOURCES, build
from firmware_model.emulation.emulator import Emulator
from firmware_model.errors import DesignError
from firmware_model.specification_drive import bias_of, typical_distances
from firmware_model.vectors import (
    CORNERS,
    FILTER_CORNERS,
    cases_within,
    check_files,
    corner_cases,
    coverage,
    estimated_bytes,
    facts,
    filter_suite,
    formats,
    from_binary,
    load_manifest,
    read_results,
    standard_suites,
    to_binary,
    verify,
    write_suites,
)
from firmware_model.vectors.coverage import watched_trace
from firmware_model.vectors.facts import (
    BITS,
    OF_COUNTERS,
    OF_THE_CLOCK,
    bits_of,
    facts_for,
    own_facts,
)
from firmware_model.vectors.filter_suite import filter_cases
from firmware_model.vectors.manifest import FieldPlace
from firmware_model.vectors.random_cases import random_adaptive_design
from tests.streams import random_events, write_drives

DESIGN = Design(width=24, height=16, pixels=9, places=20, length=3, code_bits=3, lanes=4)
FILTER = replace(DESIGN, matching="filter", length=1, code="contrast")


def test_events_are_laid_out_as_the_page_says(tmp_path):
    """A clock of 20 bits, which wraps: time, column, row, and ON as the highest bit."""
    design = replace(DESIGN, timestamp_bits=20, tau_us=50_000)
    write_suites(tmp_path / "v", design, standard_suites(design, 0, "random"), 0)
    ons = set()
    for folder in (tmp_path / "v" / "random").iterdir():
        packed = (folder / "events.bin").read_bytes()
        with (folder / "events.csv").open(newline="") as file:
            rows = [tuple(map(int, row.values())) for row in csv.DictReader(file)]
        read = [
            (int.from_bytes(packed[at : at + 4], "little"),
             int.from_bytes(packed[at + 4 : at + 6], "little"),
             int.from_bytes(packed[at + 6 : at + 8], "little") & 0x7FFF, packed[at + 7] >> 7)
            for at in range(0, len(packed), 8)
        ]  # fmt: skip
        assert read == rows and max(t for t, *_ in rows) < 1 << 20
        ons |= {on for *_, on in rows}
    assert ons == {0, 1}


@pytest.fixture(scope="module")
def vectors(tmp_path_factory):
    """Vectors of a small design."""
    folder = tmp_path_factory.mktemp("golden") / "vectors"
    write_suites(folder, DESIGN, standard_suites(DESIGN, 3), 3)
    return folder


def each_case(folder):
    for name, case in load_manifest(folder).cases():
        yield name, case, folder / name


def correct_results(folder):
    """What a perfect device returns, a list of records."""
    for _, case, place in each_case(folder):
        yield "case", (case.number,)
        yield from from_binary((place / "expected.bin").read_bytes())


@pytest.mark.slow
def test_the_same_seed_makes_the_same_bytes(vectors, tmp_path):
    """Every file, archives too; another seed makes other random cases and the same corners."""
    write_suites(tmp_path / "again", DESIGN, standard_suites(DESIGN, 3), 3)
    write_suites(tmp_path / "other", DESIGN, standard_suites(DESIGN, 4), 4)
    files = sorted(p.relative_to(vectors) for p in vectors.rglob("*") if p.is_file())
    assert len(files) > 500
    differ = set()
    for file in files:
        data = (vectors / file).read_bytes()
        assert data == (tmp_path / "again" / file).read_bytes(), file
        # which cases are of its own, the seed decides too
        other = tmp_path / "other" / file
        if not other.exists() or data != other.read_bytes():
            differ.add(file.parts[0])
    assert differ == {"random", "own", "manifest.json"}


@pytest.mark.parametrize("window", ["time", "count"])
def test_the_corner_suite_reaches_every_corner(window):
    """Whatever windows a design has, as counted in the model's states."""
    design = replace(DESIGN, window=window, window_events=30)
    reached = [
        {corner for corner, n in coverage(c).items() if n and corner not in BITS}
        for c in corner_cases(design)
    ]
    assert set().union(*reached) == set(CORNERS)
    # and no case could stand for all the others
    assert max(map(len, reached)) < len(CORNERS) - 5


def test_corners_change_each_bit_of_the_address_of_a_selected_pixel():
    """A device that leaves a bit out takes the event for one of that pixel."""
    case = next(case for case in corner_cases(DESIGN) if case.name == "events_by_time")
    pixels = set(case.memories.pixels)
    columns, rows = set(), set()
    for event in case.events:
        if (event.x, event.y) not in pixels:
            columns |= {b for b in range(16) if (event.x ^ 1 << b, event.y) in pixels}
            rows |= {b for b in range(15) if (event.x, event.y ^ 1 << b) in pixels}
    assert (columns, rows) == (set(range(16)), set(range(15)))


@pytest.mark.parametrize("places", [1, 4])
def test_a_place_filter_of_fewer_places_than_a_sequence_has_corners(places):
    """Its maps are made for each case, whatever the map of the design."""
    small = replace(DESIGN, matching="filter", length=1, places=places)
    names = [case.name for case in corner_cases(small)]
    assert names == [case.name for case in corner_cases(replace(small, places=20))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("window", "code", "gains"),
    [("time", "counts", 1), ("count", "contrast", 1), ("time", "contrast", 1),
     ("time", "contrast", 7)],
)  # fmt: skip
def test_the_filter_suite_shows_every_fact(window, code, gains):
    """Of a design with the filter, contrast codes, or both; the other suites stay as they are."""
    changes = {"code": code, "window": window, "window_events": 30, "gains": gains}
    design = replace(DESIGN, matching="filter", length=1, **changes)
    suites = standard_suites(design, 0)
    reached = {c for case in suites["filter"] for c, n in coverage(case).items() if n}
    assert reached >= facts_for(design)
    assert all(case.design == design for case in suites["own"])
    by_its_own = {c for case in suites["own"] for c, n in coverage(case).items() if n}
    wanted = own_facts(design)
    assert wanted <= facts_for(design) | OF_THE_CLOCK | OF_COUNTERS | bits_of(design)
    assert len(wanted & by_its_own) > (0.8 if window == "time" else 0.6) * len(wanted)
    large = {"events_above_16_bits"}  # what another fact implies
    assert reached >= large
    assert (facts_for(design) | large >= set(FILTER_CORNERS)) == (gains == 7)
    sequences = replace(design, matching="sequence", length=3, gains=1)
    assert ("filter" in standard_suites(sequences, 0)) == (code == "contrast")
    of_corners = {c for case in suites["corners"] for c, n in coverage(case).items() if n}
    assert of_corners - set(BITS) == set(CORNERS)


@pytest.mark.parametrize("seed", range(8))
def test_the_suite_own_has_cases_of_any_design_itself(seed, monkeypatch):
    monkeypatch.setattr(filter_suite, "OWN_DRAWS", 1)
    rng = np.random.default_rng(seed)
    drawn = iter(lambda: random_adaptive_design(rng, (1, 7)), None)
    design = next(drawn)
    for places in (design.places, design.length + seed % 3):
        design = replace(design, places=places)
        cases = standard_suites(design, seed, "own")["own"]
        assert cases and all(case.design == design for case in cases)
        # NumPy draws them, and the specification writes them
        assert coverage(cases[0]) == watched_trace(cases[0])[1]
        codes = cases[0].memories.places
        assert filter_suite._bias_of(codes) == bias_of(typical_distances(codes))


@pytest.mark.parametrize("code", ["counts", "contrast"])
@pytest.mark.parametrize("window", ["time", "count"])
def test_sequences_have_a_suite_of_their_own(window, code):
    """All facts of counts, most of contrast codes: ties, each bit of a sum and off the sensor."""
    design = replace(DESIGN, window=window, code=code, window_events=30)
    cases = standard_suites(design, 1, "own")["own"]
    assert all(case.design == design for case in cases)
    reached = {c for case in cases for c, n in coverage(case).items() if n}
    wanted = own_facts(design)
    assert len(wanted & reached) >= (1 if code == "counts" else 0.8) * len(wanted)
    assert reached >= {"row_bit_14", "column_bit_5", "sum_bit_5", "tie_of_seconds"}
    assert ("half_a_period_late" in reached) == (window == "time")


@pytest.mark.parametrize("seed", range(2))
def test_cases_made_for_rare_facts_show_them_in_a_map_of_default_settings(seed, monkeypatch):
    """A device that follows fewer gains in a window, for one, passes all other cases."""
    design = replace(
        FILTER, width=128, height=128, pixels=150, places=298, places_per_window=2, gains=7,
        exclusion=6, lookup_depth=0,
    )  # fmt: skip
    wanted = set().union(*map(filter_suite._AIMED.get, filter_suite._ROOMY_KINDS))
    assert wanted <= own_facts(design)
    left = set(wanted)
    monkeypatch.setattr(filter_suite, "own_facts", lambda _: left)
    assert 0 < len(filter_suite.own_cases(design, seed)) <= 7
    assert not left


@pytest.mark.parametrize("gains", [1, 7])
def test_a_device_whose_sums_lack_a_bit_fails_cases_of_its_own_design(gains, monkeypatch):
    """A sum of the distances to many places is wider than any that other designs have."""
    design = replace(FILTER, pixels=24, places=100, gains=gains, exclusion=3, lookup_depth=0)
    bits = {name for name in bits_of(design) if name.startswith(("total", "deviations"))}
    assert {"total_bit_13", "deviations_bit_12"} <= bits
    left = set(bits)
    monkeypatch.setattr(filter_suite, "own_facts", lambda _: left)
    cases = filter_suite.own_cases(design, 0)
    assert not left
    expected = [case.trace().matches for case in cases]
    for name in sorted(bits):
        kind, bit = name.split("_bit_")
        mask = ~(1 << int(bit))
        total, deviations = (mask, -1) if kind == "total" else (-1, mask)

        def spread_of(distances, total=total, deviations=deviations):
            mean = (sum(distances) & total) // len(distances)
            around = sum(abs(d - mean) for d in distances) & deviations
            return max(around // len(distances), 1)

        with facts.replaced("spread_of", spread_of):
            assert [case.trace().matches for case in cases] != expected, name


def test_to_restart_in_a_pause_is_a_fact_where_to_stay_costs_more():
    for places, restart in product((1, 2), range(31)):
        design = replace(FILTER, places_per_window=places, restart=restart)
        assert ("pause_restarted" in own_facts(design)) == (restart <= (7, 12)[places - 1])


def test_a_fact_that_no_case_shows_fails_the_build(monkeypatch):
    monkeypatch.setattr(filter_suite, "facts_for", lambda _: {"first_window", "never"})
    monkeypatch.setattr(filter_suite, "MOST_DRAWS", 1)
    with pytest.raises(VectorError, match="no case of 1 of each kind shows these facts: never"):
        filter_cases(FILTER)


def test_the_manifest_names_every_file_and_its_hash(vectors):
    """No file beside those of the manifest; each as long as it says, with its SHA-256."""
    named = {vectors / name for name in ("manifest.json", "design.toml", "README.md")}
    for _, case, place in each_case(vectors):
        for name, told in case.files.items():
            data = (place / name).read_bytes()
            assert (len(data), hashlib.sha256(data).hexdigest()) == (told.bytes, told.sha256)
            named.add(place / name)
    assert named == {path for path in vectors.rglob("*") if path.is_file()}
    assert check_files(vectors) == len(named) - 3


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda manifest: manifest.pop("suites"), "'suites'"),
        (lambda manifest: manifest["suites"][0].pop("name"), "argument: 'name'"),
        (lambda manifest: manifest["suites"].append(3), "is not a mapping"),
        (lambda manifest: manifest["suites"][0]["cases"][0].pop("number"), "argument: 'number'"),
        (
            lambda manifest: manifest["suites"][0]["cases"][0]["files"].update(x=[]),
            "must be a mapping",
        ),
        (lambda manifest: manifest["design"].update(pixels=-1), "pixels = -1"),
        (lambda manifest: manifest.update(schema=99), "has schema 99"),
    ],
)
def test_a_damaged_manifest_is_one_line(vectors, tmp_path, damage, says):
    """Which names what is wrong, and what to do."""
    manifest = json.loads((vectors / "manifest.json").read_text())
    assert load_manifest(vectors).to_json() == manifest
    damage(manifest)
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(VectorError, match=f"{says}.*make the vectors again"):
        load_manifest(tmp_path)


def test_a_changed_file_is_found(vectors, tmp_path):
    """One byte of one file."""
    shutil.copytree(vectors, tmp_path / "copy")
    changed = tmp_path / "copy" / "corners" / "tie_of_two" / "places.mem"
    data = bytearray(changed.read_bytes())
    data[3] ^= 1
    changed.write_bytes(data)
    with pytest.raises(VectorError, match=r"places\.mem was changed"):
        check_files(tmp_path / "copy")
    changed.unlink()
    with pytest.raises(VectorError, match="cannot read"):
        check_files(tmp_path / "copy")


def unpack(word: int, fields: tuple[FieldPlace, ...]) -> dict[str, int]:
    return {f.field: word >> f.lowest_bit & ((1 << f.bits) - 1) for f in fields}


def table(path: Path) -> list[list[int]]:
    """Read the numbers of a CSV file below its line of names."""
    return [[int(value) for value in line.split(",")] for line in path.read_text().split()[1:]]


def test_all_forms_of_a_memory_hold_the_same(vectors):
    """`.mem`, COE and MIF word by word; unpacked by the manifest alone, they are those of CSV."""
    for name, case, place in each_case(vectors):
        words = {
            stem: [int(line, 16) for line in (place / f"{stem}.mem").read_text().split()]
            for stem in case.words
        }
        for stem in ("displacement", "lookup", "places"):
            coe = (place / f"{stem}.coe").read_text().split("vector=")[1]
            assert [int(w.strip(" ;\n"), 16) for w in coe.split(",")] == words[stem]
            mif = (place / f"{stem}.mif").read_text().split("CONTENT BEGIN")[1].split("\n")[1:-2]
            pairs = [line.rstrip(";").split(" : ") for line in mif]
            assert [int(a, 16) for a, _ in pairs] == list(range(len(words[stem])))
            assert [int(w, 16) for _, w in pairs] == words[stem]
        taken = {stem: [unpack(word, case.words[stem]) for word in words[stem]] for stem in words}
        events = [[e[column] for column in ("t", "x", "y", "on")] for e in taken["events"]]
        assert events == table(place / "events.csv"), name
        lanes, slots = case.design.lanes, case.design.slots
        windows = [row[2:] for row in table(place / "expected_windows.csv")]
        for stem, rows in (("places", table(place / "places.csv")), ("expected_windows", windows)):
            flat = [word[f"lane_{i}"] for word in taken[stem] for i in range(lanes)]
            packed = np.array(flat).reshape(len(rows), -1)
            assert packed[:, :slots].tolist() == rows and not packed[:, slots:].any()
        matches = table(place / "expected_matches.csv")
        for match, row in zip(taken["expected_matches"], matches, strict=True):
            window, best, total, second, second_sum, ties, accepted = row
            assert (match["window"], match["place"], match["sum"]) == (window, best, total)
            assert (match["ties"], match["accepted"]) == (ties, accepted)
            assert match["has_second"] == (second >= 0)
            assert second < 0 or (match["second"], match["second_sum"]) == (second, second_sum)


@pytest.mark.parametrize("gains", [1, 7])
def test_states_of_a_case_are_those_that_its_matches_come_from(tmp_path, gains):
    """Margin, trust and least metric as in the matches, the rest by the rules of the page."""
    design = replace(DESIGN, matching="filter", length=1, code="contrast", gains=gains)
    of_kinds = (
        "bursts", "clear", "drive", "halts", "loud", "numbers", "quiet", "speeds", "sums", "times",
    )  # fmt: skip
    chosen = [case for case in filter_cases(design) if case.name.startswith(of_kinds)]
    write_suites(tmp_path / "v", design, {"filter": chosen}, 0)
    kinds = set()
    for case in chosen:
        folder = tmp_path / "v" / "filter" / case.name
        rows = {}
        for name in ("states", "matches"):
            with (folder / f"expected_{name}.csv").open(encoding="ascii") as file:
                lines = csv.DictReader(file)
                rows[name] = [{k: int(v) for k, v in row.items()} for row in lines]
        assert len(rows["states"]) == len(rows["matches"]) > 1
        several, activity = case.design.gains > 1, case.memories.activity
        own, before = -1, None
        for state, match in zip(rows["states"], rows["matches"], strict=True):
            mean_activity, counted = state["mean_activity"], state["counted"]
            assert state["paused"] == (counted == 0 or 2048 * counted < mean_activity)
            # floor(16 log2(n)) of numbers up to some thousands, which are no powers of 2^(1/16)
            mean = activity if several else mean_activity
            logs = [math.floor(16 * math.log2(1 + n) + 1e-9) for n in (counted, mean >> 8)]
            assert state["activity"] == (logs[0] - logs[1] if counted else -368)
            weight, few = 8, bool(state["paused"])
            if before is not None:
                own_activity = case.memories.place_activity[before["best"]]
                surplus = state["activity"] - own_activity - min(before["gain"], 0)
                weight = min(max((surplus + 56) // 2, 0), 8)
                few = few or surplus < -48
            assert state["weight"] == (0 if state["paused"] else weight)
            in_row = 0 if before is None else before["few"]
            assert state["few"] == (min(in_row + 1, 3) if few else 0)
            assert state["stands"] == (state["few"] == 3)
            assert several or (state["speed"], state["sums"], state["gain"]) == (0, 1, 0)
            contrast = case.design.code == "contrast"
            assert contrast or (state["window_mean"], state["mean_shift"]) == (-1, -1)
            whole = max(state["support"] - 16 * state["worst_residual"], 0)
            assert (state["least"], whole * state["age"] // 8) == (match["sum"], match["trust"])
            assert 0 <= state["worst_residual"] <= 23
            alone = match["second"] == -1
            assert state["margin"] == (127 if alone else match["second_sum"] - match["sum"])
            if state["paused"]:
                assert state["reciprocal"] == state["spread"] == -1
            elif not several:  # of several sums, the best gain may look at another one
                reciprocal = 65_536 // state["spread"]
                assert state["reciprocal"] == (reciprocal if own < 0 else own)
                own = reciprocal
            raised = state["kept"] + (16 * min(state["margin"], 23) - state["kept"]) // 4
            if before is not None and state["best"] == before["best"]:
                raised = min(raised, state["kept"] - state["kept"] // 8)
            assert state["support"] == raised
            before = state
            kinds.add((state["weight"], state["paused"], contrast and state["window_mean"] < 0))
    assert {weight for weight, _, _ in kinds} == set(range(9))
    assert {kind[1:] for kind in kinds} == set(product((0, 1), (False, True)))
    manifest = json.loads((tmp_path / "v" / "manifest.json").read_text(encoding="utf-8"))
    assert "1/256 event" in manifest["units"]["activity of a case, mean_activity"]


def test_intel_hex_gives_the_image_back(vectors):
    """Lines of a correct checksum, also across 64 KiB and of an odd length."""

    def decode(text: str) -> dict[int, int]:
        bytes_at, upper = {}, 0
        for line in text.split():
            data = bytes.fromhex(line[1:])
            assert line[0] == ":" and sum(data) & 0xFF == 0 and data[0] == len(data) - 5
            if data[3] == 4:
                upper = int.from_bytes(data[4:6], "big") << 16
            elif data[3] == 0:
                at = upper | int.from_bytes(data[1:3], "big")
                bytes_at |= {at + i: byte for i, byte in enumerate(data[4:-1])}
        assert text.endswith(":00000001FF\n")
        return bytes_at

    _, _, place = next(each_case(vectors))
    image = (place / "image.bin").read_bytes()
    assert decode((place / "image.hex").read_text()) == dict(enumerate(image))
    data = bytes(i * i >> 8 & 0xFF for i in range(0x2_0123))
    assert decode(formats.intel_hex(data)) == dict(enumerate(data))


def test_a_c_program_of_nothing_but_a_header_passes(vectors, tmp_path):
    """The C header holds all that a device needs to test itself."""
    pytest.importorskip("ziglang", reason="ziglang is not installed (extra firmware)")
    main_c = tmp_path / "main.c"
    main_c.write_text(
        '#include <string.h>\n#include "replay.h"\n#include "case.h"\n'
        "static uint32_t ram[1U << 14];\nstatic uint32_t out[1U << 18];\n"
        "int main(void)\n{\n"
        "    const uint32_t words = vpr_replay(case_image, CASE_IMAGE_BYTES,\n"
        "        (const vpr_event_t *)(const void *)case_events, CASE_EVENTS_BYTES / 8U, 1U,\n"
        "        CASE_START, ram, sizeof ram, out, 1U << 18);\n"
        "    return (words * 4U == CASE_EXPECTED_BYTES) && "
        "(memcmp(out, case_expected, CASE_EXPECTED_BYTES) == 0) ? 0 : 1;\n}\n"
    )
    program = tmp_path / "self-test"
    place = vectors / "corners" / "events_by_time"
    command = [sys.executable, "-m", "ziglang", "cc", "-std=c11", "-O2", f"-I{SOURCES}"]
    command += [f"-I{place}", main_c, SOURCES / "vpr.c", SOURCES / "replay.c", "-o", program]
    environment = os.environ | {"ZIG_LOCAL_CACHE_DIR": str(tmp_path)}
    subprocess.run(command, check=True, capture_output=True, env=environment)
    assert subprocess.run([program], check=False).returncode == 0


def test_correct_results_pass(vectors, tmp_path):
    """As binary and as CSV, all cases or some, and where only matches are returned."""
    records = list(correct_results(vectors))
    (tmp_path / "r.bin").write_bytes(to_binary(records))
    verdict = verify(vectors, read_results(tmp_path / "r.bin"))
    cases = len(list(each_case(vectors)))
    assert verdict.differences == [] and verdict.cases == verdict.total == cases
    assert verdict.compared["event"] > 10_000 and verdict.compared["match"] > 100
    names = {case.number: name for name, case, _ in each_case(vectors)}
    with (tmp_path / "r.csv").open("w") as file:
        for kind, values in records:
            told = [names[values[0]]] if kind == "case" else values
            file.write(",".join(map(str, (kind, *told))).replace("4294967295", "-1") + "\n")
    assert verify(vectors, read_results(tmp_path / "r.csv")) == verdict
    matches = [r for r in records if r[0] in ("case", "match")]
    assert verify(vectors, matches, kinds=("match",)).differences == []
    assert len(verify(vectors, matches).differences) == cases


def test_the_first_difference_is_pointed_at(vectors):
    """Event, pixel, expected and got; window and slot; a match's field; and what is missing."""
    name = "corners/events_by_time"
    place = vectors / "corners" / "events_by_time"
    good = list(from_binary((place / "expected.bin").read_bytes()))
    pixels = list(csv.reader((place / "pixels.csv").read_text().splitlines()))[1:]

    def said(records) -> str:
        differences = verify(vectors, records, case=name).differences
        assert len(differences) == 1 and differences[0].startswith(name)
        return differences[0].removeprefix(f"{name}: ")

    def replaced(at, values):
        return [*good[:at], (good[at][0], tuple(values)), *good[at + 1 :]]

    def first(kind, after=0):
        return next(i for i, r in enumerate(good) if r[0] == kind and i >= after)

    at = next(i for i, (kind, v) in enumerate(good) if kind == "event" and i > 50 and v[2] > 2)
    number, slot, count = good[at][1]
    count_less = replaced(at, (number, slot, count - 1))
    # a later fault is not the first
    count_less[-1] = (good[-1][0], (999, *good[-1][1][1:]))
    x, y = pixels[slot]
    expected = f"event {number} at pixel ({x}, {y}): count: expected {count}, got {count - 1}"
    assert said(count_less) == expected
    at_window, (x, y) = first("window", after=20), pixels[4]
    values = list(good[at_window][1])
    values[2 + 4] ^= 1
    wrong_code = said(replaced(at_window, values))
    assert f"code of slot 4, pixel ({x}, {y}): expected" in wrong_code
    at_match = first("match")
    match = list(good[at_match][1])
    match[3] = 0xFFFF_FFFF
    no_second = said(replaced(at_match, match))
    assert f"match of window {match[0]} (after event" in no_second
    assert no_second.endswith("got none")
    assert "nothing was returned" in said(good[:-1])
    assert "expected 3 values, got 2" in said(replaced(at, (number, slot)))
    assert "beyond the last one" in said([*good, good[0]])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("r.bin", b"123", "expected 32-bit words"),
        ("r.bin", b"\x09\0\0\0\0\0\0\0", "begins no whole record"),
        ("r.bin", b"\x01\0\0\0\x03\0\0\0", "begins no whole record"),
        ("r.csv", b"evnt,1,2,3\n", "line 1: 'evnt,1,2,3' is no record: begin"),
        ("r.csv", b"case,a/b\nevent,1,x,3\n", "line 2: 'event,1,x,3' is no record: begin"),
        ("r.csv", b"case,a/b\nevent,1,1_0,3\n", "line 2: 'event,1,1_0,3' is no record: begin"),
        ("r.csv", b"window,place,sum\n0,40,0\n", "lack the kind"),
        ("r.csv", b"case,a/b\nevent,0,0,0\n", "results of a case 'a/b'"),
        ("r.csv", b"event,0,0,0\n", "names no case: .* --case SUITE/NAME"),
        ("r.csv", b"\n", "empty"),
        ("r.csv", "case,a/b\n".encode("utf-16"), "the byte 0xff, .* save them as UTF-8"),
        ("r.csv", "case,a/b\n".encode("utf-8-sig"), "the byte 0xef, .* byte order mark"),
        ("r.bin", b"\0\0\0\0\x01\0\0\0\xff\0\0\0", "case number"),
        ("r.jsonl", b'{"match": 3}\n', r"name a \.csv or \.bin file"),
    ],
)
def test_results_that_cannot_be_read_are_refused(vectors, tmp_path, name, content, message):
    """Each error says where and what was expected."""
    (tmp_path / name).write_bytes(content)
    with pytest.raises(VectorError, match=message):
        verify(vectors, read_results(tmp_path / name))


def test_only_an_empty_folder_is_written_to(vectors):
    """Vectors are not mixed with others."""
    with pytest.raises(VectorError, match="not an empty folder"):
        write_suites(vectors, DESIGN, {}, 0)
    with pytest.raises(VectorError, match="name a folder of vectors"):
        load_manifest(vectors / "corners")


@pytest.mark.slow
def test_the_command_makes_and_verifies_vectors(tmp_path, run, refused):
    """From a design's file; the summary counts cases; a wrong result ends with exit code 1."""
    DESIGN.save(tmp_path / "design.toml")
    vectors, results = tmp_path / "vectors", tmp_path / "results.bin"
    made = ["golden", "--design", tmp_path / "design.toml", "-o", vectors]
    assert f"{len(CORNERS)} of its {len(CORNERS)} facts" in run(*made).out
    assert "files are as they were made" in run("golden", "verify", vectors).out
    records = list(correct_results(vectors))
    verified = ["golden", "verify", vectors, "--results", results]
    results.write_bytes(to_binary(records))
    out, said = run(*verified)
    assert "equal records" in out and "facts" not in said and "lack" not in said
    few = ["--suite", "own", "--suite", "corners", "--vectors", "200KB", "-o", tmp_path / "few"]
    run(*made[:3], *few)
    (tmp_path / "few.bin").write_bytes(to_binary(correct_results(tmp_path / "few")))
    said = run("golden", "verify", tmp_path / "few", "--results", tmp_path / "few.bin").err
    assert re.search(r"own shows \d+ of its \d+ facts, and no fault in the others", said)
    run(*made[:3], "--suite", "corners", "-o", tmp_path / "rest")
    (tmp_path / "rest.bin").write_bytes(to_binary(correct_results(tmp_path / "rest")))
    said = run("golden", "verify", tmp_path / "rest", "--results", tmp_path / "rest.bin").err
    assert "these vectors lack the suite own, without which many faults are not found" in said
    second = [i for i, (kind, _) in enumerate(records) if kind == "case"][1]
    results.write_bytes(to_binary(records[:second]))
    assert "were not verified, such as corners/" in run(*verified, code=1).err
    at = next(i for i, (kind, _) in enumerate(records) if kind == "match")
    records[at] = ("match", (*records[at][1][:6], 1 - records[at][1][6]))
    results.write_bytes(to_binary(records))
    error = run(*verified, code=1).err
    assert "accepted: expected" in error and "1 of " in error
    assert "not an empty folder" in refused(*made)
    for wrong in (
        ["golden"],
        ["golden", "verify"],
        ["golden", "make", "x"],
        [*verified, "--only", "a"],
    ):
        refused(*wrong)


def same_as_the_pipeline(folder, map_file, query) -> int:
    """Hold the suite `recording` to what the pipeline makes of the same drive."""
    reference = ReferenceMap.load(map_file)
    drive = folder / "recording" / "drive"
    recording = open_recording(query)
    device = replace(reference.settings, smooth=False)
    reference = replace(reference, settings=device)
    queries = describe_query(reference, recording)
    windows = np.array(table(drive / "expected_windows.csv"))[:, 2:]
    assert 0 < len(windows) <= len(queries)
    assert np.array_equal(windows, queries.counts[: len(windows)])
    matches = match_descriptors(reference.places, queries, device)
    length = device.windows_per_match
    end = length - 1 - length // 2  # from the middle window of a sequence to the newest
    rows = table(drive / "expected_matches.csv")
    second_distance = np.where(matches.second < 0, -1 / length, matches.second_distance)
    for row, i in zip(rows, range(len(matches)), strict=False):
        assert row[0] == matches.query[i] + end
        assert row[1] == matches.place[i] + end and row[2] / length == matches.distance[i]
        assert row[4] / length == second_distance[i] and row[5] == matches.ties[i]
        assert row[3] == (matches.second[i] + end if matches.second[i] >= 0 else -1)
        assert device.matching == "sequence" or row[7] == matches.trust[i]
    return len(rows)


@pytest.mark.parametrize(
    ("suite", "says"),
    [
        ("filter", "--suite filter: this design has neither place filter nor contrast codes"),
        ("recording", "--suite recording needs a drive: name one with --recording"),
    ],
)
def test_a_suite_that_a_design_has_not_is_refused(suite, says, tmp_path, refused):
    DESIGN.save(tmp_path / "design.toml")
    golden = ["golden", "--design", tmp_path / "design.toml", "-o", tmp_path / "vectors"]
    assert says in refused(*golden, "--suite", suite)
    assert not (tmp_path / "vectors").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        [],
        ["--preset", "paper", "--window", "count", "--counter-code", "linear"],
        ["--preset", "paper"],
        ["--places-per-window", "2"],
    ],
    ids=["defaults", "saturating counts, windows by number", "counts", "half windows"],
)
def test_a_map_and_a_recording_make_vectors_that_are_the_pipelines_matches(tmp_path, settings, run):
    """All windows and matches of a random drive, by counts and by codes."""
    write_drives(tmp_path, 6_000, Sensor(16, 12), 3_000_000)
    made, query = tmp_path / "map.npz", tmp_path / "query.npz"
    flags = ["--pixels", 8, "--sigma", 1, "--tau", "50ms", "-L", 3, *settings]
    run("map", tmp_path / "reference.npz", "-o", made, *flags)
    golden = ["golden", "--map", made, "--recording", query, "--max-windows", 60]
    # what a map's own design makes of the other suites is seen once, and of any design elsewhere
    only = [] if not settings else ["--suite", "recording"]
    run(*golden, *only, "-o", tmp_path / "vectors")
    assert same_as_the_pipeline(tmp_path / "vectors", made, query) > 5
    manifest = json.loads((tmp_path / "vectors" / "manifest.json").read_text())
    suites = [suite["name"] for suite in manifest["suites"]]
    every = ["corners", "random", "filter", "own", "recording"]
    assert suites == (["recording"] if settings else every)


@pytest.mark.slow
def test_a_real_drive_makes_vectors_that_are_the_pipelines_matches(tmp_path, shared_data, run):
    """Events of a camera in a car, at 30 of 1280 x 720 pixels."""
    drive = shared_data / "recordings" / "evt3_gen41_1280x720_driving.raw"
    made = tmp_path / "map.npz"
    run("map", drive, "-o", made, "--pixels", 30, "--tau", "200us")
    golden = ["golden", "--map", made, "--recording", drive, "--max-windows", 40]
    run(*golden, "--suite", "random", "--suite", "recording", "-o", tmp_path / "vectors")
    assert same_as_the_pipeline(tmp_path / "vectors", made, drive) > 10
    pytest.importorskip("unicorn", reason="unicorn is not installed (extra firmware)")
    pytest.importorskip("ziglang", reason="ziglang is not installed (extra firmware)")
    for target in EMULATED:
        emulator = Emulator(target, build(target, tmp_path))
        for name, case, place in each_case(tmp_path / "vectors"):
            if name.startswith(("random", "recording")):
                flash, events = ((place / f"{n}.bin").read_bytes() for n in ("image", "events"))
                records = emulator.replay(flash, events, case.start, 1 << 20)
                assert records == (place / "expected.bin").read_bytes(), (target.name, name)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A map of 8 pixels, and a drive of 3 s of which few events are at these."""
    folder = tmp_path_factory.mktemp("recorded")
    rng, sensor = np.random.default_rng(5), Sensor(64, 48)
    for name in ("reference", "query"):
        events = random_events(rng, 40_000, sensor, 3_000_000)
        write_recording(folder / f"{name}.npz", [events], sensor=sensor)
    made, query = folder / "map.npz", folder / "query.npz"
    flags = ["--pixels", "8", "--sigma", "1", "--tau", "100ms"]
    assert main(["map", str(folder / "reference.npz"), "-o", str(made), *flags]) == 0
    return made, query


def test_a_recording_is_limited_in_windows(recorded, tmp_path, run):
    """20 windows by default, whatever the rate of events."""
    made, query = recorded
    golden = ["golden", "--map", made, "--recording", query, "--suite", "recording", "-o"]
    for i, (flags, windows) in enumerate((([], 20), (["--max-windows", 7], 7))):
        folder = tmp_path / f"v{i}"
        run(*golden, folder, *flags)
        drive = folder / "recording" / "drive"
        for kind in ("windows", "matches"):
            assert len(table(drive / f"expected_{kind}.csv")) == windows
        # events elsewhere are in it too
        slots = [slot for _, slot, _ in table(drive / "expected_events.csv")]
        elsewhere = slots.count(-1)
        assert 0 < elsewhere <= len(slots) - elsewhere + 1
        parts = ("image", "events", "expected")
        assert sum((drive / f"{p}.bin").stat().st_size for p in parts) < 504 * 1024
        same_as_the_pipeline(folder, made, query)
    said = run(*golden, tmp_path / "v", "--max-windows", 60).err
    assert "of --max-windows 60: the drive is shorter" in said


def test_a_recording_that_fits_no_flash_is_told(recorded, tmp_path, run, monkeypatch):
    made, query = recorded
    golden = ["golden", "--map", made, "--recording", query, "--suite", "recording"]
    run(*golden, "-o", tmp_path / "v")
    drive = tmp_path / "v/recording/drive"
    size = sum((drive / f"{each}.bin").stat().st_size for each in ("image", "events", "expected"))
    assert (drive / "case.h").exists()
    for module in ("firmware_model.vectors", "firmware_model.vectors.suite"):
        monkeypatch.setattr(f"{module}.FLASH_BYTES", size - 1)
    said = run(*golden, "-o", tmp_path / "w").err
    assert f"with events and records {size:,}, and the flash of the example {size - 1:,}" in said
    drive = tmp_path / "w/recording/drive"
    assert (drive / "image.hex").exists() and not (drive / "case.h").exists()

    def too_large(_):
        raise DesignError("too large for the image")

    monkeypatch.setattr("firmware_model.vectors.suite.image", too_large)
    monkeypatch.setattr("firmware_model.vectors.FLASH_BYTES", 1)
    assert "case.h" not in run(*golden, "-o", tmp_path / "x").err
    assert not (tmp_path / "x/recording/drive/image.bin").exists()


@pytest.mark.parametrize(
    ("sensor", "duration_us", "flags", "code", "says"),
    [
        (Sensor(64, 48), 40_000, [], 2, "no match in its first 20 windows, of 0.1 s"),
        (Sensor(64, 48), 40_000, ["--max-windows", 0], 2, "--max-windows 0: a match takes 1"),
        (Sensor(60, 40), 3_000_000, [], 1, "the recording is of a 60x40 sensor"),
        (Sensor(128, 96), 3_000_000, [], 1, "the recording is of a 128x96 sensor"),
    ],
)
def test_a_recording_without_a_match_is_an_error(
    sensor, duration_us, flags, code, says, recorded, tmp_path, refused
):
    """Shorter than a window, or of another camera; nothing is written."""
    other = tmp_path / "other.npz"
    events = random_events(np.random.default_rng(1), duration_us // 800, sensor, duration_us)
    write_recording(other, [events], sensor=sensor)
    golden = ["golden", "--map", recorded[0], "-o", tmp_path / "v", "--recording", other]
    assert says in refused(*golden, *flags, code=code)
    assert not (tmp_path / "v").exists()


def test_vectors_have_a_size_of_choice(tmp_path, run):
    """How many cases are left out is said; a README says how to check."""
    DESIGN.save(tmp_path / "design.toml")
    golden = ["golden", "--design", tmp_path / "design.toml", "--suite", "corners"]
    golden += ["-o", tmp_path / "v", "--vectors"]
    out, err = run(*golden, "1MB")
    assert "v/corners: " in out
    left_out, whole = re.search(
        r"leaves cases out: (\d+) of \d+ of corners; --vectors (\w+) keeps", err
    ).groups()
    assert "no case that is left shows these facts: " in err
    size = sum(p.stat().st_size for p in (tmp_path / "v").rglob("*") if p.is_file())
    assert 0.4e6 < size < 1.3e6
    assert "golden verify" in (tmp_path / "v" / "README.md").read_text()
    run("golden", "verify", tmp_path / "v")
    run(*golden, "500kB", "--overwrite")
    every = standard_suites(DESIGN, 0, "corners")["corners"]
    assert f"v/corners: {len(every)} cases" in run(*golden, whole, "--overwrite").out
    assert f"v/corners: {len(every) - int(left_out)} of {len(every)} cases" in out
    # every case is announced, for the progress
    told = []
    cases = {"corners": every[:3]}
    write_suites(tmp_path / "w", DESIGN, cases, 0, on_case=told.append)
    assert [text.split(":")[0] for text in told] == [f"case {n} of 3" for n in (1, 2, 3)]


@pytest.mark.parametrize("most", [5e5, 2e6])
def test_cases_of_a_size_reach_more_corners_than_the_smallest_ones(most):
    suites = standard_suites(DESIGN, 0)
    chosen = cases_within(suites, most)
    assert sum(estimated_bytes(case) for cases in chosen.values() for case in cases) <= most
    by_size = sorted(suites["corners"], key=estimated_bytes)
    sizes = np.cumsum([estimated_bytes(case) for case in by_size])
    chosen_corners, smallest_corners = (
        {corner for case in cases for corner, times in coverage(case).items() if times}
        for cases in (chosen["corners"], by_size[: np.searchsorted(sizes, most)])
    )
    assert len(chosen_corners) > len(smallest_corners)
    assert cases_within(suites, np.inf) == suites


def test_quiet_prints_nothing_but_errors(vectors, recorded, tmp_path, run):
    """Neither results, nor tables, nor notes; a difference is in the error itself."""
    made, query = recorded
    truth, results = tmp_path / "truth.csv", tmp_path / "results.bin"
    truth.write_text("query_s,reference_s\n0,0\n3,3\n")
    for words in (
        ["info", query],
        ["estimate", "--map", made, "--target", "cortex-m4"],
        ["golden", "verify", vectors],
        ["golden", "--map", made, "--suite", "recording", "--recording", query,
         "-o", tmp_path / "v"],
        ["match", made, query, "-o", tmp_path / "run"],
        ["evaluate", tmp_path / "run", "--ground-truth", truth, "--tolerance", 0.2],
        ["ports"],
    ):  # fmt: skip
        assert run(*words, "-q") == ("", ""), words
    results.write_bytes(to_binary([("case", (0,)), ("match", (1, 2, 3, 4, 5, 6, 7))]))
    out, err = run("golden", "verify", vectors, "--results", results, "-q", code=1)
    assert out == "" and err.count("\n") == 1 and "first in corners/" in err


def test_the_page_has_every_key_of_a_design():
    """With its default, its range, and what it is."""
    page_file = Path(__file__).parents[2] / "docs" / "vectors.md"
    assert page() in page_file.read_text(encoding="utf-8")
