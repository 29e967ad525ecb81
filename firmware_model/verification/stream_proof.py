"""Claims about the core's streams, windows, matches and counters, for the model checker pdr.

The core has small parameters. Its memories are replaced by ones that return any word, so that a
claim holds for all tables, places and contents, and its activity by one that says anything.
`formal/vpr_core_properties.sv` states what must hold at the core's ports,
``formal/vpr_core_inside.sv`` what must hold inside it, and
``formal/vpr_counters_properties.sv`` what must hold for the counters.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from firmware_model.errors import ToolError
from firmware_model.hardware.sources import UNITS, text_of
from firmware_model.verification.formal import (
    PROPERTIES,
    broken_source,
    chparam,
    run,
    run_yosys,
    write_package,
)

#: commands of yosys-abc that prove a claim for any number of clocks; the same where these give no
#: answer
UNBOUNDED, SIMPLIFIED = "fold; pdr", "fold; scorr; dc2; scorr; pdr"
#: clocks of a claim about the first ones alone; a core of sequences has its second window in fewer
CLOCKS, CLOCKS_OF_SEQUENCES = 120, 80
#: time limit of the model checker
_SECONDS = 3600

#: module of the core
CORE = "vpr_core"
#: claim of each define of ``vpr_core_properties.sv``
CORE_CLAIMS = {
    "EVENT": "m_event stays until it is taken, and returns each event that s_event took",
    "WINDOW": "m_window stays until it is taken",
    "MATCH": "m_match stays until it is taken",
    "ONE": "exactly one match follows each window once L are seen, before the next",
    "NUMBER": "a match has the number of its window",
    "IDLE": "a window ends only while the place filter is idle",
    "PATIENCE": "a match comes within so many clocks of its window",
    "PROGRESS": "an event that is offered is taken, or a window or match is complete, within so "
    "many clocks in which the core waits for nobody",
}
#: state of each define of ``vpr_core_properties.sv`` that a core must be able to reach
COVERS = {
    "THREE": "three matches are taken",
    "RESET": "a match follows after a reset that came after a match",
    "WAIT": "an event waits while a match does",
    "SECOND": "a match has a second best place",
    "ACCEPTED": "a match is accepted",
}
#: claims about place filters alone, with reciprocals of as many bits as those of a design: with
#: fewer, the division ends before its match is taken
_OF_FILTERS = {"IDLE": {"RECIPROCAL_BITS": 17}}
#: constants of the cores that are proved: 2 slots and 2 places, and numbers of few bits
_SMALL = {
    "PIXELS": 2, "TIMESTAMP_BITS": 4, "EVENT_TIME_BITS": 4, "TAU_US": 3, "WINDOW_EVENTS": 2,
    "PLACES": 2, "RESTART": 2, "TRUST": 1, "BY_MARGIN": 1, "MARGIN": 1, "WINDOW_EVENTS_BITS": 2,
    "METRIC_BITS": 2, "SUM_BITS": 2, "RECIPROCAL_BITS": 5, "EVIDENCE_BITS": 2, "TRUST_BITS": 6,
}  # fmt: skip


class Kind(NamedTuple):
    """Clocks within which the core must get on, and its constants beside those of `_SMALL`."""

    patience: int
    progress: int
    constants: dict[str, int]


#: cores that are proved, by the kind of design
CORE_KINDS = {
    "sequences of 2, windows by time": Kind(24, 36, {"LENGTH": 2}),
    "sequences of 1, own means, windows by count": Kind(24, 36, {"BY_TIME": 0, "OWN_MEAN": 1}),
    "place filter, windows by time": Kind(64, 70, {"FILTER": 1}),
    "place filter that keeps distances, own means, a step back, windows by count": Kind(
        64, 70,
        {"FILTER": 1, "BY_TIME": 0, "KEEP_DISTANCES": 1, "OWN_MEAN": 1, "BACK": 1,
         "ACTIVITY_COSTS": 1, "STEPS": 4},
    ),
    "sequences of 1, contrast, windows by count": Kind(
        24, 52, {"BY_TIME": 0, "OWN_MEAN": 1, "CONTRAST": 1}
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Claim:
    """Assertions of a file of properties, about units with some parameters.

    Attributes
    ----------
    name : str
        The claim as a sentence.
    top : str
        Module of the properties.
    files : tuple of str
        Source files of the units.
    define : str
        Define of the assertions that are proved.
    constants : dict of str to int
        Of the package of sizes and widths.
    parameters : dict of str to int
        Parameters of `top`.
    free_memories : bool
        Whether memories return any word, and the activity is any.
    method : str
        `UNBOUNDED` or `SIMPLIFIED`.
    bound : int or None
        Number of the first clocks that it is about; None if it is about all.
    """

    name: str
    top: str
    files: tuple[str, ...]
    define: str = "PROVE_UNIT"
    constants: dict[str, int] = field(default_factory=dict)
    parameters: dict[str, int] = field(default_factory=dict)
    free_memories: bool = False
    method: str = UNBOUNDED
    bound: int | None = None


#: units of the core but for those of the activity, which is replaced
_UNITS_OF_CORE = tuple(
    unit for unit in UNITS if unit not in ("vpr_activity.sv", "vpr_logarithm.sv")
)


def core_claim(define: str, kind: str, *, slow_blocks: bool = False) -> Claim:
    """Return a claim of `CORE_CLAIMS` about a kind of `CORE_KINDS`.

    With `slow_blocks`, it is about the core that has registers behind its block memories.
    """
    filters = "FILTER" in CORE_KINDS[kind].constants
    name = f"{CORE_CLAIMS[define]} ({kind})"
    if slow_blocks:
        name = f"{name}, with registers behind block memories"
    bound = None
    if define == "PROGRESS" or (define == "PATIENCE" and filters):
        bound = CLOCKS if filters else CLOCKS_OF_SEQUENCES
        name = f"in the first {bound} clocks, {name}"
    claim = _of_core(name, f"PROVE_{define}", kind, bound, slow_blocks=slow_blocks)
    return replace(
        claim,
        constants=claim.constants | _OF_FILTERS.get(define, {}),
        method=SIMPLIFIED if define == "MATCH" and filters else UNBOUNDED,
    )


def cover(define: str, kind: str) -> Claim:
    """Return the claim that a kind of `CORE_KINDS` never reaches a state of `COVERS`.

    `holds` must refuse it: then there are inputs that lead there in the first clocks.
    """
    return _of_core(f"never: {COVERS[define]} ({kind})", f"COVER_{define}", kind, CLOCKS)


def _of_core(
    name: str, define: str, kind: str, bound: int | None, *, slow_blocks: bool = False
) -> Claim:
    patience, progress, constants = CORE_KINDS[kind]
    parameters = {"PATIENCE": patience, "PROGRESS": progress, "SLOW_BLOCKS": int(slow_blocks)}
    return Claim(
        name, f"{CORE}_properties", _UNITS_OF_CORE, define, _SMALL | constants, parameters,
        free_memories=True, bound=bound,
    )  # fmt: skip


COUNTERS = Claim(
    "each event raises the count of its slot by one, up to its maximum",
    "vpr_counters_properties",
    ("vpr_ram.sv", "vpr_counters.sv"),
    constants={"PIXELS": 3, "COUNT_MAX": 2},
)
DELAY = Claim(
    "a delay line returns each word so many pushes later",
    "vpr_delay_properties",
    ("vpr_ram.sv", "vpr_delay.sv"),
)
#: the delay line of pixels behind slow block memories
DELAY_OF_THREE = replace(DELAY, name=f"{DELAY.name}, of 3 words", parameters={"STEPS": 3})
CLAIMS = (
    COUNTERS,
    DELAY,
    DELAY_OF_THREE,
    *(
        core_claim(define, kind)
        for kind in CORE_KINDS
        for define in CORE_CLAIMS
        if define not in _OF_FILTERS or "FILTER" in CORE_KINDS[kind].constants
    ),
    *(
        core_claim(define, kind, slow_blocks=True)
        for kind in CORE_KINDS
        for define in ("EVENT", "WINDOW")
    ),
)

_BY_TIME, _BY_COUNT, _FILTER, _KEPT, _CONTRAST = CORE_KINDS
#: covers: a map of two places has one sequence of 2, and no second best
REACHED = (
    *(cover(define, kind) for kind in (_BY_COUNT, _KEPT) for define in COVERS),
    *(
        cover(define, kind)
        for kind in (_BY_TIME, _CONTRAST)
        for define in ("THREE", "RESET", "WAIT")
    ),
)
#: broken versions: the claim that must refuse each, its file, the replaced text and its replacement
BROKEN: dict[str, tuple[Claim, str, str, str]] = {
    "an event that is not taken is overwritten": (
        core_claim("EVENT", _BY_TIME),
        "vpr_events.sv",
        "!has_raised_q || m_event_tready;",
        "1'b1;",
    ),
    "an event is lost when the window is full": (
        core_claim("EVENT", _BY_COUNT),
        "vpr_events.sv",
        "has_count_q  <= has_slot_q && looks;",
        "has_count_q  <= has_slot_q && looks && !counting;",
    ),
    "a word of a window is not held": (
        core_claim("WINDOW", _BY_TIME),
        "vpr_encoder.sv",
        "!word_valid_o || word_ready_i;",
        "1'b1;",
    ),
    "a match is not held until it is taken": (
        core_claim("MATCH", _BY_TIME),
        "vpr_core.sv",
        "else if (match_taken) m_match_tvalid",
        "else m_match_tvalid",
    ),
    "a window ends before the match is taken": (
        core_claim("MATCH", _BY_COUNT),
        "vpr_core.sv",
        "match_taken || (finished && !has_best)",
        "finished",
    ),
    "a window before the L-th gives a match": (
        core_claim("ONE", _BY_TIME),
        "vpr_sequence.sv",
        "sum_complete_o = seen_all && place_o",
        "sum_complete_o = place_o",
    ),
    "a reset keeps the windows that were seen": (
        core_claim("ONE", _BY_TIME),
        "vpr_sequence.sv",
        "seen_q      <= '0;",
        "seen_q      <= seen_q;",
    ),
    "the first window has the number 1": (
        core_claim("NUMBER", _BY_TIME),
        "vpr_core.sv",
        "window_q         <= '1;",
        "window_q         <= '0;",
    ),
    "a window ends while the spread is divided": (
        core_claim("IDLE", _FILTER),
        "vpr_core.sv",
        "settled && filter_idle;",
        "settled;",
    ),
    "a core stops after its first match": (
        core_claim("PROGRESS", _BY_TIME),
        "vpr_core.sv",
        "match_taken || (finished && !has_best)",
        "match_taken && (finished && !has_best)",
    ),
    "a filter stops after its first match": (
        core_claim("PROGRESS", _FILTER),
        "vpr_core.sv",
        "match_taken || (finished && !has_best)",
        "match_taken && (finished && !has_best)",
    ),
    "the last sum of a window is not recognised": (
        core_claim("PATIENCE", _BY_COUNT),
        "vpr_sequence.sv",
        "sum_last_o = place_o == PLACE_BITS'(PLACES - 1);",
        "sum_last_o = 1'b0;",
    ),
    "the last count of a slot is not looked at": (
        COUNTERS,
        "vpr_counters.sv",
        "same_1_q ? raised_o : ",
        "",
    ),
    "the count before the last is not looked at": (
        COUNTERS,
        "vpr_counters.sv",
        "same_2_q ? written_q : ",
        "",
    ),
    "a drained count is kept": (COUNTERS, "vpr_counters.sv", "clears_q ? '0 : ", ""),
    "a delay line has a word more": (DELAY, "vpr_delay.sv", "STEPS - 1) ? '0", "STEPS) ? '0"),
    "a count wraps": (COUNTERS, "vpr_counters.sv", "count == FULL ? FULL : count", "count"),
}


def holds(claim: Claim, changed: Mapping[str, str] | None = None) -> bool:
    """Return whether a claim holds: for any number of clocks, unless it is of the first alone.

    Parameters
    ----------
    changed : mapping of str to str, optional
        Text of changed source files, by name.

    Raises
    ------
    ToolError
        If a tool is missing, refuses the source, or gives no answer in time.
    """
    with tempfile.TemporaryDirectory() as name:
        folder, model = Path(name), Path(name) / "model.aig"
        for file in claim.files:
            text = text_of(file) if changed is None or file not in changed else changed[file]
            if file == f"{CORE}.sv":
                inside = (PROPERTIES / "vpr_core_inside.sv").read_text(encoding="ascii")
                text = text.replace("endmodule", f"{inside}endmodule")
            (folder / file).write_text(text, encoding="ascii")
        files = [folder / file for file in claim.files]
        package = write_package(folder, claim.constants)
        if claim.free_memories:
            free = ("vpr_free_memories.sv", "vpr_free_activity.sv")
            files = [*(PROPERTIES / name for name in free), *files]
        files = [package, *files, PROPERTIES / f"{claim.top}.sv"]
        run_yosys(
            [
                f"read_verilog -formal -sv -D{claim.define} {' '.join(map(str, files))}",
                chparam(claim.parameters, claim.top),
                f"hierarchy -check -top {claim.top}",
                "proc; flatten; memory_map; opt -fast; async2sync; dffunmap; opt_clean",
                "formalff -clk2ff; setundef -anyseq -undriven",
                "opt -fast; techmap; opt -fast; abc -g AND -fast; opt_clean",
                # registers without an initial value begin with any value
                f"write_aiger -zinit -I -B {model}",
            ],
            claim.top,
        )
        # property directed reachability (pdr) finds an invariant and checks it
        bounded = f"fold; strash; bmc3 -F {claim.bound}"
        method = claim.method if claim.bound is None else bounded
        done = run(["yosys-abc", "-c", f"read_aiger {model}; {method}"], _SECONDS)
    if "Property proved." in done.stdout or f"asserted in {claim.bound} frames" in done.stdout:
        return True
    if "was asserted in frame" in done.stdout:
        return False
    raise ToolError(f"yosys-abc gives no answer: {(done.stderr + done.stdout).strip()}")


def reached(claim: Claim) -> bool:
    """Return whether the state of a `cover` is reached; raises as `holds`."""
    return not holds(claim)


def refused(name: str) -> bool:
    """Return whether a broken version, by its name in `BROKEN`, is refused; raises as `holds`."""
    claim, file, old, new = BROKEN[name]
    return not holds(claim, {file: broken_source(file, old, new)})
