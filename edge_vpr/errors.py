"""The one family of errors: each message says the value, what was expected, and the remedy."""

from __future__ import annotations

#: Longest message of an error, in characters.
LONGEST_MESSAGE = 1_000


def one_line(text: str, longest: int = LONGEST_MESSAGE) -> str:
    r"""Return text from a file or a device as one line that is safe to print on a terminal.

    Characters that are not printable (terminal escapes, changes of the writing direction, halves
    of surrogate pairs) are written as escapes, and the middle of a text that is too long is left
    out.

    Examples
    --------
    >>> one_line("two\nlines, \x1b[2J")
    'two lines, \\x1b[2J'
    """
    line = " ".join(text.split())
    if not line.isprintable():
        line = "".join(
            c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in line
        )
    if len(line) > longest:
        half = (longest - 5) // 2
        line = f"{line[:half]} ... {line[-half:]}"
    return line


class EdgeVprError(Exception):
    """Base of every error that edge-vpr raises on purpose; its text is one printable line."""

    exit_code = 1

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class UsageError(EdgeVprError):
    """The request cannot be met as it was put: an argument, a setting or a combination is wrong."""

    exit_code = 2


class MissingExtraError(UsageError):
    """An optional library is needed and not installed; the message names the extra."""

    def __init__(self, what: str, library: str, extra: str) -> None:
        super().__init__(
            f"{what} needs the library {library}, which is not installed: "
            f"run pip install 'edge-vpr[{extra}]'"
        )


class EventError(EdgeVprError):
    """An event array is not what it claims to be (dtype, order, coordinates)."""


class RecordingError(EdgeVprError):
    """A recording cannot be read, or holds faults that the caller did not allow."""


class MapError(EdgeVprError):
    """A reference map or a result cannot be read, or does not fit the query."""


class GroundTruthError(EdgeVprError):
    """A ground truth cannot be read, or does not fit the matches."""
