"""Cases that reach every corner, made for any design: small maps, and streams by construction."""

from __future__ import annotations

from dataclasses import replace

from firmware_model.design import Design
from firmware_model.vectors.case import Case
from firmware_model.vectors.event_corners import event_cases
from firmware_model.vectors.match_corners import match_cases


def corner_cases(design: Design) -> list[Case]:
    """Make the cases of the suite ``corners``.

    Maps are small and made for each case. Some cases change the design where a corner needs it:
    they carry their own.

    Parameters
    ----------
    design : Design
        Of one with the place filter or own-mean codes, that with sequences and logarithms; what
        these have is in `filter_cases`.

    Returns
    -------
    list of Case
        Of a design with a single code of a bit or two, those that it has room for.
    """
    if design.filters:
        design = replace(design, matching="sequence", length=0, trust=0)
    if design.own_mean:
        design = replace(design, code="log", full_scales=(0,))
    design = replace(design, places=_roomy(design))
    return [*event_cases(design), *match_cases(design)]


def _roomy(design: Design) -> int:
    """Places that hold two sequences with more than an exclusion zone between and around them."""
    return 3 * design.length + 3 * (design.exclusion + 2)
