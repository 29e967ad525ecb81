"""The one family of errors: each message says the value, what was expected, and the remedy."""

from __future__ import annotations

#: A text of others that is longer than this is cut.
LONGEST_TEXT = 500


def printable(text: object, longest: int = LONGEST_TEXT) -> str:
    r"""Escape what a terminal or a table would obey, in text of a file, a device or the system.

    Parameters
    ----------
    text : object
        Its `str` is taken.
    longest : int
        Characters to keep; the rest becomes ``...``.

    Returns
    -------
    str
        One line without control characters, which become ``\xNN``, and without other characters
        that have no shape of their own (marks of direction, line separators, bytes of file names
        that are no text), which become ``\uNNNN``.

    Examples
    --------
    >>> print(printable("a\x1b[2Jb"))
    a\x1b[2Jb
    """
    plain = str(text)
    cut = plain if len(plain) <= longest else plain[:longest] + "..."
    if cut.isprintable():
        return cut
    return "".join(each if each.isprintable() else _escaped(each) for each in cut)


def _escaped(character: str) -> str:
    code = ord(character)
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


class EdgeVprError(Exception):
    """Base of every error that edge-vpr raises on purpose; its text fits one line."""

    exit_code = 1


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
