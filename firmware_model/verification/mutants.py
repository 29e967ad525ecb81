"""Mutants of the firmware: ``python -m firmware_model.verification.mutants``."""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise
from pathlib import Path

from firmware_model.design import Design
from firmware_model.emulation.build import SOURCES
from firmware_model.errors import ToolError
from firmware_model.vectors.corners import corner_cases
from firmware_model.vectors.filter_suite import filter_cases
from firmware_model.verification.images import bundle, image_cases
from firmware_model.verification.large_cases import large_cases, long_windows
from firmware_model.verification.outcomes import Change, Outcome, Outcomes, mutants_at

# Mutants of the C sources: one operator, constant, type or statement is changed in each.


#: replacement of a deleted statement
DELETED = "(deleted)"

_TOKEN = re.compile(
    r"""(?P<comment>/\*.*?\*/) | (?P<directive>^\#[^\n]*) | (?P<text>"[^"\n]*")
      | (?P<number>0[xX][0-9A-Fa-f]+U?|\d+U?) | (?P<word>[A-Za-z_]\w*)
      | (?P<sign><<=|>>=|->|\+\+|--|<<|>>|<=|>=|==|!=|&&|\|\||[-+*/%&|^]=
                |[-+*/%&|^~!<>=?:;,.(){}\[\]])
    """,
    re.VERBOSE | re.DOTALL | re.MULTILINE,
)
_SIGNS = {
    "<": ("<=", ">"), "<=": ("<", ">="), ">": (">=", "<"), ">=": (">", "<="), "==": ("!=",),
    "!=": ("==",), "+": ("-",), "-": ("+",), "*": ("+",), "/": ("*",), "%": ("/",), "&": ("|",),
    "|": ("&",), "<<": (">>",), ">>": ("<<",), "&&": ("||",), "||": ("&&",), "++": ("--",),
    "--": ("++",), "+=": ("-=", "="), "-=": ("+=", "="), "!": ("",), "~": ("",),
}  # fmt: skip
_WORDS = {
    "true": ("false",),
    "false": ("true",),
    "continue": ("break",),
    "break": ("continue",),
    "int32_t": ("int16_t", "uint32_t"),
    "uint16_t": ("uint8_t",),
}
_NARROWED = re.compile(r"\buint32_t(?= \w)")
_ASSIGNED = re.compile(r"^(.*?) (?:[-+*/|&]|<<|>>)?= |^(.*?)(?:\+\+|--);")
_STATEMENT = re.compile(
    r"^[ ]+(?!return|const |static |for |while |if |uint|bool |search_t |vpr_|struct|typedef)"
    r"[a-z*][^;{}]*;(?=\s)",
    re.MULTILINE,
)


@dataclass(frozen=True)
class Mutant:
    """A source with one change."""

    file: str
    function: str  #: In which the change is; empty outside of functions.
    number: int  #: Line, from 1.
    #: line, becomes: the line before and after, without what is left and right of it.
    line: str
    becomes: str
    text: str  #: The whole source.

    @property
    def change(self) -> Change:
        """What is changed."""
        return self.file, self.line, self.becomes

    @property
    def place(self) -> str:
        """Its file and line."""
        return f"{self.file}:{self.number}"

    @property
    def places(self) -> set[str]:
        """Names of where it is: its file, its line, and its function."""
        return {self.file, self.place, self.function}


def mutants(file: str, text: str) -> Iterator[Mutant]:
    """Generate the mutants of a C source.

    Enumerations, declarations of types and preprocessor lines are not changed, except the numbers
    of ``#define``. The part of a header before its last ``#else`` is for other processors and is
    not changed either.

    Parameters
    ----------
    file : str
        Its name.

    Yields
    ------
    Mutant
        In the order of the text, no two of the same text.
    """
    seen = {"".join(text.split())}
    for start, end, new in sorted(_changes(file, text), key=lambda change: change[:2]):
        changed = text[:start] + new + text[end:]
        shape = "".join(changed.split())
        if shape in seen:
            continue
        seen.add(shape)
        number = text.count("\n", 0, start) + 1
        line_start = text.rfind("\n", 0, start) + 1
        line_end = text.find("\n", end)
        line = " ".join(text[line_start:line_end].split())
        becomes = " ".join((text[line_start:start] + new + text[end:line_end]).split())
        function = _function(text, start)
        yield Mutant(file, function, number, line, becomes or DELETED, changed)


def _changes(file: str, text: str) -> Iterator[tuple[int, int, str]]:
    first = text.rfind("\n#else") if file.endswith(".h") else 0
    skipped = [match.span() for match in re.finditer(r"^(enum|typedef) .*?^\}", text, re.M | re.S)]
    before = ""
    for token in _TOKEN.finditer(text):
        kind, word, at = token.lastgroup, token.group(), token.start()
        if at < first or any(start <= at < end for start, end in skipped):
            continue
        if kind == "directive":
            number = re.match(r"#define \w+ (0x[0-9A-F]+U|\d+U)", word)
            if number:
                for new in _numbers(number[1]):
                    yield at + number.start(1), at + number.end(1), new
        elif kind == "number":
            for new in _numbers(word):
                yield at, token.end(), new
        elif kind == "word":
            for new in _WORDS.get(word, ()):
                yield at, token.end(), new
        elif kind == "sign" and not _is_of_a_type(word, before, text[token.end() :]):
            for new in _SIGNS.get(word, ()):
                yield at, token.end(), new
        if kind != "comment":
            before = word
    yield from _statements(text, first)
    yield from _exchanged(text, first)
    yield from _held(text, first)
    for declared in _NARROWED.finditer(text):
        if declared.start() > first and _function(text, declared.start()):
            yield declared.start(), declared.end(), "uint16_t"


def _exchanged(text: str, first: int) -> Iterator[tuple[int, int, str]]:
    """Return the mutants that exchange two statements, one of which assigns what the other uses."""
    found = [match for match in _STATEMENT.finditer(text) if match.start() > first]
    for one, two in pairwise(found):
        between = text[one.end() : two.start()]
        if between != "\n" or not _function(text, one.start()):
            continue
        parts = one.group().strip(), two.group().strip()
        if any(_assigns(part, other) for part, other in (parts, parts[::-1])):
            yield one.start(), two.end(), two.group() + between + one.group()


def _assigns(statement: str, other: str) -> bool:
    """Return whether a statement assigns a variable that another one names."""
    found = _ASSIGNED.match(" ".join(statement.split()))
    return found is not None and bool(
        re.search(rf"{re.escape(found[1] or found[2])}(?!\w)", " ".join(other.split()))
    )


def _held(text: str, first: int) -> Iterator[tuple[int, int, str]]:
    """Return the mutants that hold one operand of a condition, or one side of a choice."""
    tokens = [t for t in _TOKEN.finditer(text) if t.lastgroup not in ("comment", "directive")]
    for i, token in enumerate(tokens):
        sign = token.group()
        if token.start() < first or sign not in ("&&", "||", "?"):
            continue
        if not _function(text, token.start()):
            continue
        start, end = _operand(tokens, i, -1), _operand(tokens, i, 1)
        if sign == "?":
            colon = next(t.start() for t in tokens[i:] if t.group() == ":")
            # of a choice within a choice, the outer condition is held
            end = _operand(tokens, i, 1, through=(":", "?", "&&", "||"))
            yield start, end, text[token.end() : colon].strip()
            yield start, end, text[colon + 1 : end].strip()
        else:
            neutral = "true" if sign == "&&" else "false"
            yield start, token.start() - 1, neutral
            yield token.end() + 1, end, neutral


def _operand(tokens: list[re.Match[str]], at: int, step: int, through: tuple[str, ...] = ()) -> int:
    """Return where the operand on one side of a token begins or ends."""
    depth, last = 0, at
    stop = {"&&", "||", "?", ":", ";", ",", "=", "{", "}", "return"} - set(through)
    for i in range(at + step, len(tokens) if step > 0 else -1, step):
        sign = tokens[i].group()
        depth += step * ((sign in ("(", "[")) - (sign in (")", "]")))
        if depth < 0 or (depth == 0 and sign in stop):
            break
        last = i
    return tokens[last].end() if step > 0 else tokens[last].start()


def _numbers(word: str) -> Iterator[str]:
    value, suffix = int(word.rstrip("U"), 0), "U" if word.endswith("U") else ""
    yield f"{value + 1}{suffix}"
    if value:
        yield f"{value - 1}{suffix}"


def _is_of_a_type(sign: str, before: str, behind: str) -> bool:
    """Return whether a star or ampersand belongs to a pointer, or a minus to a negative number."""
    if sign not in ("*", "&", "-"):
        return False
    operand = re.fullmatch(r"\w+|[\])]", before) is not None
    is_type = before.endswith("_t") or before in ("void", "const", "return", "sizeof")
    cast = sign == "*" and behind.startswith(")")
    return not operand or is_type or cast


def _statements(text: str, first: int) -> Iterator[tuple[int, int, str]]:
    """Return the mutants that delete a statement or fix a condition."""
    for statement in _STATEMENT.finditer(text):
        if statement.start() > first and _function(text, statement.start()):
            yield statement.start(), statement.end(), ""
    for condition in re.finditer(r"\bif \(", text):
        if condition.start() > first:
            end = _closing(text, condition.end() - 1)
            yield condition.end(), end, "true"
            yield condition.end(), end, "false"


def _closing(text: str, opening: int) -> int:
    depth = 0
    for at in range(opening, len(text)):
        depth += {"(": 1, ")": -1}.get(text[at], 0)
        if depth == 0:
            return at
    raise ValueError("a parenthesis is not closed")


def _function(text: str, at: int) -> str:
    """Return the name of the function that a position lies in; empty if it lies in none."""
    name = ""
    for line in re.finditer(r"^(?:\w+ )+(\w+)\(|^\}", text, re.MULTILINE):
        if line.start() > at:
            break
        name = line.group(1) or ""
    return name


# The command compiles every mutant of ``vpr.c`` and its headers for this computer and runs the
# images and the suites ``corners`` and ``filter`` on it. A mutant that passes them all survives: it
# is equal to the firmware, or a case is missing.


FILES = ("vpr.c", "sad.h", "filter.h", "quotient.h", "crc.h", "tables.h")
#: of the suite `corners`
DESIGN = Design(width=64, height=48, pixels=25, places=40, length=4, code_bits=3)
#: of the suite `filter`
FILTER = replace(DESIGN, matching="filter", length=1, code="contrast")
#: seconds of the processor after which a mutant is taken to loop for ever; the firmware takes 0.1
PATIENCE_S = 3

#: a microcontroller's faults are traps: unaligned access, index beyond an array, write behind one
_OPTIONS = (
    "-std=c11", "-O0", "-pedantic-errors", "-fstack-protector-all", "-fsanitize=alignment,bounds",
    "-fsanitize-undefined-trap-on-error",
)  # fmt: skip


class Bench:
    """A folder in which mutants are compiled and run.

    Raises
    ------
    ToolError
        If neither gcc nor Zig is installed, or the firmware itself fails the vectors.
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = Path(folder)
        self._sources = self._folder / "c"
        shutil.copytree(SOURCES, self._sources)
        self._bundle = self._folder / "bundle"
        self._bundle.write_bytes(
            bundle(
                image_cases(),
                [*corner_cases(DESIGN), *filter_cases(FILTER), *large_cases(FILTER)],
                long_windows(FILTER),
            )
        )
        if not all(map(self._compiles, _AROUND)):
            raise ToolError("the program that runs the vectors does not compile")
        #: of the sources and of what is run
        self.digest = _digest(self._sources, self._bundle)
        outcome = self._run()
        if outcome != "survives":
            raise ToolError(f"the firmware without a fault fails the vectors: {outcome}")

    def run(self, mutant: Mutant) -> Outcome:
        """Compile a mutant, and run the vectors up to the first difference."""
        file = self._sources / mutant.file
        original = file.read_text(encoding="ascii")
        file.write_text(mutant.text, encoding="ascii")
        try:
            # what runs the vectors divides too
            return self._run() if self._compiles("vectors_main.c") else "does not compile"
        finally:
            file.write_text(original, encoding="ascii")

    def _compiles(self, file: str, *more: str) -> bool:
        command = [*_compiler(), *_OPTIONS, *more, "-c", str(self._sources / file)]
        command += ["-o", str(self._folder / f"{file}.o")]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0

    def _run(self) -> Outcome:
        outcome = self._run_with()
        # it sees writes behind a local array too; Zig has none
        if outcome == "survives" and len(_compiler()) == 1:
            return self._run_with("-fsanitize=address")
        return outcome

    def _run_with(self, *more: str) -> Outcome:
        if not self._compiles("vpr.c", *more):
            return "does not compile"
        program = self._folder / "mutant"
        objects = [str(self._folder / f"{file}.o") for file in ("vpr.c", *_AROUND)]
        command = [*_compiler(), *_OPTIONS, *more, *objects, "-o", str(program)]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            return "does not compile"
        command = [str(program.absolute()), str(self._bundle)]
        limit = partial(resource.setrlimit, resource.RLIMIT_CPU, (PATIENCE_S, PATIENCE_S))
        done = subprocess.run(command, capture_output=True, preexec_fn=limit, check=False)
        return "found" if done.returncode else "survives"


def _digest(sources: Path, bundle: Path) -> str:
    hashed = hashlib.sha256(bundle.read_bytes())
    for file in (*FILES, *_AROUND):
        hashed.update((sources / file).read_bytes())
    return hashed.hexdigest()[:16]


#: what runs the vectors: compiled once
_AROUND = ("replay.c", "vectors_main.c")


@cache
def _compiler() -> tuple[str, ...]:
    """Return gcc if this computer has it, or else Zig's compiler, which takes longer."""
    gcc = shutil.which("gcc")
    if gcc:
        return (gcc,)
    if importlib.util.find_spec("ziglang") is None:
        raise ToolError("mutants need gcc, or Zig's compiler: run pip install 'edge-vpr[firmware]'")
    return sys.executable, "-m", "ziglang", "cc"


def all_mutants() -> list[Mutant]:
    """Generate the mutants of all files."""
    return [m for file in FILES for m in mutants(file, (SOURCES / file).read_text("ascii"))]


def chosen(every: Sequence[Mutant], places: Sequence[str]) -> list[Mutant]:
    """Select mutants by ``FILE``, ``FILE:LINE`` or function, see `mutants_at`."""
    return mutants_at(every, places, "FILE, FILE:LINE or a function of the firmware")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the mutants, and print which survive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="PLACE",
        help="run the mutants of these files, lines (vpr.c:300) or functions alone",
    )  # fmt: skip
    parser.add_argument("--keep", type=Path, metavar="FILE", help="go on where it was ended")
    options = parser.parse_args(arguments)
    try:
        every = chosen(all_mutants(), options.only)
        with tempfile.TemporaryDirectory() as folder:
            bench = Bench(folder)
            outcomes = Outcomes(every, bench.digest, options.keep)
            for mutant in outcomes.left():
                outcomes.add(mutant, bench.run(mutant))
    except ToolError as error:
        parser.error(str(error))
    print(*outcomes.report(), sep="\n")


if __name__ == "__main__":
    main()
