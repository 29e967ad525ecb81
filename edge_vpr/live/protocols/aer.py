"""Plain address-event words of home-made bridges, described by a small TOML file.

.. code-block:: toml

    bytes = 4                          # 2 to 8
    endian = "little"                  # or "big"
    x = { shift = 0, bits = 7 }
    y = { shift = 7, bits = 7 }
    p = { shift = 14, on = 1 }         # absent: all events are ON
    t = { shift = 16, bits = 16, tick_us = 1 }  # absent: an event's time is that of its arrival
    sync = { mask = 0x8000, value = 0x8000 }    # bits that every event's word has; may be absent

Include every bit that never changes in the mask: the decoder uses these bits to find the beginning
of words again. Two layouts have names and need no file: ``aer:layout=aer4`` is the one above, and
``aer:layout=jaer8`` is that of jAER: a big-endian address (row from bit 8, column from bit 1,
polarity in bit 0), then 32 bits of microseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError, printable
from edge_vpr.events import Columns, Events, Sensor, empty_columns
from edge_vpr.live.protocols import Clock, Decoder, Encoder, OptionReader
from edge_vpr.live.protocols.timestamps import STEP_US
from edge_vpr.live.protocols.words import Raw, Reading, WordDecoder, word_at
from edge_vpr.records import read_toml

# Address-event words, with the fields that a layout describes.


Form = npt.NDArray[np.void]

#: Most microseconds by which words of a device are out of order.
DISORDER_US = 1_000
#: Number of words within which a shifted stream is noticed.
NOTICE_WORDS = 40
# values of a layout for kernels; each field has a shift and a mask
_FORM = np.dtype(
    [
        (name, "<u8")
        for name in (
            "size", "big", "off", "sync_mask", "sync", "late", "span",
            "x", "x_mask", "y", "y_mask", "p", "p_mask", "t", "t_mask",
        )
    ]
)  # fmt: skip
# An odd step of time adds the first number to a score, and a good one subtracts 1. If the score
# exceeds the second number, the decoder is out of sync.
_ODD, _TOO_ODD = 4, 8
# time of the last word (-1: there is none), and score of the last steps
_MEMORY = np.dtype([("last", "<i8"), ("odd", "<i8")])
_NOTHING = (-1, 0)


@dataclass(frozen=True)
class Field:
    """Bits ``shift`` to ``shift + bits - 1`` of a word; a field without bits is absent."""

    shift: int = 0
    bits: int = 0

    @property
    def mask(self) -> int:
        """Largest value of the field."""
        return (1 << self.bits) - 1


@dataclass(frozen=True)
class Layout:
    """Position of the fields in a word."""

    size: int  #: Bytes of a word, 2 to 8.
    big: bool  #: Whether the most significant byte comes first.
    #: x, y, p, t: without `p` all events are ON; without `t` the time of an event is that of its
    #: arrival.
    x: Field
    y: Field
    p: Field = Field()
    t: Field = Field()
    tick_us: int = 1  #: Microseconds of a tick of `t`.
    #: sync_mask, sync_value: bits that the word of every event has, and their values; other words
    #: are not events.
    sync_mask: int = 0
    sync_value: int = 0
    off_is_one: bool = False  #: Whether the polarity bit is set for OFF.

    @property
    def clock(self) -> Clock:
        """Clock of the device, or that of the host if words have no time."""
        return Clock(self.t.bits, self.tick_us) if self.t.bits else Clock()

    def form(self) -> Form:
        """Return the values for kernels, as an array of one record."""
        # ticks that an event may lie before and after the last one to be plausible
        period = 1 << self.t.bits
        late = min(DISORDER_US // self.tick_us, period // 16)
        span = late + min(max(1, STEP_US // self.tick_us), period // 2)
        values = [self.size, self.big, self.off_is_one, self.sync_mask, self.sync_value, late, span]
        for field in (self.x, self.y, self.p, self.t):
            values += [field.shift, field.mask]
        return np.array([tuple(values)], dtype=_FORM)

    def check_sensor(self, name: str, sensor: Sensor) -> None:
        """Raise `UsageError` if the sensor has more columns or rows than the fields can hold."""
        if sensor.width > 1 << self.x.bits or sensor.height > 1 << self.y.bits:
            raise UsageError(
                f"{name} holds up to {1 << self.x.bits}x{1 << self.y.bits} pixels, and not "
                f"{sensor}: use another protocol"
            )


class LayoutDecoder(WordDecoder):
    """Decodes words of a layout; sync bits and time steps show where they begin."""

    def __init__(self, name: str, layout: Layout, sensor: Sensor) -> None:
        layout.check_sensor(name, sensor)
        super().__init__(sensor, layout.clock, layout.size, notice_words=NOTICE_WORDS)
        self.layout = layout
        self._form = layout.form()
        self._memory = np.array([_NOTHING], dtype=_MEMORY)
        self._columns = empty_columns(0)

    def _readings(self, raw: Raw, most: int) -> list[Reading]:
        return [Reading(*row) for row in _read(raw, most, self._form).tolist()]

    def _take_words(self, raw: Raw) -> tuple[int, Columns, bool]:
        words = raw.size // self.layout.size
        if words > self._columns.t.size:
            self._columns = empty_columns(words)
        t, x, y, p = self._columns
        used = int(_take(raw, self._form, self._memory, self._host_us, t, x, y, p))
        return used, Columns(t[:used], x[:used], y[:used], p[:used]), used < words

    def _lose_sync(self) -> None:
        super()._lose_sync()
        self._memory[0] = _NOTHING


@kernel
def _take(raw, form, memory, host_us, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode words up to one with wrong sync bits, or with one odd time step too many.

    A single odd step may be a silence, a damaged time or a restart; `TimestampFilter` decides.
    """
    f, m = form[0], memory[0]
    size, big = np.int64(f["size"]), f["big"] != 0
    words = raw.size // size
    x_at, x_mask, y_at, y_mask = f["x"], f["x_mask"], f["y"], f["y_mask"]
    p_at, p_mask, t_at, t_mask = f["p"], f["p_mask"], f["t"], f["t_mask"]
    sync_mask, sync, off = f["sync_mask"], f["sync"], f["off"] != 0
    late, span, period = np.int64(f["late"]), np.int64(f["span"]), np.int64(t_mask)
    last, odd = m["last"], m["odd"]
    for i in range(words):
        word = word_at(raw, i * size, size, big)
        if word & sync_mask != sync:
            return i
        if period:
            time = np.int64(word >> t_at & t_mask)
            if last >= 0 and (time - last + late) & period > span:
                odd += _ODD
                if odd > _TOO_ODD:
                    return i
            elif odd:
                odd -= 1
            last = time
            t[i] = time
        else:
            t[i] = host_us
        x[i] = word >> x_at & x_mask
        y[i] = word >> y_at & y_mask
        p[i] = (word >> p_at & p_mask != 0) != off if p_mask else True
    m["last"], m["odd"] = last, odd
    return words


@kernel
def _read(raw, most, form):  # type: ignore[no-untyped-def]
    """Count words with the right sync bits and a plausible time after the previous word."""
    f = form[0]
    size, big, t_at, t_mask = np.int64(f["size"]), f["big"] != 0, f["t"], f["t_mask"]
    late, span, period = np.int64(f["late"]), np.int64(f["span"]), np.int64(t_mask)
    sync_mask, sync = f["sync_mask"], f["sync"]
    readings = np.zeros((min(size, raw.size - size + 1), 4))
    steps = np.zeros(max(1, most - 1), dtype=np.int64)
    for offset in range(len(readings)):
        words = min(most, (raw.size - offset) // size)
        before = word_at(raw, offset, size, big)
        synced = before & sync_mask == sync
        good, marked = 1 if synced else 0, sync_mask != 0 and synced
        first = 0 if synced and words == 1 else words
        for i in range(1, words):
            word = word_at(raw, offset + i * size, size, big)
            step = np.int64(word >> t_at & t_mask) - np.int64(before >> t_at & t_mask)
            steps[i - 1] = step & period
            fits = (step + late) & period <= span
            # the first word after other bytes can only be checked against the next one
            if synced and fits:
                first = min(first, i - 1)
            before, synced = word, word & sync_mask == sync
            if synced and fits:
                good += 1
                first = min(first, i)
            marked &= synced
        readings[offset, 0], readings[offset, 1] = good, first
        readings[offset, 2] = np.median(steps[: max(1, words - 1)]) if period else 0.0
        readings[offset, 3] = marked
    return readings


class LayoutEncoder(Encoder):
    """Encodes events as words of a layout."""

    host_needs_options = True

    def __init__(self, name: str, layout: Layout, sensor: Sensor) -> None:
        layout.check_sensor(name, sensor)
        super().__init__(sensor)
        self.layout = layout

    def encode(self, events: Events) -> bytes:
        """Encode events; their times wrap."""
        layout = self.layout
        polarity = events.p ^ layout.off_is_one
        words = np.full(events.size, layout.sync_value, dtype=np.uint64)
        for where, values in (
            (layout.x, events.x),
            (layout.y, events.y),
            (layout.p, polarity),
            (layout.t, events.t // layout.tick_us),
        ):
            field = values.astype(np.int64) & where.mask
            words |= field.astype(np.uint64) << np.uint64(where.shift)
        as_bytes = words.astype(">u8").view(np.uint8).reshape(-1, 8)[:, 8 - layout.size :]
        return (as_bytes if layout.big else as_bytes[:, ::-1]).tobytes()


# Layouts by name, or of a TOML file.


#: Layouts that have names.
LAYOUTS = {
    "aer4": Layout(
        4, False, Field(0, 7), Field(7, 7), Field(14, 1), Field(16, 16),
        sync_mask=0x8000, sync_value=0x8000,
    ),
    "jaer8": Layout(
        8, True, Field(33, 7), Field(40, 7), Field(32, 1), Field(0, 32), off_is_one=True,
        sync_mask=0xFFFF8000 << 32,
    ),
}  # fmt: skip
_KEYS = {"bytes", "endian", "x", "y", "p", "t", "sync"}


def read_layout(path: str | Path) -> Layout:
    """Read a layout from a TOML file.

    Raises
    ------
    UsageError
        If the file cannot be read, or describes an impossible word.
    """
    values = read_toml(path, "a layout", "name a TOML file as docs/live.md shows it")
    if unknown := set(values) - _KEYS:
        names = printable(", ".join(sorted(unknown)))
        raise UsageError(f"{path} names {names}: a layout has {', '.join(sorted(_KEYS))}")
    size = _whole(path, "bytes", values.get("bytes"), 2, 8)
    if values.get("endian") not in ("little", "big"):
        shown = _shown(values.get("endian"))
        raise UsageError(f"{path}: endian = {shown}: expected little or big")
    for name in ("x", "y"):
        if name not in values:
            raise UsageError(
                f"{path} does not say where {name} lies: {name} = {{ shift = 0, ... }}"
            )
    fields = {name: _field(path, name, values[name], size) for name in "xypt" if name in values}
    taken = 0
    for name, field in fields.items():
        if taken >> field.shift & field.mask:
            raise UsageError(f"{path}: {name} overlaps another field: check shifts and bits")
        taken |= field.mask << field.shift
    sync = _table(path, "sync", values.get("sync", {}))
    mask, value = sync.get("mask", 0), sync.get("value", 0)
    for number in (mask, value):
        _whole(path, "sync", number, 0, (1 << 8 * size) - 1)
    if value & ~mask or mask & taken:
        raise UsageError(f"{path}: sync has value bits outside its mask, or lies over a field")
    return Layout(
        size,
        values["endian"] == "big",
        fields["x"],
        fields["y"],
        fields.get("p", Field()),
        fields.get("t", Field()),
        tick_us=_whole(
            path, "tick_us", _table(path, "t", values.get("t", {})).get("tick_us", 1), 1, 10**6
        ),
        sync_mask=mask,
        sync_value=value,
        off_is_one=_table(path, "p", values.get("p", {})).get("on", 1) == 0,
    )


def _shown(value: object) -> str:
    try:
        return printable(repr(value), 80)
    except ValueError:  # a number of thousands of digits, which TOML allows
        return "a number too long to print"


def _table(path: str | Path, name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise UsageError(f"{path}: {name} = {_shown(value)}: write a table in braces")
    return value


def _field(path: str | Path, name: str, value: Any, size: int) -> Field:
    table = _table(path, name, value)
    shift = _whole(path, f"{name}.shift", table.get("shift"), 0, 8 * size - 1)
    longest = {"p": 1, "t": 48}.get(name, 16)
    bits = _whole(path, f"{name}.bits", table.get("bits", 1 if name == "p" else None), 1, longest)
    if shift + bits > 8 * size:
        raise UsageError(f"{path}: {name} ends after the word: check shift, bits and bytes")
    return Field(shift, bits)


def _whole(path: str | Path, name: str, value: Any, low: int, high: int) -> int:
    if type(value) is not int or not low <= value <= high:
        raise UsageError(
            f"{path}: {name} = {_shown(value)}: expected a whole number {low} to {high}"
        )
    return value


def _layout(options: OptionReader) -> Layout:
    name = options.text("layout") or "aer4"
    return LAYOUTS[name] if name in LAYOUTS else read_layout(name)


def open_decoder(name: str, sensor: Sensor, options: OptionReader) -> Decoder:
    """Make a decoder of a layout."""
    return LayoutDecoder("this layout", _layout(options), sensor)


def open_encoder(name: str, sensor: Sensor, options: OptionReader) -> Encoder:
    """Make an encoder of a layout."""
    return LayoutEncoder("this layout", _layout(options), sensor)
