"""The reference page of all settings, made from their descriptions.

``python tools/site/settings_page.py > docs/settings.md``
"""

from __future__ import annotations

import re

from edge_vpr.settings import PRESETS, SETTING_FIELDS, SettingField

_HEAD = """# Settings

Every setting is a key of a TOML file for `--config`, and a flag of `edge-vpr map`: `filter_restart`
is `--filter-restart`. Those of matching are flags of `match` too. Flags override the file, and the
file the preset. A map stores its settings, by which queries are described.

```toml
preset = "default"
pixels = 100
tau = "500ms"
bursts = "keep"
filter_restart = 20
```

`edge_vpr.Settings` has the same names, except `tau_us` (in microseconds), `remove_hot_pixels` and
`remove_bursts` (booleans); `none` and `auto` are None. `Settings()` has the values of `paper`, and
`PRESETS["default"]` those of `default`, with which `ReferenceMap.build` begins. Defaults of other
presets than `default` are in brackets.
"""

#: the name of a page in the text of a meaning
_PAGE = re.compile(r"(?:docs/)?(\w+\.md)")


def page() -> str:
    """Return the page as Markdown."""
    lines = [_HEAD, "| key | values | default | meaning |", "| --- | --- | --- | --- |"]
    for field in SETTING_FIELDS.values():
        meaning = _PAGE.sub(r"[\1](\1)", field.meaning.replace("|", "\\|"))
        lines.append(f"| `{field.key}` | {_values(field)} | {_defaults(field)} | {meaning} |")
    return "\n".join(lines)


def _defaults(field: SettingField) -> str:
    """Return the default, with the values of other presets in brackets."""
    default = _word(field, "default")
    found = {name: _word(field, name) for name in PRESETS}
    others = [f"{name}: {word}" for name, word in found.items() if word != default]
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
    print(page())
