"""Conversion of the firmware model's errors to those of edge-vpr."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from edge_vpr.errors import UsageError
from firmware_model import DesignError, VectorError


@contextmanager
def design_errors() -> Iterator[None]:
    """Convert errors of the firmware model to `UsageError` with the same text."""
    try:
        yield
    except (DesignError, VectorError) as error:
        raise UsageError(str(error)) from error
