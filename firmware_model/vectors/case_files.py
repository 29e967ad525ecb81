"""The contents of a case's files: words of memories, CSV and arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from firmware_model.design import Design
from firmware_model.machine import Trace
from firmware_model.vectors import formats
from firmware_model.vectors.case import Case, in_order, records
from firmware_model.vectors.formats import Packing, Table
from firmware_model.vectors.memory_words import descriptor_words, memory_words
from firmware_model.widths import widths_of


def word_tables(case: Case, done: Trace) -> dict[str, tuple[Packing, Table]]:
    """Return everything that is written as words, and the fields of these words."""
    design = case.design
    bits = widths_of(design)
    time_bits = 32 if design.timestamp_bits <= 32 else 64
    event = (("t", time_bits), ("x", 16), ("y", 15), ("on", 1))
    seen = (("selected", 1), ("slot", bits["slot"]), ("count", bits["count"]))
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
    rows: dict[str, tuple[tuple[tuple[str, int], ...], Iterable[Sequence[int]]]] = {
        "start": ((("t", time_bits),), [(case.start % (1 << design.timestamp_bits),)]),
        "events": (event, case.events),
        "expected_events": (
            seen,
            [(r.slot is not None, r.slot or 0, r.counted) for r in done.events],
        ),
        "expected_matches": (
            match,
            [
                (
                    *(m.window, m.place, m.sum, m.second is not None),
                    *(m.second or 0, m.second_sum or 0, m.ties, m.accepted),
                    *(() if m.trust is None else (m.trust,)),
                )
                for m in done.matches
            ],
        ),
    }
    if design.filters or design.own_mean:
        rows["activity"] = ((("activity", bits["activity"]),), [(case.memories.activity,)])
    packed = memory_words(case.memories)
    for name, (fields, values) in rows.items():
        packing = Packing(fields)
        integers = (tuple(map(int, row)) for row in values)
        packed[name] = packing, formats.pack(packing, integers)
    windows = tuple(window.codes for window in done.windows)
    packed["expected_windows"] = descriptor_words(case.memories, windows)
    return packed


_EVENT = ("event", "slot", "count")
_MATCH = ("window", "place", "sum", "second", "second_sum", "ties", "accepted")


def _match_columns(design: Design) -> tuple[str, ...]:
    return (*_MATCH, "trust") if design.filters else _MATCH


def csv_files(case: Case, done: Trace) -> dict[str, str]:
    """Return the tables of a case and of its results as CSV text."""
    slots = range(case.design.slots)
    numbered: dict[str, list[tuple[int, ...]]] = {"event": [], "window": [], "match": []}
    for kind, values in records(in_order(done)):
        numbered[kind].append(values)
    window = ("window", "events", *(f"slot_{slot}" for slot in slots))
    return {
        "events.csv": formats.csv(("t", "x", "y", "on"), [tuple(map(int, e)) for e in case.events]),
        "pixels.csv": formats.csv(("x", "y"), case.memories.pixels),
        "places.csv": formats.csv([f"slot_{slot}" for slot in slots], case.memories.places),
        "expected_events.csv": formats.csv(_EVENT, numbered["event"]),
        "expected_windows.csv": formats.csv(window, numbered["window"]),
        "expected_matches.csv": formats.csv(_match_columns(case.design), numbered["match"]),
    }


def arrays(case: Case, done: Trace) -> dict[str, np.ndarray[Any, Any]]:
    """Return the arrays of a case by name; -1 stands for an absent value."""
    lookup, design = case.memories.lookup(), case.design
    t, x, y, on = zip(*case.events, strict=True) if case.events else ((),) * 4
    columns = len(_match_columns(design))
    matches = [[-1 if v is None else int(v) for v in match[:columns]] for match in done.matches]
    windows = [window.codes for window in done.windows]
    ended = [window.events for window in done.windows]
    shape = (-1, design.slots)
    return {
        "t": np.array(t, dtype="<u8"),
        "x": np.array(x, dtype="<u2"),
        "y": np.array(y, dtype="<u2"),
        "on": np.array(on, dtype="?"),
        "start": np.array(case.start, dtype="<u8"),
        "pixels": np.array(case.memories.pixels, dtype="<u2"),
        "displacement": np.array(lookup.displacement, dtype="<u4"),
        "owner": np.array(lookup.owner, dtype="<u4"),
        "slot": np.array(lookup.slot, dtype="<u4"),
        "codes": np.array(case.memories.codes, dtype="<u2"),
        "code_tables": np.array(case.memories.tables, dtype="u1"),
        "places": np.array(case.memories.places, dtype="<u2"),
        "expected_slot": np.array([-1 if r.slot is None else r.slot for r in done.events], "<i4"),
        "expected_count": np.array([r.counted for r in done.events], dtype="<u4"),
        "expected_window_events": np.array(ended, dtype="<u4"),
        "expected_windows": np.array(windows, dtype="<u2").reshape(shape),
        "expected_matches": np.array(matches, dtype="<i8").reshape(-1, columns),
        "means": np.array(case.memories.mean, dtype="<u2"),
        "activity": np.array(case.memories.activity, dtype="<u4"),
    }
