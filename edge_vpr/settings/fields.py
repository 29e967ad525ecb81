"""The record that describes one setting: default, meaning, unit, range and accepted words.

The flags of the command line, the keys of a TOML file, the checks of `Settings`, its docstring and
docs/settings.md are all made from these records.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from textwrap import wrap
from typing import Any

from edge_vpr.errors import UsageError

#: largest value of any setting; in microseconds, 31 years
MOST = 10**15


@dataclass(frozen=True, kw_only=True)
class SettingField:
    """Description of one setting.

    Attributes
    ----------
    help : str
        What the setting does, in one line; shown by ``--help``.
    more : str
        Further sentences, shown on the reference page and in the docstring only.
    group : str
        Heading under which ``--help`` shows the flag.
    kind : type
        Type of the value: bool, int, float, str or tuple.
    name : str
        Attribute of `Settings`.
    key : str
        Key in a TOML file. The flag is the key after ``--``, with dashes.
    short : str, optional
        A flag of one letter.
    metavar : str, optional
        Placeholder of the value in ``--help``.
    default : object
    choices : tuple of str
        All allowed values, for a setting that is chosen from a few.
    words : mapping of str to object
        Words that stand for values, such as ``none`` for None.
    read, show : callable, optional
        Functions from text to the value and from the value to text. They are for settings that
        files and flags write in another form, such as ``250ms``.
    least, most : float
        Range of a number, both ends included.
    above, below : float, optional
        Bounds of a number, themselves not included.
    valid : callable, optional
        Function that returns whether a value of the right type is allowed.
    expected : str
        Description of the allowed values; if empty, it is made from the range of a number.
    needs : (str, tuple of str), optional
        Name of another setting, and those of its values with which this setting has an effect.
    zero_is_none : bool
        Whether 0 in a file or a flag means None, as in older files.
    """

    help: str
    kind: type = str
    group: str = ""
    more: str = ""
    name: str = ""
    key: str = ""
    short: str | None = None
    metavar: str | None = None
    default: Any = None
    choices: tuple[str, ...] = ()
    words: Mapping[str, Any] = field(default_factory=dict)
    read: Callable[[str], Any] | None = None
    show: Callable[[Any], str] | None = None
    least: float = 0
    most: float = MOST
    above: float | None = None
    below: float | None = None
    valid: Callable[[Any], bool] | None = None
    expected: str = ""
    needs: tuple[str, tuple[str, ...]] | None = None
    zero_is_none: bool = False

    def named(self, name: str, default: Any) -> SettingField:
        """Return the record of the attribute `name` with its default."""
        return replace(self, name=name, key=self.key or name, default=default)

    @property
    def flag(self) -> str:
        """Flag of the command line, such as ``--events-per-pixel``."""
        return "--" + self.key.replace("_", "-")

    @property
    def meaning(self) -> str:
        """`help` and `more`, as sentences."""
        return f"{self.help[0].upper()}{self.help[1:]}. {self.more}".rstrip()

    @property
    def is_number(self) -> bool:
        """Whether the value is a number."""
        return self.kind in (int, float)

    @property
    def range(self) -> str:
        """Description of the allowed values; empty if not a number and without `expected`."""
        if self.expected or not self.is_number:
            return self.expected
        least = f"{self.least:g} or more" if self.above is None else f"more than {self.above:g}"
        if self.below is not None:
            return f"{least}, below {self.below:g}"
        return least if self.most == MOST else f"{self.least:g} to {self.most:g}"

    @property
    def accepted(self) -> str:
        """Description of what a flag or a file may contain, for error messages."""
        kinds = {int: "a whole number", float: "a number"}
        value = self.expected or kinds.get(self.kind, "")
        return " or ".join([*[value] * bool(value), *self.words])

    def value_of(self, given: Any) -> Any:
        """Convert what a flag or a file contains to the value of the setting.

        Parameters
        ----------
        given : object
            A key of `words`, a text that `read` accepts, or the value itself, as in JSON and TOML.

        Raises
        ------
        UsageError
            If a word is unknown.
        """
        if isinstance(given, list) and self.kind is tuple:
            return tuple(given)
        if self.zero_is_none and type(given) in (int, float) and given == 0:
            return None
        if not isinstance(given, str):
            return given
        if given in self.words:
            return self.words[given]
        if self.kind is str:
            return given
        try:
            if self.read is not None:
                return self.read(given)
            if self.words and self.is_number:
                return self.value_of(self.kind(given))
        except (UsageError, ValueError):
            pass
        if not self.words and self.read is None:
            return given  # of the wrong type: `check` will raise
        raise UsageError(f"setting {self.key} = {shown(given)}: expected {self.accepted}")

    def word(self, value: Any) -> str:
        """Return a value as the text that the flag takes."""
        for word, meaning in self.words.items():
            if type(meaning) is type(value) and meaning == value:
                return word
        if self.show is not None:
            return self.show(value)
        if isinstance(value, bool):
            return "yes" if value else "no"
        return f"{value:g}" if isinstance(value, float) else str(value)

    def check(self, value: Any) -> None:
        """Check the type and the range of a value.

        Raises
        ------
        UsageError
            If the type is wrong or the value is out of range.
        """
        if value is None and None in self.words.values():
            return
        integer_for_float = self.kind is float and type(value) is int
        if type(value) is not self.kind and not integer_for_float:
            raise UsageError(
                f"setting {self.name} = {shown(value)} is of type {type(value).__name__}: "
                f"expected {self.kind.__name__}"
            )
        if self.choices and value not in self.choices:
            raise UsageError(
                f"setting {self.name} = {value!r}: choose from {', '.join(self.choices)}"
            )
        if self.is_number and not self._in_range(value):
            limit = f", up to {self.most:g}" if self.range.endswith("more") else ""
            raise UsageError(f"setting {self.name} = {shown(value)}: expected {self.range}{limit}")
        if self.valid is not None and not self.valid(value):
            raise UsageError(f"setting {self.name} = {shown(value)}: expected {self.expected}")

    def _in_range(self, value: float) -> bool:
        """Return whether a number is in the range; NaN never is."""
        above = self.above is None or value > self.above
        below = self.below is None or value < self.below
        return self.least <= value <= self.most and above and below


def attributes_section(known: Mapping[str, SettingField]) -> str:
    """Return the "Attributes" section of the docstring of a dataclass of settings."""
    lines = ["    Attributes", "    ----------"]
    for name, info in known.items():
        kind = f"{{{', '.join(map(repr, info.choices))}}}" if info.choices else info.kind.__name__
        optional = ", optional" if None in info.words.values() else ""
        lines.append(f"    {name} : {kind}{optional}")
        lines += wrap(info.meaning, 100, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return "\n".join(lines) + "\n"


def shown(value: object) -> str:
    """Return a value as text for an error message.

    Python raises ValueError for integers of thousands of digits; they are described instead.
    """
    try:
        return repr(value)
    except (ValueError, RecursionError):
        return f"a {type(value).__name__} too long to be shown"
