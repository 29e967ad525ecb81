"""A match as a film: the events, the cost of each place, the position and the probability."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image

from edge_vpr.descriptors.published import WindowSource
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import EdgeVprWarning, UsageError
from edge_vpr.evaluation.ground_truth import TruePositions
from edge_vpr.files import replacing
from edge_vpr.match_result import MatchResult, describe_query
from edge_vpr.matching.drive import query_distances
from edge_vpr.matching.matches import Matches
from edge_vpr.matching.sequences import middle_window
from edge_vpr.odometry import Odometry
from edge_vpr.recordings.reading import EventSource
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Route
from edge_vpr_tools.report.figures import Window, along_route, dot_sizes, draw_window, total_counts
from edge_vpr_tools.report.style import BLACK, BLUE, GREEN, GREY, ORANGE, RED, SKY, panels
from edge_vpr_tools.report.verdict import Outcome, outcome_of
from edge_vpr_tools.truth_files import TruthFiles, truth_of

_DPI = 100
_WIDTH, _HEIGHT = 7.2, 4.5
#: colours of a film; its frames share them, so that unchanged parts are stored once
_COLOURS = 64
#: a colour of the palette that is so near to paper or a mark was mixed with it
_MIXED = 10

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Replay:
    """Contents of a film, frame by frame."""

    reference: ReferenceMap
    outcome: Outcome  #: Of n matches, one a frame.
    queries: Descriptors  #: Window of each frame, n of them.
    #: Shape (K, n): of each place, NaN where it cannot match; the match is the place of the least.
    cost: Floats
    #: Shape (n, height, width): events of each window at every pixel.
    images: npt.NDArray[np.integer] | None = None
    #: Where the camera was in each frame, as `query`; None where that is not known.
    true: TruePositions | None = None

    def __len__(self) -> int:
        return len(self.queries)

    def captions(self) -> list[str]:
        """Return what each frame shows, in words."""
        matches, along = self.outcome.matches, self.reference.along_mm
        texts = []
        for i in range(len(self)):
            place = int(matches.place[i])
            text = f"{matches.time_us[i] / 1e6:.1f} s: place {place} of {len(self.reference)}"
            if along is not None:
                text += f", at {along[place] / 1e3:,.0f} m"
            if np.isfinite(matches.probability[i]):
                text += f", probability {matches.probability[i]:.2f}"
            if self.outcome.precision is not None:
                accepted = "accepted" if self.outcome.accepted[i] else "not accepted"
                text += f", {accepted} at {self.outcome.precision:g}"
            if self.outcome.correct[i] or self.outcome.wrong[i]:
                text += ", correct" if self.outcome.correct[i] else ", wrong"
            texts.append(text)
        return texts


def frames(replay: Replay) -> Iterator[Image.Image]:
    """Draw the frames, all with the same palette.

    Yields
    ------
    Image
        In mode P.
    """
    palette: Image.Image | None = None
    with panels(2, 3, _WIDTH, _HEIGHT) as (drawing, axes):
        film = _Film(replay, drawing, axes)
        # the palette is that of a frame in the middle, which has all lines
        for i in (len(replay) // 2, *range(len(replay))):
            picture = film.frame(i)
            if palette is None:
                palette = _palette_of(picture)
            else:
                yield picture.quantize(palette=palette, dither=Image.Dither.NONE)


def _palette_of(picture: Image.Image) -> Image.Image:
    """Return a palette of the most frequent colours, with those of paper and marks as they are."""
    palette = picture.quantize(_COLOURS)
    colours = np.array(palette.getpalette(), dtype=np.int64).reshape(-1, 3)
    for name in ("#ffffff", BLUE, ORANGE, BLACK, SKY, RED, GREEN):
        kept = np.array([int(name[i : i + 2], 16) for i in (1, 3, 5)])
        colours[np.abs(colours - kept).max(axis=1) <= _MIXED] = kept
        colours = np.concatenate([colours, kept[None]])
    palette.putpalette(colours.astype(np.uint8).tobytes())
    return palette


class _Film:
    """The figure of a film, and the parts that change from frame to frame."""

    def __init__(self, replay: Replay, drawing: Figure, axes: npt.NDArray[np.object_]) -> None:
        self._replay, self._drawing = replay, drawing
        reference = replay.reference
        self._texts = replay.captions()
        self._canvas = FigureCanvasAgg(drawing)
        self._seen = total_counts(reference, replay.queries)
        self._mapped = total_counts(reference, reference.places)
        every = np.concatenate([self._seen.ravel(), self._mapped.ravel()])
        self._most = max(float(np.percentile(every, 99.5)), 1.0)
        self._title = drawing.suptitle(self._texts[0], fontsize=11)
        (query, place, where), (left, right, confidence) = axes
        grid = left.get_gridspec()
        left.remove()
        right.remove()
        cost = drawing.add_subplot(grid[1, :2])
        self._image = None
        if replay.images is not None:
            images = replay.images
            brightest = max(float(np.percentile(images[images > 0], 95)), 1.0)
            self._image = query.imshow(
                images[0], cmap="Greys", norm=PowerNorm(0.5, 0, 2.5 * brightest), aspect="equal"
            )
        self._query = self._sensor(query, "what the camera sees", self._seen[0])
        self._place = self._sensor(place, "the matched place", self._mapped[0])
        scale = along_route(reference, reference.route)
        self._x = scale.values
        label = "distance (m)" if reference.route is not None else "reference (s)"
        self._draw_cost(cost, label)
        self._draw_position(where, label)
        confidence.set(title="probability", xlabel="time (s)", ylim=(-0.05, 1.05))
        confidence.set_xlim(*self._span())
        (self._probability,) = confidence.plot([], [], color=BLUE, lw=1.5)
        self._probability_now = confidence.scatter([], [], s=30, color=ORANGE, zorder=3)
        for each in (query, place, cost, where, confidence):
            each.title.set_fontsize(10)
            each.tick_params(labelsize=8)
            each.xaxis.label.set_fontsize(9)
            each.yaxis.label.set_fontsize(9)

    def _sensor(self, axes: Axes, title: str, counts: npt.NDArray[np.integer]) -> PathCollection:
        return draw_window(axes, self._replay.reference, Window(title, counts), self._most)

    def _span(self) -> tuple[float, float]:
        return _with_margins(self._replay.outcome.time_s)

    def _draw_cost(self, axes: Axes, label: str) -> None:
        cost = self._replay.cost
        low, high = float(np.nanmin(cost)), 1.05 * float(np.nanmax(cost))
        (self._cost,) = axes.plot(self._x, cost[:, 0], color=BLUE, lw=1.2)
        self._cheapest = axes.scatter([], [], s=45, color=ORANGE, zorder=3)
        axes.set(title="cost of each place; orange: the match", xlabel=label)
        axes.set_ylim(low - 0.06 * (high - low), max(high, low + 1e-9))

    def _draw_position(self, axes: Axes, label: str) -> None:
        """Draw the route from above if it has two dimensions, else the distance over time."""
        route, places = self._replay.reference.route, self._replay.outcome.matches.place
        axes.set_title("position")
        if route is not None and route.position.shape[1] > 1:
            flat = route.metres(route.position)[:, :2]
            axes.plot(*flat.T, color=GREY, lw=1.5, alpha=0.6)
            axes.set_aspect("equal", adjustable="datalim")
            geographic = route.kind == "geographic"
            axes.set(
                xlabel="east (m)" if geographic else "x (m)",
                ylabel="north (m)" if geographic else "y (m)",
            )
            self._path: Floats = flat[places]
        else:
            self._path = np.column_stack([self._replay.outcome.time_s, self._x[places]])
            axes.set(xlabel="time (s)", ylabel=label, xlim=self._span())
            axes.set_ylim(*_with_margins(self._x))
        axes.xaxis.set_major_locator(MaxNLocator(4))
        self._true = self._true_path(route)
        self._truly = axes.scatter([], [], s=90, lw=2, facecolors="none", zorder=4)
        self._truly.set_edgecolor(GREEN)
        if self._true is not None:
            axes.set_title("position; circle: the truth")
        self._trail = axes.scatter([], [], s=5, zorder=2)
        self._now = axes.scatter([], [], s=45, color=ORANGE, zorder=3)
        self._wrong = axes.scatter([], [], s=70, marker="X", lw=0, zorder=3)

    def _true_path(self, route: Route | None) -> Floats | None:
        """Return where the camera truly was in each frame, in the coordinates of the panel."""
        true = self._replay.true
        if true is None:
            return None
        if route is not None and true.query.shape[1] > 1:
            return route.metres(true.query)[:, :2]
        apart = np.abs(true.place[:, 0] - true.query)
        nearest = np.argmin(np.where(np.isnan(apart), np.inf, apart), axis=1)
        at = np.where(np.isnan(true.query[:, 0]), np.nan, self._x[nearest])
        return np.column_stack([self._replay.outcome.time_s, at])

    def frame(self, i: int) -> Image.Image:
        """Draw the frame of the i-th window."""
        replay = self._replay
        outcome, place = replay.outcome, int(replay.outcome.matches.place[i])
        if self._image is not None and replay.images is not None:
            self._image.set_data(replay.images[i])
        for dots, counts in ((self._query, self._seen[i]), (self._place, self._mapped[place])):
            dots.set_sizes(dot_sizes(counts, self._most))
        self._cost.set_ydata(replay.cost[:, i])
        self._cheapest.set_offsets([(self._x[place], replay.cost[place, i])])
        accepted = outcome.accepted[: i + 1]
        self._trail.set_offsets(self._path[: i + 1])
        self._trail.set_color([BLUE if taken else SKY for taken in accepted])
        self._wrong.set_color(RED if accepted[-1] else BLACK)
        for mark, wrong in ((self._now, False), (self._wrong, True)):
            mark.set_offsets(self._path[i : i + (bool(outcome.wrong[i]) is wrong)])
        if self._true is not None:
            self._truly.set_offsets(self._true[i : i + 1])
        probability = outcome.matches.probability[: i + 1]
        self._probability.set_data(outcome.time_s[: i + 1], probability)
        self._probability_now.set_offsets([(outcome.time_s[i], probability[-1])])
        self._title.set_text(self._texts[i])
        self._drawing.set_dpi(_DPI)
        self._canvas.draw()  # type: ignore[no-untyped-call]
        self._drawing.set_layout_engine("none")  # as it was laid out first
        pixels = np.asarray(self._canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        return Image.fromarray(pixels).convert("RGB")


def _with_margins(values: Floats) -> tuple[float, float]:
    """Return limits of an axis within which the dots at both ends are whole."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = max(0.05 * (high - low), 1e-3)
    return low - margin, high + margin


#: frames per second of a film
FPS = 10


def write_gif(path: Path, pictures: Sequence[Image.Image]) -> None:
    """Write an animated GIF of `FPS` that is repeated for ever, atomically."""
    with replacing(path) as temporary:
        pictures[0].save(
            temporary, format="GIF", save_all=True, append_images=pictures[1:],
            duration=1000 // FPS, loop=0,
        )  # fmt: skip


# What a film of a match shows, from its folder of results.


def replay_of(
    result: MatchResult,
    recording: EventSource | WindowSource | None,
    odometry: Odometry | None,
    most: int,
    *,
    start_s: float | None = None,
    end_s: float | None = None,
    all_events: bool = False,
    truth: TruthFiles | None = None,
) -> Replay:
    """Compute the cost of each place again, for the windows of a match.

    Parameters
    ----------
    recording : EventSource or WindowSource, optional
        Of the query, needed if it was matched online, or for `all_events`.
    most : int
        Largest number of frames: of more windows, some are left out, evenly.
    truth : TruthFiles, optional
        To show which matches are correct, and where the camera truly was.

    Raises
    ------
    EdgeVprError
        If the recording cannot be read, or no window is in the part.
    """
    reference, matches, queries = result.reference, result.matches, result.queries
    matched_map = reference.matched_with(matches.settings)
    if queries is None:
        assert recording is not None
        queries = describe_query(matched_map, recording)
    cost = query_distances(matched_map, queries, odometry)
    settings = matched_map.settings
    if settings.matching == "sequence":  # places where a whole sequence does not fit never match
        before = middle_window(settings.sequence_length)
        cost[:before] = np.nan
        cost[len(cost) - (settings.sequence_length - 1 - before) :] = np.nan
    window, row = _windows_of(matches, queries)
    time_s = queries.centre_us[window] / 1e6
    within = np.flatnonzero(
        (time_s >= (-np.inf if start_s is None else start_s))
        & (time_s <= (np.inf if end_s is None else end_s))
    )
    if not within.size:
        raise UsageError(
            f"no window lies between {start_s} and {end_s} s: the matches are from "
            f"{time_s[0]:.1f} to {time_s[-1]:.1f} s"
        )
    shown = within[np.unique(np.linspace(0, within.size - 1, most).round().astype(int))]
    window, row = window[shown], row[shown]
    images = None
    if all_events and recording is not None:
        if isinstance(recording, WindowSource):
            images = _window_images(recording, window)
        else:
            images = event_images(recording, queries.start_us[window], queries.end_us[window])
    shown_matches, evaluation, true = matches.take(row), None, None
    if truth is not None:
        judged = shown_matches
        if result.queries is None:  # of a drive that was matched online, each match is a query
            judged = replace(judged, query=np.arange(len(judged), dtype=np.int64))
        some = replace(result, matches=judged)
        with warnings.catch_warnings():  # the evaluation has given them
            warnings.simplefilter("ignore", EdgeVprWarning)
            evaluation = some.evaluate(truth_of(some, truth))
        positions, route = evaluation.truth.positions, reference.route
        panel = ("metric", 1) if route is None else (route.kind, route.position.shape[1])
        if positions is not None and (positions.kind, positions.query.shape[1]) == panel:
            true = replace(positions, query=positions.query[judged.query])
    return Replay(
        reference, outcome_of(reference, shown_matches, evaluation), queries.take(window),
        cost[:, window], images, true,
    )  # fmt: skip


def _windows_of(
    matches: Matches, queries: Descriptors
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return windows, and for each the row of its match: of several, the newest."""
    if len(matches.candidates[0]) > 1:
        return matches.query.astype(np.intp), np.arange(len(matches))
    newest = np.searchsorted(matches.time_us, queries.centre_us, side="right") - 1
    window = np.flatnonzero(newest >= 0)
    return window, newest[window]


def event_images(
    recording: EventSource, start_us: npt.NDArray[np.int64], end_us: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Count the events of n spans of time at every pixel, shape (n, height, width).

    Parameters
    ----------
    start_us, end_us : ndarray of int64, shape (n,)
        Events at the start are counted, those at the end are not.
    """
    width, height = recording.sensor
    images = np.zeros((len(start_us), height * width), dtype=np.int64)
    for events in recording:
        time, flat = events.t, events.y.astype(np.int64) * width + events.x
        first, last = np.searchsorted(time, start_us), np.searchsorted(time, end_us)
        for row in np.flatnonzero(last > first):
            images[row] += np.bincount(flat[first[row] : last[row]], minlength=height * width)
    return images.reshape(-1, height, width)


def _window_images(recording: WindowSource, window: npt.NDArray[np.intp]) -> npt.NDArray[np.int64]:
    """Return the counts of some published windows, shape (n, height, width)."""
    width, height = recording.sensor
    counts = [counted.counts for counted in recording.windows()]
    return np.stack([counts[number] for number in window]).reshape(-1, height, width)
