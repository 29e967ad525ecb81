"""Names of choices in words, for pages and figures."""

from __future__ import annotations

#: queries that recall counts as missed, by the name of the denominator
MISSED: dict[str, str] = {
    "rejected-correct": "rejected ones whose best match was right",
    "all-with-place": "all with a place in the map that they did not get",
}
