"""Prove what the core must do: ``python -m firmware_model.verification.proof``.

The proofs use yosys and the model checker pdr of its yosys-abc (``apt install yosys``). The files
in ``formal/`` state what must hold. No proof has a bound on the number of clocks, unless its claim
says so. Each deliberately broken version must be refused, and so must be the claim that a state is
never reached.
Each line ends with the seconds of the processor.
"""

from __future__ import annotations

import argparse
import resource
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

from firmware_model.errors import ToolError
from firmware_model.verification import claims
from firmware_model.verification.formal import holds


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
    return int(failures > 0)


def _processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _trials() -> Iterator[Trial]:
    """Yield all proofs and covers, and the broken versions that must be refused."""
    for claim in claims.CLAIMS:
        yield Trial(claim.name, partial(holds, claim), "proved", "NOT PROVED")
    for claim in claims.REACHED:
        yield Trial(claim.name, partial(claims.reached, claim), "refused", "NEVER REACHED")
    for name in claims.BROKEN:
        yield Trial(name, partial(claims.refused, name), "refused", "NOT REFUSED")


if __name__ == "__main__":
    sys.exit(main())
