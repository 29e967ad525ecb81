"""Exact integer arithmetic: widths of counters, codes and sums, contrast codes, activity.

Modules that use this package import from its modules, so that another library of the same name
cannot take its place.
"""

from __future__ import annotations

from fixedpoint.formats import FixedPointError, UnsignedFormat

__all__ = ["FixedPointError", "UnsignedFormat"]
