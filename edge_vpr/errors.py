"""The family of errors; each message gives the value, what was expected, and the remedy."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

#: longest message, in characters: enough for the fault and the remedy, but not for a whole file
LONGEST_MESSAGE = 1_000
#: longest name of a file that Linux has, in bytes
LONGEST_NAME = 255


def printable(text: object, longest: int = LONGEST_MESSAGE) -> str:
    r"""Return text as one printable line for terminals, logs and reports.

    File names, names of devices and texts in files come from others. An escape sequence in one of
    them could clear the screen, or make a failure look like a success.

    Parameters
    ----------
    text : object
        Turned to text first.
    longest : int
        Characters that are kept; of longer texts the middle is left out, since a message ends
        with its remedy.

    Returns
    -------
    str
        White space, line feeds included, is single blanks. Other characters that are not printed
        (controls, escapes, changes of writing direction, lone surrogates) are ``\x1b`` and alike.

    Examples
    --------
    >>> printable("a\tname\x1b[2J\nof two lines")
    'a name\\x1b[2J of two lines'
    """
    whole = str(text)
    if len(whole) > 64 * longest:  # limits the work for a text of megabytes
        whole = whole[: 32 * longest] + whole[-32 * longest :]
    line = escaped(" ".join(whole.split()))
    if len(line) <= longest:
        return line
    end = longest * 2 // 5
    return f"{line[: longest - end - 5]} ... {line[-end:]}"


def escaped(text: object) -> str:
    r"""Return text with unprintable characters written as ``\x1b``, ``\n`` and so on.

    Examples
    --------
    >>> escaped("P@100R 0.986   see a\x1b[2J.html")
    'P@100R 0.986   see a\\x1b[2J.html'
    """
    line = str(text)
    if line.isprintable():
        return line
    return "".join(
        character if character.isprintable() else ascii(character)[1:-1] for character in line
    )


class EdgeVprError(Exception):
    """Base class of all errors that edge-vpr raises on purpose.

    >>> import edge_vpr
    >>> try:
    ...     edge_vpr.open_recording("monday.raw")
    ... except EdgeVprError as error:
    ...     print(error)
    monday.raw does not exist: check the path

    Its text is one printable line of at most `LONGEST_MESSAGE` characters (see `printable`).
    """

    exit_code = 1

    def __str__(self) -> str:
        return printable(super().__str__())


class EdgeVprWarning(UserWarning):
    """Something about the data makes a result doubtful; the message says what, and what to do."""


class UsageError(EdgeVprError):
    """An argument, a setting or a combination of them is wrong.

    >>> import edge_vpr
    >>> edge_vpr.resolve_settings(flags={"pixls": 50})
    Traceback (most recent call last):
    edge_vpr.errors.UsageError: flags has the unknown setting 'pixls': did you mean pixels?
    """

    exit_code = 2


class MissingExtraError(UsageError):
    """An optional library is needed and not installed; the message names the extra."""

    def __init__(self, what: str, library: str, extra: str) -> None:
        # as `args`, by which a worker's process sends it
        super().__init__(what, library, extra)

    def __str__(self) -> str:
        what, library, extra = self.args
        return printable(
            f"{what} needs the library {library}, which is not installed: "
            f"run {install_command(extra)}"
        )


class EventError(EdgeVprError):
    """An event array has a wrong dtype, order or coordinates."""


class RecordingError(EdgeVprError):
    """A recording cannot be read, or holds faults that the caller did not allow."""


class MapError(EdgeVprError):
    """A reference map or a result cannot be read, or does not fit the query."""


class GroundTruthError(EdgeVprError):
    """A ground truth cannot be read, or does not fit the matches."""


def expect(value: object, kinds: type | tuple[type, ...], name: str, give: str) -> None:
    """Raise UsageError unless an argument is of one of some types.

    Parameters
    ----------
    kinds : type or tuple of type
        A truth value is not taken for a whole number.
    name : str
        What the message calls the argument.
    give : str
        What to give instead, for the message.

    Examples
    --------
    >>> expect("50", int, "pixels", "a whole number")
    Traceback (most recent call last):
    edge_vpr.errors.UsageError: pixels is a str ('50'): give a whole number
    """
    wanted = kinds if isinstance(kinds, tuple) else (kinds,)
    if isinstance(value, wanted) and (not isinstance(value, bool) or bool in wanted):
        return
    raise UsageError(f"{name} is {kind_of(value)}: give {give}")


def kind_of(value: object) -> str:
    """Return the type of a value with its article, and a short text or number itself."""
    if value is None:
        return "None"
    name = type(value).__name__.replace("ndarray", "array")
    shown = f" ({value!r})" if isinstance(value, str | int | float) and len(str(value)) < 40 else ""
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}{shown}"


def as_path(path: object, what: str) -> Path:
    """Return a path from text or a path object.

    Parameters
    ----------
    what : str
        What is expected at the path, for the message.
    """
    if not isinstance(path, str | Path) or "\0" in str(path):
        raise UsageError(f"the path of {what} is {kind_of(path)}: give it as text")
    for name in Path(path).parts:
        if (size := len(os.fsencode(name))) > LONGEST_NAME:
            raise UsageError(
                f"the path of {what} has a name of {size} bytes, {printable(name, 40)}: expected "
                f"at most {LONGEST_NAME}"
            )
    return Path(path)


def number_in(text: str) -> float:
    """Return the number that a text is.

    `float` also takes ``1_000``, which means another number where ``_`` is a comma or a blank.

    Raises
    ------
    ValueError
        If it is none.
    """
    if "_" in text:
        raise ValueError(f"{printable(text, 40)!r} has a _")
    return float(text)


#: letters in which a name may differ from what was typed
_MOST_CHANGED = 2


def did_you_mean(typed: str, words: Iterable[str]) -> str:
    """Return the end of an error message that suggests a similar name.

    Parameters
    ----------
    typed : str
        What the user wrote.
    words : iterable of str
        What could have been meant.

    Returns
    -------
    str
        Empty if nothing is similar: a longer name that begins so, or one that differs by a letter
        or two.

    Examples
    --------
    >>> did_you_mean("varience", ["variance", "random"])
    ': did you mean variance?'
    """
    from difflib import SequenceMatcher, get_close_matches  # take 10 ms, needed for errors only

    names = list(words)
    longer = [name for name in names if name.startswith(typed)]
    similar = sorted(longer, key=len)[:1]
    for name in () if longer else get_close_matches(typed, names, n=1):
        steps = SequenceMatcher(None, typed, name).get_opcodes()
        changed = sum(max(i2 - i1, j2 - j1) for kind, i1, i2, j1, j2 in steps if kind != "equal")
        similar += [name] * (changed <= _MOST_CHANGED)
    return f": did you mean {similar[0]}?" if similar else ""


def import_extra(module: str, what: str, library: str, extra: str) -> Any:
    """Import a module of an optional library, or raise an error that names the extra with it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError(what, library, extra) from error


def install_command(extra: str) -> str:
    """Return the command that installs an extra (or several, with commas).

    An edge-vpr that runs from its checkout still does so afterwards (``-e``). Elsewhere the command
    names the libraries: where edge-vpr itself came from may be gone, as after
    `tools/board/install.sh`, and is not on a package index.
    """
    checkout = Path(__file__).parents[1]
    if (checkout / "pyproject.toml").is_file():
        here = checkout == Path.cwd()
        return f"pip install -e '{'.' if here else checkout}[{extra}]'"
    sudo = "" if os.access(sys.prefix, os.W_OK) else "sudo "
    libraries = " ".join(f"'{each}'" for each in _libraries(extra.split(",")))
    return f"{sudo}{sys.executable} -m pip install {libraries}"


def _libraries(extras: list[str]) -> list[str]:
    """Return the requirements of extras on this machine, without their markers."""
    from importlib.metadata import PackageNotFoundError, requires  # 30 ms, for errors only

    from packaging.requirements import Requirement

    try:
        needed = [Requirement(text) for text in requires("edge-vpr") or ()]
    except PackageNotFoundError:
        return [f"edge-vpr[{','.join(extras)}]"]
    return [
        f"{each.name}{each.specifier}"
        for each in needed
        if each.marker is not None
        and any(each.marker.evaluate({"extra": one}) for one in extras)
        and not each.marker.evaluate({"extra": ""})
    ]
