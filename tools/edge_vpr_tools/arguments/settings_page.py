"""The reference page of all settings, made from the settings themselves and their flags.

``python -m edge_vpr_tools.arguments.settings_page > docs/settings.md``
"""

from __future__ import annotations

import argparse
import re
from dataclasses import fields

from edge_vpr.settings import PRESETS, Settings
from edge_vpr_tools.arguments.setting_flags import add_map_flags

#: settings whose flag has another name
FLAGS = {"tau_us": "--tau", "remove_hot_pixels": "--hot-pixels", "remove_bursts": "--bursts"}

_HEAD = """# Settings

Every setting has a flag of `edge-vpr map` (those of matching also of `match`) and a key of the TOML
file that `--config` reads. Flags go over the file, the file over the preset (`--preset`, or
`preset = "tiny"` in the file). A map keeps its settings; a query is described with the same.

This page is made by `python -m edge_vpr_tools.arguments.settings_page`.

```toml
preset = "default"
pixels = 100
tau_us = 500000      # 500 ms; the flag takes --tau 500ms
filter_steps = [1, 0, 1]
```
"""


def page() -> str:
    """Return the page as Markdown."""
    names = [field.name for field in fields(Settings)]
    presets = [name for name in PRESETS if name != "default"]
    lines = [_HEAD, f"| key | flag | default | {' | '.join(presets)} | meaning |"]
    lines.append("| --- " * (4 + len(presets)) + "|")
    meanings, flags = _meanings(), _flags()
    for name in names:
        default = _shown(PRESETS["default"], name)
        others = (_shown(PRESETS[preset], name) for preset in presets)
        cells = ["" if other == default else other for other in others]
        flag = f"`{flags[name]}`" if name in flags else ""
        lines.append(f"| `{name}` | {flag} | {default} | {' | '.join(cells)} | {meanings[name]} |")
    lines.append("\nA preset's column is empty where it has the default.")
    return "\n".join(lines)


def _shown(settings: Settings, name: str) -> str:
    value = getattr(settings, name)
    return "" if value is None else f"`{list(value) if isinstance(value, tuple) else value}`"


def _flags() -> dict[str, str]:
    """Name the flag of each setting that has one."""
    parser = argparse.ArgumentParser()
    add_map_flags(parser)
    known = {option for action in parser._actions for option in action.option_strings}
    found = {}
    for field in fields(Settings):
        flag = FLAGS.get(field.name, "--" + field.name.replace("_", "-"))
        if flag in known:
            found[field.name] = flag
    return found


def _meanings() -> dict[str, str]:
    """Read what the docstring of `Settings` says of each attribute, in one line."""
    text = (Settings.__doc__ or "").partition("----------\n")[2]
    found: dict[str, str] = {}
    for names, body in re.findall(
        r"^    (\w[\w, ]*) : [^\n]*\n((?:        [^\n]*\n|\n)+)", text, re.M
    ):
        meaning = " ".join(body.split()).replace("|", "\\|")
        found |= dict.fromkeys((name.strip() for name in names.split(",")), meaning)
    return found


if __name__ == "__main__":
    print(page())
