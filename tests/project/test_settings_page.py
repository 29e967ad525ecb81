"""docs/settings.md is made from the settings."""

from __future__ import annotations

import runpy
from dataclasses import fields
from pathlib import Path

from edge_vpr.settings import SETTING_FIELDS, Settings

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/settings.md"
made = runpy.run_path(str(ROOT / "tools/site/settings_page.py"))


def test_the_page_is_current():
    """If not: python tools/site/settings_page.py."""
    text = PAGE.read_text(encoding="utf-8")
    assert made["table"]() in text
    assert made["with_table"](text) == text


def test_every_setting_has_a_row_with_a_meaning():
    rows = [line for line in made["table"]().splitlines() if line.startswith("| `")]
    keys = [SETTING_FIELDS[field.name].key for field in fields(Settings)]
    assert [row.split("`")[1] for row in rows] == keys


def test_every_flag_is_its_key_as_the_page_says():
    for field in SETTING_FIELDS.values():
        assert field.flag == "--" + field.key.replace("_", "-")
