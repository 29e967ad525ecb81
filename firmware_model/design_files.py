"""Conversion of a design to and from plain values and TOML files."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Self

from firmware_model.errors import DesignError

_MOST_BYTES = 1 << 20


class DesignFile:
    """Base class that writes and reads a dataclass of plain values and tuples."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON and TOML."""
        values = asdict(self)  # type: ignore[call-overload]
        return {n: list(v) if isinstance(v, tuple) else v for n, v in values.items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "design") -> Self:
        """Build from plain values.

        Raises
        ------
        DesignError
            If a name is unknown or missing, or a value out of range; `source` is named.
        """
        known = {field.name for field in fields(cls)}  # type: ignore[arg-type]
        unknown = sorted(set(values) - known)
        if unknown:
            raise DesignError(
                f"{source} has the unknown name {unknown[0]!r}: choose from "
                f"{', '.join(sorted(known))}"
            )
        missing = sorted({"width", "height", "pixels", "places"} - set(values))
        if missing:
            raise DesignError(f"{source} lacks {missing[0]}: name it")
        try:
            return cls(**values)
        except DesignError:
            raise
        except Exception as error:  # a value of an unexpected type
            raise DesignError(f"{source} is no design ({error}): check its values") from error

    def to_toml(self) -> str:
        """Write as TOML, which `load` reads."""
        values = self.to_dict()
        return "".join(f"{name} = {_toml(value)}\n" for name, value in values.items())

    def save(self, path: str | Path) -> None:
        """Write as a TOML file."""
        Path(path).write_text(self.to_toml(), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a TOML file.

        Raises
        ------
        DesignError
            If it cannot be read, or is no design.
        """
        try:
            with Path(path).open("rb") as file:
                raw = file.read(_MOST_BYTES)  # a longer file is not a design
            values = tomllib.loads(raw.decode("utf-8-sig"))
        # the parser also raises other errors for deep nesting, long numbers and invalid dates
        except Exception as error:
            raise DesignError(
                f"cannot read a design from {path}: {str(error)[:200]}: name a TOML file"
            ) from error
        return cls.from_dict(values, str(path))


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    return repr(value)
