"""Numbers in the sentences of the README are those of the model and of the files of docs/results.

Tables are compared with their files in `test_documents.py`; sentences of other pages have few
figures that an experiment could change.
"""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

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
    said = (
        f"A second of the route takes {second} bytes, packed. On a Cortex-M4, whose firmware keeps "
        f"a byte per code, a route of 500 s, 1,000 places, takes {flash:.0f} KiB of flash "
        f"and {ram:.0f} KiB of RAM, and a match {1e3 * of['load']['central']:.0f} ms and "
        f"{1e3 * of['per_match_j']['central']:.1f} mJ at 100,000 events per second"
    )
    assert said in re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", prose)


def test_other_light_is_that_of_the_table_of_rivals(prose):
    with (ROOT / "docs/results/rivals.csv").open(encoding="utf-8", newline="") as file:
        rows = [
            row for row in csv.DictReader(file)
            if row["drives"] == "Brisbane, 49 pixels, half a day on sunset2"
            and row["tolerance"] == "70 m" and row["matching"] == "place filter, live"
        ]  # fmt: skip
    (ours,) = (row for row in rows if row["system"].startswith("edge-vpr"))
    (theirs,) = (row for row in rows if row["system"].startswith("patch-normalised"))
    assert int(theirs["bytes per place"]) > 20 * int(ours["bytes per place"])
    assert (
        f"In Brisbane by day, on a map of the sunset, {float(ours['P@100R']):.2f} of the live "
        f"matches are correct, but hardly any is accepted. Patch normalisation finds only "
        f"{float(theirs['P@100R']):.2f}, and takes many times the bytes."
    ) in prose


def test_the_readme_is_read_in_minutes(prose):
    """All words and numbers that it shows count, also those of code and of the table."""
    shown = re.sub(r"<!--.*?-->", "", prose).split()
    assert sum(re.search(r"\w", word) is not None for word in shown) <= 900
