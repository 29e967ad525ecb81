"""Mutants of the C sources: one operator, constant, type or statement is changed in each."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

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
_STATEMENT = re.compile(
    r"^[ ]+(?!return|const |static |for |while |if |uint|bool |search_t |vpr_|struct|typedef)"
    r"[a-z*][^;{}]*;(?=\s)",
    re.MULTILINE,
)


@dataclass(frozen=True)
class Mutant:
    """A source with one change.

    Attributes
    ----------
    file : str
    function : str
        In which the change is; empty outside of functions.
    number : int
        Line, from 1.
    line, becomes : str
        The line before and after, without what is left and right of it: these and the function
        tell a mutant, whatever stands in the lines around.
    text : str
        The whole source.
    """

    file: str
    function: str
    number: int
    line: str
    becomes: str
    text: str

    @property
    def key(self) -> tuple[str, str, str]:
        """Function, line, and the changed line."""
        return self.function, self.line, self.becomes


def mutants(file: str, text: str) -> Iterator[Mutant]:
    """Generate the mutants of a C source.

    Enumerations, declarations of types and preprocessor lines are not changed, except the numbers
    of ``#define``. The part of a header before its last ``#else`` is for other processors and is
    not changed either.

    Parameters
    ----------
    file : str
        Its name.
    text : str

    Yields
    ------
    Mutant
        In the order of the text, no two of the same text.
    """
    seen = {text}
    for begin, end, new in sorted(_changes(file, text), key=lambda change: change[:2]):
        changed = text[:begin] + new + text[end:]
        if changed in seen:
            continue
        seen.add(changed)
        number = text.count("\n", 0, begin) + 1
        line_begin = text.rfind("\n", 0, begin) + 1
        line_end = text.find("\n", end)
        line = " ".join(text[line_begin:line_end].split())
        becomes = " ".join((text[line_begin:begin] + new + text[end:line_end]).split())
        function = _function(text, begin)
        yield Mutant(file, function, number, line, becomes or DELETED, changed)


def _changes(file: str, text: str) -> Iterator[tuple[int, int, str]]:
    first = text.rfind("\n#else") if file.endswith(".h") else 0
    skipped = [match.span() for match in re.finditer(r"^(enum|typedef) .*?^\}", text, re.M | re.S)]
    before = ""
    for token in _TOKEN.finditer(text):
        kind, word, at = token.lastgroup, token.group(), token.start()
        if at < first or any(begin <= at < end for begin, end in skipped):
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
    for line in re.finditer(r"^(?:static )?(?:inline )?\w+ (\w+)\(|^\}", text, re.MULTILINE):
        if line.start() > at:
            break
        name = line.group(1) or ""
    return name
