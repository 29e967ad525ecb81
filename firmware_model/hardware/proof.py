"""Prove search and prediction of the core: ``python -m firmware_model.hardware.proof``.

By yosys and its yosys-smtbmc with the solver z3 (``apt install yosys z3``, or the package
``z3-solver``). The files in ``formal/`` say what must hold; the proofs are by induction, for any
number of sums or metrics at any times. Deliberately broken versions must each be refused.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from firmware_model.errors import ToolError
from firmware_model.hardware.sources import FOLDER

PROPERTIES = FOLDER / "formal" / "vpr_search_properties.sv"
#: registers of the search that the induction refers to
REGISTERS = (
    *("delayed", "filled", "behind", "has_left", "left", "left_sum", "update"),
    *("sum_lower", "sum_equal", "sum_below_second", "oldest_lower", "oldest_place"),
)
#: clocks of a window of induction, and in which a broken version must fail
INDUCTION, BOUND = 4, 24


class Size(NamedTuple):
    """Parameters of a search that is proved."""

    exclusion: int
    sum_bits: int
    place_bits: int


SIZES = (Size(0, 4, 4), Size(1, 3, 3), Size(2, 3, 4), Size(3, 4, 4))
#: broken versions are of this size
SMALL = Size(1, 2, 3)

#: what is broken, and how: text of ``vpr_search.sv`` and what replaces it
BROKEN = {
    "of equal sums the highest place is best": ("sum < best_sum;", "sum <= best_sum;"),
    "of equal seconds the highest place wins": ("sum < second_sum;", "sum <= second_sum;"),
    "of equal sums on the left the highest wins": ("oldest < left_sum;", "oldest <= left_sum;"),
    "the second best may lie at the zone's edge": (
        "behind == ZONE_BITS'(EXCLUSION)",
        "behind == ZONE_BITS'(EXCLUSION - 1)",
    ),
    "the place on the left is off by one": ("place - PLACE_BITS'(DELAY)", "place - 1'b1"),
    "a sum leaves the delay line too early": (
        "leaves   = filled == ZONE_BITS'(DELAY)",
        "leaves   = filled >= ZONE_BITS'(EXCLUSION)",
    ),
    "a new best forgets the place that leaves": (
        "second     <= next_left;",
        "second     <= left;",
    ),
    "a new best keeps the ties": ("ties       <= '0;\n                behind", "behind"),
    "a match begins with the left of the last": (
        "has_left   <= 1'b0;\n            has_best",
        "has_best",
    ),
    "the best is never replaced": ("!has_best || sum_lower", "!has_best"),
}


def prove(size: Size, source: str | None = None, *, seconds: int = 300) -> bool:
    """Prove the search, without a bound on the number of sums.

    Parameters
    ----------
    size : Size
    source : str, optional
        Of ``vpr_search.sv``; by default as it is.
    seconds : int
        After which the solver is ended.

    Returns
    -------
    bool
        Whether base case and induction hold.

    Raises
    ------
    ToolError
        If a tool is missing, refuses the source, or takes too long.
    """
    with tempfile.TemporaryDirectory() as folder:
        model = _translate(Path(folder), size, _search(source), induction=True)
        base = _solve(model, ["-t", str(INDUCTION)], seconds)
        return base and _solve(model, ["-i", "-t", str(INDUCTION)], seconds)


def refuted(size: Size, source: str, *, seconds: int = 300) -> bool:
    """Return whether some sums make a search give a wrong result within `BOUND` clocks.

    Parameters
    ----------
    size : Size
    source : str
        Of ``vpr_search.sv``.
    seconds : int
        After which the solver is ended.

    Returns
    -------
    bool

    Raises
    ------
    ToolError
        As of `prove`.
    """
    with tempfile.TemporaryDirectory() as folder:
        model = _translate(Path(folder), size, source, induction=False)
        return not _solve(model, ["-t", str(BOUND)], seconds)


#: parameters of the prediction that is proved: steps of 0, 1 and 2 places, and one back
_PREDICTION = {
    "STEPS": "3",
    "BACK": "1",
    "STEP_PRICES": f"160'h{2 | 1 << 2 * 10:040x}",
    "BACK_PRICES": "160'h3",
    "RESTART": "9",
    "METRIC_BITS": "4",
}
#: broken versions of the prediction: text of ``vpr_prediction.sv`` and what replaces it
BROKEN_PREDICTIONS = {
    "the dearer of two ways is taken": ("right < left ?", "right > left ?"),
    "a place off the map is one to come from": ("off || !below", "!below"),
}


def prove_prediction(source: str | None = None, *, seconds: int = 600) -> bool:
    """Prove that each prediction is the price of the cheapest way, and a restart at most.

    Parameters
    ----------
    source : str, optional
        Of ``vpr_prediction.sv``; by default as it is.
    seconds : int
        After which the solver is ended.

    Returns
    -------
    bool
        Whether base case and induction hold; of a source that is given, the base case alone, in
        which a broken version must fail.

    Raises
    ------
    ToolError
        As of `prove`.
    """
    text = _source("vpr_prediction.sv") if source is None else source
    chosen = " ".join(f"-set {name} {value}" for name, value in _PREDICTION.items())
    with tempfile.TemporaryDirectory() as name:
        unit, model = Path(name) / "unit.sv", Path(name) / "prediction.smt2"
        unit.write_text(text, encoding="ascii")
        properties = FOLDER / "formal" / "vpr_prediction_properties.sv"
        script = (
            f"read_verilog -formal -sv {unit}; chparam {chosen} vpr_prediction; "
            "hierarchy -top vpr_prediction; proc; flatten; expose vpr_prediction/w:entries; "
            f"read_verilog -formal -sv {properties}; hierarchy -top vpr_prediction_properties; "
            f"proc; flatten; opt_clean; write_smt2 -wires {model}"
        )
        done = _run(["yosys", "-q", "-p", script], 60)
        if done.returncode:
            raise ToolError(f"yosys refuses the prediction: {(done.stderr + done.stdout).strip()}")
        base = _solve(model, ["-t", "8"], seconds)
        return base and (source is not None or _solve(model, ["-i", "-t", "8"], seconds))


def broken_prediction(name: str) -> str:
    """Return the source of a broken version, by its name in `BROKEN_PREDICTIONS`.

    Raises
    ------
    ToolError
        If the text that it replaces does not occur once.
    """
    return _replaced("vpr_prediction.sv", *BROKEN_PREDICTIONS[name])


def broken(name: str) -> str:
    """Return the source of a broken version, by its name in `BROKEN`.

    Raises
    ------
    ToolError
        If the text that it replaces does not occur once.
    """
    return _replaced("vpr_search.sv", *BROKEN[name])


def _replaced(file: str, old: str, new: str) -> str:
    source = _source(file)
    if source.count(old) != 1:
        raise ToolError(f"{file} has {source.count(old)} times {old!r}: mend {__name__}")
    return source.replace(old, new)


def _source(file: str) -> str:
    return (FOLDER / file).read_text(encoding="ascii")


def _search(source: str | None) -> str:
    return _source("vpr_search.sv") if source is None else source


def _translate(folder: Path, size: Size, source: str, *, induction: bool) -> Path:
    search, model = folder / "vpr_search.sv", folder / "search.smt2"
    search.write_text(source, encoding="ascii")
    chosen = (
        f"-set EXCLUSION {size.exclusion} -set SUM_BITS {size.sum_bits} "
        f"-set PLACE_BITS {size.place_bits}"
    )
    ports = " ".join(f"vpr_search/w:{name}" for name in REGISTERS)
    script = "; ".join(
        [
            f"read_verilog -formal -sv {search}",
            f"chparam {chosen} vpr_search",
            "hierarchy -top vpr_search",
            "proc",
            f"expose {ports}",
            f"read_verilog -formal -sv {PROPERTIES}",
            f"chparam {chosen} -set INDUCTION {int(induction)} vpr_search_properties",
            "hierarchy -top vpr_search_properties",
            "proc",
            "flatten",
            "opt_clean",
            f"write_smt2 -wires {model}",
        ]
    )
    done = _run(["yosys", "-q", "-p", script], 60)
    if done.returncode:
        raise ToolError(f"yosys refuses the search: {(done.stderr + done.stdout).strip()}")
    return model


def _solve(model: Path, options: Sequence[str], seconds: int) -> bool:
    done = _run(["yosys-smtbmc", "-s", "z3", *options, str(model)], seconds)
    if "Status: PASSED" in done.stdout:
        return True
    if "Status: FAILED" in done.stdout:
        return False
    raise ToolError(f"yosys-smtbmc gives no answer: {(done.stderr + done.stdout).strip()}")


def _run(command: Sequence[str], seconds: int) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
    except FileNotFoundError as error:
        raise ToolError(
            f"the proof needs {command[0]}, which is not installed: install yosys and z3"
        ) from error
    except subprocess.TimeoutExpired as error:
        raise ToolError(f"{command[0]} took more than {seconds} s") from error


def main(words: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    words : sequence of str, optional
        The command line.

    Returns
    -------
    int
        1 if a proof fails, or a broken version passes.
    """
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args(words)
    failures = 0
    try:
        for size in SIZES:
            holds = prove(size)
            failures += not holds
            print(f"{size}: {'proved' if holds else 'NOT PROVED'}", flush=True)
        for name in BROKEN:
            refused = refuted(SMALL, broken(name))
            failures += not refused
            print(f"{name}: {'refused' if refused else 'NOT REFUSED'}", flush=True)
        holds = prove_prediction()
        failures += not holds
        print(f"prediction of the place filter: {'proved' if holds else 'NOT PROVED'}", flush=True)
        for name in BROKEN_PREDICTIONS:
            refused = not prove_prediction(broken_prediction(name))
            failures += not refused
            print(f"{name}: {'refused' if refused else 'NOT REFUSED'}", flush=True)
    except ToolError as error:
        print(error, file=sys.stderr)
        return 1
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
