"""The reference page of all settings, made from the settings themselves.

``python -m edge_vpr_tools.arguments.settings_page > docs/settings.md``
"""

from __future__ import annotations

import re

from edge_vpr.settings import PRESETS, SETTING_FIELDS, SettingField

_HEAD = """# Settings

Every setting has a key in the TOML file that `--config` reads, and a flag of `edge-vpr map` (those
of matching also of `match`): the key `filter_steps` is the flag `--filter-steps`. Both take the
same values. A flag overrides the file, and the file the preset (`--preset`, or `preset = "tiny"` in
the file). A map keeps its settings, and a query is described with the same ones.

This page is made by `python -m edge_vpr_tools.arguments.settings_page`.

```toml
preset = "default"
pixels = 100
tau = "500ms"
bursts = "keep"
filter_steps = [1, 0, 1]   # or "1,0,1", as the flag takes it
```

In Python, the attributes of `edge_vpr.Settings` have the same names, except `tau_us` (in
microseconds), `remove_hot_pixels` and `remove_bursts` (true or false). Files may use these names
too. None stands for `none` and `auto`; older files, in which 0 stands for them, are still read.

The default is that of `--preset default`; in brackets is what other presets have.
"""

#: a page that a meaning names
_PAGE = re.compile(r"(?:docs/)?(\w+\.md)")


def page() -> str:
    """Return the page as Markdown."""
    lines = [_HEAD, "| key | values | default | meaning |", "| --- | --- | --- | --- |"]
    for field in SETTING_FIELDS.values():
        meaning = _PAGE.sub(r"[\1](\1)", field.meaning.replace("|", "\\|"))
        lines.append(f"| `{field.key}` | {_values(field)} | {_defaults(field)} | {meaning} |")
    return "\n".join(lines)


def _defaults(field: SettingField) -> str:
    """Say the default, and what presets have in its place."""
    default = _word(field, "default")
    found = {name: _word(field, name) for name in PRESETS}
    others = [f"{name}: {word}" for name, word in found.items() if word != default]
    return default + (f" ({', '.join(others)})" if others else "")


def _word(field: SettingField, preset: str) -> str:
    value = getattr(PRESETS[preset], field.name)
    if field.kind is bool and not field.words:
        return f"`{str(value).lower()}`"
    return f"`{field.word(value)}`"


def _values(field: SettingField) -> str:
    """Say what values a setting takes."""
    if field.choices:
        return ", ".join(f"`{choice}`" for choice in field.choices)
    if field.kind is bool and not field.words:
        return "`true`, `false`"
    words = [f"`{word}`" for word in field.words]
    return ", or ".join([field.range] * bool(field.range) + words)


if __name__ == "__main__":
    print(page())
