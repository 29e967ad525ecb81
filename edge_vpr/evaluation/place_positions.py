"""The positions of a map's places, from the track of the reference drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from edge_vpr.errors import GroundTruthError
from edge_vpr.evaluation.tracks import Track, distances
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Route


def with_positions(reference: ReferenceMap, track: Track) -> ReferenceMap:
    """Give each place the position that the reference drive had in the middle of its window.

    Parameters
    ----------
    reference : ReferenceMap
    track : Track
        Of the reference drive; time 0 is the recording's start.

    Raises
    ------
    GroundTruthError
        If the track covers no place.
    """
    position = track.at(reference.places.centre_us)
    known = np.flatnonzero(np.isfinite(position).all(axis=1))
    if known.size == 0:
        first, last = (float(t) / 1e6 for t in (track.time_us[0], track.time_us[-1]))
        raise GroundTruthError(
            f"the track runs from {first:.1f} to {last:.1f} s and covers no place of the map: "
            "give the reference drive's own track, and set its clock right"
        )
    position[~np.isfinite(position).all(axis=1)] = np.nan
    along = np.full(len(position), np.nan)
    # distances are added between places, not between fixes: those would add the noise of the GPS
    legs = distances(track.kind, position[known[:-1]], position[known[1:]])
    along[known] = np.concatenate([[0.0], np.cumsum(legs)])
    return replace(reference, route=Route(position, along, track.kind))
