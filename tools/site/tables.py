"""Put the tables of docs/results, and that of all settings, into the pages that name them.

python tools/site/tables.py. A page names a table by a line, behind which the table is put:

<!-- table: results/rivals.csv drives = Brisbane; columns = method, P@100R -->

`tools/lab/tables.py` says how rows are chosen and trials joined; a test compares the pages with
the files.
"""

from __future__ import annotations

import re
from pathlib import Path

from lab.tables import with_tables

from edge_vpr.settings import PRESETS, SETTING_FIELDS, SettingField

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = (*sorted(DOCS.glob("*.md")), *sorted(ROOT.glob("*.md")))
#: the table of settings, which the line `<!-- settings -->` names
_SETTINGS = re.compile(r"(?<=<!-- settings -->\n\n)(?:\|.*\n)*")
#: the name of a page in the text of a meaning
_PAGE = re.compile(r"(?:docs/)?(\w+\.md)")


def filled_page(text: str) -> str:
    """Return a page with the tables that it names."""
    return _SETTINGS.sub(lambda _: f"{settings_table()}\n", with_tables(text, DOCS))


def settings_table() -> str:
    """Return the table of all settings, from their descriptions, as Markdown."""
    lines = ["| key | values | default | meaning |", "| --- | --- | --- | --- |"]
    for field in SETTING_FIELDS.values():
        meaning = _PAGE.sub(r"[\1](\1)", field.meaning.replace("|", "\\|"))
        lines.append(f"| `{field.key}` | {_values(field)} | {_defaults(field)} | {meaning} |")
    return "\n".join(lines)


def _defaults(field: SettingField) -> str:
    """Return the default, with the values of other presets in brackets."""
    default = _word(field, "default")
    words = {name: _word(field, name) for name in PRESETS}
    others = [f"{name}: {word}" for name, word in words.items() if word != default]
    return default + (f" ({', '.join(others)})" if others else "")


def _word(field: SettingField, preset: str) -> str:
    return f"`{field.word(getattr(PRESETS[preset], field.name))}`"


def _values(field: SettingField) -> str:
    """Return the values that a setting takes, as text."""
    if field.choices:
        return ", ".join(f"`{choice}`" for choice in field.choices)
    if field.kind is bool and not field.words:
        return "`true`, `false`"
    words = [f"`{word}`" for word in field.words]
    return ", or ".join([field.range] * bool(field.range) + words)


def main() -> None:
    """Write the tables into all pages."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        filled = filled_page(text)
        if filled != text:
            page.write_text(filled, encoding="utf-8")


if __name__ == "__main__":
    main()
