"""Names of choices in words, for pages and figures."""

from __future__ import annotations

from edge_vpr.evaluation.metrics import RecallDenominator

#: queries that recall counts as missed
MISSED: dict[RecallDenominator, str] = {
    "rejected-correct": "rejected ones whose best match was right",
    "all-with-place": "all with a place in the map that they did not get",
}
