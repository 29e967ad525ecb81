"""Prove what the core must do: ``python -m firmware_model.verification.proof``.

The proofs use yosys and its yosys-smtbmc with the solver z3 (``apt install yosys z3``, or the
package ``z3-solver``), and its model checker pdr for the core's streams. The files in ``formal/``
state what must hold. No proof has a bound on the number of clocks, unless its claim says so. Each
deliberately broken version must be refused, and so must be the claim that a state is never reached.
Each line ends with the seconds of the processor; ``--table`` puts those of the claims about the
core's streams into a table, in which those of other runs stay.
"""

from __future__ import annotations

import argparse
import csv
import resource
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from firmware_model.errors import ToolError
from firmware_model.verification import stream_proof, unit_proof


class Trial(NamedTuple):
    """What is tried, by its name, and what is said of it where it is as it must be, and if not."""

    name: str
    succeeds: Callable[[], bool]
    good: str
    bad: str


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return 1 if a proof fails or has no answer, or a broken version passes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--only", metavar="TEXT", default="", help="those whose name has this text alone"
    )
    parser.add_argument("--skip", type=int, default=0, metavar="N", help="go on behind the first N")
    parser.add_argument("--table", type=Path, metavar="FILE.csv", help="seconds by claim and kind")
    args = parser.parse_args(words)
    chosen = [trial for trial in _trials() if args.only in trial.name][args.skip :]
    failures = 0
    for trial in chosen:
        begun = _processor_seconds()
        try:
            good = trial.succeeds()
            said = trial.good if good else trial.bad
        except ToolError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                print(error, file=sys.stderr)
                return 1
            good, said = False, f"NO ANSWER, {error}"
        failures += not good
        taken = _processor_seconds() - begun
        print(f"{trial.name}: {said}, {taken:.0f} s", flush=True)
        if args.table is not None:
            _put(args.table, trial.name, taken if good else None)
    return int(failures > 0)


def _processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _trials() -> Iterator[Trial]:
    """Yield all proofs and covers, and the broken versions that must be refused."""
    proofs = {name: unit.proved for name, unit in unit_proof.PROVED.items()}
    proofs |= {claim.name: partial(stream_proof.holds, claim) for claim in stream_proof.CLAIMS}
    for name, proof in proofs.items():
        yield Trial(name, proof, "proved", "NOT PROVED")
    for claim in stream_proof.REACHED:
        reached = partial(stream_proof.reached, claim)
        yield Trial(claim.name, reached, "refused", "NEVER REACHED")
    broken_units = (unit_proof.SMALL_SEARCH, unit_proof.PREDICTION, unit_proof.TIMER)
    trials = {name: partial(unit.refused, name) for unit in broken_units for name in unit.broken}
    trials |= {name: partial(stream_proof.refused, name) for name in stream_proof.BROKEN}
    for name, trial in trials.items():
        yield Trial(name, trial, "refused", "NOT REFUSED")


def _put(table: Path, name: str, seconds: float | None) -> None:
    """Put a claim about the core's streams into a table, as the others are of runs before.

    Its cell has the seconds and the bound, if there is one; a claim without a proof has none.
    """
    kinds = list(stream_proof.CORE_KINDS)
    cells: dict[tuple[str, str], str] = {}
    if table.exists():
        with table.open(newline="", encoding="utf-8") as file:
            head, *rows = csv.reader(file)
        cells = {
            (row[0], kind): cell
            for row in rows
            for kind, cell in zip(head[1:], row[1:], strict=True)
            if cell
        }
    for define, claim in stream_proof.CORE_CLAIMS.items():
        for kind in kinds:
            stated = stream_proof.core_claim(define, kind)
            if stated.name == name:
                first = f"first {stated.bound} clocks: " if stated.bound else ""
                cells[claim, kind] = "" if seconds is None else f"{first}{seconds:.0f}"
    with table.open("w", newline="", encoding="utf-8") as file:
        rows_now = (
            [claim, *(cells.get((claim, kind), "") for kind in kinds)]
            for claim in stream_proof.CORE_CLAIMS.values()
            if any(cells.get((claim, kind)) for kind in kinds)
        )
        csv.writer(file, lineterminator="\n").writerows([["claim", *kinds], *rows_now])


if __name__ == "__main__":
    sys.exit(main())
