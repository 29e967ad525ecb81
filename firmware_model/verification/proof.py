"""Prove what the core must do: ``python -m firmware_model.verification.proof``.

The proofs use yosys and its yosys-smtbmc with the solver z3 (``apt install yosys z3``, or the
package ``z3-solver``), and its model checker pdr for the core's streams. The files in ``formal/``
state what must hold. No proof has a bound on the number of clocks, unless its claim says so. Each
deliberately broken version must be refused, and so must be the claim that a state is never reached.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from functools import partial

from firmware_model.errors import ToolError
from firmware_model.verification import stream_proof, unit_proof


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return 1 if a proof fails, or a broken version passes."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args(words)
    failures = 0
    try:
        for what, holds in _outcomes():
            failures += not holds
            print(what, flush=True)
    except ToolError as error:
        print(error, file=sys.stderr)
        return 1
    return int(failures > 0)


def _outcomes() -> Iterator[tuple[str, bool]]:
    """Run all proofs and covers, and check that each broken version is refused."""
    proofs = {name: unit.proved for name, unit in unit_proof.PROVED.items()}
    proofs |= {claim.name: partial(stream_proof.holds, claim) for claim in stream_proof.CLAIMS}
    for what, proof in proofs.items():
        holds = proof()
        yield f"{what}: {'proved' if holds else 'NOT PROVED'}", holds
    for claim in stream_proof.REACHED:
        reached = not stream_proof.holds(claim)
        yield f"{claim.name}: {'refused' if reached else 'NEVER REACHED'}", reached
    broken_units = (unit_proof.SMALL_SEARCH, unit_proof.PREDICTION, unit_proof.TIMER)
    trials = {name: partial(unit.refused, name) for unit in broken_units for name in unit.broken}
    trials |= {name: partial(stream_proof.refused, name) for name in stream_proof.BROKEN}
    for what, trial in trials.items():
        refused = trial()
        yield f"{what}: {'refused' if refused else 'NOT REFUSED'}", refused


if __name__ == "__main__":
    sys.exit(main())
