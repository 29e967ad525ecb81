"""A profile as text, on the terminal, as a spreadsheet, and as a page with figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure

from edge_vpr import results
from edge_vpr.files import parse_errors
from edge_vpr.results import to_json, write_json
from edge_vpr_tools.console import say, table
from edge_vpr_tools.profile.measurement import (
    Energy,
    Figures,
    NotMeasured,
    Outcome,
    Readings,
    varying_load,
)
from edge_vpr_tools.profile.profiling import (
    NOT_MEASURED,
    NOT_RESOLVED,
    PROFILE,
    VOID,
    Number,
    Profile,
    Provenance,
    numbers,
)
from edge_vpr_tools.report.page import Page, add_run, plain, quantity
from edge_vpr_tools.report.style import BLUE, ORANGE, SKY, figure, save
from edge_vpr_tools.report.tables import write_spreadsheet

# Text of a profile, with units: rows of its tables, and notes.


#: one over the marginal energy: the headline
PER_JOULE = "matches per joule"
#: Speed and memory by their names in `numbers`: names in a table, and units.
SPEED: Mapping[str, tuple[str, str]] = {
    "events_per_s": ("events per second", ""),
    "matches_per_s": ("matches per second", ""),
    "times_real_time": ("times real time", ""),
    "latency_p50_s": ("latency of a call with a match, p50", "s"),
    "latency_p99_s": ("latency of a call with a match, p99", "s"),
    "cpu_s_per_match": ("processor time per match, with its events", "s"),
    "peak_memory_bytes": ("peak memory of the process", "MiB"),
}
#: What two profiles are compared by: the headline, speed, and energy.
COMPARED: Mapping[str, tuple[str, str]] = {
    "matches_per_joule": (PER_JOULE, ""),
    **SPEED,
    "marginal_j_per_match": ("marginal energy of a match, with its events", "J"),
    "idle_w": ("power at rest", "W"),
}


def cell(of: Number) -> str:
    """Return a figure of `COMPARED` with its unit and interval, or why it is missing."""
    if of.value is None:
        return of.why
    unit = COMPARED[of.name][1]
    if unit == "MiB":
        return f"{of.value / 2**20:,.1f} MiB"
    if unit:
        return quantity(of.value, unit, of.low, of.high, digits=3 if unit == "s" else 4)
    if of.low is not None and of.high is not None:
        return f"{of.value:,.4g} ({of.low:,.4g} to {of.high:,.4g})"
    return f"{of.value:,.0f}" if of.value >= 10_000 else f"{of.value:,.1f}"


def rows(found: Profile) -> list[tuple[str, str]]:
    """Return the figures of a profile as pairs of name and value; missing ones are marked."""
    lines = [(SPEED[one.name][0], cell(one)) for one in numbers(found) if one.name in SPEED]
    # the headline first
    energy = _energy_rows(found)
    return energy[:1] + lines + energy[1:]


def _energy_rows(found: Profile) -> list[tuple[str, str]]:
    energy, rate = found.energy, f"{found.drive_events_per_s:,.0f}"
    # what a figure includes, and at which rate of events, stands beside it
    headline = f"{PER_JOULE}: what the work adds, at the drive's {rate} events/s"
    name = "marginal energy of a match, with its events"
    if found.void or energy.figures is None:
        missing = VOID if found.void else NOT_MEASURED
        return [(headline, missing), (name, missing)]
    figures = energy.figures
    idle = quantity(figures.idle_w, "W", *figures.idle_w_interval, digits=4)
    return [
        (headline, _per_joule(figures)),
        (name, _marginal(energy, figures)),
        ("power at rest", idle),
        ("power under load", quantity(figures.load_w, "W", digits=4)),
    ]


def _per_joule(figures: Figures) -> str:
    found = figures.bounded("matches_per_joule")
    if found.value is None or found.low is None or found.high is None:
        return NOT_RESOLVED
    return f"{found.value:,.4g} ({found.low:,.4g} to {found.high:,.4g})"


def _marginal(energy: Energy, figures: Figures) -> str:
    value, low, high = figures.bounded("marginal_j_per_match")
    if value is not None:
        return quantity(value, "J", low, high, digits=4)
    pairs = figures.pairs_needed
    if pairs is None:
        return NOT_RESOLVED
    minutes = pairs * 2 * energy.window_s / 60
    return f"{NOT_RESOLVED}: about {pairs} pairs ({minutes:.0f} min) would do"


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
    if readings is not None and (busy := varying_load(readings.windows)):
        notes.append(f"{busy.capitalize()}, which widens the intervals; stop other programs.")
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


# A profile on the terminal.


#: of the tables and paragraphs, in characters
WIDTH = 110


def show(found: Profile) -> None:
    """Print a profile."""
    table(("measured", ""), rows(found), title=found.run.machine.processor, width=WIDTH)
    for line in notes(found):
        say(line, width=WIDTH)


def check_shown(found: Profile, path: Path) -> None:
    """Raise `UsageError` unless all shown parts of a profile are valid."""
    with parse_errors(path, "a profile", "make it again with edge-vpr profile"):
        _ = rows(found), notes(found)
        for number in numbers(found):
            for value in number[1:4]:
                if value is not None and not math.isfinite(value):
                    raise ValueError(f"{number.name} is {value}")


# The files of a profile.


def write_profile(found: Profile, folder: Path, *, name: str = PROFILE) -> None:
    """Write a profile to a file of this name, with its spreadsheet and its report."""
    write_json(folder / name, found)
    header = ("quantity", "value", "low", "high")
    write_spreadsheet(folder / "profile.csv", header, [one[:4] for one in numbers(found)])
    write_report(found, folder)


def write_report(found: Profile, folder: Path) -> None:
    """Write ``report.html``, with figures."""
    page = Page("edge-vpr: what a match costs on this machine")
    page.text(found.run.machine.processor)
    page.table(("measured", ""), rows(found))
    for line in notes(found):
        page.text(line)
    energy = found.energy
    if energy.readings is not None and energy.figures is not None:
        page.heading("Energy")
        caption = "Power; idle and load windows are shaded."
        page.picture(save(power_trace(energy.readings), folder / "power.png"), caption)
    provenance = to_json(found.provenance)
    page.heading("Conditions of the measurement")
    page.table(
        ("condition", "value"),
        [
            (name.replace("_", " "), plain(value))
            for name, value in provenance.items()
            if name != "versions"
        ],
    )
    add_run(page, found.run)
    page.write(folder / results.REPORT)


# The figure of a profile.


def power_trace(readings: Readings) -> Figure:
    """Draw power over time, with idle and load windows shaded."""
    with figure() as (drawing, axes):
        labels = {True: "load", False: "idle"}
        for window in readings.windows:
            axes.axvspan(
                window.start_s, window.end_s, color=ORANGE if window.load else SKY, alpha=0.25,
                lw=0, label=labels.pop(window.load, None),
            )  # fmt: skip
        axes.plot(readings.trace.time_s, readings.trace.watts, color=BLUE, lw=0.8)
        axes.set(title="Power over time", xlabel="time (s)", ylabel="power (W)")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return drawing
