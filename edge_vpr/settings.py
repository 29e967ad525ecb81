"""Settings of the main job: named presets, and flags over a TOML file over the preset."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args

from edge_vpr.errors import UsageError
from fixedpoint.codes import CounterCode
from fixedpoint.errors import FixedPointError

Strategy = Literal["variance", "seed-code", "random", "random-upper", "top"]
STRATEGIES: tuple[str, ...] = get_args(Strategy)
WindowKind = Literal["time", "count"]
CounterCodeName = Literal["none", "linear", "sqrt", "log"]
CounterScaling = Literal["shared", "per-pixel"]
Anchor = Literal["middle", "end"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """Everything that decides a map and its matches; saved with both.

    Attributes
    ----------
    pixels : int
        J, number of selected pixels.
    strategy : str
        How they are selected, see `select_pixels`.
    sigma : float
        Surround suppression, in pixels.
    seed : int
        Of the draw of pixels.
    window : {"time", "count"}
        Fixed time, or fixed number of events at the selected pixels.
    tau_us : int
        Length of a fixed-time window in microseconds. Pixels are always selected by windows of this
        length, so that both kinds of window can use the same pixels.
    events_per_pixel : float
        A fixed-count window holds N = events_per_pixel * J events, rounded (released code: 3). 0
        takes N from the reference: as many as a window of tau holds there on average, so that
        windows span the distance that the reference drive covered in tau. The map then has the
        number found.
    polarity : bool
        Count ON and OFF events apart.
    clip : int
        Largest count in a descriptor; 0 = no limit (released code: 10). Pixels are selected by the
        clipped counts too, as in the released code.
    counter_code : {"none", "linear", "sqrt", "log"}
        What a descriptor holds in place of each count, see `fixedpoint.codes.CounterCode`; "none"
        is the count itself. Pixels are selected by counts, and fixed-count windows count events.
    counter_bits : int
        Bits of a code, 1 to 16.
    counter_full_scale : int
        Largest count that the code tells apart; 0 takes the code's own.
    counter_scaling : {"shared", "per-pixel"}
        One code for all, or each pixel's with a full scale learned from the reference.
    remove_hot_pixels, remove_bursts : bool
        Cleaning of method.md section 1.
    keep_incomplete : bool
        Keep the last window though it was not completed.
    sequence_length : int
        L, in windows.
    anchor : {"middle", "end"}
        Which window of a sequence a match is attributed to.
    exclusion : int
        The second best match is looked for more than this many places from the best.
    """

    pixels: int = 150
    strategy: Strategy = "variance"
    sigma: float = 7.0
    seed: int = 0
    window: WindowKind = "time"
    tau_us: int = 1_000_000
    events_per_pixel: float = 3.0
    polarity: bool = False
    clip: int = 0
    counter_code: CounterCodeName = "none"
    counter_bits: int = 3
    counter_full_scale: int = 0
    counter_scaling: CounterScaling = "shared"
    remove_hot_pixels: bool = True
    remove_bursts: bool = True
    keep_incomplete: bool = False
    sequence_length: int = 5
    anchor: Anchor = "middle"
    exclusion: int = 3

    def __post_init__(self) -> None:
        for field in fields(self):
            value, kind = getattr(self, field.name), type(field.default)
            integer_for_float = kind is float and type(value) is int
            if type(value) is not kind and not integer_for_float:
                raise UsageError(
                    f"setting {field.name} = {value!r} is of type {type(value).__name__}: "
                    f"expected {kind.__name__}"
                )
        for name, least in _LEAST.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and least <= value <= _MOST):
                raise UsageError(
                    f"setting {name} = {value}: expected {least} or more, up to {_MOST}"
                )
        if self.events_per_pixel > 0 and self.events_per_window < 1:
            raise UsageError(
                f"setting events_per_pixel = {self.events_per_pixel} makes windows without events: "
                f"expected at least {1 / self.pixels:g} for {self.pixels} pixels"
            )
        for name, choices in (
            ("strategy", STRATEGIES),
            ("window", get_args(WindowKind)),
            ("anchor", get_args(Anchor)),
            ("counter_code", get_args(CounterCodeName)),
            ("counter_scaling", get_args(CounterScaling)),
        ):
            if getattr(self, name) not in choices:
                raise UsageError(
                    f"setting {name} = {getattr(self, name)!r}: choose from {', '.join(choices)}"
                )
        self._check_code()

    @property
    def events_per_window(self) -> int:
        """N of a fixed-count window."""
        return round(self.events_per_pixel * self.pixels)

    @property
    def shared_code(self) -> CounterCode | None:
        """The code of all counters; None where a descriptor holds the counts themselves.

        Where each pixel has a full scale of its own, the kind and the bits of the code still hold.
        """
        if self.counter_code != "none":
            return CounterCode(self.counter_code, self.counter_bits, self.counter_full_scale)
        return CounterCode.saturating(self.clip) if self.clip else None

    @property
    def learns_full_scale(self) -> bool:
        """Whether the full scale of each pixel's code is learned from the reference."""
        return self.counter_code != "none" and self.counter_scaling == "per-pixel"

    def _check_code(self) -> None:
        if self.clip and self.counter_code != "none":
            raise UsageError(
                f"setting clip = {self.clip} with counter_code = {self.counter_code}: a count "
                "has one code; set clip to 0"
            )
        if self.counter_scaling == "per-pixel" and self.counter_full_scale:
            raise UsageError(
                f"setting counter_full_scale = {self.counter_full_scale} with a per-pixel "
                "counter_scaling, which learns each pixel's from the reference: set it to 0"
            )
        try:
            _ = self.shared_code
        except FixedPointError as error:
            raise UsageError(f"settings: {error}") from error

    @property
    def uncoded(self) -> Settings:
        """The same with counts as they are."""
        return replace(self, clip=0, counter_code="none")

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON and TOML."""
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
        """Copy with other values; `source` is named where one is wrong.

        Raises
        ------
        UsageError
            If a name is unknown or a value out of range.
        """
        known = {field.name for field in fields(self)}
        for name in values:
            if name not in known:
                raise UsageError(
                    f"{source} has the unknown setting {name!r}: choose from "
                    f"{', '.join(sorted(known))}"
                )
        try:
            return replace(self, **values)
        except UsageError as error:
            raise UsageError(f"{source}: {error}") from None


_MOST = 10**15  # microseconds: 31 years
_LEAST = {
    "pixels": 1,
    "sigma": 0,
    "seed": 0,
    "tau_us": 1,
    "events_per_pixel": 0,
    "clip": 0,
    "counter_bits": 1,
    "counter_full_scale": 0,
    "sequence_length": 1,
    "exclusion": 0,
}

PRESETS: Mapping[str, Settings] = {
    "paper": Settings(),
    # what the released code does: saliency by mean, rejection within 7 px, counts clipped at 10,
    # L = 10, 100 pixels, no cleaning
    "seed-code": Settings(
        pixels=100,
        strategy="seed-code",
        clip=10,
        remove_hot_pixels=False,
        remove_bursts=False,
        sequence_length=10,
        exclusion=2,  # it excludes |k - best| < 3
    ),
    "tiny": Settings(pixels=25, sequence_length=10),
}


def resolve_settings(
    preset: str = "paper",
    config: str | Path | None = None,
    flags: Mapping[str, Any] | None = None,
) -> Settings:
    """Lay flags over a TOML file over a preset.

    Parameters
    ----------
    preset : {"paper", "seed-code", "tiny"}
    config : path, optional
        TOML file with names and values of `Settings`; it may name its own ``preset``.
    flags : mapping, optional
        Values given one by one; None means not given.

    Returns
    -------
    Settings

    Raises
    ------
    UsageError
        If the file cannot be read, or a name or value is wrong.
    """
    values: dict[str, Any] = {}
    if config is not None:
        try:
            values = tomllib.loads(Path(config).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise UsageError(
                f"cannot read settings from {config}: {error}: name a TOML file"
            ) from error
        preset = values.pop("preset", preset)
    if preset not in PRESETS:
        raise UsageError(f"preset {preset!r} is unknown: choose from {', '.join(PRESETS)}")
    given = {name: value for name, value in (flags or {}).items() if value is not None}
    return PRESETS[preset].replaced(values, str(config)).replaced(given, "the command line")
