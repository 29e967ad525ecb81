"""The text header of Prophesee's RAW and DAT files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from edge_vpr.errors import RecordingError
from edge_vpr.events import Sensor

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

#: Header field in which our writers store ``start_us``; with it, times count from the start.
START_FIELD = "edge_vpr_start_us"


class Header(NamedTuple):
    """Content of the lines that begin with ``%``."""

    fields: dict[str, str]
    n_bytes: int

    @property
    def encoding(self) -> str | None:
        """Name of the format; None if no line states it."""
        if "format" in self.fields:
            return _FORMATS.get(self.fields["format"].split(";")[0].strip().upper())
        if "evt" in self.fields:
            return _VERSIONS.get(self.fields["evt"])
        text = " ".join(self.fields.values())
        return "dat" if "Event2d" in text or self._is_dat() else None

    @property
    def sensor(self) -> Sensor | None:
        """Size of the sensor; None if no line states it."""
        options = self._options
        width = options.get("width") or self.fields.get("Width")
        height = options.get("height") or self.fields.get("Height")
        if width and height and width.isdigit() and height.isdigit():
            return Sensor(int(width), int(height))
        if "geometry" in self.fields:
            return Sensor.parse(self.fields["geometry"])
        plugin = self.fields.get("plugin_name", "") + "_"
        return next((size for name, size in _PLUGINS if re.search(name, plugin)), None)

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

    def _is_dat(self) -> bool:
        return "Version" in self.fields or {"Width", "Height"} <= self.fields.keys()


def parse_header(head: bytes) -> Header:
    """Read the header lines at the beginning of a file.

    Header lines are text and begin with ``%``. The header ends before the first other line, or
    after ``% end``.
    """
    fields: dict[str, str] = {}
    at = 0
    while head[at : at + 2] == b"% ":
        line, newline, _ = head[at:].partition(b"\n")
        # data may begin with the byte of "%", but no header line has such a length or such bytes
        if not newline or not line.rstrip(b"\r").isascii() or b"\0" in line:
            break
        at += len(line) + 1
        key, _, value = line[1:].decode("ascii").strip().partition(" ")
        if key == "end":
            break
        fields[key] = value.strip()
    return Header(fields, at)


def read_header(path: Path) -> Header:
    """Read the header lines of a file."""
    with path.open("rb") as file:
        return parse_header(file.read(1 << 16))


def encoding_of(head: bytes) -> str | None:
    """Return the format of a file that begins with ``%``; None if its header does not state it."""
    header = parse_header(head)
    if header.encoding is None and ("format" in header.fields or "evt" in header.fields):
        named = header.fields.get("format") or header.fields.get("evt")
        raise RecordingError(
            f"Prophesee encoding {named!r} is not read: convert it to EVT2, EVT2.1 or EVT3"
        )
    return header.encoding


def header_lines(encoding: str, sensor: Sensor, start_us: int) -> bytes:
    """Return the header of a file that we write; `encoding` is ``"evt2"`` or ``"dat"``."""
    width, height = sensor
    lines = {
        "evt2": ["evt 2.0", f"format EVT2;height={height};width={width}", f"geometry {sensor}"],
        "dat": ["Data file of CD events", "Version 2", f"Height {height}", f"Width {width}"],
    }[encoding]
    lines.append(f"{START_FIELD} {start_us}")
    if encoding == "evt2":
        lines.append("end")
    return "".join(f"% {line}\n" for line in lines).encode("ascii")
