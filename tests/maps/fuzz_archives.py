"""Feed changed maps, states, matches, settings and ground truth to their readers.

``python tests/maps/fuzz_archives.py --inputs 100_000`` loads so many files, each made from the seed
and its number alone, in forked children with limits of memory and time. Every file must be refused
by an error of ours, or give what plain Python gives (`archive_mutants.outcome`). A find is printed
with its number: ``--only NUMBER`` repeats it in this process.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import os
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]

from archive_mutants import LOADERS, VARIANTS, map_of, mutant, outcome, write_originals
from archive_oracle import check_loaded_map

#: what a child may take beside what the interpreter and the compiled kernels have, in bytes
MEMORY_BYTES = 512 << 20
#: what one input may take, in seconds
TIME_S = 60.0
_AT_ONCE = 2_000


class Find(NamedTuple):
    """An input that broke a promise."""

    number: int
    what: str


class Result(NamedTuple):
    """What a run found."""

    accepted: Counter[str]
    refused: Counter[str]
    finds: list[Find]
    most_bytes: int  # that a child took beside what it was forked with


def one(files: dict[str, list[Path]], folder: Path, seed: int, number: int) -> tuple[str, bool]:
    """Make input `number` and load it; its kind, and whether it was accepted."""
    rng = np.random.default_rng([seed, number])
    # most inputs to what kernels work on
    kinds = [kind for kind in LOADERS for _ in range(4 if kind in ("map", "state") else 1)]
    kind = kinds[int(rng.integers(len(kinds)))]
    original = files[kind][int(rng.integers(len(files[kind])))]
    path = folder / f"input{original.suffix}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # casts of odd values, while they are made
        path.write_bytes(mutant(original, rng))
    return kind, outcome(kind, path)


def run(inputs: int, seed: int, *, tell: bool = False) -> Result:
    """Load so many inputs in forked children; tell how far it has come on standard error."""
    # files in memory, where the system has a folder of it: each is written once and read twice
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=memory) as name:
        folder = Path(name)
        files = write_originals(folder)
        for kind, paths in files.items():
            for path in paths:  # kernels are compiled before the children inherit them
                assert outcome(kind, path), f"an original {kind} is refused: {path}"
        _compile_kernels()
        result = Result(Counter(), Counter(), [], 0)
        first = told = 0
        while first < inputs:
            last = min(first + _AT_ONCE, inputs)
            if tell:  # a run that is stopped has told what it found
                print(f"{first} inputs, {len(result.finds)} finds", file=sys.stderr, flush=True)
                print(*result.finds[told:], sep="\n", end="", file=sys.stderr, flush=True)
                told = len(result.finds)
            for line in _child(files, folder, seed, first, last):
                number, took, what, rest = line.split(" ", 3)
                first = int(number) + 1
                result = result._replace(most_bytes=max(result.most_bytes, int(took)))
                if what == "find":
                    result.finds.append(Find(int(number), rest))
                else:
                    (result.accepted if what == "accepted" else result.refused)[rest] += 1
        return result


@cache
def _compile_kernels() -> None:
    """Compile the kernels of all maps, once in this process, for the children to inherit."""
    for variant in VARIANTS:
        for largest in (3, 300, 70_000, 2**31 - 1):  # counts of each width
            check_loaded_map(map_of(variant, np.random.default_rng(1), largest))


def _child(
    files: dict[str, list[Path]], folder: Path, seed: int, first: int, last: int
) -> Iterator[str]:
    """Yield a line an input; a child that dies or hangs ends with a find."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _work(files, folder, seed, first, last, writing)
    os.close(writing)
    number, pending, why = first, b"", ""
    try:
        while number < last and not why:
            if not select.select([reading], [], [], TIME_S)[0]:
                os.kill(child, signal.SIGKILL)
                why = f"took more than {TIME_S:g} s"
            elif not (piece := os.read(reading, 1 << 16)):
                why = "ended the process"
            else:
                *lines, pending = (pending + piece).split(b"\n")
                for line in lines:
                    number += 1
                    yield line.decode()
    finally:
        os.close(reading)
        _, status = os.waitpid(child, 0)
    if why:
        if os.WIFSIGNALED(status):
            why += f" by {signal.Signals(os.WTERMSIG(status)).name}"
        yield f"{number} 0 find {why}"


def _work(
    files: dict[str, list[Path]], folder: Path, seed: int, first: int, last: int, writing: int
) -> None:
    """Load inputs in the child, and never return."""
    with contextlib.suppress(BaseException):
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + MEMORY_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        faulthandler.disable()  # the parent tells of a signal
        forked_with = _most_resident()
        for number in range(first, last):
            try:
                kind, accepted = one(files, folder, seed, number)
                said = f"{'accepted' if accepted else 'refused'} {kind}"
            except Exception:
                said = "find " + " | ".join(traceback.format_exc(limit=-2).split("\n"))
            line = f"{number} {_most_resident() - forked_with} {said}"
            os.write(writing, f"{line[:3000]}\n".encode(errors="replace"))
    os._exit(0)


def _most_resident() -> int:
    """Give the most memory that this process ever held, in bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def main() -> int:
    """Run as the arguments say; 1 if there was a find."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, metavar="NUMBER", help="repeat one input, here")
    args = parser.parse_args()
    if args.only is not None:
        with tempfile.TemporaryDirectory() as name:
            print(*one(write_originals(Path(name)), Path(name), args.seed, args.only))
        return 0
    begin = time.monotonic()
    result = run(args.inputs, args.seed, tell=True)
    for kind in LOADERS:
        print(f"{kind}: {result.accepted[kind]} accepted, {result.refused[kind]} refused")
    for find in result.finds[:50]:
        print(f"FIND {find.number}: {find.what}")
    print(
        f"{args.inputs} inputs, seed {args.seed}: {len(result.finds)} finds, at most "
        f"{result.most_bytes >> 20} MB, {time.monotonic() - begin:.0f} s"
    )
    return 1 if result.finds else 0


if __name__ == "__main__":
    sys.exit(main())
