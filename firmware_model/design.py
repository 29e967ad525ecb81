"""The design of a device: its parameters, their ranges, its file, and its widths."""

from __future__ import annotations

import errno
import json
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args, get_type_hints

from firmware_model.errors import DesignError
from fixedpoint.activity import BANK_COSTS, EVENTS_TOP, GAINS, LOG_TOP, SUMS, WEIGHT_BITS
from fixedpoint.formats import CONTRAST_BITS, MAX_BITS, UnsignedFormat
from fixedpoint.own_mean import FULL_SCALE, MEAN_FRACTION_BITS, ContrastCode

# Largest values of what a device computes, and fraction bits of its numbers.


#: fraction bits of the filter's metrics, evidence and costs
FRACTION_BITS = 2
#: largest metric and largest evidence
METRIC_TOP, EVIDENCE_TOP = (1 << 7) - 1, (1 << 8) - 1
#: fraction bits of the reciprocal of the spread, which is at most 1
RECIPROCAL_FRACTION_BITS = 16
#: largest margin and largest residual that count
MARGIN_TOP = RESIDUAL_TOP = 23
#: fraction bits of the trust, and its largest value
TRUST_FRACTION_BITS = 4
TRUST_TOP = MARGIN_TOP << TRUST_FRACTION_BITS
#: fraction bits of the mean number of events in a window
ACTIVITY_FRACTION_BITS = 8
#: bits of the activity of a place, a number with sign
PLACE_ACTIVITY_BITS = 8
#: largest number that is added to the distance of a place
BIAS_TOP = (1 << 8) - 1
#: level of each count of contrast codes: ``round(256 log2(1 + count))``
LEVELS: tuple[int, ...] = tuple(ContrastCode().levels.tolist())
LEVEL_TOP = LEVELS[-1]


# Ranges of the parameters of a design.


DeviceCode = Literal["counts", "contrast"]
WindowKind = Literal["time", "count"]
Matching = Literal["sequence", "filter"]

#: largest cost of a restart: with its fraction bits, it is below the largest metric
MAX_COST = (METRIC_TOP >> FRACTION_BITS) - 1
#: an event has 15 bits for the row, and one for the polarity, which a device does not look at
MAX_SIDE = 1 << 15
#: accepts sequences of any sum
LARGEST_SUM = (1 << 32) - 1


def _shown(value: object) -> str:
    try:
        return repr(value)[:80]
    except ValueError:  # of thousands of digits, as TOML allows
        return "a number too long to print"


#: a longer file is no design
_MOST_BYTES = 1 << 20
#: sequence length if 0 is given
LENGTH = 5


@dataclass(frozen=True, kw_only=True)
class Design:
    """All parameters of what a device computes, without the contents of its tables.

    A number has its least and its largest value, and each key says what it is.
    """

    width: Annotated[int, 1, MAX_SIDE, "Of the sensor."]
    height: Annotated[int, 1, MAX_SIDE, "Of the sensor."]
    pixels: Annotated[int, 1, 1 << 15, "J, selected pixels."]
    code: Annotated[DeviceCode, "Saturating counts, or contrast codes."] = "counts"
    code_bits: Annotated[int, 1, MAX_BITS, "Of contrast codes at most 8."] = 3
    window: Annotated[WindowKind, "A window ends by time, or by its number of events."] = "time"
    tau_us: Annotated[
        int, 1, 1 << 63, "Length of a window by time in µs, below half the clock's period."
    ] = 1_000_000
    window_events: Annotated[
        int, 1, (1 << 32) - 1, "Events at selected pixels in a window by count."
    ] = 450
    timestamp_bits: Annotated[int, 2, 64, "Of the clock in µs, which wraps."] = 32
    places: Annotated[int, 1, 1 << 24, "K."]
    matching: Annotated[Matching, "Sequences of L windows, or the place filter."] = "sequence"
    length: Annotated[int, 0, 1 << 12, "L; 0 takes 5. The filter has 1."] = 0
    places_per_window: Annotated[int, 1, 2, "Filter: places that start in one window."] = 1
    gains: Annotated[
        int,
        1,
        len(GAINS),
        "Filter: gains of the camera, 1 or 7; 7 need contrast codes and windows by time.",
    ] = 1
    restart: Annotated[int, 0, MAX_COST, "Filter: cost of a jump to any place."] = 16
    lanes: Annotated[int, 1, 1 << 10, "P, codes compared per clock."] = 8
    exclusion: Annotated[
        int, 0, 1 << 15, "The second best place is more than so many places from the best."
    ] = 3
    trust: Annotated[
        int,
        0,
        TRUST_TOP,
        "Filter: least accepted trust, in 1/16 of a unit of the metric, 1/64 of a cost.",
    ] = 0
    largest_sum: Annotated[int, 0, LARGEST_SUM, "Sequences: largest accepted sum."] = LARGEST_SUM
    lookup_depth: Annotated[
        int,
        0,
        1 << 20,
        "Entries of the pixel look-up, a power of two, at least `width` and `pixels`; 0 takes the "
        "smallest that is also at least twice `pixels`.",
    ] = 0

    def __post_init__(self) -> None:
        self._check_each()
        self._check_together()
        if self.lookup_depth == 0:
            least = max(self.width, 2 * self.pixels)
            object.__setattr__(self, "lookup_depth", 1 << (least - 1).bit_length())

    def _check_each(self) -> None:
        """Check type and range of each parameter."""
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
                raise DesignError(f"design: {name} = {_shown(value)}: expected {low} to {high}")
        for name, choices in _CHOICES.items():
            value = getattr(self, name)
            if value not in choices:
                raise DesignError(
                    f"design: {name} = {_shown(value)}: choose from {', '.join(choices)}"
                )

    def _check_together(self) -> None:
        if self.pixels > self.width * self.height:
            raise DesignError(
                f"design: {self.pixels} pixels of a {self.width} x {self.height} sensor: take fewer"
            )
        if self.contrast and self.code_bits > CONTRAST_BITS:
            raise DesignError(
                f"design: code_bits = {self.code_bits} of contrast codes: expected 1 to "
                f"{CONTRAST_BITS}"
            )
        self._check_matching()
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
        depth = self.lookup_depth
        if depth and (depth & (depth - 1) or depth < max(self.width, self.pixels)):
            raise DesignError(
                f"design: lookup_depth = {depth}: expected a power of two, not less than the "
                f"{self.width} columns and {self.pixels} pixels"
            )

    def _check_matching(self) -> None:
        if self.length == 0:
            object.__setattr__(self, "length", 1 if self.matching == "filter" else LENGTH)
        if self.matching == "filter" and self.length != 1:
            raise DesignError(
                f"design: sequences of {self.length} in a place filter: leave length out"
            )
        if self.matching == "filter" and self.largest_sum != LARGEST_SUM:
            raise DesignError(
                f"design: largest_sum = {self.largest_sum} of the place filter: it accepts by trust"
            )
        if self.matching == "sequence" and self.trust:
            raise DesignError(
                f"design: trust = {self.trust} of sequences: only the place filter has it"
            )
        if self.matching == "sequence" and self.places_per_window != 1:
            raise DesignError(
                f"design: places_per_window = {self.places_per_window} of sequences: only the "
                "place filter has places at half windows"
            )
        if self.gains not in (1, len(GAINS)):
            raise DesignError(f"design: gains = {self.gains}: expected 1 or {len(GAINS)}")
        if self.gains > 1 and not (self.filters and self.contrast and self.window == "time"):
            raise DesignError(
                f"design: gains = {self.gains}: they need the place filter, contrast codes and "
                "windows by time"
            )

    # Sizes

    @property
    def filters(self) -> bool:
        """Whether matches are made by the place filter."""
        return self.matching == "filter"

    @property
    def contrast(self) -> bool:
        """Whether codes are contrast codes; else they are counts."""
        return self.code == "contrast"

    @property
    def pauses(self) -> bool:
        """Whether windows with hardly any events are pauses."""
        return self.contrast or self.filters

    @property
    def step_costs(self) -> tuple[tuple[int, ...], ...]:
        """Costs of steps of 0, 1, 2 ... places, a row for each half octave of activity."""
        return BANK_COSTS[self.places_per_window]

    @property
    def steps(self) -> int:
        """Number of steps of 0, 1, 2 ... places that have a cost."""
        return len(self.step_costs[0])

    @property
    def sums(self) -> int:
        """Number of sums of newest windows that have codes: of 1, 2 and 4 windows, or of 1."""
        return len(SUMS) if self.gains > 1 else 1

    @property
    def slots(self) -> int:
        """Number of counters, and of codes in a descriptor: J."""
        return self.pixels

    @property
    def count_max(self) -> int:
        """Count at which a counter saturates."""
        return FULL_SCALE if self.contrast else self.code_max

    @property
    def code_max(self) -> int:
        """Largest code; the smallest is 0."""
        return (1 << self.code_bits) - 1

    @property
    def words(self) -> int:
        """Memory words of a descriptor, with P codes in each; the last one is filled with zeros."""
        return -(-self.slots // self.lanes)

    @property
    def numbers(self) -> dict[str, int]:
        """The parameters that are numbers, by name."""
        return {name: getattr(self, name) for name in _RANGES}

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON and TOML."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "design") -> Self:
        """Build from plain values."""
        names = {field.name for field in fields(cls)}
        unknown = sorted(set(values) - names)
        if unknown:
            raise DesignError(
                f"{source} has the unknown name {unknown[0]!r}: choose from "
                f"{', '.join(sorted(names))}"
            )
        missing = sorted({"width", "height", "pixels", "places"} - set(values))
        if missing:
            raise DesignError(f"{source} lacks {missing[0]}: name it")
        try:
            return cls(**values)
        except DesignError:
            raise
        except Exception as error:  # a value of an unexpected type
            raise DesignError(f"{source} is no design ({error}): check its values") from error

    def to_toml(self) -> str:
        """Write as TOML, which `load` reads."""
        # JSON and TOML write these kinds of values alike
        values = self.to_dict().items()
        return "".join(f"{name} = {json.dumps(value)}\n" for name, value in values)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write as a TOML file."""
        try:
            with Path(path).open("w" if overwrite else "x", encoding="utf-8") as file:
                file.write(self.to_toml())
        except FileExistsError:
            raise DesignError(
                f"design {path} exists: name another, or replace it with overwrite=True"
            ) from None

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a TOML file.

        Raises
        ------
        DesignError
            If it cannot be read, or is no design.
        """
        try:
            values = tomllib.loads(read_file(path, _MOST_BYTES).decode("utf-8-sig"))
        # the parser also raises other errors for deep nesting, long numbers and invalid dates
        except Exception as error:
            reason = getattr(error, "strerror", None) or str(error)[:200]
            raise DesignError(
                f"cannot read a design from {path}: {reason}: name a TOML file"
            ) from error
        return cls.from_dict(values, str(path))


_KEYS = get_type_hints(Design, include_extras=True)
_RANGES = {name: key.__metadata__[:2] for name, key in _KEYS.items() if key.__origin__ is int}
_CHOICES = {name: get_args(key.__origin__) for name, key in _KEYS.items() if name not in _RANGES}


def read_file(path: str | Path, most: int = -1) -> bytes:
    """Read a file, up to `most` bytes of it; a pipe or device, or a link to one, has no end.

    Raises
    ------
    OSError
        If it cannot be read, or is no file.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is no file", str(path))
    with path.open("rb") as file:
        return file.read(most)


# Widths of all quantities of a device, computed from the largest values that can occur.


def formats_of(design: Design) -> dict[str, UnsignedFormat]:
    """Return the format of every quantity by its name, all unsigned integers.

    Returns
    -------
    dict of str to UnsignedFormat
        ``sum`` is what the search takes: a sequence's sum, or a metric. ``level`` is the logarithm
        of a count. ``place_activity`` holds numbers with sign, as two's complement.
        ``event_log`` and ``level_total`` are without the sign that a difference of them has.
    """
    holding, code = UnsignedFormat.holding, UnsignedFormat(design.code_bits)
    distance = code.sum_of(design.slots)
    total = code.sum_of(design.slots * design.length)
    if design.filters:
        total = holding(METRIC_TOP)
    formats: dict[str, UnsignedFormat] = {} if design.filters else {"sequence": total}
    formats |= {
        "timestamp": UnsignedFormat(design.timestamp_bits),
        "column": holding(design.width - 1),
        "row": holding(design.height - 1),
        "address": holding(design.lookup_depth - 1),
        # one value more than the number of rows marks an entry without an owner
        "owner": holding(design.height),
        "slot": holding(design.slots - 1),
        "count": holding(design.count_max),
        "window_count": holding(design.window_events),
        "code": code,
        "distance": distance,
        "sum": total,
        "place": holding(design.places - 1),
    }
    if design.pauses:
        formats |= {
            "window_events": holding(EVENTS_TOP),
            "activity": holding(EVENTS_TOP << ACTIVITY_FRACTION_BITS),
            "event_log": holding(LOG_TOP),
        }
    if design.contrast:
        formats |= {
            "limit": holding(design.count_max),
            "level": holding(LEVEL_TOP),
            "mean": holding(LEVEL_TOP << MEAN_FRACTION_BITS),
            "level_total": holding(LEVEL_TOP * design.slots),
        }
    if design.filters:
        biased = holding(distance.highest + BIAS_TOP)
        highest_cost = max(*map(max, design.step_costs), design.restart << FRACTION_BITS)
        formats |= {
            "place_activity": UnsignedFormat(PLACE_ACTIVITY_BITS),
            "place_bias": holding(BIAS_TOP),
            "biased": biased,
            "distance_total": biased.sum_of(design.places),
            "reciprocal": holding(1 << RECIPROCAL_FRACTION_BITS),
            "evidence": holding(EVIDENCE_TOP),
            "weight": holding(1 << WEIGHT_BITS),
            "cost": holding(highest_cost),
            "prediction": holding(METRIC_TOP),
            "metric": holding(METRIC_TOP),
            "trust": holding(TRUST_TOP),
        }
    return formats


def widths_of(design: Design) -> dict[str, int]:
    """Return the number of bits of every quantity by its name."""
    return {name: form.width for name, form in formats_of(design).items()}


def page() -> str:
    """Return the keys of a design's file in Markdown: defaults, ranges, and what each is."""
    lines = ["| key | default | range | |", "| --- | --- | --- | --- |"]
    for key in fields(Design):
        default = "needed" if key.default is MISSING else f"`{json.dumps(key.default)}`"
        if key.name in _RANGES:
            span = "{:,} to {:,}".format(*_RANGES[key.name])
        else:
            span = ", ".join(f'`"{choice}"`' for choice in _CHOICES[key.name])
        lines.append(f"| `{key.name}` | {default} | {span} | {_KEYS[key.name].__metadata__[-1]} |")
    return "\n".join(lines)
