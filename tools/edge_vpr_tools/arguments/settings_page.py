"""The reference page of all settings, made from the settings themselves.

``python -m edge_vpr_tools.arguments.settings_page > docs/settings.md``
"""

from __future__ import annotations

import re

from edge_vpr.settings import PRESETS, SETTING_FIELDS, SettingField

_HEAD = """# Settings

Every setting has a flag of `edge-vpr map` (those of matching also of `match`) and a key of the TOML
file that `--config` reads: the flag without dashes, with `_` between words. Both take the same
values. A flag overrides the file, and the file the preset (`--preset`, or `preset = "tiny"` in the
file). A map keeps its settings, and a query is described with the same ones.

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
"""

#: a page that a meaning names
_PAGE = re.compile(r"(?:docs/)?(\w+\.md)")


def page() -> str:
    """Return the page as Markdown."""
    presets = [name for name in PRESETS if name != "default"]
    lines = [_HEAD, f"| key | flag | values | default | {' | '.join(presets)} | meaning |"]
    lines.append("| --- " * (5 + len(presets)) + "|")
    for field in SETTING_FIELDS.values():
        default = _word(field, "default")
        others = [_word(field, preset) for preset in presets]
        cells = [
            f"`{field.key}`",
            f"`{field.flag}`",
            _values(field),
            default,
            *("" if other == default else other for other in others),
            _PAGE.sub(r"[\1](\1)", field.meaning.replace("|", "\\|")),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    lines.append("\nA preset's column is empty where it has the default.")
    return "\n".join(lines)


def _word(field: SettingField, preset: str) -> str:
    return f"`{field.word(getattr(PRESETS[preset], field.name))}`"


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
