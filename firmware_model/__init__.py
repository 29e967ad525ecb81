"""Bit-exact model of the device, in plain and slow Python, and the golden vectors made from it."""

from firmware_model.design import Design
from firmware_model.errors import DesignError, ToolError, VectorError
from firmware_model.memories import Lookup, Memories
from firmware_model.specification import (
    Event,
    EventResult,
    Machine,
    MatchResult,
    Trace,
    WindowResult,
    trace,
)

__all__ = [
    "Design",
    "DesignError",
    "Event",
    "EventResult",
    "Lookup",
    "Machine",
    "MatchResult",
    "Memories",
    "ToolError",
    "Trace",
    "VectorError",
    "WindowResult",
    "trace",
]
