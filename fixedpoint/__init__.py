"""Exact integers: how wide a counter, a code and a sum are, and the codes of event counts.

Modules that use this package import from its modules, so that another library of the same name
cannot take its place (see docs/fixedpoint.md).
"""

from fixedpoint.errors import FixedPointError
from fixedpoint.formats import UnsignedFormat

__all__ = ["FixedPointError", "UnsignedFormat"]
