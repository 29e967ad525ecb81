"""When a localiser gives a match: the flag ``--every``."""

from __future__ import annotations

from edge_vpr.errors import UsageError
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import duration_us


def parse_every(text: str, reference: ReferenceMap) -> MatchSchedule:
    """Read ``event``, a number of events, a time such as ``10ms``, ``window``, or ``change``.

    Raises
    ------
    UsageError
        If it is none of these.
    """
    if text == "event":
        return MatchSchedule(events=1)
    if text == "change":
        return MatchSchedule(events=1, change=True)
    if text == "window":
        return MatchSchedule.window(reference.settings)
    if text.isascii() and text.isdigit() and int(text) > 0:
        return MatchSchedule(events=int(text))
    try:
        return MatchSchedule(interval_us=duration_us(text))
    except UsageError:
        raise UsageError(
            f"--every {text!r}: expected event, a number of events, a time such as 10ms, window, "
            "or change"
        ) from None
