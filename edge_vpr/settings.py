"""Settings of the main job: named presets, and flags over a TOML file over the preset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args

from edge_vpr.errors import UsageError
from edge_vpr.plain_values import read_toml
from fixedpoint.codes import CounterCode
from fixedpoint.errors import FixedPointError
from fixedpoint.own_mean import OwnMeanCode

Strategy = Literal["variance", "seed-code", "random", "random-upper", "top"]
STRATEGIES: tuple[str, ...] = get_args(Strategy)
WindowKind = Literal["time", "count"]
CounterCodeName = Literal["none", "linear", "sqrt", "log"]
CounterScaling = Literal["shared", "per-pixel", "own-mean"]
QueryMean = Literal["own", "running"]
Matching = Literal["sequence", "filter"]
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
    counter_scaling : {"shared", "per-pixel", "own-mean"}
        One code for all; or each pixel's with a full scale learned from the reference; or the
        logarithm less its mean over the drive, which a change of light does not move
        (`fixedpoint.own_mean`).
    query_mean : {"own", "running"}
        Of own-mean codes, the mean of a query: over the whole drive, which only a recording has;
        or the running mean, as on the robot.
    remove_hot_pixels, remove_bursts : bool
        Cleaning of method.md section 1.
    keep_incomplete : bool
        Keep the last window though it was not completed.
    matching : {"sequence", "filter"}
        Sequences of L windows (the paper), or the place filter (`matching.place_filter`).
    filter_steps : tuple of int, optional
        Price of a step of 0, 1, 2 ... places in a window; None takes (1, 0, 1) for windows of fixed
        time, and (1, 0, 0, 1) for those of a number of events, which other light makes longer.
    filter_back : tuple of int
        Price of a step of -1, -2 ... places; empty: the route is never driven backwards.
    filter_restart : int
        Price of a step to any place.
    sequence_length : int
        L, in windows.
    anchor : {"middle", "end"}
        Which window of a sequence a match is attributed to.
    exclusion : int
        The second best match is looked for more than this many places from the best.
    precision : float
        Wanted share of right ones among the matches that are not marked lost, below 1; 0 marks
        none. It is as good as the table of probabilities, see `confidence`.
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
    query_mean: QueryMean = "own"
    remove_hot_pixels: bool = True
    remove_bursts: bool = True
    keep_incomplete: bool = False
    matching: Matching = "sequence"
    filter_steps: tuple[int, ...] | None = None
    filter_back: tuple[int, ...] = ()
    filter_restart: int = 16
    sequence_length: int = 5
    anchor: Anchor = "middle"
    exclusion: int = 3
    precision: float = 0.0

    def __post_init__(self) -> None:
        for name in ("filter_steps", "filter_back"):
            self._check_prices(name)
        for field in fields(self):
            value, kind = getattr(self, field.name), type(field.default)
            if field.name == "filter_steps":
                continue
            integer_for_float = kind is float and type(value) is int
            if type(value) is not kind and not integer_for_float:
                raise UsageError(
                    f"setting {field.name} = {_shown(value)} is of type {type(value).__name__}: "
                    f"expected {kind.__name__}"
                )
        for name, least in _LEAST.items():
            value = getattr(self, name)
            if not least <= value <= _MOST:  # nor is a value that is not a number
                raise UsageError(
                    f"setting {name} = {_shown(value)}: expected {least} or more, up to {_MOST}"
                )
        if self.precision >= 1:
            raise UsageError(
                f"setting precision = {self.precision}: expected 0 or more, below 1, such as 0.99"
            )
        if self.window == "count" and self.events_per_window > _MOST:
            raise UsageError(
                f"settings events_per_pixel = {self.events_per_pixel} and pixels = {self.pixels} "
                f"make windows of more than {_MOST} events: ask for fewer"
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
            ("query_mean", get_args(QueryMean)),
            ("matching", get_args(Matching)),
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
    def windows_per_match(self) -> int:
        """How many windows are compared at once: L, or 1 for the place filter."""
        return 1 if self.matching == "filter" else self.sequence_length

    @property
    def of_trust(self) -> tuple[object, ...]:
        """What the scale of the trust depends on, so that a table of probabilities holds for it."""
        shared = (self.matching, self.exclusion)
        if self.matching == "sequence":
            return (*shared, self.sequence_length)
        return (*shared, self.filter_steps, self.filter_back, self.filter_restart)

    @property
    def own_mean_code(self) -> OwnMeanCode | None:
        """The code of all counters, where it is taken against each counter's own mean."""
        if self.counter_code == "none" or self.counter_scaling != "own-mean":
            return None
        return OwnMeanCode(self.counter_bits, self.counter_full_scale)

    @property
    def shared_code(self) -> CounterCode | None:
        """The code of all counters; None where a descriptor holds the counts themselves.

        Where each pixel has a full scale or a mean of its own, the kind and the bits still hold.
        """
        if self.counter_code != "none":
            return CounterCode(self.counter_code, self.counter_bits, self.counter_full_scale)
        return CounterCode.saturating(self.clip) if self.clip else None

    @property
    def learns_full_scale(self) -> bool:
        """Whether the full scale of each pixel's code is learned from the reference."""
        return self.counter_code != "none" and self.counter_scaling == "per-pixel"

    def _check_prices(self, name: str) -> None:
        prices = getattr(self, name)
        if isinstance(prices, list):  # as TOML and JSON have them
            prices = tuple(prices)
            object.__setattr__(self, name, prices)
        if prices is None and name == "filter_steps":
            return
        if self.filter_restart > 254:
            raise UsageError(f"setting filter_restart = {self.filter_restart}: expected 1 to 254")
        least = 1 if name == "filter_steps" else 0
        whole = isinstance(prices, tuple) and all(type(p) is int for p in prices)
        if not (whole and least <= len(prices) <= 16 and all(0 <= p <= 254 for p in prices)):
            raise UsageError(
                f"setting {name} = {prices!r}: expected {least} to 16 prices from 0 to 254, for "
                "example [1, 0, 1]"
            )

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
        if self.counter_scaling == "own-mean" and self.counter_code != "log":
            raise UsageError(
                f"setting counter_scaling = own-mean with counter_code = {self.counter_code}: it "
                "is taken of logarithms; set counter_code to log"
            )
        try:
            _ = self.shared_code, self.own_mean_code
        except FixedPointError as error:
            raise UsageError(f"settings: {error}") from error

    @property
    def uncoded(self) -> Settings:
        """The same with counts as they are."""
        return replace(self, clip=0, counter_code="none", counter_scaling="shared")

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
        if not isinstance(values, Mapping):
            raise UsageError(f"{source} is a {type(values).__name__}: expected names and values")
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


def _shown(value: object) -> str:
    """Write a value for a message; Python refuses to write integers of thousands of digits."""
    try:
        return repr(value)
    except (ValueError, RecursionError):
        return f"a {type(value).__name__} too long to be shown"


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
    "filter_restart": 1,
    "sequence_length": 1,
    "exclusion": 0,
    "precision": 0,
}

_BEST = Settings(matching="filter", counter_code="log", counter_scaling="own-mean", anchor="end")

PRESETS: Mapping[str, Settings] = {
    # chosen on the real drives and on simulated streets, see docs/place_filter.md
    "default": _BEST,
    # windows of a fixed time, counts and sequences, as in the paper
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
    "tiny": replace(_BEST, pixels=25),
}


def resolve_settings(
    preset: str = "default",
    config: str | Path | None = None,
    flags: Mapping[str, Any] | None = None,
) -> Settings:
    """Lay flags over a TOML file over a preset.

    Parameters
    ----------
    preset : {"default", "paper", "seed-code", "tiny"}
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
        values = read_toml(config, "settings", "name a TOML file")
        preset = values.pop("preset", preset)
    if not isinstance(preset, str) or preset not in PRESETS:
        raise UsageError(f"preset {_shown(preset)} is unknown: choose from {', '.join(PRESETS)}")
    given = {name: value for name, value in (flags or {}).items() if value is not None}
    for chosen in (values, given):
        # the preset's own-mean codes are of logarithms: another code asked for has no mean
        if chosen.get("counter_code", "log") != "log" or chosen.get("clip"):
            chosen.setdefault("counter_scaling", "shared")
            if chosen.get("clip"):
                chosen.setdefault("counter_code", "none")
    return PRESETS[preset].replaced(values, str(config)).replaced(given, "the command line")
