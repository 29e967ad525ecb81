"""How a profile is shown: one table, a report with figures, and a file for a spreadsheet."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from edge_vpr.archive import replacing
from edge_vpr_tools import results
from edge_vpr_tools.power.profiling import load
from edge_vpr_tools.report.page import Page
from edge_vpr_tools.report.style import BLUE, GREEN, ORANGE, figure, save

NOT_MEASURED, NOT_RESOLVED = "not measured", "not resolved"


def rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Tell what a profile says, as name and value; what was not measured says so."""
    speed, energy = found["throughput"], found["energy"]
    told = [
        ("events a second", f"{speed['events_per_s']:,.0f}"),
        ("matches a second", f"{speed['matches_per_s']:,.1f}"),
        ("times real time", f"{speed['times_real_time']:,.1f}"),
        ("latency of a call with a match, p50", f"{speed['latency_p50_s'] * 1e6:,.1f} us"),
        ("latency of a call with a match, p99", f"{speed['latency_p99_s'] * 1e6:,.1f} us"),
        ("processor time a match", f"{speed['cpu_s_per_match'] * 1e6:,.1f} us"),
        ("peak memory of the process", f"{speed['peak_memory_bytes'] / 2**20:,.1f} MiB"),
    ]
    against = found.get("sparse_against_all")
    if against:
        told.append(
            (f"{against['sparse_pixels']:,} against {against['all_pixels']:,} pixels",
             f"{against['sparse_us_per_match']:,.1f} against {against['all_us_per_match']:,.1f} us "
             f"a match, {against['times_faster']:,.1f} times")
        )  # fmt: skip
    return told + _energy_rows(energy)


def _energy_rows(energy: dict[str, Any]) -> list[tuple[str, str]]:
    names = ("marginal energy of a match", "whole board, saturated", "whole board at the mission")
    if not energy.get("measured"):
        return [(name, NOT_MEASURED) for name in names]
    marginal = NOT_RESOLVED
    if energy["pairs_needed"] is not None:
        marginal += f": about {energy['pairs_needed']} pairs would do"
    if energy["resolved"]:
        marginal = _joules(energy, "marginal_j_per_match")
    rate = energy["mission_matches_per_s"]
    told = [
        (names[0], marginal),
        (names[1], _joules(energy, "saturated_j_per_match")),
        (f"{names[2]}'s {rate:g} matches a second", _joules(energy, "mission_j_per_match")),
        ("power at rest", f"{energy['idle_w']:.4g} W"),
    ]
    if energy["resolved"]:
        told.append(("matches a joule (marginal)", f"{energy['matches_per_joule']:,.4g}"))
    return told


def notes(found: dict[str, Any]) -> list[str]:
    """Tell what has to be said beside the figures."""
    energy, conditions = found["energy"], found["conditions"]
    said = []
    if found["quick"]:
        said.append("--quick: windows too short for a figure to be published.")
    if conditions["void_because"]:
        said.append(f"VOID: the board was throttled ({conditions['void_because']}).")
    for when in ("before", "after"):
        state = conditions[when]
        known = ", ".join(
            f"{name.replace('_', ' ')} {'not known' if value is None else value}"
            for name, value in state.items()
        )
        said.append(f"{when.capitalize()}: {known}.")
    if not energy.get("measured"):
        said.append("Energy is not measured: " + "; ".join(energy["not_measured_because"]) + ".")
        if energy.get("windows"):
            said.append("Turns were taken: `edge-vpr profile trace` adds a meter's CSV.")
        return said
    sensor = energy["sensor"]
    said.append(
        f"Sensor {sensor['name']}: {sensor['scope']}; a reading every {sensor['period_s']:g} s, "
        f"gain error {sensor['gain_error']:.2%}; {sensor['detail']}."
    )
    low, high = energy["marginal_j_per_match_interval_with_gain"]
    said.append(
        f"Intervals are of 95 %, by bootstrap over {energy['pairs']} pairs; with the meter's gain "
        f"error the marginal energy is {low:.4g} to {high:.4g} J."
    )
    if "sampler_cpu_share" in energy:
        said.append(f"Sampling took {energy['sampler_cpu_share']:.2%} of a core, idle or not.")
    if energy["resolved"]:
        share = energy["idle_w"] / energy["mission_matches_per_s"] / energy["mission_j_per_match"]
        said.append(f"At the mission's rate, {share:.1%} of the energy is the board at rest.")
    return said


def table(found: dict[str, Any]) -> None:
    """Print a profile."""
    console = _console()
    shown = Table(title=found["run"]["machine"]["processor"])
    shown.add_column("measured")
    shown.add_column("", justify="right")
    for row in rows(found):
        shown.add_row(*row)
    console.print(shown)
    for line in notes(found):
        console.print(line, highlight=False, markup=False)


def compare(first: Path, second: Path) -> None:
    """Print two profiles side by side, with the ratio where both have a number.

    Raises
    ------
    UsageError
        If one cannot be read.
    """
    a, b = load(first), load(second)
    shown = Table()
    for i, title in enumerate(("", str(first), str(second), "times")):
        shown.add_column(title, justify="left" if i == 0 else "right")
    for name in dict.fromkeys([*flat(a), *flat(b)]):
        left, right = flat(a).get(name), flat(b).get(name)
        ratio = f"{right / left:.3g}" if left and right is not None else "-"
        shown.add_row(name, _cell(left), _cell(right), ratio)
    _console().print(shown)
    for path, found in ((first, a), (second, b)):
        for line in notes(found):
            _console().print(f"{path}: {line}", highlight=False, markup=False)


def flat(found: dict[str, Any]) -> dict[str, float | None]:
    """Gather the numbers of a profile by name; None is not measured or not resolved."""
    energy = found["energy"]
    names = ("marginal_j_per_match", "saturated_j_per_match", "mission_j_per_match",
             "matches_per_joule", "idle_w")  # fmt: skip
    return {
        **found["throughput"],
        **(found.get("sparse_against_all") or {}),
        **{name: energy.get(name) for name in names},
    }


def write_csv(found: dict[str, Any], path: Path) -> None:
    """Write the numbers for a spreadsheet; an empty cell was not measured."""
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["quantity", "value", "low", "high"])
        for name, value in flat(found).items():
            low, high = found["energy"].get(f"{name}_interval") or ("", "")
            if value is None:
                low = high = ""
            writer.writerow([name, "" if value is None else value, low, high])


def write_report(found: dict[str, Any], folder: Path) -> None:
    """Write ``report.html``, with figures where energy was measured."""
    page = Page("edge-vpr: what a match costs on this machine")
    page.text(found["run"]["machine"]["processor"])
    page.table(("measured", ""), rows(found))
    for line in notes(found):
        page.text(line)
    if found["energy"].get("measured"):
        for name, drawing, caption in (
            ("power.png", power_trace(found["energy"]), "Power; load windows are shaded."),
            ("pairs.png", differences(found["energy"]), "Load less idle of each pair."),
            ("rate.png", against_rate(found["energy"]),
             "Energy of a match against the match rate: at low rates the board at rest is all."),
        ):  # fmt: skip
            save(drawing, folder / name)
            page.picture(folder / name, caption)
    page.heading("Where and how")
    page.verbatim(json.dumps(found["run"], indent=2))
    page.write(folder / results.REPORT)


def power_trace(energy: dict[str, Any]) -> Figure:
    """Draw power over time, load windows shaded."""
    with figure() as (drawing, axes):
        for window in energy["windows"]:
            if window["load"]:
                axes.axvspan(window["start_s"], window["end_s"], color=ORANGE, alpha=0.25, lw=0)
        axes.plot(energy["trace"]["time_s"], energy["trace"]["watts"], color=BLUE, lw=0.8)
        axes.set(title="Power; shaded: load", xlabel="time (s)", ylabel="power (W)")
    return drawing


def differences(energy: dict[str, Any]) -> Figure:
    """Draw the difference of each pair."""
    with figure(7.5, 3.6) as (drawing, axes):
        values = energy["differences_w"]
        axes.plot(np.arange(1, len(values) + 1), values, "o", color=BLUE)
        axes.axhline(float(np.median(values)), color=ORANGE, label="median")
        axes.axhline(0.0, color="black", lw=0.8)
        axes.set(title="Load less idle, pair by pair", xlabel="pair", ylabel="power (W)")
        axes.legend()
    return drawing


def against_rate(energy: dict[str, Any]) -> Figure:
    """Draw joules a match against matches a second."""
    with figure() as (drawing, axes):
        rates = np.logspace(-1, 4, 200)
        marginal = energy["marginal_j_per_match"]
        rest = energy["idle_w"] / rates
        axes.loglog(rates, rest + (marginal or 0.0), color=BLUE, label="whole board")
        if marginal is not None:
            axes.axhline(marginal, color=GREEN, ls="--", label="marginal")
        axes.set(
            title="Energy of a match against the match rate",
            xlabel="matches a second",
            ylabel="energy of a match (J)",
        )
        axes.legend()
    return drawing


def _joules(energy: dict[str, Any], name: str) -> str:
    low, high = energy[f"{name}_interval"]
    return f"{energy[name]:.4g} ({low:.4g} to {high:.4g}) J"


def _cell(value: float | None) -> str:
    return NOT_MEASURED if value is None else f"{value:,.6g}"


def _console() -> Console:
    return Console() if Console().is_terminal else Console(width=110)
