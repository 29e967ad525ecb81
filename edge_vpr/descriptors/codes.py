"""Tables of the counter code that the settings choose.

The codes themselves are in `fixedpoint.codes`, which the hardware model uses too. Clipping is the
linear code up to the clip.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import MapError
from edge_vpr.settings import Settings
from fixedpoint.codes import PixelCodes

FullScale = npt.NDArray[np.uint16]


def codes_of(
    settings: Settings, counters: int, full_scale: FullScale | None = None
) -> PixelCodes | None:
    """Return the code of each counter; None if descriptors hold counts.

    Parameters
    ----------
    settings : Settings
    counters : int
        J, or with polarity 2 J.
    full_scale : ndarray of uint16, shape (counters,), optional
        What the reference map learned, needed where the settings scale the code to each pixel.

    Raises
    ------
    MapError
        If the full scales are needed and missing, or not one a counter.
    """
    code = settings.shared_code
    if code is None:
        return None
    if settings.own_mean_code is not None:
        raise MapError("own-mean codes have no fixed table: code counts by the reference map")
    if not settings.learns_full_scale:
        return PixelCodes.shared(code, counters)
    if full_scale is None or full_scale.shape != (counters,):
        raise MapError(
            f"the code of {counters} counters is scaled to each pixel and "
            f"{0 if full_scale is None else full_scale.size} scales are given: pass those of the "
            "reference map"
        )
    return PixelCodes.scaled(code.kind, code.bits, full_scale)
