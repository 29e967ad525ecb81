"""What each setting means, its range, and the words it is given in; once for flags, files and docs.

The types and the defaults are those of `Settings`.
"""

from __future__ import annotations

from typing import get_args

from edge_vpr.settings.choices import (
    STRATEGIES,
    Anchor,
    CounterCodeName,
    CounterScaling,
    Matching,
    QueryMean,
    Score,
    WindowKind,
)
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

_FILTER, _SEQUENCE = ("matching", ("filter",)), ("matching", ("sequence",))
_CODE = ("counter_code", ("linear", "sqrt", "log"))

TABLE = {
    "pixels": SettingField(
        kind=int, help="number of selected pixels, J", group="pixels", metavar="J", least=1
    ),
    "strategy": SettingField(
        kind=str,
        help="how pixels are selected",
        group="pixels",
        choices=STRATEGIES,
        more="By the variance of their counts (the paper), by the mean (its released code), at "
        "random, at random without the bottom third, those of the highest variance, or one after "
        "another by what each says of the place beyond those before it.",
    ),
    "sigma": SettingField(
        kind=float,
        help="standard deviation of the Gaussian that keeps selected pixels apart, in pixels",
        group="pixels",
        metavar="PX",
        needs=("strategy", ("variance", "random", "random-upper")),
    ),
    "seed": SettingField(kind=int, help="seed of the draw of pixels", group="pixels"),
    "window": SettingField(
        kind=str,
        help="windows of a fixed time, or of a fixed count of events at the selected pixels",
        group="windows",
        choices=get_args(WindowKind),
    ),
    "tau_us": SettingField(
        kind=int,
        help="length of a fixed-time window: 1s, 250ms",
        group="windows",
        key="tau",
        metavar="TIME",
        least=1,
        read=duration_us,
        show=duration_word,
        expected="a time such as 1s, 250ms or 500us",
        more="Pixels are always selected by windows of this length, so that both kinds of window "
        "can use the same pixels.",
    ),
    "events_per_pixel": SettingField(
        kind=float,
        help="a fixed-count window holds R x J events at the selected pixels, rounded; auto: as "
        "many as a window of tau holds in the reference on average",
        group="windows",
        metavar="R",
        words={"auto": None},
        above=0,
        zero_is_none=True,
        more="The released code has 3. With auto, windows span the distance that the reference "
        "drive covered in tau, and the map keeps the number found.",
        needs=("window", ("count",)),
    ),
    "polarity": SettingField(kind=bool, help="count ON and OFF events apart", group="counters"),
    "clip": SettingField(
        help="largest count in a descriptor; none: no limit",
        group="counters",
        kind=int,
        metavar="N",
        words={"none": None},
        least=1,
        most=MAX_FULL_SCALE,
        zero_is_none=True,
        more="The released code has 10. Pixels are selected by the clipped counts too, as there.",
    ),
    "counter_code": SettingField(
        kind=str,
        help="what is compared in place of a count; none: the count itself",
        group="counters",
        choices=get_args(CounterCodeName),
        more="See docs/codes.md. Pixels are selected by counts, and fixed-count windows count "
        "events.",
    ),
    "counter_bits": SettingField(
        kind=int,
        help="bits of a code",
        group="counters",
        metavar="B",
        least=1,
        most=MAX_BITS,
        needs=_CODE,
    ),
    "counter_full_scale": SettingField(
        help="largest count that the code tells apart; auto: the code's own",
        group="counters",
        kind=int,
        metavar="N",
        words={"auto": None},
        least=1,
        most=MAX_FULL_SCALE,
        zero_is_none=True,
        needs=_CODE,
    ),
    "counter_scaling": SettingField(
        kind=str,
        help="one full scale for all; or one for each pixel, learned from the reference; or the "
        "logarithm less its mean over the drive, which other light does not move",
        group="counters",
        choices=get_args(CounterScaling),
    ),
    "query_mean": SettingField(
        kind=str,
        help="of own-mean codes, a query's mean: over the whole drive, or running, as on the robot",
        group="matching",
        choices=get_args(QueryMean),
        more="The whole drive is known of a recording only.",
        needs=("counter_scaling", ("own-mean",)),
    ),
    "remove_hot_pixels": SettingField(
        kind=bool,
        help="find and leave out hot pixels, keep them, or leave out those listed in FILE (x, y "
        "a line)",
        group="cleaning",
        key="hot_pixels",
        metavar="find|keep|FILE",
        words={"find": True, "keep": False},
        more="Only the flag takes a file. Cleaning of method.md section 1.",
    ),
    "remove_bursts": SettingField(
        kind=bool,
        help="events of moments when most pixels fire",
        group="cleaning",
        key="bursts",
        words={"remove": True, "keep": False},
        more="Cleaning of method.md section 1.",
    ),
    "keep_incomplete": SettingField(
        kind=bool, help="keep the last, incomplete window", group="windows"
    ),
    "matching": SettingField(
        kind=str,
        help="by sequences of windows (the paper), or the place filter",
        group="matching",
        choices=get_args(Matching),
        more="See docs/place_filter.md.",
    ),
    "filter_steps": SettingField(
        help="place filter: price of a step of 0, 1, 2 ... places in a window; auto: 1,0,1 for "
        "windows of fixed time, 1,0,0,1 for a number of events",
        group="matching",
        kind=tuple,
        metavar="P,P,...",
        words={"auto": None},
        read=prices,
        show=prices_word,
        valid=lambda values: len(values) > 0 and are_prices(values),
        expected="1 to 16 prices from 0 to 254, for example 1,0,1",
        more="Other light makes windows of a number of events longer.",
        needs=_FILTER,
    ),
    "filter_back": SettingField(
        kind=tuple,
        help="place filter: price of a step of 1, 2 ... places backwards; none: the route is never "
        "driven backwards",
        group="matching",
        metavar="P,P,...",
        words={"none": ()},
        read=prices,
        show=prices_word,
        valid=are_prices,
        expected="0 to 16 prices from 0 to 254, for example 2,4",
        needs=_FILTER,
    ),
    "filter_restart": SettingField(
        kind=int,
        help="place filter: price of a step to any place",
        group="matching",
        metavar="P",
        least=1,
        most=MOST_PRICE,
        needs=_FILTER,
    ),
    "smooth": SettingField(
        kind=bool,
        help="place filter: let the windows after each one decide with, as a recording allows",
        group="matching",
        more="Online there is no later window, and nothing is smoothed.",
        needs=_FILTER,
    ),
    "sequence_length": SettingField(
        kind=int,
        help="windows in a sequence, L",
        group="matching",
        short="-L",
        metavar="L",
        least=1,
        needs=_SEQUENCE,
    ),
    "anchor": SettingField(
        kind=str,
        help="window that a sequence's match belongs to: middle (offline) or end",
        group="matching",
        choices=get_args(Anchor),
        needs=_SEQUENCE,
    ),
    "exclusion": SettingField(
        kind=int,
        help="second best is over R places from the best",
        group="matching",
        metavar="R",
    ),
    "score": SettingField(
        help="what the threshold of an evaluation is on; auto: the trust of the place filter, the "
        "ratio of sequences",
        group="matching",
        kind=str,
        words={"auto": None},
        choices=get_args(Score),
        more="Best over second-best distance, or second less best; the trust is docs/trust.md's. "
        "The paper has the distance.",
    ),
    "precision": SettingField(
        help="mark matches as lost so that of the others a share of P is right, for example 0.99; "
        "none: mark none",
        group="matching",
        kind=float,
        metavar="P",
        words={"none": None},
        above=0,
        below=1,
        zero_is_none=True,
        more="It is as good as the table of probabilities, see docs/trust.md.",
    ),
}
