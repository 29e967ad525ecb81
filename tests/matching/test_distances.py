"""Distances and best matches equal the oracle for any integers, and never wrap."""

from __future__ import annotations

import os
import re

import llvmlite.binding as llvm
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from edge_vpr.errors import UsageError
from edge_vpr.matching import distances as sad
from edge_vpr.matching.distances import ReferenceIndex, typical_distances
from edge_vpr.matching.search import best_matches
from firmware_model import specification_drive
from tests import naive

SEEDS = st.integers(0, 2**32)
# the ends of each width, and steps over them
CORNERS = [0, 1, 127, 128, 254, 255, 256, 300, 65534, 65535, 65536, 70_000, 2**31 - 1, 2**32 - 1]
DTYPES = [np.uint8, np.int8, np.uint16, np.int16, np.uint32, np.int32, np.uint64, np.int64]


def random_counts(rng, rows, J, dtype, below):
    """Counts up to the dtype's or the given limit, negative ones too, half of them corners."""
    info = np.iinfo(dtype)
    high = min(info.max, below)
    low = max(info.min, -high)
    corners = [c for value in CORNERS for c in (value, -value) if low <= c <= high]
    counts = np.where(
        rng.random((rows, J)) < 0.5,
        rng.choice(corners, (rows, J)),
        rng.integers(low, high, (rows, J), endpoint=True),
    )
    return counts.astype(dtype)


@pytest.mark.slow
@given(
    seed=SEEDS,
    K=st.integers(1, 9),
    Q=st.integers(0, 9),
    J=st.sampled_from([1, 2, 15, 16, 31, 32, 33, 63, 64, 65, 97, 150, 255, 256, 257, 300]),
    dtypes=st.tuples(st.sampled_from(DTYPES), st.sampled_from(DTYPES)),
    limits=st.tuples(*[st.sampled_from([1, 255, 65535, 2**32 - 1])] * 2),
)
def test_distances_equal_the_oracle_for_any_integers(seed, K, Q, J, dtypes, limits):
    rng = np.random.default_rng(seed)
    reference = random_counts(rng, K, J, dtypes[0], limits[0])
    queries = random_counts(rng, Q, J, dtypes[1], limits[1])
    index = ReferenceIndex(reference)
    matrix = index.matrix(queries)
    assert matrix.tolist() == naive.distance_matrix(reference.tolist(), queries.tolist())
    assert matrix.dtype in (np.int32, np.int64)
    rows = index.rows(queries)
    assert np.array_equal(rows, matrix.T) and rows.flags.c_contiguous
    assert rows.dtype == matrix.dtype
    for j, query in enumerate(queries):
        assert np.array_equal(index.distances(query), matrix[:, j])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(("K", "Q"), [(3, 700), (700, 3)])
def test_more_places_than_a_cache_tile_are_all_compared(dtype, K, Q):
    rng = np.random.default_rng(5)
    reference = rng.integers(0, np.iinfo(dtype).max, (K, 40), dtype=dtype, endpoint=True)
    queries = rng.integers(0, np.iinfo(dtype).max, (Q, 40), dtype=dtype, endpoint=True)
    matrix = ReferenceIndex(reference).matrix(queries)
    assert matrix.tolist() == naive.distance_matrix(reference.tolist(), queries.tolist())


def test_rows_longer_than_a_cache_tile_are_summed_to_their_end():
    reference = np.arange(60_000, dtype=np.uint16).reshape(2, 30_000)
    query = reference[::-1] // 2
    matrix = ReferenceIndex(reference).matrix(query)
    assert matrix.tolist() == naive.distance_matrix(reference.tolist(), query.tolist())


@pytest.mark.parametrize(
    ("J", "reference", "query", "dtype"),
    [
        (32_768, 65_535, 0, np.int32),  # the largest sum that 31 bits hold is 2**31 - 1
        (32_769, 65_535, 0, np.int64),
        (32_769, 0, 65_535, np.int64),
        (1, 0, 2**31 - 1, np.int32),
        (1, 0, 2**31, np.int64),
        (1, 2**31 - 1, 0, np.int32),
        (1, 2**31, 0, np.int64),
        (2, -(2**32), 2**32, np.int64),
    ],
)
def test_a_sum_beyond_31_bits_widens_the_result_and_never_wraps(J, reference, query, dtype):
    # two places span the range, so that the packing cannot move it out of sight
    places = np.array([[reference] * J, [0] * J])
    matrix = ReferenceIndex(places).matrix(np.array([[query] * J]))
    assert matrix.tolist() == [[J * abs(reference - query)], [J * abs(query)]]
    assert matrix.dtype == dtype


def test_without_pixels_every_distance_is_zero():
    assert (
        ReferenceIndex(np.empty((3, 0), int)).matrix(np.empty((2, 0), int)).tolist() == [[0, 0]] * 3
    )


def test_layout_and_write_protection_of_the_input_do_not_matter():
    rng = np.random.default_rng(0)
    whole = rng.integers(0, 256, (12, 80), dtype=np.uint8)
    strided = whole[::2, ::-2]
    strided.flags.writeable = False
    expected = naive.distance_matrix(strided.tolist(), strided.tolist())
    assert ReferenceIndex(strided).matrix(np.asfortranarray(strided)).tolist() == expected


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ReferenceIndex([1, 2]), "reference: int64 of shape"),
        (lambda: ReferenceIndex([[0.5]]), "reference: float64"),
        (lambda: ReferenceIndex([[True]]), "reference: bool"),
        (lambda: ReferenceIndex(np.array([[2**63]], dtype=np.uint64)), "exceed 32 bits"),
        (lambda: ReferenceIndex([[-(2**62)]]), "exceed 32 bits"),
        (lambda: ReferenceIndex([[1, 2]]).matrix([[1]]), "have 1 counts and the reference 2"),
        (lambda: ReferenceIndex([[1, 2]]).distances([1]), "have 1 counts and the reference 2"),
        (lambda: ReferenceIndex([[1, 2**20]]).distances([1]), "have 1 counts and the reference 2"),
        (lambda: ReferenceIndex([[1, 2]]).distances([[1, 2]]), "descriptor: int64 of shape"),
        (lambda: best_matches(np.zeros(2), 3), "give 2 dimensions"),
        (lambda: best_matches(np.empty((0, 4)), 3), "at least one"),
    ],
)
def test_what_cannot_be_matched_is_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()


def plain_best(distances: list[int], exclusion: int) -> tuple[int, int, int]:
    """Best place, runner-up and ties by their definitions; `min` takes the lowest of equals."""
    places = range(len(distances))
    best = min(places, key=distances.__getitem__)
    outside = [k for k in places if abs(k - best) > exclusion]
    second = min(outside, key=distances.__getitem__, default=-1)
    return best, second, distances.count(distances[best]) - 1


@given(
    seed=SEEDS,
    K=st.integers(1, 12),
    Q=st.integers(0, 8),
    exclusion=st.integers(0, 13),
    largest=st.sampled_from([0, 2, 9, 2**31 - 1]),
    dtype=st.sampled_from([np.int32, np.int64, np.float64]),
)
def test_best_matches_equal_their_definition(seed, K, Q, exclusion, largest, dtype):
    rng = np.random.default_rng(seed)
    matrix = rng.integers(largest // 2, largest, (K, Q), endpoint=True).astype(dtype)
    expected = [plain_best(matrix[:, j].tolist(), exclusion) for j in range(Q)]
    assert (
        list(zip(*(a.tolist() for a in best_matches(matrix, exclusion)), strict=True)) == expected
    )


compiled = pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="needs the compiler")


@pytest.fixture(scope="module")
def kernel_ir() -> str:
    """LLVM IR of the kernel for 8-bit counts, without its entry from Python.

    Numba's own reference counting, which that entry needs, speaks this machine's language.
    """
    kernel = njit(sad._add_sad)
    row = np.zeros((1, sad.PAD), dtype=np.uint8)
    kernel(row, row, np.zeros((1, 1), dtype=np.int32))
    text = kernel.inspect_llvm(kernel.signatures[0])
    body = re.search(r"^define .*?_add_sad.*?^}$", text, re.MULTILINE | re.DOTALL)
    declared = re.findall(
        r"^(?:declare .*@llvm\.(?!x86|aarch64)|attributes).*$", text, re.MULTILINE
    )
    body_text = re.sub(r", !llvm\.loop !\d+", "", body.group())
    return "\n".join([body_text, *declared])


@pytest.mark.slow
@compiled
@pytest.mark.parametrize(
    ("triple", "cpu", "instructions"),
    [
        ("aarch64-unknown-linux-gnu", "cortex-a76", ["uabd", "udot"]),
        ("aarch64-unknown-linux-gnu", "cortex-a53", ["uabd", "uaddl"]),
        ("x86_64-unknown-linux-gnu", "haswell", ["vpsadbw"]),
        ("x86_64-unknown-linux-gnu", "znver4", ["vpsadbw"]),
    ],
)
def test_each_processor_gets_its_own_instructions(kernel_ir, triple, cpu, instructions):
    """Emit assembly for the boards and desktops that matter, none of which need be this machine."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    try:
        machine = llvm.Target.from_triple(triple).create_target_machine(cpu=cpu, opt=3)
    except RuntimeError:
        pytest.skip(f"this llvmlite cannot emit {triple}")
    module = llvm.parse_assembly(kernel_ir)
    module.triple, module.data_layout = triple, str(machine.target_data)
    # what this machine's code generator expanded in the IR, the target's optimiser folds again
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=3))
    passes.getModulePassManager().run(module, passes)
    assembly = machine.emit_assembly(module)
    for instruction in instructions:
        if instruction == "udot" and llvm.llvm_version_info < (22,):
            continue  # older ones add in two steps
        assert f"\t{instruction}" in assembly


@given(
    seed=st.integers(0, 2**32),
    places=st.integers(1, 20),
    pixels=st.integers(1, 5),
    largest=st.sampled_from([1, 7, 2**32 - 1]),
)
def test_what_is_typical_of_a_place_is_that_of_the_oracle(seed, places, pixels, largest):
    drawn = np.random.default_rng(seed).integers(0, largest + 1, (places, pixels)).astype(np.uint32)
    assert typical_distances(drawn).tolist() == specification_drive.typical_distances(
        drawn.tolist()
    )
