"""The design of a device: all its parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from firmware_model.design_files import DesignFile
from firmware_model.design_ranges import (
    MAX_PRICE,
    MAX_STEPS,
    MAX_TABLES,
    AcceptKind,
    DeviceCode,
    Matching,
    WindowKind,
    check_parameters,
)
from firmware_model.errors import DesignError
from fixedpoint.codes import CounterCode
from fixedpoint.errors import FixedPointError
from fixedpoint.own_mean import OwnMeanCode

#: sequence length if 0 is given
LENGTH = 5


@dataclass(frozen=True, kw_only=True)
class Design(DesignFile):
    """All parameters of what a device computes, without the contents of its tables.

    Parameters
    ----------
    width, height : int
        Of the sensor, in pixels.
    pixels : int
        J, selected pixels.
    polarity : bool
        Count ON and OFF events apart: J counters for ON are followed by J for OFF.
    code : {"linear", "sqrt", "log", "own-mean"}
    code_bits : int
        What a count is turned into at its window's end, see `fixedpoint.codes.CounterCode`; or its
        logarithm less the counter's running mean, see `fixedpoint.own_mean.OwnMeanCode`, of at
        most 8 bits.
    full_scales : tuple of int
        Where each of one or more code tables ends, 0 for the code's own choice. Each counter uses
        one of the tables, as `Memories` says; all counters saturate at the largest full scale.
        Own-mean codes have one.
    window : {"time", "count"}
        A window is of `tau_us` microseconds, ``[start, start + tau_us)``, or ends with its
        `window_events`-th event at a selected pixel.
    tau_us, window_events : int
    timestamp_bits : int
        Of the device's clock, in microseconds, which wraps. What is left of a window at some time
        is their difference modulo 2 to this power, read as a signed number.
    places : int
        K.
    matching : {"sequence", "filter"}
        Sequences of L windows, or the place filter (`firmware_model.place_filter`).
    length : int
        L, windows in a sequence; 0 takes 5. The filter has 1.
    steps, back : tuple of int
        Of the filter, the price of a step of 0, 1, 2 ... places in a window, and of -1, -2 ...
    restart : int
        Of the filter, the price of getting to any place.
    keep_distances : bool
        Of the filter, keep the distances of a window in memory; or compute them twice, which takes
        no memory and more time.
    lanes : int
        P, codes that are compared in one cycle.
    exclusion : int
        The second best place is looked for more than so many places from the best.
    accept : {"margin", "ratio"}
        A match is accepted if ``second - best >= margin``; or, by ratio, if ``second > 0`` and
        ``best * ratio[1] <= second * ratio[0]``. It is not if there is no second.
    margin : int
    trust : int
        A match of the filter of less trust is not accepted either, in units of 1/16 of a metric.
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
    code: DeviceCode = "log"
    code_bits: int = 3
    full_scales: tuple[int, ...] = (0,)
    window: WindowKind = "time"
    tau_us: int = 1_000_000
    window_events: int = 450
    timestamp_bits: int = 32
    places: int
    matching: Matching = "sequence"
    length: int = 0
    steps: tuple[int, ...] = (1, 0, 1)
    back: tuple[int, ...] = ()
    restart: int = 16
    keep_distances: bool = False
    lanes: int = 8
    exclusion: int = 3
    accept: AcceptKind = "ratio"
    margin: int = 0
    trust: int = 0
    ratio: tuple[int, int] = (7, 8)
    lookup_depth: int = 0

    def __post_init__(self) -> None:
        check_parameters(self)
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
        if self.code == "own-mean" and len(self.full_scales) != 1:
            raise DesignError(
                f"design: {len(self.full_scales)} full scales of own-mean codes: expected 1"
            )
        try:
            scales = tuple(self._code(scale).full_scale for scale in self.full_scales)
        except FixedPointError as error:
            raise DesignError(f"design: {error}") from error
        # replace 0 by the value it means, so that the file of a design is complete
        object.__setattr__(self, "full_scales", scales)
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

    def _check_matching(self) -> None:
        if self.length == 0:
            object.__setattr__(self, "length", 1 if self.matching == "filter" else LENGTH)
        if self.matching == "filter" and self.length != 1:
            raise DesignError(
                f"design: sequences of {self.length} in a place filter: leave length out"
            )
        if self.matching == "sequence" and self.trust:
            raise DesignError(
                f"design: trust = {self.trust} of sequences: only the place filter has it"
            )
        for name, least in (("steps", 1), ("back", 0)):
            prices = getattr(self, name)
            if not least <= len(prices) <= MAX_STEPS or not all(
                0 <= price <= MAX_PRICE for price in prices
            ):
                raise DesignError(
                    f"design: {name} = {list(prices)}: expected {least} to {MAX_STEPS} prices "
                    f"from 0 to {MAX_PRICE}"
                )

    def _code(self, scale: int) -> CounterCode | OwnMeanCode:
        if self.code == "own-mean":
            return OwnMeanCode(self.code_bits, scale)
        return CounterCode(self.code, self.code_bits, scale)

    # Sizes

    @property
    def filters(self) -> bool:
        """Whether matches are made by the place filter."""
        return self.matching == "filter"

    @property
    def own_mean(self) -> bool:
        """Whether codes are taken against a running mean of each counter."""
        return self.code == "own-mean"

    @property
    def slots(self) -> int:
        """Number of counters, and of codes in a descriptor: J, or 2 J with separate polarities."""
        return self.pixels * (2 if self.polarity else 1)

    @cached_property
    def count_max(self) -> int:
        """Count at which a counter saturates."""
        return max(self.full_scales)

    @cached_property
    def tables(self) -> tuple[tuple[int, ...], ...]:
        """Code of each count for each full scale, in tables of ``count_max + 1`` entries.

        With own-mean codes, the logarithm of each count in units of 1/256 octave.
        """
        counts, found = np.arange(self.count_max + 1), []
        for code in map(self._code, self.full_scales):
            table = code.levels if isinstance(code, OwnMeanCode) else code.encode(counts)
            found.append(tuple(table.tolist()))
        return tuple(found)

    @cached_property
    def code_max(self) -> int:
        """Largest code; the smallest is 0."""
        if self.own_mean:
            return (1 << self.code_bits) - 1
        return max(table[-1] for table in self.tables)

    @property
    def entry_max(self) -> int:
        """Largest entry of a code table: a code, or a logarithm."""
        return self.tables[0][-1] if self.own_mean else self.code_max

    @property
    def words(self) -> int:
        """Memory words of a descriptor, with P codes in each; the last one is filled with zeros."""
        return -(-self.slots // self.lanes)


def _power_of_two(least: int) -> int:
    return 1 << (least - 1).bit_length()
