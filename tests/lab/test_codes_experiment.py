"""The experiment on counter codes, on the real data where it lies."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from lab.codes import TableCode
from lab.drives import open_pairs
from lab.experiments import codes
from lab.loop import Draw

from edge_vpr.settings import PRESETS

#: counts of 8 bits
RAW = ("linear", 8)
VARIANTS = {
    RAW: TableCode("linear", 8),
    ("log", 3): TableCode("log"),
    ("log, per-pixel", 1): TableCode("log", 1, per_pixel=True),
}


def score(pair, seed, variants):
    mapped = pair.mapped(pair.drawn_with(seed))
    return {name: mapped.coded({}, code).correct() for name, code in variants.items()}


@pytest.fixture(scope="module")
def scores_by_pair(shared_data):
    return {
        pair.name: [score(pair, seed, VARIANTS) for seed in range(2)]
        for pair in open_pairs(shared_data)
    }


@pytest.mark.slow
def test_three_bits_of_log_beat_eight_bits_of_count_on_every_pair_of_drives(scores_by_pair):
    """What docs/results.md claims, with two draws in place of five."""
    assert len(scores_by_pair) == 6
    for name, scores in scores_by_pair.items():
        right, raw = (np.mean([each[code] for each in scores]) for code in (("log", 3), RAW))
        assert right > raw, name


@pytest.mark.slow
def test_the_figures_quoted_for_brisbane_are_those_of_this_code(scores_by_pair):
    """Nothing is drawn there, so that the figures are the same on every run."""
    scores = scores_by_pair["Brisbane, 49 px"][0]
    assert {variant: round(value, 3) for variant, value in scores.items()} == {
        RAW: 0.442,
        ("log", 3): 0.824,
        ("log, per-pixel", 1): 0.730,
    }


def test_every_code_is_a_row_and_is_drawn():
    values = iter(np.linspace(0.2, 0.9, 1000))
    mapped = SimpleNamespace(
        coded=lambda changes, code: SimpleNamespace(correct=lambda: next(values))
    )
    settings = PRESETS["tiny"]
    pair = SimpleNamespace(
        settings=settings, drawn_with=lambda seed: settings, mapped=lambda settings: mapped
    )
    rows = [{"drives": "pair", **row} for row in codes.measure(Draw(pair, 0, True))]
    bits = len(codes.BITS)
    names = list(dict.fromkeys(row["code"] for row in rows))
    assert len(rows) == len(names) * bits == 6 * bits
    (axes,) = codes.figure(rows).axes
    assert [bars.get_label() for bars in axes.containers] == names
    drawn = axes.containers[0].lines[0].get_ydata().tolist()
    assert drawn == [row["P@100R"] for row in rows[:bits]]
    assert [row["bytes per place"] for row in rows[:bits]] == [4, 7, 10, 13, 19, 25]
