"""The matrix of distances: what every match is the least of, and finite everywhere."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr import Matches, ReferenceMap
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.errors import MissingExtraError, UsageError
from edge_vpr.events import Sensor
from edge_vpr.matching import drive as module
from edge_vpr.matching.drive import match_descriptors, query_distances
from edge_vpr.recordings import open_recording
from edge_vpr.settings import Settings
from tests import naive
from tests.streams import descriptors, map_of_counts, write_drives

SENSOR = Sensor(16, 12)


def distances_of(reference, query, settings):
    """The matrix of counts, shape (K, J) and (Q, J)."""
    x = np.arange(reference.shape[1])
    settings = replace(settings, pixels=x.size)
    route = map_of_counts(PixelMap(SENSOR, x, np.zeros_like(x)), reference, settings)
    return query_distances(route, descriptors(query))


@given(
    seed=st.integers(0, 2**32), places=st.integers(1, 12), queries=st.integers(1, 9), data=st.data()
)
def test_a_sequence_that_leaves_the_matrix_counts_what_is_inside(seed, places, queries, data):
    rng = np.random.default_rng(seed)
    reference, query = rng.integers(0, 50, (places, 3)), rng.integers(0, 50, (queries, 3))
    length = data.draw(st.integers(1, min(places, queries)))
    settings = Settings(sequence_length=length)
    matrix = distances_of(reference, query, settings)
    before = length // 2
    plain = naive.distance_matrix(reference.tolist(), query.tolist())
    for k in range(places):
        for q in range(queries):
            inside = [
                plain[k + i][q + i]
                for i in range(-before, length - before)
                if 0 <= k + i < places and 0 <= q + i < queries
            ]
            assert matrix[k, q] == sum(inside) / len(inside)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("matching", ["sequence", "filter"])
def test_a_match_is_where_its_column_is_least(smooth, matching):
    rng = np.random.default_rng(1)
    reference = rng.integers(0, 9, (40, 6))
    query = np.maximum(reference[5:30] + rng.integers(-2, 3, (25, 6)), 0)
    settings = Settings(matching=matching, smooth=smooth and matching == "filter")
    places, queries = descriptors(reference), descriptors(query)
    matrix = distances_of(reference, query, settings)
    assert matrix.shape == (40, 25)
    assert np.isfinite(matrix).all()
    matches = match_descriptors(places, queries, settings)
    columns = matrix[:, matches.query]
    if matching == "sequence":
        inner = slice(2, 38)
        assert np.array_equal(columns[inner].argmin(axis=0) + 2, matches.place)
        assert np.array_equal(columns[inner].min(axis=0), matches.distance)
    else:
        assert np.array_equal(columns.argmin(axis=0), matches.place)
        assert np.array_equal(columns.min(axis=0), matches.distance)


def test_a_matrix_that_would_fill_the_memory_is_refused(monkeypatch):
    monkeypatch.setattr(module, "MOST_BYTES", 100)
    some = np.ones((9, 2), np.int64)
    with pytest.raises(UsageError, match="read a part"):
        distances_of(some, some, Settings())


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    write_drives(folder, 3_000, SENSOR, 1_500_000)
    settings = Settings(pixels=5, sigma=1.0, tau_us=100_000, sequence_length=3)
    ReferenceMap.build(open_recording(folder / "reference.npz"), settings).save(folder / "map.npz")
    return folder


@pytest.mark.slow
def test_match_writes_the_matrix_and_figures_in_the_formats_that_are_named(
    drives, tmp_path, run, refused
):
    command = f"match {drives}/map.npz {drives}/query.npz -o {tmp_path}/out"
    matrix = tmp_path / "d.npy"
    run(*f"{command} --matrix {matrix} --figures pdf,svg".split())
    saved = np.load(matrix)
    assert saved.dtype == np.float64
    assert np.isfinite(saved).all()
    queries = Matches.load(tmp_path / "out/matches.npz").query[-1] + 2  # L = 3, in the middle
    assert saved.shape == (len(ReferenceMap.load(drives / "map.npz")), queries)
    pictures = {path.suffix for path in (tmp_path / "out").glob("pixels.*")}
    assert pictures == {".pdf", ".svg"}
    assert (tmp_path / "out/pixels.pdf").read_bytes().startswith(b"%PDF")
    assert "<svg" in (tmp_path / "out/pixels.svg").read_text()
    assert "data:image/png;base64" in (tmp_path / "out/report.html").read_text()
    for words, message in (
        (f"{command} --overwrite --matrix {matrix}x", "does not end in .npy"),
        (f"{command} --overwrite --online --matrix {matrix}2.npy", "leave one out"),
        (f"{command} --overwrite --figures jpeg", "no format of figures"),
        (f"{command}2 --matrix {matrix}", "name another, or replace it"),
    ):
        assert message in refused(*words.split())
    run(*f"{command} --overwrite --no-figures --matrix {matrix}".split())


def test_a_table_of_matches_needs_pandas(monkeypatch):
    some = descriptors([[1, 2, 3]] * 4)
    matches = match_descriptors(some, some, Settings(sequence_length=2))
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match="pandas"):
        matches.to_frame()


@pytest.mark.slow
def test_a_report_has_metres_after_an_evaluation_and_seconds_before(drives, tmp_path, run):
    """Metres come from the tracks, seconds from the windows themselves."""
    out, online = tmp_path / "out", tmp_path / "online"
    match = f"match {drives}/map.npz {drives}/query.npz"
    run(*f"{match} -o {out}".split())
    run(*f"{match} --online --every window -o {online}".split())
    for folder in (out, online):
        page = (folder / "report.html").read_text()
        assert "time of the reference drive (s)" in page
        assert "distance along the route (m)" not in page
    assert "time of the query drive (s)" in (out / "report.html").read_text()
    (tmp_path / "track.csv").write_text("time_s,position_m\n-1,-10\n3,30\n")
    tracks = f"{tmp_path}/track.csv {tmp_path}/track.csv --offset 0 0 --tolerance 2"
    run(*f"evaluate {out} --ground-truth {tracks}".split())
    page = (out / "report.html").read_text()
    assert "distance along the route (m)" in page
    assert "time of the reference drive (s)" not in page
