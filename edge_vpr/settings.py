"""Settings of mapping and matching, and the one description of each for flags, files and docs.

>>> from edge_vpr.settings import resolve_settings
>>> resolve_settings("paper", flags={"tau": "250ms"}).tau_us
250000
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from fractions import Fraction
from pathlib import Path
from textwrap import wrap
from types import UnionType
from typing import (
    TYPE_CHECKING,
    Any,
    Literal,
    NewType,
    TypedDict,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from edge_vpr.errors import UsageError, as_path, did_you_mean, expect
from edge_vpr.records import read_toml
from fixedpoint.formats import CONTRAST_BITS, MAX_BITS, MAX_COUNT

if TYPE_CHECKING:
    from fixedpoint.own_mean import ContrastCode


# Types of the settings that are chosen from a few words.


Strategy = Literal["variance", "seed-code", "random", "random-upper", "top"]
STRATEGIES: tuple[str, ...] = get_args(Strategy)
#: A name that type checkers cannot know: of a part of another package, or with options
#: (``PartName("edvs:format=E3")``). Python itself takes the text alone.
PartName = NewType("PartName", str)
WindowKind = Literal["time", "count"]
CounterCode = Literal["none", "linear", "contrast"]
Matching = Literal["sequence", "filter"]
Score = Literal["distance", "ratio", "margin", "trust"]
Preset = Literal["default", "paper", "seed-code", "tiny"]


# Conversion between values of settings and their text on the command line and in files.


_MICROSECONDS = {"us": 1, "ms": 1_000, "s": 1_000_000}
#: of a restart, in units of evidence; devices have 7 bits for four times as much
MOST_COST = 30


def duration_us(text: str) -> int:
    """Read ``1s``, ``250ms`` or ``500us`` as whole microseconds."""
    form = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*(us|ms|s)\s*", text)
    if form:
        microseconds = Fraction(form[1]) * _MICROSECONDS[form[2]]
        if microseconds.denominator == 1 and microseconds >= 1:
            return int(microseconds)
    raise UsageError(f"duration {text!r}: expected a time such as 1s, 250ms or 500us")


def duration_word(microseconds: int) -> str:
    """Write a duration in the largest unit in which it is a whole number.

    Examples
    --------
    >>> duration_word(1_000_000), duration_word(250_000), duration_word(7)
    ('1s', '250ms', '7us')
    """
    unit = next(unit for unit in ("s", "ms", "us") if microseconds % _MICROSECONDS[unit] == 0)
    return f"{microseconds // _MICROSECONDS[unit]}{unit}"


# The record that describes one setting: default, meaning, unit, range and accepted words.
#
# The flags of the command line, the keys of a TOML file, the checks of `Settings`, its docstring
# and docs/settings.md are all made from these records.


_DESCRIBED = "setting"  # in the metadata of a field
#: largest value of any setting; in microseconds, 31 years
MOST = 10**15


@dataclass(frozen=True, kw_only=True)
class SettingField:
    """Description of one setting.

    Attributes
    ----------
    help : str
        What the setting does, in one line; shown by ``--help``.
    more : str
        Further sentences, shown on the reference page and in the docstring only.
    group : str
        Heading under which ``--help`` shows the flag.
    kind : type
        Type of the value: bool, int, float or str. It comes from the attribute of
        `Settings`, as the name, the default and the choices do.
    name : str
        Attribute of `Settings`.
    key : str
        Key in a TOML file. The flag is the key after ``--``, with dashes.
    short : str, optional
        A flag of one letter.
    metavar : str, optional
        Placeholder of the value in ``--help``.
    default : object
        Value where none is given.
    choices : tuple of str
        All allowed values, for a setting that is chosen from a few words.
    words : mapping of str to object
        Words that stand for values, such as ``none`` for None.
    read, show : callable, optional
        Functions from text to the value and from the value to text. They are for settings that
        files and flags write in another form, such as ``250ms``.
    least, most : float
        Range of a number, both ends included.
    above, below : float, optional
        Bounds of a number, themselves not included.
    valid : callable, optional
        Function that returns whether a value of the right type is allowed.
    expected : str
        Description of the allowed values; if empty, it is made from the range of a number.
    needs : (str, tuple of str), optional
        Name of another setting, and those of its values with which this setting has an effect.
    """

    help: str
    kind: type = str
    group: str = ""
    more: str = ""
    name: str = ""
    key: str = ""
    short: str | None = None
    metavar: str | None = None
    default: Any = None
    choices: tuple[str, ...] = ()
    words: Mapping[str, Any] = field(default_factory=dict)
    read: Callable[[str], Any] | None = None
    show: Callable[[Any], str] | None = None
    least: float = 0
    most: float = MOST
    above: float | None = None
    below: float | None = None
    valid: Callable[[Any], bool] | None = None
    expected: str = ""
    needs: tuple[str, tuple[str, ...]] | None = None

    def of(self, name: str, hint: Any, default: Any) -> SettingField:
        """Return the record of the attribute `name` with its type and its default."""
        # of ``float | None`` the float
        one = get_args(hint)[0] if get_origin(hint) in (Union, UnionType) else hint
        words: tuple[str, ...] = get_args(one) if get_origin(one) is Literal else ()
        kind = str if words else get_origin(one) or one
        return replace(
            self, name=name, key=self.key or name, default=default, kind=kind, choices=words
        )

    @property
    def flag(self) -> str:
        """Flag of the command line, such as ``--events-per-pixel``."""
        return "--" + self.key.replace("_", "-")

    @property
    def meaning(self) -> str:
        """`help` and `more`, as sentences."""
        return f"{self.help[0].upper()}{self.help[1:]}. {self.more}".rstrip()

    @property
    def is_number(self) -> bool:
        """Whether the value is a number."""
        return self.kind in (int, float)

    @property
    def range(self) -> str:
        """Description of the allowed values; empty if not a number and without `expected`."""
        if self.expected or not self.is_number:
            return self.expected
        least = f"{self.least:g} or more" if self.above is None else f"more than {self.above:g}"
        if self.below is not None:
            return f"{least}, below {self.below:g}"
        return least if self.most == MOST else f"{self.least:g} to {self.most:g}"

    @property
    def accepted(self) -> str:
        """Description of what a flag or a file may contain, for error messages."""
        kinds = {int: "a whole number", float: "a number"}
        value = self.expected or kinds.get(self.kind, "")
        return " or ".join([*[value] * bool(value), *self.words])

    def value_of(self, stated: Any) -> Any:
        """Convert what a flag or a file contains to the value of the setting.

        Parameters
        ----------
        stated : object
            A key of `words`, a text that `read` accepts, or the value itself, as in JSON and TOML.
        """
        if getattr(stated, "shape", None) == () and hasattr(stated, "item"):
            return stated.item()  # a number of NumPy, which help does not load
        if not isinstance(stated, str):
            return stated
        if stated in self.words:
            return self.words[stated]
        if self.kind is str:
            return stated
        try:
            if self.read is not None:
                return self.read(stated)
            if self.words and self.is_number:
                return self.value_of(self.kind(stated))
        except (UsageError, ValueError):
            pass
        if not self.words and self.read is None:
            return stated  # of the wrong type: `check` will raise
        raise UsageError(f"setting {self.key} = {shown(stated)}: expected {self.accepted}")

    def word(self, value: Any) -> str:
        """Return a value as the text that a file or the flag takes."""
        for word, meaning in self.words.items():
            if type(meaning) is type(value) and meaning == value:
                return word
        if self.show is not None:
            return self.show(value)
        if isinstance(value, bool):
            return str(value).lower()
        return f"{value:g}" if isinstance(value, float) else str(value)

    def check(self, value: Any) -> None:
        """Check the type and the range of a value."""
        if value is None and None in self.words.values():
            return
        integer_for_float = self.kind is float and type(value) is int
        if type(value) is not self.kind and not integer_for_float:
            raise UsageError(
                f"setting {self.name} = {shown(value)} is of type {type(value).__name__}: "
                f"expected {self.kind.__name__}{f', or {self.accepted}' if self.read else ''}"
            )
        if self.choices and value not in self.choices:
            raise UsageError(
                f"setting {self.name} = {value!r}: choose from {', '.join(self.choices)}"
            )
        if self.is_number and not self._in_range(value):
            too_large = self.range.endswith("more") and value > self.most
            limit = f", up to {self.most:g}" if too_large else ""
            raise UsageError(f"setting {self.name} = {shown(value)}: expected {self.range}{limit}")
        if self.valid is not None and not self.valid(value):
            raise UsageError(f"setting {self.name} = {shown(value)}: expected {self.expected}")

    def _in_range(self, value: float) -> bool:
        """Return whether a number is in the range; NaN never is."""
        above = self.above is None or value > self.above
        below = self.below is None or value < self.below
        return self.least <= value <= self.most and above and below


def attributes_section(fields: Mapping[str, SettingField]) -> str:
    """Return the "Attributes" section of the docstring of a dataclass of settings."""
    lines = ["    Attributes", "    ----------"]
    for name, info in fields.items():
        kind = f"{{{', '.join(map(repr, info.choices))}}}" if info.choices else info.kind.__name__
        optional = ", optional" if None in info.words.values() else ""
        lines.append(f"    {name} : {kind}{optional}")
        lines += wrap(info.meaning, 100, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return "\n".join(lines) + "\n"


def shown(value: object) -> str:
    """Return a value as text for an error message.

    Python raises ValueError for integers of thousands of digits; they are described instead.
    """
    try:
        return repr(value)
    except (ValueError, RecursionError):
        return f"a {type(value).__name__} too long to be shown"


# The settings of mapping and matching: types, defaults, meaning, and allowed combinations.


_FILTER, _SEQUENCE = ("matching", ("filter",)), ("matching", ("sequence",))
_CODE = ("counter_code", ("linear", "contrast"))


def _setting(default: Any, group: str, help: str, **others: Any) -> Any:
    """Return a field of `Settings` with its default and its description, see `SettingField`."""
    described = SettingField(group=group, help=help, **others)
    return field(default=default, metadata={_DESCRIBED: described})


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """All settings that determine a map and its matches; stored with both.

    Values that are not given are those of the paper, as in ``PRESETS["paper"]``; commands and
    `ReferenceMap.build` begin with ``PRESETS["default"]``.

    >>> settings = Settings(pixels=50, window="count")
    >>> settings.events_per_window
    150
    """

    pixels: int = _setting(150, "pixels", "number of selected pixels, J", metavar="J", least=1)
    strategy: Strategy = _setting(
        "variance",
        "pixels",
        "how pixels are selected",
        more="variance: drawn by the variance of their counts (the paper). seed-code: by their "
        "mean (the released code). random: all equally likely. random-upper: the same, in the "
        "upper two thirds of the image. top: the highest variances.",
    )
    sigma: float = _setting(
        7.0,
        "pixels",
        "width (sigma, in pixels) of the Gaussian that keeps selected pixels apart",
        metavar="PX",
        needs=("strategy", ("variance", "random", "random-upper")),
    )
    seed: int = _setting(0, "pixels", "seed of the selection of pixels")
    window: WindowKind = _setting(
        "time",
        "windows",
        "windows of a fixed time, or of a fixed number of events at the selected pixels",
    )
    tau_us: int = _setting(
        1_000_000,
        "windows",
        "length of a fixed-time window, for example 1s or 250ms",
        key="tau",
        metavar="TIME",
        least=1,
        read=duration_us,
        show=duration_word,
        expected="a time such as 1s, 250ms or 500us",
        more="Pixels are always selected by windows of this length.",
    )
    events_per_pixel: float | None = _setting(
        3.0,
        "windows",
        "a fixed-count window holds R x J events, rounded; auto: the average number of the "
        "reference drive in --tau",
        metavar="R",
        words={"auto": None},
        above=0,
        needs=("window", ("count",)),
    )
    places_per_window: int | None = _setting(
        1,
        "windows",
        "places per window length; 2: a place starts at every half window; auto: 2 where the "
        "reference and the other settings allow it",
        metavar="N",
        words={"auto": None},
        least=1,
        most=2,
        more="2 takes twice the memory and work, and needs the place filter and a reference of "
        "events. auto is 1 for windows of a number of events or of an odd number of microseconds, "
        "and for fewer than 20 count frames per window.",
        needs=_FILTER,
    )
    clip: int | None = _setting(
        None,
        "counters",
        "cap counts at N; none: no cap",
        metavar="N",
        words={"none": None},
        least=1,
        most=MAX_COUNT,
        more="Pixels are selected by the clipped counts too.",
    )
    counter_code: CounterCode = _setting(
        "none",
        "counters",
        "how counts are stored in a few bits: saturating (linear), or as logarithms minus the "
        "pixel's mean over the drive and the window's mean (contrast); none: as they are",
        more="Contrast codes hardly change with light or speed.",
    )
    counter_bits: int = _setting(
        3, "counters", "bits per code", metavar="B", least=1, most=MAX_BITS, needs=_CODE
    )
    remove_hot_pixels: bool = _setting(
        True,
        "cleaning",
        "find hot pixels and leave them out, keep them, or leave out those listed in FILE "
        "(one x, y per line)",
        key="hot_pixels",
        metavar="find|keep|FILE",
        words={"find": True, "keep": False},
        more="Only the flag takes a file.",
    )
    remove_bursts: bool = _setting(
        True,
        "cleaning",
        "remove or keep the events of bursts, moments in which most pixels fire",
        key="bursts",
        words={"remove": True, "keep": False},
    )
    matching: Matching = _setting(
        "sequence",
        "matching",
        "match with the place filter, or by sequences of windows (the paper)",
    )
    filter_restart: int = _setting(
        16,
        "matching",
        "place filter: cost of moving to any other place",
        metavar="C",
        least=1,
        most=MOST_COST,
        needs=_FILTER,
    )
    gains: int = _setting(
        7,
        "matching",
        "place filter: number of gains of the camera that it follows side by side, 1 or 7",
        metavar="N",
        valid=lambda number: number in (1, 7),
        expected="1 or 7",
        more="With 7, the filter can tell another speed from another light or camera. Codes other "
        "than contrast, and windows by count, have 1.",
        needs=_FILTER,
    )
    smooth: bool = _setting(
        False,
        "matching",
        "place filter: use the later windows of a recording too",
        more="Live and online matching never smooth.",
        needs=_FILTER,
    )
    sequence_length: int = _setting(
        5,
        "matching",
        "windows in a sequence, L",
        short="-L",
        metavar="L",
        least=1,
        needs=_SEQUENCE,
    )
    exclusion: int = _setting(
        3,
        "matching",
        "exclusion zone: the second-best place lies more than R places away from the best",
        metavar="R",
        more="With two places per window, R counts windows.",
    )
    precision: float | None = _setting(
        None,
        "matching",
        "mark the less certain matches as lost, so that a share P of the others, such as 0.99, "
        "is expected to be right, within the exclusion zone; none: mark none",
        metavar="P",
        words={"none": None},
        above=0,
        below=1,
        more="Where this holds: docs/method.md.",
    )
    stays_on_map: bool = _setting(
        False,
        "matching",
        "place filter without smoothing: accept more matches, for a robot that "
        "never leaves the route",
        more="Off the map, probabilities are too high: see docs/method.md.",
        needs=_FILTER,
    )

    def __post_init__(self) -> None:
        for name, setting in SETTING_FIELDS.items():
            setting.check(getattr(self, name))
        if self.events_per_pixel is not None:
            events = self.events_per_window
            if self.window == "count" and events > MOST:
                raise UsageError(
                    f"settings events_per_pixel = {self.events_per_pixel} and pixels = "
                    f"{self.pixels} make windows of more than {MOST} events: choose smaller values"
                )
            if events < 1:
                raise UsageError(
                    f"setting events_per_pixel = {self.events_per_pixel} makes windows without "
                    f"events: expected at least {1 / self.pixels:g} for {self.pixels} pixels"
                )
        if self.window_parts > 1 and self.matching != "filter":
            raise UsageError(
                f"setting places_per_window = {self.places_per_window} with matching = "
                f"{self.matching}: sequences compare one place per window; set matching to filter, "
                "or map the reference with places_per_window = 1"
            )
        if self.clip and self.counter_code != "none":
            raise UsageError(
                f"setting clip = {self.clip} with counter_code = {self.counter_code}: only one of "
                "them can be used; set clip or counter_code to none"
            )
        if self.counter_code == "contrast" and self.counter_bits > CONTRAST_BITS:
            raise UsageError(
                f"setting counter_bits = {self.counter_bits} with counter_code = contrast: "
                f"expected 1 to {CONTRAST_BITS} bits"
            )

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
    def exclusion_places(self) -> int:
        """Number of places on each side of the best one in its exclusion zone."""
        return self.exclusion * self.window_parts

    @property
    def window_parts(self) -> int:
        """Parts of a window at which places start, 1 or 2; of a map, its `places_per_window`."""
        return self.places_per_window or 1

    def at_places_of(self, reference: Settings) -> Settings:
        """Return these settings for a map that is made, whose places decide what "auto" is."""
        if self.places_per_window is not None:
            return self
        return replace(self, places_per_window=reference.places_per_window)

    @property
    def hypotheses(self) -> int:
        """Number of gains that the filter follows: with other codes or windows by count, 1."""
        return self.gains if self.profile == "robot" else 1

    @property
    def score(self) -> Score:
        """Score by which an evaluation accepts matches if none is named."""
        if self.matching == "filter":
            return "trust"
        return "ratio" if self.counter_code == "contrast" else "distance"

    @property
    def of_map(self) -> dict[str, Any]:
        """Settings that a map is made with, by name: all but those of matching."""
        return {
            name: getattr(self, name)
            for name, setting in SETTING_FIELDS.items()
            if setting.group != "matching"
        }

    @property
    def profile(self) -> Literal["robot", "paper"] | None:
        """Profile that the settings belong to, if any.

        The two are promised on every implementation, equal to the bit: ``"robot"`` is the place
        filter with contrast codes and windows of fixed time, ``"paper"`` sequences of saturating
        counts with windows of either kind.
        """
        return (
            None if self._beyond_profiles else ("robot" if self.matching == "filter" else "paper")
        )

    @property
    def beyond_profile(self) -> str:
        """What to change for the nearest profile, in one sentence; empty if it is one already."""
        beyond = self._beyond_profiles
        if not beyond:
            return ""
        name, values = (
            ("robot", "the place filter with contrast codes and windows of fixed time")
            if self.matching == "filter"
            else ("paper", "sequences of saturating counts")
        )
        wanted = ", ".join(f"{key} = {value}" for key, value in beyond.items())
        return (
            "live matching and devices take two profiles: make the map with "
            f"{wanted} for {name}, {values}"
        )

    @property
    def _beyond_profiles(self) -> dict[str, str]:
        """Return the settings that keep these from the nearest profile, and their values there."""
        filters, wanted = self.matching == "filter", {}
        if self.clip:
            wanted["clip"] = "none"
        if filters and self.window != "time":
            wanted["window"] = "time"
        if filters != (self.counter_code == "contrast"):
            wanted["counter_code"] = "contrast" if filters else "linear"
        return wanted

    @property
    def of_trust(self) -> tuple[object, ...]:
        """Settings that the scale of the trust depends on.

        A table of probabilities holds only for matches with the same values.
        """
        shared = (self.matching, self.exclusion)
        if self.matching == "sequence":
            return (*shared, self.sequence_length)
        return (*shared, self.filter_restart, self.hypotheses, self.smooth)

    @property
    def contrast_code(self) -> ContrastCode | None:
        """The contrast code of the counters; None if descriptors hold counts."""
        if self.counter_code != "contrast":
            return None
        from fixedpoint.own_mean import ContrastCode

        return ContrastCode(self.counter_bits)

    @property
    def most_counted(self) -> int | None:
        """Count at which counters saturate; None if they do not, or hold contrast codes."""
        return (1 << self.counter_bits) - 1 if self.counter_code == "linear" else self.clip

    @property
    def uncoded(self) -> Settings:
        """The same settings without a counter code: descriptors hold counts."""
        return replace(self, clip=None, counter_code="none")

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain values, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "settings") -> Settings:
        """Build settings from plain values."""
        return cls().replaced(values, source)

    def replaced(self, values: Mapping[str, Any], source: str) -> Settings:
        """Return a copy with values of a file or of flags in place of its own.

        Parameters
        ----------
        values : mapping
            See `values_by_name`.
        source : str
            Where the values come from, for error messages.
        """
        by_name = values_by_name(values, source)
        try:
            return replace(self, **by_name)
        except UsageError as error:
            raise UsageError(f"{source}: {error}") from None


class MatchingChanges(TypedDict, total=False):
    """Settings of matching as keywords, for type checkers: names and types of `Settings`.

    Words of the command line, such as ``auto``, are taken too. A function of yours that passes
    settings on takes ``**changes: Unpack[MatchingChanges]``.
    """

    matching: Matching
    filter_restart: int
    gains: int
    smooth: bool
    sequence_length: int
    exclusion: int
    precision: float | Literal["none"] | None
    stays_on_map: bool


class SettingChanges(MatchingChanges, total=False):
    """All settings as keywords; three have a shorter name too, which is that of their flag."""

    pixels: int
    strategy: Strategy
    sigma: float
    seed: int
    window: WindowKind
    tau_us: int | str
    tau: str
    events_per_pixel: float | Literal["auto"] | None
    places_per_window: int | Literal["auto"] | None
    clip: int | Literal["none"] | None
    counter_code: CounterCode
    counter_bits: int
    remove_hot_pixels: bool | Literal["find", "keep"]
    hot_pixels: bool | Literal["find", "keep"]
    remove_bursts: bool | Literal["remove", "keep"]
    bursts: bool | Literal["remove", "keep"]


_HINTS = get_type_hints(Settings)
#: the description of each setting, by its name, in order
SETTING_FIELDS = {
    field.name: field.metadata[_DESCRIBED].of(field.name, _HINTS[field.name], field.default)
    for field in fields(Settings)
}
Settings.__doc__ = f"{Settings.__doc__}\n\n{attributes_section(SETTING_FIELDS)}"


def setting_words(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the values of `Settings.to_dict` by the keys, and in the words, of files and flags.

    Examples
    --------
    >>> setting_words({"tau_us": 250_000, "remove_bursts": False})
    {'tau': '250ms', 'bursts': 'keep'}
    """
    return {
        field.key: field.word(values[name])
        for name, field in SETTING_FIELDS.items()
        if name in values
    }


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
    """
    if not isinstance(values, Mapping):
        raise UsageError(f"{source} is a {type(values).__name__}: expected names and values")
    by_key = {field.key: field for field in SETTING_FIELDS.values()}
    by_name: dict[str, Any] = {}
    for name, stated in values.items():
        field = by_key.get(name) or SETTING_FIELDS.get(name)
        if field is None:
            nearest = did_you_mean(str(name), [*by_key, *SETTING_FIELDS])
            raise UsageError(
                f"{source} has the unknown setting {name!r}"
                f"{nearest or ': choose from ' + ', '.join(sorted(by_key))}"
            )
        if field.name in by_name:
            raise UsageError(f"{source} has both {field.key} and {field.name}: give one of them")
        if field.name == f"{name}_us" and type(stated) in (int, float):
            raise UsageError(
                f"{source}: setting {name} = {shown(stated)} has no unit: write for example "
                f"{name} = '250ms', or give {field.name}"
            )
        try:
            by_name[field.name] = field.value_of(stated)
        except UsageError as error:
            raise UsageError(f"{source}: {error}") from None
    return by_name


# Named presets, and the settings that result from a preset, a TOML file and flags.


_BEST = Settings(places_per_window=None, matching="filter", smooth=True, counter_code="contrast")

PRESETS: Mapping[Preset, Settings] = {
    # chosen on the real drives and on simulated streets, see docs/method.md
    "default": _BEST,
    # windows of a fixed time, counts and sequences, as in the paper
    "paper": Settings(),
    # the settings of the code that the authors released: saliency by mean, no two pixels within
    # 7 px, counts clipped at 10, L = 10, 100 pixels, no cleaning
    "seed-code": Settings(
        pixels=100,
        strategy="seed-code",
        clip=10,
        remove_hot_pixels=False,
        remove_bursts=False,
        sequence_length=10,
        exclusion=2,  # the released code excludes |k - best| < 3
    ),
    "tiny": replace(_BEST, pixels=25),
}


def resolve_settings(
    preset: Preset = "default",
    config: str | Path | None = None,
    flags: Mapping[str, Any] | None = None,
    source: str = "flags",
) -> Settings:
    """Combine a preset, a TOML file and flags; a flag overrides the file, the file the preset.

    Parameters
    ----------
    preset : {"default", "paper", "seed-code", "tiny"}
        Values of all settings that neither the file nor a flag gives.
    config : path, optional
        TOML file with settings as `values_by_name` reads them. It may have a key ``preset``, which
        overrides the parameter.
    flags : mapping, optional
        Single settings by the keys of the file; None means not given.
    source : str
        Where `flags` come from, for error messages.

    Raises
    ------
    UsageError
        If the file cannot be read, or a name or value is wrong.
    """
    expect(flags or {}, Mapping, "flags", "single settings by name, as {'pixels': 50}")
    values: dict[str, Any] = {}
    if config is not None:
        config = as_path(config, "settings")
        values = read_toml(config, "settings", "name a TOML file")
        preset = values.pop("preset", preset)
    if not isinstance(preset, str) or preset not in PRESETS:
        raise UsageError(f"preset {shown(preset)} is unknown: choose from {', '.join(PRESETS)}")
    values = values_by_name(values, str(config))
    of_flags = {name: value for name, value in (flags or {}).items() if value is not None}
    of_flags = values_by_name(of_flags, source)
    for chosen in (values, of_flags):
        if chosen.get("clip"):  # in place of the code that a preset has
            chosen.setdefault("counter_code", "none")
    return PRESETS[preset].replaced(values, str(config)).replaced(of_flags, source)
