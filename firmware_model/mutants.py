"""Generate mutants of the firmware, and list those that no vector finds.

``python -m firmware_model.mutants`` compiles every mutant of ``vpr.c`` and its headers for this
computer and runs the images and the suite ``corners`` on it. A mutant that passes them all must be
equal to the firmware, and ``c/mutants.toml`` must say why.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from firmware_model.build import HOST, SOURCES, build
from firmware_model.design import Design
from firmware_model.errors import ToolError
from firmware_model.mutant_places import mutants_at
from firmware_model.mutation import Mutant, mutants
from firmware_model.vectors.bundle import bundle
from firmware_model.vectors.corners import corner_cases
from firmware_model.vectors.filter_corners import filter_cases
from firmware_model.vectors.images import image_cases

FILES = ("vpr.c", "sad.h", "filter.h", "quotient.h")
PROOFS = SOURCES / "mutants.toml"
#: of the suite `corners`
DESIGN = Design(width=64, height=48, pixels=25, places=40, length=4, code_bits=3)
#: of the suite `filter`
FILTER = replace(DESIGN, matching="filter", length=1, code="own-mean", full_scales=(0,))
#: seconds after which a mutant is taken to loop for ever; the firmware takes some hundredths
PATIENCE_S = 3.0

#: faults on a microcontroller: an unaligned access, an index beyond
SANITISED = ("-fsanitize=alignment,array-bounds", "-fsanitize-trap=alignment,array-bounds")

Outcome = Literal["found", "survives", "does not compile"]
Key = tuple[str, str, str]


@dataclass
class Survey:
    """Outcome of the mutants.

    Attributes
    ----------
    found, invalid : int
        That some vector finds, and that do not compile.
    equal, unproved : list of Mutant
        That no vector finds, with and without a proof.
    stale : list of tuple of str
        Proofs of what is no mutant, or one that is found.
    """

    found: int = 0
    invalid: int = 0
    equal: list[Mutant] = field(default_factory=list)
    unproved: list[Mutant] = field(default_factory=list)
    stale: list[Key] = field(default_factory=list)


class Bench:
    """A folder in which mutants are compiled and run.

    Raises
    ------
    ToolError
        If Zig is not installed, or the firmware itself fails the vectors.
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = Path(folder)
        self._sources = self._folder / "c"
        shutil.copytree(SOURCES, self._sources)
        self._bundle = self._folder / "bundle"
        self._bundle.write_bytes(
            bundle(image_cases(), [*corner_cases(DESIGN), *filter_cases(FILTER)])
        )
        outcome = self._run()
        if outcome != "survives":
            raise ToolError(f"the firmware without a fault fails the vectors: {outcome}")

    def run(self, mutant: Mutant) -> Outcome:
        """Compile a mutant, and run the vectors up to the first difference."""
        file = self._sources / mutant.file
        original = file.read_text(encoding="ascii")
        file.write_text(mutant.text, encoding="ascii")
        try:
            return self._run()
        finally:
            file.write_text(original, encoding="ascii")

    def _run(self) -> Outcome:
        options = ("-O1", "-w", *SANITISED)
        try:
            program = build(
                HOST,
                self._folder,
                sources=self._sources,
                program="vectors_main.c",
                name="mutant",
                options=options,
            )
        except ToolError:
            return "does not compile"
        command = [str(program.absolute()), str(self._bundle)]
        try:
            done = subprocess.run(command, capture_output=True, timeout=PATIENCE_S, check=False)
        except subprocess.TimeoutExpired:
            return "found"
        return "found" if done.returncode else "survives"


def all_mutants() -> list[Mutant]:
    """Generate the mutants of all files."""
    return [m for file in FILES for m in mutants(file, (SOURCES / file).read_text("ascii"))]


def proofs() -> dict[Key, str]:
    """Read why mutants are equal to the firmware, by their keys."""
    entries = tomllib.loads(PROOFS.read_text(encoding="utf-8"))["equal"]
    return {
        (entry["function"], entry["line"], becomes): entry["why"]
        for entry in entries
        for becomes in entry["becomes"]
    }


def survey(bench: Bench, chosen: Iterable[Mutant], proved: Iterable[Key]) -> Survey:
    """Run mutants, and look up the proofs of those that survive.

    Parameters
    ----------
    bench : Bench
    chosen : iterable of Mutant
    proved : iterable of tuple of str
        Keys of those that are proved to be equal.
    """
    result, left = Survey(), set(proved)
    known = frozenset(left)
    for mutant in chosen:
        outcome = bench.run(mutant)
        if outcome == "found":
            result.found += 1
        elif outcome == "does not compile":
            result.invalid += 1
        elif mutant.key in known:
            result.equal.append(mutant)
            left.discard(mutant.key)
        else:
            result.unproved.append(mutant)
    result.stale = sorted(left)
    return result


def chosen(every: Iterable[Mutant], places: Sequence[str]) -> list[Mutant]:
    """Select mutants by ``FILE:LINE`` or function, see `mutants_at`."""
    return mutants_at(every, places, _places, "FILE:LINE or a function of the firmware")


def _places(mutant: Mutant) -> set[str]:
    return {f"{mutant.file}:{mutant.number}", mutant.function}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the mutants; print which survive, and why; return 1 if one of them has no proof."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="PLACE",
        help="run the mutants of these lines (vpr.c:300) or functions alone",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    try:
        every = chosen(all_mutants(), options.only)
    except ToolError as error:
        parser.error(str(error))
    keys = {mutant.key for mutant in every}
    known = proofs()
    # if only a part is run, only its own proofs can be stale
    proved = {k: why for k, why in known.items() if not options.only or k in keys}
    with tempfile.TemporaryDirectory() as folder:
        result = survey(Bench(folder), _counted(every), proved)
    for mutant in result.equal:
        _show("equal", mutant)
        sys.stdout.write(f"    {proved[mutant.key]}\n")
    for mutant in result.unproved:
        _show("SURVIVES WITHOUT A PROOF", mutant)
    for function, line, becomes in result.stale:
        sys.stdout.write(f"PROOF OF NO SURVIVOR: {function}: {line} -> {becomes}\n")
    sys.stdout.write(
        f"{len(every)} mutants, {result.invalid} of which do not compile; {result.found} found, "
        f"{len(result.equal)} proved to be equal, {len(result.unproved)} neither\n"
    )
    return 1 if result.unproved or result.stale else 0


def _counted(every: Sequence[Mutant]) -> Iterator[Mutant]:
    """Yield the mutants, and print how many have been run, because all of them take an hour."""
    for i, mutant in enumerate(every):
        if i and i % 50 == 0:
            sys.stderr.write(f"{i:,} of {len(every):,} mutants\n")
        yield mutant


def _show(what: str, mutant: Mutant) -> None:
    sys.stdout.write(
        f"{mutant.file}:{mutant.number} {mutant.function}: {what}\n"
        f"  - {mutant.line}\n  + {mutant.becomes}\n"
    )


if __name__ == "__main__":
    sys.exit(main())
