"""Largest values of what a device computes, and fraction bits of its numbers."""

from __future__ import annotations

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
#: largest number of events of a window; larger ones saturate
EVENTS_TOP = (1 << 23) - 1
