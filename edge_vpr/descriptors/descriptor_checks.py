"""Checks of descriptors from a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edge_vpr.array_checks import check_array, check_range
from edge_vpr.errors import MapError
from edge_vpr.events import TIME_LIMIT_US

if TYPE_CHECKING:
    from edge_vpr.descriptors.windows import Descriptors

#: dtypes of counts that can be matched: native byte order, at most 32 bits
COUNT_DTYPES = (np.uint8, np.uint16, np.uint32)


def check_descriptors(descriptors: Descriptors, counters: int | None = None) -> None:
    """Check that all arrays have the documented dtypes and the same length.

    Parameters
    ----------
    descriptors : Descriptors
        At least one.
    counters : int, optional
        How many counts each must have.

    Raises
    ------
    MapError
        If a dtype or shape differs, a time is out of range, or a window ends before it starts.
    """
    check_array(descriptors.counts, "counts", COUNT_DTYPES, (None, counters))
    n = len(descriptors.counts)
    if not descriptors.counts.size:
        raise MapError(
            f"counts are of shape {descriptors.counts.shape}: expected one window or more, with "
            "one count or more"
        )
    for name in ("start_us", "end_us", "events"):
        check_array(getattr(descriptors, name), name, (np.int64,), (n,))
    for name in ("start_us", "end_us"):
        check_range(getattr(descriptors, name), name, -TIME_LIMIT_US, TIME_LIMIT_US)
    check_range(descriptors.events, "events", 0, TIME_LIMIT_US)
    if descriptors.selected is not None:
        check_array(descriptors.selected, "selected", (np.int64,), (n,))
        check_range(descriptors.selected, "selected", 0, TIME_LIMIT_US // n)
    if (descriptors.end_us < descriptors.start_us).any():
        raise MapError("a window ends before it starts: expected end_us of start_us or later")
