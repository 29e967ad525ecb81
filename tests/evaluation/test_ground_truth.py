"""Ground truth: tracks, alignments and matrices, held to the oracle and to real logs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.errors import GroundTruthError, UsageError
from edge_vpr.evaluation import ground_truth
from edge_vpr.evaluation.ground_truth import (
    Alignment,
    GroundTruth,
    from_alignment,
    from_matrix,
    from_tracks,
    load_alignment,
    load_matrix,
)
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.evaluation.tracks import Track, great_circle, interpolate
from edge_vpr.route import EARTH_RADIUS_M
from tests import naive
from tests.streams import centres

SECOND = 1_000_000


# --- tracks ---------------------------------------------------------------------------------------

points = st.lists(st.integers(0, 200), min_size=1, max_size=12, unique=True).map(sorted)


@given(
    points, st.lists(st.integers(-20, 220), min_size=1), st.none() | st.integers(1, 60), st.data()
)
def test_interpolation_is_the_oracles_to_the_bit(times, wanted, max_gap, data):
    values = data.draw(st.lists(st.integers(-1000, 1000), min_size=len(times), max_size=len(times)))
    bridged = None if max_gap is None else np.diff(times) <= max_gap
    interpolated = interpolate(wanted, times, np.array(values, dtype=float)[:, None], bridged)
    expected = [
        naive.interpolate(list(zip(times, values, strict=True)), x, max_gap) for x in wanted
    ]
    np.testing.assert_array_equal(
        interpolated[:, 0], [math.nan if e is None else e for e in expected]
    )


def test_a_track_is_unknown_before_it_after_it_and_inside_long_gaps():
    # one gap as long as allowed, one a microsecond longer
    times = [0, 5 * SECOND, 10 * SECOND + 1]
    track = Track(times, [[0.0], [10.0], [20.0]], max_gap_us=5 * SECOND)
    at = track.at([-1, 0, SECOND, times[1], 7 * SECOND, times[2], times[2] + 1])
    np.testing.assert_array_equal(at[:, 0], [np.nan, 0, 2, 10, np.nan, 20, np.nan])


def test_a_track_of_one_point_is_known_there_alone():
    track = Track([5], [[1.0, 2.0]])
    np.testing.assert_array_equal(track.at([4, 5, 6]), [[np.nan] * 2, [1.0, 2.0], [np.nan] * 2])


def test_a_track_crosses_the_180th_meridian_the_short_way():
    track = Track([0, 10], [[0.0, 179.0], [0.0, -179.0]], "geographic")
    np.testing.assert_allclose(track.at([0, 4, 5, 6, 10])[:, 1], [179, 179.8, 180, -179.8, -179])


def test_a_track_cannot_be_changed_after_its_checks():
    times, position = np.array([0, 1]), np.zeros((2, 1))
    track = Track(times, position)
    times[1] = -5
    assert track.time_us.tolist() == [0, 1]
    with pytest.raises(ValueError, match="read-only"):
        track.position[0] = 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0, 0], [[0.0], [1.0]]), "at point 1, from 0 to 0 us: .* keep one a time$"),
        (([0, 1], [[0.0]]), r"expected \(2, d\)"),
        (([], np.empty((0, 1))), "n of at least 1"),
        (([0], [[0.0, 0.0, 0.0, 0.0]]), r"d in \(1, 2, 3\)"),
        (([0], [[math.nan]]), "point 0 is not finite"),
        (([0], [[153.0, -27.0]], "geographic"), "latitude first"),
        (([0], [[1.0]], "polar"), "use geographic or metric"),
    ],
)
def test_a_track_that_is_none_says_what_is_wrong(arguments, message):
    with pytest.raises(GroundTruthError, match=message):
        Track(*arguments)


# --- truth from tracks ----------------------------------------------------------------------------


def test_great_circle_gives_known_distances():
    # a quarter of the Earth, half of it, and Nashville to Los Angeles (2887.26 km at R = 6372.8 km)
    ends = np.array([[90.0, 0.0], [0.0, 180.0], [33.94, -118.40]])
    starts = np.array([[0.0, 77.0], [0.0, 0.0], [36.12, -86.67]])
    half = math.pi * EARTH_RADIUS_M
    expected = [half / 2, half, 2887259.9506 * 6371.0088 / 6372.8]
    np.testing.assert_allclose(great_circle(starts, ends), expected, rtol=1e-9)


def tracks(kind: str):
    """Short drives along a street of Brisbane, or on a floor."""
    step = st.tuples(*[st.integers(-60, 60)] * 2)
    scale, origin = (1e-6, (-27.5, 152.9)) if kind == "geographic" else (1.0, (0.0, 0.0))
    return st.lists(step, min_size=2, max_size=8).map(
        lambda steps: Track(
            np.arange(len(steps)) * 3 * SECOND, np.cumsum(steps, axis=0) * scale + origin, kind
        )
    )


@pytest.mark.parametrize("kind", ["metric", "geographic"])
@given(st.data(), st.integers(1, 50))
def test_truth_from_tracks_is_the_oracles_however_the_matrix_is_cut(kind, data, cells):
    reference, query = data.draw(tracks(kind)), data.draw(tracks(kind))
    places, queries = centres(20), centres(25)
    tolerance = data.draw(st.integers(1, 60)) + 0.123
    expected = [
        [naive.distance(kind, a, b) for b in query.at(queries).tolist()]
        for a in reference.at(places).tolist()
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ground_truth, "BLOCK_CELLS", cells)
        if not any(d <= tolerance for row in expected for d in row):
            with pytest.raises(GroundTruthError, match="no query lies within"):
                from_tracks(reference, query, places, queries, tolerance)
            return
        patch.setattr(ground_truth, "MOST_CHANCE", 1.0)
        truth = from_tracks(reference, query, places, queries, tolerance)
    # sines of two libraries may differ in the last bit: cells on the very border are left out
    clear = ~(np.abs(np.array(expected) - tolerance) < 1e-6)
    np.testing.assert_array_equal(truth.correct[clear], (np.array(expected) <= tolerance)[clear])
    np.testing.assert_array_equal(truth.placed, places <= reference.time_us[-1])
    # of a query without a correct place, the log says nothing if the reference can have been there
    ends, start = reference.time_us[-1], reference.position[-1].tolist()
    steps = zip(reference.position[1:].tolist(), reference.position[:-1].tolist(), strict=True)
    speed = np.quantile([naive.distance(kind, a, b) / 3 for a, b in steps], 0.95)
    away = np.array([naive.distance(kind, start, b) for b in query.at(queries).tolist()])
    reach = tolerance + speed * np.maximum(0, places - ends)[:, None] / 1e6
    near = (away <= reach) & (places > ends)[:, None]
    maybe = near.any(axis=0) & ~truth.has_place
    np.testing.assert_array_equal(truth.has_truth, (queries <= query.time_us[-1]) & ~maybe)
    # a match with a place after the log's end is wrong, unless the reference can have been there
    unsure = np.abs(away - reach) < 1e-6
    judged = truth.judged(*np.indices(truth.correct.shape))
    np.testing.assert_array_equal(judged[~unsure], (truth.has_truth & ~near)[~unsure])
    np.testing.assert_array_equal(truth.has_place, truth.correct.any(axis=0))


def test_a_truth_that_more_than_half_of_all_pairs_pass_is_refused():
    here = Track([0, 4 * SECOND], [[0.0], [4.0]])
    assert from_tracks(here, here, centres(4), centres(4), 0.9).chance == 0.25
    assert from_matrix(np.eye(2), 2, 2, rows="query").chance == 0.5
    for truth in (
        lambda: from_tracks(here, here, centres(4), centres(4), 1.0),
        lambda: from_alignment(Alignment([[0, 0], [9, 9]], "s"), centres(4), centres(4), 1.0),
        lambda: from_matrix(np.tri(4), 4, 4, rows="query"),
    ):
        with pytest.raises(GroundTruthError, match=r"^6[23]% of all pairs of place and query coun"):
            truth()


def test_the_description_counts_what_is_known():
    reference, query = (
        Track([0, 10 * SECOND], [[0.0], [10.0]], max_gap_us=10 * SECOND) for _ in range(2)
    )
    truth = from_tracks(reference, query, centres(8), centres(14), 1.0)
    assert truth.description == (
        "metric tracks at 1 m, 8 of 8 places with a position; "
        "10 of 14 windows known, 9 with a place"
    )


def test_tracks_that_cannot_be_compared_or_never_meet_are_refused():
    here = Track([0, 4 * SECOND], [[0.0], [4.0]])
    far = Track([0, 4 * SECOND], [[1000.0], [1004.0]])
    flat = Track([0, 4 * SECOND], [[0.0, 0.0], [4.0, 0.0]])
    earth = Track([0, 4 * SECOND], [[0.0, 0.0], [4.0, 0.0]], "geographic")
    sparse = Track([0, 9 * SECOND], [[0.0], [9.0]])
    for other in (flat, earth):
        with pytest.raises(GroundTruthError, match="give two tracks of one kind"):
            from_tracks(here, other, centres(3), centres(3), 1.0)
    late_us, sparse_says = centres(3) + 60 * SECOND, r"reference track covers 0 to 9 s in 2 points"
    for reference, query, queries_us, tolerance, says in (
        (
            here,
            far,
            centres(3),
            1.0,
            "no query lies within 1 m of any place, the nearest 998 m away",
        ),
        (sparse, here, centres(3), 1.0, f"{sparse_says} .* 9 s apart.*, or give max_gap_s="),
        (here, here, late_us, 1.0, r"query track covers 0 to 4 s .* give the log of this"),
        (here, here, centres(3), math.nan, "tolerance nan is not a distance"),
        (here, here, [], 1.0, "at least one"),
    ):
        with pytest.raises(GroundTruthError, match=says):
            from_tracks(reference, query, centres(3), queries_us, tolerance)


def test_gps_at_70_m_confirms_the_published_matches_of_sunset_1_and_2(shared_data):
    """Every published match of a query whose position is known lies within 50 m, and so within 70.

    The matrix matches 711 of 724 queries. 10 of these come after the GPS log has ended, 714 s in:
    their truth is unknown here. The other 701 all agree. The 13 queries that the matrix leaves
    without a match lie within 70 m of a place.
    """
    folder = shared_data / "brisbane_sparse49"
    with np.load(folder / "gt_query_sunset1_reference_sunset2.npz") as archive:
        published = archive["gt"].T.astype(bool)
    reference, query = (load_track(folder / f"sunset{number}.nmea") for number in (2, 1))
    places, queries = published.shape
    for tolerance_m in (50.0, 70.0):
        truth = from_tracks(reference, query, centres(places), centres(queries), tolerance_m)
        matched = published.any(axis=0)
        agrees = (published & truth.correct).any(axis=0)
        assert (matched.sum(), (matched & truth.has_truth).sum(), agrees.sum()) == (711, 701, 701)
        np.testing.assert_array_equal(np.flatnonzero(~truth.has_truth), np.arange(714, 724))
        assert truth.has_place[~matched].all()
    # the match and the position fit best without an offset between counts and GPS
    j = np.flatnonzero(matched & truth.has_truth)
    k = published[:, j].argmax(axis=0)
    at = query.at(centres(queries))[j]
    medians = {
        shift: np.nanmedian(great_circle(at, reference.at(centres(places) + shift * SECOND)[k]))
        for shift in (-1, 0, 1)
    }
    assert medians[0] < 5 < 10 < min(medians[-1], medians[1])


# --- truth from an alignment ----------------------------------------------------------------------


@given(points.filter(lambda p: len(p) > 1), st.data(), st.integers(0, 30), st.integers(1, 50))
def test_truth_from_an_alignment_is_the_oracles(times, data, tolerance, cells):
    values = data.draw(st.lists(st.integers(0, 60), min_size=len(times), max_size=len(times)))
    pairs = list(zip(times, values, strict=True))
    alignment = Alignment(pairs, "s")
    queries, places = np.arange(0, 220, 7), np.arange(0, 60, 2)
    expected = [naive.interpolate(pairs, int(q)) for q in queries]
    correct = [[e is not None and abs(k - e) <= tolerance for e in expected] for k in places]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ground_truth, "BLOCK_CELLS", cells)
        if not np.any(correct):
            with pytest.raises(GroundTruthError):
                from_alignment(alignment, places * SECOND, queries * SECOND, tolerance)
            return
        patch.setattr(ground_truth, "MOST_CHANCE", 1.0)
        truth = from_alignment(alignment, places * SECOND, queries * SECOND, tolerance)
    np.testing.assert_array_equal(truth.correct, correct)
    np.testing.assert_array_equal(truth.has_truth, [e is not None for e in expected])


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("query_frame,reference_frame\n100,270\n340,440\n", "frame"),
        ("reference_frame, query_frame\n270,100\n440,340\n", "frame"),
        ("query_s,reference_s\n100,270\n340,440\n", "s"),
        ("reference_time_s,query_time_s\n270,100\n440,340\n", "s"),
    ],
)
def test_the_header_says_which_column_is_the_query_and_the_unit(tmp_path, text, unit):
    path = tmp_path / "alignment.csv"
    path.write_text(text)
    alignment = load_alignment(path)
    assert alignment.unit == unit
    assert alignment.pairs.tolist() == [[100.0, 270.0], [340.0, 440.0]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("query,reference\n0,0\n1,1\n", "expected query_frame,reference_frame"),
        ("query_frame,reference_s\n0,0\n1,1\n", "expected query_frame,reference_frame"),
        ("query_s,query_s\n0,0\n1,1\n", "expected query_frame,reference_frame"),
        ("query_s,reference_s,note_s\n0,0,0\n1,1,1\n", "expected query_frame,reference_frame"),
        ("query_s,reference_s\n0,0\n", "n at least 2"),
        ("query_s,reference_s\n1,0\n0,1\n", "point 1 is at query 0 after 1"),
        ("query_s,reference_s\n0,0\n1,-1\n2,-1\n", "2 points at reference -1, before the drive"),
    ],
)
def test_an_alignment_that_leaves_a_question_is_refused(tmp_path, text, message):
    path = tmp_path / "alignment.csv"
    path.write_text(text)
    with pytest.raises(GroundTruthError, match=message):
        load_alignment(path)


def test_frames_need_their_period():
    alignment = Alignment(np.array([[0.0, 0.0], [9.0, 9.0]]), "frame")
    assert repr(alignment) == "Alignment(2 pairs, in 'frame')"
    assert alignment.coordinate([0, 50_000], "1/30").tolist() == [0.0, 1.5]
    with pytest.raises(GroundTruthError, match="pass frame_period="):
        alignment.coordinate([0])
    with pytest.raises(UsageError, match=r"frame period 0\.0 is no positive number"):
        alignment.coordinate([0], 0.0)
    with pytest.raises(GroundTruthError, match="unit 'frames' is unknown: use s or frame"):
        alignment._replace(unit="frames").coordinate([0])
    assert alignment._replace(unit="s").coordinate([1_500_000]).tolist() == [1.5]


def test_the_wrong_unit_shows_in_the_error():
    alignment, seconds = Alignment([[100, 270], [3640, 3283]], "s"), np.arange(0.5, 9) * SECOND
    with pytest.raises(GroundTruthError, match=r"covers query 100 to 3640 .* lie at 0.5 to 8.5"):
        from_alignment(alignment, seconds, seconds, 60)
    with pytest.raises(GroundTruthError, match="no place lies within 60 of an aligned query"):
        from_alignment(alignment, seconds, np.arange(100, 200) * SECOND, 60)
    with pytest.raises(UsageError, match=r"give what load_alignment returned, or Alignment\("):
        from_alignment(alignment.pairs, seconds, seconds, 60)


def test_speck_walks_has_truth_for_the_queries_that_its_alignment_covers(shared_data):
    alignment = load_alignment(shared_data / "speck_walks/ground_truth.csv")
    frames = np.arange(30 // 2, 3723, 30)  # centres of windows of 30 frames
    places = np.arange(30 // 2, 3453, 30)
    truth = from_alignment(alignment, places * SECOND, frames * SECOND, 60, frame_period=1)
    np.testing.assert_array_equal(truth.has_truth, (frames >= 100) & (frames <= 3640))
    np.testing.assert_array_equal(truth.has_place, truth.has_truth)
    # 60 frames either side hold 4 windows of 30, or 5 where one lies right in the middle
    assert set(truth.correct[:, truth.has_truth].sum(axis=0).tolist()) <= {4, 5}


# --- truth from a matrix --------------------------------------------------------------------------


def test_a_matrix_lies_as_its_rows_are_said_to():
    matrix = np.array([[1, 0, 0], [0, 1, 0]])
    by_place = from_matrix(matrix, 2, 3, rows="reference")
    by_query = from_matrix(matrix, 3, 2, rows="query")
    np.testing.assert_array_equal(by_place.correct, matrix == 1)
    np.testing.assert_array_equal(by_query.correct, matrix.T == 1)
    assert by_place.has_truth.all()
    assert by_place.has_place.tolist() == [True, True, False]


def test_a_matrix_that_fits_the_other_way_round_says_so():
    with pytest.raises(GroundTruthError) as error:
        from_matrix(np.eye(724, 641), 641, 724, rows="reference")
    assert str(error.value) == (
        "ground-truth matrix has shape (724, 641), expected (641, 724) for rows='reference': "
        "pass rows='query'"
    )


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.zeros((2, 3)), "all zero"),
        (np.full((2, 3), 0.5), "holds 0.5 at row 0, column 0"),
        (np.full((2, 3), math.nan), "holds nan"),
        (np.ones((2, 4)), r"has shape \(2, 4\), expected \(2, 3\) .* windows that it was made for"),
        (np.ones((1, 3)), "places at half windows; make the map with places_per_window=1"),
        (np.ones(6), r"has shape \(6,\)"),
    ],
)
def test_a_matrix_that_is_no_truth_is_refused(matrix, message):
    with pytest.raises(GroundTruthError, match=message):
        from_matrix(matrix, 2, 3, rows="reference")


def test_what_the_rows_stand_for_is_never_guessed():
    with pytest.raises(TypeError):
        from_matrix(np.eye(2), 2, 2)
    with pytest.raises(GroundTruthError, match="pass rows='reference' or rows='query'"):
        from_matrix(np.eye(2), 2, 2, rows="auto")


def test_a_matrix_is_the_same_from_any_kind_of_file(tmp_path):
    matrix = np.eye(3, 4, dtype=np.uint8)
    np.save(tmp_path / "a.npy", matrix)
    np.savez(tmp_path / "b.npz", matrix)
    np.savez(tmp_path / "c.npz", gt=matrix, note=np.array("x"))
    np.savetxt(tmp_path / "d.csv", matrix, delimiter=",", fmt="%d")
    for path in sorted(tmp_path.iterdir()):
        np.testing.assert_array_equal(load_matrix(path), matrix, err_msg=path.name)


def test_a_file_without_a_matrix_says_why(tmp_path):
    np.savez(tmp_path / "two.npz", a=np.eye(2), b=np.eye(2))
    np.save(tmp_path / "cube.npy", np.zeros((2, 2, 2)))
    np.save(tmp_path / "object.npy", np.array([None]), allow_pickle=True)
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 and no more")
    (tmp_path / "empty.npy").write_bytes(b"")
    (tmp_path / "words.csv").write_text("one,two\n")
    for name, message in {
        "two.npz": "holds the arrays a, b: name the matrix gt",
        "cube.npy": r"float64 of shape \(2, 2, 2\)",
        "object.npy": "not a matrix of numbers",
        "broken.npz": "not a matrix of numbers",
        "empty.npy": "not a matrix of numbers",
        "words.csv": "not a matrix of numbers",
        "absent.csv": "cannot be read",
        "absent.npz": "cannot be read",
        "matrix.mat": "give a .npz, .npy or .csv file",
    }.items():
        with pytest.raises(GroundTruthError, match=message) as error:
            load_matrix(tmp_path / name)
        assert "\n" not in str(error.value)


def test_a_matrix_that_announces_more_than_its_file_holds_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.eye(3))
    raw = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(raw.replace(b"(3, 3), }      ", b"(99999, 99999), }"[:15]))
    (tmp_path / "b.npy").write_bytes(raw.replace(b"(3, 3), }        ", b"(99999, 9999), }"[:17]))
    for name in ("a.npy", "b.npy"):
        with pytest.raises(GroundTruthError, match=name):
            load_matrix(tmp_path / name)


def test_a_truth_that_contradicts_itself_is_refused():
    has_truth = np.array([True, False])
    with pytest.raises(GroundTruthError, match="unknown truth has a correct place"):
        GroundTruth(np.ones((3, 2), dtype=bool), has_truth, "")
    with pytest.raises(GroundTruthError, match="give one value per query"):
        GroundTruth(np.zeros((3, 3), dtype=bool), has_truth, "")
    with pytest.raises(GroundTruthError, match="give bool arrays"):
        GroundTruth(np.zeros((3, 2)), has_truth, "")


def test_a_truth_above_its_size_is_refused(monkeypatch):
    monkeypatch.setattr(ground_truth, "MOST_CELLS", 1_000)
    drive = Track(np.arange(41) * SECOND, np.arange(41.0)[:, None])
    with pytest.raises(GroundTruthError, match=r"35 queries and 40 places .* part of the drive"):
        from_tracks(drive, drive, centres(40), centres(35), 6.0)
