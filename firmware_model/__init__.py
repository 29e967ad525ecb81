"""Bit-exact model of the device, in plain and slow Python, and the golden vectors made from it."""

from firmware_model.comparator import ComparatorModel, MatchResult, SearchModel
from firmware_model.descriptor import DescriptorModel, Event, EventResult, WindowResult
from firmware_model.design import Design
from firmware_model.errors import DesignError, ToolError, VectorError
from firmware_model.machine import Cycle, Machine, Trace, trace
from firmware_model.memories import Lookup, Memories
from firmware_model.sequence import SequenceModel

__all__ = [
    "ComparatorModel",
    "Cycle",
    "DescriptorModel",
    "Design",
    "DesignError",
    "Event",
    "EventResult",
    "Lookup",
    "Machine",
    "MatchResult",
    "Memories",
    "SearchModel",
    "SequenceModel",
    "ToolError",
    "Trace",
    "VectorError",
    "WindowResult",
    "trace",
]
