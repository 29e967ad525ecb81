"""Settings: presets, a file, flags."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Literal, get_args, get_type_hints

import pytest
from edge_vpr_tools.flags import add_map_flags, map_settings

from edge_vpr.errors import UsageError
from edge_vpr.live.protocols import PROTOCOLS, ProtocolName
from edge_vpr.settings import (
    PRESETS,
    SETTING_FIELDS,
    MatchingChanges,
    Preset,
    SettingChanges,
    Settings,
    resolve_settings,
)


def test_flags_lie_over_the_file_and_the_file_over_the_preset(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text('preset = "tiny"\nseed = 7\nsigma = 3\n')
    resolved = resolve_settings("paper", path, {"seed": 9, "sigma": None})
    assert (resolved.pixels, resolved.seed, resolved.sigma) == (25, 9, 3)


def test_the_presets_are_the_paper_its_code_and_a_small_one():
    pixels = {name: preset.pixels for name, preset in PRESETS.items()}
    assert pixels == {"default": 150, "paper": 150, "seed-code": 100, "tiny": 25}
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
        ({"smooth": 1}, "of type int: expected bool"),
        ({"sigma": float("nan")}, "sigma = nan"),
        ({"strategy": "best"}, "choose from variance"),
        ({"window": "space"}, "choose from time, count"),
        ({"counter_code": "cubic"}, "choose from none, linear, contrast"),
        ({"counter_code": "linear", "counter_bits": 17}, "counter_bits = 17: expected 1 to 16"),
        ({"counter_code": "contrast", "counter_bits": 9}, "= contrast: expected 1 to 8 bits"),
        ({"counter_bits": 0}, "counter_bits = 0: expected 1 to 16"),
        ({"clip": 65536}, "expected 1 to 65535"),
        ({"clip": 10, "counter_code": "contrast"}, "set clip or counter_code to none"),
        ({"events_per_pixel": 0.001}, "windows without events"),
        ({"places_per_window": 3}, "places_per_window = 3: expected 1 to 2"),
        ({"places_per_window": 2}, "sequences compare one place per window; set matching to"),
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


ALL_FLAGS = {  # a value other than the preset's, as the flag takes it
    "pixels": "7",
    "strategy": "random",
    "sigma": "2.5",
    "seed": "4",
    "window": "count",
    "tau": "250ms",
    "events_per_pixel": "auto",
    "clip": "9",
    "counter_code": "linear",
    "counter_bits": "5",
    "hot_pixels": "keep",
    "bursts": "keep",
    "matching": "sequence",
    "filter_restart": "20",
    "gains": "1",
    "sequence_length": "2",
    "exclusion": "1",
    "precision": "0.9",
    "places_per_window": "2",
}
#: flags of two words, and what stands in a file where the default is the other
SWITCHES = {"smooth": False, "stays_on_map": True}


def by_flags(*words):
    parser = argparse.ArgumentParser()
    add_map_flags(parser)
    return map_settings(parser.parse_args(list(words)))


def by_file(folder, text):
    path = folder / "settings.toml"
    path.write_text(text)
    return resolve_settings(config=path)


def test_every_setting_is_tried():
    assert {*ALL_FLAGS, *SWITCHES} == {field.key for field in SETTING_FIELDS.values()}


@pytest.mark.parametrize("key", ALL_FLAGS)
def test_a_file_takes_the_words_of_the_flag(tmp_path, key):
    word, field = ALL_FLAGS[key], next(f for f in SETTING_FIELDS.values() if f.key == key)
    in_toml = word if word.replace(".", "").isdigit() else f'"{word}"'
    settings = by_flags(f"--{key.replace('_', '-')}", word)
    assert settings != PRESETS["default"]
    assert by_file(tmp_path, f"{key} = {in_toml}\n") == settings
    assert field.word(getattr(settings, field.name)) == word


@pytest.mark.parametrize("key", SWITCHES)
def test_a_switch_is_true_in_a_file(tmp_path, key):
    on = SWITCHES[key]
    settings = by_flags(f"--{'' if on else 'no-'}{key.replace('_', '-')}")
    assert settings != PRESETS["default"]
    assert by_file(tmp_path, f"{key} = {str(on).lower()}\n") == settings


@pytest.mark.parametrize(
    ("names", "flags"),
    [
        ("tau_us = 500_000", "--tau 500ms"),
        ("remove_hot_pixels = false", "--hot-pixels keep"),
        ("remove_bursts = false", "--bursts keep"),
    ],
)
def test_a_file_takes_the_names_of_attributes_too(tmp_path, names, flags):
    assert by_file(tmp_path, names) == by_flags(*flags.split())


@pytest.mark.parametrize("name", ["clip", "events_per_pixel", "precision"])
def test_none_and_not_zero_stands_for_what_is_absent(name):
    assert getattr(Settings(**{name: None}), name) is None
    with pytest.raises(UsageError, match=f"{name} = 0: expected"):
        Settings(**{name: 0})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('tau = "1s"\ntau_us = 1', "both tau and tau_us"),
        ('tau = "soon"', "tau = 'soon': expected a time such as 1s"),
        ("tau = true", "tau_us = True is of type bool"),
        ('clip = "some"', "clip = 'some': expected a whole number or none"),
        ('bursts = "maybe"', "bursts = 'maybe': expected remove or keep"),
    ],
)
def test_a_wrong_word_in_a_file_is_named_with_those_that_are_right(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        by_file(tmp_path, text)


def test_the_events_of_a_window_are_not_known_before_the_reference():
    with pytest.raises(UsageError, match="map the reference first"):
        _ = Settings(window="count", events_per_pixel=None).events_per_window


def test_the_docstring_has_every_attribute():
    doc = Settings.__doc__
    assert all(f"    {name} : " in doc for name in SETTING_FIELDS)


def test_a_word_of_a_setting_of_words_is_read_as_what_it_means():
    assert Settings(clip=4).replaced({"clip": "none"}, "a file").clip is None


@pytest.mark.parametrize(
    ("preset", "changes", "profile"),
    [
        ("default", {}, "robot"),
        ("default", {"pixels": 25, "smooth": False, "places_per_window": 1}, "robot"),
        ("paper", {}, "paper"),
        ("paper", {"window": "count", "counter_code": "linear", "counter_bits": 4}, "paper"),
        ("default", {"counter_code": "none"}, None),
        ("default", {"window": "count"}, None),
        ("paper", {"counter_code": "contrast"}, None),
        ("seed-code", {}, None),
    ],
)
def test_settings_belong_to_a_profile_or_say_what_to_change(preset, changes, profile):
    settings = PRESETS[preset].replaced(changes, "the test")
    assert settings.profile == profile
    if profile is not None:
        assert settings.beyond_profile == ""
        return
    differences = (
        settings.beyond_profile.partition(" map with ")[2].partition(" for ")[0].split(", ")
    )
    wanted = dict(one.split(" = ") for one in differences)
    assert wanted
    # what it names is all that there is to change
    values = {"false": False, "none": None}
    named = {name: values.get(value, value) for name, value in wanted.items()}
    assert settings.replaced(named, "the test").profile in ("robot", "paper")


def test_keywords_for_type_checkers_are_the_settings_with_their_types():
    hints = get_type_hints(Settings)

    def keywords(settings):
        return {
            name: hints[each.name] | str
            if each.read
            else hints[each.name] | Literal[tuple(each.words)]
            if each.words
            else hints[each.name]
            for each in settings
            for name in (each.name, each.key)
        }

    matching = [each for each in SETTING_FIELDS.values() if each.group == "matching"]
    assert get_type_hints(MatchingChanges) == keywords(matching)
    # a time without its unit is none
    assert get_type_hints(SettingChanges) == keywords(SETTING_FIELDS.values()) | {"tau": str}
    assert get_args(Preset) == tuple(PRESETS)
    assert get_args(ProtocolName) == tuple(PROTOCOLS)


_TYPED = """
from typing import Unpack

from edge_vpr import AnyRecording, AnyTrack, LiveSession, Match
from edge_vpr import PartName, ReferenceMap, SettingChanges, open_recording

drive = open_recording("monday.raw", sensor=(346, 260))
route = ReferenceMap.build(drive, "paper", pixels=50, tau="500ms", hot_pixels="keep", clip=None)
route.match("tuesday.raw", precision=0.99, matching="filter").evaluate(("a.csv", "b.csv"), 70)
route.localiser("50ms", exclusion=2)
LiveSession("/dev/ttyUSB0", protocol="edvs", reference=route, precision=0.9)
LiveSession("/dev/ttyUSB0", protocol=PartName("edvs:format=E3"), reference=route)

def mine(**changes: Unpack[SettingChanges]) -> ReferenceMap:
    return ReferenceMap.build(drive, "tiny", **changes)

def mapped(recording: AnyRecording, track: AnyTrack) -> ReferenceMap:
    return ReferenceMap.build(recording, track=track)

def shown(match: Match) -> int:
    return match.place

mine(pixels=50, places_per_window="auto", strategy="top")
open_recording("monday.csv", on_fault="drop", time_unit="ns", columns="xytp")
route.match("tuesday.raw").report("out", figures=["png", "pdf"])
"""
_WRONG = """\
ReferenceMap.build(drive, pixles=50)
ReferenceMap.build(drive, pixels="many")
ReferenceMap.build(drive, window="counts")
ReferenceMap.build(5)
route.match(drive, precison=0.99)
route.match(drive, pixels=50)
route.localiser(dealy=2)
LiveSession("/dev/ttyUSB0", protocol="edvs", reference=route, precison=0.9)
LiveSession("/dev/ttyUSB0", protocol="edsv", reference=route)
ReferenceMap.build(drive, "papper")
ReferenceMap.build(drive, strategy="varience")
ReferenceMap.build(drive, counter_code="lg")
ReferenceMap.build(drive, hot_pixels="kept")
mine(pixles=50)
open_recording("monday.raw", on_fault="dorp")
open_recording("monday.csv", time_unit="sec")
route.match("tuesday.raw").report("out", figures=["pgn"])
"""


def test_a_type_checker_sees_a_misspelt_setting_and_a_wrong_value(tmp_path):
    api = pytest.importorskip("mypy.api")
    program = tmp_path / "program.py"
    program.write_text(_TYPED + _WRONG)
    config = Path(__file__).parents[2] / "pyproject.toml"
    report, errors, _ = api.run(
        ["--strict", "--no-color-output", "--config-file", str(config), str(program)]
    )
    assert not errors
    first = _TYPED.count("\n") + 1
    error_lines = sorted(
        int(line.split(":")[1]) for line in report.splitlines() if ": error:" in line
    )
    assert error_lines == [first + i for i in range(_WRONG.count("\n"))]
