"""Generated faults of the core: ``python -m firmware_model.verification.hardware_mutants``.

Each mutant changes one operator or constant of the sources, or removes a statement. The vectors of
designs with sequences, and of some with the place filter and contrast codes, are replayed
with stalls and resets until a case finds the mutant; some of them also on the core that has
registers behind its block memories, and short cases with a reset of one clock at each clock of a
place or of a match. A mutant that no case finds survives: it is equal to the core, or is found by
another test or proof, or a case is missing.

For each design, Verilator builds one program with all mutants that are left; which of them acts is
chosen when it runs. So a mutant costs some hundredths of a second a case, and not the time of a
compiler. Those that change what is elaborated are compiled by Icarus Verilog, one by one.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import shutil
import sys
import tempfile
from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import accumulate, count, takewhile
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from firmware_model.design import Design
from firmware_model.errors import ToolError, VectorError
from firmware_model.hardware import simulation, sources
from firmware_model.hardware.parameters import PACKAGE
from firmware_model.hardware.simulation import Conditions
from firmware_model.vectors.random_cases import random_cases
from firmware_model.vectors.suite import standard_suites, write_suites
from firmware_model.vectors.verify import read_results, verify
from firmware_model.verification.outcomes import Change, Outcomes, mutants_at

#: Processor seconds of a simulation, after which the mutant counts as found. The longest case takes
#: four; the testbench itself detects a core that has stopped.
LIMIT = 30
RESULTS = "results.csv"
#: the same of the programs of Verilator, whose longest case takes a tenth
BUILT_LIMIT = 3
#: as many mutants are run on a program that is built quickly
FEW = 40
# the delay line of the search is no power of two long
_SEQUENCES = Design(
    width=24, height=16, pixels=9, places=20, length=3, code_bits=4, window_events=12, lanes=4,
    exclusion=2,
)  # fmt: skip
_FILTER = replace(_SEQUENCES, matching="filter", length=1, code="contrast")
#: the third has so few bits that codes saturate at both ends, for the cases of contrast codes
DESIGNS = (_SEQUENCES, _FILTER, replace(_FILTER, code_bits=2))
#: an event a window, and sums of so many terms that one begun by a reset would end in a match;
#: replayed without stalls, and with so many resets that some keep the places
QUICK = Design(
    width=1, height=1, pixels=1, places=19, length=16, code_bits=2, window="count",
    window_events=1, lanes=1,
)  # fmt: skip
QUICK_EVENTS, QUICK_RESETS = 150, 6
#: the dearest restart, so that places match against much evidence; a map whose number of places
#: is a power of two; windows of an odd length by a narrow clock
DEAR = replace(_FILTER, places=16, restart=30, timestamp_bits=9, tau_us=51, trust=8)
DEAR_EVENTS = 600
_SMALL = Design(
    width=4, height=2, pixels=3, places=4, length=3, code_bits=2, lanes=3,
    window="count", window_events=6,
)  # fmt: skip
_CLOCKS = range(200, 400)
SILENT = "reset_silent"
#: as many counters that they are drained for longer than the narrow clock takes to start
_MANY = replace(
    _SMALL, matching="filter", length=1, code="contrast", width=5, height=3, pixels=14,
    lookup_depth=0, window="time", tau_us=20, timestamp_bits=7,
)  # fmt: skip
#: designs that are reset at each of some clocks, and their number of events: at all phases of a
#: place's sum, whose terms end after the next window begins, of a window of the filter, and of
#: contrast codes, and of sequences. The last is reset from the first event of a window to its
#: match; behind that, the first windows are silent and end before the counters are drained, so that
#: an event that is left from before would be their only one
EVERY_CLOCK = {
    "reset_sum": (replace(QUICK, places=16), 17, range(60, 76)),
    "reset_match": (replace(QUICK, matching="filter", length=1, places=3), 3, range(347, 384)),
    "reset_contrast": (
        replace(_SMALL, matching="filter", length=1, code="contrast", lanes=1),
        150,
        _CLOCKS,
    ),
    "reset_sequence": (_SMALL, 60, _CLOCKS),
    SILENT: (_MANY, 600, range(1064, 1467)),
}
#: cases that are replayed on the core of slow block memories too
ALSO_SLOW = (
    "tie_of_three", "drive_2", "near_0", "wide_0", "events_by_time",
)  # fmt: skip
#: cases that find most mutants come first, at least one of each part of the core
FIRST = (
    *ALSO_SLOW, "drive_3", "numbers_2", "logarithm_2", "halves_5", "random_2", "events_by_count",
    "sum_at_the_limit", "loud_0",
)  # fmt: skip
_CHANGES = tuple(
    (re.compile(old), new)
    for old, new in (
        (r" == ", " != "), (r" != ", " == "), (r" && ", " || "), (r" \|\| ", " && "),
        (r" \+ ", " - "), (r" - ", " + "), (r" < ", " > "), (r" > ", " >= "),
        (r" >= ", " > "), (r" >> ", " << "), (r"1'b1\b", "1'b0"), (r"1'b0\b", "1'b1"),
        (r"'0\b", "'1"), (r"!(?=[a-z(])", ""), (r" - 1\)", ")"),
    )
)  # fmt: skip
_STATEMENT = re.compile(r"^(\s+(?:if \([^;]*\) |else )?)\w[\w\[\]:]*\s+<= .*;$")
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

    @property
    def elaborates(self) -> bool:
        """Whether it changes what is elaborated, and not what is done."""
        return not with_choice(sources.text_of(self.file), {0: self})[1]

    @property
    def change(self) -> Change:
        """What is changed."""
        source = sources.text_of(self.file).split("\n")
        return self.file, source[self.line].partition("//")[0].strip(), self.text.strip()

    @property
    def place(self) -> str:
        """Its file and line, counted from 1."""
        return f"{self.file}:{self.line + 1}"

    @property
    def places(self) -> set[str]:
        """Names of where it is."""
        return {self.file, self.place}


def mutants(file: str, source: str) -> Iterator[Mutant]:
    """Yield every change of each line of a source."""
    for number, line in enumerate(source.split("\n")):
        code = line.partition("//")[0].rstrip()
        if not code or _STATED.match(code):
            continue
        for pattern, new in _CHANGES:
            for found in pattern.finditer(code):
                yield Mutant(file, number, code[: found.start()] + new + code[found.end() :])
        if statement := _STATEMENT.match(code):
            yield Mutant(file, number, f"{statement[1]};")


def all_mutants() -> list[Mutant]:
    """Return the mutants of all units of the core."""
    return [mutant for file in sources.UNITS for mutant in mutants(file, sources.text_of(file))]


def chosen(every: Sequence[Mutant], places: Sequence[str]) -> list[Mutant]:
    """Select mutants by ``FILE`` or ``FILE:LINE``, see `mutants_at`."""
    return mutants_at(every, places, "FILE or FILE:LINE of the core")


# All mutants in one program: the changed statement is chosen when it runs.


class Region(NamedTuple):
    """Part of a source of which another text can be chosen: a condition, a statement, or a net."""

    kind: Literal["condition", "statement", "assign", "wire"]
    start: int
    end: int


#: package of the chosen mutant, and its file
CHOICE = """\
package mutation;
    function automatic int given();
        if (!$value$plusargs("mutant=%d", given)) given = -1;
    endfunction
    int chosen = given();
endpackage
"""
_CHOSEN = "mutation::chosen"
_WORD = re.compile(r"\w+")
_NET = re.compile(r"wire\s+(?P<type>(?:signed\s+)?(?:\[[^\]]*\]\s*)*)(?P<name>\w+)\s*=")
#: net that is driven elsewhere
_DRIVEN = re.compile(r"\bwire(\s+(?:\[[^\]]*\]\s*)*\w+;)")
_BEHAVIOUR = re.compile(
    r"\b(?:always_ff\s*@\([^)]*\)|always_comb|initial|function\b[^;]*;|wire\b|assign\b)"
)


def with_choice(source: str, numbered: Mapping[int, Mutant]) -> tuple[str, set[int]]:
    """Return a source in which one of its mutants is chosen by its number.

    Returns
    -------
    str
        It refers to the package `CHOICE`.
    set of int
        Numbers of the mutants that it has. It has none of those that change what is elaborated.
    """
    regions = list(_regions(source))
    starts = [0, *accumulate(len(line) + 1 for line in source.split("\n"))]
    texts: dict[Region, dict[int, str]] = {}
    for number, mutant in numbered.items():
        old = source[starts[mutant.line] :].partition("\n")[0].partition("//")[0].rstrip()
        same = _alike(old, mutant.text)
        rest = _alike(old[same:][::-1], mutant.text[same:][::-1])
        start, end = starts[mutant.line] + same, starts[mutant.line] + len(old) - rest
        around = [region for region in regions if region.start <= start and end <= region.end]
        if around:
            region = min(around, key=lambda region: region.end - region.start)
            new = mutant.text[same : len(mutant.text) - rest]
            text = source[region.start : start] + new + source[end : region.end]
            texts.setdefault(region, {})[number] = text
    for region in sorted(texts, key=lambda region: -region.start):
        chosen = _chosen(region, source[region.start : region.end], texts[region])
        source = source[: region.start] + chosen + source[region.end :]
    source = _DRIVEN.sub(r"logic\1", source)
    return source, {number for of_region in texts.values() for number in of_region}


def _alike(a: str, b: str) -> int:
    """Return how many characters two texts have in common from their beginning on."""
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(a, b, strict=False)))


def _chosen(region: Region, usual: str, texts: Mapping[int, str]) -> str:
    """Return the text that takes one of some texts in the place of the usual one."""
    if region.kind == "condition":  # `|`: each has its own width
        for number, text in texts.items():
            usual = f"{_CHOSEN} == {number} ? |({text}\n) : |({usual}\n)"
        return usual
    head, target, skipped = "", "", 0
    if region.kind == "assign":
        skipped = _until(_code(usual), 0, "=") + 1
        head, target = "always_comb ", f"{usual[len('assign') : skipped]} "
    elif region.kind == "wire":
        net = _NET.match(usual)
        assert net is not None
        skipped = net.end()
        head, target = f"logic {net['type']}{net['name']}; always_comb ", f"{net['name']} = "
    cases = (f"{number}: {target}{text[skipped:]}\n" for number, text in texts.items())
    return f"{head}case ({_CHOSEN})\n{''.join(cases)}default: {target}{usual[skipped:]}\nendcase"


def _code(source: str) -> str:
    """Return a source with blanks in the place of comments and texts."""
    return re.sub(r"//[^\n]*|\"[^\"\n]*\"", lambda found: " " * len(found[0]), source)


def _regions(source: str) -> Iterator[Region]:
    code, at = _code(source), 0
    while found := _BEHAVIOUR.search(code, at):
        word = found[0]
        if word in ("wire", "assign"):
            at = _until(code, found.start(), ";") + 1
            if word == "assign" or _NET.match(code, found.start()):
                yield Region("assign" if word == "assign" else "wire", found.start(), at)
        elif word.startswith("function"):
            at = found.end()
            while _word(code, at) != "endfunction":
                at = yield from _statement(code, at)
        else:
            at = yield from _statement(code, found.end())


def _statement(code: str, at: int) -> Generator[Region, None, int]:
    """Yield the conditions and simple statements of a statement; return where it ends."""
    at = _skipped(code, at)
    word = _word(code, at)
    behind = at + len(word)
    if word == "begin":
        at = behind
        if code[_skipped(code, at)] == ":":
            name = _skipped(code, _skipped(code, at) + 1)
            at = name + len(_word(code, name))
        while _word(code, at) != "end":
            at = yield from _statement(code, at)
        return _skipped(code, at) + len("end")
    if word == "if":
        end = _until(code, behind, ")")
        yield Region("condition", code.index("(", behind) + 1, end)
        at = yield from _statement(code, end + 1)
        if _word(code, at) == "else":
            at = yield from _statement(code, _skipped(code, at) + len("else"))
        return at
    if word == "case":
        at = _until(code, behind, ")") + 1
        while _word(code, at) != "endcase":
            at = yield from _statement(code, _until(code, at, ":") + 1)
        return _skipped(code, at) + len("endcase")
    if word == "for":
        return (yield from _statement(code, _until(code, behind, ")") + 1))
    end = _until(code, at, ";") + 1
    yield Region("statement", at, end)
    return end


def _skipped(code: str, at: int) -> int:
    return at + len(code[at:]) - len(code[at:].lstrip())


def _word(code: str, at: int) -> str:
    found = _WORD.match(code, _skipped(code, at))
    return found[0] if found else ""


def _until(code: str, at: int, sign: str) -> int:
    """Return where a sign is next outside of brackets, or where a bracket closes."""
    depth = 0
    for i in range(at, len(code)):
        depth += (code[i] in "([{") - (code[i] in ")]}")
        if depth == 0 and code[i] == sign:
            return i
    raise ToolError(f"no {sign!r} behind {code[at : at + 40]!r}")


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
    digest : str
        Of the sources and the cases.
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
                    # their 65,540 events take minutes with each mutant that no other case finds
                    and case.name not in ("long_window", "busy_0")
                ]
            vectors = folder / str(number)
            write_suites(vectors, design, suites, seed, rtl=True)
            names = (f"{suite}/{case.name}" for suite, cases in suites.items() for case in cases)
            usual = Conditions(seed, stall=30, resets=1)
            self.cases += [Trial(vectors, name, usual) for name in names]
        if only is None or "random_0" in only:
            quick = self._short(folder, "quick", QUICK, QUICK_EVENTS)
            self.cases.append(quick.under(resets=QUICK_RESETS))
            self.cases.append(self._short(folder, "dear", DEAR, DEAR_EVENTS))
        first = [case for case in self.cases if case.name.partition("/")[2] in FIRST]
        slow = [
            case for case in self.cases if case.name.partition("/")[2] in (*ALSO_SLOW, "random_0")
        ]
        first += [case.under(slow_blocks=True) for case in slow]
        for suite, (design, events, clocks) in EVERY_CLOCK.items():
            if only is None or suite in only:
                short = self._short(folder, suite, design, events)
                first += [short.under(reset_at=clock) for clock in clocks]
        self.cases = list(dict.fromkeys([*first, *self.cases]))
        hashed = hashlib.sha256(repr([case[1:] for case in self.cases]).encode())
        texts = [self._rtl / name for name in sources.SIMULATED]
        for file in (*texts, *sorted(folder.glob("*/manifest.json"))):
            hashed.update(file.read_bytes())
        self.digest = hashed.hexdigest()[:16]

    def _short(self, folder: Path, suite: str, design: Design, events: int) -> Trial:
        """Write a suite of one random case, to be replayed without stalls."""
        cases = random_cases(design, np.random.default_rng(self._seed), 1, events)
        if suite == SILENT:
            start = cases[0].start - 2 * design.tau_us
            case = replace(cases[0], start=start % (1 << design.timestamp_bits))
            # of this mean activity, a single event is no pause
            cases = [replace(case, memories=replace(case.memories, activity=0))]
        write_suites(folder / suite, design, {suite: cases}, self._seed, rtl=True)
        return Trial(folder / suite, f"{suite}/{cases[0].name}", Conditions(self._seed, resets=1))

    def found_by(self, mutant: Mutant | None) -> str | None:
        """Return the case that finds a mutant, or fails without a mutant; None if there is none."""
        if mutant is not None:
            source = sources.text_of(mutant.file).split("\n")
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

    def find(self, mutants: Sequence[Mutant], jobs: int = 1) -> Iterator[tuple[Mutant, str]]:
        """Yield mutants, and the case that finds each; those that are not found are left out.

        A program of Verilator for each design has all that are left. What changes the elaboration
        is left out too.

        Parameters
        ----------
        jobs : int
            Programs at a time.

        Raises
        ------
        ToolError
            If Verilator is missing, or the source itself differs.
        """
        left = dict(enumerate(mutants))
        programs: dict[tuple[str, bool], list[Trial]] = {}
        for case in self.cases:
            package = (case.vectors / case.name / f"{PACKAGE}.sv").read_text(encoding="ascii")
            programs.setdefault((package, case.conditions.slow_blocks), []).append(case)
        # the others take the library of the first
        self._with_all(self._work / "first", self.cases[0], {})
        with ThreadPoolExecutor(jobs) as pool:
            yielded: set[int] = set()
            for found in pool.map(partial(self._found_in, left), count(), programs.values()):
                for number in found.keys() - yielded:
                    yield mutants[number], found[number]
                yielded |= found.keys()

    def _found_in(self, left: dict[int, Mutant], at: int, cases: Sequence[Trial]) -> dict[int, str]:
        """Run the cases of one design; move what they find from those that are left."""
        if not left:
            return {}
        folder = self._work / f"built_{at}"
        program, numbers = self._with_all(folder, cases[0], left.copy())
        found = {}
        for case in cases:
            if self._differs(program, case, -1):
                raise ToolError(f"the core without a mutant differs in {case}")
            usual = (folder / RESULTS).read_bytes()
            for number in sorted(numbers):
                # another program may find it at the same time
                if number in left and self._differs(program, case, number, usual):
                    left.pop(number, None)
                    found[number] = str(case)
        shutil.rmtree(folder)
        return found

    def _with_all(
        self, folder: Path, case: Trial, left: Mapping[int, Mutant]
    ) -> tuple[Path, set[int]]:
        """Build the program for the design of a case, with all mutants that can be chosen in it."""
        numbers: set[int] = set()
        rtl = folder.with_suffix(".rtl")
        rtl.mkdir()
        for file in sources.SIMULATED:
            text = sources.text_of(file)
            its_own = {number: mutant for number, mutant in left.items() if mutant.file == file}
            if its_own:
                text, found = with_choice(text, its_own)
                numbers |= found
            (rtl / file).write_text(text, encoding="ascii")
        choice = rtl / "mutation.sv"
        choice.write_text(CHOICE, encoding="ascii")
        package = case.vectors / case.name / f"{PACKAGE}.sv"
        first = self._work / "first"
        program = simulation.build_bench(
            package, folder, rtl, [choice],
            library=first if first.exists() else None, slow_blocks=case.conditions.slow_blocks,
            fast=len(left) > FEW,
        )  # fmt: skip
        return program, numbers

    def _differs(self, program: Path, case: Trial, number: int, usual: bytes = b"") -> bool:
        """Return whether a mutant's records differ from those of the vectors, in any way."""
        # registers begin with random values, others in each case
        seed = self._seed + self.cases.index(case)
        more = [f"+mutant={number}", "+verilator+rand+reset+2", f"+verilator+seed+{seed}"]
        folder, results = case.vectors / case.name, program.parent / RESULTS
        try:
            simulation.run_bench(
                program, folder, case.name, results, case.conditions, more, seconds=BUILT_LIMIT
            )
            if results.read_bytes() == usual:
                return False
            # the same records may come in another order
            return bool(verify(case.vectors, read_results(results)).differences)
        except (ToolError, VectorError):
            return True

    def _holds(self, case: Trial, programs: simulation.Programs) -> bool:
        folder = case.vectors / case.name
        try:
            program = programs.of(folder, slow_blocks=case.conditions.slow_blocks)
            done = simulation.replay(
                program, folder, case.name, self._work / RESULTS, case.conditions, seconds=LIMIT
            )
            return not verify(case.vectors, done.records).differences
        except (ToolError, VectorError):
            return False


def run(bench: Bench, outcomes: Outcomes[Mutant], jobs: int = 1) -> None:
    """Find out what becomes of the mutants that are left.

    Programs of Verilator have all mutants but those that change what is elaborated, which are
    compiled by Icarus Verilog one by one. What a compiler refuses is found.
    """
    left = outcomes.left()
    if chosen_at_run_time := [mutant for mutant in left if not mutant.elaborates]:
        for mutant, case in bench.find(chosen_at_run_time, jobs):
            outcomes.add(mutant, "found", case)
    for mutant in outcomes.left():
        found = bench.found_by(mutant) if mutant.elaborates else None
        outcomes.add(mutant, "found" if found else "survives", found or "")


def main(words: Sequence[str] | None = None) -> int:
    """Run the command, and print which mutants survive; return 1 if a tool is missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="PLACE",
        help="run the mutants of these sources or lines (vpr_core.sv:100) alone",
    )  # fmt: skip
    parser.add_argument("--keep", type=Path, metavar="FILE", help="go on where it was ended")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="programs at a time")
    args = parser.parse_args(words)
    try:
        every = chosen(all_mutants(), args.only)
        with tempfile.TemporaryDirectory() as folder:
            bench = Bench(Path(folder), args.seed)
            outcomes = Outcomes(every, bench.digest, args.keep)
            run(bench, outcomes, args.jobs)
    except ToolError as error:
        print(error, file=sys.stderr)
        return 1
    print(*outcomes.report(), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
