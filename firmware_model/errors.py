"""The errors of this package; each message gives the value, what was expected, and the remedy."""

from __future__ import annotations


class DesignError(ValueError):
    """A design, its tables or its stimulus is not valid."""


class VectorError(Exception):
    """Golden vectors, or the results of a device, cannot be read."""


class ToolError(Exception):
    """The compiler or the emulator is not installed, or has failed."""
