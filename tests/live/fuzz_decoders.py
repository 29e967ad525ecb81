"""Fuzz every stream decoder: ``python tests/live/fuzz_decoders.py --inputs 100000``.

Each input is drawn from a seed of its own, which a find names. ``--guided`` takes the branches into
account instead (``pip install atheris``; ``NUMBA_DISABLE_JIT=1``, so that the kernels' branches
show): ``python tests/live/fuzz_decoders.py --guided -max_total_time=600 CORPUS_FOLDER``. A find is
kept as a test in `test_stream_protocols.py`.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[n]) for n in (2, 1, 0)]


def seeded(inputs: int, first_seed: int, only: list[str]) -> None:
    """Feed so many inputs to the decoders of each protocol, or of those; say how it went."""
    from hostile_streams import PAIRS, Seeded, one_input

    protocols = [host.partition(":")[0] for host, _ in PAIRS]
    for number, (pair, protocol) in enumerate(zip(PAIRS, protocols, strict=True)):
        if only and protocol not in only:
            continue
        start, share = time.monotonic(), -(-inputs // protocols.count(protocol))
        for seed in range(first_seed, first_seed + share):
            try:
                one_input(pair, Seeded(np.random.default_rng([number, seed])))
            except Exception:
                print(f"{pair[0]}, a device of {pair[1]}: seed {seed}", flush=True)
                raise
        took = time.monotonic() - start
        print(f"{pair[0]}, a device of {pair[1]}: {share:,} inputs in {took:.0f} s", flush=True)


def guided(words: list[str]) -> None:
    """Let atheris choose."""
    import atheris

    with atheris.instrument_imports(include=["edge_vpr.live", "edge_vpr.recordings.prophesee"]):
        from hostile_streams import PAIRS, one_input

    class Choices:
        def __init__(self, raw: bytes) -> None:
            self._data = atheris.FuzzedDataProvider(raw)

        def integer(self, low: int, high: int) -> int:
            return int(self._data.ConsumeIntInRange(low, high))

        def bytes(self, n: int) -> bytes:
            return bytes(self._data.ConsumeBytes(n))

    def one(raw: bytes) -> None:
        choices = Choices(raw)
        one_input(PAIRS[choices.integer(0, len(PAIRS) - 1)], choices)

    atheris.Setup([sys.argv[0], *words], one)
    atheris.Fuzz()


def main() -> None:
    """Fuzz as the arguments say."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000, help="for each protocol")
    parser.add_argument("--seed", type=int, default=0, help="of the first input")
    parser.add_argument("--only", nargs="+", default=[], metavar="P", help="these protocols alone")
    parser.add_argument("--guided", action="store_true", help="by atheris, whose flags may follow")
    args, rest = parser.parse_known_args()
    if args.guided:
        guided(rest)
    else:
        seeded(args.inputs, args.seed, args.only)


if __name__ == "__main__":
    main()
