"""How designs and quantities of an estimate are written: in suitable units, with low and high."""

from __future__ import annotations

from collections.abc import Iterable

from edge_vpr_tools.estimate.targets import Spread
from edge_vpr_tools.report.page import quantity
from firmware_model.image import kept_bytes
from firmware_model.model.design import Design

UNKNOWN = "unknown"


def matching(of: Design) -> str:
    """Return how a design matches."""
    if not of.filters:
        return f"sequences of {of.length}"
    if not of.steps:
        return "place filter" + ", places at half windows" * (of.places_per_window == 2)
    return f"place filter with fixed costs of {len(of.steps) + len(of.back)} steps"


def short_text(of: Design) -> str:
    """Return pixels, codes, places and matching of a design for a cell of a table."""
    by = f"sequences of {of.length}"
    if of.filters:
        by = "filter" + ", places at half windows" * (of.places_per_window == 2)
        by += "" if of.keep_distances else ", distances computed twice"
    return (
        f"{of.pixels:,} px, {of.code_bits} bit{'s' * (of.code_bits > 1)} {of.code}, "
        f"{of.places:,} places, {by}"
    )


def design_text(of: Design) -> str:
    """Return pixels, codes, places, and how a design matches."""
    kept = ""
    if of.filters:
        kept = ", distances computed twice"
        if of.keep_distances:
            kept = f", distances kept ({size_text(kept_bytes(of))} of a processor's RAM)"
    return (
        f"{of.pixels:,} pixels, {of.code_bits} bit{'s' * (of.code_bits > 1)} ({of.code}), "
        f"{of.places:,} places, {matching(of)}{kept}"
    )


def busy(load: Spread) -> str:
    """Return the share of the time that a target is busy, or that it cannot keep up."""
    if load.low >= 1:
        return "overloaded"
    return f"{load.central:.3%}" if load.high < 1 else f"{load.central:.0%}: may be overloaded"


def joules(value: Spread | None) -> str:
    """Return an energy, or that it is unknown."""
    return UNKNOWN if value is None else spread(value, "J")


def per_joule(value: Spread | None) -> str:
    """Return the matches per joule of the work, or that they are unknown."""
    if value is None:
        return UNKNOWN
    low, central, high = (
        f"{one:,.0f}" if one >= 100 else f"{one:.3g}"
        for one in (value.low, value.central, value.high)
    )
    return f"{central} ({low} to {high})"


def watts(value: Spread | None) -> str:
    """Return a power, or that it is unknown."""
    return UNKNOWN if value is None else spread(value, "W")


def spread(value: Spread, unit: str) -> str:
    """Return a value with low and high, in one unit that suits the central value."""
    return quantity(value.central, unit, value.low, value.high)


def three(values: Iterable[float]) -> str:
    """Return low, central and high as central with its bounds."""
    low, central, high = values
    return f"{central:g} ({low:g} to {high:g})"


def times(theirs: float, ours: float) -> str:
    """Return how many times ours theirs is."""
    return f"{theirs / ours:,.3g}" if ours else "-"


def size_text(number: float) -> str:
    """Return bytes, in KiB where they are many."""
    return f"{number:,.0f} B" if number < 10_240 else f"{number / 1024:,.1f} KiB"


def count(value: Spread) -> str:
    """Return cycles with low and high."""
    if value.low == value.high:
        return f"{value.central:,.0f}"
    return f"{value.central:,.0f} ({value.low:,.0f} to {value.high:,.0f})"
