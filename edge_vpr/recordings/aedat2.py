"""AEDAT 2.0, written by jAER: pairs of a 32-bit address and a 32-bit time, big endian.

The address layout depends on the chip (docs.inivation.com, "AEDAT 2.0"). jAER stores columns
mirrored and rows from the lowest up, and mirrors the columns back when it reads: its extractors
(``DavisBaseCamera.DavisEventExtractor``, ``DVS128.Extractor``) compute ``sizeX - 1 - column``. For
the DVS128 the polarity bit of an ON event is 0. The cameras' drivers (libcaer, rpg_dvs_ros) undo
the same mirroring, so that this reader gives the events as AEDAT 4 or a ROS bag of the same camera
has them.

The decoder is our own: eventcv loads these files whole, leaves the columns mirrored, refuses DVS128
files, and reads them as DAVIS files if a sensor size is given.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError
from edge_vpr.events import Sensor
from edge_vpr.recordings.clock import Unwrapper
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.records import read_records
from edge_vpr.recordings.source import ReadOptions, Source

_EVENT = np.dtype([("address", ">u4"), ("t", ">u4")])


class _Layout(NamedTuple):
    """Position of column, row and polarity in the address.

    `on` is the value of the polarity bit of an ON event; `other` has the bits of all other events.
    """

    x_shift: int
    x_mask: int
    y_shift: int
    y_mask: int
    p_bit: int
    on: int
    other: int


# bit 31 marks frames and IMU samples, bit 10 external edges; DVS128 marks these with bit 15
_DAVIS = _Layout(12, 0x3FF, 22, 0x1FF, 11, 1, 1 << 31 | 1 << 10)
_DVS128 = _Layout(1, 0x7F, 8, 0x7F, 0, 0, 1 << 15)

_CHIPS = (
    (r"dvs128", Sensor(128, 128), _DVS128),
    (r"davis240", Sensor(240, 180), _DAVIS),
    (r"davis(rgb)?346", Sensor(346, 260), _DAVIS),
    (r"davis(rgb)?640", Sensor(640, 480), _DAVIS),
    (r"davis208", Sensor(208, 192), _DAVIS),
    (r"davis128", Sensor(128, 128), _DAVIS),
)


def chip_size(name: str) -> Sensor | None:
    """Return the size of the sensor of a chip; None if the chip is unknown."""
    return next((size for chip, size, _ in _CHIPS if re.search(chip, name.lower())), None)


class Pairs(NamedTuple):
    """Part of a file: 32-bit addresses as int64, and times continued beyond their wraps."""

    address: npt.NDArray[np.int64]
    time_us: npt.NDArray[np.int64]
    position: float


def read_pairs(path: Path, begin: int, number: int, log: FaultLog) -> Iterator[Pairs]:
    """Yield the pairs of a file from byte `begin` on, up to `number` at a time.

    `position` is the share of the file up to the end of the part.
    """
    clock = Unwrapper(32)
    for pairs, position in read_records(path, begin, _EVENT, number, log):
        yield Pairs(pairs["address"].astype(np.int64), clock.unwrap(pairs["t"]), position)


class Aedat2Source(Source):
    """Source of an AEDAT 2 file: header lines that begin with ``#``, then pairs.

    Columns and rows are turned so that pixel (0, 0) is the upper left one, as in all other sources.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._skip, chip = read_header(path)
        for name, size, layout in _CHIPS:
            if chip is not None and re.search(name, chip.lower()):
                self._sensor, self._layout = size, layout
                break
        else:
            raise RecordingError(
                f"{path} was recorded by the chip {chip or '(its header does not say)'}, whose "
                "addresses are not known here: convert it with jAER or DV to AEDAT 4"
            )
        super().__init__(path, options, self._sensor)

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        layout = self._layout
        right, top = self._sensor.width - 1, self._sensor.height - 1
        n = self.options.chunk_events
        for address, t, position in read_pairs(self.path, self._skip, n, log):
            self.position = position
            change = address & layout.other == 0
            address, t = address[change], t[change]
            yield Columns(
                t,
                right - (address >> layout.x_shift & layout.x_mask),
                top - (address >> layout.y_shift & layout.y_mask),
                (address >> layout.p_bit & 1) == layout.on,
            )


def read_header(path: Path) -> tuple[int, str | None]:
    """Return the length of the header, and the chip that it names."""
    n, chip = 0, None
    with path.open("rb") as file:
        while (line := file.readline(1 << 16)).startswith(b"#"):
            n += len(line)
            if match := re.match(rb"#\s*AEChip:\s*(\S+)", line):
                chip = match[1].decode("ascii", "replace")
            if line.startswith((b"# End Of ASCII", b"#End Of ASCII")):
                break
    return n, chip


open_source = Aedat2Source
