"""Texts on what cleaning removed from a recording, with a warning if it was much."""

from __future__ import annotations

from edge_vpr.pipeline import Removed
from edge_vpr.settings import Settings
from edge_vpr_tools.output.messages import warning
from edge_vpr_tools.output.provenance import RemovedEvents

#: share of events that a few bursts of a sensor do not reach
MUCH = 0.05


def describe_removed(removed: Removed, settings: Settings) -> str:
    """Return what was removed as bursts, as the end of a sentence."""
    if not settings.remove_bursts:
        return "; bursts kept"
    return f"; {removed.burst_events:,} events ({removed.burst_share:.1%}) removed as bursts"


def removed_record(removed: Removed, hot_pixels: int) -> RemovedEvents:
    """Return the same for `run.json`."""
    return RemovedEvents(removed.events, removed.burst_events, removed.burst_share, hot_pixels)


def warn_if_much(removed: Removed, path: str, remedy: str) -> None:
    """Warn if bursts were more than `MUCH` of a recording."""
    if removed.burst_share > MUCH:
        warning(
            f"{removed.burst_share:.0%} of the events of {path} were removed as bursts, moments "
            f"when most pixels fire: if that is the scene's or the camera's motion, {remedy}"
        )
