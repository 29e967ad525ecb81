"""A match after every event: distances are changed by what the event changes, not recomputed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from edge_vpr.archive import Arrays, read_archive, write_archive
from edge_vpr.counters import select_events
from edge_vpr.errors import EdgeVprError, EventError, MapError, UsageError
from edge_vpr.events import Events, Sensor
from edge_vpr.incremental import BLOCK, LANES, MAX_STEPS, least_in
from edge_vpr.matcher import ReferenceIndex
from edge_vpr.pipeline import window_of
from edge_vpr.pixels import PixelMap
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from edge_vpr.sliding import (
    BASE,
    MAX_MOVES,
    MOVES,
    RING_EVENTS,
    Sliding,
    advance,
    age,
    settle,
    take_moves,
)
from edge_vpr.windows import MAX_WINDOWS, Descriptors, FixedTime, narrow

#: One match: time in microseconds; best place (ties: the lowest) and the best one outside the
#: exclusion zone (-1: none); their distances, summed over the L windows of the sequence; best over
#: second; events at the selected pixels in the newest window.
MATCH_DTYPE = np.dtype(
    [
        ("t", "<i8"),
        ("place", "<i8"),
        ("distance_sum", "<i8"),
        ("second", "<i8"),
        ("second_sum", "<i8"),
        ("ratio", "<f8"),
        ("events", "<i8"),
    ]
)
KIND = "localiser state"

_MATCHES_AT_ONCE = 1_024
# why the kernel returned
_DONE, _MATCHES_FULL, _RING_FULL = range(3)
# indices into the array of the policy's state
_NEXT_TICK, _LAST_PLACE = range(2)


@dataclass(frozen=True)
class Every:
    """When to say where we are; at least one of them.

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
        if self.events < 0 or self.interval_us < 0 or not (self.events or self.interval_us):
            raise UsageError(
                f"a match every {self.events} events and every {self.interval_us} us: "
                "expected a positive number of one of them"
            )

    @classmethod
    def window(cls, settings: Settings) -> Every:
        """At the end of every window of the main job, which makes the windows not overlap."""
        if settings.window == "time":
            return cls(interval_us=settings.tau_us)
        return cls(events=settings.events_per_window)


class Localiser:
    """Follows a stream of events and says where it is on the map.

    It keeps the counters of the newest L windows, one behind the other (`edge_vpr.sliding`), and
    the distance of that sequence to every place. An event changes each distance by a few times +-1,
    so that the best place is known after it without a new comparison.

    Parameters
    ----------
    reference : ReferenceMap
        Its settings say the window, the sequence length, the exclusion zone, and the code of
        its counts.
    every : Every
        When to give a match. None is given before the L windows are complete.
    recent : int
        So many of the map's newest places are left out of the search; for a rover that appends
        places while it drives.
    check_every : int
        For debugging: after so many selected events, recompute everything and compare.

    Examples
    --------
    >>> localiser = Localiser(reference, every=Every(events=1))       # doctest: +SKIP
    >>> for events in recording:                                      # doctest: +SKIP
    ...     for match in localiser.update(events):
    ...         print(match["t"], match["place"], match["ratio"])
    """

    def __init__(
        self,
        reference: ReferenceMap,
        *,
        every: Every | None = None,
        recent: int = 0,
        check_every: int = 0,
    ) -> None:
        settings = reference.settings
        self.settings = settings
        self.every = Every(events=1) if every is None else every
        self._recent = recent
        self._check_every = check_every
        self._pixel_map = reference.pixel_map
        self._table = reference.pixel_map.table()
        self._window = window_of(settings)
        self._length = settings.sequence_length
        self._full_scale = reference.full_scale
        self._codes = reference.codes
        self._places = reference.places.counts
        if len(self._places) < self._length + recent or recent < 0:
            raise UsageError(
                f"a map of {len(self._places)} places cannot hold sequences of {self._length} "
                f"besides {recent} recent places: take a shorter sequence or a longer map"
            )
        self._policy = np.array([self.every.interval_us, -1], dtype=np.int64)
        self._now = 0
        self._s = self._empty()
        self._out = np.empty(_MATCHES_AT_ONCE, dtype=MATCH_DTYPE)

    def __len__(self) -> int:
        return len(self._places)

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """Events in each window, newest first, shape (L, J); a copy."""
        settle(self._s)
        return self._s.counts.copy()

    @property
    def distance_sums(self) -> npt.NDArray[np.int64]:
        """Distance of the sequence that ends at each place, shape (K - L + 1,).

        Element m belongs to place m + L - 1.
        """
        settle(self._s)
        sums = self._s.sums[: len(self._places) - self._length + 1].astype(np.int64)
        return sums + self._s.number[BASE]

    @property
    def complete(self) -> bool:
        """Whether the L windows are complete, so that matches are given."""
        if isinstance(self._window, FixedTime):
            return self._now >= self._length * self._window.tau_us
        return bool(self._s.bound[0] >= self._length * self._window.events)

    def update(self, events: Events) -> npt.NDArray[np.void]:
        """Feed the next events.

        Parameters
        ----------
        events : ndarray with fields t, x, y and, for polarity, p; shape (n,)
            In time order, after all those before; any number of them.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
            The matches that the policy asks for, in order.

        Raises
        ------
        EventError
            If time runs backwards or a pixel lies off the sensor; the state is then as it was.
        UsageError
            If time jumps over more than ten million ticks of the policy.
        """
        if events.size == 0:
            return np.empty(0, dtype=MATCH_DTYPE)
        t = events["t"]
        if t[0] < self._now - 1 or t[-1] < t[0]:
            raise EventError(
                f"time runs backwards, from {self._now - 1} to {min(t[0], t[-1])} us: sort the "
                "events, or drop the late ones"
            )
        self._check_ticks(int(t[-1]))
        p = events["p"] if self.settings.polarity else None
        index, slots = select_events(self._table, events["x"], events["y"], p)
        times = t[index]
        if np.any(times[1:] < times[:-1]) or (times.size and times[-1] > t[-1]):
            raise EventError("time runs backwards within the chunk: sort the events, or drop some")
        matches = self._run(slots, times, int(t[-1]))
        self._now = int(t[-1]) + 1
        advance(self._s, self._now)
        return matches

    def advance(self, until_us: int) -> npt.NDArray[np.void]:
        """Let time pass without events, to T = `until_us`; the ticks until then give matches.

        Parameters
        ----------
        until_us : int
            Not earlier than the last event.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
        """
        if until_us < self._now:
            raise EventError(f"time runs backwards, from {self._now} to {until_us} us")
        self._check_ticks(until_us)
        nothing = np.empty(0, dtype=np.int64)
        matches = self._run(nothing.astype(np.int32), nothing, until_us)
        advance(self._s, until_us)
        self._now = until_us
        return matches

    def append(self, counts: npt.NDArray[np.integer]) -> int:
        """Add a place at the end of the map.

        Parameters
        ----------
        counts : ndarray of int, shape (J,)
            Its descriptor, in codes where the localiser has a code.

        Returns
        -------
        int
            Number of the new place.

        Raises
        ------
        MapError
            If the descriptor has another length.
        """
        if counts.shape != self._places.shape[1:] or counts.min() < 0:
            raise MapError(
                f"descriptor of shape {counts.shape}: expected {self._places.shape[1:]} counts"
            )
        wide = np.promote_types(self._places.dtype, narrow(counts).dtype)
        self._places = np.concatenate([self._places.astype(wide), counts[None].astype(wide)])
        settle(self._s)
        self._s = self._with_distances(self._s)
        return len(self._places) - 1

    def save(self, path: str | Path) -> None:
        """Write the map and the state, so that `load` goes on as this localiser would.

        Parameters
        ----------
        path : path
            An ``.npz`` file, written atomically.
        """
        first, last = int(self._s.bound[-1]), int(self._s.bound[0])
        alive = np.arange(first, last) & (self._s.slot.size - 1)
        arrays = {
            "pixel_x": self._pixel_map.x,
            "pixel_y": self._pixel_map.y,
            "places": self._places,
            "slot": self._s.slot[alive],
            "time": self._s.time[alive],
            "bound": self._s.bound,
            "policy": self._policy,
        }
        if self._full_scale is not None:
            arrays["full_scale"] = self._full_scale
        meta = {
            "sensor": list(self._pixel_map.sensor),
            "settings": self.settings.to_dict(),
            "every": asdict(self.every),
            "recent": self._recent,
            "now_us": self._now,
        }
        write_archive(path, KIND, arrays, meta)

    @classmethod
    def load(cls, path: str | Path, *, check_every: int = 0) -> Localiser:
        """Read what `save` wrote, and go on from there.

        Raises
        ------
        MapError
            If the file is missing, unreadable, or from a newer version.
        """
        arrays, meta = read_archive(path, KIND)
        try:
            found = cls(
                _bare_map(arrays, meta, str(path)),
                every=Every(**meta["every"]),
                recent=meta["recent"],
                check_every=check_every,
            )
            found._resume(arrays, meta["now_us"])
        except KeyError as error:
            raise MapError(f"{path} lacks {error}: save the state again") from error
        return found

    def _resume(self, arrays: Arrays, now_us: int) -> None:
        bound = arrays["bound"]
        first = int(bound[-1])
        while self._s.slot.size < arrays["slot"].size:
            self._s = _grown(self._s)
        at = np.arange(first, first + arrays["slot"].size) & (self._s.slot.size - 1)
        self._s.slot[at] = arrays["slot"]
        self._s.time[at] = arrays["time"]
        self._s.bound[:] = bound
        self._s.counts[:] = self._recount()
        self._policy[:] = arrays["policy"]
        self._now = now_us
        self._s = self._with_distances(self._s)

    def _run(
        self, slots: npt.NDArray[np.int32], times: npt.NDArray[np.int64], until: int
    ) -> npt.NDArray[np.void]:
        """Feed selected events, then the ticks up to `until`, in pieces that fit the buffers."""
        found = []
        step = self._check_every or max(slots.size, 1)
        for start in range(0, max(slots.size, 1), step):
            stop = min(start + step, slots.size)
            last = stop == slots.size
            found += self._run_piece(
                slots[start:stop], times[start:stop], until if last else int(times[stop - 1])
            )
            if self._check_every:
                self.verify()
        return np.concatenate(found) if len(found) > 1 else found[0]

    def _run_piece(
        self, slots: npt.NDArray[np.int32], times: npt.NDArray[np.int64], until: int
    ) -> list[npt.NDArray[np.void]]:
        found, consumed = [], 0
        while True:
            read, given, why = _localise(
                self._s,
                slots[consumed:],
                times[consumed:],
                until,
                self.every.events,
                self.every.interval_us,
                self.every.change,
                self.settings.exclusion,
                len(self._places) - self._length + 1 - self._recent,
                self._policy,
                self._out,
            )
            consumed += read
            found.append(self._out[:given].copy())
            if why == _RING_FULL:
                self._s = _grown(self._s)
            elif why == _DONE:
                return found

    def verify(self) -> None:
        """Recompute counters and distances from the events in the windows, and compare.

        Raises
        ------
        EdgeVprError
            If anything differs, which no sequence of events can bring about.
        """
        settle(self._s)
        fresh = self._with_distances(self._s)
        same = (
            np.array_equal(self._recount(), self._s.counts)
            and np.array_equal(fresh.sums[: fresh.shape[1]], self._s.sums[: fresh.shape[1]])
            and fresh.number[BASE] == self._s.number[BASE]
        )
        if not same:
            raise EdgeVprError(
                f"counters or distances have drifted by {self._now} us: this is a fault of "
                "edge-vpr, report it with the recording"
            )

    def _recount(self) -> npt.NDArray[np.int64]:
        """Count the events in the ring, window by window."""
        counts = np.zeros_like(self._s.counts)
        for lag in range(self._length):
            numbers = np.arange(self._s.bound[lag + 1], self._s.bound[lag])
            slots = self._s.slot[numbers & (self._s.slot.size - 1)]
            counts[lag] = np.bincount(slots, minlength=counts.shape[1])
        return counts

    def _empty(self) -> Sliding:
        """Build the state before the first event."""
        counters = self._places.shape[1]
        tables, row = np.empty((1, 0), dtype=np.uint16), np.zeros(counters, dtype=np.uint8)
        if self._codes is not None:
            tables, row = self._codes.tables, self._codes.row.copy()
        no_sums, none = np.empty(0, dtype=np.uint16), np.empty(0, dtype=np.int64)
        empty = Sliding(
            slot=np.zeros(RING_EVENTS, dtype=np.int32),
            time=np.zeros(RING_EVENTS, dtype=np.int64),
            bound=np.zeros(self._length + 1, dtype=np.int64),
            moves=np.zeros((MAX_MOVES, 2), dtype=np.int32),
            counts=np.zeros((self._length, counters), dtype=np.int64),
            tau=self._window.tau_us if isinstance(self._window, FixedTime) else 0,
            n=0 if isinstance(self._window, FixedTime) else self._window.events,
            code=tables,
            row=row,
            columns=np.empty(0, dtype=np.uint8),
            low=none,
            high=none,
            sums=no_sums,
            block_least=no_sums,
            offset=np.zeros(MAX_STEPS, dtype=np.int64),
            level=np.empty(0, dtype=np.uint8),
            number=np.zeros(2, dtype=np.int64),
            shape=np.zeros(2, dtype=np.int64),
        )
        return self._with_distances(empty)

    def _with_distances(self, s: Sliding) -> Sliding:
        """Lay the map out by pixel and compute every distance of the present counters."""
        places, length = self._places, self._length
        count, stride = len(places) - length + 1, len(places) + LANES
        columns = np.zeros(places.shape[1] * stride + LANES, dtype=places.dtype)
        columns[: places.shape[1] * stride].reshape(-1, stride)[:, : len(places)] = places.T
        low, high = places.min(axis=0).astype(np.int64), places.max(axis=0).astype(np.int64)

        codes = s.counts
        if self._codes is not None:
            codes = self._codes.encode(s.counts).astype(np.int64)
        index = ReferenceIndex(places)
        sums = np.zeros(count, dtype=np.int64)
        for lag in range(length):
            end = length - 1 - lag
            sums += index.distances(codes[lag])[end : end + count]
        base = int(np.abs(codes - np.clip(codes, low, high)).sum())
        largest = length * int((high - low).sum())
        dtype: type[np.unsignedinteger] = (
            np.uint16 if largest <= np.iinfo(np.uint16).max else np.uint32
        )

        padded: npt.NDArray[np.unsignedinteger] = np.zeros(count + LANES, dtype=dtype)
        padded[:count] = sums - base
        blocks = padded[: count - count % BLOCK].reshape(-1, BLOCK)
        return s._replace(
            columns=columns,
            low=low,
            high=high,
            sums=padded,
            block_least=blocks.min(axis=1) if len(blocks) else np.zeros(1, dtype=dtype),
            level=np.zeros(MAX_STEPS, dtype=places.dtype),
            number=np.array([base, 0], dtype=np.int64),
            shape=np.array([stride, count], dtype=np.int64),
        )

    def _check_ticks(self, until: int) -> None:
        interval = self.every.interval_us
        if interval and (until - self._policy[_NEXT_TICK]) // interval > MAX_WINDOWS:
            raise UsageError(
                f"time jumps to {until} us, over more than {MAX_WINDOWS} matches every {interval} "
                "us: check the recording's clock, or ask for fewer matches"
            )


def _bare_map(arrays: Arrays, meta: Mapping[str, Any], source: str) -> ReferenceMap:
    """Build a map of what a localiser needs of it, without times and figures."""
    sensor = Sensor(*meta["sensor"])
    no_times = np.zeros(len(arrays["places"]), dtype=np.int64)
    return ReferenceMap(
        Settings.from_dict(meta["settings"], source),
        PixelMap(sensor, arrays["pixel_x"], arrays["pixel_y"]),
        Descriptors(arrays["places"], no_times, no_times, no_times),
        saliency=np.zeros((sensor.height, sensor.width), dtype=np.float32),
        hot=np.zeros((sensor.height, sensor.width), dtype=np.bool_),
        full_scale=arrays.get("full_scale"),
    )


def _grown(s: Sliding) -> Sliding:
    """Double the ring."""
    numbers = np.arange(s.bound[-1], s.bound[0])
    old, size = numbers & (s.slot.size - 1), 2 * s.slot.size
    slot, time = np.zeros(size, dtype=np.int32), np.zeros(size, dtype=np.int64)
    slot[numbers & (size - 1)] = s.slot[old]
    time[numbers & (size - 1)] = s.time[old]
    return s._replace(slot=slot, time=time)


@njit(cache=True, nogil=True)
def _localise(  # type: ignore[no-untyped-def]
    s, slots, times, until, every, interval, change, exclusion, places, policy, out
):
    """Feed selected events, then let time pass to `until`; stop where a buffer is full."""
    ring_slot, ring_time, bound, moves, number = s.slot, s.time, s.bound, s.moves, s.number
    counts, code, row, low, high, columns = s.counts, s.code, s.row, s.low, s.high, s.columns
    sums, block_least, offset, level, shape = s.sums, s.block_least, s.offset, s.level, s.shape
    tau, n, length, mask = s.tau, s.n, s.counts.shape[0], s.slot.size - 1
    given, i = 0, 0
    # one turn is a tick, or the next event, until both have come to an end
    while True:
        now = times[i] if i < slots.size else until
        tick = interval > 0 and policy[_NEXT_TICK] <= now
        if not tick and i == slots.size:
            return i, given, _DONE
        if given == out.size:
            return i, given, _MATCHES_FULL
        now = policy[_NEXT_TICK] if tick else now
        seen_until = now if tick else now + 1
        while not (
            age(ring_time, ring_slot, bound, moves, number, tau, 0 if tick else n, seen_until)
            and number[MOVES] < len(moves)
        ):
            take_moves(
                moves, counts, code, row, low, high, columns, sums, block_least, offset, level,
                number, shape,
            )  # fmt: skip
        if tick:
            policy[_NEXT_TICK] += interval
        else:
            if bound[0] - bound[length] > mask:
                return i, given, _RING_FULL
            ring_slot[bound[0] & mask] = slots[i]
            ring_time[bound[0] & mask] = now
            bound[0] += 1
            moves[number[MOVES], 0] = slots[i]
            moves[number[MOVES], 1] = -1
            number[MOVES] += 1
            i += 1
            if every == 0 or bound[0] % every != 0:
                continue
        complete = seen_until >= length * tau if tau > 0 else bound[0] >= length * n
        if not complete:
            continue
        take_moves(
            moves, counts, code, row, low, high, columns, sums, block_least, offset, level,
            number, shape,
        )  # fmt: skip
        best, least = least_in(sums, block_least, 0, places)
        if change and best == policy[_LAST_PLACE]:
            continue
        policy[_LAST_PLACE] = best
        match = out[given]
        match["t"] = now
        match["events"] = bound[0] - bound[1]
        _describe(match, sums, block_least, best, least, number[BASE], length, exclusion, places)
        given += 1


@njit(cache=True, nogil=True)
def _describe(match, sums, block_least, best, least, base, length, exclusion, places):  # type: ignore[no-untyped-def]
    """Write the best place, and look for the second best outside the exclusion zone."""
    second, second_least = -1, least
    if best - exclusion > 0:
        second, second_least = least_in(sums, block_least, 0, best - exclusion)
    if best + exclusion + 1 < places:
        after, after_least = least_in(sums, block_least, best + exclusion + 1, places)
        if second < 0 or after_least < second_least:
            second, second_least = after, after_least
    distance = np.int64(least) + base
    match["place"] = best + length - 1
    match["distance_sum"] = distance
    match["second"] = -1
    match["second_sum"] = -1
    match["ratio"] = np.nan
    if second >= 0:
        second_distance = np.int64(second_least) + base
        match["second"] = second + length - 1
        match["second_sum"] = second_distance
        match["ratio"] = distance / second_distance if second_distance > 0 else 1.0
