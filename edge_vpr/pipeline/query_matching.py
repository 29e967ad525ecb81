"""A query drive against a map."""

from __future__ import annotations

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.matching.matches import Matches, match_descriptors
from edge_vpr.pipeline.describing import describe_query
from edge_vpr.pipeline.sources import EventSource, WindowSource
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings


def match_traverse(
    reference: ReferenceMap,
    recording: EventSource | WindowSource,
    settings: Settings | None = None,
) -> tuple[Matches, Descriptors]:
    """Match a query drive against a map.

    Parameters
    ----------
    reference : ReferenceMap
    recording : EventSource or WindowSource
    settings : Settings, optional
        Sequence length, anchor and exclusion to use instead of the map's.

    Returns
    -------
    matches : Matches
    queries : Descriptors
        What was matched.

    Raises
    ------
    MapError, UsageError
        As `describe` and `match_descriptors` do.
    """
    if settings is not None:
        reference = reference.matched_with(settings)
    queries = describe_query(reference, recording)
    return match_query(reference, queries), queries


def match_query(reference: ReferenceMap, queries: Descriptors) -> Matches:
    """Match a described query by the settings and the table of probabilities of a map."""
    return match_descriptors(
        reference.places, queries, reference.settings, reference.judge.confidence
    )
