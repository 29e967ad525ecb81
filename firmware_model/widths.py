"""The width of everything in a device, each from the largest value that can occur."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fixedpoint.formats import FixedFormat
from fixedpoint.ops import sum_format
from fixedpoint.own_mean import MEAN_BITS

if TYPE_CHECKING:
    from firmware_model.design import Design

#: fraction bits of the filter's metrics, evidence and prices
FRACTION_BITS = 2
#: largest metric and largest evidence
METRIC_TOP, EVIDENCE_TOP = (1 << 10) - 1, (1 << 8) - 1
#: fraction bits of the reciprocal of the spread, which is at most 1
RECIPROCAL_BITS = 16
#: fraction bits of the trust, and its largest value
TRUST_BITS = 4
TRUST_TOP = METRIC_TOP << TRUST_BITS
#: fraction bits of the usual number of events in a window
ACTIVITY_BITS = 8
#: where the number of a window's events saturates
EVENTS_TOP = (1 << 23) - 1


def formats_of(design: Design) -> dict[str, FixedFormat]:
    """Return the format of every quantity by its name, all unsigned integers.

    Parameters
    ----------
    design : Design

    Returns
    -------
    dict of str to FixedFormat
        ``sum`` is what the search takes: a sequence's sum, or a metric. A code table's ``entry`` is
        a code, or a logarithm.
    """
    code = FixedFormat(False, design.code_bits)
    distance = sum_format(code, design.slots)
    total = sum_format(code, design.slots * design.length)
    if design.filters:
        total = _holding(METRIC_TOP)
    found: dict[str, FixedFormat] = {} if design.filters else {"sequence": total}
    found |= {
        "timestamp": FixedFormat(False, design.timestamp_bits),
        "column": _holding(design.width - 1),
        "row": _holding(design.height - 1),
        "address": _holding(design.lookup_depth - 1),
        # one value more than there are rows marks an entry without an owner
        "owner": _holding(design.height),
        "slot": _holding(design.slots - 1),
        "count": _holding(design.count_max),
        "window_count": _holding(design.window_events),
        "table": _holding(len(design.full_scales) - 1),
        "entry": _holding(design.entry_max) if design.own_mean else code,
        "code": code,
        "distance": distance,
        "sum": total,
        "product": _holding(total.highest * design.ratio[1]),
        "place": _holding(design.places - 1),
    }
    if design.own_mean or design.filters:
        found |= {
            "window_events": _holding(EVENTS_TOP),
            "activity": _holding(EVENTS_TOP << ACTIVITY_BITS),
        }
    if design.own_mean:
        found |= {"mean": _holding(design.entry_max << MEAN_BITS)}
    if design.filters:
        found |= {
            "distance_total": sum_format(distance, design.places),
            "reciprocal": _holding(1 << RECIPROCAL_BITS),
            "evidence": _holding(EVIDENCE_TOP),
            "price": _holding(max((*design.steps, *design.back, design.restart)) << FRACTION_BITS),
            "prediction": _holding(METRIC_TOP),
            "metric": _holding(METRIC_TOP),
            "trust": _holding(TRUST_TOP),
        }
    return found


def _holding(largest: int) -> FixedFormat:
    """Narrowest unsigned integer that holds 0 to `largest`."""
    return FixedFormat(False, max(1, largest.bit_length()))
