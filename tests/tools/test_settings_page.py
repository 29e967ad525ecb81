"""docs/settings.md is made from the settings."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from edge_vpr_tools.settings_page import page

from edge_vpr.settings import SETTING_FIELDS, Settings

PAGE = Path(__file__).parents[2] / "docs/settings.md"


def test_the_page_is_current():
    """If not: python -m edge_vpr_tools.settings_page > docs/settings.md."""
    assert PAGE.read_text(encoding="utf-8") == page() + "\n"


def test_every_setting_has_a_row_with_a_meaning():
    rows = [line for line in page().splitlines() if line.startswith("| `")]
    keys = [SETTING_FIELDS[field.name].key for field in fields(Settings)]
    assert [row.split("`")[1] for row in rows] == keys
    assert all(len(row.split("|")[-2].strip()) > 10 for row in rows)


def test_every_flag_is_its_key_as_the_page_says():
    for field in SETTING_FIELDS.values():
        assert field.flag == "--" + field.key.replace("_", "-")


def test_the_values_of_other_presets_stand_in_brackets():
    (row,) = (line for line in page().splitlines() if line.startswith("| `pixels`"))
    assert "`150` (seed-code: `100`, tiny: `25`)" in row
