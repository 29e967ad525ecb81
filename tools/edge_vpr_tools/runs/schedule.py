"""The flag ``--every``: when a localiser gives a match."""

from __future__ import annotations

from edge_vpr.errors import UsageError
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import duration_us


def every_of(given: str | None, default: str, reference: ReferenceMap) -> str:
    """Return the given ``--every``; without one, the default, or ``window`` if matches are late."""
    return given or ("window" if reference.settings.late else default)


def parse_every(text: str, reference: ReferenceMap) -> MatchSchedule:
    """Return the schedule of matches with a map, see `read_every`.

    Raises
    ------
    UsageError
        If it is none, or matches come late and are wanted at other times than the ends of windows.
    """
    schedule = read_every(text)
    if schedule is not None and reference.settings.late:
        raise UsageError(
            f"--every {text} with a delay of {reference.settings.late} windows, which gives a "
            "match at the end of each window: leave --every out, or set --delay 0"
        )
    return schedule or MatchSchedule.window(reference.settings)


def read_every(text: str) -> MatchSchedule | None:
    """Read ``event``, a number of events, a time such as ``10ms``, ``window``, or ``change``.

    Returns
    -------
    MatchSchedule or None
        None for ``window``, whose length a map or a design knows.

    Raises
    ------
    UsageError
        If it is none of these.
    """
    if text == "window":
        return None
    if text in ("event", "change"):
        return MatchSchedule(events=1, change=text == "change")
    if text.isascii() and text.isdigit() and int(text) > 0:
        return MatchSchedule(events=int(text))
    try:
        return MatchSchedule(interval_us=duration_us(text))
    except UsageError:
        raise UsageError(
            f"--every {text!r}: expected event, a number of events, a time such as 10ms, window, "
            "or change"
        ) from None
