"""The error of this package; each message gives the value, what was expected, and the remedy."""

from __future__ import annotations


class FixedPointError(ValueError):
    """A format, a code or an operand does not fit the operation."""
