"""Probabilities of matches: learnt, stored, applied, and judged."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from edge_vpr_tools.cli import main
from hypothesis import given
from hypothesis import strategies as st
from lab.pairs import MappedPair
from lab.shipped_tables import Sample, sample, windows_past_the_edge
from lab.spliced import carried_off, spliced, with_detour, without_places

from edge_vpr import LiveSession
from edge_vpr.confidence import (
    DEFAULT_TABLES,
    NO_MISFIT,
    Acceptance,
    Confidence,
    default_confidence,
    net_trust,
)
from edge_vpr.descriptors.counting import count_places
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.errors import MapError, UsageError
from edge_vpr.evaluation.calibration import isotonic, learn_confidence, reliability
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import auroc, evaluate_rejection
from edge_vpr.events import Sensor, join_events
from edge_vpr.learning import align
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.online.localiser import Localiser
from edge_vpr.recordings import open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS, SETTING_FIELDS, Settings
from firmware_model.specification_drive import confidence_of
from tests import naive
from tests.live.devices import sent_by
from tests.streams import Drive, descriptors, map_of_counts, random_events, resumed

SENSOR = Sensor(16, 12)
outcomes = st.lists(st.tuples(st.integers(0, 8), st.booleans()), min_size=1, max_size=60)


def table(*steps):
    trust, probability, matches = zip(*steps, strict=True)
    return Confidence(np.array(trust), np.array(probability), np.array(matches))


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(1, 5)), min_size=1, max_size=12))
def test_blocks_of_pooled_violators_are_the_least_squares_rising_fit(pairs):
    values, weights = (np.array(column, dtype=float) for column in zip(*pairs, strict=True))
    begins = isotonic(values, weights)
    ends = [*begins[1:].tolist(), len(values)]
    fit = []
    for begin, end in zip(begins.tolist(), ends, strict=True):
        mean = np.average(values[begin:end], weights=weights[begin:end])
        fit += [mean] * (end - begin)
    assert np.allclose(fit, naive.isotonic(values.tolist(), weights.tolist()))
    assert (np.diff([fit[begin] for begin in begins]) > 0).all()


def test_a_robot_that_stays_on_the_map_accepts_live_matches_of_lower_trust():
    any_robot, on_map = (default_confidence(stays_on_map=stays) for stays in (False, True))
    assert on_map.least_trust(0.99) < any_robot.least_trust(0.99)
    assert on_map.matches.sum() < any_robot.matches.sum()
    assert default_confidence(True, stays_on_map=True) == default_confidence(True)


@pytest.mark.parametrize(
    ("original", "becomes", "says"),
    [
        ('"live_on_map"', '"live_of_map"', "lacks 'live_on_map': install"),
        ('"smoothed"', '"smoother"', "lacks 'smoothed': install"),
        ('"probability": [', '"probability": [1.5, ', "confidence_probability is float64 of shape"),
        ('"matches": [', '"matches": [-', "confidence_matches holds"),
        ("}}", "}", "damaged"),
    ],
)
def test_a_damaged_file_of_shipped_tables_is_named(tmp_path, monkeypatch, original, becomes, says):
    text = files("edge_vpr").joinpath(DEFAULT_TABLES).read_text(encoding="utf-8")
    assert original in text
    (tmp_path / DEFAULT_TABLES).write_text(text.replace(original, becomes), encoding="utf-8")
    monkeypatch.setattr("edge_vpr.confidence.files", lambda package: tmp_path)
    with pytest.raises(MapError, match=f"{DEFAULT_TABLES}.*{says}.*again"):
        for smoothed, stays_on_map in ((True, False), (False, True)):
            default_confidence.__wrapped__(smoothed, stays_on_map)


@given(outcomes)
def test_a_learnt_table_rises_and_never_says_never_or_always(pairs):
    trust = np.array([t for t, _ in pairs])
    correct = np.array([c for _, c in pairs])
    learnt = learn_confidence(trust, correct)
    assert (np.diff(learnt.probability) >= 0).all()
    assert learnt.probability[0] > 0 and learnt.probability[-1] < 1
    assert learnt.matches.sum() == len(pairs)
    for i, (begin, n) in enumerate(zip(learnt.trust, learnt.matches, strict=True)):
        end = learnt.trust[i + 1] if i + 1 < len(learnt.trust) else 99
        assert ((trust >= begin) & (trust < end)).sum() == n
    for p in learnt.probability:  # of all steps that have it together
        inside = learnt.probability_of(trust) == p
        assert p == (correct[inside].sum() + 1) / (inside.sum() + 2)


def test_a_threshold_lies_within_a_long_block():
    """Half of the matches are right in 0.98, the others always."""
    trust = np.repeat(np.arange(1_000), 10)
    correct = np.ones(10_000, dtype=np.bool_)
    correct[:5_000:50] = False  # 2 % of the lower half
    learnt = learn_confidence(trust, correct)
    least = learnt.least_trust(0.995)
    assert 300 < least < 500 and len(learnt.trust) < 300
    assert learnt.probability_of(np.array([least])) < 0.985


@given(outcomes, st.floats(0.01, 0.99))
def test_a_precision_asked_for_is_that_of_the_accepted_by_the_table(pairs, precision):
    learnt = learn_confidence(np.array([t for t, _ in pairs]), np.array([c for _, c in pairs]))
    of_all = np.array([t for t, _ in pairs])
    table_p = learnt.probability_of(of_all)
    by_threshold = {t: table_p[of_all >= t].mean() for t in of_all.tolist()}
    if learnt.precision[-1] < precision:
        with pytest.raises(UsageError, match="was not reached where trust was calibrated"):
            learnt.least_trust(precision)
        return
    least = learnt.least_trust(precision)
    accepted = of_all[of_all >= least]
    assert by_threshold[accepted.min()] >= precision - 1e-12
    refused = [p for t, p in by_threshold.items() if t < least and t in learnt.trust]
    assert all(p < precision + 1e-12 for p in refused)


def test_learning_from_nothing_is_refused():
    with pytest.raises(UsageError, match="from one match or more"):
        learn_confidence(np.array([], dtype=np.int64), np.array([], dtype=bool))


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"confidence_trust": np.array([1, 1])}, "does not increase"),
        ({"confidence_trust": np.array([1.0, 2.0])}, "float64"),
        ({"confidence_probability": np.array([0.5, 1.0])}, "not rising"),
        ({"confidence_probability": np.array([0.5, 0.4])}, "not rising"),
        ({"confidence_probability": np.array([0.5, np.nan])}, "not rising"),
        ({"confidence_probability": np.array([0.5])}, "shape"),
        ({"confidence_matches": np.array([0, 1])}, "confidence_matches holds"),
        ({"confidence_matches": None}, "NoneType"),
    ],
)
def test_a_damaged_table_is_refused(arrays, says):
    whole = table((0, 0.5, 3), (7, 0.6, 2)).to_arrays()
    with pytest.raises(MapError, match=says):
        Confidence.from_arrays({**whole, **arrays})


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=40))
def test_the_calibration_error_is_the_oracles(pairs):
    p, correct = [p for p, _ in pairs], [c for _, c in pairs]
    error = reliability(np.array(p), np.array(correct)).expected_calibration_error
    assert error == pytest.approx(naive.calibration_error(p, correct, 10), abs=1e-12)


@given(
    st.lists(st.integers(-3, 5), min_size=1, max_size=15),
    st.lists(st.integers(-3, 5), min_size=1, max_size=15),
)
def test_the_area_under_the_curve_is_the_share_of_ordered_pairs(higher, lower):
    assert auroc(np.array(higher), np.array(lower)) == pytest.approx(naive.auroc(higher, lower))


def test_found_at_99_percent_counts_queries_that_are_not_on_the_map():
    trust = np.arange(10)
    has_place = trust % 5 != 0
    correct = has_place & (trust != 1)
    rejection = evaluate_rejection(trust, correct, has_place, trust >= 4)
    assert (rejection.on_map, rejection.off_map, rejection.right_on_map) == (8, 2, 7 / 8)
    assert rejection.found_at_99_precision == 4 / 8  # down to 6; 5 is off the map
    assert (rejection.accepted, rejection.precision, rejection.recall) == (6, 5 / 6, 5 / 8)
    assert evaluate_rejection(trust, correct, trust >= 0).off_map_auroc is None
    nothing = evaluate_rejection(trust, correct, has_place, trust > 99)
    assert (nothing.accepted, nothing.precision, nothing.recall) == (0, None, 0.0)


def test_matches_by_sequences_have_no_probability_until_they_are_calibrated():
    trust, misfit = np.array([3, 4]), np.array([NO_MISFIT, NO_MISFIT])
    probability, lost = Acceptance(None).accept(trust, misfit)
    assert np.isnan(probability).all() and not lost.any()
    with pytest.raises(UsageError, match="calibrate the map"):
        Acceptance(None, 0.9)
    probability, lost = Acceptance(table((0, 0.5, 9), (4, 0.95, 9)), 0.9).accept(trust, misfit)
    assert (probability.tolist(), lost.tolist()) == ([0.5, 0.95], [True, False])


@pytest.mark.parametrize("precision", [1.0, -0.1, float("nan"), 2])
def test_a_precision_is_a_share_below_one(precision):
    with pytest.raises(UsageError, match="precision"):
        Settings(precision=precision)


def a_map(settings, **more):
    pixels = PixelMap(SENSOR, np.array([0, 5, 2]), np.array([0, 4, 3]))
    counts = np.random.default_rng(1).integers(0, 6, (20, 3))
    return map_of_counts(pixels, counts, settings, **more)


CODED = Settings(
    pixels=3, tau_us=100_000, matching="filter", remove_bursts=False, counter_code="contrast"
)


def test_a_table_travels_with_its_map_and_with_the_state_of_a_localiser(tmp_path):
    own = table((0, 0.25, 8), (2, 0.75, 8))
    reference = a_map(CODED.replaced({"precision": 0.7}, "test"), confidence=own)
    reference.save(tmp_path / "map.npz")
    loaded = ReferenceMap.load(tmp_path / "map.npz")
    assert loaded.confidence is not None
    for name, column in own.to_arrays().items():
        assert np.array_equal(loaded.confidence.to_arrays()[name], column)
    events = random_events(np.random.default_rng(2), 400, SENSOR, 2_000_000)
    localiser = Localiser(loaded)
    rows = localiser.update(events[:200])
    assert set(rows["probability"]) <= {0.25, 0.75} and set(rows["lost"]) == {True, False}
    assert np.array_equal(rows["lost"], net_trust(rows["trust"], rows["misfit"]) < 2)
    assert np.array_equal(resumed(localiser).update(events[200:]), localiser.update(events[200:]))


def test_a_table_is_not_used_with_settings_that_give_trust_another_scale():
    reference = a_map(CODED, confidence=table((0, 0.25, 8)))
    other_query = reference.settings.replaced({"stays_on_map": True}, "test")
    assert reference.matched_with(other_query).confidence is reference.confidence
    for changes in ({"filter_restart": 9}, {"exclusion": 1}, {"matching": "sequence"}):
        changed = reference.settings.replaced(changes, "test")
        assert reference.matched_with(changed).confidence is None


#: another value of each setting that changes the scale of the trust, and those that do not
OF_TRUST = {
    "matching": "sequence", "filter_restart": 9,
    "smooth": False, "exclusion": 1, "sequence_length": 9, "gains": 1,
}  # fmt: skip
NOT_OF_TRUST = {"precision", "stays_on_map"}


def test_every_setting_of_matching_changes_the_scale_of_the_trust_or_is_known_not_to():
    names = {name for name, setting in SETTING_FIELDS.items() if setting.group == "matching"}
    assert names == set(OF_TRUST) | NOT_OF_TRUST
    for name, value in OF_TRUST.items():
        base = PRESETS["paper" if name == "sequence_length" else "default"]
        assert replace(base, **{name: value}).of_trust != base.of_trust, name


COLUMNS = ("place", "probability", "lost")


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """A folder with a map of the place filter, and a query as a recording and as sent bytes."""
    folder, rng = tmp_path_factory.mktemp("robot"), np.random.default_rng(0)
    settings = CODED.replaced({"pixels": 5, "sigma": 1.0, "precision": 0.99}, "test")
    drive = random_events(rng, 6_000, SENSOR, 6_000_000)
    ReferenceMap.build(Drive(drive, SENSOR), settings).save(folder / "map.npz")
    # the second half of the route is another one, whose matches are improbable
    other = random_events(rng, 6_000, SENSOR, 6_000_000)
    query = join_events([drive[drive.t < 3_000_000], other[other.t >= 3_000_000]])
    write_recording(folder / "query.npz", [query], sensor=SENSOR)
    (folder / "sent.bin").write_bytes(sent_by(query, SENSOR))
    return folder


@pytest.mark.parametrize("smooth", [True, False])
def test_a_recorded_drive_that_stays_on_the_map_has_the_probabilities_of_such(robot, smooth):
    reference = ReferenceMap.load(robot / "map.npz")
    for stays in (False, True):
        changes = {"smooth": smooth, "stays_on_map": stays}
        result = reference.match(robot / "query.npz", **changes)
        matches, settings = result.matches, result.matches.settings
        assert match_descriptors(reference.places, result.queries, settings) == matches
        table = default_confidence(smooth, stays)
        assert matches.probability.tolist() == table.probability_of(matches.net_trust).tolist()
        assert matches.lost.tolist() == (matches.net_trust < table.least_trust(0.99)).tolist()


def test_each_live_path_gives_the_matches_of_a_recorded_drive_that_stays_on_the_map(
    robot, tmp_path, run
):
    def rows_of(rows):
        return [tuple(row[name] for name in COLUMNS) for row in rows]

    def of_matches(matches):
        return list(zip(*(getattr(matches, name).tolist() for name in COLUMNS), strict=True))

    names = [robot / name for name in ("map.npz", "query.npz", "sent.bin")]
    reference = ReferenceMap.load(names[0])
    changes = {"smooth": False, "stays_on_map": True}
    recorded = of_matches(reference.match(names[1], **changes).matches)
    assert {lost for _, _, lost in recorded} == {True, False}
    # the recording's last window has no event after it, so that only its end ends it
    online = of_matches(reference.match(names[1], every="window", **changes).matches)
    assert online == recorded[: len(online)] and len(recorded) - len(online) <= 1
    live = ["--online", "--every", "window", "--no-figures", "-o", tmp_path / "out"]
    run("match", *names[:2], "--stays-on-map", *live)
    assert of_matches(Matches.load(tmp_path / "out/matches.npz")) == online

    localiser = reference.localiser("window", **changes)
    rows = [localiser.update(part) for part in open_recording(names[1])]
    assert rows_of(np.concatenate(rows)) == online

    chosen = reference.matched_with(reference.settings.replaced(changes, "test"))
    with LiveSession(names[2], protocol="evpr", reference=chosen, every="window") as session:
        assert [(m.place, m.probability, m.lost) for m in session] == online
    sent = ["--port", names[2], "--protocol", "evpr", "--map", names[0], "--every", "window"]
    said = run("stream", *sent, "--stays-on-map", "--json").out.splitlines()
    assert rows_of(row for row in map(json.loads, said) if "place" in row) == online


def test_a_map_with_a_table_of_its_own_is_not_asked_for_a_shipped_one(robot, tmp_path, refused):
    own = table((0, 0.25, 8), (8, 0.999, 80))
    reference = replace(ReferenceMap.load(robot / "map.npz"), confidence=own)
    stays = reference.settings.replaced({"stays_on_map": True}, "test")
    says = "the map has a table of its own"
    for ask in (reference.match, lambda recording, **changed: reference.localiser(**changed)):
        with pytest.raises(UsageError, match=says):
            ask(robot / "query.npz", stays_on_map=True)
    reference.save(tmp_path / "map.npz")
    match = ["match", tmp_path / "map.npz", robot / "query.npz", "-o", tmp_path / "out"]
    stream = ["stream", "--port", robot / "sent.bin", "--protocol", "evpr", "--map", match[1]]
    for words in (match, [*match, "--online"], stream):
        assert says in refused(*words, "--stays-on-map")
    # a map that was made for a robot that stays on it uses the table that it learnt later
    made = replace(reference, settings=stays)
    assert made.match(robot / "query.npz").reference.acceptance.confidence is own
    # with another restart, trust has another scale than that of the map's own table
    changes = {"smooth": False, "filter_restart": 20}
    matches = reference.match(robot / "query.npz", stays_on_map=True, **changes).matches
    shipped = default_confidence(False, True)
    assert matches.probability.tolist() == shipped.probability_of(matches.net_trust).tolist()


@pytest.mark.parametrize(
    ("flag", "warned"), [("--smooth", True), ("--no-smooth", False), ("--online", False)]
)
def test_what_has_no_effect_on_such_matches_is_warned_of(flag, warned, robot, tmp_path, run):
    match = ["match", robot / "map.npz", robot / "query.npz", "--no-figures", "-o", tmp_path / "m"]
    said = run(*match, flag, "--stays-on-map").err
    assert ("--stays-on-map is for live matches" in said) == warned


def test_what_a_map_learns_does_not_depend_on_whether_the_robot_stays_on_it(robot):
    reference = ReferenceMap.load(robot / "map.npz")
    stays = reference.matched_with(reference.settings.replaced({"stays_on_map": True}, "test"))
    query = open_recording(robot / "query.npz")
    counted = count_places(query, reference.pixel_map, reference.settings)
    place, again = (align(each, counted).place for each in (reference, stays))
    assert (place == again).all() and (place >= 0).any()


@pytest.mark.slow
def test_calibrating_stores_probabilities_that_later_matches_have(tmp_path, run, refused):
    rng = np.random.default_rng(0)
    drive = random_events(rng, 6_000, SENSOR, 6_000_000)
    write_recording(tmp_path / "drive.npz", [drive], sensor=SENSOR)
    small = ["--pixels", 5, "--sigma", 1, "--tau", "100ms", "--places-per-window", 1]
    recording, first = tmp_path / "drive.npz", tmp_path / "map.npz"
    run("map", recording, "-o", first, *small)
    # as a robot matches, whose table it is to be
    match = ["match", first, recording, "--no-figures", "--no-smooth"]
    run(*match, "-o", tmp_path / "a", "--precision", 0.99)
    windows = len(Matches.load(tmp_path / "a" / "matches.npz"))
    truth = np.eye(windows, dtype=np.uint8)
    truth[:, ::7] = 0  # taken as not on the map
    np.save(tmp_path / "truth.npy", truth)
    truth_flags = ["--ground-truth", tmp_path / "truth.npy", "--rows", "reference"]
    said = run("evaluate", tmp_path / "a", *truth_flags).out
    for name in ("calibration error", "precision of the accepted", "AUROC off the map"):
        assert name in said
    sure = tmp_path / "sure.npz"
    run("calibrate", tmp_path / "a", "-o", sure)
    learnt = ReferenceMap.load(sure).confidence
    assert learnt is not None and learnt.matches.sum() == windows
    for name, flags in (("b", []), ("c", ["--online", "--every", "window"])):
        run("match", sure, recording, "-o", tmp_path / name, "--no-figures", *flags)
        again = Matches.load(tmp_path / name / "matches.npz")
        assert np.array_equal(again.probability, learnt.probability_of(again.net_trust))
    said = refused(*match, "-o", tmp_path / "d", "--precision", "0.999999")
    assert "was not reached where trust was calibrated" in said
    assert not (tmp_path / "d").exists()


def a_pair():
    settings = PRESETS["paper"].replaced({"pixels": 3, "sequence_length": 1}, "test")
    reference = a_map(settings)
    counted = descriptors(reference.places.counts)
    return MappedPair(
        reference, counted, GroundTruth(np.eye(20, dtype=bool), np.ones(20, bool), "same")
    )


def test_places_that_are_cut_out_are_right_for_no_query():
    pair = without_places(a_pair(), 5, 9)
    assert len(pair.reference) == 16
    assert np.flatnonzero(~pair.truth.has_place).tolist() == [5, 6, 7, 8]
    assert pair.match().places_in_map == 16


def test_a_spliced_drive_keeps_the_truth_of_each_window():
    jumped = carried_off(a_pair(), 4, 15)
    order = [*range(4), *range(15, 20), *range(4, 15)]
    assert jumped.truth.correct.argmax(axis=0).tolist() == order
    assert np.array_equal(jumped.counted.counts, a_pair().counted.counts[order])
    assert (np.diff(jumped.counted.start_us) > 0).all()
    away = descriptors(np.full((3, 3), 9))
    detour = with_detour(a_pair(), away, 6)
    assert np.flatnonzero(~detour.truth.has_place).tolist() == [6, 7, 8]
    assert detour.counted.counts[6:9].min() == 9 and len(detour.match()) == 23
    assert not (jumped.changes.any() or detour.changes.any())


def test_a_window_that_holds_a_change_has_the_truth_of_its_end():
    """Parts 0 to 19 are the drive, two in a window: before 5, from 15 on, and between."""
    pair = a_pair()
    jumped = carried_off(pair, 5, 15, parts=2)
    ends = [1, 3, 15, 17, 19, 6, 8, 10, 12, 14]
    assert jumped.truth.correct.argmax(axis=0).tolist() == ends
    assert np.flatnonzero(jumped.changes).tolist() == [2]  # parts 4 and 15; 19 and 5 are at an end
    counts = pair.counted.counts.astype(np.int64)
    assert np.array_equal(jumped.counted.counts[2], counts[4] + counts[15])
    away = descriptors(np.full((3, 3), 9))
    detour = with_detour(pair, away, 6, parts=2)
    assert np.flatnonzero(~detour.truth.has_place).tolist() == [3]
    assert np.flatnonzero(detour.changes).tolist() == [4]  # part 22 and part 6
    cut = spliced(without_places(pair, 5, 9), np.arange(20), parts=2)
    assert np.flatnonzero(cut.changes).tolist() == [2, 4]
    assert np.flatnonzero(sample(cut).changes).tolist() == [2, 4]


@given(trust=st.integers(0, 2**31), misfit=st.integers(-1, 1_000))
def test_net_trust_is_that_of_the_oracle(trust, misfit):
    net = net_trust(np.array([trust]), np.array([misfit]))
    assert net.tolist() == [confidence_of(trust, misfit)]


def test_matches_that_are_accepted_past_the_edge_of_the_map_are_counted():
    trust = np.array([9, 9, 9, 9, 0, 9, 0, 9, 9])
    has_place = np.array([1, 1, 0, 0, 0, 1, 0, 1, 0], dtype=np.bool_)
    drive = Sample(trust, has_place, has_place, np.zeros(9, dtype=np.bool_))
    assert windows_past_the_edge([drive], 5) == [2, 0, 1]  # the last one up to its end
    assert windows_past_the_edge([drive], 10) == []


@pytest.mark.filterwarnings("always")
def test_a_warning_is_one_line(monkeypatch, capsys):
    def run(argv):
        warnings.warn("too old", stacklevel=1)

    monkeypatch.setattr("edge_vpr_tools.cli.run", run)
    assert main([]) == 0
    assert capsys.readouterr().err == "edge-vpr: warning: too old\n"
