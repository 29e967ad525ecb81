"""Mapping and matching: from a recording to a reference map, or to the matches of a query."""

from edge_vpr.pipeline.cleaned_events import Removed, cleaned
from edge_vpr.pipeline.describing import count_windows, describe, describe_query, window_of
from edge_vpr.pipeline.mapping import coded_map, map_traverse
from edge_vpr.pipeline.query_matching import match_query, match_traverse, query_distances
from edge_vpr.pipeline.registration import Registration, register
from edge_vpr.pipeline.sources import EventSource, WindowSource, check_sensor

__all__ = [
    "EventSource",
    "Registration",
    "Removed",
    "WindowSource",
    "check_sensor",
    "cleaned",
    "coded_map",
    "count_windows",
    "describe",
    "describe_query",
    "map_traverse",
    "match_query",
    "match_traverse",
    "query_distances",
    "register",
    "window_of",
]
