"""Count frames: the number of events of each pixel in each frame, as events or as windows."""

from __future__ import annotations

import io
import json
import math
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError, as_path, printable
from edge_vpr.events import LONGEST_SIDE, TIME_LIMIT_US, Columns, Sensor
from edge_vpr.recordings.numpy_files import Archive, ArrayStream
from edge_vpr.recordings.reading import FaultLog, ReadOptions, Source, foreign_errors

# Grey PNG images as count frames.


#: Most pixels of a frame: four times as many as the largest event camera has.
MOST_PIXELS = 1 << 22
_LARGEST_IMAGE = 1 << 26


def _read_png_frame(path: Path, sensor: Sensor | None) -> npt.NDArray[Any]:
    """Read one 8- or 16-bit grey PNG; its values are counts, uint16, shape (height, width)."""
    pixels, mode = _open_png(path)
    if not (mode == "L" or mode.startswith("I")) or pixels.ndim != 2:
        raise RecordingError(
            f"{path} has mode {mode}: count frames are 8- or 16-bit grey without alpha or palette"
        )
    _check_size(path, pixels, sensor)
    if pixels.min(initial=0) < 0 or pixels.max(initial=0) > 0xFFFF:
        raise RecordingError(f"{path} has values outside 0 to 65,535: write 8- or 16-bit grey")
    return pixels.astype(np.uint16)


def _check_size(path: Path, frame: npt.NDArray[Any], first: Sensor | None) -> None:
    """Raise RecordingError if a frame has another size than the first one."""
    if first is not None and frame.shape[:2] != (first.height, first.width):
        raise RecordingError(
            f"{path} has {frame.shape[1]}x{frame.shape[0]} pixels and the first frame {first}: "
            "all frames need one size"
        )


def _open_png(path: Path) -> tuple[npt.NDArray[Any], str]:
    """Return the pixels of a PNG and Pillow's name of their mode."""
    from PIL import Image

    if path.stat().st_size > _LARGEST_IMAGE:
        raise RecordingError(f"{path} has more than {_LARGEST_IMAGE:,} bytes: write it again")
    # not from the file: Pillow would ask it for as many bytes as a damaged chunk claims
    content = io.BytesIO(path.read_bytes())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the size is checked below
            with Image.open(content, formats=("PNG",)) as image:
                mode, size = image.mode, Sensor(*image.size)
                fits = size.possible and size.pixels <= MOST_PIXELS
                pixels = np.asarray(image) if fits else np.empty(0)
    except MemoryError:
        raise
    except Exception as error:  # Pillow passes on exceptions of any kind from its parser
        raise RecordingError(f"{path} is damaged or no PNG ({error}): write it again") from error
    if not fits:
        raise RecordingError(
            f"{path} claims {size} pixels; there is one at least, and the most is "
            f"{MOST_PIXELS:,}: write it again"
        )
    return pixels, mode


def _number_key(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts ``frame_2`` before ``frame_10``."""
    return [
        (int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.stem)
    ]


# NumPy arrays as count frames, one frame a file, and the ``metadata.json`` beside them.


METADATA = "metadata.json"
_LONGEST_METADATA = 1 << 20


def _read_array_frame(path: Path, sensor: Sensor | None) -> npt.NDArray[Any]:
    """Read one ``.npy`` frame; return ON and OFF counts added, shape (height, width)."""
    with path.open("rb") as file:
        stream = ArrayStream(file, str(path))
        _check_frame_shape(stream.shape, stream.dtype, str(path))
        frame = stream.load(MOST_PIXELS * 16)
    _check_size(path, frame, sensor)
    return both_polarities(frame, 2)


def _check_frame_shape(shape: tuple[int, ...], dtype: np.dtype[Any], name: str) -> None:
    """Raise RecordingError unless an array of this shape and dtype is a frame of counts."""
    fits = len(shape) == 2 or (len(shape) == 3 and shape[2] == 2)
    if not fits or 0 in shape or dtype.kind not in "biuf":
        raise RecordingError(
            f"{name} has shape {shape} and dtype {dtype}: a count frame is numbers of shape "
            "(height, width), or (height, width, 2) with ON and OFF counts"
        )


def both_polarities(frames: npt.NDArray[Any], plain_dimensions: int) -> npt.NDArray[Any]:
    """Add ON and OFF counts, if `frames` has a last axis beyond `plain_dimensions`.

    Parameters
    ----------
    frames : ndarray of numbers
        A last axis of length 2 may follow the usual axes.
    """
    if frames.ndim == plain_dimensions:
        return frames
    wide = np.float64 if frames.dtype.kind == "f" else np.int64
    with np.errstate(invalid="ignore"):  # the reader refuses values that are not finite
        return np.asarray(frames.sum(axis=-1, dtype=wide))


def _whole_counts(block: npt.NDArray[Any], first: int, path: Path) -> npt.NDArray[Any]:
    """Return the counts of some frames, the first of which has the number `first`, as integers."""
    if block.dtype.kind == "u":
        return block
    if block.dtype.kind == "b":
        return block.view(np.uint8)
    with np.errstate(invalid="ignore", over="ignore"):
        bad = ~((block >= 0) & (block == np.floor(block)) & (block < 2.0**53))
    if bad.any():
        frame, pixel = (int(i) for i in np.argwhere(bad)[0])
        raise RecordingError(
            f"{path}: frame {first + frame} counts {block[frame, pixel]} events at pixel "
            f"{pixel}: counts are whole numbers from 0 up"
        )
    return block.astype(np.int64)


def _simplest_fraction(seconds: float, path: Path) -> Fraction:
    """Return the simplest fraction that equals a float: 1/30, not a multiple of 2**-57."""
    if not (math.isfinite(seconds) and seconds > 0):
        raise RecordingError(f"{path}: window_s is {seconds}: a frame lasts more than 0 s")
    simple = Fraction(seconds).limit_denominator(1_000_000)
    return simple if float(simple) == seconds else Fraction(seconds)


def _frame_arrays(folder: Path) -> list[Path]:
    """Return the ``.npy`` frames of a folder, unordered.

    These are the files ``frame_*.npy`` if there are any, since other arrays (times of the frames)
    may lie beside them; otherwise all ``.npy`` files.
    """
    return list(folder.glob("frame_*.npy")) or list(folder.glob("*.npy"))


def _read_metadata(folder: Path) -> tuple[Fraction | None, int]:
    """Read the duration of a frame, and the time at which the first one begins.

    Parameters
    ----------
    folder : Path
        Its ``metadata.json``, if present, may have ``timewindow_ns`` or ``timewindow_ms``; and
        ``start_time_ns``, or ``start_tick`` with ``ticks_per_second``.

    Returns
    -------
    period : Fraction or None
        In seconds; None if it is absent or 0, as for frames of a fixed number of events.
    start_us : int
        0 if it is absent.

    Raises
    ------
    RecordingError
        If the file exists and is damaged.
    """
    path = folder / METADATA
    if not path.is_file():
        return None, 0
    try:
        with path.open("rb") as file:
            return _times(json.loads(file.read(_LONGEST_METADATA)))
    except (ValueError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
        raise RecordingError(
            f"{path} is no readable metadata of frames ({printable(error, 200)}): write it again, "
            "or remove it and pass frame_period="
        ) from error


def _times(values: dict[str, Any]) -> tuple[Fraction | None, int]:
    period = start = Fraction(0)
    for name, unit in (("timewindow_ms", 1000), ("timewindow_ns", 10**9)):
        if name in values:
            period = _number(values[name]).limit_denominator(1_000_000) / unit
    if "start_time_ns" in values:
        start = _number(values["start_time_ns"]) / 1000
    elif {"start_tick", "ticks_per_second"} <= values.keys():
        start = _number(values["start_tick"]) / _number(values["ticks_per_second"]) * 1_000_000
    if not 0 <= period < 1 << 31 or abs(start) > TIME_LIMIT_US:
        raise ValueError(f"a window of {float(period)} s, a start of {float(start)} us")
    return period or None, round(start)


def _number(value: object) -> Fraction:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{value!r} in the place of a number")
    return Fraction(value)


# Expansion of counts to events, in integer arithmetic.
#
# Frame f lasts from ``lo = floor(f * period)`` to ``hi = floor((f + 1) * period)`` microseconds,
# where the period is a fraction. If pixel j has n events in the frame, its event i is placed at::
#
#     t = lo + floor((i + phase_j) * (hi - lo) / n),   phase_j = (40503 * (j + 1) mod 65536) / 65536
#
# so that the events of each pixel are evenly spread over the frame, and each pixel has its own
# phase. The phases are multiples of the golden ratio: pixels with a single event then do not all
# fire at once, which would be a burst, nor row after row. Events at the same time are in the order
# of j. The count is kept exactly, and ``lo <= t < hi``. Frames have no polarity: all events are
# ON.


_PHASE_BITS = 16
_GOLDEN = 40503  # 2**16 over the golden ratio, made odd
#: Events that are expanded at a time, and most events within one microsecond.
_MOST_EXPANDED, _MOST_AT_ONCE = 1 << 20, 1 << 16

Counts = npt.NDArray[Any]
Placed = tuple[npt.NDArray[np.int64], npt.NDArray[np.intp]]
"""Times and pixel numbers of events, in time order."""


def expand(counts: Counts, lo: int, hi: int, path: Path) -> Iterator[Placed]:
    """Place the events of one frame in time.

    A frame of many events is cut into parts of equal duration, which are expanded one by one.

    Parameters
    ----------
    counts : ndarray of integers, shape (J,)
        Events of each pixel in the frame.
    lo, hi : int
        Begin and end of the frame in microseconds.
    path : Path
        Named in messages.

    Yields
    ------
    t : ndarray of int64, shape (n,)
        In order, from `lo` to below `hi`.
    pixel : ndarray of intp, shape (n,)

    Raises
    ------
    RecordingError
        If there are too many events for the duration of the frame.
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
    first = np.zeros_like(n)
    for piece in range(1, pieces + 1):
        # the first event of each pixel that lies at or after the piece's end
        bound = -(-((n << _PHASE_BITS) * (length * piece // pieces)) // length)
        end = np.clip(-(-(bound - phases) // (1 << _PHASE_BITS)), 0, n)
        some = end - first
        pixel = np.repeat(active, some)
        index = np.arange(pixel.size) + np.repeat(first - (np.cumsum(some) - some), some)
        shifted = (index << _PHASE_BITS) + np.repeat(phases, some)
        offset = shifted * length // (np.repeat(n, some) << _PHASE_BITS)
        # offsets of 16 bits are sorted by radix
        key = offset.astype(np.uint16) if length <= 1 << 16 else offset
        order = np.argsort(key, kind="stable")
        yield lo + offset[order], pixel[order]
        first = end


def join(frames: list[Placed], x: npt.NDArray[np.uint16], y: npt.NDArray[np.uint16]) -> Columns:
    """Join placed events to columns; pixel j lies at ``x[j]``, ``y[j]``."""
    t = np.concatenate([times for times, _ in frames])
    pixel = np.concatenate([pixels for _, pixels in frames])
    return Columns(t, x[pixel], y[pixel], np.ones(t.size, dtype=bool))


_BLOCK_BYTES = 1 << 20


class CountFrames:
    """Count frames of a ``.npz`` or ``.npy`` file, or of a folder of PNG or ``.npy`` files.

    Frames are read a few at a time.

    Attributes
    ----------
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
        self._read_image: Callable[[Path, Sensor | None], Counts] = _read_png_frame
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
                yield _whole_counts(
                    self._read_image(image, self.sensor).reshape(1, -1), frame, self.path
                )
                frame += 1
            return
        with foreign_errors(self.path, lambda: f" after frame {frame:,}"), self._stream() as stream:
            rows = max(1, _BLOCK_BYTES // max(1, stream.row_bytes))
            log = log or FaultLog(self.path, Sensor(1, 1))
            for block in stream.blocks(rows, log, "frame {} of {}"):
                counts = both_polarities(block, len(stream.shape) - self._polarities)
                yield _whole_counts(counts.reshape(len(block), -1), frame, self.path)
                frame += len(block)

    def load(self) -> Counts:
        """Return all frames as windows, shape ``(F, J)``."""
        return np.concatenate(list(self.blocks()))

    def _find_images(self) -> None:
        images = list(self.path.glob("*.png"))
        if not images:
            images, self._read_image = _frame_arrays(self.path), _read_array_frame
        if not images:
            raise RecordingError(
                f"{self.path} holds no *.png and no *.npy: name a folder of count frames"
            )
        self._images = sorted(images, key=_number_key)
        first = self._read_image(self._images[0], None)
        self._grid(*first.shape)
        self.n_frames = len(self._images)
        self.period, self.start_us = _read_metadata(self.path)

    @contextmanager
    def _stream(self) -> Iterator[ArrayStream]:
        if self._name:
            with Archive(self.path) as archive:
                yield archive.stream(self._name)
        else:
            with self.path.open("rb") as file:
                yield ArrayStream(file, str(self.path))

    def _read_array_layout(self) -> None:
        with self._stream() as stream:
            shape, dtype = stream.shape, stream.dtype
        _check_frame_shape(shape[1:], dtype, str(self.path))
        if not shape[0]:
            raise RecordingError(f"{self.path} holds no frames: save it again")
        self._polarities = len(shape) - 3
        self.n_frames = shape[0]
        self._grid(*shape[1:3])

    def _read_layout(self) -> None:
        with Archive(self.path) as archive:
            arrays = [name for name in ("frames", "counts") if name in archive.names]
            if len(arrays) != 1:
                raise RecordingError(
                    f"{self.path} holds {', '.join(sorted(archive.names)) or 'nothing'}: "
                    "count frames need the array frames (F,H,W) or counts (F,J)"
                )
            self._name = arrays[0]
            stream = archive.stream(self._name)
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
                self.period = _simplest_fraction(float(seconds), self.path)

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
    path = as_path(path, "count frames")
    if not path.exists():
        raise RecordingError(f"{path} does not exist: check the path")
    with foreign_errors(path):
        return CountFrames(path)


def parse_period(duration: Fraction | float | str) -> Fraction:
    """Return the exact period of a frame in seconds, of a number or of text such as ``1/30``."""
    period = Fraction(0)
    if isinstance(duration, Fraction):
        period = duration
    elif isinstance(duration, str):
        with suppress(ValueError, ZeroDivisionError):
            period = Fraction(duration)
    elif isinstance(duration, int | float) and 0 < duration < 1 << 31 and duration is not True:
        period = Fraction(duration).limit_denominator(1_000_000)
    if not 0 < period < 1 << 31:
        raise UsageError(f"frame period {duration!r} is no positive number: write for example 1/30")
    return period


class FrameSource(Source):
    """Source of the events of count frames, which `expand` places in time."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.frames = read_count_frames(path)
        super().__init__(path, options, self.frames.sensor, self.frames.start_us)
        period = self.frames.period
        if period is None:
            period = options.frame_period or options.default.frame_period
        elif options.frame_period not in (None, period):
            raise UsageError(
                f"{path} has frames of {period} s, and {options.frame_period} s was given: "
                "leave the frame period out"
            )
        if period is None:
            raise UsageError(
                f"{path} does not say how long a frame lasts: pass frame_period=, "
                "for example frame_period='1/30'"
            )
        if self.frames.pixel_x is None or self.frames.pixel_y is None:
            raise UsageError(
                f"{path} has counts without pixel_x and pixel_y, so that they cannot become "
                "events: add the pixels, or use the counts as windows (read_count_frames)"
            )
        self.frame_period, self.period_us = period, period * 1_000_000
        if self.sensor is not None:
            self.counted = np.zeros((self.sensor.height, self.sensor.width), dtype=np.bool_)
            x, y = self.frames.pixel_x, self.frames.pixel_y
            on = (x < self.sensor.width) & (y < self.sensor.height)
            self.counted[y[on], x[on]] = True

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
        self.end_us = math.floor(frame * self.period_us)
