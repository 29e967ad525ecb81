"""Checks of parts of a reference map that kernels use as indices."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.array_checks import check_array, check_range
from edge_vpr.descriptors.codes import codes_of
from edge_vpr.errors import MapError
from edge_vpr.odometry import MOST_MM
from edge_vpr.settings import Settings
from fixedpoint.errors import FixedPointError

#: each is processed after every window
MOST_JUMPS = 4_096


def check_ways(
    places: int, jumps: npt.NDArray[Any] | None, odometer_mm: npt.NDArray[Any] | None
) -> None:
    """Check that jumps lead from place to place, and that the distance driven never decreases."""
    if jumps is not None:
        check_array(jumps, "jumps", (np.int32,), (None, 2))
        check_range(jumps, "jumps", 0, places - 1)
        if len(jumps) > MOST_JUMPS:
            raise MapError(f"jumps has {len(jumps)} pairs of places: expected up to {MOST_JUMPS}")
        if (jumps[:, 0] == jumps[:, 1]).any():
            raise MapError("jumps leads from a place to itself: expected pairs of two places")
    if odometer_mm is not None:
        check_array(odometer_mm, "odometer_mm", (np.int64,), (places,))
        check_range(odometer_mm, "odometer_mm", 0, MOST_MM)
        if (np.diff(odometer_mm) < 0).any():
            raise MapError("odometer_mm falls from place to place: expected the way driven")


def check_codes(
    settings: Settings, counts: npt.NDArray[Any], full_scale: npt.NDArray[Any] | None
) -> None:
    """Check that all codes of the places occur in the tables of their counters."""
    if settings.learns_full_scale and full_scale is not None:
        # arbitrary scales, which no reference gives, could need one table for each counter
        scale = full_scale.astype(np.int64)
        wrong = (scale < 1) | (scale & (scale + 1) != 0)
        if wrong.any():
            raise MapError(
                f"full_scale holds {scale[wrong][0]}: expected 2**n - 1, with n from 1 to 16"
            )
    try:
        codes = codes_of(settings, counts.shape[1], full_scale)
    except FixedPointError as error:
        raise MapError(f"the codes of the map: {error}") from error
    if codes is None:
        return
    top = np.array([code.top for code in codes.codes], dtype=np.int64)[codes.row]
    above = np.flatnonzero(counts.max(axis=0) > top)
    if above.size:
        j = int(above[0])
        raise MapError(
            f"counter {j} holds the code {counts[:, j].max()}: expected codes up to {top[j]}"
        )
