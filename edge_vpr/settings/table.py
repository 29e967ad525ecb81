"""Meaning, range and accepted words of every setting.

The flags, the TOML files and docs/settings.md are all made from this one table. Types and defaults
stand in `Settings`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

from edge_vpr.settings import choices
from edge_vpr.settings.fields import SettingField
from edge_vpr.settings.words import (
    MOST_PRICE,
    are_prices,
    duration_us,
    duration_word,
    prices,
    prices_word,
)
from fixedpoint.limits import MAX_BITS, MAX_FULL_SCALE

#: largest number of windows that a match waits for
MOST_DELAY = 64
_FILTER, _SEQUENCE = ("matching", ("filter",)), ("matching", ("sequence",))
_CODE = ("counter_code", ("linear", "sqrt", "log"))


def _group(title: str, **settings: SettingField) -> dict[str, SettingField]:
    """Return the settings of one group by name."""
    return {name: replace(one, group=title) for name, one in settings.items()}


_PIXELS = _group(
    "pixels",
    pixels=SettingField(kind=int, help="number of selected pixels, J", metavar="J", least=1),
    strategy=SettingField(
        help="how pixels are selected",
        choices=choices.STRATEGIES,
        more="variance: drawn with a probability that grows with the variance of their counts (the "
        "paper). seed-code: drawn by the mean of their counts (the code that the authors "
        "released). random: every pixel is equally likely. random-upper: random, from the upper "
        "two thirds of the image. top: the pixels of the highest variance. information: one after "
        "another, each time the pixel that adds most information about the place to the pixels "
        "selected before it.",
    ),
    sigma=SettingField(
        kind=float,
        help="standard deviation of the Gaussian that keeps selected pixels apart, in pixels",
        metavar="PX",
        needs=("strategy", ("variance", "random", "random-upper")),
    ),
    seed=SettingField(kind=int, help="seed of the random numbers that select pixels"),
)
_WINDOWS = _group(
    "windows",
    window=SettingField(
        help="windows of a fixed time, or of a fixed count of events at the selected pixels",
        choices=get_args(choices.WindowKind),
    ),
    tau_us=SettingField(
        kind=int,
        help="length of a fixed-time window, for example 1s or 250ms",
        key="tau",
        metavar="TIME",
        least=1,
        read=duration_us,
        show=duration_word,
        expected="a time such as 1s, 250ms or 500us",
        more="Pixels are always selected by windows of this length, also with --window count, so "
        "that both kinds of window use the same pixels.",
    ),
    events_per_pixel=SettingField(
        kind=float,
        help="a fixed-count window holds R x J events at the selected pixels, rounded; auto: the "
        "average number that the reference drive has in a window of --tau",
        metavar="R",
        words={"auto": None},
        above=0,
        zero_is_none=True,
        more="The released code uses 3. With auto, a window covers about the distance that the "
        "reference drive covered in tau. The map stores the number found.",
        needs=("window", ("count",)),
    ),
    keep_incomplete=SettingField(
        kind=bool, help="keep the last window although the recording ends before it is complete"
    ),
)
_COUNTERS = _group(
    "counters",
    polarity=SettingField(
        kind=bool, help="count ON and OFF events separately, in two counters for each pixel"
    ),
    clip=SettingField(
        help="largest count in a descriptor, larger ones become N; none: no limit",
        kind=int,
        metavar="N",
        words={"none": None},
        least=1,
        most=MAX_FULL_SCALE,
        zero_is_none=True,
        more="The released code uses 10. As in that code, pixels are selected by the clipped "
        "counts too.",
    ),
    counter_code=SettingField(
        help="how a count is turned into a number of few bits, which is compared in its place; "
        "none: counts are compared",
        choices=get_args(choices.CounterCodeName),
        more="See docs/codes.md. The code changes neither which pixels are selected nor where "
        "fixed-count windows end.",
    ),
    counter_bits=SettingField(
        kind=int, help="number of bits of a code", metavar="B", least=1, most=MAX_BITS, needs=_CODE
    ),
    counter_full_scale=SettingField(
        help="count at which the code reaches its largest value; auto: a value that suits the code "
        "and its bits",
        kind=int,
        metavar="N",
        words={"auto": None},
        least=1,
        most=MAX_FULL_SCALE,
        zero_is_none=True,
        needs=_CODE,
    ),
    counter_scaling=SettingField(
        help="range of the codes: the same for all pixels (shared); one for each pixel, taken from "
        "the reference (per-pixel); or logarithms of counts less their mean over the drive "
        "(own-mean)",
        choices=get_args(choices.CounterScaling),
        more="Codes by own-mean hardly change when the light does.",
    ),
)
_MATCHING = _group(
    "matching",
    query_mean=SettingField(
        help="mean that own-mean codes subtract in a query: that of the whole drive (own), or a "
        "running mean, as on a robot (running)",
        choices=get_args(choices.QueryMean),
        more="Only with a recording is the whole drive known: live and online matching always use "
        "the running mean.",
        needs=("counter_scaling", ("own-mean",)),
    ),
    matching=SettingField(
        help="match with the place filter, or by comparing sequences of windows (the paper)",
        choices=get_args(choices.Matching),
        more="See docs/place_filter.md.",
    ),
    filter_steps=SettingField(
        help="place filter: price of moving on by 0, 1, 2 ... places in one window; auto: 1,0,1 "
        "for windows of fixed time, 1,0,0,1 for windows of a fixed count",
        kind=tuple,
        metavar="P,P,...",
        words={"auto": None},
        read=prices,
        show=prices_word,
        valid=lambda values: len(values) > 0 and are_prices(values),
        expected="1 to 16 prices from 0 to 254, for example 1,0,1",
        more="With fixed-count windows, moving on by two places costs nothing too, because such "
        "windows become longer in other light.",
        needs=_FILTER,
    ),
    filter_back=SettingField(
        kind=tuple,
        help="place filter: price of moving back by 1, 2 ... places in one window; none: the route "
        "is never driven backwards",
        metavar="P,P,...",
        words={"none": ()},
        read=prices,
        show=prices_word,
        valid=are_prices,
        expected="0 to 16 prices from 0 to 254, for example 2,4",
        needs=_FILTER,
    ),
    filter_restart=SettingField(
        kind=int,
        help="place filter: price of moving to any other place",
        metavar="P",
        least=1,
        most=MOST_PRICE,
        needs=_FILTER,
    ),
    smooth=SettingField(
        kind=bool,
        help="place filter: match each window of a recording with the windows after it too",
        more="Live and online matching have no later windows, and never smooth.",
        needs=_FILTER,
    ),
    delay=SettingField(
        kind=int,
        help="place filter without smoothing: number of windows after each one that decide with, "
        "so that a match comes N windows late",
        metavar="N",
        most=MOST_DELAY,
        more="For live and online matching, and for recordings with --no-smooth. See "
        "docs/place_filter.md.",
        needs=_FILTER,
    ),
    sequence_length=SettingField(
        kind=int,
        help="number of windows in a sequence, L",
        short="-L",
        metavar="L",
        least=1,
        needs=_SEQUENCE,
    ),
    anchor=SettingField(
        help="window of a sequence that its match is given for: the middle one, or the last (end)",
        choices=get_args(choices.Anchor),
        needs=_SEQUENCE,
    ),
    exclusion=SettingField(
        kind=int,
        help="exclusion zone: the second-best place lies more than R places away from the best",
        metavar="R",
    ),
    score=SettingField(
        help="figure by which matches are accepted or rejected in an evaluation; auto: trust with "
        "the place filter, ratio with sequences",
        words={"auto": None},
        choices=get_args(choices.Score),
        more="distance: of the best place (the paper). ratio: best distance divided by the "
        "second-best. margin: second-best less best. trust: see docs/trust.md.",
    ),
    precision=SettingField(
        help="mark unsure matches as lost, such that a share of P of the others is right, for "
        "example 0.99; none: mark none",
        kind=float,
        metavar="P",
        words={"none": None},
        above=0,
        below=1,
        zero_is_none=True,
        more="How well this holds depends on the table of probabilities, see docs/trust.md.",
    ),
)
_CLEANING = _group(
    "cleaning",
    remove_hot_pixels=SettingField(
        kind=bool,
        help="find hot pixels and leave them out, keep them, or leave out the pixels listed in "
        "FILE (one x, y in each line)",
        key="hot_pixels",
        metavar="find|keep|FILE",
        words={"find": True, "keep": False},
        more="Only the flag takes a file. See section 1 of method.md.",
    ),
    remove_bursts=SettingField(
        kind=bool,
        help="remove or keep the events of bursts, moments in which most pixels fire",
        key="bursts",
        words={"remove": True, "keep": False},
        more="See section 1 of method.md.",
    ),
)
TABLE = _PIXELS | _WINDOWS | _COUNTERS | _MATCHING | _CLEANING
