"""The suites ``filter`` and ``own``: random cases until every fact was seen.

Each kind of case draws maps and drives from its own ranges, and for ``filter`` also designs; those
of ``own`` have the design itself, also of sequences. A case is kept if it shows a fact of
`vectors.facts` that none before it has shown.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain, cycle, groupby
from typing import Any

import numpy as np

from firmware_model.design import ACTIVITY_FRACTION_BITS, LARGEST_SUM, LEVEL_TOP, LEVELS, Design
from firmware_model.errors import VectorError
from firmware_model.memories import Codes, Memories
from firmware_model.specification import (
    Event,
    Machine,
    gains_of,
    ilog,
    mean_activity_after,
)
from firmware_model.specification_drive import bias_of
from firmware_model.vectors.case import Case, Stream
from firmware_model.vectors.corners import moved_by
from firmware_model.vectors.coverage import coverage
from firmware_model.vectors.facts import (
    BITS,
    CONTRAST,
    LOGARITHMS,
    OF_COUNTERS,
    OF_MEANS,
    OF_SEQUENCES,
    OF_THE_CLOCK,
    apart,
    facts_for,
    own_facts,
)
from fixedpoint.activity import BANK_COSTS, EVENTS_TOP, GAINS, PARTS, PAUSE_SHIFT
from fixedpoint.own_mean import FIRST_SHIFT, LAST_SHIFT

#: pixels of which a design must have so many to show every fact
ENOUGH_PIXELS = 8
#: cases that are drawn of each kind before a fact is given up, and of fewer pixels
MOST_DRAWS, FEW_DRAWS = 400, 40
#: the same of a design that does not vary, and of kinds of many windows
OWN_DRAWS, FEWER_OWN_DRAWS = 30, {"drive": 6, "sums": 12, "speeds": 6, "long": 2, "bursts": 2}

#: makes a variant of a design: `replace`, or `_as_it_is`
Vary = Callable[..., Design]
#: name, design, how it varies, random numbers, and how many of its kind were drawn before
Draw = Callable[[str, Design, Vary, np.random.Generator, int], Case]


def filter_cases(design: Design, seed: int = 0) -> list[Case]:
    """Make the cases of the suite ``filter``.

    Parameters
    ----------
    design : Design
        With the place filter or contrast codes; cases change it to have the filter, and one place
        per window or two.

    Raises
    ------
    VectorError
        If no case shows a fact, of a design of enough pixels.
    """
    design = replace(
        design, matching="filter", length=1, places=12, places_per_window=1, trust=0,
        largest_sum=LARGEST_SUM, code="contrast", code_bits=min(design.code_bits, 8),
    )  # fmt: skip
    if design.window == "time" and design.tau_us < 4:
        design = replace(design, tau_us=4, timestamp_bits=max(design.timestamp_bits, 8))
    wanted, enough = facts_for(design), design.pixels >= ENOUGH_PIXELS
    rng = np.random.default_rng((seed, 64))
    cases = _until_seen(design, replace, _KINDS, wanted, MOST_DRAWS if enough else FEW_DRAWS, rng)
    if wanted and enough:
        raise VectorError(
            f"no case of {MOST_DRAWS} of each kind shows these facts: {', '.join(sorted(wanted))}"
        )
    return cases


def own_cases(design: Design, seed: int = 0) -> list[Case]:
    """Make the cases of the suite ``own``, for a core that has no other design."""
    rng = np.random.default_rng((seed, 65))
    kinds = {kind: _at_any_time(_KINDS[kind]) for kind in _kinds_of(design)}
    return _until_seen(design, _as_it_is, kinds, own_facts(design), OWN_DRAWS, rng, FEWER_OWN_DRAWS)


def _kinds_of(design: Design) -> list[str]:
    """Return the kinds of cases that a design has, if it does not vary."""
    by_count = ["drive", "near", "runs", "clear", "far", "full", "times"]
    by_time = [*by_count, "half", "numbered", "long", "pauses", "loud", "halves"]
    if design.window == "count":
        return by_count
    if design.filters:
        roomy = min(design.places, design.slots) > 8
        return [kind for kind in _KINDS if roomy or kind not in _ROOMY_KINDS]
    return by_time if design.contrast else by_time[:-4]


def _at_any_time(draw: Draw) -> Draw:
    """Let cases start at any time, half of them soon before the clock wraps, as their events do."""

    def drawn_later(
        name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int
    ) -> Case:
        case, period = draw(name, design, vary, rng, drawn), 1 << design.timestamp_bits
        tau, start = design.tau_us, int(rng.integers(min(period, 1 << 62)))
        if rng.random() < 0.5:
            start = -(start % (8 * tau)) % period
        events: list[Event] = []
        for opens, alike in groupby(case.events, key=lambda event: event.t):
            of_window = list(alike)
            after = rng.integers(0, min(tau, 1 << 62), len(of_window))
            kind = rng.random(len(of_window))
            after[kind < 0.2], after[kind > 0.8] = 0, tau - 1
            if draw in (_times, _half):
                after[:] = 0
            events += (
                event._replace(t=(start + opens + at) % period)
                for event, at in zip(of_window, sorted(after.tolist()), strict=True)
            )
        return replace(case, events=tuple(events), start=start)

    return drawn_later


def _as_it_is(design: Design, **values: Any) -> Design:
    """Return the design of a core that has no other values."""
    return design


def _until_seen(
    design: Design,
    vary: Vary,
    kinds: Mapping[str, Draw],
    missing: set[str],
    most: int,
    rng: np.random.Generator,
    fewer: Mapping[str, int] = {},
) -> list[Case]:
    """Draw cases until no fact is missing, or so many of each kind; remove the facts they show."""
    chosen: list[Case] = []
    for number, (kind, draw) in enumerate(cycle(kinds.items())):
        if not missing or number == most * len(kinds):
            break
        if not missing & _AIMED.get(kind, missing):
            continue
        drawn = number // len(kinds)
        if drawn >= fewer.get(kind, most):
            continue
        if kind == "logarithm":  # the next one that is missing
            left = [at for at, name in enumerate(LOGARITHMS) if name in missing]
            drawn = left[drawn % len(left)]
        name = f"{kind}_{number // len(kinds)}"
        case = draw(name, _variant(design, vary, rng), vary, rng, drawn)
        seen = {name for name, times in coverage(case, missing).items() if times}
        if missing & seen:
            chosen.append(case)
            missing -= seen
    return chosen


def _variant(design: Design, vary: Vary, rng: np.random.Generator) -> Design:
    """Draw what a device may have otherwise, of the same kind of codes or with counts."""
    by_time = design.gains > 1 or rng.random() < 0.5
    if design.gains == 1 and rng.random() < 0.3:
        design = vary(design, code="counts")
    if rng.random() < 0.2:  # of so few that codes are beyond both ends
        design = vary(design, code_bits=min(design.code_bits, 3))
    return vary(
        design,
        window="time" if by_time else design.window,
        tau_us=max(design.tau_us, 4),
        places_per_window=int(rng.integers(1, 3)),
        restart=int(rng.choice([0, 2, 6, 16, 16, 30])),
        exclusion=int(rng.choice([0, 1, 1, 2, 3, 11])),
    )


# Drives through a map.


def _drive(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw a drive through a map of few places."""
    places = int(rng.choice([1, 2, 3, 4, 5, 6, 7, 8, 9, 12, 12, 16, 24]))
    design = vary(design, places=places)
    windows = 60 if design.places > 24 else int(rng.integers(10, 26))
    windows += design.length - 1
    rates = _rates(design, rng)
    places = design.places
    shown = [_counts(rates[k], 1.0, rng) for k in range(places)]
    for counts in shown:
        counts[-1] += not any(counts)  # windows by count have some
    design = _long_enough(design, shown, vary)
    stream, reference = Stream(design), Stream.showing(design, shown)
    mean = _means(design, rng)
    codes = reference.shown_codes(mean)[:places]
    limits = _limits(design, shown, rng)
    events = [sum(map(min, counts, limits or [1 << 30] * len(counts))) for counts in shown]
    activity = max((sum(events) << ACTIVITY_FRACTION_BITS) // places, 1)
    place, gain, speed = int(rng.integers(places)), 0.0, 1
    for _ in range(windows):
        place, gain, speed = _moved(place, gain, speed, design, rng)
        kind = rng.random()
        if kind < 0.12 and design.window == "time":
            stream.unselected()
            stream.end()
        else:
            less = 0.05 if kind < 0.24 else 1.0
            stream.fill(_counts(rates[place], less * 2.0**gain * max(speed, 0.4), rng))
    stream.close()
    case = stream.case(
        name, codes, mean=mean, limits=limits,
        activity=activity if rng.random() < 0.8 else int(activity * 2 ** rng.normal(0, 3)),
        place_activity=_activities(events, activity, rng),
        place_bias=_bias_of(codes) if rng.random() < 0.7 else _biases(design, rng),
    )  # fmt: skip
    return _at_threshold(case, vary, rng)


def _rates(
    design: Design, rng: np.random.Generator
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Draw the mean counts of each place: those of near places differ little."""
    ends = design.places + 8
    drawn = rng.gamma(0.5, 1.0, (ends, design.slots))
    if rng.random() < 0.7:  # a few pixels have all events, so that counts are large
        drawn[:, rng.permutation(design.slots)[ENOUGH_PIXELS:]] = 0
    smooth = int(rng.choice([1, 2, 3]))
    rates = sum(drawn[i : i + design.places] for i in range(smooth)) / smooth
    rates *= 2.0 ** rng.normal(0, rng.choice([0.2, 1.0]), (design.places, 1))
    total: float = rng.choice([10, 30, 80])
    return np.asarray(rates * total / max(rates.sum(axis=1).mean(), 1e-9))


def _counts(rates: Sequence[float], gain: float, rng: np.random.Generator) -> list[int]:
    return [int(count) for count in np.minimum(rng.poisson(np.asarray(rates) * gain), 40)]


def _long_enough(design: Design, shown: Sequence[Sequence[int]], vary: Vary) -> Design:
    """Give windows by count as many events as the largest that is shown."""
    if design.window == "time":
        return design
    return vary(design, window_events=max(map(sum, shown)) + 1)


def _means(design: Design, rng: np.random.Generator) -> list[int] | None:
    if not design.contrast:
        return None
    if rng.random() < 0.2:
        return [int(mean) for mean in rng.choice([0, LEVEL_TOP], design.slots)]
    return [int(mean) for mean in rng.integers(0, int(rng.choice([100, 600])), design.slots)]


def _limits(
    design: Design, shown: Sequence[Sequence[int]], rng: np.random.Generator
) -> list[int] | None:
    if not design.contrast:
        return None
    limits = np.max(shown, axis=0) + rng.integers(0, 2, design.slots)
    limits[rng.random(design.slots) < 0.1] = 0
    return [int(limit) for limit in limits]


def _activities(events: Sequence[int], activity: int, rng: np.random.Generator) -> list[int]:
    """Take what a map gives, or anything."""
    if rng.random() < 0.4:
        drawn = np.clip(np.rint(rng.normal(-8, 40, len(events))), -128, 127).astype(int).tolist()
        return [-128, *drawn[1:-1], 127][: len(events)]
    of_mean = ilog(activity >> ACTIVITY_FRACTION_BITS)
    return [min(max(ilog(number) - of_mean, -128), 127) for number in events]


def _bias_of(codes: Sequence[Sequence[int]]) -> list[int]:
    """Take what a map gives: `bias_of` its `typical_distances`, which take long in a large map."""
    places = np.array(codes, dtype=np.int64)
    means = [int(abs(places - place).sum()) // len(places) for place in places]
    return bias_of([mean - sum(means) // len(means) for mean in means])


def _biases(design: Design, rng: np.random.Generator) -> list[int]:
    drawn = rng.integers(0, int(rng.choice([4, 30, 256])), design.places)
    drawn[0] = int(rng.choice([0, 255]))
    return [int(bias) for bias in drawn]


def _moved(
    place: int, gain: float, speed: int, design: Design, rng: np.random.Generator
) -> tuple[int, float, int]:
    """Drive on: mostly as before, at times at another speed, with another gain, or elsewhere."""
    kind = rng.random()
    last = design.places - 1
    if kind < 0.05:
        return int(rng.integers(last + 1)), gain, speed
    if kind < 0.2:
        speed = int(rng.choice([-1, 0, 0, 1, 2, 3, 4, 5, 6, 7]))
    if kind > 0.85:
        gain = float(rng.choice([-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0]))
    return min(max(place + speed, 0), last), gain, speed


def _at_threshold(case: Case, vary: Vary, rng: np.random.Generator) -> Case:
    """Set the threshold to a trust of the drive, or to one above it, at times."""
    if vary is _as_it_is:
        return case
    trusts = sorted({match.trust for match in case.trace().matches if match.trust})
    if not trusts or rng.random() < 0.3:
        return case
    trust = int(rng.choice(trusts)) + int(rng.integers(2))
    memories = replace(case.memories, design=vary(case.design, trust=min(trust, 368)))
    return replace(case, memories=memories)


# Numbers of events: at the thresholds of pauses, of few events, and of logarithms.


def _numbers(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw windows whose numbers of events lie at thresholds, with the same pixels busy."""
    design = vary(design, window="time", places=int(rng.choice([2, 3, 5, 8])))
    own = int(rng.choice([-128, -60, -20, 0, 0, 30]))
    activity = int(2 ** rng.uniform(3, 12)) << ACTIVITY_FRACTION_BITS
    stream, mean, shown = Stream(design), activity, []
    first = int(rng.integers(1, 40))
    threshold = rng.random() < 0.4
    if threshold:
        activity = mean = (first << ACTIVITY_FRACTION_BITS + 3) + int(rng.integers(2))
    # of the gain that may be the best; and two windows with few events before one at the edge
    gain = int(rng.choice([min(one, 0) for one in gains_of(design.gains)]))
    edges = [-60, -60, int(rng.choice([-49, -48]))] * 5
    many = rng.random() < 0.4
    if many:  # of places so busy that few events are no pause
        own = 40 - gain
    for window in range(14):
        of_mean = activity if design.gains > 1 else mean
        log = ilog(of_mean >> ACTIVITY_FRACTION_BITS)
        surplus = int(rng.choice([-60, -49, -48, *range(-57, -38), -10, 0, 20]))
        surplus = gain + (edges[window] if many else surplus)
        number = _with_log(min(max(log + surplus + own, 0), 190))
        if rng.random() < 0.15 and not many:
            number = max((mean >> ACTIVITY_FRACTION_BITS + 3) + int(rng.integers(-1, 2)), 0)
        if threshold and window == 0:
            number = first
        number = min(number, 1500)
        shown.append(number)
        mean = mean_activity_after(mean, number)
    for number in shown:
        stream.fill(_spread(number, design, rng))
        if not number:
            stream.unselected()
    stream.close()
    codes = _any_codes(design, rng)
    return stream.case(
        name, codes, activity=activity, place_activity=[own] * design.places,
        place_bias=_biases(design, rng) if rng.random() < 0.3 else None,
    )  # fmt: skip


def _spread(number: int, design: Design, rng: np.random.Generator) -> list[int]:
    """Divide a number of events by chance among a few pixels, none of which saturates."""
    busy = -(-number // 500) + int(rng.integers(1, 4))
    counts = [0] * design.slots
    slots = rng.permutation(design.slots)[:busy]
    if not len(slots):
        return counts
    for slot, count in zip(
        slots, rng.multinomial(number, [1 / len(slots)] * len(slots)), strict=True
    ):
        counts[slot] = int(count)
    return counts


def _any_codes(design: Design, rng: np.random.Generator) -> list[list[int]]:
    """Draw places of any codes."""
    codes: list[list[int]] = rng.integers(
        0, design.code_max + 1, (design.places, design.slots)
    ).tolist()
    return codes


def _with_log(log: int) -> int:
    """Return the least number of events of a logarithm."""
    return bisect_left(range(EVENTS_TOP), log, key=ilog)


def _logarithms(
    name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int
) -> Case:
    """Draw a mean number of 18 bits or more at an edge of `LOGARITHMS`, and windows by it."""
    design = vary(design, window="time", places=4)
    log = (17 + int(rng.integers(2))) * PARTS + drawn % PARTS
    edge = _with_log(log)
    below = drawn // PARTS % 2
    wanted = edge - below << ACTIVITY_FRACTION_BITS
    if design.gains > 1:
        start = mean = wanted
    else:  # the first window takes 1/1024
        start = -(-wanted * 1024 // 1023)
        start += next(i for i in range(-3, 4) if mean_activity_after(start + i, 1) >= wanted)
        mean = mean_activity_after(start, 1)
    own, of_mean = -128, ilog(mean >> ACTIVITY_FRACTION_BITS)
    # the activity less that of the place is the first or the last of its row
    row = int(rng.integers(-2, 5))  # in lower rows the cheapest steps cost the same
    target = 8 * row - 4 + own + (0 if below else 7) + of_mean
    number = _with_log(max(target, 1))
    windows = (_spread(events, design, rng) for events in (1, number, number, 3))
    stream = Stream.showing(design, windows)
    codes = _any_codes(design, rng)
    return stream.case(name, codes, activity=start, place_activity=[own] * design.places)


def _sums(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw places that are not alike, and windows of so few events that gains look at all sums."""
    design = vary(design, window="time", places=int(rng.choice([6, 9])), restart=30)
    events, windows = int(rng.integers(10, 60)), int(rng.choice([30, 100]))
    numbers = (int(events * 2 ** rng.normal(0, 0.4)) + 1 for _ in range(windows))
    stream = Stream.showing(design, (_spread(number, design, rng) for number in numbers))
    shown = stream.shown_codes()
    codes = [shown[int(rng.integers(len(shown)))] for _ in range(design.places)]
    activity = int(events * 2 ** rng.uniform(0.5, 2)) << ACTIVITY_FRACTION_BITS
    return stream.case(name, codes, activity=activity)


class _OfSums(Machine):
    """The model, which keeps the codes of each sum that it compares, and compares none."""

    def __init__(self, memories: Memories) -> None:
        super().__init__(memories)
        self.seen: list[Codes] = []

    def distances(self, codes: Sequence[int]) -> list[int]:
        self.seen.append(tuple(codes))
        return [0] * self.design.places


def _codes_of_sums(stream: Stream, activity: int) -> list[list[Codes]]:
    """Return the codes of each sum of each window of a stimulus."""
    design = stream.design
    no_places = [[0] * design.slots] * design.places
    model = _OfSums(Memories(design, stream.pixels, no_places, activity=activity))
    for event in stream.events:
        deque(model.take(event), 0)
    return [model.seen[i : i + design.sums] for i in range(0, len(model.seen), design.sums)]


def _paths(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw places that are alike but for some with codes of sums, so that much speaks for these.

    Then a gain is worth its changes, and a restart from another gain is the nearest one.
    """
    design = vary(design, places=int(rng.choice([24, 60])), window="time")
    events = int(rng.integers(8, 30))
    kinds = [_spread(events, design, rng) for _ in range(int(rng.integers(2, 4)))]
    stream = Stream.showing(design, (kinds[int(rng.integers(len(kinds)))] for _ in range(60)))
    activity = int(events * 2 ** rng.uniform(0, 2)) << ACTIVITY_FRACTION_BITS
    seen = list(chain.from_iterable(_codes_of_sums(stream, activity)))
    alike = list(seen[int(rng.integers(len(seen)))])
    for slot in rng.integers(design.slots, size=int(rng.integers(8))):
        alike[slot] += 1 if alike[slot] < design.code_max else -1
    codes: list[Sequence[int]] = [alike] * design.places
    first = int(rng.integers(max(design.places - 12, 1)))
    for at in rng.integers(min(design.places, 12), size=int(rng.integers(3, 9))):
        codes[first + at] = seen[int(rng.integers(len(seen)))]
    activities = [int(rng.integers(-50, 30))] * design.places
    return stream.case(name, codes, activity=activity, place_activity=activities)


# Distances: wide ones, small spreads, many places.


def _wide(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw places of any codes, with distances and sums of them above 8 and 16 bits."""
    if design.slots * 255 + 255 <= 0xFFFF:
        design = vary(design, code_bits=8)
    most = design.slots * design.code_max
    # sums of distances, or of deviations, above 16 bits; and one place or some among many
    places = (12, min(max(12, 6 * 0x10000 // most), 400), 150)[drawn % 3]
    design = vary(design, places=places, window="time")
    places = design.places
    windows = (_spread(int(rng.integers(1, 60)), design, rng) for _ in range(5))
    stream = Stream.showing(design, windows)
    shown = stream.shown_codes()
    near, far = list(shown[-1]), apart(shown[-1], design)
    if rng.random() < 0.5:
        near, far = far, near
    codes = rng.choice([0, design.code_max], (design.places, design.slots)).tolist()
    if drawn % 3 == 1:
        codes = [(near, far)[k % 2] for k in range(places)]
    if drawn % 6 == 4:  # at three distances
        ways = [[*far[:n], *near[n:]] for n in rng.integers(design.slots + 1, size=3).tolist()]
        codes = [ways[way] for way in rng.integers(3, size=places).tolist()]
    if drawn % 3 == 2:
        codes = [near] * places
        others = int(places ** rng.random())
        for place in rng.permutation(places)[:others].tolist():
            codes[place] = far
    if drawn % 6 == 5:  # the only place outside the zone around the last one
        beside = [near[0] + (1 if near[0] < design.code_max else -1), *near[1:]]
        codes = [far, *[beside] * (places - 2), near]
        design = vary(design, exclusion=places - 2)
    elif rng.random() < 0.5:
        codes[int(rng.integers(places))] = near
    stream.design = design
    return stream.case(
        name, codes, activity=0, place_bias=_biases(design, rng) if drawn % 2 else None
    )


def _near(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw places that differ from the windows by a few units: spreads of 0 and 1."""
    design = vary(design, places=int(rng.choice([4, 9, 12])))
    counts = _spread(20, design, rng)
    design = _long_enough(design, [counts], vary)
    stream = Stream.showing(design, [counts] * (5 + design.length))
    shown = stream.shown_codes()[-1]
    codes = []
    for _ in range(design.places):
        row = list(shown)
        for slot in rng.permutation(design.slots)[: int(rng.choice([0, 1, 1, 2, 3]))]:
            row[slot] += 1 if row[slot] < design.code_max else -1
        codes.append(row)
    return stream.case(name, codes)


def _many(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw many equal places."""
    design = vary(
        design, places=int(rng.integers(4097, 4200)), exclusion=2, lookup_depth=0,
        pixels=min(design.pixels, ENOUGH_PIXELS),
    )  # fmt: skip
    counts = [_spread(20, design, rng) for _ in range(3)]
    stream = Stream.showing(_long_enough(design, counts, vary), counts)
    return stream.case(name, [stream.shown_codes()[0]] * design.places)


def _runs(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw windows that are alike, and runs of places whose sums are about a power of two, or ties.

    A sum is about an odd number of such powers, so that its bit decides between two places.
    """
    number = int(rng.choice([0, 0, 60, 600 if design.contrast else 60]))
    if design.window == "count":
        number = min(design.window_events, 60)
    counts = _spread(number, design, rng)
    stream = Stream(design)
    for _ in range(2 * design.length + 2):
        stream.unselected()
        stream.fill(counts)
    stream.close()
    shown = stream.shown_codes()[-1]
    most = sum(max(code, design.code_max - code) for code in shown)
    top = most * design.length
    power = 1 << int(rng.integers(top.bit_length()))
    total = power * (1 + 2 * int(rng.integers(top // (2 * power) + 1)))
    last = drawn % 3 == 0  # the best place, behind a second best with a large sum
    if last:
        total = int(rng.integers(top // 2, top + 1))
    about = (total // design.length + rng.integers(-3, 4, 4)).tolist()
    others = [] if last else rng.choice([0, 1, 2, most], 2).tolist()
    distances = [min(max(one, 0), most) for one in (*about, *others)]
    few = rng.permutation(distances)[: int(rng.integers(2, 7))]
    codes: list[Sequence[int]] = []
    while len(codes) < design.places:
        at = moved_by(design, shown, int(rng.choice(few)))
        codes += [at or shown] * int(rng.integers(1, design.length + design.exclusion + 2))
    if last:
        codes[design.places - 1] = shown
    return stream.case(name, codes[: design.places])


# Long drives, and long windows.


def _long(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw as many windows as means take for their last shift, and more."""
    design = vary(design, places=3, window="time", code="contrast")
    stream, busy = Stream(design), rng.permutation(design.slots)[:ENOUGH_PIXELS]
    for window in range(40 + (1 << LAST_SHIFT)):
        counts = [0] * design.slots
        for slot in busy:
            counts[slot] = int(rng.poisson(1 + 2 * (window // 30 % 2)))
        stream.fill(counts)
    # a pause, and counts whose codes the means decide
    stream.unselected()
    stream.end()
    for _ in range(1 << FIRST_SHIFT):
        stream.fill(_spread(60, design, rng))
    stream.close()
    codes = _any_codes(design, rng)
    return stream.case(name, codes, mean=_means(design, rng), activity=2 << ACTIVITY_FRACTION_BITS)


def _quiet(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw windows of ever fewer events, none a pause, until quiet places have few.

    Then more of them bring the mean speed up again.
    """
    design = vary(design, places=3, window="time")
    activity = mean = 1000 << ACTIVITY_FRACTION_BITS
    stream = Stream(design)
    for _ in range(260):
        number = (mean >> ACTIVITY_FRACTION_BITS + PAUSE_SHIFT) + 1
        mean = mean_activity_after(mean, number)
        stream.fill(_spread(number, design, rng))
    for _ in range(40):
        stream.fill(_spread(500, design, rng))
    stream.close()
    codes = _any_codes(design, rng)
    activities = rng.integers(-80, -72, design.places).tolist()
    return stream.case(name, codes, activity=activity, place_activity=activities)


def _numbered(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw more windows than 12 bits can number, with an event in each."""
    design = vary(design, window="time", places=3, pixels=1, gains=1, lookup_depth=0)
    stream = Stream(design)
    for number in range(4100):
        stream.slot(number % design.slots)
        stream.end()
    stream.close()
    return stream.case(name, [[k % 2] * design.slots for k in range(design.places)])


def _half(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw an event half the clock's period behind the end of a window."""
    stream, half = Stream(design), 1 << (design.timestamp_bits - 1)
    stream.fill(_spread(20, design, rng))
    stream.slot(0, offset=half)  # of the window before, which is still open
    stream.skip(half // design.tau_us + 1)
    for _ in range(design.length):
        stream.fill(_spread(20, design, rng))
    stream.close()
    codes = _any_codes(design, rng)
    return stream.case(name, codes)


def _pauses(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw silence before any event, or a mean that rounding brings to the threshold of a pause."""
    design = vary(design, places=int(rng.choice([4, 9])), window="time")
    number = int(rng.integers(1, 30))
    mean = number << ACTIVITY_FRACTION_BITS + PAUSE_SHIFT
    activity = 0
    if drawn % 2:
        wider = range(mean, mean + mean // 512 + 4)
        activity = next(n for n in wider if n % 1024 and mean_activity_after(n, 0) == mean)
    stream = Stream(design)
    for events in (0, number, 0, number, 2 * number):
        if not events:
            stream.unselected()
        stream.fill(_spread(events, design, rng))
    stream.close()
    codes = _any_codes(design, rng)
    return stream.case(name, codes, activity=activity)


def _loud(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw windows in which a pixel has hundreds of events, and sums above 1,023."""
    design = vary(design, places=4, window="time", code="contrast")
    stream = Stream(design)
    for _ in range(6):
        counts = _spread(20, design, rng)
        counts[0] = int(rng.integers(200, 700))
        stream.fill(counts)
    stream.close()
    codes = _any_codes(design, rng)
    limits = [int(limit) for limit in rng.choice([0, 5, 1023], design.slots)]
    return stream.case(
        name, codes, mean=_means(design, rng), limits=limits,
        activity=int(2 ** rng.choice([rng.uniform(4, 10), rng.uniform(10, 12.5)]))
        << ACTIVITY_FRACTION_BITS,
    )  # fmt: skip


def _large_means(
    name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int
) -> Case:
    """Draw a mean number of events of which one bit makes a pause of the first window."""
    design = vary(design, places=4, window="time")
    numbers = (1, int(rng.integers(1, 30)), int(rng.integers(1, 30)))
    stream = Stream.showing(design, (_spread(number, design, rng) for number in numbers))
    codes = _any_codes(design, rng)
    bit = ACTIVITY_FRACTION_BITS + PAUSE_SHIFT + drawn % len(OF_MEANS)
    return stream.case(name, codes, activity=(1 << bit) + 1)


def _halves(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw means that become half a unit of a logarithm, where rounding decides about a code."""
    design = vary(design, places=3, window="time", code="contrast")
    first = _spread(30, design, rng)
    # the first shift is 4: means that are 8 and any number of 16 units below the level
    levels = [LEVELS[count] for count in first]
    mean = [(level - 8) % 16 + 16 * int(rng.integers(30)) for level in levels]
    others = (_spread(30, design, rng) for _ in range(3))
    stream = Stream.showing(design, chain([first], others))
    shown = stream.shown_codes(mean)[:3]
    return stream.case(name, [shown[i % len(shown)] for i in range(design.places)], mean=mean)


def _clear(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw a drive of which the map has each window, so that nothing speaks against its path."""
    windows, apart = 30, design.places_per_window
    design = vary(design, places=windows * apart, restart=30)
    counts = rng.integers(0, 6, (windows, design.slots)).tolist()
    design = _long_enough(design, counts, vary)
    stream = Stream.showing(design, counts)
    codes = _any_codes(design, rng)
    first = int(rng.choice([0, max(design.places - windows * apart, 0)]))  # or up to the last one
    ways = range(first, design.places, apart)
    for place, shown in zip(ways, stream.shown_codes(), strict=False):
        codes[place : place + apart] = [list(shown)] * apart
    activity = max(sum(map(sum, counts)) // windows, 1)
    activity <<= ACTIVITY_FRACTION_BITS
    return stream.case(name, codes[: design.places], activity=activity)


def _far(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw places that are all far by their biases."""
    design = vary(design, places=int(rng.choice([4, 9])))
    counts = [_spread(20, design, rng) for _ in range(6)]
    stream = Stream.showing(_long_enough(design, counts, vary), counts)
    codes = _any_codes(design, rng)
    biases = rng.integers(128, 256, design.places).tolist()
    return stream.case(name, codes, place_bias=biases)


def _full(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw windows in which a counter is full."""
    counts = [[int(n) for n in rng.integers(0, 4, design.slots)] for _ in range(3)]
    counts[0][int(rng.integers(design.slots))] = design.count_max + 1
    stream = Stream.showing(_long_enough(design, counts, vary), counts)
    codes = _any_codes(design, rng)
    return stream.case(name, codes)


def _times(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw events at any time of a window, and off the sensor by a bit of their column or row."""
    design = vary(design, window="time", places=int(rng.choice([4, 9])))
    stream, tau = Stream(design), design.tau_us
    bits = [(1 << n, 0) for n in range((design.width - 1).bit_length(), 16)]
    bits += [(0, 1 << n) for n in range((design.height - 1).bit_length(), 15)]
    for _ in range(12):
        times = [0, tau - 1, *rng.integers(0, tau, int(rng.integers(30))).tolist()]
        for at in sorted(times[int(rng.integers(3)) :]):
            x, y = stream.pixels[int(rng.integers(design.slots))]
            off = bits.pop() if bits and rng.random() < 0.5 else (0, 0)
            stream.at(x + off[0], y + off[1], at, bool(rng.integers(2)))
        # half the clock's period before the end, less a power of two
        for n in range(design.timestamp_bits - 1) if rng.random() < 0.3 else ():
            stream.slot(0, offset=tau - (1 << design.timestamp_bits - 1) + (1 << n))
        # about a power of two before the end
        for n in range(1, design.timestamp_bits - 1):
            near = 1 << n // 2
            stream.slot(0, offset=tau - (1 << n) + int(rng.integers(-near, near)))
        stream.skip(int(rng.choice([1, 1, 1, 2, 3])))
    stream.close()
    codes = _any_codes(design, rng)
    return stream.case(name, codes)


# Rare paths and thresholds: a map of many places, few of which are near.


def _roomy(design: Design, vary: Vary) -> Design:
    """Give a design pixels for windows that differ, and so many places that a few hardly spread."""
    return vary(
        design, window="time", pixels=96, width=max(design.width, 16), lookup_depth=0,
        height=max(design.height, 16), code_bits=max(design.code_bits, 3), places=300, restart=16,
    )  # fmt: skip


def _evenly(number: int, slots: Sequence[int], design: Design) -> list[int]:
    """Divide a number of events among slots."""
    counts = [0] * design.slots
    for i in range(number):
        counts[slots[i % len(slots)]] += 1
    return counts


def _far_from(codes: Codes, design: Design, most: int = 200) -> Codes:
    """Return codes that are far from these, as far as there is room."""
    return next(far for steps in range(most, -1, -1) if (far := moved_by(design, codes, steps)))


def _leaps(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw a path to a place that the lowest gain alone sees, and then gains of other sums.

    The lowest gain sees it by the second window. The gains from a number on see it again by the sum
    of the last two; if the number is 1, another place, to which they restart from the path.
    """
    design = _roomy(design, vary)
    pixels, most = rng.permutation(design.slots).tolist(), min((design.slots - 1) // 2, 30)
    number, events = (1, 5)[drawn % 2], max(2 * most, 60)
    before, slow = pixels[:most], pixels[most : 2 * most]
    last = pixels[2 * most :][: most if number == 1 else 4]
    activity = int(events * 2.0 ** (44 / PARTS)) + 1
    # with it, the mean speed is between those by which this gain and the one below look at two
    log = 2 * (GAINS[number] - 16) + 44 + int(rng.integers(-6, 7))
    stream = Stream.showing(design, [
        _evenly(events, before, design), _evenly(events, slow, design),
        _evenly(int(activity * 2.0 ** (log / PARTS)), last, design),
    ])  # fmt: skip
    activity <<= ACTIVITY_FRACTION_BITS
    sums = _codes_of_sums(stream, activity)
    start, beyond = int(rng.integers(design.places)), 12 + design.exclusion
    near = {0: sums[0][0], **dict.fromkeys((1, 2, 3), sums[1][0])}
    near |= {beyond: sums[1][1], beyond + 1: sums[2][0]}
    if number == 1:
        near |= {2 * beyond: sums[2][1]}
    codes = [sums[1][0]] * design.places
    biases = [int(rng.integers(16, 40))] * design.places
    for behind, shown in near.items():
        place = (start + behind) % design.places
        codes[place], biases[place] = shown, 0
    return stream.case(
        name, codes, activity=activity, place_bias=biases,
        place_activity=[int(rng.integers(-10, 10))] * design.places,
    )  # fmt: skip


def _halts(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw windows with few events, and the next place in one at their threshold.

    Whether the robot stands decides what the step costs. The window before has 1/8 weight.
    """
    design = _roomy(design, vary)
    activity = mean = _with_log(int(rng.integers(80, 90))) << ACTIVITY_FRACTION_BITS
    pixels, stream = rng.permutation(design.slots).tolist(), Stream(design)
    for surplus in (0, -60, -60, -54, (-49, -48)[drawn % 2]):
        of_mean = activity if design.gains > 1 else mean
        number = _with_log(ilog(of_mean >> ACTIVITY_FRACTION_BITS) + 40 + surplus)
        stream.fill(_evenly(number, pixels[4:8] if -50 < surplus < 0 else pixels[:4], design))
        mean = mean_activity_after(mean, number)
    stream.close()
    shown = stream.shown_codes()
    apart = sum(abs(a - b) for a, b in zip(shown[0], shown[-1], strict=True))
    # in a map of few places, what is between both spreads less
    most = (200, apart // 2)[drawn // 2 % 2]
    codes = [_far_from(shown[0], design, most)] * design.places
    place = int(rng.integers(design.places - 1))
    codes[place], codes[place + 1] = shown[0], shown[-1]
    # places so busy that few events are no pause
    own = 40 - min(gains_of(design.gains))
    return stream.case(name, codes, activity=activity, place_activity=[own] * design.places)


def _speeds(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw a mean speed that is as it begins, then large, then slow to move.

    A pause and a window with few events leave it. Many events raise it, fewer let it fall, until 63
    windows have moved it.
    """
    design = _roomy(design, vary)
    pixels, busy = rng.permutation(design.slots).tolist(), int(rng.integers(4, 9))
    groups, log = cycle((pixels[:busy], pixels[busy : 2 * busy])), ilog(17)
    surpluses = [-41, -15, 140, *[-12] * 3, *[0] * 60, *[40] * 6]
    numbers = (_with_log(log + surplus) for surplus in surpluses)
    windows = (
        _evenly(number, pixels if number > 1000 else next(groups), design) for number in numbers
    )
    stream = Stream.showing(design, windows)
    activity = 17 << ACTIVITY_FRACTION_BITS
    seen = _codes_of_sums(stream, activity)
    codes = [_far_from(seen[1][0], design)] * design.places
    # the first place is the best after the pause: for it, the next window has few events
    own = [70, *rng.integers(-8, 8, design.places - 1).tolist()]
    for shown in (*seen[1][:2], *seen[-1][:2]):
        codes[int(rng.integers(1, design.places))] = shown
    return stream.case(name, codes, activity=activity, place_activity=own)


def _bursts(name: str, design: Design, vary: Vary, rng: np.random.Generator, drawn: int) -> Case:
    """Draw a window with hundreds of times the mean number of events, along very busy places.

    It has more events than 16 bits can count, if counters have room for them. Its path goes on by
    the largest step, for the costs of a row of which its activity is the least.
    """
    design = _roomy(design, vary)
    own, apart, busy = 127, design.places_per_window, int(0x10000 * 2 ** (2 / PARTS))
    log = ilog(busy if design.slots * design.count_max > busy else 600)
    mean = _with_log(log - own - 4)
    pixels = rng.permutation(design.slots).tolist()
    windows = [_evenly(mean, pixels[:8], design), _evenly(_with_log(log), pixels, design)]
    stream = Stream.showing(design, windows)
    first, last = stream.shown_codes()
    codes, step = [_far_from(last, design)] * design.places, len(BANK_COSTS[apart][0]) - 1
    place = int(rng.integers(design.places - step))
    codes[place], codes[place + step] = first, last
    return stream.case(
        name, codes, activity=mean << ACTIVITY_FRACTION_BITS,
        place_activity=[own] * design.places,
    )  # fmt: skip


#: kinds for rare paths and thresholds, which need some pixels and places
_ROOMY_KINDS: dict[str, Draw] = {
    "leaps": _leaps,
    "halts": _halts,
    "speeds": _speeds,
    "bursts": _bursts,
}
_KINDS: dict[str, Draw] = {
    **_ROOMY_KINDS,
    "drive": _drive,
    "numbers": _numbers,
    "sums": _sums,
    "paths": _paths,
    "logarithm": _logarithms,
    "wide": _wide,
    "near": _near,
    "many": _many,
    "long": _long,
    "pauses": _pauses,
    "loud": _loud,
    "large_means": _large_means,
    "halves": _halves,
    "clear": _clear,
    "far": _far,
    "full": _full,
    "times": _times,
    "quiet": _quiet,
    "numbered": _numbered,
    "half": _half,
    "runs": _runs,
}
#: kinds that are made for some facts alone
_AIMED: dict[str, set[str]] = {
    "leaps": {"changes_before_restart_decide", "change_by_five_decides"},
    "halts": {
        "few_at_threshold", "enough_at_threshold", "evidence_limit_decides",
        "large_evidence_decides",
    },
    "speeds": {
        "first_speed_decides", "large_speed_decides", "largest_speed_decides", "slowness_decides",
    },
    "bursts": {"large_activity_decides", "events_decide"},
    "logarithm": set(LOGARITHMS),
    "sums": {
        "change_up_decides", "change_down_decides", "change_by_one_decides", "forgetting_decides",
    },
    "paths": {"change_by_several_decides", "low_gains_decide"},
    "many": {"ties_above_4095", "all_places_tie", "spread_of_nothing"},
    "long": {
        "speed_saturated",
        "last_shift_stays",
        *(name for name in CONTRAST if name.startswith("mean_shift_")),
    },
    "pauses": {"silence_of_nothing", "silence_decides", "decay_decides"},
    "large_means": OF_MEANS,
    "halves": {"mean_of_a_half"},
    "clear": {"trust_above_255", "middle_at_the_last"},
    "far": {"nearest_above_7_bits"},
    "full": OF_COUNTERS,
    "times": OF_THE_CLOCK | {name for name in BITS if name.startswith(("column", "row", "late"))},
    "quiet": {"quiet_place", "lowest_speed_decides"},
    "numbered": {"window_above_4095"},
    "half": {"half_a_period_late"},
    "runs": OF_SEQUENCES | {name for name in BITS if name.startswith(("sum", "left"))},
}  # fmt: skip
