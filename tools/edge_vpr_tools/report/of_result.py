"""What `MatchResult` shows by itself: its plots, its report, and what a notebook displays.

`edge_vpr.reference_map` imports this module by its name when one of these is asked for.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.layout_engine import ConstrainedLayoutEngine

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.metrics import Evaluation
from edge_vpr.match_result import MatchResult
from edge_vpr.records import to_json, write_json
from edge_vpr.results import METRICS, results_folder
from edge_vpr_tools.report.figures import (
    TIME,
    WIDTH,
    RouteView,
    along_route,
    draw_errors,
    draw_probability,
    has_probability,
    over_time,
)
from edge_vpr_tools.report.page import as_html
from edge_vpr_tools.report.style import STYLE, legend_below, save
from edge_vpr_tools.report.traverse import evaluated, write_report
from edge_vpr_tools.report.verdict import outcome_of


def plot(
    result: MatchResult, evaluation: Evaluation | None, axes: Axes | Sequence[Axes] | None
) -> npt.NDArray[Any]:
    """Draw the route, the error and the probability; see `MatchResult.plot`."""
    outcome = outcome_of(result.reference, result.matches, evaluation)
    view = RouteView.of(result.reference, outcome, result.reference.route)
    scale = along_route(result.reference, result.reference.route)
    panels: list[Callable[[Axes], None]] = []
    if view is not None:
        panels.append(lambda on: view.draw(on, outcome))
    panels.append(lambda on: draw_errors(on, outcome, scale))
    if has_probability(outcome):
        panels.append(lambda on: draw_probability(on, outcome))
    if axes is None:
        from matplotlib import pyplot  # which notebooks and `pyplot.show` need

        heights = [2.4] * len(panels)
        if view is not None:
            heights[0] = view.height(outcome, WIDTH)
        with mpl.rc_context(STYLE):
            size = (WIDTH, sum(heights) + 0.4)
            _, grid = pyplot.subplots(
                len(panels), 1, figsize=size, height_ratios=heights, squeeze=False
            )
            return _drawn(panels, list(grid[:, 0]), view is not None, outcome.title)
    panels_of_user = list(np.ravel(np.asarray(axes, dtype=object)))
    if not panels_of_user or not all(isinstance(each, Axes) for each in panels_of_user):
        raise UsageError("axes= is no Matplotlib axes: give one or more, as of pyplot.subplots(3)")
    return _drawn(panels, panels_of_user, view is not None, outcome.title)


def _drawn(
    panels: Sequence[Callable[[Axes], None]], axes: list[Axes], first_is_route: bool, title: str
) -> npt.NDArray[Any]:
    """Draw as many panels as there are axes, with one title, and a legend below if it has room."""
    used = axes[: len(panels)]
    used[0].set_title(title)
    for number, (draw, on) in enumerate(zip(panels, used, strict=False)):
        draw(on)
        if number or not first_is_route:
            on.set_xlabel(TIME)
    labelled = [on for on in used if on.get_legend_handles_labels()[1]]
    for on in labelled[:1]:
        drawing = on.get_figure(root=True)
        assert drawing is not None
        constrained = isinstance(drawing.get_layout_engine(), ConstrainedLayoutEngine)
        if constrained and not drawing.legends:
            wide = drawing.get_figwidth() > drawing.get_figheight()
            legend_below(drawing, [on], 4 if wide else 2, fontsize=9)
        else:
            on.legend(fontsize=9)
    return np.array(used, dtype=object)


def write(
    result: MatchResult,
    folder: Path,
    evaluation: Evaluation | None,
    figures: Sequence[str],
    overwrite: bool,
) -> None:
    """Write a folder of results with its report; see `MatchResult.report`."""
    outcome = outcome_of(result.reference, result.matches, evaluation)
    with results_folder(folder, overwrite, result.inputs) as new:
        run, facts = result.write(new, result.inputs), result.facts(outcome.truth)
        write_report(new, result, run, outcome, figures, facts)
        if evaluation is not None:
            metrics = {} if result.metrics is None else to_json(result.metrics)
            metrics |= evaluated(result, outcome, evaluation, facts, ())
            write_json(new / METRICS, metrics)


def html(result: MatchResult) -> str:
    """Return the verdict and the route as HTML."""
    outcome = outcome_of(result.reference, result.matches)
    view = RouteView.of(result.reference, outcome, result.reference.route)
    drawing = over_time(outcome) if view is None else view.figure(outcome)
    picture = base64.b64encode(save(drawing)).decode("ascii")
    text = as_html(outcome.sentence)
    return (
        f"<p><strong>{text}</strong></p>"
        f'<img alt="the matches" style="background: white" '
        f'src="data:image/svg+xml;base64,{picture}">'
    )
