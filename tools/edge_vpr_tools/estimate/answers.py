"""The answer of an estimate in sentences: what fits, memory, time, power and accuracy."""

from __future__ import annotations

from edge_vpr_tools.estimate.counts import block_memories, large_and_small_blocks, sizes
from edge_vpr_tools.estimate.estimation import Estimation, Question
from edge_vpr_tools.estimate.fit import broken_by, memory_bytes
from edge_vpr_tools.estimate.model import Cost, Mission
from edge_vpr_tools.estimate.targets import Target
from edge_vpr_tools.estimate.wording import UNKNOWN, busy, matching, size_text, spread
from firmware_model.design import Design


def answer_lines(found: Estimation) -> list[str]:
    """Return the answer: a sentence for each target, and one on the accuracy."""
    asked = found.question
    if found.answers is not None:
        return [
            *found.answers.text.values(),
            "an accuracy is of those drives: a longer route has more places to be mistaken for "
            "one another",
        ]
    of = asked.design
    head = (
        f"{of.pixels} pixels, codes of {of.code_bits} bits ({of.code}), {of.places:,} places, "
        f"{matching(of)}:"
    )
    lines = [
        f"{target.name}: {_verdict(asked, target, found.costs[target.name])}"
        for target in asked.targets
    ]
    return [head, *lines, "accuracy is not estimated: --accuracy-on tries designs on two drives"]


def _verdict(asked: Question, target: Target, cost: Cost) -> str:
    """Return whether a design fits, and what it takes."""
    of = asked.design
    budgets = asked.budgets if asked.alone is not None else ()
    over = broken_by(of, target, asked.mission, budgets, asked.measured)
    problems = [f"over {over}"] if over else []
    memory = size_text(memory_bytes(of, target))
    if target.blocks:
        blocks, enough = _blocks(of, target)
        memory += f" in {blocks}"
        if not enough:
            problems.append("too few block memories")
    if cost.logic_cells is not None:
        memory += f"; {cells_text(cost.logic_cells, target)} (predicted)"
        if cost.logic_cells > target.logic_cells:
            problems.append("too few logic cells")
    if cost.load.low >= 1:
        problems.append("too slow for the mission")
    fits = f"does not fit ({', '.join(problems)})" if problems else "fits"
    energy = f"energy {UNKNOWN}"
    if cost.energy_j is not None:
        energy = f"{spread(cost.energy_j['match'], 'J')} modelled"
    known = ((cost.marginal_w, "added by the work"), (cost.idle_w, "at rest"))
    power = [f"{spread(value, 'W')} {what}" for value, what in known if value is not None]
    return (
        f"{fits}; memory {memory}; a match takes {spread(cost.seconds['match'], 's')}, {energy}; "
        f"busy {busy(cost.load)}; power {', '.join(power) or UNKNOWN}"
    )


def memory_text(of: Design, target: Target) -> str:
    """Return the memory that a design takes on a target, and whether that is too much."""
    if target.kind == "processor":
        limit = broken_by(of, target, Mission(0.0, 0.0, 1.0), ())
        return size_text(memory_bytes(of, target)) + (f": over {limit}" if limit else "")
    if not target.blocks:
        return size_text(sizes(of).packed_bytes)
    blocks, enough = _blocks(of, target)
    return blocks if enough else f"{blocks}: too many"


def cells_text(taken: int, target: Target) -> str:
    """Return the logic cells that the core takes, and those that there are."""
    return f"{taken:,} of {target.logic_cells:,} logic cells"


def _blocks(of: Design, target: Target) -> tuple[str, bool]:
    """Return the block memories that a design takes, and whether there are as many."""
    needed = block_memories(of, target.block_shapes)
    if needed <= target.blocks or not target.large_blocks:
        return f"{needed} of {target.blocks} blocks", needed <= target.blocks
    large, rest = large_and_small_blocks(of, target.large_block_shapes, target.block_shapes)
    enough = rest <= target.blocks and large <= target.large_blocks
    return f"{rest} of {target.blocks} blocks, {large} of {target.large_blocks} large", enough
