"""Hold the core to golden vectors: ``python -m firmware_model.hardware.replay``.

With a folder of vectors that ``edge-vpr golden --rtl`` wrote, its cases are replayed; with
``--designs N``, those of N random designs; with ``--events N``, one long case of a design with the
place filter and contrast codes. With ``--slow-blocks``, the core is that of an ECP5, which has
registers behind its block memories. Needs Icarus Verilog.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from firmware_model.design import Design
from firmware_model.errors import ToolError, VectorError
from firmware_model.hardware.simulation import Conditions, replay_vectors
from firmware_model.vectors.random_cases import random_adaptive_design, random_cases, random_design
from firmware_model.vectors.suite import Suites, standard_suites, write_suites
from firmware_model.vectors.verify import COMPARED, Verdict, verify

#: design of the long case
LONG = Design(
    width=24, height=16, pixels=9, matching="filter", length=1, code="contrast",
    timestamp_bits=24, places=20, lanes=4,
)  # fmt: skip


def hold(vectors: Path, conditions: Conditions) -> Verdict:
    """Replay all cases of a folder of vectors, and compare the results."""
    with tempfile.TemporaryDirectory() as work:
        replays = replay_vectors(vectors, Path(work), conditions)
        return verify(vectors, (record for _, done in replays for record in done.records))


def hold_random_designs(
    number: int, conditions: Conditions, only: str | None = None
) -> Iterator[Verdict]:
    """Replay the cases of random designs, and yield the verdict on each design.

    Parameters
    ----------
    number : int
        Number of designs; every other one has the place filter, contrast codes, or both.
    conditions : Conditions
        The seed is also that of designs and cases.
    only : str, optional
        Name of a suite; by default all suites.
    """
    rng = np.random.default_rng(conditions.seed)
    for at in range(number):
        design = random_adaptive_design(rng, gains=(1, 7)) if at % 2 else random_design(rng)
        its_own = conditions._replace(seed=conditions.seed + at)
        verdict = hold_suites(design, standard_suites(design, its_own.seed, only), its_own)
        yield replace(verdict, differences=[f"{it} ({design})" for it in verdict.differences])


def hold_suites(design: Design, suites: Suites, conditions: Conditions) -> Verdict:
    """Write suites of cases, replay them, and compare."""
    with tempfile.TemporaryDirectory() as folder:
        vectors = Path(folder) / "vectors"
        write_suites(vectors, design, suites, conditions.seed, rtl=True)
        return hold(vectors, conditions)


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return 1 if a case differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("vectors", nargs="?", type=Path, help="folder of vectors")
    parser.add_argument("--designs", type=int, default=0, metavar="N", help="random designs")
    parser.add_argument("--suite", metavar="NAME", help="of the random designs, one alone")
    parser.add_argument("--events", type=int, default=0, metavar="N", help="one long case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--stall", type=int, default=40, metavar="PER_CENT")
    parser.add_argument("--resets", type=int, default=1, metavar="N")
    parser.add_argument("--slow-blocks", action="store_true", help="the core of an ECP5")
    args = parser.parse_args(words)
    if [args.vectors is not None, args.designs > 0, args.events > 0].count(True) != 1:
        parser.error("name a folder of vectors, a number of --designs, or one of --events")
    conditions = Conditions(args.seed, args.stall, args.resets, slow_blocks=args.slow_blocks)
    verdicts = []
    try:
        if args.vectors is not None:
            verdicts.append(hold(args.vectors, conditions))
        elif args.events:
            suite = random_cases(LONG, np.random.default_rng(args.seed), 1, args.events)
            verdicts.append(hold_suites(LONG, {"random": suite}, conditions))
        for verdict in hold_random_designs(args.designs, conditions, args.suite):
            verdicts.append(verdict)
            print(
                f"design {len(verdicts)}: {len(verdict.differences)} of {verdict.cases} cases "
                "differ",
                flush=True,
            )
    except (ToolError, VectorError) as error:
        print(error, file=sys.stderr)
        return 1
    differences = [line for verdict in verdicts for line in verdict.differences]
    for line in differences:
        print(line)
    compared = {kind: sum(verdict.compared[kind] for verdict in verdicts) for kind in COMPARED}
    equal = ", ".join(f"{number:,} {kind} records" for kind, number in compared.items())
    cases = sum(verdict.cases for verdict in verdicts)
    print(f"{cases} cases, {len(differences)} differ; equal: {equal}")
    return int(bool(differences))


if __name__ == "__main__":
    sys.exit(main())
