"""Registration of a query's image with the map, before matching."""

from __future__ import annotations

from dataclasses import dataclass

from edge_vpr.pipeline import EventSource, WindowSource, register
from edge_vpr.reference_map import ReferenceMap


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


@dataclass(frozen=True)
class Mounted:
    """A map with its pixels moved for a query.

    Attributes
    ----------
    reference : ReferenceMap
        Moved, where a shift is clear.
    shift : MountShift or None
        None where none was asked for.
    """

    reference: ReferenceMap
    shift: MountShift | None = None


def mounted(reference: ReferenceMap, recording: EventSource | WindowSource, asked: bool) -> Mounted:
    """Register a map with a recording, if that is asked for.

    Parameters
    ----------
    reference : ReferenceMap
    recording : EventSource or WindowSource
        Is read from its start, and again by the matching.
    asked : bool

    Returns
    -------
    Mounted

    Raises
    ------
    MapError, UsageError
        As `edge_vpr.pipeline.register` does.
    """
    if not asked:
        return Mounted(reference)
    found = register(reference, recording)
    shift = MountShift(
        dx=found.dx, dy=found.dy, windows=found.windows, likeness=found.likeness,
        likeness_unmoved=found.unmoved,
    )  # fmt: skip
    return Mounted(found.reference, shift)
