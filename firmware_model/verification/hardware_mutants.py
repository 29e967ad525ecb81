"""Generated faults of the core: ``python -m firmware_model.verification.hardware_mutants``.

Each mutant changes one operator or constant of the sources, or removes a statement. The vectors of
designs with sequences, and of some with the place filter, own-mean and contrast codes, are replayed
with stalls and resets until a case finds the mutant; the first of them also on the core that has
registers behind its block memories. Short cases with a reset of one clock, at each clock of a place
or of a match, follow. The command lists the mutants that no case finds.
It needs Icarus Verilog.
"""

from __future__ import annotations

import argparse
import re
import shutil
import sys
import tempfile
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from firmware_model.errors import ToolError, VectorError
from firmware_model.hardware import simulation, sources
from firmware_model.hardware.simulation import Conditions
from firmware_model.model.design import Design
from firmware_model.vectors.random_cases import random_cases
from firmware_model.vectors.suite import standard_suites, write_suites
from firmware_model.vectors.verify import verify
from firmware_model.verification.mutants import mutants_at

#: mutants of a run of all sources
DRAWN = 60
#: Processor seconds of a simulation, after which the mutant counts as found. The longest case takes
#: four; the testbench itself detects a core that has stopped.
LIMIT = 30
_SEQUENCES = Design(
    width=24, height=16, pixels=9, places=20, length=3, full_scales=(15,), window_events=12, lanes=4
)
_FILTER = replace(_SEQUENCES, matching="filter", length=1, code="own-mean")
#: the third has so few bits that codes saturate at both ends, for the cases of own means
DESIGNS = (_SEQUENCES, _FILTER, replace(_FILTER, code_bits=2))
#: an event a window, and sums of so many terms that one begun by a reset would end in a match;
#: replayed without stalls, and with so many resets that some keep the places
QUICK = Design(
    width=1, height=1, pixels=1, places=19, length=16, full_scales=(3,), window="count",
    window_events=1, lanes=1,
)  # fmt: skip
QUICK_EVENTS, QUICK_RESETS = 150, 6
#: designs that are reset at each of some clocks, and their number of events: at all phases of a
#: place's sum, whose terms end after the next window begins, and of a window of the filter
EVERY_CLOCK = {
    "reset_sum": (replace(QUICK, places=16), 17, range(60, 76)),
    "reset_match": (replace(QUICK, matching="filter", length=1, places=3), 3, range(347, 384)),
}
#: cases that find most mutants come first
FIRST = (
    "tie_of_three", "walk", "own_means_of_sequences", "by_one_too_many", "events_by_time",
    "usually_more_events", "pause_at_threshold", "by_activity", "contrasts", "weights",
    "spread_of_one", "pauses_of_kept_distances", "random_2",
)  # fmt: skip
#: mutants that behave as the source does, and the reason
EQUAL = {
    ("vpr_activity.sv", "{wrapped_q, events_q} - {1'b0, {EVENTS_BITS{has_events_q}}} + "
     "(EVENTS_BITS + 1)'(counted_i);"): "the operand is 0 whenever the sum is taken",
    ("vpr_activity.sv", "{wrapped_q, events_q} + {1'b0, {EVENTS_BITS{has_events_q}}} + "
     "(EVENTS_BITS - 1)'(counted_i);"): "either width holds the one bit",
    ("vpr_logarithm.sv", "memory[(15 - of) * 32 + at] = at < 8 ? 1'b1 : "
     "POWERS[24*of+(at<8?0:at-8)];"): "the words below the lowest bit of a power are not read",
    ("vpr_trust.sv", "larger_q     <= former_q >= earlier_q ? former_q : earlier_q;"):
     "of two equal numbers either is the larger",
    ("vpr_trust.sv", "worst_q      <= newest_q >= larger_q ? newest_q : larger_q;"):
     "of two equal numbers either is the larger",
}  # fmt: skip
_CHANGES = tuple(
    (re.compile(old), new)
    for old, new in (
        (r" == ", " != "), (r" != ", " == "), (r" && ", " || "), (r" \|\| ", " && "),
        (r" \+ ", " - "), (r" - ", " + "), (r" < ", " > "), (r" > ", " >= "),
        (r" >= ", " > "), (r" >> ", " << "), (r"1'b1\b", "1'b0"), (r"1'b0\b", "1'b1"),
        (r"'0\b", "'1"), (r"!(?=[a-z(])", ""), (r" - 1\)", ")"),
    )
)  # fmt: skip
_STATEMENT = re.compile(r"^\s+(?:if \([^;]*\) |else )?\w[\w\[\]:]*\s+<= .*;$")
#: lines with declarations instead of behaviour
_STATED = re.compile(
    r"^\s*(?://|parameter|localparam|input|output|logic [^=]*;|\.|genvar|for |module|wire unused)"
)


class Trial(NamedTuple):
    """Folder of vectors, suite and case, and how it is replayed."""

    vectors: Path
    name: str
    conditions: Conditions

    def __str__(self) -> str:
        """Return suite and case, and what is special about the replay."""
        at, slow = self.conditions.reset_at, self.conditions.slow_blocks
        reset = f", reset at clock {at}" if at else ""
        return f"{self.name}{reset}{', slow block memories' if slow else ''}"

    def under(self, **changes: Any) -> Trial:
        """Return the same case under other conditions."""
        return self._replace(conditions=self.conditions._replace(**changes))


class Mutant(NamedTuple):
    """Changed line of a source."""

    file: str
    line: int
    text: str


def mutants(file: str, source: str) -> Iterator[Mutant]:
    """Yield every change of each line of a source."""
    for number, line in enumerate(source.split("\n")):
        code = line.partition("//")[0].rstrip()
        if not code or _STATED.match(code):
            continue
        for pattern, new in _CHANGES:
            for found in pattern.finditer(code):
                yield Mutant(file, number, code[: found.start()] + new + code[found.end() :])
        if _STATEMENT.match(code):
            yield Mutant(file, number, ";" if code.lstrip().startswith(("if", "else")) else "")


def all_mutants() -> list[Mutant]:
    """Return the mutants of all units of the core."""
    return [
        mutant
        for file in sources.UNITS
        for mutant in mutants(file, (sources.FOLDER / file).read_text(encoding="ascii"))
    ]


def chosen(every: Sequence[Mutant], places: Sequence[str]) -> list[Mutant]:
    """Select mutants by ``FILE`` or ``FILE:LINE``, with lines counted from 1, see `mutants_at`."""
    return mutants_at(every, places, _places, "FILE or FILE:LINE of the core")


def _places(mutant: Mutant) -> set[str]:
    return {mutant.file, f"{mutant.file}:{mutant.line + 1}"}


class Bench:
    """Vectors in a folder, with which mutants of the sources are tested.

    They are of `DESIGNS`, `QUICK` and `EVERY_CLOCK`.

    Parameters
    ----------
    folder : path
        Empty folder.
    seed : int
        Seed of the vectors, and of stalls and resets.
    only : collection of str, optional
        Names of the cases; by default all cases.

    Attributes
    ----------
    cases : list of Trial
        In the order of replay; the case that found the latest mutant comes first.
    """

    def __init__(self, folder: Path, seed: int, only: Collection[str] | None = None) -> None:
        self._seed = seed
        self.cases: list[Trial] = []
        self._rtl = folder / "rtl"
        sources.copy_sources(self._rtl, sources.SIMULATED)
        self._work = folder
        for number, design in enumerate(DESIGNS):
            suites = standard_suites(design, seed)
            if number:  # the cases of sequences are already present
                del suites["corners"]
            if number == 2:
                del suites["random"]
            for suite, cases in suites.items():
                suites[suite] = [
                    case
                    for case in cases
                    if (only is None or case.name in only)
                    and (number < 2 or "mean" in case.name)
                    # its 65,540 events take minutes with each mutant that no other case finds
                    and case.name != "long_window"
                ]
            vectors = folder / str(number)
            write_suites(vectors, design, suites, seed, rtl=True)
            names = (f"{suite}/{case.name}" for suite, cases in suites.items() for case in cases)
            usual = Conditions(seed, stall=30, resets=1)
            self.cases += [Trial(vectors, name, usual) for name in names]
        if only is None or "random_0" in only:
            quick = self._short(folder, "quick", QUICK, QUICK_EVENTS)
            self.cases.append(quick.under(resets=QUICK_RESETS))
        self.cases.sort(key=lambda case: case.name.partition("/")[2] not in FIRST)
        slow = [
            case for case in self.cases if case.name.partition("/")[2] in (*FIRST[:5], "random_0")
        ]
        self.cases += [case.under(slow_blocks=True) for case in slow]
        for suite, (design, events, clocks) in EVERY_CLOCK.items():
            if only is None or suite in only:
                short = self._short(folder, suite, design, events)
                self.cases += [short.under(reset_at=clock) for clock in clocks]

    def _short(self, folder: Path, suite: str, design: Design, events: int) -> Trial:
        """Write a suite of one random case, to be replayed without stalls."""
        cases = random_cases(design, np.random.default_rng(self._seed), 1, events)
        write_suites(folder / suite, design, {suite: cases}, self._seed, rtl=True)
        return Trial(folder / suite, f"{suite}/{cases[0].name}", Conditions(self._seed, resets=1))

    def found_by(self, mutant: Mutant | None) -> str | None:
        """Return the case that finds a mutant, or fails without a mutant; None if there is none."""
        if mutant is not None:
            source = (sources.FOLDER / mutant.file).read_text(encoding="ascii").split("\n")
            source[mutant.line] = mutant.text
            (self._rtl / mutant.file).write_text("\n".join(source), encoding="ascii")
        try:
            programs = simulation.Programs(self._work, self._rtl)
            for at, case in enumerate(self.cases):
                if not self._holds(case, programs):
                    # the next mutant often belongs to the same unit
                    self.cases.insert(0, self.cases.pop(at))
                    return str(case)
            return None
        finally:
            if mutant is not None:
                shutil.copyfile(sources.FOLDER / mutant.file, self._rtl / mutant.file)

    def _holds(self, case: Trial, programs: simulation.Programs) -> bool:
        folder = case.vectors / case.name
        try:
            program = programs.of(folder, slow_blocks=case.conditions.slow_blocks)
            results = self._work / "results.csv"
            done = simulation.replay(
                program, folder, case.name, results, case.conditions, seconds=LIMIT
            )
            return not verify(case.vectors, done.records).differences
        except (ToolError, VectorError):
            return False


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return 1 if a mutant is not found, or a tool is missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="PLACE",
        help="run the mutants of these sources or lines (vpr_core.sv:100) alone",
    )  # fmt: skip
    parser.add_argument(
        "--mutants", type=int, metavar="N",
        help=f"run so many, drawn at random: {DRAWN} by default, or all of those of --only",
    )  # fmt: skip
    parser.add_argument("--skip", type=int, default=0, metavar="N", help="go on behind the first N")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(words)
    if not simulation.available():
        print("mutants need Icarus Verilog: run apt install iverilog", file=sys.stderr)
        return 1
    try:
        every = chosen(all_mutants(), args.only)
    except ToolError as error:
        parser.error(str(error))
    count = args.mutants or (len(every) if args.only else DRAWN)
    order = np.random.default_rng(args.seed).permutation(len(every))
    drawn = sorted(order[:count].tolist())[args.skip :]
    left = 0
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), args.seed)
        for at in drawn:
            mutant = every[at]
            equal = EQUAL.get((mutant.file, mutant.text.strip()))
            if equal is not None:
                print(f"{mutant.file}:{mutant.line + 1}: {mutant.text.strip()}: equal, as {equal}")
                continue
            case = bench.found_by(mutant)
            left += case is None
            told = "NOT FOUND" if case is None else f"found by {case}"
            print(f"{mutant.file}:{mutant.line + 1}: {mutant.text.strip()}: {told}", flush=True)
    print(f"{len(drawn)} of {len(every)} mutants, {left} not found")
    return int(left > 0)


if __name__ == "__main__":
    sys.exit(main())
