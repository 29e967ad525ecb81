"""Distances between descriptors: matrices, single queries, and all pixels instead of 150."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from table import OURS

from edge_vpr.matching.distances import ReferenceIndex

J, ALL_PIXELS = 150, 346 * 260


def counts(rows, columns, seed):
    return np.random.default_rng(seed).integers(0, 256, (rows, columns), dtype=np.uint8)


def plain(reference, queries):
    """Return the distances by NumPy, which all results must equal."""
    wide = reference.astype(np.int64)
    return np.stack([np.abs(wide - query).sum(axis=1) for query in queries], axis=1)


def by_faiss(reference, queries):
    faiss = pytest.importorskip("faiss", reason="faiss-cpu is not installed")
    faiss.omp_set_num_threads(1)
    a, b = reference.astype(np.float32), queries.astype(np.float32)
    return lambda: faiss.pairwise_distances(a, b, faiss.METRIC_L1)


def by_faiss_index(reference, queries):
    """Search by an index of Faiss, which sorts the distances."""
    faiss = pytest.importorskip("faiss", reason="faiss-cpu is not installed")
    faiss.omp_set_num_threads(1)
    index = faiss.IndexFlat(reference.shape[1], faiss.METRIC_L1)
    index.add(reference.astype(np.float32))
    b = queries.astype(np.float32)
    return lambda: index.search(b, 1)[0].T


def by_opencv(reference, queries):
    """Search by OpenCV, which finds the nearest place in the same pass."""
    cv2 = pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    cv2.setNumThreads(1)
    how = {"dtype": cv2.CV_32S, "normType": cv2.NORM_L1, "K": 1}
    return lambda: cv2.batchDistance(queries, reference, **how)[0].T


def by_scipy(reference, queries):
    distance = pytest.importorskip("scipy.spatial.distance", reason="scipy is not installed")
    a, b = reference.astype(np.float64), queries.astype(np.float64)
    return lambda: distance.cdist(a, b, "cityblock")


def by_torch(reference, queries):
    torch = pytest.importorskip("torch", reason="torch is not installed")
    torch.set_num_threads(1)
    a, b = (torch.from_numpy(rows.astype(np.float32)) for rows in (reference, queries))
    return lambda: torch.cdist(a, b, p=1)


def by_numpy(reference, queries):
    a, b = reference.astype(np.int16), queries.astype(np.int16)
    return lambda: np.stack([np.abs(a - query).sum(axis=1, dtype=np.int32) for query in b], axis=1)


@njit
def read(words, times):
    """Read every word so many times; an OR of all of them costs less than anything else."""
    seen = np.uint64(0)
    for _ in range(times):
        for i in range(words.size):
            seen |= words[i]
    return seen


def reading(rows, times):
    """Read packed rows of 160 bytes, as often as the work does."""
    words = np.zeros(rows * 160 // 8, dtype=np.uint64)
    return lambda: read(words, times)


def bench_matrix(race, contestant):
    """Race on 641 x 724 places, the size of a pair of Brisbane traverses."""
    work = "distance matrix 641 x 724, 150 pixels, 8 bits"
    run(race, contestant, work, counts(641, J, 1), counts(724, J, 2))


def bench_single_query(race, contestant):
    """Race on one query, as on a robot with a long route."""
    work = "one query against 20,000 places, 150 pixels, 8 bits"
    run(race, contestant, work, counts(20_000, J, 3), counts(1, J, 4))


@pytest.mark.parametrize("places", [100_000, 1_000_000])
def bench_long_route(race, contestant, places):
    """Race on one query against more places than a cache holds."""
    work = f"one query against {places:,} places, 150 pixels, 8 bits"
    run(race, contestant, work, counts(places, J, 3), counts(1, J, 4))


def run(race, contestant, work, reference, queries):
    """Race on these counts; a limit has no result to compare."""
    library, make, how = contestant
    expected = plain(reference, queries)
    if library.endswith("nearest only"):
        expected = expected.min(axis=0)[None]
    expected = None if how.get("limit") else expected
    race(work, library, make(reference, queries), expected, **how)


def one_by_one(reference, queries):
    index, query = ReferenceIndex(reference), queries[0]
    return lambda: index.distances(query)[:, None]


FIELDS = {
    bench_matrix: (
        (OURS, lambda r, q: lambda: ReferenceIndex(r).matrix(q), {"rounds": 100}),
        ("OpenCV batchDistance, nearest only", by_opencv, {}),
        ("faiss pairwise_distances L1", by_faiss, {"target": 5}),
        ("faiss IndexFlat, nearest only", by_faiss_index, {"target": 5}),
        ("scipy cdist cityblock", by_scipy, {"target": 18}),
        ("torch.cdist p=1", by_torch, {"target": 28}),
        ("NumPy", by_numpy, {"rounds": 5}),
        (
            "reading all queries for each place",
            lambda r, q: reading(len(q), len(r)),
            {"limit": True, "rounds": 100},
        ),
    ),
    bench_single_query: (
        (OURS, one_by_one, {"rounds": 500}),
        ("OpenCV batchDistance, nearest only", by_opencv, {"rounds": 100}),
        ("faiss pairwise_distances L1", by_faiss, {"rounds": 100, "target": 5}),
        ("faiss IndexFlat, nearest only", by_faiss_index, {"rounds": 100, "target": 5}),
        ("torch.cdist p=1", by_torch, {"rounds": 100, "target": 20}),
        ("NumPy", by_numpy, {"rounds": 50}),
        ("reading all places", lambda r, q: reading(len(r), 1), {"limit": True, "rounds": 500}),
    ),
    bench_long_route: (
        (OURS, one_by_one, {}),
        ("OpenCV batchDistance, nearest only", by_opencv, {}),
        ("reading all places", lambda r, q: reading(len(r), 1), {"limit": True}),
    ),
}


def pytest_generate_tests(metafunc):
    if "contestant" in metafunc.fixturenames:
        field = FIELDS[metafunc.function]
        metafunc.parametrize("contestant", field, ids=[library for library, *_ in field])


@pytest.mark.parametrize(
    ("library", "pixels", "make", "how"),
    [
        (OURS, J, one_by_one, {"rounds": 500}),
        ("edge-vpr with all 89,960 pixels", ALL_PIXELS, one_by_one, {"target": 600}),
        ("NumPy with all 89,960 pixels", ALL_PIXELS, by_numpy, {"rounds": 5, "target": 600}),
    ],
)
def bench_sparse(race, library, pixels, make, how):
    """Compare 150 pixels with all of them (the paper: 50 times faster)."""
    reference, queries = counts(641, pixels, 5), counts(1, pixels, 6)
    expected = plain(reference, queries)
    work = "one query against 641 places, 150 pixels of 346 x 260"
    race(work, library, make(reference, queries), expected, **how)
