"""The errors of this package: each message says the value, what was expected, and the remedy."""

from __future__ import annotations


class FixedPointError(ValueError):
    """A format, a notation or an operand is not what the operation needs."""


class FixedOverflowError(FixedPointError, OverflowError):
    """A value does not fit its format, and overflow was to be an error."""
