"""Mutants of the C: ``python -m firmware_model.verification.mutants``; run before a release.

universalmutator changes one line of a source. A mutant that compiles to other code than the
firmware's runs the images and the golden vectors. One that passes them all survives and is printed:
it is equal to the firmware, or a case is missing.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import random
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

from firmware_model.design import Design
from firmware_model.emulation.build import SOURCES
from firmware_model.vectors.corners import corner_cases
from firmware_model.vectors.filter_suite import filter_cases
from firmware_model.verification.images import bundle, image_cases
from firmware_model.verification.large_cases import large_cases, long_windows

FILES = ("vpr.c", "sad.h", "filter.h", "quotient.h", "crc.h", "tables.h")
RULES = ["universal.rules", "c_like.rules", "c.rules"]
#: of the suite `corners`
DESIGN = Design(width=64, height=48, pixels=25, places=40, length=4, code_bits=3)
#: of the suite `filter`
FILTER = replace(DESIGN, matching="filter", length=1, code="contrast")
#: the firmware, and what runs the vectors
_PROGRAM = ("vpr.c", "replay.c", "vectors_main.c")
#: a microcontroller's faults are traps: unaligned access, index or write beyond an array
_TRAPS = (
    "-O0", "-pedantic-errors", "-fsanitize=alignment,bounds,address",
    "-fsanitize-undefined-trap-on-error",
)  # fmt: skip
#: seconds of the processor after which a mutant is taken to loop for ever; the firmware takes two
_PATIENCE_S = 20


class Mutant(NamedTuple):
    """A source in which one line is changed."""

    file: str
    number: int  #: Of the line, from 1.
    line: str  #: What the line becomes.
    text: str  #: The whole source.


def mutants(file: str) -> list[Mutant]:
    """Generate the mutants of a source; lines with comments are not changed."""
    from universalmutator.mutator import mutants_regexp  # see the Makefile: no extra has it

    lines = (SOURCES / file).read_text(encoding="ascii").splitlines(keepends=True)
    with contextlib.redirect_stdout(io.StringIO()):
        changed = mutants_regexp(lines, RULES, ignorePatterns=[])
    return [
        Mutant(
            file,
            number,
            " ".join(line.split()),
            "".join([*lines[: number - 1], line, *lines[number:]]),
        )
        for number, line, *_ in changed
    ]


def survives(vectors: Path, mutant: Mutant | None) -> bool:
    """Compile a mutant, or the firmware itself, and return whether it passes the vectors."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "c"
        shutil.copytree(SOURCES, folder)
        if mutant is not None:
            (folder / mutant.file).write_text(mutant.text, encoding="ascii")
            if _code(folder) in (b"", _unchanged()):  # it does not compile, or does the same
                return False
        if not _run(folder, "gcc", "-std=c11", *_TRAPS, *_PROGRAM, "-o", "program"):
            return False
        # of processor time, by util-linux: other mutants run beside it
        return _run(folder, "prlimit", f"--cpu={_PATIENCE_S}", "./program", str(vectors))


def _run(folder: Path, *words: str) -> bool:
    return subprocess.run(words, cwd=folder, capture_output=True, check=False).returncode == 0


@cache
def _unchanged() -> bytes:
    return _code(SOURCES)


def _code(folder: Path) -> bytes:
    """Return the optimised code of the firmware in a folder; empty if it does not compile."""
    with tempfile.TemporaryDirectory() as name:
        names = [str(folder / file) for file in _PROGRAM]
        if not _run(Path(name), "gcc", "-std=c11", "-O2", "-c", *names):
            return b""
        return b"".join((Path(name) / file).with_suffix(".o").read_bytes() for file in _PROGRAM)


def main(words: Sequence[str] | None = None) -> None:
    """Run mutants, and print which survive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", default=FILES, metavar="FILE", help="of the C sources")
    parser.add_argument("--number", type=int, help="so many, drawn at random (default: all)")
    options = parser.parse_args(words)
    every = [mutant for file in options.files for mutant in mutants(file)]
    if options.number is not None:
        every = random.Random(0).sample(every, min(options.number, len(every)))
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(os.cpu_count()) as threads:
        vectors = Path(name) / "vectors"
        cases = [*corner_cases(DESIGN), *filter_cases(FILTER), *large_cases(FILTER)]
        cases += filter_cases(replace(FILTER, gains=7))
        vectors.write_bytes(bundle(image_cases(), cases, long_windows(FILTER)))
        if not survives(vectors, None):
            parser.error("the firmware itself fails the vectors")
        outcomes = list(threads.map(partial(survives, vectors), every))
    left = [mutant for mutant, passes in zip(every, outcomes, strict=True) if passes]
    for mutant in left:
        print(f"{mutant.file}:{mutant.number}: survives as: {mutant.line}")
    print(f"{len(every):,} mutants, {len(left):,} survive")


if __name__ == "__main__":
    main()
