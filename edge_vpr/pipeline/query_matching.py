"""Matching of a query drive with a map."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.descriptors import Descriptors
from edge_vpr.matching.drive_distances import drive_distances
from edge_vpr.matching.drive_matching import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.odometry import Odometry
from edge_vpr.pipeline.describing import describe_query
from edge_vpr.pipeline.sources import EventSource, WindowSource
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings


def match_traverse(
    reference: ReferenceMap,
    recording: EventSource | WindowSource,
    settings: Settings | None = None,
    odometry: Odometry | None = None,
) -> tuple[Matches, Descriptors]:
    """Match a query drive with a map.

    Parameters
    ----------
    reference : ReferenceMap
    recording : EventSource or WindowSource
    settings : Settings, optional
        Sequence length, anchor and exclusion to use instead of the map's.
    odometry : Odometry, optional
        Of the query drive.

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
    return match_query(reference, queries, odometry), queries


def match_query(
    reference: ReferenceMap, queries: Descriptors, odometry: Odometry | None = None
) -> Matches:
    """Match a described query with a map, using its settings, probabilities and jumps.

    Parameters
    ----------
    reference : ReferenceMap
    queries : Descriptors
    odometry : Odometry, optional
        Of the query drive.
    """
    return match_descriptors(
        reference.places,
        queries,
        reference.settings,
        reference.judge.confidence,
        jumps=reference.jumps,
        along_mm=reference.along_mm,
        odometry=odometry,
    )


def query_distances(
    reference: ReferenceMap, queries: Descriptors, odometry: Odometry | None = None
) -> npt.NDArray[np.float64]:
    """Return the distance of every place of a map to every query window of `match_query`.

    Returns
    -------
    ndarray of float64, shape (K, Q)
        All finite, see `drive_distances`.
    """
    return drive_distances(
        reference.places,
        queries,
        reference.settings,
        jumps=reference.jumps,
        along_mm=reference.along_mm,
        odometry=odometry,
    )
