"""The settings of mapping and matching: types, defaults, and which combinations are allowed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from edge_vpr.errors import UsageError
from edge_vpr.settings import choices
from edge_vpr.settings.fields import MOST, attributes_section
from edge_vpr.settings.table import TABLE
from fixedpoint.limits import OWN_MEAN_BITS

if TYPE_CHECKING:
    from fixedpoint.codes import CounterCode
    from fixedpoint.own_mean import OwnMeanCode


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """All settings that determine a map and its matches; stored with both."""

    pixels: int = 150
    strategy: choices.Strategy = "variance"
    sigma: float = 7.0
    seed: int = 0
    window: choices.WindowKind = "time"
    tau_us: int = 1_000_000
    events_per_pixel: float | None = 3.0
    polarity: bool = False
    clip: int | None = None
    counter_code: choices.CounterCodeName = "none"
    counter_bits: int = 3
    counter_full_scale: int | None = None
    counter_scaling: choices.CounterScaling = "shared"
    query_mean: choices.QueryMean = "own"
    remove_hot_pixels: bool = True
    remove_bursts: bool = True
    keep_incomplete: bool = False
    matching: choices.Matching = "sequence"
    filter_steps: tuple[int, ...] | None = None
    filter_back: tuple[int, ...] = ()
    filter_restart: int = 16
    smooth: bool = False
    delay: int = 0
    sequence_length: int = 5
    anchor: choices.Anchor = "middle"
    exclusion: int = 3
    score: choices.Score | None = None
    precision: float | None = None

    def __post_init__(self) -> None:
        for name, field in SETTING_FIELDS.items():
            field.check(getattr(self, name))
        if self.events_per_pixel is not None:
            self._check_events_per_window()
        self._check_code()

    @property
    def events_per_window(self) -> int:
        """Number of events in a fixed-count window, N.

        Raises
        ------
        UsageError
            If `events_per_pixel` is None: the number is then found when the reference is mapped.
        """
        if self.events_per_pixel is None:
            raise UsageError(
                "events_per_pixel = auto: the number of events in a window is taken from the "
                "reference; map the reference first, or give a number"
            )
        return round(self.events_per_pixel * self.pixels)

    @property
    def windows_per_match(self) -> int:
        """Number of windows that one match compares: L, or 1 with the place filter."""
        return 1 if self.matching == "filter" else self.sequence_length

    @property
    def late(self) -> int:
        """Number of windows by which a match comes late; 0 for a drive that is smoothed whole."""
        return self.delay if self.matching == "filter" and not self.smooth else 0

    @property
    def of_trust(self) -> tuple[object, ...]:
        """Settings that the scale of the trust depends on.

        A table of probabilities holds only for matches with the same values.
        """
        shared = (self.matching, self.exclusion)
        if self.matching == "sequence":
            return (*shared, self.sequence_length)
        return (
            *shared, self.filter_steps, self.filter_back, self.filter_restart, self.smooth,
            self.late,
        )  # fmt: skip

    @property
    def own_mean_code(self) -> OwnMeanCode | None:
        """The own-mean code of the counters; None with other codes."""
        if self.counter_code == "none" or self.counter_scaling != "own-mean":
            return None
        from fixedpoint.own_mean import OwnMeanCode  # imports NumPy, which --help does not need

        return OwnMeanCode(self.counter_bits, self.counter_full_scale or 0)

    @property
    def shared_code(self) -> CounterCode | None:
        """The code of the counters; None if descriptors hold the counts themselves.

        With a scaling of each pixel, only the kind and the bits of this code are used.
        """
        from fixedpoint.codes import CounterCode  # imports NumPy, which --help does not need

        if self.counter_code != "none":
            full_scale = self.counter_full_scale or 0
            return CounterCode(self.counter_code, self.counter_bits, full_scale)
        return CounterCode.saturating(self.clip) if self.clip else None

    @property
    def learns_full_scale(self) -> bool:
        """Whether each pixel has its own full scale, taken from the reference."""
        return self.counter_code != "none" and self.counter_scaling == "per-pixel"

    def _check_events_per_window(self) -> None:
        if self.window == "count" and self.events_per_window > MOST:
            raise UsageError(
                f"settings events_per_pixel = {self.events_per_pixel} and pixels = {self.pixels} "
                f"make windows of more than {MOST} events: choose smaller values"
            )
        if self.events_per_window < 1:
            raise UsageError(
                f"setting events_per_pixel = {self.events_per_pixel} makes windows without events: "
                f"expected at least {1 / self.pixels:g} for {self.pixels} pixels"
            )

    def _check_code(self) -> None:
        if self.clip and self.counter_code != "none":
            raise UsageError(
                f"setting clip = {self.clip} with counter_code = {self.counter_code}: only one of "
                "them can be used; set clip or counter_code to none"
            )
        if self.counter_scaling == "per-pixel" and self.counter_full_scale:
            raise UsageError(
                f"setting counter_full_scale = {self.counter_full_scale} with counter_scaling = "
                "per-pixel, which takes the full scale of each pixel from the reference: set "
                "counter_full_scale to auto"
            )
        if self.counter_scaling == "own-mean" and self.counter_code != "log":
            raise UsageError(
                f"setting counter_scaling = own-mean with counter_code = {self.counter_code}: "
                "own-mean needs logarithms; set counter_code to log"
            )
        if self.counter_scaling == "own-mean" and self.counter_bits > OWN_MEAN_BITS:
            raise UsageError(
                f"setting counter_bits = {self.counter_bits} with counter_scaling = own-mean: "
                f"expected 1 to {OWN_MEAN_BITS} bits"
            )

    @property
    def uncoded(self) -> Settings:
        """The same settings without a counter code: descriptors hold counts."""
        return replace(self, clip=None, counter_code="none", counter_scaling="shared")

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain values, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "settings") -> Settings:
        """Build settings from plain values.

        Raises
        ------
        UsageError
            If a name is unknown or a value out of range; the message names `source`.
        """
        return cls().replaced(values, source)

    def replaced(self, values: Mapping[str, Any], source: str) -> Settings:
        """Return a copy with values of a file or of flags in place of its own.

        Parameters
        ----------
        values : mapping
            See `values_by_name`.
        source : str
            Where the values come from, for error messages.

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


#: the description of each setting, by its name, in order
SETTING_FIELDS = {
    field.name: TABLE[field.name].named(field.name, field.default) for field in fields(Settings)
}
Settings.__doc__ = f"{Settings.__doc__}\n\n{attributes_section(SETTING_FIELDS)}"


def values_by_name(values: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Convert the values of a file or of flags to those of `Settings`.

    Parameters
    ----------
    values : mapping of str to object
        Its keys are those of a TOML file (``tau``) or names of attributes (``tau_us``). Its values
        are those of `Settings`, or texts for them (``"250ms"``).
    source : str
        Where the values come from, for error messages.

    Returns
    -------
    dict
        Values by the name of the attribute of `Settings`.

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
