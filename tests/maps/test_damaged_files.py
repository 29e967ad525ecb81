"""Damaged files of every kind: refused in one line, or worth what they say."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from edge_vpr.errors import LONGEST_MESSAGE, EdgeVprError, UsageError, printable
from edge_vpr.settings import resolve_settings
from firmware_model.design import Design
from firmware_model.errors import DesignError
from tests.maps import saved_files


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    return saved_files.write_originals(tmp_path_factory.mktemp("originals"))


def one_line(error):
    # firmware_model does not shorten its messages; the command line does
    text = printable(error) if isinstance(error, DesignError) else str(error)
    assert text.isprintable() and 0 < len(text) <= LONGEST_MESSAGE, text
    return text


def damaged(raw, rng):
    """Change bytes of a file: one or several, repeated, removed, or replaced by others."""
    changed = bytearray(raw)
    for _ in range(int(rng.integers(1, 4))):
        if not changed:
            break
        at = int(rng.integers(len(changed)))
        end = min(len(changed), at + int(rng.integers(1, 40)))
        what = rng.integers(6)
        if what == 0:
            changed[at] ^= 1 << int(rng.integers(8))
        elif what == 1:
            changed[at] = int(rng.choice([0, 9, 10, 27, 34, 44, 45, 48, 57, 91, 101, 123, 255]))
        elif what == 2:
            del changed[at:end]
        elif what == 3:
            changed[at:at] = changed[at:end] * int(rng.choice([1, 2, 300]))
        elif what == 4:
            changed[at:end] = rng.bytes(end - at)
        else:
            del changed[at:]
    return bytes(changed)


@pytest.mark.parametrize("kind", saved_files.LOADERS)
def test_a_damaged_file_is_refused_in_one_line_or_read(originals, tmp_path, kind):
    load, rng = saved_files.LOADERS[kind], np.random.default_rng(7)
    for original in originals[kind]:
        load(original)
        path, raw = tmp_path / original.name, original.read_bytes()
        for _ in range(60):
            path.write_bytes(damaged(raw, rng))
            loads_or_refuses(load, path)


def loads_or_refuses(load, path):
    """Load a file; False if it is refused as it should be."""
    try:
        loaded = load(path)
    except (EdgeVprError, DesignError) as error:
        one_line(error)
        return False
    if isinstance(loaded, Design):
        assert Design.from_dict(tomllib.loads(loaded.to_toml())) == loaded
    return True


NESTED = "a = " + "[" * 5_000 + "]" * 5_000
DIGITS = "9" * 5_000


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        *((kind, text) for kind in ("layout", "design", "target") for text in (NESTED, DIGITS)),
        ("profile", "[" * 50_000),
        ("profile", "[]"),
        ("design", 'width = 4\nheight = 4\npixels = 2\nplaces = 9\nsteps = "x"'),
        ("design", f"width = 4\nheight = 4\npixels = 2\nplaces = {DIGITS[:4200]}"),
        ("target", 'name = "a"\nkind = "processor"\nclock_hz = "fast"'),
        ("target", 'name = "a"\nkind = "fpga"\nclock_hz = 1e6\nblock_shapes = [[1]]'),
        ("target", 'name = "a"\nkind = ["fpga"]\nclock_hz = 1e6'),
        ("target", 'name = "a"\nkind = "fpga"\nclock_hz = nan'),
        ("meter", "time,power\n" + "1" * 200_000 + ",1\n2,1\n"),
        ("meter", ""),
    ],
)
def test_files_of_plain_values_end_in_one_error_whatever_they_hold(kind, text, tmp_path):
    path = tmp_path / f"file.{'json' if kind == 'profile' else 'toml'}"
    path.write_text(text)
    assert not loads_or_refuses(saved_files.LOADERS[kind], path)


@pytest.mark.parametrize(
    "text",
    ["sigma = " + "[" * 50_000, "seed = 0x" + "f" * 5_000, "seed = " + "1" * 5_000, "sigma = nan",
     "sigma = inf", "preset = 7", "preset = []", "a = 1979-13-45", "tau_us = true", "\x00",
     "strategy = 3", "# " + "x" * (1 << 20)],
)  # fmt: skip
def test_settings_that_cannot_be_are_one_line_that_names_the_file(tmp_path, text):
    (tmp_path / "odd.toml").write_text(text)
    with pytest.raises(UsageError) as caught:
        resolve_settings(config=tmp_path / "odd.toml")
    said = one_line(caught.value)
    assert "preset" in text or "odd.toml" in said
