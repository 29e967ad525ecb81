"""One frozen design: the parameters of a device, and the width of everything in it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from firmware_model.errors import DesignError
from fixedpoint.codes import CodeKind, CounterCode
from fixedpoint.errors import FixedPointError
from fixedpoint.formats import FixedFormat
from fixedpoint.ops import sum_format

WindowKind = Literal["time", "count"]
AcceptKind = Literal["margin", "ratio"]

#: code tables of one design
MAX_TABLES = 16
#: rows are told by 15 bits in an event, beside its polarity
MAX_SIDE = 1 << 15


@dataclass(frozen=True, kw_only=True)
class Design:
    """Everything that decides what a device computes, but for the contents of its tables.

    Parameters
    ----------
    width, height : int
        Of the sensor, in pixels.
    pixels : int
        J, selected pixels.
    polarity : bool
        Count ON and OFF events apart: J counters for ON are followed by J for OFF.
    code : {"linear", "sqrt", "log"}
    code_bits : int
        What a count is turned into at its window's end, see `fixedpoint.codes.CounterCode`.
    full_scales : tuple of int
        Where each of one or more code tables ends, 0 for the code's own choice. Each counter uses
        one of the tables, as `Memories` says; all counters saturate at the largest full scale.
    window : {"time", "count"}
        A window is of `tau_us` microseconds, ``[start, start + tau_us)``, or ends with its
        `window_events`-th event at a selected pixel.
    tau_us, window_events : int
    timestamp_bits : int
        Of the device's clock, in microseconds, which wraps. What is left
        of a window at some time is their difference modulo 2 to this power, read as a signed
        number.
    places : int
        K.
    length : int
        L, windows in a sequence.
    lanes : int
        P, codes that are compared in one cycle.
    exclusion : int
        The second best place is looked for more than so many places from the best.
    accept : {"margin", "ratio"}
        A match is accepted if ``second - best >= margin``; or, by ratio, if ``second > 0`` and
        ``best * ratio[1] <= second * ratio[0]``. It is not if there is no second.
    margin : int
    ratio : tuple of int
        Numerator and denominator, in lowest terms or not, below 1.
    lookup_depth : int
        Entries of the pixel look-up, a power of two and not less than `width`; 0 takes the smallest
        that is also at least twice `pixels`.

    Raises
    ------
    DesignError
        If a parameter is out of its range.
    """

    width: int
    height: int
    pixels: int
    polarity: bool = False
    code: CodeKind = "log"
    code_bits: int = 3
    full_scales: tuple[int, ...] = (0,)
    window: WindowKind = "time"
    tau_us: int = 1_000_000
    window_events: int = 450
    timestamp_bits: int = 32
    places: int
    length: int = 5
    lanes: int = 8
    exclusion: int = 3
    accept: AcceptKind = "ratio"
    margin: int = 0
    ratio: tuple[int, int] = (7, 8)
    lookup_depth: int = 0

    def __post_init__(self) -> None:
        for name in ("full_scales", "ratio"):
            object.__setattr__(self, name, tuple(int(part) for part in getattr(self, name)))
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
                raise DesignError(f"design: {name} = {value!r}: expected {low} to {high}")
        for name, choices in (("window", WindowKind), ("accept", AcceptKind)):
            if getattr(self, name) not in get_args(choices):
                raise DesignError(
                    f"design: {name} = {getattr(self, name)!r}: choose from "
                    f"{', '.join(get_args(choices))}"
                )
        self._check_together()
        if self.lookup_depth == 0:
            object.__setattr__(
                self, "lookup_depth", _power_of_two(max(self.width, 2 * self.pixels))
            )

    def _check_together(self) -> None:
        if self.pixels > self.width * self.height:
            raise DesignError(
                f"design: {self.pixels} pixels of a {self.width} x {self.height} sensor: take fewer"
            )
        if not 1 <= len(self.full_scales) <= MAX_TABLES:
            raise DesignError(
                f"design: {len(self.full_scales)} full scales: expected 1 to {MAX_TABLES}"
            )
        try:
            codes = tuple(CounterCode(self.code, self.code_bits, f) for f in self.full_scales)
        except FixedPointError as error:
            raise DesignError(f"design: {error}") from error
        # what 0 stood for, so that the file of a design says all
        object.__setattr__(self, "full_scales", tuple(code.full_scale for code in codes))
        if self.tau_us >= 1 << (self.timestamp_bits - 1):
            raise DesignError(
                f"design: windows of {self.tau_us} us, and a clock of {self.timestamp_bits} bits: "
                "expected less than half of the time after which it wraps"
            )
        if self.length > self.places:
            raise DesignError(
                f"design: sequences of {self.length} places in a map of {self.places}: take a "
                "shorter sequence or a longer map"
            )
        if len(self.ratio) != 2 or not 0 < self.ratio[0] < self.ratio[1] < 1 << 16:
            raise DesignError(
                f"design: ratio = {list(self.ratio)}: expected a numerator and a larger "
                "denominator of at most 16 bits"
            )
        depth = self.lookup_depth
        if depth and (depth & (depth - 1) or depth < max(self.width, self.pixels)):
            raise DesignError(
                f"design: lookup_depth = {depth}: expected a power of two, not less than the "
                f"{self.width} columns and {self.pixels} pixels"
            )

    # Sizes

    @property
    def slots(self) -> int:
        """Counters, and codes of a descriptor: J, or 2 J with polarities apart."""
        return self.pixels * (2 if self.polarity else 1)

    @property
    def count_max(self) -> int:
        """Where a counter saturates."""
        return max(self.full_scales)

    @cached_property
    def tables(self) -> tuple[tuple[int, ...], ...]:
        """Code of each count, for each full scale; all of them of ``count_max + 1`` entries."""
        codes = [CounterCode(self.code, self.code_bits, scale) for scale in self.full_scales]
        counts = np.arange(self.count_max + 1)
        return tuple(tuple(code.encode(counts).tolist()) for code in codes)

    @cached_property
    def code_max(self) -> int:
        """Largest code; the smallest is 0."""
        return max(table[-1] for table in self.tables)

    @property
    def words(self) -> int:
        """Memory words of one descriptor, P codes in each; the last is filled up with zeros."""
        return -(-self.slots // self.lanes)

    # Widths, each from the largest value that can occur

    @property
    def formats(self) -> dict[str, FixedFormat]:
        """Format of every quantity by its name, all unsigned integers."""
        code = FixedFormat(False, self.code_bits)
        distance = sum_format(code, self.slots)
        sequence = sum_format(code, self.slots * self.length)
        return {
            "timestamp": FixedFormat(False, self.timestamp_bits),
            "column": _holding(self.width - 1),
            "row": _holding(self.height - 1),
            "address": _holding(self.lookup_depth - 1),
            # one value more than there are rows marks an entry without an owner
            "owner": _holding(self.height),
            "slot": _holding(self.slots - 1),
            "count": _holding(self.count_max),
            "window_count": _holding(self.window_events),
            "table": _holding(len(self.full_scales) - 1),
            "code": code,
            "distance": distance,
            "sequence": sequence,
            "product": _holding(sequence.highest * self.ratio[1]),
            "place": _holding(self.places - 1),
        }

    # Files

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON and TOML."""
        values = asdict(self)
        return values | {"full_scales": list(self.full_scales), "ratio": list(self.ratio)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "design") -> Design:
        """Build from plain values.

        Raises
        ------
        DesignError
            If a name is unknown or missing, or a value out of range; `source` is named.
        """
        known = {field.name for field in fields(cls)}
        unknown = sorted(set(values) - known)
        if unknown:
            raise DesignError(
                f"{source} has the unknown name {unknown[0]!r}: choose from "
                f"{', '.join(sorted(known))}"
            )
        missing = sorted({"width", "height", "pixels", "places"} - set(values))
        if missing:
            raise DesignError(f"{source} lacks {missing[0]}: name it")
        return cls(**values)

    def to_toml(self) -> str:
        """Write as TOML, which `load` reads."""
        return "".join(f"{name} = {_toml(value)}\n" for name, value in self.to_dict().items())

    def save(self, path: str | Path) -> None:
        """Write as a TOML file."""
        Path(path).write_text(self.to_toml(), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Design:
        """Read a TOML file.

        Raises
        ------
        DesignError
            If it cannot be read, or is no design.
        """
        try:
            values = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise DesignError(f"cannot read a design from {path}: {error}") from error
        return cls.from_dict(values, str(path))


_RANGES = {
    "width": (1, MAX_SIDE),
    "height": (1, MAX_SIDE),
    "pixels": (1, 1 << 15),
    "tau_us": (1, 1 << 63),
    "window_events": (1, (1 << 32) - 1),
    "timestamp_bits": (2, 64),
    "places": (1, 1 << 24),
    "length": (1, 1 << 12),
    "lanes": (1, 1 << 10),
    "exclusion": (0, 1 << 15),
    "margin": (0, (1 << 32) - 1),
    "lookup_depth": (0, 1 << 20),
}


def _power_of_two(least: int) -> int:
    return 1 << (least - 1).bit_length()


def _holding(largest: int) -> FixedFormat:
    """Narrowest unsigned integer that holds 0 to `largest`."""
    return FixedFormat(False, max(1, largest.bit_length()))


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    return repr(value)
