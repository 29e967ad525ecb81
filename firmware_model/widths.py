"""Widths of all quantities of a device, computed from the largest values that can occur."""

from __future__ import annotations

from firmware_model.design import Design
from firmware_model.largest_values import (
    ACTIVITY_BITS,
    EVENTS_TOP,
    EVIDENCE_TOP,
    FRACTION_BITS,
    METRIC_TOP,
    RECIPROCAL_BITS,
    TRUST_TOP,
)
from fixedpoint.formats import UnsignedFormat
from fixedpoint.own_mean import MEAN_BITS


def formats_of(design: Design) -> dict[str, UnsignedFormat]:
    """Return the format of every quantity by its name, all unsigned integers.

    Returns
    -------
    dict of str to UnsignedFormat
        ``sum`` is what the search takes: a sequence's sum, or a metric. A code table's ``entry`` is
        a code, or a logarithm.
    """
    holding, code = UnsignedFormat.holding, UnsignedFormat(design.code_bits)
    distance = code.sum_of(design.slots)
    total = code.sum_of(design.slots * design.length)
    if design.filters:
        total = holding(METRIC_TOP)
    found: dict[str, UnsignedFormat] = {} if design.filters else {"sequence": total}
    found |= {
        "timestamp": UnsignedFormat(design.timestamp_bits),
        "column": holding(design.width - 1),
        "row": holding(design.height - 1),
        "address": holding(design.lookup_depth - 1),
        # one value more than the number of rows marks an entry without an owner
        "owner": holding(design.height),
        "slot": holding(design.slots - 1),
        "count": holding(design.count_max),
        "window_count": holding(design.window_events),
        "table": holding(len(design.full_scales) - 1),
        "entry": holding(design.entry_max) if design.own_mean else code,
        "code": code,
        "distance": distance,
        "sum": total,
        "product": holding(total.highest * design.ratio[1]),
        "place": holding(design.places - 1),
    }
    if design.own_mean or design.filters:
        found |= {
            "window_events": holding(EVENTS_TOP),
            "activity": holding(EVENTS_TOP << ACTIVITY_BITS),
        }
    if design.own_mean:
        found |= {"mean": holding(design.entry_max << MEAN_BITS)}
    if design.filters:
        found |= {
            "distance_total": distance.sum_of(design.places),
            "reciprocal": holding(1 << RECIPROCAL_BITS),
            "evidence": holding(EVIDENCE_TOP),
            "price": holding(max((*design.steps, *design.back, design.restart)) << FRACTION_BITS),
            "prediction": holding(METRIC_TOP),
            "metric": holding(METRIC_TOP),
            "trust": holding(TRUST_TOP),
        }
    return found


def widths_of(design: Design) -> dict[str, int]:
    """Return the number of bits of every quantity by its name."""
    return {name: form.width for name, form in formats_of(design).items()}
