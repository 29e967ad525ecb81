"""A profile as text, alone or beside another."""

from __future__ import annotations

import math
from pathlib import Path

from edge_vpr.files import parse_errors
from edge_vpr_tools.console import say, table
from edge_vpr_tools.profile.measurement import Energy, Figures, NotMeasured, Outcome, Readings
from edge_vpr_tools.profile.record import (
    NOT_MEASURED,
    NOT_RESOLVED,
    VOID,
    Number,
    Profile,
    Provenance,
    numbers,
)
from edge_vpr_tools.profile.speed import Timing
from edge_vpr_tools.report.page import quantity
from edge_vpr_tools.report.tables import write_spreadsheet

# Text of a profile, with units: rows of its tables, and notes.


#: one over the marginal energy, with the events of a match: the headline
PER_JOULE = "matches per joule"
DESIGNS = ("design", "P@100R", "bytes per place", "processor time per match", "marginal energy")


def rows(found: Profile) -> list[tuple[str, str]]:
    """Return the figures of a profile as pairs of name and value; missing ones are marked."""
    speed = found.throughput
    lines = [
        ("events per second", f"{speed.events_per_s:,.0f}"),
        ("matches per second", f"{speed.matches_per_s:,.1f}"),
        ("times real time", f"{speed.times_real_time:,.1f}"),
        ("latency of a call with a match, p50", quantity(speed.latency_p50_s, "s")),
        ("latency of a call with a match, p99", quantity(speed.latency_p99_s, "s")),
        ("processor time per match, with its events", quantity(speed.cpu_s_per_match, "s")),
        ("peak memory of the process", f"{speed.peak_memory_bytes / 2**20:,.1f} MiB"),
    ]
    for name, against in found.sparse_against_all.parts().items():
        what = f"{name.partition('_')[0]}, {against.sparse_pixels:,} against "
        what += f"{against.all_pixels:,} pixels"
        if against.places:
            what += f", {against.places:,} places"
        if name.endswith("_paper"):
            what += ", made up"
        sparse, every = (quantity(one.value, "s") for one in (against.sparse_s, against.all_s))
        seconds = f"{sparse} against {every} {against.unit}"
        lines.append((what, f"{seconds}: {_three(against.times)} times"))
    # the headline first
    energy = _energy_rows(found.energy, found.void)
    return energy[:1] + lines + energy[1:]


def _energy_rows(energy: Outcome, void: bool) -> list[tuple[str, str]]:
    names = (
        "marginal energy of a match, with its events",
        "energy of a match, whole board, saturated",
        "energy of a match, whole board, at the mission",
    )
    figures = energy.figures if isinstance(energy, Energy) else None
    if void or not isinstance(energy, Energy) or figures is None:
        return [(name, VOID if void else NOT_MEASURED) for name in (PER_JOULE, *names)]
    idle = quantity(figures.idle_w, "W", *figures.idle_w_interval, digits=4)
    return [
        (PER_JOULE, _per_joule(figures)),
        (names[0], _marginal(energy, figures)),
        (names[1], _joules(figures, "saturated_j_per_match")),
        (f"{names[2]}'s {energy.mission_matches_per_s:g} matches per second",
         _joules(figures, "mission_j_per_match")),
        ("power at rest", idle),
    ]  # fmt: skip


def _per_joule(figures: Figures) -> str:
    found = figures.bounded("matches_per_joule")
    if found.value is None or found.low is None or found.high is None:
        return NOT_RESOLVED
    return f"{found.value:,.4g} ({found.low:,.4g} to {found.high:,.4g})"


def _marginal(energy: Energy, figures: Figures) -> str:
    if figures.resolved:
        return _joules(figures, "marginal_j_per_match")
    pairs = figures.pairs_needed
    if pairs is None:
        return NOT_RESOLVED
    minutes = pairs * 2 * energy.window_s / 60
    return f"{NOT_RESOLVED}: about {pairs} pairs ({minutes:.0f} min) would do"


def designs(found: Profile) -> list[list[str]]:
    """Return the accuracy of each design and the cost of its match, as rows of `DESIGNS`."""
    lines = []
    for one in found.designs:
        figures = one.energy.figures if isinstance(one.energy, Energy) else None
        joules = VOID if found.void else NOT_MEASURED
        if figures is not None and isinstance(one.energy, Energy) and not found.void:
            joules = _marginal(one.energy, figures)
        lines.append(
            [one.name, f"{one.precision_at_100_recall:.3f}", f"{one.bytes_per_place:,}",
             quantity(one.cpu_s_per_match, "s", *one.cpu_s_per_match_interval), joules]
        )  # fmt: skip
    return lines


def notes(found: Profile) -> list[str]:
    """Return notes on the figures."""
    notes = []
    if found.quick:
        notes.append("--quick: windows too short for a figure to be published.")
    if found.void:
        notes.append(
            f"VOID: the board was throttled ({found.conditions.void_because}). Cool it, or give "
            "it a stronger supply, and run again."
        )
    if found.designs:
        places = sorted({one.places for one in found.designs})
        span = " to ".join(map(str, dict.fromkeys((places[0], places[-1]))))
        notes.append(
            f"P@100R of {found.load.recording}, among {span} places; it says nothing of "
            "other drives."
        )
    speed, of = found.throughput, found.load
    notes += [
        f"Load: {of.recording}, in packets of {of.packet:,} events, a match --every "
        f"{of.every}. Time and energy of a match include the counting of its "
        f"{speed.events_per_s / speed.matches_per_s:,.0f} events.",
        _provenance(found.provenance),
    ]
    notes += [f"{when.capitalize()}: {one}." for when, one in found.conditions.named().items()]
    return notes + _energy_notes(found.energy)


def _energy_notes(energy: Outcome) -> list[str]:
    if isinstance(energy, NotMeasured):
        notes = [f"Energy is not measured. {reason}." for reason in energy.not_measured_because]
        if energy.windows:
            notes.append("Turns were taken: `edge-vpr profile trace` adds a meter's CSV.")
        return notes
    readings, figures = energy.readings, energy.figures
    notes = [] if readings is None else [_sensor(readings)]
    if figures is None:
        return notes
    with_gain = "the meter's gain error is not known, and not in them"
    gain = 0.0 if readings is None else readings.sensor.gain_error
    if gain:
        bounds = figures.marginal_j_per_match_interval_with_gain
        low, high = (quantity(bound, "J", digits=4) for bound in bounds)
        with_gain = (
            f"with the meter's gain error of {gain:.2%} the marginal energy is {low} to {high}"
        )
    notes.append(f"Intervals are of 95 %, by bootstrap over {energy.pairs} pairs; {with_gain}.")
    if energy.sampler_cpu_share is not None:
        notes.append(f"Sampling took {energy.sampler_cpu_share:.2%} of a core, idle or not.")
    if figures.resolved:
        share = figures.idle_w / energy.mission_matches_per_s / figures.mission_j_per_match
        notes.append(f"At the mission's rate, {share:.2%} of the energy is the board at rest.")
    return notes


def _sensor(readings: Readings) -> str:
    sensor = readings.sensor
    step = "step not known"
    if sensor.resolution:
        step = f"steps of {sensor.resolution:.3g} {'J' if sensor.kind == 'energy' else 'W'}"
    return (
        f"Sensor {sensor.name} ({sensor.kind}): {sensor.scope}; a reading every "
        f"{sensor.period_s:g} s, {step}; {sensor.detail}."
    )


def _provenance(of: Provenance) -> str:
    unknown = "not known"
    clock = unknown if of.clock_hz is None else f"{of.clock_hz / 1e6:,.0f} MHz"
    shunt = unknown if of.shunt_mohm is None else f"{of.shunt_mohm:g} mOhm"
    versions = ", ".join(f"{name} {version}" for name, version in of.versions.items())
    return (
        f"Board {of.board or unknown}, {of.processor}; kernel {of.kernel}; clock {clock}; sensor "
        f"{of.sensor or 'none'}; shunt {shunt}; {versions}."
    )


def _joules(figures: Figures, name: str) -> str:
    value, low, high = figures.bounded(name)
    assert value is not None
    return quantity(value, "J", low, high, digits=4)


def _three(of: Timing) -> str:
    return f"{of.value:.3g} ({of.low:.3g} to {of.high:.3g})"


# Print a profile, or two side by side, on the terminal.


_WIDTH = 110
#: what a comparison says of two intervals
OVERLAP, APART = "overlap", "apart"


def show(found: Profile) -> None:
    """Print a profile."""
    table(("measured", ""), rows(found), title=found.run.machine.processor, width=_WIDTH)
    if found.designs:
        table(DESIGNS, designs(found), width=_WIDTH)
    for line in notes(found):
        say(line, width=_WIDTH)


def compare(first: Path, second: Path, spreadsheet: Path | None = None) -> None:
    """Print two profiles side by side, with the ratio if both have a number.

    Parameters
    ----------
    first, second : path
        Paths of the two ``profile.json`` files.
    spreadsheet : path, optional
        File to which the comparison is also written.

    Raises
    ------
    UsageError
        If a profile cannot be read.
    """
    found = [Profile.load_file(path) for path in (first, second)]
    for path, one in zip((first, second), found, strict=True):
        check_shown(one, path)
    sides = [{number.name: number for number in numbers(one)} for one in found]
    lines, cells = [], []
    for name in dict.fromkeys(name for side in sides for name in side):
        a, b = (side.get(name, Number(name, None, why=NOT_MEASURED)) for side in sides)
        ratio = b.value / a.value if a.value and b.value is not None else None
        overlap = _overlap(a, b)
        cells.append((name, *a[1:4], *b[1:4], ratio, overlap))
        lines.append(
            (name, _cell(a), _cell(b), "-" if ratio is None else f"{ratio:.3g}", overlap or "-")
        )
    table(("", str(first), str(second), "times", "intervals"), lines, width=_WIDTH)
    if any(cell[-1] == OVERLAP for cell in cells):
        say(
            "intervals are of 95 %; where they overlap, the two profiles show no difference",
            width=_WIDTH,
        )
    for path, one in zip((first, second), found, strict=True):
        for line in notes(one):
            say(f"{path}: {line}", width=_WIDTH)
    if spreadsheet is not None:
        header = (
            "quantity", str(first), f"{first} low", f"{first} high",
            str(second), f"{second} low", f"{second} high", "times", "intervals",
        )  # fmt: skip
        write_spreadsheet(spreadsheet, header, cells)


def check_shown(found: Profile, path: Path) -> None:
    """Raise `UsageError` unless all shown parts of a profile are valid."""
    with parse_errors(path, "a profile", "make it again with edge-vpr profile"):
        _ = rows(found), designs(found), notes(found)
        for number in numbers(found):
            for value in number[1:4]:
                if value is not None and not math.isfinite(value):
                    raise ValueError(f"{number.name} is {value}")


def _cell(of: Number) -> str:
    if of.value is None:
        return of.why
    if of.low is None or of.high is None:
        return f"{of.value:,.6g}"
    return f"{of.value:,.4g} ({of.low:,.4g} to {of.high:,.4g})"


def _overlap(a: Number, b: Number) -> str | None:
    """Return whether two intervals overlap; None unless both figures have one."""
    if a.low is None or a.high is None or b.low is None or b.high is None:
        return None
    return OVERLAP if a.low <= b.high and b.low <= a.high else APART
