"""Records in TOML and JSON: reading with all checks, and writing."""

from __future__ import annotations

import json
import math
import tomllib
import types
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields, is_dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from edge_vpr.errors import EdgeVprError, UsageError, printable
from edge_vpr.files import open_input, replacing

# Reading of TOML and JSON files; any fault in them raises one `UsageError`.


#: longest file; a manifest has some megabytes
_MOST_BYTES = 64 << 20


def read_toml(path: str | Path, what: str, remedy: str) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    what : str
        What is read from it, for the message: "settings".

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
        If it cannot be read, is longer than 64 MiB, or holds something else, or a number in
        it is not finite.
    """
    # Python also reads what JSON does not have: NaN and infinity
    parse = partial(json.loads, parse_constant=_finite, parse_float=_finite)
    return _read(path, what, remedy, _MOST_BYTES, parse)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{printable(text, 40)} is not a finite number")
    return value


def _read(
    path: str | Path, what: str, remedy: str, most: int, parse: Callable[[str], Any]
) -> dict[str, Any]:
    fault = f"cannot read {what} from {path}"
    try:
        with open_input(path) as file:
            raw = file.read(most + 1)
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{fault}: {reason}: {remedy}") from error
    if len(raw) > most:
        raise UsageError(f"{fault}: it has more than {most} bytes: {remedy}")
    try:
        values = parse(raw.decode("utf-8-sig"))
    # parsers also raise other errors for deep nesting, long numbers and invalid dates
    except Exception as error:
        raise UsageError(f"{fault}: {printable(error, 200)}: {remedy}") from error
    if not isinstance(values, dict):
        raise UsageError(
            f"{fault}: it holds a {type(values).__name__}, not names and values: {remedy}"
        )
    return values


@contextmanager
def parse_errors(path: str | Path, what: str, remedy: str) -> Iterator[None]:
    """Convert errors that the values of a file raise to a `UsageError` that names the file.

    Parameters
    ----------
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


# Conversion of frozen dataclasses to and from JSON.
#
# The names of the fields are the names in the file. Fields that the class does not have are
# ignored, so that a file of a newer version with the same schema can be read.
#
# msgspec reads most of these records equally, and faster. It refuses a union of two dataclasses and
# has named tuples as lists, both of which profiles need; it cannot leave out fields of dataclasses
# that are None, so that writing would stay as it is; and its errors do not contain the value.


T = TypeVar("T")

#: metadata of a field that is not written while it is None
LEFT_OUT: Mapping[str, bool] = {"left_out": True}
_NUMBERS = {float: "a number", int: "an integer", str: "text", bool: "true or false"}


class RecordError(ValueError):
    """Values from a file do not fit the expected record."""


def read_record(kind: type[T], path: Path, what: str, remedy: str) -> T:
    """Read a record from a JSON file; see `from_json` and `read_json`.

    Raises
    ------
    UsageError
        If the file cannot be read, or a field of it is missing or of a wrong type.
    """
    with parse_errors(path, what, remedy):
        return from_json(kind, read_json(path, what, remedy))


def to_json(value: Any) -> Any:
    """Return a record as values that JSON can hold.

    Parameters
    ----------
    value : object
        A dataclass, a named tuple, or a sequence or mapping of them.

    Returns
    -------
    object
        Dictionaries, lists and plain values; None for a number that is not finite.
    """
    if is_dataclass(value) and not isinstance(value, type):
        named = ((each, getattr(value, each.name)) for each in fields(value))
        return {
            each.name: to_json(one)
            for each, one in named if one is not None or not each.metadata.get("left_out")
        }  # fmt: skip
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: to_json(one) for name, one in value._asdict().items()}
    if isinstance(value, Mapping):
        return {name: to_json(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def json_text(value: Any, indent: int | None = None) -> str:
    """Return a record as the text of a JSON file; numbers that are not finite are null."""
    return json.dumps(to_json(value), indent=indent, allow_nan=False)


def write_json(path: Path, values: object) -> None:
    """Write a record, or values by name, as indented JSON, atomically."""
    with replacing(path) as temporary:
        temporary.write_text(json_text(values, indent=2) + "\n", encoding="utf-8")


def from_json(kind: type[T], value: object, where: str = "") -> T:
    """Build a record from values of JSON.

    Parameters
    ----------
    kind : type
        A dataclass or a named tuple of plain values, tuples, mappings by name, and records.
    value : object
        As read, and not trusted.
    where : str
        Names of the fields that lead to it, for the message.

    Raises
    ------
    RecordError
        If a field is missing, or is not of its type.
    """
    values = _names(value, where)
    record: Any = kind
    by_field = {}
    for name, hint in _hints(record).items():
        if name in values:
            by_field[name] = _value(hint, values[name], f"{where}.{name}" if where else name)
        elif name not in _defaults(record):
            raise RecordError(f"{where or 'the file'} lacks {name}")
    return kind(**by_field)


@cache
def _hints(kind: Any) -> Mapping[str, Any]:
    return get_type_hints(kind)


@cache
def _defaults(kind: Any) -> frozenset[str]:
    if not is_dataclass(kind):
        return frozenset(kind._field_defaults)
    return frozenset(
        field.name for field in fields(kind)
        if field.default is not MISSING or field.default_factory is not MISSING
    )  # fmt: skip


def _value(hint: Any, value: object, where: str) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return _any_of(arguments, value, where)
    if origin is Literal:
        if value not in arguments:
            raise RecordError(f"{where} is {value!r}: expected one of {', '.join(arguments)}")
        return value
    if origin is tuple:
        return _sequence(arguments, value, where)
    if origin is not None and issubclass(origin, Mapping):
        return {
            name: _value(arguments[1], one, f"{where}.{name}")
            for name, one in _names(value, where).items()
        }
    if hint is Any:
        return value
    if hint in _NUMBERS:
        # some programs write 1.0 as 1; true and false are not numbers
        fits = isinstance(value, int | float if hint is float else hint)
        if not fits or (isinstance(value, bool) and hint is not bool):
            raise RecordError(f"{where} is {value!r}: expected {_NUMBERS[hint]}")
        try:
            return hint(value)
        except OverflowError:
            raise RecordError(f"{where} is {value!r}: expected a smaller number") from None
    return value if isinstance(value, hint) else from_json(hint, value, where)


def _any_of(kinds: tuple[Any, ...], value: object, where: str) -> Any:
    """Return the value as the first kind that it fits; the error is that of the last one."""
    if value is None and types.NoneType in kinds:
        return None
    *others, last = (kind for kind in kinds if kind is not types.NoneType)
    for kind in others:
        try:
            return _value(kind, value, where)
        except RecordError:
            continue
    return _value(last, value, where)


def _sequence(kinds: tuple[Any, ...], value: object, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise RecordError(f"{where} is {value!r}: expected a list")
    if kinds[1:] == (...,):
        kinds = kinds[:1] * len(value)
    if len(kinds) != len(value):
        raise RecordError(f"{where} has {len(value)} values: expected {len(kinds)}")
    return tuple(
        _value(kind, one, f"{where}[{i}]")
        for i, (kind, one) in enumerate(zip(kinds, value, strict=True))
    )


def _names(value: object, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise RecordError(
            f"{where or 'the file'} holds a {type(value).__name__}: expected names and values"
        )
    return value
