"""Experiments: their tables, and that what is drawn is what the table says."""

from __future__ import annotations

import csv
import json
from functools import partial
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from edge_vpr_tools.report.figures import precision_recall, reliability_diagram
from lab import plots, shipped_tables
from lab.__main__ import main
from lab.experiments import EXPERIMENTS, calibration
from lab.loop import DRIVES, open_experiment
from lab.tables import SEED

from edge_vpr.confidence import DEFAULT_TABLES, LIVE, LIVE_ON_MAP, SMOOTHED, TABLES
from edge_vpr.evaluation.calibration import reliability
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import simulate_pair
from tests.lab.in_process import rows_of

FEW = {"pixels": 10, "sigma": 1.0}
STREET = partial(simulate_pair, sensor="tiny", length_m=80.0)


def nothing(name):
    """Hear what begins."""


def dots(axes):
    """Return the drawn means of each series of a panel of `plots.dots`."""
    return [bars[0].get_xdata().tolist() for bars in axes.containers]


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_a_file_of_results_is_as_its_experiment_writes_it(name):
    """A row for each seed: means that were written by hand, or by an earlier form, have none."""
    file = Path(__file__).parents[2] / "docs/results" / f"{name}.csv"
    with file.open(newline="") as lines:
        table = csv.DictReader(lines)
        named = [DRIVES, *open_experiment(name).names, SEED]
        assert list(table.fieldnames or ())[: len(named)] == named
        assert all(row[SEED].isdigit() for row in table)


def test_a_dot_is_the_mean_and_its_bar_the_spread():
    rows = [
        {"drives": "d", "row": name, "series": series, "P@100R": value}
        for series in ("x", "y")
        for name, value in (("a", 0.2), ("a", 0.4), ("a", 0.6), ("$b", 1.0))
    ]
    drawing = plots.dots(rows, "P@100R", "row", "series")
    (axes,) = drawing.axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a", r"\$b"]
    assert (axes.get_xlabel(), axes.get_title()) == ("P@100R", "")
    assert axes.get_ylim()[0] > axes.get_ylim()[1]  # the first row is at the top
    assert dots(axes) == [[pytest.approx(0.4), 1.0]] * 2
    heights = [bars[0].get_ydata().tolist() for bars in axes.containers]
    assert heights == [[-0.125, 0.875], [0.125, 1.125]]
    (bar, point) = axes.containers[0].lines[2][0].get_segments()
    assert np.ptp(bar[:, 0]) == pytest.approx(0.4) and np.ptp(point[:, 0]) == 0
    assert [text.get_text() for text in drawing.legends[0].get_texts()] == ["x", "y"]
    assert plots.dots(rows[:4], "P@100R", "row", "series").legends == []
    # drives below each other have rows of their own, and the same colour for a series
    others = [{**row, "drives": f"e, {i}"} for row in rows[4:7] for i in range(4)]
    *beside, lower = plots.dots([*rows, *others], "P@100R", "row", "series").axes
    assert [label.get_text() for label in lower.get_yticklabels()] == ["a"]
    assert [axes.get_title() for axes in (beside[0], lower)] == ["d", "e\n3"] and len(beside) == 4
    assert np.isnan(dots(lower)[0]).all() and dots(lower)[1] == [pytest.approx(0.4)]


@pytest.fixture
def few_streets(monkeypatch):
    """Streets of 30 m in two lights, with few pixels and windows of one kind."""
    monkeypatch.setattr(calibration, "simulate_pair", STREET)
    monkeypatch.setattr(calibration, "PIXELS", (10,))
    monkeypatch.setattr(calibration, "WINDOWS", ("time",))
    some = list(calibration.QUERIES.items())[:2]
    monkeypatch.setattr(calibration, "QUERIES", dict(some))
    preset = {"default": PRESETS["default"].replaced({"sigma": 1.0}, "test")}
    monkeypatch.setattr(calibration, "PRESETS", preset)


@pytest.mark.usefixtures("few_streets")
def test_the_calibration_learns_tables_instead_of_judging_them(tmp_path, capsys):
    assert main(f"calibration --seeds 2 --table {tmp_path}".split()) == 0
    assert "learnt on 2 streets" in capsys.readouterr().out
    assert [each.name for each in tmp_path.iterdir()] == [DEFAULT_TABLES]
    learnt = json.loads((tmp_path / DEFAULT_TABLES).read_text())
    assert learnt["street_seeds"] == [20, 21]
    shipped = json.loads(files("edge_vpr").joinpath(DEFAULT_TABLES).read_text())
    assert list(learnt) == list(shipped)
    assert list(learnt[TABLES]) == list(shipped[TABLES]) == [LIVE, SMOOTHED]
    fields = ["right", "off_map", "trust", "probability", "matches"]
    for made in (learnt, shipped):
        assert all(list(table) == fields for table in [*made[TABLES].values(), made[LIVE_ON_MAP]])
        assert made[LIVE_ON_MAP]["off_map"] == 0 < made[TABLES][LIVE]["off_map"]
    # the same streets, pooled by hand
    pooled, whole, leaving = [], [], []
    for seed in (20, 21):
        street, rng = calibration.open_street(seed), np.random.default_rng((7, seed))
        beside = calibration.drive_elsewhere(seed)
        for case, away in calibration.driven(street, beside, places_per_window=1):
            for name, version in calibration.versions_of(case, away, rng).items():
                live, smoothed = (
                    shipped_tables.sample(version.with_settings(shipped_tables.MATCHINGS[how]))
                    for how in (LIVE, SMOOTHED)
                )
                pooled.append(live)
                if name == "whole":
                    whole.append(live)
                if name not in ("whole", "carried off twice"):
                    leaving.append(smoothed)
    tables = learnt[TABLES][LIVE], learnt[LIVE_ON_MAP], learnt[TABLES][SMOOTHED]
    for table, some in zip(tables, (pooled, whole, leaving), strict=True):
        assert sum(table["matches"]) == sum(one.trust.size for one in some)
        correct = np.concatenate([one.correct for one in some])
        assert table["right"] == round(float(correct.mean()), 4)


@pytest.mark.usefixtures("few_streets")
def test_the_calibration_judges_the_shipped_tables_on_streets_that_they_are_not_from(monkeypatch):
    simulated_seeds = set()
    monkeypatch.setattr(
        calibration, "simulate_pair",
        lambda seed, **drive: simulated_seeds.add(seed) or STREET(seed, **drive),
    )  # fmt: skip
    rows = rows_of(calibration, None, 1)
    first, last = shipped_tables.learnt_seeds()
    # the one before is a detour's
    assert simulated_seeds == {999, 1_000} and not first <= 999 <= last
    by_map = {(row["map"], row["matching"]): row for row in rows}
    for how in shipped_tables.MATCHINGS:
        assert {row["map"] for row in rows if row["matching"] == how} >= {
            "whole", "a piece cut out", "a detour", "carried off twice",
        }  # fmt: skip
        assert (
            by_map["whole", how]["correct"] == by_map["whole", how]["correct of those on the map"]
        )
        whole = by_map["whole", how]
        if how != LIVE:
            assert "accepted at 0.99 (stays on map)" not in whole
            continue
        assert whole["accepted at 0.99 (stays on map)"] >= whole["accepted at 0.99"]
        probability = whole["mean probability (stays on map)"]
        assert whole["mean probability"] < probability < 1
    assert by_map["a detour", "live"]["AUROC off the map"] is not None
    for how in shipped_tables.MATCHINGS:
        kinds = [by_map[kind, how] for kind in calibration.LEARNT_FROM[LIVE]]
        windows = sum(row["windows"] for row in kinds)
        accepted = sum(row["windows"] * row["accepted at 0.99"] for row in kinds)
        assert by_map["all six", how]["windows"] == windows
        assert by_map["all six", how]["accepted at 0.99"] == pytest.approx(accepted / windows)
    assert by_map[shipped_tables.SWITCHED_ON, "live"]["starts"] >= 0


def labels(drawing):
    """Of the legend, which is outside the axes; its dots are no data."""
    return [text.get_text() for text in drawing.legends[0].get_texts()[1:]]


def test_a_reliability_says_its_error_and_how_many_matches_it_has():
    rng = np.random.default_rng(0)
    probability = rng.random(200)
    one = reliability(probability, rng.random(200) < probability)
    (axes,) = (drawing := reliability_diagram(one)).axes
    error = f"expected calibration error {one.expected_calibration_error:.3f}"
    assert axes.get_title() == f"Reliability: {error}"
    assert labels(drawing) == ["200 matches in 10 bins, larger: more"]


@pytest.mark.parametrize("least", [0.0, 0.5, 0.95, 1.0])
def test_the_axis_of_precision_goes_from_0_to_1_at_most(least):
    """And no further down than the curve needs."""
    curve = SimpleNamespace(recall=np.array([0.0, 1.0]), precision=np.array([1.0, least]))
    evaluation = SimpleNamespace(
        curve=curve, precision_at_100_recall=least, recall_at_99_precision=0.0, score="trust",
        findable=2, recall_denominator="rejected-correct",
    )  # fmt: skip
    (axes,) = precision_recall(evaluation, "a").axes
    low, high = axes.get_ylim()
    assert 0.0 <= low <= least and 1.0 <= high <= 1.03
    assert low > 0.4 or least < 0.5
    assert axes.get_legend() is None
    # of the lower of two thresholds, so that the curve leaves 0.99 at R@99P
    assert axes.lines[0].get_drawstyle() == "steps-pre"
