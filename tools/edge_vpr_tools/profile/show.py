"""A profile as text, on the terminal, as a spreadsheet, and as a page with figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from statistics import fmean

from matplotlib.figure import Figure

from edge_vpr import results
from edge_vpr.records import parse_errors, write_json
from edge_vpr_tools.console import say, table
from edge_vpr_tools.profile.measurement import Energy
from edge_vpr_tools.profile.profiling import PROFILE, Number, Profile, numbers
from edge_vpr_tools.profile.sensors.sensor import About
from edge_vpr_tools.profile.workload import PACKET
from edge_vpr_tools.report.page import Page, add_run, quantity
from edge_vpr_tools.report.spreadsheets import write_spreadsheet
from edge_vpr_tools.report.style import BLUE, ORANGE, SKY, figure, save

# Text of a profile, with units: rows of its tables, and notes.


#: one over the marginal energy: the headline
PER_JOULE = "matches per joule"
#: What two profiles are compared by, by the names in `numbers`: names in a table, and units.
COMPARED: Mapping[str, tuple[str, str]] = {
    "matches_per_joule": (PER_JOULE, ""),
    "events_per_s": ("events per second", ""),
    "matches_per_s": ("matches per second", ""),
    "times_real_time": ("times real time", ""),
    "latency_p50_s": ("latency of a call with a match, p50", "s"),
    "latency_p99_s": ("latency of a call with a match, p99", "s"),
    "cpu_s_per_match": ("processor time per match, with its events", "s"),
    "peak_memory_bytes": ("peak memory of the process", "MiB"),
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


def rows(profile: Profile) -> list[tuple[str, str]]:
    """Return the figures of a profile as pairs of name and value; missing ones are marked."""
    cells = {one.name: cell(one) for one in numbers(profile) if one.name in COMPARED}
    (_, headline), *others = ((title, cells[name]) for name, (title, _) in COMPARED.items())
    # what the headline includes, and at which rate of events, stands beside it
    rate = f"{profile.drive_events_per_s:,.0f}"
    return [(f"{PER_JOULE}: what the work adds, at the drive's {rate} events/s", headline), *others]


def notes(profile: Profile) -> list[str]:
    """Return notes on the figures."""
    notes = []
    if profile.quick:
        notes.append("--quick: windows too short for a figure to be published.")
    if profile.void:
        notes.append(
            f"VOID: the board was throttled ({profile.conditions.void_because}). Cool it, or give "
            "it a stronger supply, and run again."
        )
    notes += [
        f"Load: {profile.recording}, in packets of {PACKET:,} events, a match each window. Time "
        "and energy of a match include the counting of its events.",
        _machine(profile),
    ]
    moments: dict[str, list[str]] = {}
    for when, conditions in profile.conditions.named().items():
        moments.setdefault(str(conditions), []).append(when)
    notes += [f"{', '.join(when).capitalize()}: {text}." for text, when in moments.items()]
    return notes + _energy_notes(profile.energy)


def _energy_notes(energy: Energy) -> list[str]:
    if energy.sensor is None and energy.windows:
        first = next(window for window in energy.windows if window.load)
        since_s = first.start_s - energy.windows[0].start_s
        when = ""
        if energy.began_unix_s is not None:
            began = datetime.fromtimestamp(energy.began_unix_s + since_s, UTC)
            when = f", which began at {began.isoformat(timespec='milliseconds')}"
        return [
            "Idle and load alternated for an external meter: `edge-vpr profile trace` adds the CSV "
            f"that it recorded meanwhile, given its time of the first load{when}."
        ]
    notes = [f"Energy is not measured. {reason}." for reason in energy.not_measured_because]
    if energy.sensor is None:
        return notes
    notes.append(_sensor(energy.sensor))
    notes += _power_notes(energy)
    if (figures := energy.figures) is not None:
        gain = energy.sensor.gain_error
        notes.append(
            f"Intervals are of 95 %, by bootstrap over {figures.pairs} pairs; the meter's gain "
            f"error{f' of up to {gain:.2%}' if gain else ', which is not known,'} comes on top."
        )
        if figures.pairs_needed is not None:
            minutes = figures.pairs_needed * 2 * figures.window_s / 60
            notes.append(
                f"About {figures.pairs_needed} pairs ({minutes:.0f} min) would resolve the energy "
                "of a match."
            )
    return notes


def _power_notes(energy: Energy) -> list[str]:
    """Return facts by which a person sees whether the power is that of the turns."""
    notes, middles = [], []
    for name, load in (("at rest", False), ("under load", True)):
        turns = [one for one in energy.windows if one.load == load]
        watts = [one.watts for one in turns if one.watts is not None]
        middle = [one.middle_watts for one in turns if one.middle_watts is not None]
        if watts and middle:
            each = ", ".join(f"{w:.3f}" for w in watts)
            notes.append(f"Power {name}, turn by turn: {each} W.")
            middles.append(f"{fmean(middle):.3f} W {name} (whole turns: {fmean(watts):.3f} W)")
    if middles:
        notes.append(
            f"In the middle half of the turns, of which the figures are: {', and '.join(middles)}."
        )
    if (readings := energy.readings) is not None:
        notes.append(
            f"{readings.samples:,} readings from {readings.lowest_w:.3f} to "
            f"{readings.highest_w:.3f} W, {readings.at_highest:,} of them the highest; at most "
            f"{readings.longest_gap_s:.3g} s apart."
        )
    matches = [window.matches for window in energy.windows if window.load]
    notes.append(f"A period under load had {min(matches):,} to {max(matches):,} matches.")
    return notes


def _sensor(sensor: About) -> str:
    step = "in steps that are not known"
    if sensor.resolution:
        step = f"in steps of {sensor.resolution:.3g} {'J' if sensor.kind == 'energy' else 'W'}"
    return (
        f"Sensor {sensor.name} ({sensor.kind}): {sensor.scope}; a reading every "
        f"{sensor.period_s:g} s, {step}; {sensor.detail}."
    )


def _machine(profile: Profile) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in profile.run.versions.items())
    return (
        f"Board {profile.board or 'not known'}, {profile.run.machine.processor}; kernel "
        f"{profile.kernel}; {versions}."
    )


# A profile on the terminal.


#: of the tables and paragraphs, in characters
WIDTH = 110


def show(profile: Profile) -> None:
    """Print a profile."""
    table(("measured", ""), rows(profile), title=profile.run.machine.processor, width=WIDTH)
    for line in notes(profile):
        say(line, width=WIDTH)


def check_shown(profile: Profile, path: Path) -> None:
    """Raise `UsageError` unless all shown parts of a profile are valid."""
    with parse_errors(path, "a profile", "make it again with edge-vpr profile"):
        _ = rows(profile), notes(profile)
        for number in numbers(profile):
            for value in number[1:4]:
                if value is not None and not math.isfinite(value):
                    raise ValueError(f"{number.name} is {value}")


# The files of a profile.


def write_profile(profile: Profile, folder: Path, *, name: str = PROFILE) -> None:
    """Write a profile to a file of this name, with its spreadsheet and its report."""
    write_json(folder / name, profile)
    header = ("quantity", "value", "low", "high")
    write_spreadsheet(folder / "profile.csv", header, [one[:4] for one in numbers(profile)])
    write_report(profile, folder)


def write_report(profile: Profile, folder: Path) -> None:
    """Write ``report.html``, with figures."""
    page = Page("edge-vpr: what a match costs on this machine")
    page.text(profile.run.machine.processor)
    page.table(("measured", ""), rows(profile))
    for line in notes(profile):
        page.text(line)
    if profile.energy.trace is not None and profile.energy.figures is not None:
        page.heading("Energy")
        caption = "Power; idle and load windows are shaded."
        page.picture(save(power_trace(profile.energy), folder / "power.png"), caption)
    add_run(page, profile.run)
    page.write(folder / results.REPORT)


# The figure of a profile.


def power_trace(energy: Energy) -> Figure:
    """Draw power over time, with idle and load windows shaded."""
    assert energy.trace is not None
    with figure() as (drawing, axes):
        labels = {True: "load", False: "idle"}
        for window in energy.windows:
            axes.axvspan(
                window.start_s, window.end_s, color=ORANGE if window.load else SKY, alpha=0.25,
                lw=0, label=labels.pop(window.load, None),
            )  # fmt: skip
        axes.plot(energy.trace.time_s, energy.trace.watts, color=BLUE, lw=0.8)
        axes.set(title="Power over time", xlabel="time (s)", ylabel="power (W)")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return drawing
