"""Numbers in the sentences of pages are those of the model and of the files of docs/results.

Tables are compared with their files in `test_documents.py`.
"""

from __future__ import annotations

import csv
import json
import re
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from edge_vpr_tools.cli import main

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def prose():
    return " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())


def test_what_a_match_costs_is_what_estimate_says(prose, capsys):
    assert main(["estimate", "--places", "1000", "--target", "cortex-m4", "--json"]) == 0
    estimate = json.loads(capsys.readouterr().out)
    of = estimate["targets"]["cortex-m4"]
    memory = of["memory"]
    flash, ram = (memory[name] / 1024 for name in ("flash_bytes", "ram_bytes"))
    second = estimate["sizes"]["place_bytes"] * estimate["design"]["places_per_window"]
    assert f"of the first drive: {second} bytes per second of the route." in prose
    said = (
        f"On a Cortex-M4, whose firmware keeps a byte per code, a route of 1,000 places "
        f"takes **{flash:.0f} KiB of flash and {ram:.0f} KiB of RAM, and a match "
        f"{1e3 * of['load']['central']:.0f} ms and {1e3 * of['per_match_j']['central']:.1f} mJ** "
        f"at 100,000 events per second"
    )
    assert said in re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", prose)


def test_the_caption_of_brisbane_is_its_row_of_the_table(prose):
    rows = rows_of(
        "place-filter.csv", drives="Brisbane, 49 px", method="place filter, running mean (robot)"
    )
    (correct,) = means_by("drives", "P@100R", rows).values()
    (right,) = means_by("drives", "correct of accepted", rows).values()
    assert f"{correct:.3f} are correct, and no accepted match is wrong" in prose
    assert right == 1


def test_other_light_is_that_of_the_table_of_rivals(prose):
    rows = rows_of(
        "rivals.csv", drives="Brisbane, 49 pixels, half a day on sunset2", tolerance="70 m",
        matching="place filter, live",
    )  # fmt: skip
    (ours,) = (row for row in rows if row["system"].startswith("edge-vpr"))
    (theirs,) = (row for row in rows if row["system"].startswith("patch-normalised"))
    assert int(theirs["bytes per place"]) > 20 * int(ours["bytes per place"])
    assert float(ours["P@100R"]) > 0.85 > 0.6 > float(theirs["P@100R"])
    assert float(ours["accepted at 0.99"]) < 0.13
    assert (
        "In Brisbane by day, on a map of the sunset, most of the live matches are correct, but "
        "hardly any is accepted. Patch normalisation has [far fewer "
        "correct](docs/results.md#against-other-methods), and takes many times the bytes."
    ) in prose


def test_the_paper_with_windows_by_count_is_that_of_the_table(prose):
    rows = rows_of("simulated.csv")
    by_count, by_time = (
        means_by("variant", "P@100R", rows)[f"150 varying pixels, fixed {window}"]
        for window in ("N", "tau")
    )
    assert by_count > 0.89 and "lift the paper's method [nearly to ours]" in prose
    said = f"{by_count:.3f} of the streets' windows instead of {by_time:.3f}"
    assert said in sentences("results.md")


def test_the_readme_is_read_in_minutes(prose):
    """All words count, also those of code and of the table, and twelve figures of the prose."""
    shown = re.sub(r"<!--.*?-->", "", prose).split()
    assert sum(re.search(r"\w", word) is not None for word in shown) <= 900
    text = (ROOT / "README.md").read_text(encoding="utf-8").split("## Cite")[0]
    for no_prose in (
        r"(?s)<!--.*?-->",
        r"(?s)```.*?```",
        r"(?m)^\|.*$",
        r"\]\([^)]*\)",
        r"`[^`]*`",
    ):
        text = re.sub(no_prose, "]", text)
    of_names = r"ROS 2|Cortex-M4|Python 3\.11|BY-NC-SA\s4\.0"
    assert len(set(re.findall(r"\d[\d,.]*\d|\d", re.sub(of_names, "", text)))) <= 12


def rows_of(name, **only):
    """Return the rows of a file of results that have these values."""
    with (ROOT / "docs/results" / name).open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [row for row in rows if all(row[key] == value for key, value in only.items())]


def means_by(key, column, rows):
    """Return the mean of a column over the seeds, by the value of another column."""
    values = defaultdict(list)
    for row in rows:
        if row[column]:
            values[row[key]].append(float(row[column]))
    return {name: float(np.mean(each)) for name, each in values.items()}


def sentences(page):
    return " ".join((ROOT / "docs" / page).read_text(encoding="utf-8").split())


def test_sentences_of_results_are_those_of_their_files():
    text = sentences("results.md")
    at = rows_of("position.csv", position="reported")
    at = [row for row in at if row["query"] in ("as recorded", "in other light")]
    at = [row for row in at if row["pixels"] in ("49", "150")]
    middle, most = (
        means_by("drives", column, at) for column in ("median error (m)", "95 % of the errors (m)")
    )
    real, street = "Brisbane, 49 px", "streets of 600 m"
    assert f"on Brisbane is {middle[real]:.1f} m off in the median" in text
    assert f"95 % of the errors are at most {most[real]:.1f} m." in text
    assert f"the figures are {middle[street]:.1f} m and {most[street]:.1f} m" in text

    judged = {how: rows_of("calibration.csv", matching=how) for how in ("live", "smoothed")}
    of_time = [
        float(row["precision from one window after a change on"])
        for rows in judged.values() for row in rows
        if row["map"] == "all six, windows of a fixed time"
    ]  # fmt: skip
    assert "the promise holds over all six together**, on each of the five streets" in text
    assert min(of_time) >= 0.99 and len(of_time) == 10
    kinds = "whole", "a piece cut out", "a detour", "carried off twice"
    least = min(
        means_by("map", "precision", rows)[kind] for rows in judged.values() for kind in kinds
    )
    assert f"each kind of drive has {np.floor(100 * least) / 100:.2f} or more" in text
    cut = rows_of("trust.csv", map="a piece cut out", matching="smoothed")
    (indoors,) = means_by(
        "map", "precision", [row for row in cut if row["drives"] == "Speck indoor, 150 px"]
    ).values()
    assert f"{indoors:.3f} of the accepted smoothed matches are right" in text
    nulls = max(
        float(row["accepted at 0.99"])
        for rows in judged.values() for row in rows if row["map"].startswith("null")
    )  # fmt: skip
    assert f"on streets at most {nulls:.3f} of them" in text

    elsewhere = rows_of("robustness.csv", trouble="40 other streets", gains="7")
    accepted = means_by("matching", "accepted at 0.99", elsewhere)
    worst = max(
        float(row["most of a drive accepted"]) for row in elsewhere if row["matching"] == "smoothed"
    )
    assert (
        f"{accepted['live']:.4f} of the live windows are accepted, and {accepted['smoothed']:.3f} "
        "of the smoothed ones"
    ) in text
    assert f"{worst:.2f} of the smoothed windows" in text

    day = {
        row["drives"]: float(row["P@100R"])
        for row in rows_of("rivals.csv", matching="place filter, live", tolerance="70 m")
        if "half a day" in row["drives"] and row["system"].startswith("edge-vpr")
    }
    of_other = next(value for name, value in day.items() if name.endswith("sunset1"))
    (back,) = means_by("map", "P@100R", rows_of(
        "several-drives.csv", drives="Brisbane, 49 px", map="half a drive by day",
        query="at sunset", matched="live",
    )).values()  # fmt: skip
    assert f"matches {of_other:.3f} of the half day" in text and f"half day {back:.3f}." in text

    ours = {
        how: means_by("drives", "P@100R", rows_of("place-filter.csv", method=method))
        for how, method in (
            ("live", "place filter, running mean (robot)"),
            ("smoothed", "place filter, contrast, smoothed (default)"),
        )
    }
    worst = [
        max(of["street, 150 px"] - of[f"street, {kind}, 150 px"]
            for kind in ("half speed", "double speed", "thresholds x 2"))
        for of in ours.values()
    ]  # fmt: skip
    lost = f"live matches lose at most {worst[0]:.2f}, and smoothed ones {worst[1]:.2f};"
    assert lost in text and 0.45 < ours["live"]["street, triple speed, 150 px"] < 0.55

    pace = "null: constant speed from start to end"
    guess = means_by("drives", "P@100R", rows_of("place-filter.csv", method=pace))
    assert f"at most {max(guess.values()):.2f} (the walks)" in text
