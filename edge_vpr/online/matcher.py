"""The matcher of the localiser: its state, one kernel over events, and what needs Python."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays, check_array, check_range
from edge_vpr.compiling import KernelState, entry, kernel, plain
from edge_vpr.descriptors.windows import MAX_WINDOWS, FixedTime, Window, narrow
from edge_vpr.errors import EdgeVprError, MapError, UsageError
from edge_vpr.events import EVENT_DTYPE, TIME_LIMIT_US, Events
from edge_vpr.map_record import MapRecord
from edge_vpr.matching.distances import aligned_zeros
from edge_vpr.matching.drive import FixedLag, Late, filter_of
from edge_vpr.matching.place_filter import (
    LASTING_BITS,
    NUMBER_NAMES,
    USUAL_FIT,
    FilterMatch,
    FilterState,
    PlaceFilter,
    StepTable,
    WindowRows,
)
from edge_vpr.online.kernels import (
    BLOCK,
    LANES,
    MAX_STEPS,
    acceptance,
    advance,
    age,
    match_now,
    note,
    recode,
    selected_in_order,
    settle,
    take_moves,
    write_codes,
    write_distances,
)
from edge_vpr.route import Odometer
from edge_vpr.settings import Settings, duration_us
from fixedpoint.codes import PixelCodes
from fixedpoint.own_mean import OwnMeanCode, RunningMean

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
        # when to give a match, see `MatchSchedule`
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


# The kernel of the localiser: converts events to matches without returning to Python.


# why the kernel returned
DONE, MATCHES_FULL, RING_FULL, WINDOW_OVER, REFUSED = range(5)
#: in place of a time
GO_ON = -1

Stop = tuple[int, int, int]
"""Result of `follow`."""


@kernel
def follow(box, events, until):
    """Process events, or go on with those of an earlier call; stop where Python is needed.

    Parameters
    ----------
    box : BoxedState
        Of `OnlineState`; its arrays are changed in place.
    events : ndarray of EVENT_DTYPE, shape (m,)
        As many as `OnlineState.slots` has room for.
    until : int
        Without events: time to advance to, or `GO_ON` with what `OnlineState.control` says is left
        of an earlier call.

    Returns
    -------
    given, why : int
        Matches written to `OnlineState.out`, and `DONE`, `MATCHES_FULL`, `RING_FULL`,
        `WINDOW_OVER`: the place filter has ended a window; or `REFUSED`: an event is off the
        sensor, not in the order of time, or over more ticks than may be, and nothing was taken.
    until : int
        Time of the last event, selected or not.
    """
    f = OnlineState(*box.value)
    s, c, out = SlidingWindows(*f.s), f.control[0], f.out
    if events.size > 0:
        last = events[events.size - 1]["t"]
        selected = selected_in_order(f.table, events, c.floor, c.off_slots, f.slots, f.times)
        if selected < 0 or (c.interval > 0 and (last - c.next_tick) // c.interval > MAX_WINDOWS):
            return 0, REFUSED, last
        c.floor, c.until, c.now, c.read, c.selected = last, last, last + 1, 0, selected
    elif until != GO_ON:
        c.floor, c.until, c.now, c.read, c.selected = until, until, max(c.now, until), 0, 0
    slots, times, until = f.slots, f.times, c.until
    ring_slot, ring_time, bound = s.slot, s.time, s.bound
    moves, totals, counts, code, counters = s.moves, s.totals, s.counts, s.code, s.counters
    columns, sums, steps = s.columns, s.sums, s.steps
    own = OwnCodes(*s.own)
    state, step, rows, length = f.state, f.step, f.rows, f.length
    tau, n, windows, mask = s.tau, s.n, s.counts.shape[0], s.slot.size - 1
    given, i, end = 0, c.read, c.selected
    # counted down, because a division would take as long as the rest of an event's processing
    left = c.every - bound[0] % c.every if c.every > 0 else np.int64(-1)
    # each iteration is a tick or an event, until there are no more of either
    while True:
        now = times[i] if i < end else until
        tick = c.interval > 0 and c.next_tick <= now
        now = c.next_tick if tick else now
        seen_until = now if tick else now + 1
        # a tick at the end of a window belongs to it; an event at the same time to the next window
        over = seen_until > c.window_end if tau > 0 else bound[0] >= c.window_end
        why = DONE
        if over:
            seen_until = c.window_end
        elif not tick and i == end:
            break
        why = MATCHES_FULL
        if given == len(out):
            break
        room = 0 if tick or over else n
        while not (
            age(ring_time, ring_slot, bound, moves, totals, tau, room, seen_until)
            and totals[0].moves < len(moves)
        ):
            take_moves(moves, totals, counts, code, counters, columns, sums, steps)
        if tick and not over:
            c.next_tick += c.interval
        elif not over:
            why = RING_FULL
            if bound[0] - bound[windows] > mask:
                break
            ring_slot[bound[0] & mask] = slots[i]
            ring_time[bound[0] & mask] = now
            bound[0] += 1
            note(moves, totals, slots[i], -1)
            i += 1
            left -= 1
            if left != 0:
                continue
            left = c.every
        complete = seen_until >= windows * tau if tau > 0 else bound[0] >= windows * n
        if not complete:
            continue
        take_moves(moves, totals, counts, code, counters, columns, sums, steps)
        if own.levels.size > 0:
            recode(own, counts, totals, counters, columns, sums, steps)
        row, in_window = out[given], bound[0] - bound[1]
        if match_now(state, step, rows, sums, totals[0], c, length, in_window, over, row):
            row["time_us"], row["events"] = now, in_window
            # start of a fixed-count window: the time of its oldest event
            row["start_us"] = seen_until - tau if tau > 0 else ring_time[bound[1] & mask]
            acceptance(row, f.trust, f.probability, c.least_trust)
            given += 1
        why = WINDOW_OVER
        if over:
            break
    c.read = i
    return given, why, until


# Feeds events to the kernel, and does the work at its stops that needs Python.


Found = list[npt.NDArray[np.void]]
_NO_EVENTS = np.empty(0, dtype=EVENT_DTYPE)


class MatchRun:
    """Matches by the sequence of the newest L windows; holds the state of the localiser.

    Counters and distances are updated when they are read. They are then those at the time
    `now_us`; all earlier events have been processed.

    Parameters
    ----------
    schedule : MatchSchedule
        When to give a match.
    recent : int
        So many of the newest places are not searched.
    place_filter : PlaceFilter, optional
        What matches in place of sequences, see `FilterRun`.

    Attributes
    ----------
    places : ndarray of unsigned int, shape (K, J)
        Those of the map, and those that were appended.
    state : OnlineState
        In its place comes another one where an array has to grow.
    boxed : BoxedState
        The same for `follow`; call `go_on` after it.
    """

    #: Name of the array of the schedule in an archive.
    schedule_name = "policy"

    def __init__(
        self,
        reference: MapRecord,
        window: Window,
        schedule: MatchSchedule,
        recent: int = 0,
        place_filter: PlaceFilter | None = None,
    ) -> None:
        self.places, self._codes = reference.places.counts, reference.codes
        windows = start(
            self.places, window, reference.settings.windows_per_match,
            reference.own_mean_code or self._codes, reference.mean,
        )  # fmt: skip
        state = OnlineState.begin(reference, windows, schedule, recent, place_filter)
        # not as a record array, whose fields take 1 us each
        self._control = np.asarray(state.control).view(CONTROL)[0]
        self._out = state.out.view(np.uint8).data
        self._hold(state)

    def _hold(self, state: OnlineState) -> None:
        self.state, self.boxed = state, KernelState(state).boxed
        self._follow: Callable[..., Stop] = entry(follow, self.boxed, _NO_EVENTS, GO_ON)

    @property
    def next_tick(self) -> int:
        """Time of the next match by the interval of the schedule, in microseconds."""
        return int(self._control["next_tick"])

    @next_tick.setter
    def next_tick(self, time_us: int) -> None:
        self._control["next_tick"] = time_us

    @property
    def floor_us(self) -> int:
        """Earliest time that the next event may have."""
        return int(self._control["floor"])

    @property
    def now_us(self) -> int:
        """T: all earlier events have been processed."""
        return int(self._control["now"])

    def follow(self, events: Events) -> Stop:
        """Call the kernel of this name, with events in one piece that may be written to."""
        if events.size > self.state.slots.size:
            # of this room, memory is taken only where selected events are written
            slots, times = np.empty(events.size, np.int32), np.empty(events.size, np.int64)
            self._hold(self.state._replace(slots=slots, times=times))
        return self._follow(self.boxed, events, GO_ON)

    def advance(self, until_us: int) -> Found:
        """Advance the time without events."""
        return self.go_on(self._follow(self.boxed, _NO_EVENTS, until_us))

    def go_on(self, stop: Stop) -> Found:
        """Call the kernel until all events are processed, and return all matches.

        Parameters
        ----------
        stop : tuple
            Of the first call, which is not that the events are refused.

        Returns
        -------
        list of ndarray of MATCH_DTYPE
        """
        found = []
        while True:
            given, why, _ = stop
            if given:
                found.append(self._taken(given))
            if why == DONE:
                return found
            if why == RING_FULL:
                self._hold(self.state._replace(s=grown(self.state.s)))
            elif why == WINDOW_OVER:
                self._window_over()
            stop = self._follow(self.boxed, _NO_EVENTS, GO_ON)

    def finish(self) -> Found:
        """Return the matches of windows that wait for later ones, at the end of a drive."""
        return []

    def _taken(self, given: int) -> npt.NDArray[np.void]:
        # as bytes, because NumPy copies records field by field
        room = bytearray(self._out[: given * MATCH_DTYPE.itemsize])
        return np.frombuffer(room, dtype=MATCH_DTYPE)

    def _window_over(self) -> None:
        """Do what is left to do when the place filter has ended a window."""
        raise NotImplementedError

    def settled(self) -> SlidingWindows:
        """Return the windows, with counters and distances of the present time."""
        advance(self.state.s, self.now_us)
        settle(self.state.s)
        return self.state.s

    def distance_sums(self) -> npt.NDArray[np.int64]:
        """Return the distance of the sequence that ends at each place, shape (K - L + 1,)."""
        s = self.settled()
        return s.sums[: s.totals["sums"][0]].astype(np.int64) + s.totals["common"][0]

    def append(self, counts: npt.NDArray[np.integer]) -> None:
        """Add a place at the end of the map.

        Parameters
        ----------
        counts : ndarray of int, shape (J,)
            Its descriptor, in codes where the map has a code.

        Raises
        ------
        MapError
            If the descriptor has another length, or holds what the map cannot.
        """
        if counts.shape != self.places.shape[1:] or counts.dtype.kind not in "iu":
            raise MapError(
                f"descriptor of {counts.dtype} and shape {counts.shape}: expected "
                f"{self.places.shape[1]} whole numbers, as `DescriptorStream` gives them"
            )
        most = np.iinfo(np.int32).max if self._codes is None else int(self._codes.tables.max())
        if counts.min() < 0 or counts.max() > most:
            raise MapError(
                f"descriptor holds {counts.min()} to {counts.max()}: expected 0 to {most}, in "
                "codes where the map has a code"
            )
        wide = np.promote_types(self.places.dtype, narrow(counts).dtype)
        self.places = np.concatenate([self.places.astype(wide), counts[None].astype(wide)])
        self._hold(self.state._replace(s=with_distances(self.settled(), self.places)))

    def verify(self) -> None:
        """Recompute counters and distances from the events in the windows, and compare.

        Raises
        ------
        EdgeVprError
            If anything differs, which no sequence of events can bring about.
        """
        s = self.settled()
        fresh = with_distances(s, self.places)
        used = slice(fresh.totals["sums"][0])
        same = (
            np.array_equal(recount(s), s.counts)
            and np.array_equal(fresh.sums[used], s.sums[used])
            and fresh.totals["common"] == s.totals["common"]
        )
        if not same:
            raise EdgeVprError(
                f"counters or distances have drifted by {self.now_us} us: this is a fault of "
                "edge-vpr, report it with the recording"
            )

    def to_arrays(self) -> Arrays:
        """Return the arrays that `resume` needs, for an archive."""
        s, control = self.settled(), self._control
        alive = np.arange(s.bound[-1], s.bound[0]) & (s.slot.size - 1)
        schedule = np.array([control["next_tick"], control["last_reported"]], dtype=np.int64)
        return {
            "places": self.places,
            "slot": s.slot[alive],
            "time": s.time[alive],
            "bound": s.bound,
            self.schedule_name: schedule,
        }

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Restore the state from the arrays of `to_arrays`; the map has the saved places."""
        self._control["now"], self._control["floor"] = now_us, floor_us
        tick, place = arrays[self.schedule_name].tolist()
        self._control["next_tick"], self._control["last_reported"] = tick, place
        s, first = self.state.s, int(arrays["bound"][-1])
        while s.slot.size < arrays["slot"].size:
            s = grown(s)
        at = np.arange(first, first + arrays["slot"].size) & (s.slot.size - 1)
        s.slot[at] = arrays["slot"]
        s.time[at] = arrays["time"]
        s.bound[:] = arrays["bound"]
        s.counts[:] = recount(s)
        self._hold(self.state._replace(s=with_distances(s, self.places)))


# The place filter event by event: within windows, and at the end of each window.


class FilterRun(MatchRun):
    """Matches by the place filter, within windows too.

    Attributes
    ----------
    mean : RunningMean or None
        Of own-mean codes.
    """

    schedule_name = "filter_schedule"

    def __init__(self, reference: MapRecord, window: Window, schedule: MatchSchedule) -> None:
        self.place_filter = filter_of(
            reference.places, reference.settings, reference.jumps, reference.along_mm
        )
        super().__init__(reference, window, schedule, place_filter=self.place_filter)
        self.odometer = Odometer()
        self._code = reference.own_mean_code
        self.mean = None
        if self._code is not None and reference.mean is not None:
            self.mean = RunningMean(reference.mean)
        self._windows = 0  # finished
        self._silence: tuple[object, ...] = ()  # the filter after a window without events
        self._set_window_end()

    def read_odometer(self, distance_mm: int) -> None:
        """Take a reading; until the window ends, places are predicted by the distance driven.

        Raises
        ------
        UsageError
            If the map does not say how far its places are from each other.
        """
        self.place_filter.transitions.check_odometry()
        self.odometer.read(distance_mm)
        self._travel()

    def _travel(self) -> None:
        travelled = self.odometer.travelled_mm
        if travelled is not None:
            self.place_filter.predict_travelled(travelled)

    def _set_window_end(self) -> None:
        s = self.state.s
        self._control["window_end"] = (self._windows + 1) * (s.tau or s.n)

    def _window_over(self) -> None:
        s, read = self.state.s, self.odometer.fresh
        self._windows += 1
        self.odometer.end_window()
        if self.mean is not None and self._code is not None and not self._control["paused"]:
            self.mean.update(self._code.level(s.counts[0]))
            s.own.means[:] = self.mean.mean
        if s.tau and s.bound[0] == s.bound[1]:
            self._skip_silence(read)
        else:
            self._silence = ()
        self._set_window_end()

    def _skip_silence(self, odometry: bool) -> None:
        """Skip windows without events, as soon as they change nothing any more."""
        found, c = self.place_filter, self._control
        before = self._silence
        self._silence = found.numbers, found.state.metric.tobytes()
        if self._silence == before and not odometry:
            read, until = c["read"], c["until"]
            if read < c["selected"]:
                until = self.state.times[read]
            if c["interval"]:
                until = min(until, c["next_tick"])
            self._windows = max(self._windows, int(until) // self.state.s.tau - 1)

    def to_arrays(self) -> Arrays:
        """Return the arrays that `resume` needs, for an archive."""
        found, meter = self.place_filter, self.odometer
        state = [*found.numbers, self._windows]
        arrays = super().to_arrays() | {
            "filter_metric": found.state.metric,
            "filter_state": np.array(state, dtype=np.int64),
        }
        if meter.fresh or meter.anchored:
            state = [meter.latest, meter.anchor, meter.fresh, meter.anchored]
            arrays["filter_odometer"] = np.array(state, dtype=np.int64)
        if self.mean is not None:
            arrays["filter_mean"] = self.mean.total
            arrays["filter_mean_windows"] = np.array([self.mean.windows], dtype=np.int64)
        return arrays

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Restore the state from the arrays of `to_arrays`."""
        found = self.place_filter
        *numbers, self._windows = filter_state(arrays)
        found.resume(arrays["filter_metric"], numbers)
        if "filter_odometer" in arrays:
            found.transitions.check_odometry()
            meter = self.odometer
            meter.latest, meter.anchor, fresh, anchored = arrays["filter_odometer"].tolist()
            meter.fresh, meter.anchored = bool(fresh), bool(anchored)
            self._travel()
        self._set_window_end()
        if self.mean is not None:
            check_array(arrays["filter_mean"], "filter_mean", (np.int32,), self.mean.total.shape)
            check_range(arrays["filter_mean"], "filter_mean", 0, np.iinfo(np.int32).max)
            self.mean.total = arrays["filter_mean"].copy()
            self.mean.windows = int(arrays["filter_mean_windows"][0])
            self.state.s.own.means[:] = self.mean.mean
        super().resume(arrays, now_us, floor_us)


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


# The place filter event by event, with matches that come some windows late.


class DelayedRun(FilterRun):
    """Gives the match of each window when N more windows have ended.

    The kernel gives a match at the end of each window. Its time and events are kept, and its place
    and trust are replaced by those of `FixedLag`.

    Parameters
    ----------
    reference : MapRecord
        Its settings say N.
    schedule : MatchSchedule
        At the end of each window.

    Raises
    ------
    UsageError
        If matches are wanted at other times.
    """

    def __init__(self, reference: MapRecord, window: Window, schedule: MatchSchedule) -> None:
        settings = reference.settings
        if schedule != MatchSchedule.window(settings):
            raise UsageError(
                f"a delay of {settings.delay} windows gives a match at the end of each window: "
                "match every window, or set delay to 0"
            )
        super().__init__(reference, window, schedule)
        self._lag = FixedLag(
            self.place_filter.transitions, settings.exclusion_places, settings.late
        )
        self._given: np.void | None = None  # by the kernel, of the window that ends
        self._undecided: deque[np.void | None] = deque()  # None of a window that was skipped
        self._decided: list[np.void] = []

    def go_on(self, stop: Stop) -> Found:
        """See `MatchRun.go_on`."""
        super().go_on(stop)
        return self._drained()

    def finish(self) -> Found:
        """See `MatchRun.finish`."""
        self._decide(self._lag.finish())
        return self._drained()

    def _taken(self, given: int) -> npt.NDArray[np.void]:
        rows = super()._taken(given)
        (self._given,) = rows
        return rows[:0]

    def _window_over(self) -> None:
        assert self.state.rows is not None
        self._undecided.append(self._given)
        self._given = None
        self._decide(self._lag.add(self.state.rows, [self.odometer.travelled_mm]))
        super()._window_over()

    def _decide(self, late: Late) -> None:
        for column in late[0].tolist():
            row, match = self._undecided.popleft(), FilterMatch(*column)
            if row is None:
                continue
            row["place"], row["second"] = match.place, match.second
            row["trust"], row["misfit"] = match.trust, match.misfit
            plain(write_distances)(row, match.metric, match.second_metric, 1)
            trust, probability = self.state.trust, self.state.probability
            plain(acceptance)(row, trust, probability, self._control["least_trust"])
            self._decided.append(row)

    def _drained(self) -> Found:
        decided, self._decided = self._decided, []
        return [np.array(decided, dtype=MATCH_DTYPE)] if decided else []

    def to_arrays(self) -> Arrays:
        """Raise UsageError: the windows that wait for later ones are not saved."""
        raise UsageError(
            "a localiser with a delay cannot be saved: set delay to 0, or keep the events"
        )

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Raise MapError: no state holds the windows that wait."""
        raise MapError("the state has a delay, with which none can be saved")
