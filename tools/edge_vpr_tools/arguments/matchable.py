"""Whether a drive was long enough for a map that can be matched."""

from __future__ import annotations

from edge_vpr.errors import UsageError
from edge_vpr.reference_map import ReferenceMap


def check_matchable(reference: ReferenceMap) -> None:
    """Refuse a map that no drive can be matched against with its own sequence length.

    Raises
    ------
    UsageError
        If it has fewer places than a sequence has windows.
    """
    length, places = reference.settings.windows_per_match, len(reference)
    if length > places:
        raise UsageError(
            f"a sequence of {length} windows does not fit the {places} places of this drive: take "
            "a shorter sequence (-L), shorter windows (--tau), or a longer drive"
        )
