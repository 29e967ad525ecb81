"""Reading of TOML and JSON files; any fault in them raises one `UsageError`."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from edge_vpr.errors import EdgeVprError, UsageError, printable

#: longest file; a manifest has some megabytes
MOST_BYTES = 64 << 20


def read_toml(path: str | Path, what: str, remedy: str) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    path : path
    what : str
        What is read from it, for the message: "settings".
    remedy : str

    Raises
    ------
    UsageError
        If it cannot be read, has more than 1 MiB, or is no TOML.
    """
    return _read(path, what, remedy, 1 << 20, tomllib.loads)


def read_json(path: str | Path, what: str, remedy: str) -> dict[str, Any]:
    """Read a JSON file with an object of names and values; see `read_toml`.

    Raises
    ------
    UsageError
        If it cannot be read, is longer than `MOST_BYTES`, or holds something else.
    """
    return _read(path, what, remedy, MOST_BYTES, json.loads)


def _read(
    path: str | Path, what: str, remedy: str, most: int, parse: Callable[[str], Any]
) -> dict[str, Any]:
    begin = f"cannot read {what} from {path}"
    try:
        with Path(path).open("rb") as file:
            raw = file.read(most + 1)
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{begin}: {reason}: {remedy}") from error
    if len(raw) > most:
        raise UsageError(f"{begin}: it has more than {most} bytes: {remedy}")
    try:
        values = parse(raw.decode("utf-8-sig"))
    # parsers also raise other errors for deep nesting, long numbers and invalid dates
    except Exception as error:
        raise UsageError(f"{begin}: {printable(error, 200)}: {remedy}") from error
    if not isinstance(values, dict):
        raise UsageError(
            f"{begin}: it holds a {type(values).__name__}, not names and values: {remedy}"
        )
    return values


@contextmanager
def understood(path: str | Path, what: str, remedy: str) -> Iterator[None]:
    """Convert errors that the values of a file raise to a `UsageError` that names the file.

    Parameters
    ----------
    path : path
    what, remedy : str
        As for `read_toml`.
    """
    try:
        yield
    except EdgeVprError:
        raise
    except KeyError as error:
        raise UsageError(f"cannot read {what} from {path}: it lacks {error}: {remedy}") from error
    except Exception as error:
        reason = printable(error, 200) or type(error).__name__
        raise UsageError(f"cannot read {what} from {path}: {reason}: {remedy}") from error
