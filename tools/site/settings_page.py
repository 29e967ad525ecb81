"""The table of all settings on their page, made from their descriptions.

``python tools/site/settings_page.py`` puts it into docs/settings.md, behind its marker.
"""

from __future__ import annotations

import re
from pathlib import Path

from edge_vpr.settings import PRESETS, SETTING_FIELDS, SettingField

#: the name of a page in the text of a meaning
_PAGE = re.compile(r"(?:docs/)?(\w+\.md)")


PAGE = Path(__file__).parents[2] / "docs/settings.md"
_TABLE = re.compile(r"(?<=<!-- settings -->\n\n)(?:\|.*\n)*")


def with_table(text: str) -> str:
    """Return a page with the table of settings behind its marker."""
    return _TABLE.sub(lambda _: f"{table()}\n", text)


def table() -> str:
    """Return the table as Markdown."""
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


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
