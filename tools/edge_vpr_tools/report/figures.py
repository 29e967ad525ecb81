"""The figures of a mapped and matched drive.

Each function draws one and returns it as a Matplotlib figure, which the caller may change, save, or
show in a notebook.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.calibration import Reliability
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import Evaluation
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Route
from edge_vpr_tools.console import number_of
from edge_vpr_tools.report.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    SKY,
    figure,
    legend_below,
    panels,
)
from edge_vpr_tools.report.verdict import Bools, Outcome

# Figures of the outcome of each match: correct, wrong or not accepted.


#: width of a figure in inches, at which its letters can be read on a telephone
WIDTH = 5.4
#: more points are drawn as a raster within the figure
_MOST_SHAPES = 2_000
#: a picture of distances shows no more cells than this on a side
_SIDE = 1500
#: area of the dot of the pixel with most events, in points squared
_LARGEST_DOT = 60.0

Floats = npt.NDArray[np.float64]


class _Group(NamedTuple):
    """Matches that look the same."""

    label: str
    of: Bools
    look: dict[str, Any]


def _groups(outcome: Outcome) -> list[_Group]:
    """Return the matches grouped by outcome, those to be drawn on top last; no group is empty."""
    taken = outcome.accepted
    # a transparent colour and not "none": Matplotlib draws marks much faster that have a colour
    ring = {"s": 22, "facecolors": "#ffffff00", "edgecolors": SKY, "linewidths": 1.0}
    cross = {"s": 55, "marker": "X", "linewidths": 0.7, "edgecolors": "white"}
    dot = {"s": 16, "color": BLUE, "linewidths": 0}
    if outcome.evaluation is None:
        label = "match" if outcome.precision is None else "accepted"
        groups = [_Group("not accepted", ~taken, ring), _Group(label, taken, dot)]
    else:
        correct, wrong = outcome.correct, outcome.wrong
        accepted = "" if outcome.precision is None else ", accepted"
        groups = [
            _Group(f"correct{accepted}", correct & taken, dot),
            _Group("correct, not accepted", correct & ~taken, ring),
            _Group("wrong, not accepted", wrong & ~taken, {**cross, "color": BLACK}),
            _Group(f"wrong{accepted}", wrong & taken, {**cross, "color": RED}),
        ]
    return [group for group in groups if group.of.any()]


def draw_outcomes(axes: Axes, x: Floats, y: Floats, outcome: Outcome) -> None:
    """Draw a mark for each match by its outcome, with labels for a legend."""
    for group in _groups(outcome):
        axes.scatter(
            x[group.of], y[group.of], **group.look, zorder=3,
            label=f"{group.label} ({np.count_nonzero(group.of):,})",
            rasterized=bool(np.count_nonzero(group.of) > _MOST_SHAPES),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class RouteView:
    """Where each match was made: on the route from above, or along it.

    Attributes
    ----------
    at : ndarray of float64, shape (n, d) or (n,)
        Position of each match to draw, of the query where it is known, else of the place: d of 2 or
        more, or along the route.
    caption : str
        A sentence on what is shown.
    label : str
        Of the axis along the route, with the unit.
    route : Route, optional
        Drawn from above, if it has two dimensions or more; None of a view along it.
    """

    at: Floats
    caption: str
    label: str = ""
    route: Route | None = None

    @classmethod
    def of(cls, reference: ReferenceMap, outcome: Outcome, route: Route | None) -> RouteView | None:
        """Return the best view that positions of the map or of the truth allow; None without any.

        Parameters
        ----------
        route : Route, optional
            Positions of the places.
        """
        places, query = outcome.matches.place, outcome.matches.query
        positions = None if outcome.truth is None else outcome.truth.positions
        if route is not None and route.position.shape[1] > 1:
            if positions is not None and positions.are_like(route.kind, route.position):
                text = "a line leads to the place that a wrong match gave"
                text = f"The route from above. Each mark is where the camera was; {text}."
                return cls(positions.query[query], text, "", route)
            text = "The route from above. Each mark is where the camera was according to a match."
            return cls(route.position[places], text, "", route)
        along = "distance along the route (m)"
        if positions is not None and positions.query.shape[1] == 1:
            unit = positions.unit
            label = along if unit == "m" else f"true reference place ({unit})"
            text = "Where on the route each match was made."
            return cls(positions.query[query, 0], text, label)
        if reference.along_mm is None:
            return None
        at = reference.along_mm[places] / 1e3
        return cls(at, "The place of each match along the route.", along)

    def draw(self, axes: Axes, outcome: Outcome) -> None:
        """Draw a mark for each match by its outcome."""
        if self.route is None:
            _draw_along(axes, outcome, self.at, self.label)
            return
        route = self.route.metres(self.route.position)[:, :2]
        shown = self.route.metres(self.at)[:, :2]
        axes.plot(*route.T, color=GREY, lw=1.2, alpha=0.7, zorder=1, label="route of the map")
        _draw_direction(axes, route[np.isfinite(route).all(axis=1)])
        matched = route[outcome.matches.place]
        wrong = outcome.wrong
        axes.add_collection(
            LineCollection(
                list(np.stack([shown[wrong], matched[wrong]], axis=1)),
                colors=[RED if taken else BLACK for taken in outcome.accepted[wrong]],
                linewidths=0.9, linestyles="--", alpha=0.6, zorder=2,
                label="error of a wrong match" if wrong.any() else None,
            )
        )  # fmt: skip
        draw_outcomes(axes, shown[:, 0], shown[:, 1], outcome)
        axes.set_aspect("equal", adjustable="datalim")
        if self.route.kind == "geographic":
            axes.set(xlabel="east (m)", ylabel="north (m)")
        else:
            axes.set(xlabel="x (m)", ylabel="y (m)")

    def height(self, outcome: Outcome, width: float) -> float:
        """Return a height in inches for axes of a width."""
        if self.route is None:
            return 1.1 + 0.32 * len(_groups(outcome))
        route = self.route.metres(self.route.position)[:, :2]
        across, along = np.ptp(route[np.isfinite(route).all(axis=1)], axis=0)
        return float(np.clip(width * along / max(across, 1e-9), 2.2, 5.5)) + 0.7

    def figure(self, outcome: Outcome) -> Figure:
        """Return the view as a figure of its own."""
        above = self.route is not None
        with figure(WIDTH, self.height(outcome, WIDTH) + 0.7 * above) as (drawing, axes):
            self.draw(axes, outcome)
            drawing.suptitle(outcome.title, fontsize=12)
            if above:
                legend_below(drawing, [axes], 2, fontsize=10)
        return drawing


#: arrows along a route
_ARROWS = 5


def _draw_direction(axes: Axes, route: Floats) -> None:
    """Draw where a route starts, and arrows in the direction in which it was mapped."""
    axes.plot(*route[0], "o", color=BLACK, mfc="none", mew=1.8, ms=11, zorder=2.5, label="start")
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
    for metres in np.linspace(0.0, along[-1], 2 * _ARROWS + 1)[1::2]:
        tail = int(np.searchsorted(along, metres))
        head = np.searchsorted(along, along[tail] + along[-1] / 200, side="right")
        axes.annotate(
            "", route[min(head, len(route) - 1)], route[tail], zorder=4,
            arrowprops={"arrowstyle": "-|>,head_length=0.7,head_width=0.35", "color": BLACK},
        )  # fmt: skip


def _draw_along(axes: Axes, outcome: Outcome, at: Floats, label: str) -> None:
    """Draw where along the route each match was made, a row for each outcome."""
    groups = _groups(outcome)[::-1]
    for row, group in enumerate(groups):
        colour = group.look.get("color", SKY)
        where = at[group.of]
        axes.eventplot(
            where[np.isfinite(where)], lineoffsets=row, linelengths=0.7, linewidths=1.2,
            colors=colour, rasterized=bool(where.size > _MOST_SHAPES),
        )  # fmt: skip
    names = [f"{group.label} ({np.count_nonzero(group.of):,})" for group in groups]
    axes.set_yticks(range(len(groups)), names)
    axes.set(xlabel=label, ylim=(len(groups) - 0.5, -0.5))
    axes.grid(visible=False, axis="y")


def has_probability(outcome: Outcome) -> bool:
    """Return whether the probability of any match is known."""
    return bool(np.isfinite(outcome.matches.probability).any())


def draw_errors(axes: Axes, outcome: Outcome, scale: Scale | None) -> None:
    """Draw the error of each match over time, or else its place; see `over_time`."""
    errors = outcome.errors
    if errors is None or outcome.truth is None:
        place = outcome.matches.place
        shown = place.astype(np.float64) if scale is None else scale.values[place]
        draw_outcomes(axes, outcome.time_s, shown, outcome)
        axes.set(ylabel="place" if scale is None else scale.label)
    else:
        draw_outcomes(axes, outcome.time_s, errors, outcome)
        _error_axis(axes, outcome.truth, errors[outcome.correct | outcome.wrong])


def draw_probability(axes: Axes, outcome: Outcome) -> None:
    """Draw the probability of each match over time."""
    draw_outcomes(axes, outcome.time_s, outcome.matches.probability, outcome)
    axes.set(ylabel="probability", ylim=(-0.04, 1.04))


#: label of an axis of times
TIME = "time of the query (s)"


def over_time(outcome: Outcome, scale: Scale | None = None) -> Figure:
    """Draw the error of each match over time, or else its place, and below it the probability.

    Parameters
    ----------
    scale : Scale, optional
        Where the places are along the route, shown before an evaluation; by default their numbers.
    """
    rated = has_probability(outcome)
    with panels(1 + rated, 1, WIDTH, 4.3 + 2.0 * rated, sharex=True) as (drawing, rows):
        draw_errors(rows[0, 0], outcome, scale)
        if rated:
            draw_probability(rows[1, 0], outcome)
        drawing.suptitle(outcome.title, fontsize=12)
        rows[-1, 0].set(xlabel=TIME)
        legend_below(drawing, [rows[0, 0]], 2, fontsize=10)
    return drawing


def _error_axis(axes: Axes, truth: GroundTruth, errors: Floats) -> None:
    """Scale the axis of errors: linear up to the tolerance, logarithmic beyond."""
    tolerance = None if truth.positions is None else truth.positions.tolerance
    largest = float(np.nanmax(errors, initial=0.0))
    label = f"error ({truth.error_unit})"
    if tolerance:
        axes.axhline(tolerance, color=GREY, lw=1, ls="--")
        axes.text(
            0.99, tolerance, f"tolerance {tolerance:g} {truth.error_unit}", color=GREY, fontsize=9,
            ha="right", va="bottom", transform=axes.get_yaxis_transform(),
        )  # fmt: skip
        if largest > 3 * tolerance:
            axes.set_yscale("symlog", linthresh=tolerance, linscale=1.0)
            decades = 10.0 ** np.arange(np.floor(np.log10(tolerance)), np.log10(largest) + 1)
            steps = (1, 2, 5) if largest < 100 * tolerance else (1,)
            above = np.outer(decades, steps).ravel()
            ticks = [0.0, tolerance, *above[(above > 1.5 * tolerance) & (above <= largest)]]
            axes.set_yticks(ticks, [f"{value:g}" for value in ticks])
            axes.minorticks_off()
            label += f", log above {tolerance:g}"
    axes.set_ylim(0, 1.12 * max(largest, 1.25 * (tolerance or 0.8)))  # also where all errors are 0
    axes.set_ylabel(label)


class Window(NamedTuple):
    """A window to show: its title, and the counts at the selected pixels, shape (J,)."""

    title: str
    counts: npt.NDArray[np.integer]


def dot_sizes(counts: npt.NDArray[np.integer], most: float) -> Floats:
    """Return the area of the dot of each pixel, in points squared; see `draw_window`."""
    return _LARGEST_DOT * np.minimum(counts / max(most, 1e-9), 1.0)


def draw_window(axes: Axes, reference: ReferenceMap, window: Window, most: float) -> PathCollection:
    """Draw the selected pixels of a window on the sensor, larger where more events were counted.

    Parameters
    ----------
    most : float
        Count of the largest dot.

    Returns
    -------
    PathCollection
        The dots, whose sizes may be changed.
    """
    pixels, sensor = reference.pixel_map, reference.pixel_map.sensor
    sizes = dot_sizes(window.counts, most)
    dots = axes.scatter(pixels.x, pixels.y, s=sizes, color=BLUE, linewidths=0, alpha=0.85)
    axes.scatter(pixels.x, pixels.y, s=1.5, color=GREY, linewidths=0)
    axes.set(
        xlim=(-0.5, sensor.width - 0.5), ylim=(sensor.height - 0.5, -0.5), xticks=[], yticks=[]
    )
    axes.set_aspect("equal")
    axes.grid(visible=False)
    axes.set_title(window.title, fontsize=10)
    for spine in axes.spines.values():
        spine.set(visible=True, color=GREY)
    return dots


def windows_side_by_side(reference: ReferenceMap, windows: list[Window]) -> Figure:
    """Draw windows in a row, with equal scales; see `draw_window`."""
    sensor = reference.pixel_map.sensor
    most = float(np.percentile(np.concatenate([window.counts for window in windows]), 99))
    height = WIDTH / len(windows) * sensor.height / sensor.width + 0.3
    with panels(1, len(windows), WIDTH, height) as (drawing, (row,)):
        for axes, window in zip(row, windows, strict=True):
            draw_window(axes, reference, window, most)
    return drawing


def total_counts(reference: ReferenceMap, drive: Descriptors) -> npt.NDArray[np.int64]:
    """Return the counts of the windows at each selected pixel, of both polarities, shape (n, J)."""
    counts = reference.decoded(drive).counts.astype(np.int64)
    return counts.reshape(len(counts), -1, len(reference.pixel_map)).sum(axis=1)


def selected_pixels(reference: ReferenceMap) -> Figure:
    """Draw the selected pixels over the map that they were drawn from."""
    sensor = reference.pixel_map.sensor
    what = "mean" if reference.settings.strategy == "seed-code" else "variance"
    with figure(WIDTH, 2.0 + 4.4 * sensor.height / sensor.width) as (drawing, axes):
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
            axes.scatter(
                x,
                y,
                s=30,
                marker="x",
                color=RED,
                label=f"{number_of(x.size, 'hot pixel')}, left out",
            )
        bar = drawing.colorbar(image, ax=axes, shrink=0.8, location="bottom", aspect=30)
        bar.set_label(f"square root of the {what} of events per window")
        axes.set(xlabel="column (px)", ylabel="row (px)")
        axes.grid(visible=False)
        legend_below(drawing, [axes], 2, fontsize=9)
    return drawing


def distance_matrix(
    reference: ReferenceMap, queries: Descriptors, outcome: Outcome, route: Route | None
) -> Figure:
    """Draw the distances of all places to all queries, the matches, and the true places.

    Parameters
    ----------
    route : Route, optional
        Positions of the places, for a second axis; by default it is the time of the reference.
    """
    matches, truth, evaluation = outcome.matches, outcome.truth, outcome.evaluation
    distances, strides = shown_distances(reference.places, queries, matches)
    first = int(matches.query[0])
    extent = (
        first - 0.5,
        first + distances.shape[1] * strides[1] - 0.5,
        first - 0.5,
        first + distances.shape[0] * strides[0] - 0.5,
    )
    with figure(WIDTH, 6.2) as (drawing, axes):
        image = axes.imshow(
            distances, cmap="gray", origin="lower", aspect="auto", extent=extent,
            interpolation="nearest",
        )  # fmt: skip
        handles = []
        if truth is not None:
            _truth_band(axes, truth)
            handles.append(Line2D([], [], color=GREEN, lw=6, alpha=0.6, label="true places"))
        if evaluation is None:
            handles += axes.plot(
                matches.query, matches.place, ".", color=ORANGE, ms=4, label="match"
            )
        else:
            correct, wrong = evaluation.correct, evaluation.evaluated & ~evaluation.correct
            handles += axes.plot(
                matches.query[correct], matches.place[correct], ".", color=ORANGE, ms=4,
                label=f"correct match ({correct.sum()})",
            )  # fmt: skip
            if wrong.any():  # seen on dark and on light distances
                handles += axes.plot(
                    matches.query[wrong], matches.place[wrong], "X", color=BLACK, mec="white", ms=7,
                    mew=0.7, label=f"wrong match ({wrong.sum()})",
                )  # fmt: skip
        bar = drawing.colorbar(image, ax=axes, location="bottom", shrink=0.8, aspect=30)
        length = matches.settings.windows_per_match
        unit = "events" if matches.settings.counter_code == "none" else "codes"
        of = "of one window" if length == 1 else f"mean over sequences of {length} windows"
        bar.set_label(f"distance, {of} ({unit})")
        half = ", at half windows" * (matches.settings.window_parts == 2)
        axes.set(xlabel="query window", ylabel=f"reference place{half}")
        axes.grid(visible=False)
        add_scale(axes, "top", seconds(queries.centre_us, "query"))
        add_scale(axes, "right", along_route(reference, route))
        drawing.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=9)
    return drawing


def shown_distances(
    places: Descriptors, queries: Descriptors, matches: Matches
) -> tuple[npt.NDArray[np.float64], tuple[int, int]]:
    """Compute D_seq at every few places and queries, so that a long drive fits a picture.

    Returns
    -------
    distances : ndarray of float64, shape (rows, columns)
    strides : (int, int)
        Of the places and of the queries.
    """
    length = matches.settings.windows_per_match
    strides = (1 + len(places) // _SIDE, 1 + len(queries) // _SIDE)
    rows = np.arange(0, len(places) - length + 1, strides[0])
    columns = np.arange(0, len(matches), strides[1])
    total = np.zeros((rows.size, columns.size))
    for i in range(length):  # the i-th windows of all sequences
        total += ReferenceIndex(places.counts[rows + i]).matrix(queries.counts[columns + i])
    return total / length, strides


#: what recall is a share of, by the name of the denominator
FINDABLE: dict[str, str] = {
    "rejected-correct": "queries whose best match is correct",
    "all-with-place": "queries with a place in the map",
}


def precision_recall(evaluation: Evaluation, name: str) -> Figure:
    """Draw the precision-recall curve of the matches of a name, with P@100R and R@99P."""
    curve = evaluation.curve
    least = min(0.9, float(curve.precision.min()))
    with figure(WIDTH, 4.2) as (drawing, axes):
        axes.step(
            curve.recall,
            curve.precision,
            where="pre",  # as R@99P and average precision count it
            color=BLUE,
            lw=2,
            label=f"{name}\nP@100R {evaluation.precision_at_100_recall:.3f}, "
            f"R@99P {evaluation.recall_at_99_precision:.3f}",
        )
        axes.axhline(0.99, color="gray", lw=0.8)
        of = FINDABLE[evaluation.recall_denominator]
        axes.set(
            title=f"Thresholds on the {evaluation.score}",
            xlabel=f"recall, of the {evaluation.findable:,} {of}",
            ylabel="precision",
            xlim=(0, 1.01),
            ylim=(max(0.0, least - 0.1 * (1 - least)), 1 + 0.03 * (1 - least)),
        )
        legend_below(drawing, [axes], 1, fontsize=9)
    return drawing


def reliability_diagram(reliability: Reliability) -> Figure:
    """Draw the share of correct matches against their stated probability."""
    matches = reliability.matches
    with figure(WIDTH, 4.8) as (drawing, axes):
        axes.plot([0, 1], [0, 1], color="gray", lw=0.8, label="probability equals share")
        axes.plot(reliability.probability, reliability.right, color=BLUE, lw=1.5)
        axes.scatter(
            reliability.probability, reliability.right, s=15 + 285 * matches / matches.max(),
            color=BLUE, label=f"{number_of(int(matches.sum()), 'match')} in "
            f"{number_of(len(matches), 'bin')}, larger: more",
        )  # fmt: skip
        error = reliability.expected_calibration_error
        axes.set(
            title=f"Reliability: expected calibration error {error:.3f}",
            xlabel="probability of being correct",
            ylabel="share of correct matches",
            xlim=(0, 1.02),
            ylim=(0, 1.05),
        )
        legend_below(drawing, [axes], 1, fontsize=9)
    return drawing


def _truth_band(axes: Axes, truth: GroundTruth) -> None:
    places, queries = truth.correct.shape
    band = np.ma.masked_equal(true_cells(truth.correct), False)
    axes.imshow(
        band,
        cmap=ListedColormap([GREEN]),
        alpha=0.55,
        origin="lower",
        aspect="auto",
        extent=(-0.5, queries - 0.5, -0.5, places - 0.5),
        interpolation="nearest",
    )
    axes.set_xlim(-0.5, queries - 0.5)
    axes.set_ylim(-0.5, places - 0.5)


def true_cells(correct: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return the cells of a picture of at most 2,000 on a side with a true place, widened.

    One of hundreds of places would be thinner than a pixel of the picture.
    """
    height, width = (1 + side // 2000 for side in correct.shape)
    shape = tuple(-(-side // n) for side, n in zip(correct.shape, (height, width), strict=True))
    cells = np.zeros(shape, dtype=np.bool_)
    place, query = np.nonzero(correct)
    cells[place // height, query // width] = True
    widened = cells.copy()
    for shift in range(1, 1 + shape[0] // 250):
        widened[shift:] |= cells[:-shift]
        widened[:-shift] |= cells[shift:]
    return widened


# Second axes of figures: seconds or metres beside the numbers of windows and places.


_TICKS = 7


@dataclass(frozen=True, eq=False)
class Scale:
    """A quantity that grows from window to window of a drive."""

    #: Shape (n,): of each window, not falling; NaN where it is not known.
    values: Floats
    label: str  #: With the unit.

    def ticks(self) -> tuple[Floats, Floats]:
        """Return round values, and between which windows each of them was reached.

        Returns
        -------
        positions, values : ndarray of float64, shape (m,)
            m is 0 where fewer than two different values are known.
        """
        with_value = np.flatnonzero(np.isfinite(self.values))
        values = self.values[with_value]
        if with_value.size < 2 or values[0] == values[-1]:
            return np.empty(0), np.empty(0)
        round_values = MaxNLocator(_TICKS, steps=[1, 2, 5, 10]).tick_values(values[0], values[-1])
        inside = round_values[(round_values >= values[0]) & (round_values <= values[-1])]
        return np.interp(inside, values, with_value), inside


def seconds(centre_us: npt.NDArray[np.int64], drive: str) -> Scale:
    """Return the time of each window."""
    return Scale(centre_us / 1e6, f"time of the {drive} drive (s)")


def along_route(reference: ReferenceMap, route: Route | None) -> Scale:
    """Return the metres to each place where a track or odometry says them, else the seconds."""
    along_m = reference.along_m if route is None else route.along_m
    if along_m is None:
        return seconds(reference.places.centre_us, "reference")
    return Scale(along_m, "distance along the route (m)")


def add_scale(axes: Axes, side: str, scale: Scale) -> None:
    """Draw a second axis; nothing is drawn where the quantity is not known.

    Parameters
    ----------
    axes : Axes
        With windows or places, from 0, on the opposite axis.
    """
    positions, values = scale.ticks()
    if not positions.size:
        return
    texts = [f"{value:g}" for value in values]
    if side == "top":
        second = axes.secondary_xaxis("top")
        second.set_xticks(positions, texts)
        second.set_xlabel(scale.label)
    else:
        second = axes.secondary_yaxis("right")
        second.set_yticks(positions, texts)
        second.set_ylabel(scale.label)
