"""The errors of this package; each message gives the value, what was expected, and the remedy.

Their `exit_code` is that of a command which they end.
"""

from __future__ import annotations


class DesignError(ValueError):
    """A design, its tables or its stimulus is not valid."""

    exit_code = 2


class VectorError(Exception):
    """Golden vectors, or the results of a device, cannot be read."""

    exit_code = 2


class BoardError(VectorError):
    """A board does not answer, or answers what no device would."""

    exit_code = 1


class ToolError(Exception):
    """The compiler or the emulator is not installed, or has failed."""

    exit_code = 1
