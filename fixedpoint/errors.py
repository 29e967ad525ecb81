"""The error of this package: each message says the value, what was expected, and the remedy."""

from __future__ import annotations


class FixedPointError(ValueError):
    """A format, a code or an operand is not what the operation needs."""
