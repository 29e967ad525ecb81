"""State of a localiser: its time, its windows, and how it matches; and the state as an archive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays
from edge_vpr.descriptors.windows import FixedTime
from edge_vpr.errors import UsageError
from edge_vpr.map_checks import check_map
from edge_vpr.matching.drive_matching import check_no_ways
from edge_vpr.online.filter_run import FilterRun
from edge_vpr.online.followed_windows import FollowedWindows
from edge_vpr.online.match_records import MATCH_DTYPE, judged_matches
from edge_vpr.online.saved_map import map_arrays
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.sequence_run import SequenceRun
from edge_vpr.online.state_checks import check_extent, check_filter_state, check_state
from edge_vpr.pipeline import window_of
from edge_vpr.reference_map import ReferenceMap

NO_MATCHES = np.empty(0, dtype=MATCH_DTYPE)


class LocaliserState:
    """What changes while a localiser follows a stream.

    Parameters
    ----------
    reference, every, recent, check_every
        See `edge_vpr.online.localiser.Localiser`.

    Attributes
    ----------
    now : int
        T: all events before it have been taken.
    floor : int
        No event may be earlier.
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
        self._window = window_of(settings)
        self._length = settings.windows_per_match
        self._judge = reference.judge
        check_map(
            settings, reference.pixel_map, reference.places, reference.saliency, reference.hot,
            reference.full_scale, reference.mean, reference.route, reference.jumps,
            reference.odometer_mm,
        )  # fmt: skip
        places, counters = reference.places.counts.shape
        check_extent(places, counters, self._length, recent, self._window)
        self.now = 0  # T: all events before it have been taken
        self.floor = 0  # no event may be earlier
        if reference.own_mean_code is not None and settings.matching != "filter":
            raise UsageError(
                "own-mean codes follow the mean of a drive, which sequences after every event do "
                "not: set matching to filter, or counter_scaling to shared when the map is made"
            )
        if settings.matching == "filter" and recent:
            raise UsageError(
                f"{recent} recent places are left out by sequences only: set matching to sequence"
            )
        self.run: FilterRun | SequenceRun
        if settings.matching == "filter":
            self.run = FilterRun(reference, self._every)
        else:
            check_no_ways(reference.jumps, odometry=False)
            self.run = SequenceRun(self._every, settings.exclusion, recent)
        self.windows = FollowedWindows(reference, self._window)
        self.windows.s = self.run.prepared(self.windows.s)

    def seen_and_whole(self) -> tuple[int, int]:
        """Return how much of the L windows has been seen, and how much they hold."""
        if isinstance(self._window, FixedTime):
            return self.now, self._length * self._window.tau_us
        return int(self.windows.s.bound[0]), self._length * self._window.events

    def resume(self, arrays: Arrays, meta: Mapping[str, Any]) -> None:
        """Take up what `to_archive` gave.

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
        self.windows.s = self.run.prepared(self.windows.s)
        self.now, self.floor = clock.now_us, clock.floor_us

    def feed(
        self, slots: npt.NDArray[np.int32], times: npt.NDArray[np.int64], until: int
    ) -> npt.NDArray[np.void]:
        """Feed selected events, then the ticks up to `until`, in pieces that fit the buffers."""
        found = []
        step = self._check_every or max(slots.size, 1)
        for begin in range(0, max(slots.size, 1), step):
            stop = min(begin + step, slots.size)
            last = stop == slots.size
            found += self._feed_piece(
                slots[begin:stop], times[begin:stop], until if last else int(times[stop - 1])
            )
            if self._check_every:
                self.verify()
        if not found:
            return NO_MATCHES
        return np.concatenate(found) if len(found) > 1 else found[0]

    def _feed_piece(
        self, slots: npt.NDArray[np.int32], times: npt.NDArray[np.int64], until: int
    ) -> list[npt.NDArray[np.void]]:
        self.windows.s, rows = self.run.run(self.windows.s, slots, times, until)
        return [judged_matches(row, self._judge) for row in rows]

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
            "floor_us": self.floor,
        }
        return arrays, meta
