"""Named presets, and the settings that result from a preset, a TOML file and flags."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from edge_vpr.errors import UsageError
from edge_vpr.plain_values import read_toml
from edge_vpr.settings.fields import shown
from edge_vpr.settings.settings import Settings, values_by_name

_BEST = Settings(
    matching="filter", smooth=True, counter_code="log", counter_scaling="own-mean", anchor="end",
)  # fmt: skip

PRESETS: Mapping[str, Settings] = {
    # chosen on the real drives and on simulated streets, see docs/place_filter.md
    "default": _BEST,
    # windows of a fixed time, counts and sequences, as in the paper
    "paper": Settings(score="distance"),
    # the settings of the code that the authors released: saliency by mean, no two pixels within
    # 7 px, counts clipped at 10, L = 10, 100 pixels, no cleaning
    "seed-code": Settings(
        pixels=100,
        strategy="seed-code",
        clip=10,
        remove_hot_pixels=False,
        remove_bursts=False,
        sequence_length=10,
        exclusion=2,  # the released code excludes |k - best| < 3
        score="distance",
    ),
    "tiny": replace(_BEST, pixels=25),
}


def resolve_settings(
    preset: str = "default",
    config: str | Path | None = None,
    flags: Mapping[str, Any] | None = None,
) -> Settings:
    """Combine a preset, a TOML file and flags; a flag overrides the file, the file the preset.

    Parameters
    ----------
    preset : {"default", "paper", "seed-code", "tiny"}
    config : path, optional
        TOML file with settings as `values_by_name` reads them. It may have a key ``preset``, which
        overrides the parameter.
    flags : mapping, optional
        Single settings by the keys of the file; None means not given.

    Raises
    ------
    UsageError
        If the file cannot be read, or a name or value is wrong.
    """
    values: dict[str, Any] = {}
    if config is not None:
        values = read_toml(config, "settings", "name a TOML file")
        preset = values.pop("preset", preset)
    if not isinstance(preset, str) or preset not in PRESETS:
        raise UsageError(f"preset {shown(preset)} is unknown: choose from {', '.join(PRESETS)}")
    values = values_by_name(values, str(config))
    given = {name: value for name, value in (flags or {}).items() if value is not None}
    given = values_by_name(given, "the command line")
    for chosen in (values, given):
        # own-mean codes, which some presets have, exist for logarithms only
        if chosen.get("counter_code", "log") != "log" or chosen.get("clip"):
            chosen.setdefault("counter_scaling", "shared")
            if chosen.get("clip"):
                chosen.setdefault("counter_code", "none")
    return PRESETS[preset].replaced(values, str(config)).replaced(given, "the command line")
