"""What a descriptor holds in place of event counts: the settings' code, as tables for its counters.

The tables themselves are `fixedpoint.codes`, which the hardware model shares. Clipping is the
linear code up to the clip.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, cast, get_args

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import MapError, UsageError
from fixedpoint.codes import CodeKind, CounterCode, PixelCodes
from fixedpoint.errors import FixedPointError

if TYPE_CHECKING:
    from edge_vpr.settings import Settings

CounterCodeName = Literal["none", "linear", "sqrt", "log"]
CODES: tuple[str, ...] = get_args(CounterCodeName)
CounterScaling = Literal["shared", "per-pixel"]
SCALINGS: tuple[str, ...] = get_args(CounterScaling)

FullScale = npt.NDArray[np.uint16]


def _code_of(settings: Settings) -> CounterCode:
    kind = cast(CodeKind, settings.counter_code)
    return CounterCode(kind, settings.counter_bits, settings.counter_full_scale)


def check_code(settings: Settings) -> None:
    """Check the settings of a counter code, which only make sense together.

    Raises
    ------
    UsageError
        If they do not.
    """
    if settings.clip and settings.counter_code != "none":
        raise UsageError(
            f"setting clip = {settings.clip} with counter_code = {settings.counter_code}: a count "
            "has one code; set clip to 0"
        )
    if settings.counter_scaling == "per-pixel" and settings.counter_full_scale:
        raise UsageError(
            f"setting counter_full_scale = {settings.counter_full_scale} with a per-pixel "
            "counter_scaling, which learns each pixel's from the reference: set it to 0"
        )
    try:
        shared_code(settings)
    except FixedPointError as error:
        raise UsageError(f"settings: {error}") from error


def shared_code(settings: Settings) -> CounterCode | None:
    """Give the code that all counters have by the settings; None where they have none, or not one.

    The settings' code is returned even if it is scaled to each pixel: its kind and width hold.
    """
    if settings.counter_code != "none":
        return _code_of(settings)
    return CounterCode.saturating(settings.clip) if settings.clip else None


def learns_full_scale(settings: Settings) -> bool:
    """Whether the code is scaled to each pixel by what the reference counted."""
    return settings.counter_code != "none" and settings.counter_scaling == "per-pixel"


def codes_of(
    settings: Settings, counters: int, full_scale: FullScale | None = None
) -> PixelCodes | None:
    """Give the code of each counter; None where counts stay as they are.

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
    code = shared_code(settings)
    if code is None:
        return None
    if not learns_full_scale(settings):
        return PixelCodes.shared(code, counters)
    if full_scale is None or full_scale.shape != (counters,):
        raise MapError(
            f"the code of {counters} counters is scaled to each pixel and "
            f"{0 if full_scale is None else full_scale.size} scales are given: pass those of the "
            "reference map"
        )
    return PixelCodes.scaled(code.kind, code.bits, full_scale)
