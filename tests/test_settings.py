"""Settings: presets, a file, flags."""

from __future__ import annotations

import argparse

import pytest
from edge_vpr_tools.arguments.setting_flags import add_map_flags, map_settings

from edge_vpr.errors import UsageError
from edge_vpr.settings import PRESETS, Settings, resolve_settings


def test_flags_lie_over_the_file_and_the_file_over_the_preset(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text('preset = "tiny"\nseed = 7\nsigma = 3\n')
    found = resolve_settings("paper", path, {"seed": 9, "sigma": None})
    assert (found.pixels, found.seed, found.sigma) == (25, 9, 3)


def test_the_presets_are_the_paper_its_code_and_a_small_one():
    assert {name: preset.pixels for name, preset in PRESETS.items()} == {
        "default": 150,
        "paper": 150,
        "seed-code": 100,
        "tiny": 25,
    }
    assert PRESETS["seed-code"].clip == 10


def test_settings_come_back_from_plain_values():
    settings = Settings(pixels=3, window="count", events_per_pixel=2.5)
    assert Settings.from_dict(settings.to_dict()) == settings
    assert settings.events_per_window == 8


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"pixel": 3}, "unknown setting 'pixel'"),
        ({"pixels": 0}, "pixels = 0: expected 1 or more"),
        ({"pixels": "many"}, "of type str: expected int"),
        ({"polarity": 1}, "of type int: expected bool"),
        ({"sigma": float("nan")}, "sigma = nan"),
        ({"strategy": "best"}, "choose from variance"),
        ({"window": "space"}, "choose from time, count"),
        ({"anchor": "start"}, "choose from middle, end"),
        ({"counter_code": "cubic"}, "choose from none, linear, sqrt, log"),
        ({"counter_scaling": "mine"}, "choose from shared, per-pixel"),
        ({"counter_code": "log", "counter_bits": 17}, "17 bits: expected 1 to 16"),
        ({"counter_bits": 0}, "counter_bits = 0: expected 1 or more"),
        ({"counter_code": "log", "counter_full_scale": 65536}, "expected 1 to 65535"),
        ({"clip": 65536}, "expected 1 to 65535"),
        ({"clip": 10, "counter_code": "log"}, "set clip to 0"),
        (
            {"counter_code": "log", "counter_scaling": "per-pixel", "counter_full_scale": 9},
            "set it to 0",
        ),
        ({"events_per_pixel": 0.001}, "windows without events"),
    ],
)
def test_a_wrong_setting_is_named_with_the_remedy(values, message):
    with pytest.raises(UsageError, match=message):
        Settings.from_dict(values)


@pytest.mark.parametrize("text", ["pixels = ", "\xff"])
def test_a_file_that_is_no_toml_is_wrong_use(tmp_path, text):
    path = tmp_path / "settings.toml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(UsageError, match="cannot read settings"):
        resolve_settings(config=path)


def test_a_missing_file_and_an_unknown_preset_are_wrong_use(tmp_path):
    with pytest.raises(UsageError, match="cannot read settings"):
        resolve_settings(config=tmp_path / "none.toml")
    with pytest.raises(UsageError, match="choose from default, paper, seed-code, tiny"):
        resolve_settings("huge")


def test_the_flags_of_a_counter_code_reach_the_settings():
    parser = argparse.ArgumentParser()
    add_map_flags(parser)
    flags = "--counter-code log --counter-bits 4 --counter-full-scale 63 --counter-scaling shared"
    found = map_settings(parser.parse_args(flags.split()))
    assert (found.counter_code, found.counter_bits) == ("log", 4)
    assert (found.counter_full_scale, found.counter_scaling) == (63, "shared")
    assert map_settings(parser.parse_args([])) == PRESETS["default"]
