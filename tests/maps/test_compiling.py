"""Compiled code that a power cut left incomplete, or that was damaged."""

from __future__ import annotations

import random
import tempfile
from pathlib import Path

import pytest
from numba import config

from tests.maps.kernel_programs import KERNEL, ONE_KERNEL, Runner

pytestmark = pytest.mark.skipif(
    config.DISABLE_JIT, reason="Numba compiles nothing (NUMBA_DISABLE_JIT)"
)
_SOURCE = f"""
{KERNEL}
def added(x):
    return x + SHIFT

@kernel
def taken(x):
    return x - SHIFT
"""
_PROGRAM = """
from edge_vpr.run_log import COMPILING, compiling_reported
with compiling_reported(lambda text: text == COMPILING or print(text)):
    import two_kernels
    print(two_kernels.added(5), two_kernels.taken(5))
print("loaded", *(each.stats.cache_hits.total() for each in (two_kernels.added, two_kernels.taken)))
"""
_KEPT = "8 2\nloaded 1 1"


class Kernels:
    """Two kernels in a folder, with their compiled code."""

    def __init__(self, folder, run):
        self.source, self.run = folder / "two_kernels.py", run
        self.source.write_text(f"SHIFT = 3{_SOURCE}")
        assert self.call() == _KEPT.replace("1 1", "0 0")
        assert self.call() == _KEPT
        self.whole = {file: file.read_bytes() for file in self.files("*.nb[ic]")}
        assert len(self.whole) == 4

    def call(self):
        return self.run(_PROGRAM)

    def files(self, pattern):
        return sorted(self.source.parent.rglob(pattern))

    def restore(self):
        for file in self.files("*.nb[ic]"):
            file.unlink()
        for file, data in self.whole.items():
            file.write_bytes(data)


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kernels")
    with Runner(folder) as run:
        yield Kernels(folder, run)


@pytest.fixture
def kept(shared):
    shared.restore()
    return shared


@pytest.fixture
def changing(tmp_path):
    """As `kept`, of which the source may be changed."""
    with Runner(tmp_path) as run:
        yield Kernels(tmp_path, run)


def _flip(data, place):
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


DAMAGES = {
    "nothing left": lambda data: b"",
    "cut": lambda data: data[:1_000],
    "end cut": lambda data: data[:-1],
    "zeroed": lambda data: bytes(len(data)),
    "a block zeroed": lambda data: data[:100] + bytes(512) + data[612:],
    "a bit of the first pickle": lambda data: _flip(data, 20),
    "a bit of the rest": lambda data: _flip(data, len(data) // 2),
    "a bit of the checksum": lambda data: _flip(data, len(data) - 1),
    "another file": lambda data: b"hello\n",
}


@pytest.mark.parametrize("pattern", ["*.nbi", "*.nbc"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_code_is_deleted_compiled_again_and_noted_once(kept, pattern, damage):
    for file in kept.files(pattern):
        file.write_bytes(DAMAGES[damage](file.read_bytes()))
    lines = kept.call().splitlines()
    assert lines[1:] == ["8 2", "loaded 0 0"]
    assert "compiled kernels are damaged or of an older version" in lines[0]
    assert kept.call() == _KEPT


#: `python tests/maps/test_compiling.py` tries 1,000
RANDOM_DAMAGES = 20


def test_code_that_is_damaged_at_random_never_gives_another_result(kept):
    rng = random.Random(28)
    for _ in range(RANDOM_DAMAGES):
        kept.restore()
        file, data = rng.choice(list(kept.whole.items()))
        first = rng.randrange(len(data))
        last = min(first + rng.choice([1, 1, 2, 8, 512, 4096]), len(data))
        put = rng.choice([rng.randbytes(last - first), bytes(last - first), b"", None])
        changed = data[:first] if put is None else data[:first] + put + data[last:]
        file.write_bytes(changed)
        lines = kept.call().splitlines()
        assert lines[-2] == "8 2"
        assert len(lines) == (2 if changed == data else 3)


def test_a_new_index_beside_older_code_gives_the_new_result(changing):
    """As after a power cut: the file system had put only the new index on the disk."""
    changing.source.write_text(f"SHIFT = 44{_SOURCE}")
    assert changing.call().splitlines() == ["49 -39", "loaded 0 0"]
    for file in changing.files("*.nbc"):
        assert file.read_bytes() != changing.whole[file]
        file.write_bytes(changing.whole[file])
    assert changing.call().splitlines() == ["49 -39", "loaded 0 0"]


def test_code_for_other_arguments_is_not_taken(kept):
    """Where the index was deleted, code is numbered in another order."""
    program = "import two_kernels; print(two_kernels.taken(5.5))"
    (code,) = kept.files("*taken*.nbc")
    (index,) = kept.files("*taken*.nbi")
    index.unlink()
    assert kept.run(program) == "2.5"
    code.write_bytes(kept.whole[code])
    assert kept.run(f"{program}; print(two_kernels.taken.stats.cache_hits.total())") == "2.5\n0"


def test_a_kernel_is_compiled_again_when_what_it_calls_or_uses_has_changed(tmp_path):
    called, constants = tmp_path / "called.py", tmp_path / "constants.py"
    (tmp_path / "one_kernel.py").write_text(
        f"from called import one\nfrom constants import FIRST, STEP\n{KERNEL}"
        "def plus(x):\n    return x + FIRST[0] + STEP * one()\n"
    )
    program = (
        "import one_kernel; k = one_kernel.plus; print(k(1), sum(k.stats.cache_hits.values()))"
    )
    with Runner(tmp_path) as run:
        for one, first, step, result in (
            (1, 0, 1, 2), (100, 0, 1, 101), (100, 0, 7, 701), (100, 5, 7, 706)
        ):  # fmt: skip
            called.write_text(f"{KERNEL}def one():\n    return {one}\n")
            constants.write_text(
                f"import numpy as np\nFIRST = np.array([{first}])\nSTEP = {step}\n"
            )
            assert run(program) == f"{result} 0"  # compiled
            assert run(program) == f"{result} 1"  # loaded


def test_an_index_of_a_class_that_has_been_renamed_is_compiled_again(changing):
    changing.source.write_text(
        "from typing import NamedTuple\n\nclass Old(NamedTuple):\n    x: int\n"
        f"{KERNEL}def first(given):\n    return given[0]\n"
    )
    program = "import two_kernels; print(two_kernels.first(two_kernels.{}(3)))"
    assert changing.run(program.format("Old")) == "3"
    changing.source.write_text(changing.source.read_text().replace("Old", "Newer"))
    assert changing.run(program.format("Newer")) == "3"


if __name__ == "__main__":
    RANDOM_DAMAGES = 1_000
    with tempfile.TemporaryDirectory() as folder, Runner(folder) as run:
        test_code_that_is_damaged_at_random_never_gives_another_result(Kernels(Path(folder), run))
    print("1,000 damaged files: no other result")


def test_a_full_disk_keeps_no_code_and_ends_no_run(tmp_path):
    """It ended the run with the system's error while its kernels were being stored."""
    (tmp_path / "one_kernel.py").write_text(ONE_KERNEL)
    limited = (
        "import resource, signal, one_kernel\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))\n"
        "print(one_kernel.plus_one(1))"
    )
    with Runner(tmp_path) as run:
        assert "2" in run(limited)
