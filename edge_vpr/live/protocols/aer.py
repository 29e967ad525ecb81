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

from pathlib import Path
from typing import Any

from edge_vpr.errors import UsageError, printable
from edge_vpr.events import Sensor
from edge_vpr.files import read_toml
from edge_vpr.live.protocols import Decoder, Encoder, OptionReader
from edge_vpr.live.protocols.words import Field, Layout, LayoutDecoder, LayoutEncoder

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
    values = read_toml(path, "a layout", "name a TOML file as docs/serial.md shows it")
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
