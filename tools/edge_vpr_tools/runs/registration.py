"""Registration of a query's image with the map, before matching."""

from __future__ import annotations

from dataclasses import dataclass

from edge_vpr.pipeline import EventSource, WindowSource, register
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.output.messages import summary, warning


@dataclass(frozen=True, kw_only=True)
class MountShift:
    """Shift of a query's image, as in `metrics.json`.

    Attributes
    ----------
    dx, dy : int
        By which the map's pixels were moved, to the right and downwards.
    windows : int
        Of the query, that it was estimated from.
    likeness, likeness_unmoved : float
        Mean correlation of sequences with the most similar places, shifted and not.
    """

    dx: int
    dy: int
    windows: int
    likeness: float
    likeness_unmoved: float


def registered(
    reference: ReferenceMap, recording: EventSource | WindowSource, asked: bool
) -> tuple[ReferenceMap, MountShift | None]:
    """Move the pixels of a map by the shift of a query's image, if that is asked for, and say so.

    Parameters
    ----------
    reference : ReferenceMap
    recording : EventSource or WindowSource
        Is read from its start, and again by the matching.
    asked : bool

    Returns
    -------
    reference : ReferenceMap
        Moved, where a shift is clear.
    shift : MountShift or None
        None where none was asked for.

    Raises
    ------
    MapError, UsageError
        As `edge_vpr.pipeline.register` does.
    """
    if not asked:
        return reference, None
    found = register(reference, recording)
    if found.shifted:
        pixels = len(reference.pixel_map)
        warning(
            f"the camera's image is shifted by ({found.dx}, {found.dy}) pixels: the map's pixels "
            f"are moved, {pixels - len(found.reference.pixel_map)} of {pixels} are lost: fix the "
            "mounting, or make a new map"
        )
    else:
        summary(f"no shift of the camera is clear from {found.windows} windows")
    return found.reference, MountShift(
        dx=found.dx, dy=found.dy, windows=found.windows, likeness=found.likeness,
        likeness_unmoved=found.unmoved,
    )  # fmt: skip
