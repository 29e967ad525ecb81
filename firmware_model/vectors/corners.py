"""Corner cases for any design: small maps, and streams that reach each corner by construction."""

from __future__ import annotations

from dataclasses import replace

from firmware_model.design import LENGTH, Design
from firmware_model.vectors.case import Case
from firmware_model.vectors.event_corners import event_cases
from firmware_model.vectors.match_corners import match_cases


def corner_cases(design: Design) -> list[Case]:
    """Make the cases of the suite ``corners``.

    Maps are small and made for each case. Where a corner needs another design, the case changes it
    and carries its own.

    Parameters
    ----------
    design : Design
        If it has the place filter or own-mean codes, these are replaced by sequences and
        logarithms; the cases of the filter and of own-mean codes are in `filter_cases`.

    Returns
    -------
    list of Case
        For a design with a single code of one or two bits, only the cases that fit it.
    """
    if design.filters:
        # places with room for a sequence; their number is replaced below
        places = design.places + LENGTH
        design = replace(design, matching="sequence", length=0, trust=0, places=places)
    if design.own_mean:
        design = replace(design, code="log", full_scales=(0,))
    design = replace(design, places=_roomy(design))
    return [*event_cases(design), *match_cases(design)]


def _roomy(design: Design) -> int:
    """Return a number of places with room for two sequences, and zones around and between them."""
    return 3 * design.length + 3 * (design.exclusion + 2)
