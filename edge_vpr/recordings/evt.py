"""Prophesee RAW: EVT 2.0, 2.1 and 3.0 (docs.prophesee.ai, "Data encoding formats").

The decoders are our own, for reasons that `docs/recordings.md` measures: eventcv reads EVT 2.1 as
if it were 2.0, guesses the sensor of EVT 2.0 from the events where the header names none, and maps
the file, so that its resident memory grows with the file; the clock of expelliarmus for EVT 3.0
runs away. The compiled decoders here need bounded memory and are three times as fast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError
from edge_vpr.events import Events, Sensor
from edge_vpr.evt_words import evt2_event_words, evt2_time_words
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.evt_kernels import STATE, decode_evt2, decode_evt3, decode_evt21
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.prophesee import header_lines, read_header
from edge_vpr.recordings.records import read_records
from edge_vpr.recordings.source import ReadOptions, Source

Words = npt.NDArray[Any]

#: Word type, most events of one word, bits of the clock, and decoder of each encoding.
_DECODERS: dict[str, tuple[np.dtype[Any], int, int, Callable[..., int]]] = {
    "evt2": (np.dtype("<u4"), 1, 34, decode_evt2),
    "evt21": (np.dtype("<u8"), 32, 34, decode_evt21),
    "evt3": (np.dtype("<u2"), 12, 24, decode_evt3),
}


class Decoder:
    """Decode words of one encoding chunk by chunk; the state carries over between chunks.

    Parameters
    ----------
    encoding : {"evt2", "evt21", "evt3"}
    capacity : int
        Largest number of words of one call.
    endianness : {"little", "big", "legacy"}
        ``"legacy"`` is EVT 2.1 as Gen4.1 and IMX636 send it: little endian, but upper half first.

    Attributes
    ----------
    dtype : dtype
        Type of the words.
    per_word : int
        Most events of one word.
    clock_bits : int
        Bits of the clock, which counts microseconds.
    """

    def __init__(self, encoding: str, capacity: int, endianness: str = "little") -> None:
        dtype, self.per_word, self.clock_bits, self._kernel = _DECODERS[encoding]
        self.dtype = dtype.newbyteorder(">") if endianness == "big" else dtype
        self._swap = endianness == "legacy" and encoding == "evt21"
        unknown = {"high": -1, "low": -1, "row": -1, "first": -1}
        values = tuple(unknown.get(name, 0) for name in STATE.names or ())
        self._state = np.array([values], dtype=STATE).view(np.recarray)
        self._reserve(capacity)

    def _reserve(self, words: int) -> None:
        n = words * self.per_word
        self._t = np.empty(n, np.int64)
        self._x, self._y = np.empty(n, np.uint16), np.empty(n, np.uint16)
        self._p = np.empty(n, np.bool_)

    def take_undated(self) -> int:
        """Return the number of dropped events since the last call.

        These came before the first words of time and place.
        """
        n = int(self._state[0].undated)
        self._state[0].undated = 0
        return n

    def decode(self, words: Words) -> Columns:
        """Decode words; the returned columns are valid until the next call."""
        if words.size * self.per_word > self._t.size:
            self._reserve(words.size)
        native = words.astype(words.dtype.newbyteorder("="), copy=False)
        if self._swap:
            native = native << np.uint64(32) | native >> np.uint64(32)
        n = self._kernel(native, self._state, self._t, self._x, self._y, self._p)
        return Columns(self._t[:n], self._x[:n], self._y[:n], self._p[:n])


class EvtSource(Source):
    """Source of a RAW file: header lines, then words."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        header = read_header(path)
        super().__init__(path, options, header.sensor)
        self._skip, self._endianness = header.n_bytes, header.endianness
        if self._endianness not in ("little", "big", "legacy"):
            raise RecordingError(
                f"{path} has the unknown endianness {self._endianness!r}: known are little, big "
                "and legacy; convert it with Prophesee's tools"
            )
        if header.start_us is not None:
            self.start_us, self.relative = header.start_us, True

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        n = self.options.chunk_events
        decoder = Decoder(self.options.format, n, self._endianness)
        for words, position in read_records(
            self.path, self._skip, decoder.dtype, n, log, what="a word"
        ):
            self.position = position
            yield decoder.decode(words)
            log.undated(decoder.take_undated())


open_source = EvtSource


class Evt2Sink:
    """Write EVT 2.0: a time word where the high bits of the time change, and a word an event."""

    def __init__(self, path: Path, sensor: Sensor, start_us: int) -> None:
        if max(sensor) > 2048:
            raise RecordingError(f"EVT 2.0 holds up to 2048x2048 pixels, and not {sensor}: use .h5")
        self._file = path.open("wb")
        self._file.write(header_lines("evt2", sensor, start_us))
        self._high = -1

    def write(self, events: Events) -> None:
        """Append events.

        Raises
        ------
        RecordingError
            If there is a gap of more than 2.4 hours, which looks like a wrapped clock.
        """
        if events["t"][0] < 0:
            raise RecordingError(
                f"time {events['t'][0]} us is negative, which .raw cannot hold: use .npz"
            )
        high = events["t"] >> 6
        steps = np.diff(high, prepend=self._high)
        if steps.max() >= 1 << 27:
            raise RecordingError(
                f"a gap of {int(steps.max()) * 64 / 3.6e9:.1f} hours between two events cannot be "
                "distinguished from a wrapped clock in EVT 2.0: use .npz"
            )
        new = steps != 0
        at = np.arange(events.size) + np.cumsum(new)
        words = np.empty(events.size + int(new.sum()), "<u4")
        words[at] = evt2_event_words(events)
        words[at[new] - 1] = evt2_time_words(events["t"][new])
        self._file.write(words.tobytes())
        self._high = int(high[-1])

    def close(self) -> None:
        """End the file."""
        self._file.close()


open_sink = Evt2Sink
