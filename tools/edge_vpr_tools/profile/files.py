"""Files of a profile: JSON, a spreadsheet, and a report with figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from edge_vpr import results
from edge_vpr.results import to_json, write_json
from edge_vpr_tools.profile.measurement import Energy, Figures, Readings
from edge_vpr_tools.profile.record import PROFILE, Profile, numbers
from edge_vpr_tools.profile.show import DESIGNS, designs, notes, rows
from edge_vpr_tools.profile.workload import DesignResult
from edge_vpr_tools.report.page import Page, add_run, plain
from edge_vpr_tools.report.style import (
    BLUE,
    CYCLE,
    GREEN,
    ORANGE,
    SKY,
    figure,
    name_label,
    quantity_axis,
    save,
)
from edge_vpr_tools.report.tables import write_spreadsheet


def write_profile(found: Profile, folder: Path, *, report: bool, name: str = PROFILE) -> None:
    """Write a profile with its spreadsheet, and optionally the report.

    Parameters
    ----------
    report : bool
        Also write the report with figures.
    name : str
        Name of the JSON file.
    """
    write_json(folder / name, found)
    header = ("quantity", "value", "low", "high")
    write_spreadsheet(folder / "profile.csv", header, [one[:4] for one in numbers(found)])
    if report:
        write_report(found, folder)


def write_report(found: Profile, folder: Path) -> None:
    """Write ``report.html``, with figures."""
    page = Page("edge-vpr: what a match costs on this machine")
    page.text(found.run.machine.processor)
    page.table(("measured", ""), rows(found))
    for line in notes(found):
        page.text(line)
    if found.designs:
        page.heading("Accuracy and cost of designs")
        page.table(DESIGNS, designs(found))
        caption = "Share of correct matches of each design against what a match of it took here."
        page.picture(save(accuracy(found.designs), folder / "accuracy.png"), caption)
    energy = found.energy
    if isinstance(energy, Energy) and energy.readings is not None and energy.figures is not None:
        page.heading("Energy")
        readings, of_match = energy.readings, energy.figures
        caption = "Power; idle and load windows are shaded."
        page.picture(save(power_trace(readings), folder / "power.png"), caption)
        caption = "Load less idle of each pair."
        page.picture(save(differences(readings), folder / "pairs.png"), caption)
        caption = "Energy of a match against the match rate: at low rates the board at rest is all."
        page.picture(save(against_rate(energy, of_match), folder / "rate.png"), caption)
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
    add_run(page, to_json(found.run))
    page.write(folder / results.REPORT)


# Figures of a profile.


_MARKERS = "os^vDPX"


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


def differences(readings: Readings) -> Figure:
    """Draw the difference of each pair."""
    with figure(7.5, 3.6) as (drawing, axes):
        values = readings.differences_w
        axes.plot(np.arange(1, len(values) + 1), values, "o", color=BLUE, label="pair")
        axes.axhline(float(np.median(values)), color=ORANGE, label="median")
        axes.axhline(0.0, color="black", lw=0.8)
        axes.set(title="Load less idle, pair by pair", xlabel="pair", ylabel="power (W)")
        axes.set_xticks(range(1, len(values) + 1))
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return drawing


def against_rate(energy: Energy, figures: Figures) -> Figure:
    """Draw joules per match against matches per second, up to the highest rate of this machine."""
    with figure() as (drawing, axes):
        fastest = energy.saturated_matches_per_s
        rates = np.geomspace(min(0.1, fastest / 10), fastest, 200)
        marginal = figures.marginal_j_per_match
        axes.loglog(
            rates, figures.idle_w / rates + (marginal or 0.0), color=BLUE, label="whole board"
        )
        axes.plot(fastest, figures.saturated_j_per_match, "o", color=BLUE, label="saturated")
        rate = energy.mission_matches_per_s
        axes.plot(rate, figures.mission_j_per_match, "s", color=ORANGE, label="mission")
        if marginal is not None:
            axes.axhline(marginal, color=GREEN, ls="--", label="marginal")
        axes.set(
            title="Energy of a match against the match rate",
            xlabel="matches per second",
            ylabel="energy of a match",
        )
        quantity_axis(axes.yaxis, "J")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return drawing


def accuracy(designs: Sequence[DesignResult]) -> Figure:
    """Draw the accuracy of each design against the measured cost of its match.

    The cost is in joules if they were measured and resolved, else in processor time.
    """
    measured = [(one, _joules(one)) for one in designs]
    joules = [(one, found) for one, found in measured if found is not None]
    shown = joules or [(one, _seconds(one)) for one in designs]
    with figure(8.5, 4.8) as (drawing, axes):
        for i, (one, (value, low, high)) in enumerate(shown):
            axes.errorbar(
                value, one.precision_at_100_recall,
                xerr=[[max(value - low, 0.0)], [max(high - value, 0.0)]],
                fmt=_MARKERS[i % len(_MARKERS)], color=CYCLE[i % len(CYCLE)], capsize=3,
                label=name_label(one.name),
            )  # fmt: skip
        quantity_axis(axes.xaxis, "J" if joules else "s")
        axes.margins(x=0.15)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        axes.set_ylim(0.0, 1.08)
        axes.set(
            title="Accuracy against " + ("energy" if joules else "processor time: no joules"),
            xlabel="marginal energy of a match and its events, measured"
            if joules
            else "processor time of a match and its events, measured; energy was not",
            ylabel="P@100R",
        )
    return drawing


def _joules(one: DesignResult) -> tuple[float, float, float] | None:
    """Return the marginal energy of a match and its interval; None if it is not resolved."""
    figures = one.energy.figures if isinstance(one.energy, Energy) else None
    if figures is None or figures.marginal_j_per_match is None:
        return None
    return (figures.marginal_j_per_match, *figures.marginal_j_per_match_interval)


def _seconds(one: DesignResult) -> tuple[float, float, float]:
    return (one.cpu_s_per_match, *one.cpu_s_per_match_interval)
