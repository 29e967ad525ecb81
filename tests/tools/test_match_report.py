"""The report of a match: its verdict, figures and warnings say what the metrics say."""

from __future__ import annotations

import io
import json
import re
import shutil
from contextlib import redirect_stdout
from dataclasses import replace
from html import unescape
from types import SimpleNamespace

import numpy as np
import pytest
from edge_vpr_tools.cli import main
from edge_vpr_tools.report import figures
from edge_vpr_tools.report.figures import true_cells
from edge_vpr_tools.report.verdict import Outcome, outcome_of
from matplotlib.collections import PathCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.match_result import MatchResult, read_queries
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.results import WINDOWS
from edge_vpr.settings import PRESETS
from tests import naive
from tests.streams import descriptors


def call(*words):
    assert main([str(word) for word in words]) == 0


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """A folder with two simulated drives, a map with positions, and matches, some of them wrong."""
    folder = tmp_path_factory.mktemp("street")
    call("simulate", "-o", folder / "pair", "--sensor", "tiny", "--length", 200)
    for name in ("reference", "query"):  # the street is bent to a quarter of a circle
        table = np.loadtxt(folder / f"pair/{name}_track.csv", delimiter=",", skiprows=1)
        angle = table[:, 1] / 100
        bent = np.column_stack([table[:, 0], 100 * np.sin(angle), 100 * (1 - np.cos(angle))])
        path = folder / f"{name}.csv"
        np.savetxt(path, bent, fmt="%.5f", delimiter=",", header="time_s,x_m,y_m", comments="")
    drive = folder / "pair/reference.npz"
    few = ("--pixels", 8, "--sigma", 1)
    call("map", drive, "-o", folder / "map.npz", "--track", folder / "reference.csv", *few)
    call("match", folder / "map.npz", folder / "pair/query.npz", "-o", folder / "results")
    (folder / "printed.txt").write_text(evaluated(folder, folder / "results"))
    return folder


def evaluated(street, folder, *tracks, tolerance=3):
    tracks = [street / f"{name}.csv" for name in tracks or ("reference", "query")]
    printed = io.StringIO()
    with redirect_stdout(printed):
        call("evaluate", folder, "--ground-truth", *tracks, "--tolerance", tolerance)
    return printed.getvalue()


def read(folder):
    """Return metrics, and the text of the report without tags."""
    page = (folder / "report.html").read_text()
    text = re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]*>", " ", page[page.index("<body") :])))
    return json.loads((folder / "metrics.json").read_text()), text


def legend(text, label):
    """Return the numbers that the figures give for a kind of matches."""
    return {int(n.replace(",", "")) for n in re.findall(rf"{label} \(([\d,]+)\)", text)}


def test_the_verdict_says_what_the_metrics_say(street):
    printed = (street / "printed.txt").read_text().splitlines()[0]
    metrics, text = read(street / "results")
    evaluation = metrics["evaluation"]
    correct = round(evaluation["precision_at_100_recall"] * evaluation["queries"])
    assert 0 < correct < evaluation["queries"]
    assert printed == metrics["verdict"]
    assert printed.startswith(
        f"{correct} of {evaluation['queries']} smoothed matches are correct; "
    )
    assert printed in text
    kinds = [f"{a}, {b}" for a in ("correct", "wrong") for b in ("accepted", "not accepted")]
    shown = {kind: legend(text, kind) or {0} for kind in kinds}
    assert all(len(numbers) == 1 for numbers in shown.values())
    (yes,), (no,), (bad,), (worse,) = shown.values()
    assert (yes + no, bad + worse) == (correct, evaluation["queries"] - correct)
    share = re.search(r"(\d+) % would be accepted at precision 0.99", printed)
    assert abs(int(share[1]) - 100 * (yes + bad) / evaluation["queries"]) <= 0.5
    # a match is not the first of those that Recall@N ranks, so Recall@1 may be another than P@100R
    matches = Matches.load(street / "results/matches.npz")
    assert (matches.candidates[:, 0] != matches.place).any()
    assert "a correct place is among the 1 with the filter's least metrics; a match is the" in text


@pytest.mark.parametrize("promised", [True, False])
def test_a_missed_precision_says_within_what_it_is_promised(street, promised):
    """Where the accepted matches are less often correct than that, by the tolerance given."""
    result = MatchResult.load(street / "results")
    matches, places = result.matches, len(result.reference)
    settings = matches.settings.replaced({"precision": "0.99"}, "")
    matches = replace(matches, settings=settings, lost=np.zeros(len(matches), np.bool_))
    correct = np.zeros((places, result.queries.end_us.size), np.bool_)
    correct[matches.place, matches.query] = True
    correct[:, matches.query[0]] &= promised
    truth = GroundTruth(correct, np.ones(correct.shape[1], np.bool_), "by hand")
    said = outcome_of(result.reference, matches, evaluate(matches, truth)).sentence
    assert ("(0.99 is promised within 3 windows of the true place)" in said) != promised


def test_the_times_of_wrong_matches_are_those_of_the_truth(street):
    verdict = read(street / "results")[0]["verdict"]
    spans = re.findall(r"(\d+(?:\.5)?)(?: to (\d+))? s\b", verdict)
    matches = Matches.load(street / "results/matches.npz")
    position = ReferenceMap.load(street / "map.npz").route.position
    track = np.loadtxt(street / "query.csv", delimiter=",", skiprows=1)
    at = np.column_stack([np.interp(matches.time_us / 1e6, track[:, 0], c) for c in track.T[1:]])
    away = np.hypot(*(position[:, None] - at).T).T
    wrong = (away[matches.place, np.arange(len(at))] > 3) & (away.min(axis=0) <= 3)
    wrong_s = matches.time_us[wrong] / 1e6
    assert wrong_s.size
    if "other time" not in verdict:
        for t in wrong_s:
            assert any(float(a) - 0.5 <= t <= float(b or a) + 0.5 for a, b in spans), t
    for a, b in spans:
        assert np.any((wrong_s >= float(a) - 0.5) & (wrong_s <= float(b or a) + 0.5))


def test_the_report_shows_route_error_and_the_worst_windows(street):
    page = (street / "results/report.html").read_text()
    _, text = read(street / "results")
    for label in ("x (m)", "y (m)", "error (m)", "probability", "tolerance 3 m"):
        assert label in text
    assert "length (s)" not in text  # all windows last a second
    assert page.index('class="verdict"') < page.index("<svg")
    shown = re.findall(r"<figcaption>(\d)\. At ([\d.]+) s, ([\d,]+) m off", page)
    assert [number for number, *_ in shown] == list("12345")
    sizes = [float(error.replace(",", "")) for *_, error in shown]
    assert sizes == sorted(sizes, reverse=True)
    assert ("error (m), log above 3" in text) == (sizes[0] > 9)
    matches = Matches.load(street / "results/matches.npz")
    for number, time, _ in shown:
        j = int(np.argmin(np.abs(matches.time_us / 1e6 - float(time))))
        figure = page[: page.index(f"<figcaption>{number}. At")].rpartition("<figure")[2]
        assert f"matched: place {matches.place[j]}<" in figure
        assert "correct: place" in figure


@pytest.mark.parametrize(
    ("flags", "kind", "accepted"),
    [
        ((), "smoothed", "accepted as at precision 0.99"),
        (("--no-smooth",), "live", "accepted as at precision 0.99"),
        (
            ("--online", "--every", "window", "--precision", 0.5),
            "live",
            "accepted at precision 0.5",
        ),
    ],
)
def test_what_the_matches_are_and_which_precision_was_asked_is_said_first(
    street, tmp_path, run, flags, kind, accepted
):
    match = ["match", street / "map.npz", street / "pair/query.npz", "-o", tmp_path / "m"]
    printed = run(*match, *flags).out
    number = len(Matches.load(tmp_path / "m/matches.npz"))
    assert printed.startswith(f"{tmp_path}/m: {number:,} {kind} matches; ")
    printed += evaluated(street, tmp_path / "m").splitlines()[0]
    assert printed.count(f" {kind} matches") == 2
    verb = "would be" if " as " in accepted else "are"
    assert printed.count(f" {verb} accepted at precision {accepted.rpartition(' ')[2]}") == 2
    for name in ("route", "matches"):
        title = f">{kind.capitalize()} matches, {accepted}<"
        assert title in (tmp_path / f"m/{name}.svg").read_text()
    matches = Matches.load(tmp_path / "m/matches.npz")
    by_sequences = replace(matches, settings=PRESETS["paper"])
    assert Outcome(by_sequences, None, ~matches.lost).kind == "matches"


def test_a_route_from_above_has_a_start_and_arrows_in_its_direction(street):
    """Also where the first places have no position."""
    result = MatchResult.load(street / "results")
    position = result.reference.route.position.copy()
    position[:3] = np.nan
    along_m = np.where(np.arange(len(position)) < 3, np.nan, result.reference.route.along_m)
    route = replace(result.reference.route, position=position, along_m=along_m)
    outcome = outcome_of(result.reference, result.matches)
    (axes,) = figures.RouteView.of(result.reference, outcome, route).figure(outcome).axes
    (start,) = (line for line in axes.lines if line.get_label() == "start")
    assert start.get_xydata().tolist() == [position[3].tolist()]
    arrows = [(text.xyann, text.xy) for text in axes.texts]
    assert len(arrows) >= 3
    for tail, head in arrows:
        behind, ahead = (np.hypot(*(position[3:] - at).T).argmin() for at in (tail, head))
        assert behind < ahead


@pytest.mark.parametrize("judged", [True, False])
def test_a_colour_means_the_same_from_above_and_along_the_route(street, judged):
    result = MatchResult.load(street / "results")
    settings = result.matches.settings.replaced({"precision": "0.99"}, "")
    lost = np.arange(len(result.matches)) % 2 == 0
    matches = replace(result.matches, settings=settings, lost=lost)
    correct = np.ones((len(result.reference), result.queries.end_us.size), np.bool_)
    correct[:, ::3] = False
    truth = GroundTruth(correct, np.ones(correct.shape[1], np.bool_), "by hand")
    evaluation = evaluate(matches, truth) if judged else None
    outcome = outcome_of(result.reference, matches, evaluation)
    view = figures.RouteView.of(result.reference, outcome, result.reference.route)
    marks, strip = {}, replace(view, route=None, at=outcome.time_s).figure(outcome).axes[0]
    for each in view.figure(outcome).axes[0].collections:
        if isinstance(each, PathCollection):
            face, edge = each.get_facecolor()[0], each.get_edgecolor()[0]
            marks[each.get_label()] = to_hex(face if face[3] else edge)
    names = [label.get_text() for label in strip.get_yticklabels()]
    drawn = zip(names, strip.collections, strict=True)
    rows = {name: to_hex(row.get_color()) for name, row in drawn}
    assert rows == marks and len(rows) == (4 if judged else 2)


@pytest.mark.parametrize(("tolerance", "largest"), [(70, 600), (10, 35), (70, 90), (2, 9_000)])
def test_the_axis_of_errors_has_ticks_above_the_tolerance(tolerance, largest):
    truth = SimpleNamespace(positions=SimpleNamespace(tolerance=tolerance), error_unit="m")
    axes = Figure().subplots()
    figures._error_axis(axes, truth, np.array([0.0, largest]))
    above = [tick for tick in axes.get_yticks() if tolerance < tick <= axes.get_ylim()[1]]
    assert 1 <= len(above) <= 6


def test_warnings_of_matching_stay_in_the_report_of_an_evaluation(street, monkeypatch):
    monkeypatch.setattr("edge_vpr_tools.console._FEW_PLACES", 1_000_000)
    folder = street / "burst"
    call("match", street / "map.npz", street / "pair/query.npz", "-o", folder)
    assert "fewer than 1000000, probabilities are too high" in read(folder)[1]
    evaluated(street, folder)
    assert "fewer than 1000000, probabilities are too high" in read(folder)[1]


def test_an_online_report_shows_correct_and_wrong_once_it_knows(street):
    """And as the worst windows, the last one that was complete before each of those matches."""
    folder = street / "online"
    live = ["--online", "--every", "300ms", "-o", folder]
    call("match", street / "map.npz", street / "pair/query.npz", *live)
    text = read(folder)[1]
    number = len(Matches.load(folder / "matches.npz"))
    assert f"{number} live matches" in text
    assert not legend(text, "correct, not accepted")
    evaluated(street, folder)
    metrics, text = read(folder)
    assert metrics["evaluation"]["score"] == "trust"
    assert json.loads((folder / "run.json").read_text())["settings"]["smooth"] is False
    correct = round(metrics["evaluation"]["precision_at_100_recall"] * number)
    assert f"{correct} of {metrics['evaluation']['queries']} live matches are correct" in text
    assert legend(text, "wrong, not accepted")
    page = (folder / "report.html").read_text()
    shown = re.findall(r"<figcaption>(\d)\. At ([\d.]+) s, ([\d,]+) m off", page)
    assert [number for number, *_ in shown] == list("12345")
    for number, *_ in shown:
        figure = page[: page.index(f"<figcaption>{number}. At")].rpartition("<figure")[2]
        assert "query" in figure and "matched: place" in figure and "correct: place" in figure
    # the same windows as of a recorded match, and no queries of this one
    recorded = read_queries(street / "results")
    assert np.array_equal(read_queries(folder, WINDOWS).end_us, recorded.end_us)
    assert MatchResult.load(folder).queries is None


def test_a_map_with_a_gps_log_can_be_evaluated_by_tracks_in_metres(street):
    """Then the marks stand at the matched places, since the true ones are in other coordinates."""
    table = np.loadtxt(street / "reference.csv", delimiter=",", skiprows=1)
    table[:, 1:] = np.array([50.0, 8.0]) + table[:, 1:] * 1e-5
    header = "time_s,latitude,longitude"
    np.savetxt(street / "gps.csv", table, fmt="%.7f", delimiter=",", header=header, comments="")
    small = ("--pixels", 8, "--sigma", 1, "--track", street / "gps.csv")
    call("map", street / "pair/reference.npz", "-o", street / "gps.npz", *small)
    folder = street / "gps"
    call("match", street / "gps.npz", street / "pair/query.npz", "-o", folder, "--no-figures")
    evaluated(street, folder)
    metrics, text = read(folder)
    assert metrics["verdict"] == read(street / "results")[0]["verdict"]
    assert "east (m)" in text and "according to a match" in text


def test_errors_without_positions_are_places_to_the_nearest_correct_one():
    correct = np.zeros((6, 3), dtype=np.bool_)
    correct[[1, 5], 0] = correct[2, 1] = True
    truth = GroundTruth(correct, np.ones(3, dtype=np.bool_), "by hand")
    assert truth.error_unit == "places"
    errors = truth.errors(np.array([0, 4, 0]), np.array([0, 1, 2]))
    assert errors.tolist()[:2] == [1.0, 2.0]
    assert np.isnan(errors[2])


def test_when_all_are_wrong_or_all_correct_the_verdict_is_short(street):
    reference = ReferenceMap.load(street / "results/map.npz")
    matches = Matches.load(street / "results/matches.npz")
    n = len(matches)
    truth = np.zeros((len(reference), int(matches.query[-1]) + 1), dtype=np.bool_)
    truth[matches.place, matches.query] = True
    has_truth = np.ones(truth.shape[1], dtype=np.bool_)
    all_correct = f"{n} of {n} smoothed matches are correct; "
    for correct, start in ((truth, all_correct), (~truth, f"0 of {n} ")):
        right = GroundTruth(correct, has_truth, "by hand")
        text = outcome_of(reference, matches, evaluate(matches, right)).sentence
        assert text.startswith(start)
        assert "lie at" not in text


@pytest.mark.parametrize(("length", "side"), [(1, 9), (4, 9), (3, 1_500)])
def test_shown_distances_are_every_few_of_all_with_a_stride_for_each_axis(
    length, side, monkeypatch
):
    rng = np.random.default_rng(2)
    places, queries = (descriptors(rng.integers(0, 9, (n, 6), dtype=np.uint8)) for n in (95, 23))
    settings = PRESETS["paper"].replaced({"sequence_length": length}, "test")
    matches = match_descriptors(places, queries, settings)
    monkeypatch.setattr(figures, "_SIDE", side)
    shown, (down, across) = figures.shown_distances(places, queries, matches)
    assert (down, across) == (1 + 95 // side, 1 + 23 // side)
    every = naive.sequence_sums(
        naive.distance_matrix(places.counts.tolist(), queries.counts.tolist()), length
    )
    assert np.array_equal(shown * length, np.array(every)[::down, ::across])


def test_the_picture_of_the_truth_loses_no_true_place():
    correct = np.zeros((9_001, 4_003), np.bool_)
    for k, j in ((0, 0), (9_000, 4_002), (4_321, 77)):
        correct[k, j] = True
    cells = true_cells(correct)
    assert cells.shape == (1_801, 1_335)
    for k, j in ((0, 0), (9_000, 4_002), (4_321, 77)):
        assert cells[k // 5, j // 3]
    assert np.count_nonzero(cells) == 8 + 8 + 15  # seven cells wider on each side, on the picture


def test_the_map_of_a_result_is_a_link_to_the_map_that_was_matched_with(street, tmp_path):
    """With other settings of matching too; a map that replaces one leaves the other."""
    made, flags = street / "map.npz", ["--no-figures", "--exclusion", 1]
    call("match", made, street / "pair/query.npz", "-o", tmp_path / "one", *flags)
    assert (street / "results/map.npz").samefile(made)
    assert (tmp_path / "one/map.npz").samefile(made)
    before = made.read_bytes()
    reference = ReferenceMap.load(made)
    other = replace(reference, start_us=reference.start_us + 1)
    other.save(tmp_path / "one/map.npz", overwrite=True)
    assert made.read_bytes() == before != (tmp_path / "one/map.npz").read_bytes()


# What a result shows by itself in Python.


@pytest.fixture(scope="module")
def judged(street):
    """The result of the street, and its evaluation at 3 m."""
    result = MatchResult.load(street / "results")
    return result, result.evaluate((street / "reference.csv", street / "query.csv"), 3)


def test_a_result_draws_itself_on_axes_of_its_own_or_given_ones(judged):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    result, judged = judged
    drawn = result.plot(judged)
    labels = [axes.get_ylabel() for axes in drawn]
    assert labels == ["y (m)", "error (m)", "probability"]
    points = {
        collection.get_label(): len(collection.get_offsets()) for collection in drawn[1].collections
    }
    wrong = int(np.count_nonzero(judged.evaluated & ~judged.correct))
    assert sum(n for label, n in points.items() if label.startswith("wrong")) == wrong > 0
    assert drawn[0].get_legend() is None  # it covers no panel
    entries = [text.get_text() for text in drawn[0].figure.legends[0].get_texts()]
    assert len(entries) == len(set(entries)) > 4
    _, own_axes = pyplot.subplots(1, 2)
    assert list(result.plot(axes=own_axes)) == list(own_axes)
    assert [axes.get_ylabel() for axes in own_axes] == ["y (m)", "distance along the route (m)"]
    assert own_axes[0].get_legend() is not None
    _, one = pyplot.subplots()
    assert list(result.plot(judged, axes=one)) == [one]
    pyplot.close("all")
    with pytest.raises(UsageError, match="axes= is no Matplotlib axes"):
        result.plot(axes="axes")


def test_positions_correctness_and_errors_stand_beside_the_matches(judged):
    pytest.importorskip("pandas")
    result, judged = judged
    table = result.to_frame(judged)
    np.testing.assert_array_equal(table["along_m"], result.along_m)
    np.testing.assert_array_equal(table[["x_m", "y_m"]], result.position)
    assert table["correct"].sum() == judged.correct.sum()
    assert ((table["error"] <= 3) == table["correct"]).all()
    unknown = replace(judged, evaluated=np.zeros(len(result), bool))
    assert result.to_frame(unknown)["correct"].isna().all()
    others = result.matches.take(slice(None, None, -1)), result.matches.take(slice(1, None))
    for matches in others:
        for show in (result.to_frame, result.plot):
            with pytest.raises(UsageError, match="give that of this result"):
                show(replace(judged, matches=matches))
    nowhere = replace(result, reference=replace(result.reference, route=None))
    assert nowhere.position is None
    assert np.isnan(nowhere.along_m).all()


def test_a_report_from_python_is_that_of_the_command_line(street, judged, tmp_path):
    result, judged = judged
    assert [*result.facts()] == ["reference", "query", "views", "pixels"]
    with pytest.raises(UsageError, match="tolerance_m = 25, and truth says already"):
        result.evaluate(judged.truth, 25)
    result.report(tmp_path / "out", judged, figures=("png",))
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    of_command = json.loads((street / "results/metrics.json").read_text())
    for key in ("evaluation", "verdict", "ground_truth", "facts"):
        assert metrics[key] == of_command[key]
    assert metrics["facts"] == result.facts(judged.truth)
    assert [*metrics["facts"]][2:] == [
        "reference track",
        "query track",
        "routes",
        "views",
        "pixels",
    ]
    printed = (street / "printed.txt").read_text()
    for heading, line in metrics["facts"].items():
        assert re.search(f"^{heading} +{re.escape(line)}$", printed, re.MULTILINE)
    page = unescape((tmp_path / "out/report.html").read_text()).replace("\u00a0", " ")
    assert all(text in page for text in (metrics["verdict"], *metrics["facts"].values()))
    assert (tmp_path / "out/route.png").stat().st_size > 0
    shown = result._repr_html_()
    assert outcome_of(result.reference, result.matches).sentence in unescape(shown)
    assert "data:image/svg+xml;base64," in shown


def test_a_map_says_in_python_what_info_prints(street, run):
    info = ReferenceMap.load(street / "map.npz").info()
    assert run("info", street / "map.npz").out.endswith(f"{info}\n")
    of_info = json.loads(run("info", street / "map.npz", "--json").out)
    for name in ("places", "route_m", "settings"):
        assert of_info[name] == getattr(info, name)
    assert (of_info["format"], of_info["sensor"], of_info["pixels"]) == ("map", "32x32", 8)
    assert "8, 3 bits each" in f"{info}"


def test_several_tolerances_are_judged_in_one_run(street, tmp_path, run):
    folder = shutil.copytree(street / "results", tmp_path / "results")
    tracks = [street / f"{name}.csv" for name in ("reference", "query")]
    shown = {(3,): read(folder)[0]}
    for words in ((9,), (3, 9)):
        printed = run("evaluate", folder, "--ground-truth", *tracks, "--tolerance", *words).out
        shown[words] = json.loads((folder / "metrics.json").read_text())
    both = shown[3, 9]
    assert both["evaluation"] == shown[3,]["evaluation"]
    assert [each["tolerance"] for each in both["tolerances"]] == [3, 9]
    for each in both["tolerances"]:
        alone = shown[int(each["tolerance"]),]["evaluation"]
        assert each["unit"] == "m"
        assert set(each["recall_at"]) >= {"1", "5", "10"}
        assert each["recall_at"] == alone["recall_at"]
        assert each["precision_at_100_recall"] == alone["precision_at_100_recall"]
        assert f"{each['recall_at']['5']:.3f}" in printed
    assert both["tolerances"][1]["recall_at"]["1"] > both["tolerances"][0]["recall_at"]["1"]
    assert "9 m" in (folder / "report.html").read_text()


@pytest.mark.filterwarnings("ignore::edge_vpr.errors.EdgeVprWarning")  # of the largest tolerance
def test_the_points_of_the_curve_are_a_table_and_its_picture_is_always_there(street, tmp_path):
    pandas = pytest.importorskip("pandas")
    result = MatchResult.load(street / "results")
    tracks = (street / "reference.csv", street / "query.csv")
    for tolerance in (3, 10):  # some wrong, none wrong
        evaluation = result.evaluate(tracks, tolerance)
        result.report(tmp_path / f"{tolerance}", evaluation, figures=("svg",))
        picture = (tmp_path / f"{tolerance}/precision_recall.svg").read_text()
        assert f"of the {evaluation.correct.sum()} queries whose best match is correct" in picture
        table = pandas.read_csv(tmp_path / f"{tolerance}/precision_recall.csv")
        np.testing.assert_array_equal(table["recall"], evaluation.curve.recall)
        np.testing.assert_array_equal(table["tp"] / (table["tp"] + table["fp"]), table["precision"])
        for row in table.itertuples():  # the threshold is of the trust as matches.csv has it
            accepted = result.matches.trust >= row.threshold
            assert (accepted & evaluation.correct).sum() == row.tp
    assert not (evaluation.evaluated & ~evaluation.correct).any()


def test_json_on_standard_output_is_what_the_files_hold_and_nothing_else(street, tmp_path, run):
    def printed(*words):
        return json.loads(run(*words, "--json").out)

    out, new = tmp_path / "out", tmp_path / "map.npz"
    tracks = [street / "reference.csv", street / "query.csv"]
    made = printed("map", street / "pair/reference.npz", "-o", new, "--track", tracks[0])
    record = json.loads(new.with_suffix(".run.json").read_text())
    assert {name: made[name] for name in record} == record
    assert {name: made[name] for name in printed("info", new)} == printed("info", new)
    metrics = out / "metrics.json"
    matched = printed("match", street / "map.npz", street / "pair/query.npz", "-o", out)
    assert matched == json.loads(metrics.read_text())
    judged = printed("evaluate", out, "--ground-truth", *tracks, "--tolerance", 3)
    assert judged == json.loads(metrics.read_text())
