"""Files of a profile: JSON, a spreadsheet, and a report with figures."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from edge_vpr import results
from edge_vpr.results import to_json, write_json
from edge_vpr_tools.profile import figures
from edge_vpr_tools.profile.measurement import Energy
from edge_vpr_tools.profile.record import PROFILE, Profile, numbers
from edge_vpr_tools.profile.show import DESIGNS, designs, notes, rows
from edge_vpr_tools.report.page import Page, add_run, plain
from edge_vpr_tools.report.style import drawn_for_page, save
from edge_vpr_tools.spreadsheets import write_spreadsheet


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
        _add(page, folder / "accuracy.png", figures.accuracy(found.designs), caption)
    energy = found.energy
    if isinstance(energy, Energy) and energy.readings is not None and energy.figures is not None:
        page.heading("Energy")
        readings, of_match = energy.readings, energy.figures
        caption = "Power; idle and load windows are shaded."
        _add(page, folder / "power.png", figures.power_trace(readings), caption)
        caption = "Load less idle of each pair."
        _add(page, folder / "pairs.png", figures.differences(readings), caption)
        caption = "Energy of a match against the match rate: at low rates the board at rest is all."
        _add(page, folder / "rate.png", figures.against_rate(energy, of_match), caption)
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


def _add(page: Page, path: Path, drawing: Figure, caption: str) -> None:
    save(drawing, path)
    page.picture(drawn_for_page(drawing), caption)
