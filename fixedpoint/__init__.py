"""Exact integer arithmetic: widths of counters, codes and sums, and codes of event counts.

Modules that use this package import from its modules, so that another library of the same name
cannot take its place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fixedpoint.errors import FixedPointError

if TYPE_CHECKING:
    from fixedpoint.formats import UnsignedFormat

__all__ = ["FixedPointError", "UnsignedFormat"]


def __getattr__(name: str) -> Any:
    # imported on demand, as it loads NumPy, which the settings do not need
    if name != "UnsignedFormat":
        raise AttributeError(f"module 'fixedpoint' has no attribute {name!r}")
    from fixedpoint.formats import UnsignedFormat

    return UnsignedFormat
