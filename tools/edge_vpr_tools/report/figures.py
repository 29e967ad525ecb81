"""The figures of a mapped and matched drive.

Each function draws one and returns it as a Matplotlib figure, which the caller may change, save, or
show in a notebook.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.calibration import Reliability
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import Evaluation
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.report.page import MISSED
from edge_vpr_tools.report.style import (
    BLUE,
    CYCLE,
    ORANGE,
    RED,
    SKY,
    Scale,
    add_scale,
    figure,
    look,
)


def selected_pixels(reference: ReferenceMap) -> Figure:
    """Draw the selected pixels over the map that they were drawn from."""
    sensor = reference.pixel_map.sensor
    what = "mean" if reference.settings.strategy == "seed-code" else "variance"
    with figure(7.0, 1.5 + 5.2 * sensor.height / sensor.width) as (drawing, axes):
        shown = np.where(reference.hot, np.nan, reference.saliency)
        # a few pixels can vary a thousand times more than most: the root keeps the others visible
        image = axes.imshow(np.sqrt(shown), cmap="cividis", interpolation="nearest")
        axes.scatter(
            reference.pixel_map.x,
            reference.pixel_map.y,
            s=16,
            facecolor="white",
            edgecolor="black",
            linewidth=0.6,
            label=f"{len(reference.pixel_map)} selected pixels",
        )
        y, x = np.nonzero(reference.hot)
        if x.size:
            axes.scatter(x, y, s=30, marker="x", color=RED, label=f"{x.size} hot pixels, left out")
        bar = drawing.colorbar(image, ax=axes, shrink=0.8)
        bar.set_label(f"square root of the {what} of events per window")
        axes.set(
            title=f"Selected pixels ({reference.settings.strategy}) over the {what} of counts",
            xlabel="column (px)",
            ylabel="row (px)",
        )
        axes.grid(visible=False)
        axes.legend(loc="upper left", bbox_to_anchor=(0, -0.09), ncols=2)
    return drawing


def distance_matrix(
    distances: npt.NDArray[np.floating],
    stride: int,
    matches: Matches,
    truth: GroundTruth | None = None,
    found: Evaluation | None = None,
    query_scale: Scale | None = None,
    place_scale: Scale | None = None,
) -> Figure:
    """Draw the distances of all places to all queries, the matches, and the true places.

    Parameters
    ----------
    distances : ndarray of float, shape (rows, columns)
        Every `stride`-th place and query of D_seq.
    stride : int
    matches : Matches
    truth, found : GroundTruth and Evaluation, optional
    query_scale, place_scale : Scale, optional
        Of the query's windows and of the map's places: a second axis for each.
    """
    first = int(matches.query[0])
    extent = (
        first - 0.5,
        first + distances.shape[1] * stride - 0.5,
        first - 0.5,
        first + distances.shape[0] * stride - 0.5,
    )
    with figure(7.5, 6.8) as (drawing, axes):
        image = axes.imshow(
            distances, cmap="gray", origin="lower", aspect="auto", extent=extent,
            interpolation="nearest",
        )  # fmt: skip
        handles = []
        if truth is not None:
            _truth_band(axes, truth)
            handles.append(Line2D([], [], color=SKY, lw=6, alpha=0.6, label="true places"))
        if found is None:
            axes.plot(matches.query, matches.place, ".", color=ORANGE, ms=4)
            handles.append(_dot(ORANGE, ".", "match"))
        else:
            right, wrong = found.correct, found.evaluated & ~found.correct
            axes.plot(matches.query[wrong], matches.place[wrong], "x", color=RED, ms=5)
            axes.plot(matches.query[right], matches.place[right], ".", color=ORANGE, ms=4)
            handles.append(_dot(ORANGE, ".", f"right match ({right.sum()})"))
            handles.append(_dot(RED, "x", f"wrong match ({wrong.sum()})"))
        bar = drawing.colorbar(image, ax=axes, shrink=0.8)
        length = matches.settings.windows_per_match
        unit = "events" if matches.settings.counter_code == "none" else "codes"
        of = "of one window" if length == 1 else f"mean over sequences of {length} windows"
        bar.set_label(f"distance, {of} ({unit})")
        axes.set(
            title="Distance of each query to each place, and the best matches",
            xlabel="query window",
            ylabel="reference place",
        )
        axes.grid(visible=False)
        if query_scale is not None:
            add_scale(axes, "top", query_scale)
        if place_scale is not None:
            add_scale(axes, "right", place_scale)
        axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(0, -0.08), ncols=3)
    return drawing


def precision_recall(curves: Mapping[str, Evaluation]) -> Figure:
    """Draw the precision-recall curve of each variant, with P@100R and R@99P."""
    with figure(7.5, 5.2) as (drawing, axes):
        for i, (name, found) in enumerate(curves.items()):
            axes.step(
                found.curve.recall,
                found.curve.precision,
                where="post",
                **look(i),
                lw=2,
                label=f"{name}\nP@100R {found.precision_at_100_recall:.3f}, "
                f"R@99P {found.recall_at_99_precision:.3f}",
            )
        axes.axhline(0.99, color="gray", lw=0.8)
        some = next(iter(curves.values()))
        axes.set(
            title=f"Precision and recall over all thresholds on the {some.score}",
            xlabel=f"recall (missed queries: {MISSED[some.recall_denominator]})",
            ylabel="precision",
            xlim=(0, 1.01),
            ylim=(0, 1.03),
        )
        if len(curves) == 1:
            axes.legend(loc="lower left", fontsize=9)
        else:
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=9)
    return drawing


def reliability_diagram(found: Mapping[str, Reliability]) -> Figure:
    """Draw the share of right matches against their stated probability.

    Parameters
    ----------
    found : mapping of str to Reliability
        By what the matches are; the name is not shown if there is only one.
    """
    with figure(6.5, 5.2) as (drawing, axes):
        axes.plot([0, 1], [0, 1], color="gray", lw=0.8, label="probability equals share")
        for (name, one), colour in zip(found.items(), CYCLE, strict=False):
            axes.plot(one.probability, one.right, color=colour, lw=1.5)
            sizes = 15 + 285 * one.matches / one.matches.max()
            label = f"{one.matches.sum()} matches in {len(one.matches)} bins, larger: more"
            if len(found) > 1:
                label = f"{name}: {one.matches.sum():,} matches, error {_error(one)}"
            axes.scatter(one.probability, one.right, s=sizes, color=colour, label=label)
        single = next(iter(found.values())) if len(found) == 1 else None
        axes.set(
            title="Reliability: expected calibration error"
            + (", larger dots: more" if single is None else f" {_error(single)}"),
            xlabel="probability of being right, from the trust",
            ylabel="share of right matches",
            xlim=(0, 1.02),
            ylim=(0, 1.05),
        )
        axes.legend(loc="best" if single else "lower right", fontsize=9)
    return drawing


def _error(found: Reliability) -> str:
    return f"{found.expected_calibration_error:.3f}"


def event_rate(drives: Sequence[tuple[str, Descriptors]]) -> Figure:
    """Draw events a second over time, of the whole sensor and of the selected pixels."""
    with figure(7.5, 4.2) as (drawing, axes):
        for (name, drive), colour in zip(drives, (BLUE, ORANGE), strict=False):
            seconds = np.maximum(drive.end_us - drive.start_us, 1) / 1e6
            time = drive.centre_us / 1e6
            axes.plot(time, drive.events / seconds, color=colour, lw=1.5, label=f"{name}, all")
            selected = drive.counts.sum(axis=1, dtype=np.int64)
            axes.plot(
                time, selected / seconds, color=colour, lw=1.2, ls="--", label=f"{name}, selected"
            )
        axes.set_yscale("log")
        axes.set(
            title="Event rate of the whole sensor and of the selected pixels",
            xlabel="time (s)",
            ylabel="events per second",
        )
        axes.legend(ncols=2, fontsize=9)
    return drawing


def window_lengths(drives: Sequence[tuple[str, Descriptors]]) -> Figure:
    """Draw how long each window lasted."""
    with figure(7.5, 3.8) as (drawing, axes):
        for (name, drive), colour in zip(drives, (BLUE, ORANGE), strict=False):
            seconds = (drive.end_us - drive.start_us) / 1e6
            label = f"{name}: median {np.median(seconds):.3g} s, {len(drive)} windows"
            axes.plot(drive.centre_us / 1e6, seconds, color=colour, lw=1.5, label=label)
        axes.set(
            title="Length of each window",
            xlabel="time (s)",
            ylabel="length (s)",
        )
        axes.set_ylim(bottom=0)
        axes.legend(fontsize=9)
    return drawing


def online_places(matches: Matches, place_scale: Scale | None = None) -> Figure:
    """Draw the matched places over time; matches with little trust are light.

    Parameters
    ----------
    matches : Matches
    place_scale : Scale, optional
        Of the map's places: a second axis.
    """
    with figure(7.5, 5.0) as (drawing, axes):
        # more than some ten thousand points cannot be distinguished in a picture
        shown = matches.every(1 + len(matches) // 20_000)
        points = axes.scatter(
            shown.time_us / 1e6, shown.place, c=shown.trust, s=3, cmap="cividis_r", rasterized=True
        )
        drawing.colorbar(points, ax=axes).set_label("trust")
        axes.set(
            title=f"Best place over time, {len(matches):,} matches",
            xlabel="time (s)",
            ylabel="reference place",
            ylim=(-0.5, matches.places_in_map - 0.5),
        )
        if place_scale is not None:
            add_scale(axes, "right", place_scale)
    return drawing


def _truth_band(axes, truth: GroundTruth) -> None:  # type: ignore[no-untyped-def]
    places, queries = truth.correct.shape
    widened = truth.correct.copy()
    # one of hundreds of places would be thinner than a pixel of the picture
    for shift in range(1, 1 + places // 250):
        widened[shift:] |= truth.correct[:-shift]
        widened[:-shift] |= truth.correct[shift:]
    band = np.ma.masked_equal(widened[:: 1 + places // 2000, :: 1 + queries // 2000], False)
    axes.imshow(
        band,
        cmap=_single_colour(SKY),
        alpha=0.55,
        origin="lower",
        aspect="auto",
        extent=(-0.5, queries - 0.5, -0.5, places - 0.5),
        interpolation="nearest",
    )
    axes.set_xlim(-0.5, queries - 0.5)
    axes.set_ylim(-0.5, places - 0.5)


def _single_colour(colour: str):  # type: ignore[no-untyped-def]

    return ListedColormap([colour])


def _dot(colour: str, marker: str, label: str) -> Line2D:
    return Line2D([], [], color=colour, marker=marker, ls="", label=label)
