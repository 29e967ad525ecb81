"""The errors of this package: each message says the value, what was expected, and the remedy."""

from __future__ import annotations


class DesignError(ValueError):
    """A design, its tables or its stimulus cannot be."""


class VectorError(Exception):
    """Golden vectors, or a device's results for them, cannot be read."""


class ToolError(Exception):
    """The compiler or the emulator is not installed, or refuses its work."""
