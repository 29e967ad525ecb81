"""The figure of an estimate: accuracy of evaluated designs against their cost on a target."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edge_vpr_tools.estimate.search import Candidate
from edge_vpr_tools.estimate.targets import Target
from edge_vpr_tools.report.style import (
    BLUE,
    ORANGE,
    legend_below,
    name_label,
    panels,
    quantity_axis,
)


def frontier(found: Sequence[Candidate], cost_of: Callable[[Candidate], float]) -> list[Candidate]:
    """Return the designs for which no other is as accurate at a lower cost."""
    best: list[Candidate] = []
    for one in sorted(found, key=lambda c: (cost_of(c), -c.accuracy)):
        if not best or one.accuracy > best[-1].accuracy:
            best.append(one)
    return best


def draw(found: Sequence[Candidate], target: Target) -> Figure:
    """Draw accuracy against energy a match and memory; what no other beats has its name."""
    with panels(1, 2, 12.0, 5.2, sharey=True) as (drawing, ((left, right),)):
        known = [one for one in found if one.cost.per_match_j is not None]
        if known:
            _panel(left, known, _joules, "J", "energy of a match: modelled")
        else:
            left.text(
                0.5, 0.5, f"energy on {target.name}: unknown", transform=left.transAxes, ha="center"
            )
            left.set_xticks([])
        _panel(right, found, lambda one: one.memory_bytes, "B", "memory (1 kB is 1,000 bytes)")
        left.set_ylabel("correct (P@100R)")
        legend_below(drawing, [right], 3)
        drawing.suptitle(f"Accuracy against energy and bytes on {target.name}")
    return drawing


def _joules(one: Candidate) -> float:
    assert one.cost.per_match_j is not None
    return one.cost.per_match_j.central


def _panel(
    axes: Axes,
    found: Sequence[Candidate],
    cost_of: Callable[[Candidate], float],
    unit: str,
    label: str,
) -> None:
    for limited, marker, colour, name in (
        (False, "o", BLUE, "fits"), (True, "x", ORANGE, "over a budget")
    ):  # fmt: skip
        those = [one for one in found if bool(one.limited_by) == limited]
        if those:
            axes.plot(
                [cost_of(one) for one in those], [one.accuracy for one in those],
                marker, color=colour, label=name,
            )  # fmt: skip
    kept = frontier(found, cost_of)
    axes.step(
        [cost_of(one) for one in kept], [one.accuracy for one in kept], where="post",
        color=BLUE, lw=1, alpha=0.6, label="no other is better and cheaper",
    )  # fmt: skip
    for before, one in zip([None, *kept], kept, strict=False):
        # to the left of the steps is room, but for what is hardly above the step before
        beside = before is not None and one.accuracy - before.accuracy < 0.02
        axes.annotate(
            name_label(Path(one.name).name), (cost_of(one), one.accuracy), fontsize=7,
            ha="left" if beside else "right", xytext=(5 if beside else -5, 3),
            textcoords="offset points",
        )  # fmt: skip
    quantity_axis(axes.xaxis, unit)
    axes.margins(x=0.3)
    axes.set_xlabel(label)
