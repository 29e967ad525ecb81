"""Count frames: the number of events of each pixel in each frame, as events or as windows.

The expansion to events is in :mod:`edge_vpr.recordings.frame_expansion`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import LONGEST_SIDE, Sensor
from edge_vpr.recordings.array_stream import ArrayStream
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.count_arrays import (
    both_polarities,
    check_frame_shape,
    frame_arrays,
    read_array_frame,
    read_metadata,
    simplest_fraction,
    whole_counts,
)
from edge_vpr.recordings.count_images import MOST_PIXELS, number_key, read_image
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.frame_expansion import Counts, Placed, expand, join
from edge_vpr.recordings.guard import foreign_errors
from edge_vpr.recordings.npz import Archive
from edge_vpr.recordings.source import ReadOptions, Source

_BLOCK_BYTES = 1 << 20


class CountFrames:
    """Count frames of a ``.npz`` or ``.npy`` file, or of a folder of PNG or ``.npy`` files.

    Frames are read a few at a time.

    Attributes
    ----------
    path : Path
    sensor : Sensor or None
    pixel_x, pixel_y : ndarray of uint16, shape (J,), or None
        Position of each pixel of a frame. Whole frames are row by row; None if the file has
        ``counts`` without ``pixel_x`` and ``pixel_y``.
    period : Fraction or None
        Seconds per frame, if the file (``window_s``) or the folder (``metadata.json``) states them.
    start_us : int
        Begin of the first frame on the clock of the folder's ``metadata.json``; 0 without it.
    n_frames, n_pixels : int
        Number F of frames, and number J of pixels.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sensor: Sensor | None = None
        self.pixel_x: npt.NDArray[np.uint16] | None = None
        self.pixel_y: npt.NDArray[np.uint16] | None = None
        self.period: Fraction | None = None
        self.start_us = 0
        self._polarities = 0
        self._images: list[Path] = []
        self._read_image: Callable[[Path, Sensor | None], Counts] = read_image
        if path.is_dir():
            self._find_images()
        elif path.suffix.lower() == ".npy":
            self._name = ""
            self._read_array_layout()
        else:
            self._read_layout()

    def blocks(self, log: FaultLog | None = None) -> Iterator[Counts]:
        """Yield ``(f, J)`` arrays of about a megabyte, in the order of the frames.

        Raises
        ------
        RecordingError
            If the frames are damaged or cut off (unless `log` allows that), or hold anything other
            than whole numbers from 0 up.
        """
        frame = 0
        if self._images:
            for image in self._images:
                yield whole_counts(
                    self._read_image(image, self.sensor).reshape(1, -1), frame, self.path
                )
                frame += 1
            return
        with foreign_errors(self.path, lambda: f" after frame {frame:,}"), ExitStack() as stack:
            stream = self._stream(stack)
            rows = max(1, _BLOCK_BYTES // max(1, stream.row_bytes))
            while frame < self.n_frames:
                block, leftover = stream.read(rows)
                counts = both_polarities(block, len(stream.shape) - self._polarities)
                yield whole_counts(counts.reshape(len(block), -1), frame, self.path)
                frame += len(block)
                if leftover or not len(block):
                    lost = (self.n_frames - frame) * stream.row_bytes - leftover
                    where = f"frame {frame} of {self.n_frames}"
                    (log or FaultLog(self.path, Sensor(1, 1))).truncated(lost, where)
                    return

    def load(self) -> Counts:
        """Return all frames as windows, shape ``(F, J)``."""
        return np.concatenate(list(self.blocks()))

    def _find_images(self) -> None:
        images = list(self.path.glob("*.png"))
        if not images:
            images, self._read_image = frame_arrays(self.path), read_array_frame
        if not images:
            raise RecordingError(
                f"{self.path} holds no *.png and no *.npy: name a folder of count frames"
            )
        self._images = sorted(images, key=number_key)
        first = self._read_image(self._images[0], None)
        self._grid(*first.shape)
        self.n_frames = len(self._images)
        self.period, self.start_us = read_metadata(self.path)

    def _stream(self, stack: ExitStack) -> ArrayStream:
        if self._name:
            return stack.enter_context(Archive(self.path)).stream(self._name, stack)
        return ArrayStream(stack.enter_context(self.path.open("rb")), str(self.path))

    def _read_array_layout(self) -> None:
        with ExitStack() as stack:
            stream = self._stream(stack)
        check_frame_shape(stream.shape[1:], stream.dtype, str(self.path))
        if not stream.shape[0]:
            raise RecordingError(f"{self.path} holds no frames: save it again")
        self._polarities = len(stream.shape) - 3
        self.n_frames = stream.shape[0]
        self._grid(*stream.shape[1:3])

    def _read_layout(self) -> None:
        with Archive(self.path) as archive, ExitStack() as stack:
            found = [name for name in ("frames", "counts") if name in archive.names]
            if len(found) != 1:
                raise RecordingError(
                    f"{self.path} holds {', '.join(sorted(archive.names)) or 'nothing'}: "
                    "count frames need the array frames (F,H,W) or counts (F,J)"
                )
            self._name = found[0]
            stream = archive.stream(self._name, stack)
            dimensions = 3 if self._name == "frames" else 2
            if (
                len(stream.shape) != dimensions
                or 0 in stream.shape
                or stream.dtype.kind not in ("biuf")
            ):
                raise RecordingError(
                    f"{self.path}: {self._name} has shape {stream.shape} and dtype "
                    f"{stream.dtype}: it needs numbers of shape "
                    + ("(frames, height, width)" if dimensions == 3 else "(frames, pixels)")
                )
            self.n_frames = stream.shape[0]
            if dimensions == 3:
                self._grid(*stream.shape[1:])
            else:
                self.n_pixels = stream.shape[1]
                if self.n_pixels > MOST_PIXELS:
                    raise RecordingError(
                        f"{self.path} counts {self.n_pixels:,} pixels, and the most is "
                        f"{MOST_PIXELS:,}: leave some out"
                    )
                self.sensor = archive.sensor()
                self._pixels(archive)
            seconds = archive.scalar("window_s", "frame_period_s", "period_s")
            if seconds is not None:
                self.period = simplest_fraction(float(seconds), self.path)

    def _grid(self, height: int, width: int) -> None:
        self.sensor = Sensor(width, height)
        if not self.sensor.possible or self.sensor.pixels > MOST_PIXELS:
            raise RecordingError(
                f"{self.path} has frames of {self.sensor} pixels: sides are 1 to {LONGEST_SIDE:,}, "
                f"and the most is {MOST_PIXELS:,} pixels"
            )
        rows, columns = np.indices((height, width), dtype=np.uint16)
        self.pixel_y, self.pixel_x = rows.ravel(), columns.ravel()
        self.n_pixels = height * width

    def _pixels(self, archive: Archive) -> None:
        if not {"pixel_x", "pixel_y"} <= archive.names.keys():
            return
        x, y = archive.small("pixel_x"), archive.small("pixel_y")
        if x.shape != (self.n_pixels,) or y.shape != x.shape:
            raise RecordingError(
                f"{self.path}: pixel_x {x.shape} and pixel_y {y.shape} do not fit counts of "
                f"{self.n_pixels} pixels: give one of each a pixel"
            )
        for name, column in (("pixel_x", x), ("pixel_y", y)):
            if column.dtype.kind not in "iu" or column.min() < 0 or column.max() > 0xFFFF:
                raise RecordingError(
                    f"{self.path}: {name} holds {column.dtype} {column.min()} to {column.max()}: "
                    "pixels are whole numbers from 0 to 65535"
                )
        self.pixel_x, self.pixel_y = x.astype(np.uint16), y.astype(np.uint16)


def read_count_frames(path: str | Path) -> CountFrames:
    """Open count frames: ``frames`` (F,H,W) or ``counts`` (F,J) in ``.npz``, or a folder of them.

    A folder holds PNG or ``.npy`` (H,W) or (H,W,2), one a frame, and may hold ``metadata.json``; a
    ``.npy`` file holds all frames, (F,H,W) or (F,H,W,2). Floats are read if they are whole numbers.

    Raises
    ------
    RecordingError
        If the path is missing or unreadable, or holds something else.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingError(f"{path} does not exist: check the path")
    with foreign_errors(path):
        return CountFrames(path)


def parse_period(text: str) -> Fraction:
    """Read a frame period in seconds, ``"1/30"`` or ``"0.0333"``, exactly.

    Raises
    ------
    UsageError
        If it is not a positive number.
    """
    try:
        period = Fraction(text)
    except (ValueError, ZeroDivisionError):
        period = Fraction(0)
    if period <= 0:
        raise UsageError(f"frame period {text!r} is no positive number: write for example 1/30")
    return period


class FrameSource(Source):
    """Source of the events of count frames, placed by the rule of `frame_expansion`."""

    relative = True

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.frames = read_count_frames(path)
        self.start_us = self.frames.start_us
        super().__init__(path, options, self.frames.sensor)
        period = self.frames.period
        if period is None:
            period = options.frame_period
        elif options.frame_period not in (None, period):
            raise UsageError(
                f"{path} has frames of {period} s, and {options.frame_period} s was given: "
                "leave the frame period out"
            )
        if period is None:
            raise UsageError(
                f"{path} does not say how long a frame lasts: pass --frame-period (frame_period=), "
                "for example --frame-period 1/30"
            )
        if self.frames.pixel_x is None:
            raise UsageError(
                f"{path} has counts without pixel_x and pixel_y, so that they cannot become "
                "events: add the pixels, or use the counts as windows (read_count_frames)"
            )
        self.period_us = period * 1_000_000

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events of one frame after another; see :class:`Source`."""
        x, y = self.frames.pixel_x, self.frames.pixel_y
        assert x is not None and y is not None
        frame = 0
        waiting: list[Placed] = []
        for block in self.frames.blocks(log):
            for counts in block:
                lo = math.floor(frame * self.period_us)
                hi = math.floor((frame + 1) * self.period_us)
                for part in expand(counts, lo, hi, self.path):
                    waiting.append(part)
                    if sum(t.size for t, _ in waiting) >= self.options.chunk_events:
                        yield join(waiting, x, y)
                        waiting = []
                frame += 1
            self.position = frame / self.frames.n_frames
        if waiting:
            yield join(waiting, x, y)


open_source = FrameSource
