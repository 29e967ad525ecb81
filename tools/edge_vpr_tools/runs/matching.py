"""Messages on how a query fits its map: the image shifted, or views unlike the map's."""

from __future__ import annotations

from collections.abc import Iterable

from edge_vpr.confidence import STRANGE, STRANGE_TEXT
from edge_vpr.evaluation.match_tracks import save_match_track
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import MatchResult, ReferenceMap
from edge_vpr_tools.console import summary, warning

#: share of matches that may be unlike the map without a warning
_MUCH_STRANGE = 0.25


def report_shift(reference: ReferenceMap, found: MatchResult) -> None:
    """Print by how much the image of a query was shifted, if that was estimated.

    Parameters
    ----------
    reference : ReferenceMap
        Before its pixels were moved.
    """
    shift = found.shift
    if shift is None:
        return
    if (shift.dx, shift.dy) == (0, 0):
        summary(f"no shift of the camera is clear from {shift.windows} windows")
        return
    pixels = len(reference.pixel_map)
    warning(
        f"the camera's image is shifted by ({shift.dx}, {shift.dy}) pixels: the map's pixels are "
        f"moved, and {pixels - len(found.reference.pixel_map)} of {pixels} are lost; fix the "
        "mounting, or make a new map"
    )


def warn_if_strange(matches: Matches) -> None:
    """Warn if the views of more than a quarter of the matches are unlike those of the map."""
    share = float((matches.misfit >= STRANGE).mean())
    if share > _MUCH_STRANGE:
        warning(
            f"{STRANGE_TEXT}, by {share:.0%} of the matches: check that the drive and the map are "
            "of one route, or map the route in this light too"
        )


def export_tracks(paths: Iterable[str], reference: ReferenceMap, matches: Matches) -> None:
    """Write the matched positions to files, and report how many points each has."""
    for path in paths:
        points = save_match_track(path, reference, matches)
        summary(f"{path}: a track of {points:,} of the {len(matches):,} matches")
