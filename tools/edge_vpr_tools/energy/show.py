"""How a profile is shown: one table, a report with figures, and files for a spreadsheet."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from edge_vpr.archive import replacing
from edge_vpr.plain_values import understood
from edge_vpr_tools.energy import figures
from edge_vpr_tools.energy.conditions import Conditions
from edge_vpr_tools.energy.profile_values import NOT_MEASURED, NOT_RESOLVED, VOID, Number, numbers
from edge_vpr_tools.energy.profiling import load
from edge_vpr_tools.output import results
from edge_vpr_tools.report.page import Page
from edge_vpr_tools.report.quantities import quantity
from edge_vpr_tools.report.style import save

_DESIGNS = ("design", "P@100R", "bytes a place", "processor time a match", "marginal energy")


def rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Tell what a profile says, as name and value; what was not measured says so."""
    speed = found["throughput"]
    told = [
        ("events a second", f"{speed['events_per_s']:,.0f}"),
        ("matches a second", f"{speed['matches_per_s']:,.1f}"),
        ("times real time", f"{speed['times_real_time']:,.1f}"),
        ("latency of a call with a match, p50", quantity(speed["latency_p50_s"], "s")),
        ("latency of a call with a match, p99", quantity(speed["latency_p99_s"], "s")),
        ("processor time a match, with its events", quantity(speed["cpu_s_per_match"], "s")),
        ("peak memory of the process", f"{speed['peak_memory_bytes'] / 2**20:,.1f} MiB"),
    ]
    for name, against in found["sparse_against_all"].items():
        what = f"{name.partition('_')[0]}, {against['sparse_pixels']:,} against "
        what += f"{against['all_pixels']:,} pixels"
        if against["places"]:
            what += f", {against['places']:,} places"
        if name.endswith("_paper"):
            what += ", made up"
        few, every, times = (against[key] for key in ("sparse_s", "all_s", "times"))
        told.append(
            (what, f"{quantity(few['value'], 's')} against {quantity(every['value'], 's')} "
                   f"{against['unit']}: {_three(times)} times")
        )  # fmt: skip
    return told + _energy_rows(found["energy"], bool(found["conditions"]["void_because"]))


def _energy_rows(energy: dict[str, Any], void: bool) -> list[tuple[str, str]]:
    names = (
        "marginal energy of a match, with its events",
        "energy of a match, whole board, saturated",
        "energy of a match, whole board, at the mission",
    )
    if void or not energy.get("measured"):
        return [(name, VOID if void else NOT_MEASURED) for name in names]
    rate, (low, high) = energy["mission_matches_per_s"], energy["idle_w_interval"]
    told = [
        (names[0], _marginal(energy)),
        (names[1], _joules(energy, "saturated_j_per_match")),
        (f"{names[2]}'s {rate:g} matches a second", _joules(energy, "mission_j_per_match")),
        ("power at rest", quantity(energy["idle_w"], "W", low, high, digits=4)),
    ]
    if energy["resolved"]:
        low, high = energy["matches_per_joule_interval"]
        told.append(
            ("matches a joule (marginal)",
             f"{energy['matches_per_joule']:,.4g} ({low:,.4g} to {high:,.4g})")
        )  # fmt: skip
    return told


def _marginal(energy: dict[str, Any]) -> str:
    if energy["resolved"]:
        return _joules(energy, "marginal_j_per_match")
    pairs = energy["pairs_needed"]
    if pairs is None:
        return NOT_RESOLVED
    minutes = pairs * 2 * energy["window_s"] / 60
    return f"{NOT_RESOLVED}: about {pairs} pairs ({minutes:.0f} min) would do"


def designs(found: dict[str, Any]) -> list[list[str]]:
    """Tell how right each design is, and what a match of it takes, as rows of `_DESIGNS`."""
    void = bool(found["conditions"]["void_because"])
    told = []
    for one in found["designs"]:
        energy, (low, high) = one["energy"], one["cpu_s_per_match_interval"]
        joules = NOT_MEASURED
        if void:
            joules = VOID
        elif energy is not None and "not_measured_because" not in energy:
            joules = _marginal(energy)
        told.append(
            [one["name"], f"{one['precision_at_100_recall']:.3f}", f"{one['bytes_per_place']:,}",
             quantity(one["cpu_s_per_match"], "s", low, high), joules]
        )  # fmt: skip
    return told


def notes(found: dict[str, Any]) -> list[str]:
    """Tell what has to be said beside the figures."""
    energy, conditions = found["energy"], found["conditions"]
    said = []
    if found["quick"]:
        said.append("--quick: windows too short for a figure to be published.")
    if conditions["void_because"]:
        said.append(
            f"VOID: the board was throttled ({conditions['void_because']}). Cool it, or give it a "
            "stronger supply, and run again."
        )
    if found["designs"]:
        places = sorted({one["places"] for one in found["designs"]})
        span = " to ".join(map(str, dict.fromkeys((places[0], places[-1]))))
        said.append(
            f"P@100R of {found['load']['recording']}, among {span} places; it says nothing of "
            "other drives."
        )
    speed, of = found["throughput"], found["load"]
    said += [
        f"Load: {of['recording']}, in packets of {of['packet']:,} events, a match --every "
        f"{of['every']}. A match is told with the counting of its "
        f"{speed['events_per_s'] / speed['matches_per_s']:,.0f} events, in time and in energy.",
        _provenance(found["provenance"]),
    ]
    for when in ("before", "loaded", "after"):
        said.append(f"{when.capitalize()}: {Conditions(**conditions[when])}.")
    if not energy.get("measured"):
        said += [f"Energy is not measured. {reason}." for reason in energy["not_measured_because"]]
        if energy.get("windows"):
            said.append("Turns were taken: `edge-vpr profile trace` adds a meter's CSV.")
        return said
    sensor = energy["sensor"]
    step = "step not known"
    if sensor["resolution"]:
        step = f"steps of {sensor['resolution']:.3g} {'J' if sensor['kind'] == 'energy' else 'W'}"
    said.append(
        f"Sensor {sensor['name']} ({sensor['kind']}): {sensor['scope']}; a reading every "
        f"{sensor['period_s']:g} s, {step}; {sensor['detail']}."
    )
    if conditions["void_because"]:
        return said
    with_gain = "the meter's gain error is not known, and not in them"
    if sensor["gain_error"]:
        bounds = energy["marginal_j_per_match_interval_with_gain"]
        low, high = (quantity(bound, "J", digits=4) for bound in bounds)
        with_gain = (
            f"with the meter's gain error of {sensor['gain_error']:.2%} the marginal energy is "
            f"{low} to {high}"
        )
    said.append(f"Intervals are of 95 %, by bootstrap over {energy['pairs']} pairs; {with_gain}.")
    if "sampler_cpu_share" in energy:
        said.append(f"Sampling took {energy['sampler_cpu_share']:.2%} of a core, idle or not.")
    if energy["resolved"]:
        share = energy["idle_w"] / energy["mission_matches_per_s"] / energy["mission_j_per_match"]
        said.append(f"At the mission's rate, {share:.2%} of the energy is the board at rest.")
    return said


def _provenance(of: dict[str, Any]) -> str:
    def told(name: str, form: str = "{}") -> str:
        return "not known" if of[name] is None else form.format(of[name])

    clock = None if of["clock_hz"] is None else f"{of['clock_hz'] / 1e6:,.0f} MHz"
    versions = ", ".join(f"{name} {version}" for name, version in of["versions"].items())
    return (
        f"Board {told('board')}, {of['processor']}; kernel {of['kernel']}; clock "
        f"{clock or 'not known'}; sensor {of['sensor'] or 'none'}; shunt "
        f"{told('shunt_mohm', '{:g} mOhm')}; {versions}."
    )


def table(found: dict[str, Any]) -> None:
    """Print a profile."""
    console = _console()
    console.print(_table(("measured", ""), rows(found), found["run"]["machine"]["processor"]))
    if found["designs"]:
        console.print(_table(_DESIGNS, designs(found)))
    for line in notes(found):
        console.print(line, highlight=False, markup=False)


def compare(first: Path, second: Path, spreadsheet: Path | None = None) -> None:
    """Print two profiles side by side, with the ratio where both have a number.

    Raises
    ------
    UsageError
        If one cannot be read.
    """
    found, sides = [], []
    for path in (first, second):
        found.append(load(path))
        check_shown(found[-1], path)
        sides.append({number.name: number for number in numbers(found[-1])})
    told, cells = [], []
    for name in dict.fromkeys(name for side in sides for name in side):
        a, b = (side.get(name, Number(name, None, why=NOT_MEASURED)) for side in sides)
        ratio = b.value / a.value if a.value and b.value is not None else None
        cells.append((name, a.value, b.value, ratio))
        told.append((name, _cell(a), _cell(b), "-" if ratio is None else f"{ratio:.3g}"))
    _console().print(_table(("", str(first), str(second), "times"), told))
    for path, one in zip((first, second), found, strict=True):
        for line in notes(one):
            _console().print(f"{path}: {line}", highlight=False, markup=False)
    if spreadsheet is not None:
        _write(spreadsheet, ("quantity", str(first), str(second), "times"), cells)


def check_shown(found: dict[str, Any], path: Path) -> None:
    """Raise `UsageError` unless all that is shown of a profile can be shown."""
    with understood(path, "a profile", "make it again with edge-vpr profile"):
        said = [*rows(found), *designs(found), *notes(found), found["run"]["machine"]["processor"]]
        for number in numbers(found):
            for value in number[1:4]:
                if value is not None and not math.isfinite(value):
                    raise ValueError(f"{number.name} is {value}")
        json.dumps([*said, found["provenance"]])


def write_csv(found: dict[str, Any], path: Path) -> None:
    """Write the numbers for a spreadsheet; an empty cell was not measured."""
    _write(path, ("quantity", "value", "low", "high"), [n[:4] for n in numbers(found)])


def _write(path: Path, header: Sequence[str], lines: Iterable[Sequence[Any]]) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(["" if cell is None else cell for cell in line] for line in lines)


def write_report(found: dict[str, Any], folder: Path) -> None:
    """Write ``report.html``, with figures."""
    page = Page("edge-vpr: what a match costs on this machine")
    page.text(found["run"]["machine"]["processor"])
    page.table(("measured", ""), rows(found))
    for line in notes(found):
        page.text(line)
    drawings = []
    if found["designs"]:
        page.heading("Accuracy and cost of designs")
        page.table(_DESIGNS, designs(found))
        caption = "Share of right matches of each design against what a match of it took here."
        _add(page, folder, "accuracy.png", figures.accuracy(found["designs"]), caption)
    if found["energy"].get("measured") and not found["conditions"]["void_because"]:
        page.heading("Energy")
        drawings = [
            ("power.png", figures.power_trace, "Power; idle and load windows are shaded."),
            ("pairs.png", figures.differences, "Load less idle of each pair."),
            ("rate.png", figures.against_rate,
             "Energy of a match against the match rate: at low rates the board at rest is all."),
        ]  # fmt: skip
    for name, draw, caption in drawings:
        _add(page, folder, name, draw(found["energy"]), caption)
    page.heading("Where and how")
    page.verbatim(json.dumps(found["provenance"], indent=2))
    page.verbatim(json.dumps(found["run"], indent=2))
    page.write(folder / results.REPORT)


def _add(page: Page, folder: Path, name: str, drawing: Any, caption: str) -> None:
    save(drawing, folder / name)
    page.picture(folder / name, caption)


def _table(
    header: Sequence[str], lines: Iterable[Sequence[str]], title: str | None = None
) -> Table:
    shown = Table(title=title)
    for i, name in enumerate(header):
        shown.add_column(name, justify="left" if i == 0 else "right")
    for line in lines:
        shown.add_row(*line)
    return shown


def _joules(energy: dict[str, Any], name: str) -> str:
    low, high = energy[f"{name}_interval"]
    return quantity(energy[name], "J", low, high, digits=4)


def _three(of: dict[str, float]) -> str:
    return f"{of['value']:.3g} ({of['low']:.3g} to {of['high']:.3g})"


def _cell(of: Number) -> str:
    return of.why if of.value is None else f"{of.value:,.6g}"


def _console() -> Console:
    return Console() if Console().is_terminal else Console(width=110)
