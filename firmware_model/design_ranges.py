"""Ranges of the parameters of a design."""

from __future__ import annotations

import numbers
from typing import Any, Literal, get_args

from firmware_model.errors import DesignError
from firmware_model.largest_values import FRACTION_BITS, METRIC_TOP, TRUST_TOP
from fixedpoint.codes import CodeKind

DeviceCode = Literal[CodeKind, "own-mean"]
WindowKind = Literal["time", "count"]
Matching = Literal["sequence", "filter"]
AcceptKind = Literal["margin", "ratio"]

#: largest number of code tables in a design
MAX_TABLES = 16
#: largest number of priced steps in each direction
MAX_STEPS = 16
#: largest price: with its fraction bits, it is below the largest metric
MAX_PRICE = (METRIC_TOP >> FRACTION_BITS) - 1
#: an event has 15 bits for the row, and one for the polarity
MAX_SIDE = 1 << 15
#: largest length of a list, checked first
MOST_PARTS = 4_096

_TUPLES = ("full_scales", "steps", "back", "ratio")
_SWITCHES = ("polarity", "keep_distances")
_CHOICES = {"window": WindowKind, "matching": Matching, "accept": AcceptKind}
_RANGES = {
    "width": (1, MAX_SIDE),
    "height": (1, MAX_SIDE),
    "pixels": (1, 1 << 15),
    "tau_us": (1, 1 << 63),
    "window_events": (1, (1 << 32) - 1),
    "timestamp_bits": (2, 64),
    "places": (1, 1 << 24),
    "length": (0, 1 << 12),
    "restart": (0, MAX_PRICE),
    "trust": (0, TRUST_TOP),
    "lanes": (1, 1 << 10),
    "exclusion": (0, 1 << 15),
    "margin": (0, (1 << 32) - 1),
    "lookup_depth": (0, 1 << 20),
}


def check_parameters(design: Any) -> None:
    """Check the range of each parameter, and convert lists to tuples of plain integers.

    Raises
    ------
    DesignError
        If a parameter is of another type, or out of its range.
    """
    for name in _TUPLES:
        parts = getattr(design, name)
        if not isinstance(parts, (list, tuple)) or len(parts) > MOST_PARTS:
            raise DesignError(f"design: {name} = {_shown(parts)}: expected a list of numbers")
        if not all(isinstance(part, numbers.Integral) for part in parts):
            raise DesignError(f"design: {name} = {_shown(parts)}: expected whole numbers")
        object.__setattr__(design, name, tuple(int(part) for part in parts))
    for name in _SWITCHES:
        value = getattr(design, name)
        if not isinstance(value, bool):
            raise DesignError(f"design: {name} = {_shown(value)}: expected true or false")
    for name, (low, high) in _RANGES.items():
        value = getattr(design, name)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise DesignError(f"design: {name} = {_shown(value)}: expected {low} to {high}")
    for name, choices in _CHOICES.items():
        value = getattr(design, name)
        if value not in get_args(choices):
            raise DesignError(
                f"design: {name} = {_shown(value)}: choose from {', '.join(get_args(choices))}"
            )


def _shown(value: object) -> str:
    try:
        return repr(value)[:80]
    except ValueError:  # of thousands of digits, as TOML allows
        return "a number too long to print"
