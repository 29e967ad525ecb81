"""Suites of cases on disk: stimuli, memory images, expected results, and a manifest of them."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path

import numpy as np

from firmware_model.design import LEVELS, Design, widths_of
from firmware_model.errors import DesignError, VectorError
from firmware_model.hardware.parameters import PACKAGE, package
from firmware_model.hardware.sources import SIMULATED, copy_sources
from firmware_model.image import image, kept_bytes, ram_bytes
from firmware_model.memories import Codes, Memories
from firmware_model.specification import MatchResult, Trace, WindowState
from firmware_model.vectors import formats
from firmware_model.vectors.case import NONE, Case, in_order, records, to_binary
from firmware_model.vectors.corners import corner_cases
from firmware_model.vectors.coverage import ALL, CORNERS, coverage, watched_trace
from firmware_model.vectors.facts import FILTER_CORNERS, OF_SEQUENCES
from firmware_model.vectors.filter_suite import filter_cases, own_cases
from firmware_model.vectors.formats import Table
from firmware_model.vectors.manifest import (
    MANIFEST,
    README,
    RTL_FOLDER,
    CaseEntry,
    FileEntry,
    Manifest,
    SuiteEntry,
)
from firmware_model.vectors.random_cases import random_cases, window_cases

#: what the examples keep in the flash of their board, and its size: larger cases have no `case.h`
FLASHED = ("image.bin", "events.bin", "expected.bin")
FLASH_BYTES = 512 << 10


def memory_words(memories: Memories) -> dict[str, Table]:
    """Pack the contents of every memory, by the names of their files."""
    design, lookup = memories.design, memories.lookup()
    bits = widths_of(design)
    entries = zip(lookup.slot, lookup.owner, strict=True)
    words = {
        "displacement": _single("address", bits["address"], lookup.displacement),
        "lookup": formats.pack((("slot", bits["slot"]), ("owner", bits["owner"])), entries),
        "places": _descriptors(memories, memories.places),
    }
    if design.contrast:
        words["levels"] = _single("level", bits["level"], LEVELS)
        words["means"] = _single("mean", bits["level"], memories.mean)
        words["limits"] = _single("limit", bits["limit"], memories.limits)
    if design.filters:
        width = bits["place_activity"]
        unsigned = (activity % (1 << width) for activity in memories.place_activity)
        words["place_activity"] = _single("place_activity", width, unsigned)
        words["place_bias"] = _single("place_bias", bits["place_bias"], memories.place_bias)
    return words


def _descriptors(memories: Memories, descriptors: Iterable[Codes]) -> Table:
    """Pack descriptors, as many codes a word as the design has lanes.

    Lane 0 is in the least significant bits; zeros fill up the last word of each descriptor.
    """
    design = memories.design
    fields = tuple((f"lane_{lane}", design.code_bits) for lane in range(design.lanes))
    padding = (0,) * (design.words * design.lanes - design.slots)
    padded = ((*codes, *padding) for codes in descriptors)
    firsts = range(0, design.slots, design.lanes)
    words = (codes[first : first + design.lanes] for codes in padded for first in firsts)
    return formats.pack(fields, words)


def _single(name: str, bits: int, values: Iterable[int]) -> Table:
    return formats.pack(((name, bits),), ((value,) for value in values))


# The contents of a case's files: words of memories, CSV and arrays.


def word_tables(case: Case, done: Trace) -> dict[str, Table]:
    """Return everything that is written as words."""
    design = case.design
    bits = widths_of(design)
    time_bits = 32 if design.timestamp_bits <= 32 else 64
    start = case.start % (1 << design.timestamp_bits)
    match = (
        ("window", 32),
        ("place", bits["place"]),
        ("sum", bits["sum"]),
        ("has_second", 1),
        ("second", bits["place"]),
        ("second_sum", bits["sum"]),
        ("ties", bits["place"]),
        ("accepted", 1),
        *([("trust", bits["trust"])] if design.filters else []),
    )
    packed = memory_words(case.memories) | {
        "start": _single("t", time_bits, [start]),
        "events": formats.pack((("t", time_bits), ("x", 16), ("y", 15), ("on", 1)), case.events),
        "expected_events": formats.pack(
            (("selected", 1), ("slot", bits["slot"]), ("count", bits["count"])),
            ((r.slot is not None, r.slot or 0, r.counted) for r in done.events),
        ),
        "expected_matches": formats.pack(
            match,
            (
                (
                    *(m.window, m.place, m.sum, m.second is not None),
                    *(m.second or 0, m.second_sum or 0, m.ties, m.accepted),
                    *(() if m.trust is None else (m.trust,)),
                )
                for m in done.matches
            ),
        ),
    }
    if design.pauses:
        packed["activity"] = _single("activity", bits["activity"], [case.memories.activity])
    windows = (window.codes for window in done.windows)
    packed["expected_windows"] = _descriptors(case.memories, windows)
    return packed


def csv_files(case: Case, done: Trace) -> dict[str, str]:
    """Return the tables of a case and of its results as CSV text; -1 stands for an absent value."""
    slots = range(case.design.slots)
    numbered: dict[str, list[tuple[int, ...]]] = {"event": [], "window": [], "match": []}
    for kind, values in records(in_order(done)):
        numbered[kind].append(tuple(-1 if value == NONE else value for value in values))
    window = ("window", "events", *(f"slot_{slot}" for slot in slots))
    match = MatchResult._fields if case.design.filters else MatchResult._fields[:-1]
    files = {}
    if done.states:
        states = [tuple(-1 if v is None else int(v) for v in state) for state in done.states]
        files["expected_states.csv"] = formats.csv_text(WindowState._fields, states)
    return files | {
        "events.csv": formats.csv_text(
            ("t", "x", "y", "on"), [tuple(map(int, e)) for e in case.events]
        ),
        "pixels.csv": formats.csv_text(("x", "y"), case.memories.pixels),
        "places.csv": formats.csv_text([f"slot_{slot}" for slot in slots], case.memories.places),
        "expected_events.csv": formats.csv_text(("event", "slot", "count"), numbered["event"]),
        "expected_windows.csv": formats.csv_text(window, numbered["window"]),
        "expected_matches.csv": formats.csv_text(match, numbered["match"]),
    }


# The suites, and the folder that they are written to.


Suites = Mapping[str, Sequence[Case]]
_README = """\
# Golden vectors

What a device of the design in design.toml computes, to the bit, in folders SUITE/CASE.

- manifest.json: every file with its SHA-256, the fields of each word, units, what a device holds
  when it is switched on (each case begins so), the order of reading, and what each case covers
- events.* in, expected_events.*, expected_windows.* and expected_matches.* out; *.mem are words for
  $readmemh, *.coe and *.mif the same for vendors' tools, *.csv for other programs
- image.bin, events.bin, expected.bin and case.h: the same for the firmware in C
- rtl: the hardware core, if it was asked for

Check the files, and then the results of a device:

    edge-vpr golden verify .
    edge-vpr golden verify . --results device.csv

A line of device.csv is a record: `case,corners/tie_of_two`, then `event,NUMBER,SLOT,COUNT`,
`window,NUMBER,EVENTS,CODES...` and `match,WINDOW,PLACE,...` as in expected_*.csv, with -1 for what
is absent.
"""


def standard_suites(design: Design, seed: int, only: str | None = None) -> dict[str, list[Case]]:
    """Make the suites that need only a design: ``corners``, ``random`` and ``own``.

    A design with the place filter or contrast codes also has the suite ``filter``.

    Parameters
    ----------
    seed : int
        Seed of the random cases.
    only : str, optional
        Name of the only suite to make; by default all are made.
    """
    rng = np.random.default_rng(seed)
    makers: dict[str, Callable[[], list[Case]]] = {
        "corners": lambda: corner_cases(design),
        "random": lambda: [
            *random_cases(design, rng),
            *window_cases(design, rng),
        ],
    }
    if design.pauses:
        makers["filter"] = lambda: filter_cases(design, seed)
    makers["own"] = lambda: own_cases(design, seed)
    return {suite: make() for suite, make in makers.items() if only in (None, suite)}


#: corners that a suite is made for
AIMED: Mapping[str, Iterable[str]] = {
    "corners": CORNERS, "filter": ALL, "own": FILTER_CORNERS.keys() | OF_SEQUENCES,
}  # fmt: skip


def cases_within(suites: Suites, most_bytes: float) -> dict[str, list[Case]]:
    """Choose cases whose files have about a given size, first those that reach most for theirs.

    What counts are the corners that the suite of a case is made for, and that no chosen case has
    reached; where none is left, small cases are added. The smallest random case is always kept, if
    it fits.

    Parameters
    ----------
    most_bytes : float
        Of all files; estimated from the numbers of events, windows and places.

    Returns
    -------
    dict of str to list of Case
        Suites in their order, without those that would be empty.
    """
    if sum(estimated_bytes(case) for cases in suites.values() for case in cases) <= most_bytes:
        return {name: list(cases) for name, cases in suites.items()}
    left = {
        (name, i): estimated_bytes(case)
        for name, cases in suites.items()
        for i, case in enumerate(cases)
        if estimated_bytes(case) <= most_bytes
    }
    reaches = {
        (name, i): {(name, corner) for corner in AIMED.get(name, ()) if reached.get(corner)}
        for name, i in left
        for reached in [coverage(suites[name][i])]
    }
    chosen: set[tuple[str, int]] = set()
    so_far: set[tuple[str, str]] = set()
    at_random = [one for one in left if one[0] == "random"]
    while left:
        best = (
            min(at_random, key=left.__getitem__)
            if at_random
            else max(left, key=lambda one: (len(reaches[one] - so_far) / left[one], -left[one]))
        )
        at_random = []
        most_bytes -= left.pop(best)
        chosen.add(best)
        so_far |= reaches[best]
        left = {one: size for one, size in left.items() if size <= most_bytes}
    kept = {
        name: [case for i, case in enumerate(cases) if (name, i) in chosen]
        for name, cases in suites.items()
    }
    return {name: cases for name, cases in kept.items() if cases}


def estimated_bytes(case: Case) -> int:
    """Estimate the size of the files of a case, and of its part of the manifest."""
    design = case.design
    windows = (90 + 22 * design.slots) * _ended_windows(case)
    return 60_000 + 165 * len(case.events) + windows + 17 * design.places * design.slots


def _ended_windows(case: Case) -> int:
    """Return about how many windows the events of a case end."""
    design = case.design
    if design.window == "count":
        chosen = set(case.memories.pixels)
        return sum((event.x, event.y) in chosen for event in case.events) // design.window_events
    times, period = [case.start, *(event.t for event in case.events)], 1 << design.timestamp_bits
    steps = ((after - before) % period for before, after in pairwise(times))
    elapsed = sum(step if step < period // 2 else step - period for step in steps)
    return max(elapsed // design.tau_us, 0)


def write_suites(
    folder: str | Path,
    design: Design,
    suites: Suites,
    seed: int,
    *,
    rtl: bool = False,
    on_case: Callable[[str], None] = lambda name: None,
) -> Manifest:
    """Write suites of cases, and a manifest of all files.

    The same version writes the same bytes for the same design, suites and seed.

    Parameters
    ----------
    folder : path
        Made if it does not exist; must be empty.
    design : Design
        The design for which the suites were made.
    rtl : bool
        Add the hardware core's sources and testbench, and add the core's parameters to each case.
    on_case : callable, optional
        Called with the name of each case before it is computed.

    Raises
    ------
    VectorError
        If the folder is not empty.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise VectorError(f"{folder} is not an empty folder: name a new one")
    folder.mkdir(parents=True, exist_ok=True)
    design.save(folder / "design.toml")
    (folder / README).write_text(_README, encoding="ascii")
    written = []
    number, cases_in_all = 0, sum(map(len, suites.values()))
    for suite, cases in suites.items():
        described = []
        for case in cases:
            on_case(f"case {number + 1} of {cases_in_all}: {suite}/{case.name}")
            described.append(_write_case(folder, suite, case, number, rtl))
            number += 1
        total: Counter[str] = Counter(dict.fromkeys(CORNERS, 0))
        for entry in described:
            total.update(entry.coverage)
        written.append(SuiteEntry(suite, dict(total), tuple(described)))
    if rtl:
        copy_sources(folder / RTL_FOLDER, SIMULATED)
    manifest = Manifest(
        versions={"edge-vpr": version("edge-vpr")},
        seed=seed,
        corners=CORNERS | ALL,
        design=design,
        rtl=SIMULATED if rtl else (),
        suites=tuple(written),
    )
    (folder / MANIFEST).write_text(
        json.dumps(manifest.to_json(), indent=1) + "\n", encoding="utf-8"
    )
    return manifest


def _write_case(folder: Path, suite: str, case: Case, number: int, rtl: bool) -> CaseEntry:
    place = folder / suite / case.name
    place.mkdir(parents=True)
    done, reached = watched_trace(case)
    packed = word_tables(case, done)
    files: dict[str, str | bytes] = {"design.toml": case.design.to_toml()}
    for name, table in packed.items():
        files[f"{name}.mem"] = formats.readmemh(table)
    for name in memory_words(case.memories):
        files[f"{name}.coe"] = formats.coe(packed[name])
        files[f"{name}.mif"] = formats.mif(packed[name])
    files |= csv_files(case, done)
    if rtl:
        files[f"{PACKAGE}.sv"] = package(case.design)
    expected = to_binary(records(in_order(done)))
    files["expected.bin"] = expected
    try:
        flash, events = image(case.memories), case.event_bytes()
    except (DesignError, VectorError) as error:
        firmware = str(error)
    else:
        ram, kept = ram_bytes(case.design), kept_bytes(case.design)
        firmware = f"image.bin and events.bin are for it; its state takes {ram} bytes of RAM"
        if case.design.filters:
            firmware += f", {kept} of which keep distances"
        files |= {"image.bin": flash, "image.hex": formats.intel_hex(flash), "events.bin": events}
        if sum(len(files[each]) for each in FLASHED) <= FLASH_BYTES:
            files["case.h"] = formats.case_header(
                case.name, case.start, ram, kept, flash, events, expected
            )
    entries = {}
    for name, content in files.items():
        data = content.encode("ascii") if isinstance(content, str) else content
        (place / name).write_bytes(data)
        entry = FileEntry(len(data), hashlib.sha256(data).hexdigest())
        stem, _, suffix = name.rpartition(".")
        if stem in packed and suffix in ("mem", "coe", "mif"):
            entry = replace(entry, words=len(packed[stem].words), bits=packed[stem].bits)
        entries[name] = entry
    return CaseEntry(
        name=case.name,
        number=number,
        start=case.start,
        activity=case.memories.activity,
        events=len(done.events),
        windows=len(done.windows),
        matches=len(done.matches),
        design=case.design,
        widths=widths_of(case.design),
        reference_firmware=firmware,
        words={name: table.places() for name, table in packed.items()},
        coverage=reached,
        files=entries,
    )
