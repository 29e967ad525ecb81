"""The argument parser of one verb: no abbreviated flags, hints at typos, all defaults shown."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from edge_vpr.errors import UsageError, did_you_mean
from edge_vpr_tools.verbs import VERBS

_NEGATIVE = re.compile(r"-\.?\d")


class VerbParser(argparse.ArgumentParser):
    """Parse the arguments of one verb.

    Parameters
    ----------
    verb : str
    examples : str, optional
        Example commands, one in each line, shown at the end of the help.
    """

    def __init__(self, verb: str, examples: str = "") -> None:
        text = VERBS[verb]
        more = [name for name in VERBS if name.startswith(f"{verb} ")]
        description = f"{text[0].upper()}{text[1:]}."
        if more:
            listed = "\n".join(f"  edge-vpr {name:<16} {VERBS[name]}" for name in more)
            description += f"\n\nSee also:\n{listed}"
        super().__init__(
            prog=f"edge-vpr {verb}",
            description=description,
            epilog=f"examples:\n{examples}" if examples else None,
            formatter_class=_Formatter,
            allow_abbrev=False,
            add_help=False,
        )
        self.verb = verb

    def add_general_flags(self) -> None:
        """Add the flags of every verb, as the last group."""
        group = self.add_argument_group("general")
        group.add_argument("-h", "--help", action="help", help="show this help and exit")
        group.add_argument("-q", "--quiet", action="store_true", help="print errors only")
        group.add_argument("-v", "--verbose", action="store_true", help="print more while running")
        group.add_argument(
            "--debug", action="store_true", help="show the Python traceback of an error"
        )

        self.usage = self._short_usage()

    def _short_usage(self) -> str:
        """Return the usage line with the required arguments only; the help lists the others."""
        needed = []
        for action in self._actions:
            if action.required and action.option_strings:
                flag, value = action.option_strings[0], action.metavar or action.dest.upper()
                needed.append(f"{flag} {value}" + " ..." * (action.nargs == "+"))
        positional = [
            str(action.metavar or action.dest.upper())
            for action in self._actions
            if not action.option_strings
        ]
        return " ".join([self.prog, *positional, *needed, "[FLAGS]"])

    def parse(self, words: Sequence[str]) -> argparse.Namespace:
        """Parse the words after the verb.

        Raises
        ------
        UsageError
            If an argument is unknown, missing or wrong.
        """
        for action in self._actions:
            action.type = _checked(action)
        words = self._joined(words)
        self._refuse_unknown_flags(words)
        children = [name.split()[1] for name in VERBS if name.startswith(f"{self.verb} ")]
        if children and words and not words[0].startswith("-"):
            self.error(f"unexpected argument {words[0]!r}{did_you_mean(words[0], children)}")
        args, left = self.parse_known_args(words)
        if left:
            self.error(f"unexpected argument {left[0]!r}")
        return args

    def error(self, message: str) -> NoReturn:
        """Raise the error that argparse would print.

        Raises
        ------
        UsageError
        """
        message = message.removeprefix("argument ")
        raise UsageError(f"{self.verb}: {message} (edge-vpr {self.verb} --help shows all)")

    def _joined(self, words: Sequence[str]) -> list[str]:
        """Join a flag with a value such as -1s, which argparse would take for another flag."""
        joined: list[str] = []
        for word in words:
            action = self._option_string_actions.get(joined[-1]) if joined else None
            takes_one = action is not None and action.nargs is None
            if takes_one and _NEGATIVE.match(word):
                joined[-1] += f"={word}" if joined[-1].startswith("--") else word
            else:
                joined.append(word)
        return joined

    def _refuse_unknown_flags(self, words: Sequence[str]) -> None:
        """Raise for an unknown flag, before argparse reports a missing one in its place."""
        known = self._option_string_actions
        for word in words:
            if word == "--":
                return
            if not word.startswith("-") or word == "-" or _NEGATIVE.match(word):
                continue
            flag = word.partition("=")[0]
            short = not word.startswith("--") and word[:2] in known
            if flag not in known and not short:
                longs = [name for name in known if name.startswith("--")]
                self.error(f"there is no flag {flag}{did_you_mean(flag, longs)}")


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Show the default of every flag that has one."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=30, width=100)

    def _get_help_string(self, action: argparse.Action) -> str:
        text = action.help or ""
        if takes_value(action) and not action.required and "default" not in text:
            if action.default in (None, []):
                return f"{text} (default: none)"
            return f"{text} (default: %(default)s)"
        return text


def takes_value(action: argparse.Action) -> bool:
    """Return whether an action is a flag that takes a value."""
    return bool(action.option_strings) and action.nargs != 0


def _checked(action: argparse.Action) -> Any:
    """Return the type of an action, with clearer errors than those of argparse."""
    if action.choices is not None and action.type is None:
        return _one_of(list(action.choices))
    if action.type is int:
        return whole_number
    return number if action.type is float else action.type


def _one_of(choices: Sequence[str]) -> Callable[[str], str]:
    """Return the type of an argument with a few allowed values, which suggests one for a typo."""

    def read(text: str) -> str:
        if text not in choices:
            raise argparse.ArgumentTypeError(
                f"{text!r}: choose from {', '.join(choices)}{did_you_mean(text, choices)}"
            )
        return text

    return read


def whole_number(text: str) -> int:
    """Read a whole number.

    Raises
    ------
    argparse.ArgumentTypeError
    """
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def number(text: str) -> float:
    """Read a finite number.

    Raises
    ------
    argparse.ArgumentTypeError
    """
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value
