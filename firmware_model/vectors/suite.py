"""Suites of cases on disk: stimuli, memory images, expected results, and a manifest of them."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from firmware_model.design import Design
from firmware_model.errors import DesignError, VectorError
from firmware_model.hardware.parameters import PACKAGE, package
from firmware_model.hardware.sources import SIMULATED, copy_sources
from firmware_model.image import image
from firmware_model.vectors import formats
from firmware_model.vectors.case import Case, in_order, records, to_binary
from firmware_model.vectors.case_files import arrays, csv_files, word_tables
from firmware_model.vectors.corners import corner_cases
from firmware_model.vectors.coverage import CORNERS, watched_trace
from firmware_model.vectors.filter_corners import filter_cases
from firmware_model.vectors.filter_coverage import FILTER_CORNERS
from firmware_model.vectors.manifest import (
    MANIFEST,
    RTL_FOLDER,
    CaseEntry,
    FileEntry,
    Manifest,
    SuiteEntry,
)
from firmware_model.vectors.memory_words import MEMORIES
from firmware_model.vectors.random_cases import random_cases
from firmware_model.widths import widths_of

Suites = Mapping[str, Sequence[Case]]


def standard_suites(design: Design, seed: int, only: str | None = None) -> dict[str, list[Case]]:
    """Make the suites that need only a design: ``corners`` and ``random``.

    A design with the place filter or own-mean codes also has the suite ``filter``.

    Parameters
    ----------
    design : Design
    seed : int
        Seed of the random cases.
    only : str, optional
        Name of the only suite to make; by default all are made.
    """
    makers: dict[str, Callable[[], list[Case]]] = {
        "corners": lambda: corner_cases(design),
        "random": lambda: random_cases(design, np.random.default_rng(seed)),
    }
    if design.filters or design.own_mean:
        makers["filter"] = lambda: filter_cases(design)
    return {suite: make() for suite, make in makers.items() if only in (None, suite)}


def write_suites(
    folder: str | Path, design: Design, suites: Suites, seed: int, *, rtl: bool = False
) -> Manifest:
    """Write suites of cases, and a manifest of all files.

    The same version writes the same bytes for the same design, suites and seed.

    Parameters
    ----------
    folder : path
        Made if it does not exist; must be empty.
    design : Design
        The design for which the suites were made.
    suites : mapping of str to sequence of Case
    seed : int
    rtl : bool
        Add the hardware core's sources and testbench, and add the core's parameters to each case.

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
    written = []
    number = 0
    for suite, cases in suites.items():
        described = []
        for case in cases:
            described.append(_write_case(folder, suite, case, number, rtl))
            number += 1
        total: Counter[str] = Counter(dict.fromkeys(CORNERS, 0))
        for entry in described:
            total.update(entry.coverage)
        written.append(SuiteEntry(suite, dict(total), tuple(described)))
    manifest = Manifest(
        versions={"edge-vpr": version("edge-vpr")},
        seed=seed,
        corners=CORNERS | FILTER_CORNERS,
        design=design,
        rtl=tuple(copy_sources(folder / RTL_FOLDER, SIMULATED)) if rtl else (),
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
    for name, (_, table) in packed.items():
        files[f"{name}.mem"] = formats.readmemh(table)
    for name in MEMORIES:
        files[f"{name}.coe"] = formats.coe(packed[name][1])
        files[f"{name}.mif"] = formats.mif(packed[name][1])
    files |= csv_files(case, done)
    if rtl:
        files[f"{PACKAGE}.sv"] = package(case.design)
    files["case.npz"] = formats.npz(arrays(case, done))
    expected = to_binary(records(in_order(done)))
    files["expected.bin"] = expected
    try:
        flash, events = image(case.memories), case.event_bytes()
    except (DesignError, VectorError) as error:
        firmware = str(error)
    else:
        firmware = "image.bin and events.bin are for it"
        files |= {"image.bin": flash, "events.bin": events}
        files["image.hex"] = formats.intel_hex(flash)
        files["case.h"] = formats.case_header(case.name, case.start, flash, events, expected)
    entries = {}
    for name, content in files.items():
        data = content.encode("ascii") if isinstance(content, str) else content
        (place / name).write_bytes(data)
        entry = FileEntry(len(data), hashlib.sha256(data).hexdigest())
        stem, _, suffix = name.rpartition(".")
        if stem in packed and suffix in ("mem", "coe", "mif"):
            table = packed[stem][1]
            entry = replace(entry, words=len(table.words), bits=table.bits)
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
        words={name: packing.places() for name, (packing, _) in packed.items()},
        coverage=reached,
        files=entries,
    )
