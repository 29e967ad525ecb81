"""State of a localiser (time, windows, matching), and its form as an archive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays
from edge_vpr.descriptors.windows import FixedTime
from edge_vpr.errors import UsageError
from edge_vpr.events import EVENT_DTYPE, Events
from edge_vpr.matching.drive_matching import check_no_ways
from edge_vpr.online.delayed_run import DelayedRun
from edge_vpr.online.event_intake import selected_in_order
from edge_vpr.online.filter_run import FilterRun
from edge_vpr.online.followed import FEW
from edge_vpr.online.followed_windows import FollowedWindows
from edge_vpr.online.kernel import REFUSED
from edge_vpr.online.match_records import MATCH_DTYPE
from edge_vpr.online.match_run import Found
from edge_vpr.online.saved_map import map_arrays
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.sequence_run import SequenceRun
from edge_vpr.online.state_checks import check_extent, check_filter_state, check_state
from edge_vpr.pipeline import window_of
from edge_vpr.reference_map import ReferenceMap

NO_MATCHES = np.empty(0, dtype=MATCH_DTYPE)
_NO_SLOTS, _NO_TIMES = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int64)


class LocaliserState:
    """State of a localiser that changes with the stream.

    Parameters
    ----------
    reference, every, recent, check_every
        See `edge_vpr.online.localiser.Localiser`.

    Attributes
    ----------
    run : FilterRun or SequenceRun
    windows : FollowedWindows
    """

    def __init__(
        self, reference: ReferenceMap, every: MatchSchedule, recent: int, check_every: int
    ) -> None:
        settings = reference.settings
        self._settings, self._every = settings, every
        self._recent = recent
        self._check_every = check_every
        self._reference = reference
        self._table = reference.pixel_map.table()
        self._window = window_of(settings)
        self._length = settings.windows_per_match
        reference.check()
        places, counters = reference.places.counts.shape
        check_extent(places, counters, self._length, recent, self._window)
        if reference.own_mean_code is not None and settings.matching != "filter":
            raise UsageError(
                "own-mean codes follow the mean of a drive, which sequences after every event do "
                "not: set matching to filter, or counter_scaling to shared when the map is made"
            )
        if settings.matching == "filter" and recent:
            raise UsageError(
                f"{recent} recent places are left out by sequences only: set matching to sequence"
            )
        self.windows = FollowedWindows(reference, self._window)
        self.run: FilterRun | SequenceRun
        if settings.matching == "filter":
            run = DelayedRun if settings.late else FilterRun
            self.run = run(reference, self.windows, every)
        else:
            check_no_ways(reference.jumps, odometry=False)
            self.run = SequenceRun(reference, self.windows, every, recent)
        self.run.prepare()

    @property
    def now(self) -> int:
        """T: all earlier events have been processed."""
        return self.run.now_us

    def seen_and_whole(self) -> tuple[int, int]:
        """Return how much of the windows before the first match is complete, and their length."""
        windows = self._length + self._settings.late
        if isinstance(self._window, FixedTime):
            return self.now, windows * self._window.tau_us
        return int(self.windows.s.bound[0]), windows * self._window.events

    def resume(self, arrays: Arrays, meta: Mapping[str, Any]) -> None:
        """Restore the state from the result of `to_archive`.

        Raises
        ------
        MapError
            If it is not a state that a localiser can come to.
        """
        clock = check_state(
            arrays,
            meta,
            counters=self.windows.places.shape[1],
            length=self._length,
            ends=len(self.windows.places) - self._length + 1,
            window=self._window,
            every=self._every,
            filtered=self._settings.matching == "filter",
        )
        if self._settings.matching == "filter":
            check_filter_state(
                arrays, len(self.windows.places), self._window, self._every, clock.floor_us
            )
        self.run.resume(arrays)
        self.windows.resume(arrays)
        self.run.prepare()
        self.run.now_us, self.run.floor_us = clock.now_us, clock.floor_us

    def take(self, events: Events) -> npt.NDArray[np.void]:
        """Feed events, at any pixels; see `Localiser.update`."""
        if events.size <= FEW and events.dtype == EVENT_DTYPE and not self._check_every:
            plain = type(events) is np.ndarray and events.flags.carray
            few = events if plain else np.array(events, dtype=EVENT_DTYPE)
            result = self.run.follow_few(few)
            if result[2] != REFUSED:
                return _joined(self.run.go_on(result))
        slots, times = selected_in_order(
            self._table, events, self.run.floor_us, self._settings.polarity
        )
        last = int(events["t"][-1])
        self._every.check_ticks(self.run.next_tick, last)
        matches = self._feed(slots, times, last)
        self.run.now_us = last + 1
        return matches

    def advance(self, until_us: int) -> npt.NDArray[np.void]:
        """Advance the time without events; see `Localiser.advance`."""
        self._every.check_ticks(self.run.next_tick, until_us)
        matches = self._feed(_NO_SLOTS, _NO_TIMES, until_us)
        self.run.now_us = max(self.now, until_us)
        return matches

    def finish(self) -> npt.NDArray[np.void]:
        """Return the matches that wait for later windows; see `Localiser.finish`."""
        return _joined(self.run.finish())

    def _feed(
        self, slots: npt.NDArray[np.int32], times: npt.NDArray[np.int64], until: int
    ) -> npt.NDArray[np.void]:
        """Process selected events, then the ticks up to `until`; verify in between if asked to."""
        if not self._check_every:
            return _joined(self.run.feed(slots, times, until))
        found = []
        for begin in range(0, max(slots.size, 1), self._check_every):
            stop = min(begin + self._check_every, slots.size)
            some_until = until if stop == slots.size else int(times[stop - 1])
            found += self.run.feed(slots[begin:stop], times[begin:stop], some_until)
            self.verify()
        return _joined(found)

    def verify(self) -> None:
        """Recompute counters and distances, and compare; see `FollowedWindows.verify`."""
        self.windows.verify(self.now)

    def to_archive(self) -> tuple[Arrays, dict[str, Any]]:
        """Return the arrays and the metadata of an archive, for `resume`."""
        arrays = map_arrays(self._reference) | self.windows.to_arrays(self.now)
        arrays |= self.run.to_arrays()
        meta = {
            "sensor": list(self._reference.pixel_map.sensor),
            "settings": self._settings.to_dict(),
            "every": asdict(self._every),
            "recent": self._recent,
            "now_us": self.now,
            "floor_us": self.run.floor_us,
        }
        return arrays, meta


def _joined(found: Found) -> npt.NDArray[np.void]:
    if len(found) == 1:
        return found[0]
    return np.concatenate(found) if found else NO_MATCHES
