"""Mutants of the core: ``python -m firmware_model.verification.hardware_mutants``.

The command `mutate` of Yosys changes bits of the core's netlist, all in one program of Verilator; a
number chooses which change acts. Each replays golden vectors with stalls and a reset. One that
passes them all survives and is printed: it is equal to the core, or a case is missing. Run it
before a release.
"""

from __future__ import annotations

import argparse
import os
import re
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

from firmware_model.design import Design
from firmware_model.errors import ToolError, VectorError
from firmware_model.hardware import simulation, sources
from firmware_model.hardware.parameters import PACKAGE, package
from firmware_model.vectors.suite import standard_suites, write_suites
from firmware_model.vectors.verify import read_results, verify
from firmware_model.verification.proof import run_yosys

# the delay line of the search is no power of two long; some corners have 21 places too
_SEQUENCES = Design(
    width=24, height=16, pixels=9, places=21, length=3, code_bits=4, window_events=12, lanes=4,
    exclusion=2,
)  # fmt: skip
_ONE_GAIN = replace(_SEQUENCES, matching="filter", length=1, code="contrast")
DESIGNS = (_SEQUENCES, _ONE_GAIN, replace(_ONE_GAIN, gains=7))
# the first reset comes soon, the other one behind matches
CONDITIONS = simulation.Conditions(stall=30, resets=2)
#: processor seconds of a replay; the longest takes a tenth
_PATIENCE_S = 3
#: the instance in the testbench becomes that of the netlist, which has no parameters
_CORE, _CHOSEN = "vpr_core #(.SLOW_BLOCKS(SLOW_BLOCKS)) core (", (
    'logic [15:0] mutant; initial if (!$value$plusargs("mutant=%d", mutant)) mutant = 0;\n'
    "    vpr_core core ("
)  # fmt: skip


def build(folder: Path, case: Path, number: int, seed: int) -> tuple[Path, list[str]]:
    """Build the program of a design with so many mutants, and return it with what they change."""
    rtl, listed = folder / "rtl", folder / "mutants.ys"
    sources.copy_sources(rtl, sources.SIMULATED)
    units, netlist = [str(rtl / name) for name in sources.UNITS], folder / "netlist.v"
    memories = [str(rtl / name) for name in sources.MEMORIES]
    run_yosys(
        [
            f"read_verilog -sv {case / PACKAGE}.sv", f"read_verilog -sv -lib {' '.join(memories)}",
            f"read_verilog -sv {' '.join(units)}",
            "hierarchy -top vpr_core; proc; flatten; memory -nomap; opt -full; wreduce; opt -full",
            f"mutate -list {number} -seed {seed} -ctrl mutant 16 1 -o {listed}",
            f"script {listed}; write_verilog -noattr {netlist}",
        ],
        "core", case,
    )  # fmt: skip
    for name in sources.UNITS:
        (rtl / name).write_text("", encoding="ascii")
    text = netlist.read_text(encoding="ascii").replace("{0{1'b0}}", '""')  # the name of no file
    (rtl / sources.UNITS[-1]).write_text(text, encoding="ascii")
    bench = sources.text_of(sources.BENCH).replace(_CORE, _CHOSEN)
    (rtl / sources.BENCH).write_text(bench, encoding="ascii")
    program = simulation.build_bench(case / f"{PACKAGE}.sv", folder / "built", rtl)
    return program, listed.read_text(encoding="ascii").splitlines()


def passes(program: Path, vectors: Path, names: Sequence[str], number: int) -> bool:
    """Return whether a mutant, or the core itself (0), has the records of all these cases."""
    results = program.parent / f"{number}.csv"
    for name in names:
        try:
            simulation.run_bench(
                program, vectors / name, name, results, CONDITIONS, [f"+mutant={number}"],
                seconds=_PATIENCE_S,
            )  # fmt: skip
            if verify(vectors, read_results(results)).differences:
                return False
        except (ToolError, VectorError):
            return False
    return True


def main(words: Sequence[str] | None = None) -> None:
    """Run mutants of both profiles, one with one gain and with seven, and print which survive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=1_000, help="mutants of each design")
    parser.add_argument("--seed", type=int, default=1, help="of the choice of mutants")
    options = parser.parse_args(words)
    for design in DESIGNS:
        with tempfile.TemporaryDirectory() as work, ThreadPoolExecutor(os.cpu_count()) as threads:
            vectors = Path(work) / "vectors"
            # others, as all of the suite `filter`, have sizes, and so a program, of their own
            suites = {
                suite: [
                    case for case in standard_suites(design, 1, suite)[suite]
                    if package(case.design) == package(design)
                ]
                for suite in ("corners", "random", "own")
            }  # fmt: skip
            write_suites(vectors, design, suites, 1, rtl=True)
            names = [f"{suite}/{case.name}" for suite, cases in suites.items() for case in cases]
            program, changes = build(Path(work), vectors / names[0], options.number, options.seed)
            if not passes(program, vectors, names, 0):
                parser.error("the core itself fails the vectors")
            run = partial(passes, program, vectors, names)
            outcomes = list(threads.map(run, range(1, len(changes) + 1)))
        left = [change for change, survives in zip(changes, outcomes, strict=True) if survives]
        for change in left:
            print("survives:", re.sub(r"mutate -ctrl mutant 16 \d+ |\S*/rtl/", "", change))
        name = design.matching if design.gains == 1 else f"{design.gains} gains"
        print(f"{name}: {len(changes):,} mutants, {len(left):,} survive", flush=True)


if __name__ == "__main__":
    main()
