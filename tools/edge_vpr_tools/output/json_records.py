"""Conversion of frozen dataclasses to and from JSON, with all checks of such files.

The names of the fields are the names in the file. Fields that the class does not have are ignored,
so that a file of a newer version with the same schema can be read.
"""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from edge_vpr.errors import EdgeVprError

T = TypeVar("T")

#: metadata of a field that is not written while it is None
LEFT_OUT: Mapping[str, bool] = {"left_out": True}
_NUMBERS = {float: "a number", int: "an integer", str: "text", bool: "true or false"}


class RecordError(EdgeVprError):
    """Values from a file do not fit the expected record."""


def to_json(value: Any) -> Any:
    """Return a record as values that JSON can hold.

    Parameters
    ----------
    value : object
        A dataclass, a named tuple, or a sequence or mapping of them. Where it has a method
        `to_json`, that one is called.

    Returns
    -------
    object
        Dictionaries, lists and plain values.
    """
    if hasattr(value, "to_json"):
        return value.to_json()
    if is_dataclass(value) and not isinstance(value, type):
        return fields_to_json(value)
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: to_json(one) for name, one in value._asdict().items()}
    if isinstance(value, Mapping):
        return {name: to_json(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(one) for one in value]
    return value


def fields_to_json(record: Any) -> dict[str, Any]:
    """Return the fields of a dataclass, for a `to_json` that adds to them."""
    found = {}
    for field in fields(record):
        value = getattr(record, field.name)
        if value is not None or not field.metadata.get("left_out"):
            found[field.name] = to_json(value)
    return found


def from_json(kind: type[T], value: object, where: str = "") -> T:
    """Build a record from values of JSON.

    Parameters
    ----------
    kind : type
        A dataclass or a named tuple of plain values, tuples, mappings by name, and records. Where
        it has a class method `from_json`, that one is called.
    value : object
        As read; nothing of it is trusted.
    where : str
        Names of the fields that lead to it, for the message.

    Raises
    ------
    RecordError
        If a field is missing, or is not of its type.
    """
    own = getattr(kind, "from_json", None)
    if own is not None:
        found: T = own(_names(value, where), where)
        return found
    return fields_from_json(kind, _names(value, where), where)


def fields_from_json(kind: type[T], values: Mapping[str, Any], where: str = "") -> T:
    """Build the fields of a record, for a `from_json` that makes some of them itself."""
    record: Any = kind
    given = {}
    for name, hint in _hints(record).items():
        if name in values:
            given[name] = _value(hint, values[name], f"{where}.{name}" if where else name)
        elif name not in _defaults(record):
            raise RecordError(f"{where or 'the file'} lacks {name}")
    return kind(**given)


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
        return hint(value)
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
