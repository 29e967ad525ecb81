"""Count frames: how many events each pixel had in each frame; as events, or as windows.

Expansion to events, with whole numbers only. Frame f lasts from ``lo = floor(f * period)`` to
``hi = floor((f + 1) * period)`` microseconds, with the period a fraction. Event i of the n that
pixel j had in it is placed at::

    t = lo + floor((i + phase_j) * (hi - lo) / n),   phase_j = (40503 * (j + 1) mod 65536) / 65536

so that each pixel's events are evenly spread over the frame, each pixel with a phase of its own
(multiples of the golden ratio, so that neither the pixels that fired once share a moment, which
would be a burst, nor the rows follow one another). Events at one time are in the order of j. The
count is kept exactly, and ``lo <= t < hi``. Frames know no polarity: all events are ON.
"""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import LONGEST_SIDE, Sensor
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.guard import foreign_errors
from edge_vpr.recordings.npz import Archive
from edge_vpr.recordings.source import Columns, ReadOptions, Source

_PHASE_BITS = 16
_GOLDEN = 40503  # 2**16 over the golden ratio, made odd
_BLOCK_BYTES = 1 << 20

#: Most pixels of a frame, four times as many as the largest event camera has.
MOST_PIXELS = 1 << 22
#: Events that are expanded at a time, and most events that a microsecond may have.
_MOST_EXPANDED, _MOST_AT_ONCE = 1 << 20, 1 << 16
_LARGEST_IMAGE = 1 << 26

Counts = npt.NDArray[Any]


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
                yield _image(image, self.sensor).reshape(1, -1)
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
        self._images = sorted(self.path.glob("*.png"), key=_number_key)
        if not self._images:
            raise RecordingError(f"{self.path} holds no *.png: name a folder of count frames")
        first = _image(self._images[0], None)
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
    """Count frames, expanded to events by the rule at the head of this module."""

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
        waiting: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.intp]]] = []
        for block in self.frames.blocks(log):
            for counts in block:
                lo = math.floor(frame * self.period_us)
                hi = math.floor((frame + 1) * self.period_us)
                for part in _expand(counts, lo, hi, self.path):
                    waiting.append(part)
                    if sum(t.size for t, _ in waiting) >= self.options.chunk_events:
                        yield _join(waiting, x, y)
                        waiting = []
                frame += 1
            self.position = frame / self.frames.n_frames
        if waiting:
            yield _join(waiting, x, y)


def _expand(
    counts: Counts, lo: int, hi: int, path: Path
) -> Iterator[tuple[npt.NDArray[np.int64], npt.NDArray[np.intp]]]:
    """Place one frame's events in time: their times, in order, and pixel numbers.

    Where they are many, the frame is cut into equal times, and each is expanded on its own.
    """
    active = np.flatnonzero(counts)
    n = counts[active].astype(np.int64)
    length, total = hi - lo, float(n.sum(dtype=np.float64))
    most = int(n.max(initial=0))
    if total > length * _MOST_AT_ONCE or (most << _PHASE_BITS) * length >= 1 << 62:
        raise RecordingError(
            f"{path}: {total:,.0f} events, up to {most:,} of one pixel, do not fit a frame of "
            f"{length} us: check the frame period (in seconds)"
        )
    phases = (active + 1) * _GOLDEN & ((1 << _PHASE_BITS) - 1)
    pieces = min(length, math.ceil(total / _MOST_EXPANDED))
    begin = np.zeros_like(n)
    for piece in range(1, pieces + 1):
        # the first event of each pixel that lies at or after the piece's end
        bound = -(-((n << _PHASE_BITS) * (length * piece // pieces)) // length)
        end = np.clip(-(-(bound - phases) // (1 << _PHASE_BITS)), 0, n)
        some = end - begin
        pixel = np.repeat(active, some)
        index = np.arange(pixel.size) + np.repeat(begin - (np.cumsum(some) - some), some)
        shifted = (index << _PHASE_BITS) + np.repeat(phases, some)
        offset = shifted * length // (np.repeat(n, some) << _PHASE_BITS)
        # a radix sort, where the offsets fit 16 bits
        key = offset.astype(np.uint16) if length <= 1 << 16 else offset
        order = np.argsort(key, kind="stable")
        yield lo + offset[order], pixel[order]
        begin = end


def _join(
    frames: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.intp]]],
    x: npt.NDArray[np.uint16],
    y: npt.NDArray[np.uint16],
) -> Columns:
    t = np.concatenate([times for times, _ in frames])
    pixel = np.concatenate([pixels for _, pixels in frames])
    return Columns(t, x[pixel], y[pixel], np.ones(t.size, dtype=bool))


def _image(path: Path, sensor: Sensor | None) -> npt.NDArray[Any]:
    """One 8- or 16-bit grey PNG; its values are counts."""
    from PIL import Image

    if path.stat().st_size > _LARGEST_IMAGE:
        raise RecordingError(f"{path} has more than {_LARGEST_IMAGE:,} bytes: write it again")
    # out of memory: from a file, Pillow asks for as many bytes as a damaged chunk claims
    content = io.BytesIO(path.read_bytes())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the size is checked here
            with Image.open(content, formats=("PNG",)) as image:
                mode, size = image.mode, Sensor(*image.size)
                fits = size.possible and size.pixels <= MOST_PIXELS
                pixels = np.asarray(image) if fits else np.empty(0)
    except MemoryError:
        raise
    except Exception as error:  # Pillow raises what its parser comes across
        raise RecordingError(f"{path} is damaged or no PNG ({error}): write it again") from error
    if not fits:
        raise RecordingError(
            f"{path} claims {size} pixels; there is one at least, and the most is "
            f"{MOST_PIXELS:,}: write it again"
        )
    if not (mode == "L" or mode.startswith("I")) or pixels.ndim != 2:
        raise RecordingError(
            f"{path} has mode {mode}: count frames are 8- or 16-bit grey without alpha or palette"
        )
    if sensor is not None and pixels.shape != (sensor.height, sensor.width):
        raise RecordingError(
            f"{path} has {pixels.shape[1]}x{pixels.shape[0]} pixels and the first frame {sensor}: "
            "all frames need one size"
        )
    if pixels.min(initial=0) < 0 or pixels.max(initial=0) > 0xFFFF:
        raise RecordingError(f"{path} has values outside 0 to 65,535: write 8- or 16-bit grey")
    return pixels.astype(np.uint16)


def _number_key(path: Path) -> list[tuple[int, str]]:
    """Sort ``frame_2`` before ``frame_10``."""
    return [
        (int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.stem)
    ]


def _simplest(seconds: float, path: Path) -> Fraction:
    """Give the simplest fraction that is this float: 1/30, not its nearest multiple of 2**-57."""
    if not (math.isfinite(seconds) and seconds > 0):
        raise RecordingError(f"{path}: window_s is {seconds}: a frame lasts more than 0 s")
    simple = Fraction(seconds).limit_denominator(1_000_000)
    return simple if float(simple) == seconds else Fraction(seconds)


def open_source(path: Path, options: ReadOptions, format_name: str) -> Source:
    """Open count frames as events."""
    return FrameSource(path, options)
