"""Ranges of what can be chosen of a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from edge_vpr.errors import UsageError


def check_range(
    record: object, names: Sequence[str], remedy: str, least: float = 0, most: float = inf
) -> None:
    """Raise UsageError with a remedy unless each of some attributes lies in a range."""
    for name in names:
        value = getattr(record, name)
        if not least <= value <= most:
            raise UsageError(f"{name} is {value}: {remedy}")
