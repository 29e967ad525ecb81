"""The settings of the main job: types, defaults, and which go together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from edge_vpr.errors import UsageError
from edge_vpr.settings.choices import (
    Anchor,
    CounterCodeName,
    CounterScaling,
    Matching,
    QueryMean,
    Score,
    Strategy,
    WindowKind,
)
from edge_vpr.settings.fields import MOST, attributes_section
from edge_vpr.settings.table import TABLE
from fixedpoint.limits import OWN_MEAN_BITS

if TYPE_CHECKING:
    from fixedpoint.codes import CounterCode
    from fixedpoint.own_mean import OwnMeanCode


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """Everything that decides a map and its matches; saved with both."""

    pixels: int = 150
    strategy: Strategy = "variance"
    sigma: float = 7.0
    seed: int = 0
    window: WindowKind = "time"
    tau_us: int = 1_000_000
    events_per_pixel: float | None = 3.0
    polarity: bool = False
    clip: int | None = None
    counter_code: CounterCodeName = "none"
    counter_bits: int = 3
    counter_full_scale: int | None = None
    counter_scaling: CounterScaling = "shared"
    query_mean: QueryMean = "own"
    remove_hot_pixels: bool = True
    remove_bursts: bool = True
    keep_incomplete: bool = False
    matching: Matching = "sequence"
    filter_steps: tuple[int, ...] | None = None
    filter_back: tuple[int, ...] = ()
    filter_restart: int = 16
    smooth: bool = False
    sequence_length: int = 5
    anchor: Anchor = "middle"
    exclusion: int = 3
    score: Score | None = None
    precision: float | None = None

    def __post_init__(self) -> None:
        for name, field in SETTING_FIELDS.items():
            field.check(getattr(self, name))
        if self.events_per_pixel is not None:
            self._check_events_per_window()
        self._check_code()

    @property
    def events_per_window(self) -> int:
        """N of a fixed-count window.

        Raises
        ------
        UsageError
            If it is to be taken from the reference.
        """
        if self.events_per_pixel is None:
            raise UsageError(
                "the events of a window are taken from the reference (events_per_pixel = auto): "
                "map the reference first, or give a number"
            )
        return round(self.events_per_pixel * self.pixels)

    @property
    def windows_per_match(self) -> int:
        """How many windows are compared at once: L, or 1 for the place filter."""
        return 1 if self.matching == "filter" else self.sequence_length

    @property
    def of_trust(self) -> tuple[object, ...]:
        """What the scale of the trust depends on, so that a table of probabilities holds for it."""
        shared = (self.matching, self.exclusion)
        if self.matching == "sequence":
            return (*shared, self.sequence_length)
        return (
            *shared, self.filter_steps, self.filter_back, self.filter_restart, self.smooth,
        )  # fmt: skip

    @property
    def own_mean_code(self) -> OwnMeanCode | None:
        """The code of all counters, where it is taken against each counter's own mean."""
        if self.counter_code == "none" or self.counter_scaling != "own-mean":
            return None
        from fixedpoint.own_mean import OwnMeanCode  # with NumPy, which help does without

        return OwnMeanCode(self.counter_bits, self.counter_full_scale or 0)

    @property
    def shared_code(self) -> CounterCode | None:
        """The code of all counters; None where a descriptor holds the counts themselves.

        Where each pixel has a full scale or a mean of its own, the kind and the bits still hold.
        """
        from fixedpoint.codes import CounterCode  # with NumPy, which help does without

        if self.counter_code != "none":
            full_scale = self.counter_full_scale or 0
            return CounterCode(self.counter_code, self.counter_bits, full_scale)
        return CounterCode.saturating(self.clip) if self.clip else None

    @property
    def learns_full_scale(self) -> bool:
        """Whether the full scale of each pixel's code is learned from the reference."""
        return self.counter_code != "none" and self.counter_scaling == "per-pixel"

    def _check_events_per_window(self) -> None:
        if self.window == "count" and self.events_per_window > MOST:
            raise UsageError(
                f"settings events_per_pixel = {self.events_per_pixel} and pixels = {self.pixels} "
                f"make windows of more than {MOST} events: ask for fewer"
            )
        if self.events_per_window < 1:
            raise UsageError(
                f"setting events_per_pixel = {self.events_per_pixel} makes windows without events: "
                f"expected at least {1 / self.pixels:g} for {self.pixels} pixels"
            )

    def _check_code(self) -> None:
        if self.clip and self.counter_code != "none":
            raise UsageError(
                f"setting clip = {self.clip} with counter_code = {self.counter_code}: a count "
                "has one code; set clip to none"
            )
        if self.counter_scaling == "per-pixel" and self.counter_full_scale:
            raise UsageError(
                f"setting counter_full_scale = {self.counter_full_scale} with a per-pixel "
                "counter_scaling, which learns each pixel's from the reference: set it to auto"
            )
        if self.counter_scaling == "own-mean" and self.counter_code != "log":
            raise UsageError(
                f"setting counter_scaling = own-mean with counter_code = {self.counter_code}: it "
                "is taken of logarithms; set counter_code to log"
            )
        if self.counter_scaling == "own-mean" and self.counter_bits > OWN_MEAN_BITS:
            raise UsageError(
                f"settings: own-mean code of {self.counter_bits} bits: expected 1 to "
                f"{OWN_MEAN_BITS}"
            )

    @property
    def uncoded(self) -> Settings:
        """The same with counts as they are."""
        return replace(self, clip=None, counter_code="none", counter_scaling="shared")

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "settings") -> Settings:
        """Build from plain values; names that do not exist are an error.

        Raises
        ------
        UsageError
            If a name is unknown or a value out of range; `source` is named.
        """
        return cls().replaced(values, source)

    def replaced(self, values: Mapping[str, Any], source: str) -> Settings:
        """Copy with other values, of a file or of flags; `source` is named where one is wrong.

        Parameters
        ----------
        values : mapping
            See `values_by_name`.
        source : str

        Raises
        ------
        UsageError
            If a name is unknown or a value out of range.
        """
        known = values_by_name(values, source)
        try:
            return replace(self, **known)
        except UsageError as error:
            raise UsageError(f"{source}: {error}") from None


#: what is known of each setting, by its name, in order
SETTING_FIELDS = {
    field.name: TABLE[field.name].named(field.name, field.default) for field in fields(Settings)
}
Settings.__doc__ = f"{Settings.__doc__}\n\n{attributes_section(SETTING_FIELDS)}"


def values_by_name(values: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Read the values of a file or of flags.

    Parameters
    ----------
    values : mapping of str to object
        By the key of a TOML file (``tau``), or the name of the attribute (``tau_us``); values, or
        words for them (``"250ms"``).
    source : str
        Named in errors.

    Returns
    -------
    dict
        Value by the name of the attribute of `Settings`.

    Raises
    ------
    UsageError
        If a name is unknown or given twice, or a word is unknown.
    """
    if not isinstance(values, Mapping):
        raise UsageError(f"{source} is a {type(values).__name__}: expected names and values")
    by_key = {field.key: field for field in SETTING_FIELDS.values()}
    found: dict[str, Any] = {}
    for name, given in values.items():
        field = by_key.get(name) or SETTING_FIELDS.get(name)
        if field is None:
            raise UsageError(
                f"{source} has the unknown setting {name!r}: choose from "
                f"{', '.join(sorted(by_key))}"
            )
        if field.name in found:
            raise UsageError(f"{source} has both {field.key} and {field.name}: give one of them")
        try:
            found[field.name] = field.value_of(given)
        except UsageError as error:
            raise UsageError(f"{source}: {error}") from None
    return found
