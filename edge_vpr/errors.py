"""The one family of errors: each message says the value, what was expected, and the remedy."""

from __future__ import annotations


class EdgeVprError(Exception):
    """Base of every error that edge-vpr raises on purpose; its text fits one line."""

    exit_code = 1


class UsageError(EdgeVprError):
    """The request cannot be met as it was put: an argument, a setting or a combination is wrong."""

    exit_code = 2


class MissingExtraError(UsageError):
    """An optional library is needed and not installed; the message names the extra."""

    def __init__(self, what: str, library: str, extra: str) -> None:
        super().__init__(
            f"{what} needs the library {library}, which is not installed: "
            f"run pip install 'edge-vpr[{extra}]'"
        )


class EventError(EdgeVprError):
    """An event array is not what it claims to be (dtype, order, coordinates)."""


class RecordingError(EdgeVprError):
    """A recording cannot be read, or holds faults that the caller did not allow."""


class MapError(EdgeVprError):
    """A reference map or a result cannot be read, or does not fit the query."""


class GroundTruthError(EdgeVprError):
    """A ground truth cannot be read, or does not fit the matches."""
