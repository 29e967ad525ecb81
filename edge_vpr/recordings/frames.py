"""Count frames: how many events each pixel had in each frame; as events, or as windows.

The expansion to events is in :mod:`edge_vpr.recordings.frame_expansion`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import LONGEST_SIDE, Sensor
from edge_vpr.recordings.count_images import MOST_PIXELS, number_key, read_image
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.frame_expansion import Counts, Placed, expand, join
from edge_vpr.recordings.guard import foreign_errors
from edge_vpr.recordings.npz import Archive
from edge_vpr.recordings.source import Columns, ReadOptions, Source

_BLOCK_BYTES = 1 << 20


class CountFrames:
    """Count frames of a ``.npz`` file or of a folder of PNG, read a few at a time.

    Attributes
    ----------
    path : Path
    sensor : Sensor or None
    pixel_x, pixel_y : ndarray of uint16, shape (J,), or None
        Where the pixels of a frame lie; row by row for whole frames, None if the file has
        ``counts`` without ``pixel_x`` and ``pixel_y``.
    period : Fraction or None
        Seconds a frame, if the file says (``window_s``).
    n_frames, n_pixels : int
        F and J.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sensor: Sensor | None = None
        self.pixel_x: npt.NDArray[np.uint16] | None = None
        self.pixel_y: npt.NDArray[np.uint16] | None = None
        self.period: Fraction | None = None
        self._images: list[Path] = []
        if path.is_dir():
            self._find_images()
        else:
            self._read_layout()

    def blocks(self, log: FaultLog | None = None) -> Iterator[Counts]:
        """Yield ``(f, J)`` arrays of about a megabyte, in the order of the frames.

        Raises
        ------
        RecordingError
            If the frames are damaged or cut off (unless `log` allows that), or hold anything
            but whole numbers from 0 up.
        """
        if self._images:
            for image in self._images:
                yield read_image(image, self.sensor).reshape(1, -1)
            return
        frame = 0
        with (
            foreign_errors(self.path, lambda: f" after frame {frame:,}"),
            Archive(self.path) as archive,
            ExitStack() as stack,
        ):
            stream = archive.stream(self._name, stack)
            rows = max(1, _BLOCK_BYTES // max(1, stream.row_bytes))
            while frame < self.n_frames:
                block, leftover = stream.read(rows)
                yield self._whole(block.reshape(len(block), -1), frame)
                frame += len(block)
                if leftover or not len(block):
                    lost = (self.n_frames - frame) * stream.row_bytes - leftover
                    where = f"frame {frame} of {self.n_frames}"
                    (log or FaultLog(self.path, Sensor(1, 1))).truncated(lost, where)
                    return

    def load(self) -> Counts:
        """All frames, shape ``(F, J)``: the windows themselves."""
        return np.concatenate(list(self.blocks()))

    def _whole(self, block: Counts, begin: int) -> Counts:
        """Check that counts are whole numbers from 0 up; integers come out."""
        if block.dtype.kind == "u":
            return block
        if block.dtype.kind == "b":
            return block.view(np.uint8)
        with np.errstate(invalid="ignore", over="ignore"):
            bad = ~((block >= 0) & (block == np.floor(block)) & (block < 2.0**53))
        if bad.any():
            frame, pixel = (int(i) for i in np.argwhere(bad)[0])
            raise RecordingError(
                f"{self.path}: frame {begin + frame} counts {block[frame, pixel]} events at pixel "
                f"{pixel}: counts are whole numbers from 0 up"
            )
        return block.astype(np.int64)

    def _find_images(self) -> None:
        self._images = sorted(self.path.glob("*.png"), key=number_key)
        if not self._images:
            raise RecordingError(f"{self.path} holds no *.png: name a folder of count frames")
        first = read_image(self._images[0], None)
        self._grid(*first.shape)
        self.n_frames = len(self._images)

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
                self.period = _simplest(float(seconds), self.path)

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
    """Open count frames: ``frames`` (F,H,W) or ``counts`` (F,J) in ``.npz``, or a PNG folder.

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
        If it is no positive number.
    """
    try:
        period = Fraction(text)
    except (ValueError, ZeroDivisionError):
        period = Fraction(0)
    if period <= 0:
        raise UsageError(f"frame period {text!r} is no positive number: write for example 1/30")
    return period


class FrameSource(Source):
    """Count frames, expanded to events by the rule of `frame_expansion`."""

    relative = True
    start_us = 0

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.frames = read_count_frames(path)
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
        self.position = 0.0

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


def _simplest(seconds: float, path: Path) -> Fraction:
    """Give the simplest fraction that is this float: 1/30, not its nearest multiple of 2**-57."""
    if not (math.isfinite(seconds) and seconds > 0):
        raise RecordingError(f"{path}: window_s is {seconds}: a frame lasts more than 0 s")
    simple = Fraction(seconds).limit_denominator(1_000_000)
    return simple if float(simple) == seconds else Fraction(seconds)


def open_source(path: Path, options: ReadOptions, format_name: str) -> Source:
    """Open count frames as events."""
    return FrameSource(path, options)
