"""The state of the localiser: its windows, their distances to every place, its schedule."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays, check_array, check_range, whole_number
from edge_vpr.compiling import plain
from edge_vpr.confidence import TRUST_TOP
from edge_vpr.descriptors.windows import MAX_WINDOWS, FixedTime, Window
from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.map_record import MapRecord
from edge_vpr.matching.distances import aligned_zeros
from edge_vpr.matching.place_filter import (
    LASTING_BITS,
    METRIC_TOP,
    NUMBER_NAMES,
    RECIPROCAL_BITS,
    RESIDUAL_TOP,
    TRUST_BITS,
    USUAL_FIT,
    FilterState,
    PlaceFilter,
    StepTable,
    WindowRows,
)
from edge_vpr.online.kernels import BLOCK, LANES, MAX_STEPS, write_codes
from edge_vpr.route import MOST_MM
from edge_vpr.settings import Settings, duration_us
from fixedpoint.codes import PixelCodes
from fixedpoint.own_mean import OwnMeanCode

# State of sliding windows: the newest time or events, and windows of the same length before.
#
# A sequence consists of L such windows, one directly after the other. They are numbered by their
# lag: lag 0 is the newest window, and lag i holds what lag 0 held i window lengths ago. An event
# enters at lag 0, moves from lag to lag as it ages, and leaves after the last one. Each move
# subtracts one from a counter and adds one to another. At time T, lag i of windows of tau
# microseconds holds the events with ``T - (i+1) tau <= t < T - i tau``; after an event at time t,
# T is t + 1. Lag i of windows of N events holds the i N-th to (i+1) N-th newest event at the
# selected pixels.
#
# At the end of every non-overlapping window, T = k tau or the k N-th selected event, the lags are
# exactly the last L windows of `edge_vpr.descriptors.windows`.


#: initial size of the ring buffer of events
RING_EVENTS = 4096
#: largest number of moves that are noted before the counters are updated
MAX_MOVES = 256

#: A move of an event: its slot, and the lag that it left (-1: it is new).
MOVE = np.dtype([("slot", "<i4"), ("left", "<i4")])
#: For each counter: its table, and its smallest and largest count in the map.
COUNTER = np.dtype([("table", "<i8"), ("low", "<i8"), ("high", "<i8")])
#: Common part of all distances, number of noted moves that the counters do not include yet, stride
#: of `SlidingWindows.columns`, and number of sums in use.
TOTALS = np.dtype([("common", "<i8"), ("moves", "<i8"), ("stride", "<i8"), ("sums", "<i8")])


class OwnCodes(NamedTuple):
    """Own-mean codes of a window, which have no table.

    Attributes
    ----------
    levels : ndarray of int32, shape (size,)
        Logarithm of each count, see `OwnMeanCode`; of size 0 where there are other codes.
    means : ndarray of int32, shape (J,)
        Mean logarithm of each counter, in units of 1/256 octave.
    codes : ndarray of int64, shape (2, J)
        Those that the distances are of, and scratch.
    bits : int
        Of `OwnMeanCode`.
    """

    levels: npt.NDArray[np.int32]
    means: npt.NDArray[np.int32]
    codes: npt.NDArray[np.int64]
    contrast: bool
    bits: int


class SlidingWindows(NamedTuple):
    """State of the kernels of sliding windows and of their distances to a map.

    Attributes
    ----------
    slot : ndarray of int32, shape (capacity,)
        Ring of the slots of selected events, as `time` has their times.
    time : ndarray of int64, shape (capacity,)
        Ring of selected events: event number i is at ``i % capacity``, a power of two.
    bound : ndarray of int64, shape (L + 1,)
        Lag i holds the events numbered from ``bound[i + 1]`` up to ``bound[i]``.
    moves : ndarray of MOVE, shape (MAX_MOVES,)
        Events that have moved since the counters were last brought up to date.
    counts : ndarray of int64, shape (L, J)
        Events in each lag, by slot.
    tau, n : int
        Length of a window in microseconds, or in events; the other is 0.
    code : ndarray of uint16, shape (codes, size)
        Tables, a row each: code of each count, not decreasing; the last stands for all larger
        counts. Of shape (1, 0): the count itself; (0, 0): see `own`.
    counters : ndarray of COUNTER, shape (J,)
        State of each counter.
    columns : ndarray of uint8 or uint16
        Map, a pixel's places one after another, `stride` apart from pixel to pixel.
    sums : ndarray of uint16 or uint32
        ``sums[m]``: distance of the sequence that ends at place m + L - 1, less the common base.
        After LANES spare ones, the smallest of each block, see `kernels.least_in`.
    steps : ndarray of int64, shape (2, MAX_STEPS)
        Scratch for the steps of `update_blocks`.
    totals : ndarray of TOTALS, shape (1,)
        Numbers that are kept for all counters together.
    """

    slot: npt.NDArray[np.int32]
    time: npt.NDArray[np.int64]
    bound: npt.NDArray[np.int64]
    moves: npt.NDArray[np.void]
    counts: npt.NDArray[np.int64]
    tau: int
    n: int
    code: npt.NDArray[np.uint16]
    own: OwnCodes
    counters: npt.NDArray[np.void]
    columns: npt.NDArray[np.unsignedinteger]
    sums: npt.NDArray[np.unsignedinteger]
    steps: npt.NDArray[np.int64]
    totals: npt.NDArray[np.void]


def recount(s: SlidingWindows) -> npt.NDArray[np.int64]:
    """Count all events in the ring again, shape (L, J)."""
    counts = np.zeros_like(s.counts)
    for lag in range(len(counts)):
        numbers = np.arange(s.bound[lag + 1], s.bound[lag])
        slots = s.slot[numbers & (s.slot.size - 1)]
        counts[lag] = np.bincount(slots, minlength=counts.shape[1])
    return counts


def grown(s: SlidingWindows) -> SlidingWindows:
    """Return the state with a ring of twice the size."""
    numbers = np.arange(s.bound[-1], s.bound[0])
    old, size = numbers & (s.slot.size - 1), 2 * s.slot.size
    slot, time = np.zeros(size, dtype=np.int32), np.zeros(size, dtype=np.int64)
    slot[numbers & (size - 1)] = s.slot[old]
    time[numbers & (size - 1)] = s.time[old]
    return s._replace(slot=slot, time=time)


# Computation of all distances of the windows to the places, and the layout of the map by pixel.


def start(
    places: npt.NDArray[np.unsignedinteger],
    window: Window,
    length: int,
    codes: PixelCodes | OwnMeanCode | None,
    mean: npt.NDArray[np.int32] | None = None,
) -> SlidingWindows:
    """Build the state before the first event.

    Parameters
    ----------
    places : ndarray of unsigned int, shape (K, J)
        Map, in codes if there are any.
    length : int
        L.
    codes : PixelCodes or OwnMeanCode, optional
        What the counts of a window become before they are compared.
    mean : ndarray of int32, shape (J,), optional
        Where the means of own-mean codes start.
    """
    counters = places.shape[1]
    levels, contrast, bits = np.empty(0, dtype=np.int32), False, 0
    means, tables = np.zeros(counters, dtype=np.int32), np.empty((1, 0), dtype=np.uint16)
    if isinstance(codes, OwnMeanCode) and mean is not None:
        # copies, because for Numba a read-only array is of another type
        levels, contrast, bits = codes.levels.copy(), codes.contrast, codes.bits
        means, tables = mean.copy(), np.empty((0, 0), dtype=np.uint16)
    of_counters = np.zeros(counters, dtype=COUNTER).view(np.recarray)
    if isinstance(codes, PixelCodes):
        of_counters["table"], tables = codes.row, codes.tables
    state = SlidingWindows(
        slot=np.zeros(RING_EVENTS, dtype=np.int32),
        time=np.zeros(RING_EVENTS, dtype=np.int64),
        bound=np.zeros(length + 1, dtype=np.int64),
        moves=np.zeros(MAX_MOVES, dtype=MOVE).view(np.recarray),
        counts=np.zeros((length, counters), dtype=np.int64),
        tau=window.tau_us if isinstance(window, FixedTime) else 0,
        n=0 if isinstance(window, FixedTime) else window.events,
        code=tables,
        own=OwnCodes(levels, means, np.zeros((2, counters), dtype=np.int64), contrast, bits),
        counters=of_counters,
        columns=np.empty(0, dtype=np.uint8),
        sums=np.empty(0, dtype=np.uint16),
        steps=np.zeros((2, MAX_STEPS), dtype=np.int64),
        totals=np.zeros(1, dtype=TOTALS).view(np.recarray),
    )
    return with_distances(state, places)


def with_distances(s: SlidingWindows, places: npt.NDArray[np.unsignedinteger]) -> SlidingWindows:
    """Lay a map out by pixel, and compute all distances of the present counters."""
    length = len(s.counts)
    # an odd number of whole vectors: with a power of two, all columns of a place would share the
    # same lines of the cache
    count, stride = len(places) - length + 1, (len(places) // LANES + 2 | 1) * LANES
    columns = aligned_zeros(places.shape[1] * stride + LANES, places.dtype)
    columns[: places.shape[1] * stride].reshape(-1, stride)[:, : len(places)] = places.T
    low, high = places.min(axis=0).astype(np.int64), places.max(axis=0).astype(np.int64)

    s = s._replace(own=s.own._replace(codes=np.zeros_like(s.own.codes)))
    coded = _coded(s)
    # places with the smallest counts fill the last vector
    spare = np.broadcast_to(low.astype(places.dtype), (LANES, len(low)))
    by_pixel = np.ascontiguousarray(np.concatenate([places, spare]).T)
    distances = np.zeros(count + LANES, dtype=np.int64)
    for lag in range(length):
        end = length - 1 - lag
        # `ReferenceIndex` is faster, and would take longer to compile than this takes
        for column, code in zip(by_pixel, coded[lag].tolist(), strict=True):
            distances += np.abs(column[end : end + count + LANES].astype(np.int64) - code)
    base = int(np.abs(coded - np.clip(coded, low, high)).sum())
    # without the base, no distance is larger than this; those of filling places always are, so that
    # a search can include them
    largest = length * int((high - low).sum())
    if 2 * largest + 1 > np.iinfo(np.uint32).max:
        raise UsageError(
            f"distances of up to {largest} do not fit 32 bits: take fewer pixels, a shorter "
            "sequence, or a counter code"
        )
    distances[count:] += largest + 1
    dtype = np.uint16 if 2 * largest + 1 <= np.iinfo(np.uint16).max else np.uint32
    sums = aligned_zeros(count + LANES + -(-count // BLOCK), dtype)
    sums[: count + LANES] = distances - base
    _find_least(sums, count)
    counters = s.counters.copy()
    counters["low"], counters["high"] = low, high
    return s._replace(
        columns=columns,
        counters=counters,
        sums=sums,
        totals=np.array([(base, 0, stride, count)], dtype=TOTALS).view(np.recarray),
    )


def _find_least(sums: npt.NDArray[np.unsignedinteger], count: int) -> None:
    """Write the smallest sum of each block after the sums, see `kernels.least_in`."""
    sums[count + LANES :] = np.minimum.reduceat(sums[:count], np.arange(0, count, BLOCK))


def _coded(s: SlidingWindows) -> npt.NDArray[np.int64]:
    """Return the codes of the counters of each lag, shape (L, J); own-mean codes are kept."""
    if s.own.levels.size:
        plain(write_codes)(s.counts[0], s.own, s.own.codes[0])
        return s.own.codes[:1]
    if s.code.size == 0:
        return s.counts
    return s.code[s.counters["table"], np.minimum(s.counts, s.code.shape[1] - 1)].astype(np.int64)


# Schedule of matches: after a number of events, at times, or when the place changes.


@dataclass(frozen=True)
class MatchSchedule:
    """Schedule of matches or descriptors, by events, by time, or by both.

    >>> MatchSchedule(interval_us=50_000)
    MatchSchedule(events=0, interval_us=50000, change=False)
    >>> MatchSchedule.parse("50ms", Settings()) == MatchSchedule(interval_us=50_000)
    True

    Parameters
    ----------
    events : int
        After so many events at the selected pixels; 1 is after each. 0: not by events.
    interval_us : int
        At every multiple of so many microseconds, before the events of that time. 0: not by time.
    change : bool
        Of what the others ask for, only matches whose place differs from the one said before.
    """

    events: int = 0
    interval_us: int = 0
    change: bool = False

    def __post_init__(self) -> None:
        for name, kind in (("events", int), ("interval_us", int), ("change", bool)):
            value = getattr(self, name)
            if type(value) is not kind or value > TIME_LIMIT_US:
                raise UsageError(
                    f"matches with {name} = {value!r}: expected {kind.__name__}, at most "
                    f"{TIME_LIMIT_US}"
                )
        if self.events < 0 or self.interval_us < 0 or not (self.events or self.interval_us):
            raise UsageError(
                f"a match every {self.events} events and every {self.interval_us} us: "
                "expected a positive number of one of them"
            )

    @classmethod
    def window(cls, settings: Settings) -> MatchSchedule:
        """Return the schedule of a match at the end of every non-overlapping window."""
        if settings.window == "time":
            return cls(interval_us=settings.tau_us)
        return cls(events=settings.events_per_window)

    @classmethod
    def parse(
        cls, when: str | MatchSchedule | None, settings: Settings, default: str = "50ms"
    ) -> MatchSchedule:
        """Return the schedule of live matches with a map.

        Parameters
        ----------
        when : str, MatchSchedule or None
            See `read_every`; None: the default, or ``window`` if matches are late.
        settings : Settings
            Of the map.

        Raises
        ------
        UsageError
            If it is none, or matches come late and are wanted at other times than the ends of
            windows.
        """
        if isinstance(when, MatchSchedule):
            return when
        text = when or ("window" if settings.late else default)
        schedule = read_every(text)
        if schedule is not None and settings.late:
            raise UsageError(
                f"--every {text} with a delay of {settings.late} windows, which gives a "
                "match at the end of each window: leave --every out, or set --delay 0"
            )
        return schedule or cls.window(settings)

    def check_ticks(self, from_us: int, until_us: int) -> None:
        """Raise UsageError if time jumps over more than a million intervals."""
        if self.interval_us and (until_us - from_us) // self.interval_us > MAX_WINDOWS:
            raise UsageError(
                f"time jumps to {until_us} us, over more than {MAX_WINDOWS} times every "
                f"{self.interval_us} us: check the recording's clock, or ask less often"
            )


def read_every(text: str) -> MatchSchedule | None:
    """Read ``event``, a number of events, a time such as ``10ms``, ``window``, or ``change``.

    Returns
    -------
    MatchSchedule or None
        None for ``window``, whose length a map or a design knows.

    Raises
    ------
    UsageError
        If it is none of these.
    """
    if text == "window":
        return None
    if text in ("event", "change"):
        return MatchSchedule(events=1, change=text == "change")
    if text.isascii() and text.isdigit() and int(text) > 0:
        return MatchSchedule(events=int(text))
    try:
        return MatchSchedule(interval_us=duration_us(text))
    except UsageError:
        raise UsageError(
            f"--every {text!r}: expected event, a number of events, a time such as 10ms, window, "
            "or change"
        ) from None


# Record of one match of the localiser.


#: One match, with the names of the columns of ``matches.csv``. With the place filter, metrics
#: replace distances, and one window the sequence.
MATCH_DTYPE = np.dtype(
    [
        ("time_us", "<i8"),  # when it was given, by the clock of the events
        ("place", "<i8"),  # the best; of equal ones the first
        ("distance", "<f8"),  # of the best place: mean of the L windows of the sequence
        ("second", "<i8"),  # the best place outside the exclusion zone; -1: there is none
        ("second_distance", "<f8"),  # of that place; NaN if there is none
        ("ratio", "<f8"),  # distance / second_distance; NaN if there is no second place
        ("events", "<i8"),  # in the newest window, at the selected pixels
        ("start_us", "<i8"),  # of the newest window
        # the higher the surer: of `place_filter.FilterMatch`, or with sequences the margin
        ("trust", "<i8"),
        ("misfit", "<i8"),  # of `place_filter.FilterMatch`; -1 with sequences
        ("probability", "<f8"),  # of being right; NaN: not known
        ("lost", "?"),  # below the precision of the settings
    ]
)


# The state of a localiser's kernel, in one tuple.


#: Number of matches after which the kernel returns.
MATCHES_AT_ONCE = 4_096
#: Number of events of a chunk that there is room for at the start.
CHUNK_EVENTS = 4_096
#: Time that is later than the end of any window.
NEVER = np.iinfo(np.int64).max

#: Control of the kernel; times in microseconds.
CONTROL = np.dtype(
    [
        # when to give a match, see `edge_vpr.online.state.MatchSchedule`
        ("every", "<i8"),
        ("interval", "<i8"),
        ("change", "<i8"),
        ("next_tick", "<i8"),  # time of the next match by the interval
        ("last_reported", "<i8"),  # place of the last match
        # search
        ("exclusion", "<i8"),  # width of the zone around the best place
        ("recent", "<i8"),  # number of the newest places that are not searched
        ("least_trust", "<i8"),  # of a match that is not lost
        # place filter
        ("window_end", "<i8"),  # of the present window: a time, or the number of an event
        ("paused", "<i8"),  # whether the window that ended last was a pause
        # events
        ("off_slots", "<i8"),  # first slot of OFF events
        ("floor", "<i8"),  # earliest time that the next event may have
        ("now", "<i8"),  # T: all earlier events have been processed, but for these:
        ("read", "<i8"),  # first of the selected events of a chunk that is not processed yet
        ("selected", "<i8"),  # number of all selected events of the chunk
        ("until", "<i8"),  # time of the last event of the chunk, to which the time advances
    ]
)


class OnlineState(NamedTuple):
    """State of the kernel.

    Attributes
    ----------
    state : FilterState or None
        Of the place filter; None where sequences are matched, as are the next two.
    step : StepTable or None
        Of `Transitions`.
    rows : WindowRows or None
        Of one window; scratch of the place filter.
    length : int or None
        L of sequences; None of the place filter.
    control : ndarray of CONTROL, shape (1,)
        Numbers of the kernel, each by its name.
    trust : ndarray of int64, shape (m,)
        Lowest trust of each step of the probability.
    probability : ndarray of float64, shape (m,)
        Steps of `edge_vpr.confidence.Confidence`; of size 0 where nothing is known.
    table : ndarray of int16 or int32, shape (height, width)
        Of `PixelMap.table`.
    slots, times : ndarray of int32 and int64, shape (CHUNK_EVENTS or more,)
        Selected events of the present chunk.
    out : ndarray of MATCH_DTYPE, shape (MATCHES_AT_ONCE,)
        Matches are written here.
    """

    s: SlidingWindows
    state: FilterState | None
    step: StepTable | None
    rows: WindowRows | None
    length: int | None
    control: npt.NDArray[np.void]
    trust: npt.NDArray[np.int64]
    probability: npt.NDArray[np.float64]
    table: npt.NDArray[np.signedinteger]
    slots: npt.NDArray[np.int32]
    times: npt.NDArray[np.int64]
    out: npt.NDArray[np.void]

    @classmethod
    def begin(
        cls,
        reference: MapRecord,
        s: SlidingWindows,
        schedule: MatchSchedule,
        recent: int = 0,
        place_filter: PlaceFilter | None = None,
    ) -> OnlineState:
        """Build the state before the first event.

        Parameters
        ----------
        s : SlidingWindows
            Of this map.
        schedule : MatchSchedule
            When to give a match.
        recent : int
            So many of the newest places are not searched.
        place_filter : PlaceFilter, optional
            Its arrays are used, not copied.
        """
        settings, acceptance = reference.settings, reference.acceptance
        control = np.zeros(1, dtype=CONTROL).view(np.recarray)
        first = control[0]
        first.every, first.interval = schedule.events, schedule.interval_us
        first.change, first.exclusion = schedule.change, settings.exclusion_places
        first.next_tick, first.last_reported = schedule.interval_us, -1
        first.recent, first.window_end = recent, NEVER
        first.least_trust = -2 * TIME_LIMIT_US
        first.off_slots = len(reference.pixel_map) if settings.polarity else 0
        trust, probability = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.float64)
        if acceptance.confidence is not None:
            # copies, because for Numba a read-only array is of another type
            trust, probability = (
                acceptance.confidence.trust.copy(),
                acceptance.confidence.probability.copy(),
            )
            if acceptance.precision is not None:
                first.least_trust = acceptance.confidence.least_trust(acceptance.precision)
        state = step = rows = None
        length = settings.windows_per_match if place_filter is None else None
        if place_filter is not None:
            state, step = place_filter.state, place_filter.transitions.by_step
            rows = WindowRows.empty(1, len(place_filter))
        return cls(
            s,
            state,
            step,
            rows,
            length,
            control,
            trust,
            probability,
            reference.pixel_map.table(),
            np.empty(CHUNK_EVENTS, dtype=np.int32),
            np.empty(CHUNK_EVENTS, dtype=np.int64),
            np.zeros(MATCHES_AT_ONCE, dtype=MATCH_DTYPE),
        )


# Checks of a saved state of a localiser, before kernels use it as indices.


#: Largest number of counters of all windows of a sequence: 128 MB in the kernels.
MAX_COUNTERS = 1 << 24
#: Largest number of windows x places x counters: minutes of work at the start.
MAX_COMPARISONS = 1 << 36


def check_extent(places: int, counters: int, length: int, recent: int, window: Window) -> None:
    """Refuse sizes that would overflow the kernels' integers, or take too much memory or time.

    Parameters
    ----------
    places, counters, length, recent : int
        K, J (or 2 J), L, and the newest places that are left out.

    Raises
    ------
    UsageError
        If the map is shorter than a sequence, or one of the above is too large.
    """
    if type(recent) is not int or recent < 0 or places < length + recent:
        raise UsageError(
            f"a map of {places} places cannot hold sequences of {length} besides {recent} recent "
            "places: take a shorter sequence or a longer map"
        )
    if length * counters > MAX_COUNTERS or length * places * counters > MAX_COMPARISONS:
        raise UsageError(
            f"sequences of {length} windows of {counters} counters on {places} places are too "
            "much for matching after every event: take a shorter sequence"
        )
    span = window.tau_us if isinstance(window, FixedTime) else window.events
    if length * span > TIME_LIMIT_US:
        raise UsageError(
            f"a sequence of {length} windows of {window} is longer than {TIME_LIMIT_US} us or "
            "events: take shorter windows"
        )


def check_state(
    arrays: Arrays,
    meta: Mapping[str, Any],
    *,
    counters: int,
    length: int,
    ends: int,
    window: Window,
    every: MatchSchedule,
    filtered: bool,
) -> tuple[int, int]:
    """Check that the arrays are a possible state of a localiser.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``slot`` and ``time`` of the events in the windows, ``bound``; of sequences ``policy``.
    meta : mapping
        With ``now_us`` and ``floor_us``.
    counters, length, ends : int
        J (or 2 J), L, and the number of places that a sequence can end at.
    filtered : bool
        Whether the place filter matches, and not sequences.

    Returns
    -------
    now_us, floor_us : int
        T: all events before it have been taken; and the time that no event may be earlier than.

    Raises
    ------
    MapError
        If an array is of another dtype or shape, or holds what no run leaves.
    """
    floor_us = whole_number(meta, "floor_us", 0, TIME_LIMIT_US)
    now_us = whole_number(meta, "now_us", floor_us, floor_us + 1)
    check_array(arrays["slot"], "slot", (np.int32,), (None,))
    n = arrays["slot"].size
    check_range(arrays["slot"], "slot", 0, counters - 1)
    check_array(arrays["time"], "time", (np.int64,), (n,))
    check_range(arrays["time"], "time", 0, min(floor_us, now_us - 1))
    if (np.diff(arrays["time"]) < 0).any():
        raise MapError("time of the events in the windows runs backwards: expected sorted times")
    check_array(arrays["bound"], "bound", (np.int64,), (length + 1,))
    check_range(arrays["bound"], "bound", 0, TIME_LIMIT_US)
    bound = arrays["bound"]
    expected = _bounds(arrays, window, length, now_us)
    if not np.array_equal(bound, expected) or bound[0] - bound[-1] != n:
        raise MapError(
            f"bound is {bound.tolist()} and the {n} events in the windows make it "
            f"{expected.tolist()}"
        )
    if not filtered:  # the place filter has a schedule of its own
        _check_schedule(arrays, "policy", ends, every, floor_us)
    return now_us, floor_us


def _bounds(arrays: Arrays, window: Window, length: int, now_us: int) -> npt.NDArray[np.int64]:
    """Return the number of the event with which each lag begins, shape (L + 1,)."""
    last, n = int(arrays["bound"][0]), arrays["slot"].size
    lags = np.arange(length + 1, dtype=np.int64)
    if isinstance(window, FixedTime):
        return last - n + np.searchsorted(arrays["time"], now_us - lags * window.tau_us)
    return np.maximum(last - lags * window.events, 0)


def filter_state(arrays: Arrays) -> list[int]:
    """Return the numbers of the place filter of a saved localiser, and of finished windows.

    Raises
    ------
    MapError
        If there are others than those of this version, or of one that had no misfit of matches.
    """
    numbers = arrays["filter_state"]
    earlier = len(NUMBER_NAMES)  # without the lasting misfit
    shape = (earlier if numbers.shape == (earlier,) else earlier + 1,)
    check_array(numbers, "filter_state", (np.int64,), shape)
    found: list[int] = numbers.tolist()
    return found if len(found) > earlier else [*found[:-1], USUAL_FIT << LASTING_BITS, found[-1]]


def check_filter_state(
    arrays: Arrays, places: int, window: Window, every: MatchSchedule, floor_us: int
) -> None:
    """Check that the arrays are a possible state of the place filter of a localiser.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Of `FilterRun.to_arrays`.
    places : int
        K.
    floor_us : int
        Until when time has passed.

    Raises
    ------
    MapError
        If an array is of another dtype or shape, or holds what no run leaves.
    """
    check_array(arrays["filter_metric"], "filter_metric", (np.int32,), (places,))
    check_range(arrays["filter_metric"], "filter_metric", 0, METRIC_TOP)
    reciprocal, mean_activity, place, support, *residuals, lasting, windows = filter_state(arrays)
    ended = floor_us // window.tau_us if isinstance(window, FixedTime) else (
        int(arrays["bound"][0]) // window.events
    )  # fmt: skip
    within = (
        0 <= reciprocal <= 1 << RECIPROCAL_BITS
        and 0 <= mean_activity <= TIME_LIMIT_US
        and (0 <= place < places if windows else place == -1)
        and 0 <= support <= TRUST_TOP
        and 0 <= min(residuals) <= max(residuals) <= RESIDUAL_TOP
        and abs(lasting) <= 2 * RESIDUAL_TOP << (TRUST_BITS + LASTING_BITS)
    )
    if not within or windows != ended:
        raise MapError(
            f"filter_state holds {arrays['filter_state'].tolist()} for {places} places after "
            f"{ended} windows: save the state again"
        )
    _check_schedule(arrays, "filter_schedule", places, every, floor_us)
    if "filter_odometer" in arrays:
        check_array(arrays["filter_odometer"], "filter_odometer", (np.int64,), (4,))
        check_range(arrays["filter_odometer"][:2], "filter_odometer", -MOST_MM, MOST_MM)
        check_range(arrays["filter_odometer"][2:], "filter_odometer", 0, 1)
    if "filter_mean" in arrays:
        check_array(arrays["filter_mean_windows"], "filter_mean_windows", (np.int64,), (1,))
        check_range(arrays["filter_mean_windows"], "filter_mean_windows", 0, max(windows, 0))


def _check_schedule(
    arrays: Arrays, name: str, places: int, every: MatchSchedule, floor_us: int
) -> None:
    check_array(arrays[name], name, (np.int64,), (2,))
    tick, place = arrays[name].tolist()
    interval = every.interval_us
    if tick != ((floor_us // interval + 1) * interval if interval else 0):
        raise MapError(f"the state says the next time for a match is {tick} us, at {floor_us} us")
    if not -1 <= place < places:
        raise MapError(f"the state names the place {place}: expected -1 to {places - 1}")
