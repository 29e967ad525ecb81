"""Report of the shift of a query's image."""

from __future__ import annotations

from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.output.messages import summary, warning
from edge_vpr_tools.runs.registration import Mounted


def report_shift(found: Mounted, mapped: ReferenceMap) -> None:
    """Warn of a shift, or note that there is no clear one; nothing without registration.

    Parameters
    ----------
    found : Mounted
    mapped : ReferenceMap
        Before it was moved.
    """
    shift = found.shift
    if shift is None:
        return
    if (shift.dx, shift.dy) == (0, 0):
        summary(f"no shift of the camera is clear from {shift.windows} windows")
        return
    lost = len(mapped.pixel_map) - len(found.reference.pixel_map)
    warning(
        f"the camera's image is shifted by ({shift.dx}, {shift.dy}) pixels: the map's pixels are "
        f"moved, {lost} of {len(mapped.pixel_map)} are lost: fix the mounting, or make a new map"
    )
