"""A camera whose mounting moved: matches at each shift, of counts and codes, registered and not.

The images of real drives are shifted, and pixels that leave the sensor are lost. Fixed patterns of
the sensor move along, which they would not do in reality; the registration cancels them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr.descriptors.counting import DescriptorStream
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import FixedTime, WindowCounts
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.pipeline import EventSource, WindowSource
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.registration import register
from edge_vpr.settings import Settings
from edge_vpr_tools.report.style import CYCLE, DASHES, legend_below, mean_line, panels, save
from edge_vpr_tools.research.baselines import map_all_pixels
from edge_vpr_tools.research.experiments import SOURCES, brisbane
from edge_vpr_tools.research.experiments.drives import PAPER, check_data, pairs, without_pairs
from edge_vpr_tools.research.experiments.trial import (
    DEFAULT_MATCHING,
    Summary,
    TruthOf,
    markdown_table,
)

__all__ = ["check_data", "run"]

#: shifts to the right and downwards, in pixels
SHIFTS = (0, 1, 2, 4, 8)
_CODED = {"counter_code": "log"}


@dataclass(frozen=True)
class Way:
    """Way to match a shifted drive.

    Parameters
    ----------
    name : str
    changes : dict
        Settings that differ from the pair's.
    registered : bool
        Register the query with the map.
    all_pixels : bool
        Use every pixel instead of a selection.
    """

    name: str
    changes: dict[str, Any]
    registered: bool = False
    all_pixels: bool = False


WAYS = (
    Way("counts", {}),
    Way("counts, registered", {}, True),
    Way("3-bit logarithms", _CODED),
    Way("3-bit logarithms, registered", _CODED, True),
    Way("place filter (default)", DEFAULT_MATCHING),
    Way("place filter, registered", DEFAULT_MATCHING, True),
)
#: ways that draw no pixels, and are therefore matched once, beside the largest number of pixels
EVERY = (
    Way("all pixels, counts", {}, all_pixels=True),
    Way("all pixels, 3-bit logarithms", _CODED, all_pixels=True),
)


class ShiftedWindows:
    """Windows of a drive, counted at every pixel, with the image shifted.

    Parameters
    ----------
    images : ndarray of int, shape (n, height, width)
    window_us : int
    dx, dy : int
        Shift to the right and downwards, in pixels.
    """

    def __init__(
        self, images: npt.NDArray[np.integer], window_us: int, dx: int = 0, dy: int = 0
    ) -> None:
        self.sensor = Sensor(images.shape[2], images.shape[1])
        self.window_us = window_us
        self.counted = np.ones(images.shape[1:], dtype=np.bool_)
        self._images, self._shift = images, (dx, dy)

    def windows(self) -> Iterator[WindowCounts]:
        """Yield one window an image from the first one on, over all pixels, row by row."""
        for k, image in enumerate(self._images):
            counts = shifted(image, *self._shift).astype(np.int64).ravel()
            start = k * self.window_us
            yield WindowCounts(counts, start, start + self.window_us, int(counts.sum()))


def shifted(image: npt.NDArray[np.integer], dx: int, dy: int) -> npt.NDArray[np.integer]:
    """Shift an image to the right and downwards; zeros fill the gap, and other pixels are lost."""
    height, width = image.shape
    found = np.zeros_like(image)
    found[max(dy, 0) : height + min(dy, 0), max(dx, 0) : width + min(dx, 0)] = image[
        max(-dy, 0) : height + min(-dy, 0), max(-dx, 0) : width + min(-dx, 0)
    ]
    return found


def counted_images(drive: EventSource | WindowSource, window_us: int) -> npt.NDArray[np.integer]:
    """Count a drive at every pixel, window by window, as (n, height, width)."""
    if isinstance(drive, WindowSource):
        windows = drive.windows()
    else:
        stream = DescriptorStream(PixelMap.all_of(drive.sensor), FixedTime(window_us))
        windows = (window for events in drive for window in stream.windows(events))
    size = (drive.sensor.height, drive.sensor.width)
    return np.array([w.counts.astype(np.uint16).reshape(size) for w in windows])


Scores = dict[tuple[str, int], list[float]]


def score(
    reference: ShiftedWindows,
    images: npt.NDArray[np.integer],
    truth_of: TruthOf,
    settings: Settings,
    seeds: int,
) -> tuple[Scores, list[tuple[int, int, int]]]:
    """Match a shifted query in every way.

    Parameters
    ----------
    reference : ShiftedWindows
    images : ndarray of int, shape (n, height, width)
        Images of the query.
    truth_of : callable
    settings : Settings
    seeds : int
        Number of draws of pixels.

    Returns
    -------
    scores : dict of (way, shift) to list of float
        P@100R of each draw; of all pixels, one.
    estimates : list of (shift, dx, dy)
        Estimated shifts, with the default's map.
    """
    scores: Scores = {}
    estimates = []
    for seed in range(seeds):
        for way in (*WAYS, *(EVERY if seed == 0 and settings.pixels == PAPER.pixels else ())):
            chosen = settings.replaced({"seed": seed, **way.changes}, way.name)
            mapped = ReferenceMap.build(reference, chosen)
            if way.all_pixels:
                mapped = map_all_pixels(reference, chosen, mapped.hot)
            for shift in SHIFTS:
                query, used = ShiftedWindows(images, reference.window_us, shift, shift), mapped
                if way.registered:
                    found = register(mapped, query)
                    used = found.reference
                    if way is WAYS[-1]:
                        estimates.append((shift, found.dx, found.dy))
                matched = used.match(query)
                truth = truth_of(used.places.centre_us, matched.query_time_us)
                right = matched.evaluate(truth).precision_at_100_recall
                scores.setdefault((way.name, shift), []).append(right)
    return scores, estimates


def run(data: Path, seeds: int, on_start: Callable[[str], None], *figures: Path) -> str:
    """Shift the queries of every pair of drives, and return Markdown tables."""
    parts, drawn = [], {}
    for pair in pairs(data):
        if not pair.has_images:
            continue  # a few locations cannot be shifted
        on_start(pair.name)
        window_us = pair.settings.tau_us
        images = [counted_images(drive, window_us) for drive in (pair.reference, pair.query)]
        reference = ShiftedWindows(images[0], window_us)
        scores, estimates = score(reference, images[1], pair.truth_of, pair.settings, seeds)
        drawn[pair.name] = scores
        rows = [
            [way.name, *(str(Summary(scores[way.name, shift])) for shift in SHIFTS)]
            for way in _matched(scores)
        ]
        parts.append(f"{pair.name}, P@100R at each shift:\n")
        header = ("way", *(f"({shift}, {shift})" for shift in SHIFTS))
        parts.append(markdown_table(header, rows) + "\n")
        parts.append(f"{_off(estimates)}\n")
    if not drawn:
        folders = [folder for folder in SOURCES if folder != brisbane.FOLDER]
        raise UsageError(f"no drive with counts at every pixel: {without_pairs(data, folders)}")
    if figures:
        save(draw(drawn), *figures)
    return "\n".join(parts)


def _matched(scores: Scores) -> list[Way]:
    """Return the ways that were matched, in the order of the table."""
    return [way for way in (*WAYS, *EVERY) if (way.name, SHIFTS[0]) in scores]


def _off(estimates: Sequence[tuple[int, int, int]]) -> str:
    """Describe the errors of the estimates."""
    off = [max(abs(dx - shift), abs(dy - shift)) for shift, dx, dy in estimates]
    return (
        f"Shift estimated with the place filter's maps: right in {off.count(0)} of {len(off)}, "
        f"off by at most {max(off)} pixels."
    )


def draw(found: dict[str, Scores]) -> Figure:
    """Draw right matches against the shift, with a panel for each pair."""
    rows = (len(found) + 1) // 2
    with panels(rows, 2, 10.5, 3.0 * rows + 1) as (drawing, grid):
        for axes, (pair, scores) in zip(grid.flat, found.items(), strict=False):
            for i, way in enumerate(_matched(scores)):
                values = [scores[way.name, shift] for shift in SHIFTS]
                mean_line(
                    axes,
                    SHIFTS,
                    values,
                    color="gray" if way.all_pixels else CYCLE[i // 2],
                    linestyle="-" if way.registered else DASHES[1 + (way is EVERY[-1])],
                    label=way.name,
                )
            axes.set(title=pair, xlabel="shift, pixels", ylabel="P@100R", ylim=(0, 1.02))
        legend_below(drawing, grid.flat, 3)
    return drawing
