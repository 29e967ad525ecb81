"""Bit-exact model of the device, in plain and slow Python, and the golden vectors made from it."""

from firmware_model.errors import DesignError, ToolError, VectorError
from firmware_model.model.comparator import DistanceModel, MatchResult, SearchModel, SequenceModel
from firmware_model.model.descriptor import DescriptorModel, Event, EventResult, WindowResult
from firmware_model.model.design import Design
from firmware_model.model.machine import Cycle, Machine, Trace, trace
from firmware_model.model.memories import Lookup, Memories

__all__ = [
    "Cycle",
    "DescriptorModel",
    "Design",
    "DesignError",
    "DistanceModel",
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
