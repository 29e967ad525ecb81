"""Prophesee's RAW files with EVT 2.0, 2.1 and 3.0 words."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import RecordingError
from edge_vpr.events import Columns, Events, Sensor, empty_columns
from edge_vpr.recordings.decoding import RecordFile, clock_step, is_text
from edge_vpr.recordings.reading import FaultLog, ReadOptions, Source

# The text header of Prophesee's RAW files.


#: Sensor sizes of files older than the header's ``format`` and ``geometry`` lines: the driver's
#: name identifies the sensor, and each of these sensors has one size (Prophesee's Metavision SDK
#: decides in the same way).
_PLUGINS = (
    (r"_gen3(1)?_", Sensor(640, 480)),
    (r"_gen4(1)?_", Sensor(1280, 720)),
    (r"_imx636_", Sensor(1280, 720)),
    (r"_genx320_", Sensor(320, 320)),
)
_VERSIONS = {"2": "evt2", "2.0": "evt2", "2.1": "evt21", "3": "evt3", "3.0": "evt3"}
_FORMATS = {"EVT2": "evt2", "EVT21": "evt21", "EVT3": "evt3"}

_LONGEST_LINE, _LONGEST_HEADER = 1 << 20, 1 << 24

#: Header field in which our writers store ``start_us``; with it, times count from the start.
START_FIELD = "edge_vpr_start_us"


class Header(NamedTuple):
    """Content of the lines that begin with ``%``."""

    fields: dict[str, str]

    @property
    def encoding(self) -> str | None:
        """Name of the format; None if no line states it."""
        stated = self.fields.get("format") or self.fields.get("evt")
        if stated is None:
            return None
        encodings = _FORMATS if "format" in self.fields else _VERSIONS
        if name := encodings.get(stated.split(";")[0].strip().upper()):
            return name
        raise RecordingError(
            f"Prophesee encoding {stated!r} is not read: convert it to EVT2, EVT2.1 or EVT3"
        )

    @property
    def sensor(self) -> Sensor | None:
        """Size of the sensor; None if no line states it."""
        options = self._options
        width, height = options.get("width"), options.get("height")
        if width and height and width.isdigit() and height.isdigit():
            return Sensor(int(width), int(height))
        if "geometry" in self.fields:
            return Sensor.parse(self.fields["geometry"])
        return None

    @property
    def camera(self) -> Sensor | None:
        """Size of the sensor that the driver's name identifies, of which a part may be recorded."""
        plugin = self.fields.get("plugin_name", "") + "_"
        return next((size for name, size in _PLUGINS if re.search(name, plugin)), None)

    def size(self, options: ReadOptions) -> Sensor | None:
        """Return the size that the file states, else the caller, else the camera."""
        return self.sensor or options.sensor or self.camera

    @property
    def endianness(self) -> str:
        """``little``, ``big``, or ``legacy``: EVT 2.1 of Gen4.1 and IMX636, upper half first."""
        return self._options.get("endianness") or self.fields.get("endianness", "little")

    @property
    def start_us(self) -> int | None:
        """Time t = 0 on an outer clock, if edge-vpr wrote the file; else None."""
        text = self.fields.get(START_FIELD, "")
        return int(text) if re.fullmatch(r"-?\d+", text) else None

    @property
    def _options(self) -> dict[str, str]:
        parts = self.fields.get("format", "").split(";")
        return dict(part.split("=", 1) for part in parts if "=" in part)


def read_header(file: BinaryIO) -> tuple[Header, int]:
    """Read the header lines of a file; return the header, and its length in bytes.

    Header lines are text and begin with ``%``. The header ends before the first other line, or
    after ``% end``.
    """
    fields: dict[str, str] = {}
    at = 0
    # data may begin with the byte of "%", too
    while (line := file.readline(_LONGEST_LINE)).startswith(b"% ") and is_text(line):
        at += len(line)
        if at > _LONGEST_HEADER:
            raise RecordingError(
                f"the header has more than {_LONGEST_HEADER:,} bytes: copy or record it again"
            )
        key, _, value = line[1:].decode("utf-8", "replace").strip().partition(" ")
        if key == "end":
            break
        fields[key] = value.strip()
    return Header(fields), at


def _header_lines(sensor: Sensor, start_us: int) -> bytes:
    """Return the header of a file that we write."""
    lines = [
        "evt 2.0",
        f"format EVT2;height={sensor.height};width={sensor.width}",
        f"geometry {sensor}",
        f"{START_FIELD} {start_us}",
        "end",
    ]
    return "".join(f"% {line}\n" for line in lines).encode("ascii")


# Words of Prophesee's EVT formats: their kinds, and encoding in EVT 2.0.


#: Kinds in EVT 2.0 and 2.1: OFF event, ON event, high bits of the time, edge of a trigger, and two
#: kinds without events.
EVT2_KINDS = (0, 1, 8, 10, 14, 15)
#: Kinds in EVT 3.0: row; single event; first column of a vector; 12 and 8 columns of a vector;
#: continuations; low and high bits of the time; edge of a trigger; and two kinds without events.
EVT3_KINDS = (0, 2, 3, 4, 5, 6, 7, 8, 10, 14, 15)
_TIME_HIGH = 8
#: Six low bits of the time are in the word of an event, and 28 high bits in a word before it.
EVT2_LOW_BITS, EVT2_HIGH_BITS = 6, 28


def evt2_event_words(events: Events) -> npt.NDArray[np.uint32]:
    """Encode events as words, without the words for the high bits of their times.

    Returns
    -------
    ndarray of uint32, shape (n,)
        4 bits kind, 6 bits time, 11 bits column, 11 bits row.
    """
    low = events.t & ((1 << EVT2_LOW_BITS) - 1)
    return np.asarray(
        events.p.astype(np.uint32) << 28
        | low.astype(np.uint32) << 22
        | events.x.astype(np.uint32) << 11
        | events.y,
        dtype="<u4",
    )


def evt2_time_words(t: npt.NDArray[np.int64]) -> npt.NDArray[np.uint32]:
    """Encode the high bits of times in microseconds as words, shape (n,)."""
    high = t >> EVT2_LOW_BITS & ((1 << EVT2_HIGH_BITS) - 1)
    return (_TIME_HIGH << EVT2_HIGH_BITS | high).astype("<u4")


# Kernels that decode the words of Prophesee's EVT 2.0, 2.1 and 3.0.


#: State between two calls: time base; its raw value (-1 before the first word that states it, and
#: after a loss of words); the raw value before such a loss; usual step between two raw values; row;
#: first column and polarity of a vector; low bits of the time (-1 before the first word that states
#: them); and number of events before the first words of time and place.
STATE = np.dtype(
    [
        ("time_base", "<i8"),
        ("high", "<i8"),
        ("before", "<i8"),
        ("stride", "<i8"),
        ("row", "<i8"),
        ("first", "<i8"),
        ("polarity", "<i8"),
        ("low", "<i8"),
        ("undated", "<i8"),
    ]
)


#: EVT 3.0's clock has wrapped if it falls by its full range less this, in units of 4,096 us, as in
#: Prophesee's decoder; a smaller fall is a restart of the camera, or a late word.
_LEAST_MARGIN = 10


_clock_step = kernel(inner=True)(clock_step)


@kernel(inner=True)
def _advance(s, high):  # type: ignore[no-untyped-def]
    """Advance the time base of EVT 2.0 or 2.1, 28 bits, to a new value of the high time bits.

    The shorter direction decides between a wrap and a step back; a step back is kept.
    """
    if s["before"] < 0:
        s["time_base"] = high
    else:
        s["time_base"] += _clock_step(high - s["before"], 1 << 28, 1 << 27)
    s["high"] = s["before"] = high


@kernel(inner=True)
def _advance_evt3(s, high):  # type: ignore[no-untyped-def]
    """Advance the time base of EVT 3.0, 12 bits, to a new value of the high time bits.

    A rise is a step forward of up to 16.8 s. A fall is a wrap if it ends nearly a full range below.
    "Nearly" is twice the usual step: cameras repeat the time all along, so that it rises by 1, but
    some writers state it only with events, which can be far apart.
    """
    if s["before"] < 0:
        s["time_base"], s["stride"] = high, 1024
    else:
        step = high - s["before"]
        if step >= 4096 - _LEAST_MARGIN:
            step -= 4096  # a late word, just after a wrap
        elif step <= max(_LEAST_MARGIN, 2 * s["stride"]) - 4096:
            step += 4096
        s["time_base"] += step
        # the step to a single false time must not make the step back a wrap
        step = min(step, 2 * s["stride"] + 16, 1024)
        s["stride"] = max(step, s["stride"] - (s["stride"] + 15) // 16)
    s["high"] = s["before"] = high


#: Words that are decoded at once, so that what is kept of them stays in a core's first-level cache.
_BLOCK = 1_024
_HIGH_MASK = np.uint32((1 << EVT2_HIGH_BITS) - 1)


@kernel
def decode_evt2(words, state, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode 32-bit words: 4 bits type, 6 bits time, 11 bits column, 11 bits row."""
    s, n = state[0], np.uint64(0)
    for start in range(0, words.size, _BLOCK):
        block, first = words[start : start + _BLOCK], n
        # Without a branch: every word is written as an event, and the next one overwrites it unless
        # it is one. Where the time may wrap, the block is decoded again.
        top = s["time_base"] & ~np.int64(_HIGH_MASK)
        before = now = np.uint32(s["time_base"] & np.int64(_HIGH_MASK))
        changed = np.uint32(0)
        for i in range(block.size):
            word = block[i]
            kind = word >> np.uint32(28)
            t[n] = (top | np.int64(now)) << 6 | np.int64(word >> np.uint32(22) & np.uint32(63))
            x[n] = word >> np.uint32(11) & np.uint32(2047)
            y[n] = word & np.uint32(2047)
            p[n] = kind == 1
            n += np.uint64(kind < 2)
            now = word & _HIGH_MASK if kind == 8 else now
            changed |= now ^ before
        if s["high"] >= 0 and changed >> np.uint32(27) == 0:
            s["time_base"] = top | np.int64(now)
            s["high"] = s["before"] = np.int64(now)
            continue
        n = first
        for i in range(block.size):
            word = block[i]
            kind = word >> np.uint32(28)
            if kind == 8:
                _advance(s, np.int64(word & _HIGH_MASK))
            elif kind < 2 and s["high"] < 0:
                s["undated"] += 1
            elif kind < 2:
                t[n] = s["time_base"] << 6 | np.int64(word >> np.uint32(22) & np.uint32(63))
                x[n] = word >> np.uint32(11) & np.uint32(2047)
                y[n] = word & np.uint32(2047)
                p[n] = kind == 1
                n += np.uint64(1)
    return np.int64(n)


#: Number of the only bit of a word that is set, by the top bits of its product with a de Bruijn
#: sequence.
_DE_BRUIJN = 0x077CB531
_BIT = np.zeros(32, np.int64)
_BIT[[(_DE_BRUIJN << i & 0xFFFFFFFF) >> 27 for i in range(32)]] = np.arange(32)


@kernel
def decode_evt21(words, state, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode 64-bit words: 4 bits type, 6 time, 11 column, 11 row, 32 for one column each."""
    s, n = state[0], 0
    for word64 in words:
        top = np.int64(word64 >> np.uint64(32))
        kind = top >> 28
        if kind < 2:
            valid = np.int64(word64 & np.uint64(0xFFFFFFFF))
            first, time = top >> 11 & 2047, s["time_base"] << 6 | top >> 22 & 63
            dated = s["high"] >= 0
            while valid:
                if dated:
                    t[n] = time
                    x[n] = first + _BIT[((valid & -valid) * _DE_BRUIJN & 0xFFFFFFFF) >> 27]
                    y[n] = top & 2047
                    p[n] = kind == 1
                    n += 1
                else:
                    s["undated"] += 1
                valid &= valid - 1
        elif kind == 8:
            _advance(s, top & 0xFFFFFFF)
    return n


#: What a word of EVT 3.0 does to the packed event, by its kind: the bits that stay, where its
#: value goes, and whether it is an event. Bits 0 to 11 are column and polarity, as in the word of a
#: single event; 16 to 27 the row, 28 the 12th bit of the column, and 32 to 43 the low bits of the
#: time.
_PACKING = np.zeros((16, 3), np.uint64)
_PACKING[:, 0] = np.uint64((1 << 64) - (1 << 12))
_PACKING[0] = (1 << 64) - 1 - (0xFFF << 16), 16, 0
_PACKING[2, 2] = 1
_PACKING[6] = (1 << 64) - 1 - (0xFFF << 32), 32, 0
_SINGLE = np.uint64(0xFFF)


@kernel
def decode_evt3(words, state, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode 16-bit words, each of which changes a part of the state or holds events.

    A new value of the high time bits sets the low ones to 0; the sensor sends the low bits next.
    Parts of the state that no word has stated yet are -1.
    """
    s, n, start = state[0], 0, 0
    low, row, column, polarity = s["low"], s["row"], s["first"], s["polarity"]
    packed = np.empty(12 * _BLOCK, np.uint64)
    while start < words.size:
        dated, highs = s["high"] >= 0 and low >= 0 and row >= 0, np.uint64(s["high"])
        block = words[start : start + (_BLOCK if dated else 1)]
        now = np.uint64(low << 32 | row << 16) if dated else np.uint64(0)
        events, turned, kind, value = np.uint64(0), False, np.uint64(0), np.uint64(0)
        plain, same = dated, np.uint16(0x8000 | highs & np.uint64(4095))
        for i in range(block.size):  # compiles to vectors
            sort = np.uint16(block[i] >> np.uint16(12))
            plain &= not (((sort == 8) & (block[i] != same)) | ((sort >= 3) & (sort <= 5)))
        # Without a branch where the block has only single events: every word is written, and the
        # next one overwrites it unless it is an event.
        for i in range(block.size if plain else 0):
            word = np.uint64(block[i])
            kind = word >> np.uint64(12)
            now = now & _PACKING[kind, 0] | (word & np.uint64(4095)) << _PACKING[kind, 1]
            packed[events] = now
            events += _PACKING[kind, 2]
        at = block.size - 1
        for at in range(0 if plain else block.size):
            word = np.uint64(block[at])
            kind, value = word >> np.uint64(12), word & np.uint64(4095)
            turned = (kind == 8) & (value != highs)
            if turned | ((kind >= 3) & (kind < 6)):
                if turned:
                    break
                if kind == 3:  # the first column of a vector, and its polarity
                    column = np.int64(value & np.uint64(2047))
                    polarity = np.int64(value & np.uint64(2048))
                    continue
                width = 12 if kind == 4 else 8  # columns, one bit each
                valid = np.int64(value) & ((1 << width) - 1)
                if column < 0:
                    while valid:
                        s["undated"] += 1
                        valid &= valid - 1
                    continue
                kept = now & ~_SINGLE | np.uint64(polarity)
                for bit in range(12):
                    place = np.uint64((column + bit) & 2047 | (column + bit & 2048) << 17)
                    packed[events] = kept | place
                    events += np.uint64(valid >> bit & 1)
                column = min(column + width, 2048)  # one beyond the last one stays at 2048
                continue
            now = now & _PACKING[kind, 0] | value << _PACKING[kind, 1]
            packed[events] = now
            events += _PACKING[kind, 2]
        start += at + 1
        if dated:
            row, low = np.int64(now) >> 16 & 2047, np.int64(now) >> 32
            base, end = s["time_base"] << 12, n + np.int64(events)
            # columns of their own, so that the loop compiles to vectors
            t_of, x_of, y_of, p_of = t[n:end], x[n:end], y[n:end], p[n:end]
            for i in range(t_of.size):
                event = np.int64(packed[i])
                t_of[i] = base | event >> 32
                x_of[i] = np.uint16(event & 2047 | event >> 17 & 2048)
                y_of[i] = np.uint16(event >> 16 & 2047)
                p_of[i] = event & 2048 != 0
            n += t_of.size
        else:  # a word at a time, until time and row are stated
            s["undated"] += np.int64(events)
            row = np.int64(value) & 2047 if kind == 0 else row
            # useless without high ones
            low = np.int64(value) if kind == 6 and s["high"] >= 0 else low
        if turned:
            _advance_evt3(s, np.int64(value))
            low = min(low, 0)
    s["low"], s["row"], s["first"], s["polarity"] = low, row, column, polarity
    return n


# Prophesee RAW: EVT 2.0, 2.1 and 3.0 (docs.prophesee.ai, "Data encoding formats").
#
# The decoders are our own (`docs/results/readers.csv` compares readers): eventcv reads EVT 2.1
# as if it were 2.0, guesses the sensor of EVT 2.0 from the events where the header names none, and
# maps the file, so that its resident memory grows with the file; the clock of expelliarmus for EVT
# 3.0 runs away. The compiled decoders here need bounded memory.


Words = npt.NDArray[Any]

#: Word type, most events of one word, high bits of the clock, and decoder of each encoding.
_DECODERS: dict[str, tuple[np.dtype[Any], int, int, Callable[..., int]]] = {
    "evt2": (np.dtype("<u4"), 1, EVT2_HIGH_BITS, decode_evt2),
    "evt21": (np.dtype("<u8"), 32, EVT2_HIGH_BITS, decode_evt21),
    "evt3": (np.dtype("<u2"), 12, 12, decode_evt3),
}


class EvtWordDecoder:
    """Decode words of one encoding chunk by chunk; the state carries over between chunks.

    Parameters
    ----------
    encoding : {"evt2", "evt21", "evt3"}
        Of the words.
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
    """

    def __init__(self, encoding: str, capacity: int, endianness: str = "little") -> None:
        dtype, self.per_word, self._high_bits, self._kernel = _DECODERS[encoding]
        self.dtype = dtype.newbyteorder(">") if endianness == "big" else dtype
        self._native = dtype.newbyteorder("=")
        self._swap = endianness == "legacy" and encoding == "evt21"
        unknown = {"high": -1, "before": -1, "low": -1, "row": -1, "first": -1}
        values = tuple(unknown.get(name, 0) for name in STATE.names or ())
        self._state = np.array([values], dtype=STATE)
        self._columns = empty_columns(capacity * self.per_word)

    def lose(self) -> None:
        """Handle a loss of words: time and place are unknown until words state them again."""
        for name in ("high", "low", "row", "first"):
            self._state[name] = -1

    def take_counts(self) -> tuple[int, int]:
        """Return the number of wraps of the clock, and of dropped events since the last call.

        Events before the first words of time and place are dropped.
        """
        values = self._state.item()
        if values[-1]:
            self._state["undated"] = 0
        return max(0, values[0] >> self._high_bits), values[-1]

    def decode(self, words: Words) -> Columns:
        """Decode words; the returned columns are valid until the next call."""
        if words.size * self.per_word > self._columns.t.size:
            self._columns = empty_columns(words.size * self.per_word)
        native = words if words.dtype.isnative else words.astype(self._native)
        if self._swap:
            native = native << np.uint64(32) | native >> np.uint64(32)
        t, x, y, p = self._columns
        n = self._kernel(native, self._state, t, x, y, p)
        return Columns(t[:n], x[:n], y[:n], p[:n])


class EvtSource(Source):
    """Source of a RAW file: header lines, then words."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._file = RecordFile(path, read_header)
        header = self._file.header
        if not options.format:
            if header.encoding is None:
                raise RecordingError(
                    f"{path} has no header that names its encoding: pass format=, one of evt2, "
                    "evt21 and evt3"
                )
            options = replace(options, format=header.encoding)
        self._endianness = header.endianness
        if self._endianness not in ("little", "big", "legacy"):
            raise RecordingError(
                f"{path} has the unknown endianness {self._endianness!r}: known are little, big "
                "and legacy; convert it with Prophesee's tools"
            )
        super().__init__(path, options, header.size(options), header.start_us)

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        n = self.options.chunk_events
        decoder = EvtWordDecoder(self.options.format, n, self._endianness)
        for words, position in self._file.blocks(decoder.dtype, n, log, what="a word"):
            self.position = position
            columns = decoder.decode(words)
            log.undated(decoder.take_counts()[1])
            yield columns


class Evt2Sink:
    """Write EVT 2.0: a time word where the high bits of the time change, and a word an event."""

    def __init__(self, path: Path, sensor: Sensor, start_us: int) -> None:
        if max(sensor) > 2048:
            raise RecordingError(
                f"EVT 2.0 holds up to 2048x2048 pixels, and not {sensor}: use .npz"
            )
        self._file = path.open("wb")
        self._file.write(_header_lines(sensor, start_us))
        self._high = -1

    def write(self, events: Events) -> None:
        """Append events.

        Raises
        ------
        RecordingError
            If there is a gap of more than 2.4 hours, which looks like a wrapped clock.
        """
        if events.t[0] < 0:
            raise RecordingError(
                f"time {events['t'][0]} us is negative, which .raw cannot hold: use .npz"
            )
        high = events.t >> 6
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
        words[at[new] - 1] = evt2_time_words(events.t[new])
        self._file.write(words.tobytes())
        self._high = int(high[-1])

    def close(self) -> None:
        """End the file."""
        self._file.close()
