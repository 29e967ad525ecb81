"""Feeds events to the kernel, and does the work between its calls that needs Python."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays
from edge_vpr.boxed import Box, Boxed
from edge_vpr.compiling import entry
from edge_vpr.events import Events
from edge_vpr.online.followed import Followed
from edge_vpr.online.followed_windows import FollowedWindows
from edge_vpr.online.kernel import DONE, RING_FULL, WINDOW_OVER, Few, follow, follow_few
from edge_vpr.online.match_records import MATCH_DTYPE
from edge_vpr.online.state import grown

Found = list[npt.NDArray[np.void]]


class MatchRun:
    """Runs the kernel of a localiser on its state.

    Parameters
    ----------
    windows : FollowedWindows
        Its state may be replaced between two calls.
    followed : Followed
    """

    #: Name of the array of the schedule in an archive.
    schedule_name = "policy"

    def __init__(self, windows: FollowedWindows, followed: Followed) -> None:
        self.windows = windows
        self._followed = followed
        self._control = followed.control[0]
        self._box: Box[Followed] | None = None
        self._few: Callable[..., Few] | None = None  # code of `follow_few` for the box
        self._out = followed.out.view(np.uint8).data

    @property
    def next_tick(self) -> int:
        """Time of the next match by the interval of the schedule, in microseconds."""
        return int(self._followed.control["next_tick"][0])

    @next_tick.setter
    def next_tick(self, time_us: int) -> None:
        self._followed.control["next_tick"] = time_us

    @property
    def floor_us(self) -> int:
        """Earliest time that the next event may have."""
        return int(self._followed.control["floor"][0])

    @floor_us.setter
    def floor_us(self, time_us: int) -> None:
        self._followed.control["floor"] = time_us

    @property
    def now_us(self) -> int:
        """T: all earlier events have been processed."""
        return int(self._followed.control["now"][0])

    @now_us.setter
    def now_us(self, time_us: int) -> None:
        self._followed.control["now"] = time_us

    def feed(self, slots: npt.NDArray[np.int32], times: npt.NDArray[np.int64], until: int) -> Found:
        """Process selected events, then advance the time to `until`.

        Parameters
        ----------
        slots : ndarray of int32, shape (m,)
        times : ndarray of int64, shape (m,)
            In time order, none before `floor_us`.
        until : int

        Returns
        -------
        list of ndarray of MATCH_DTYPE
        """
        self.floor_us = until
        return self._go_on(slots, times, until, follow(self.boxed, slots, times, until))

    def follow_few(self, events: Events) -> Few:
        """Call the kernel of this name, with events in one piece that may be written to."""
        box = self.boxed
        if self._few is None:
            self._few = entry(follow_few, box, events)
        return self._few(box, events)

    def go_on(self, result: Few) -> Found:
        """Process the events that `follow_few` has left, and return all matches.

        Parameters
        ----------
        result : Few
            Which is not that the events are refused.

        Returns
        -------
        list of ndarray of MATCH_DTYPE
        """
        read, given, why, selected, last = result
        if why == DONE:
            return [self._taken(given)] if given else []
        slots, times = self._followed.slots[:selected], self._followed.times[:selected]
        return self._go_on(slots, times, int(last), (read, given, why))

    def finish(self) -> Found:
        """Return the matches of windows that wait for later ones, at the end of a drive."""
        return []

    def _go_on(
        self,
        slots: npt.NDArray[np.int32],
        times: npt.NDArray[np.int64],
        until: int,
        result: tuple[int, int, int],
    ) -> Found:
        """Call the kernel until all events are processed."""
        found, begin = [], 0
        while True:
            read, given, why = result
            begin += read
            if given:
                found.append(self._taken(given))
            if why == DONE:
                return found
            if why == RING_FULL:
                self.windows.s = grown(self.windows.s)
            elif why == WINDOW_OVER:
                self._end_window(int(times[begin]) if begin < times.size else until)
            result = follow(self.boxed, slots[begin:], times[begin:], until)

    def _taken(self, given: int) -> npt.NDArray[np.void]:
        # as bytes, because NumPy copies records field by field
        room = bytearray(self._out[: given * MATCH_DTYPE.itemsize])
        return np.frombuffer(room, dtype=MATCH_DTYPE)

    @property
    def boxed(self) -> Boxed:
        """State for `follow` and `follow_few`; call `go_on` after the latter."""
        if self._box is None or self._followed.s is not self.windows.s:
            self._followed = self._followed._replace(s=self.windows.s)
            self._rebound()
            self._box, self._few = Box(self._followed), None
        return self._box.boxed

    def _rebound(self) -> None:
        """Update the control record for another map or other windows."""

    def _end_window(self, next_us: int) -> None:
        """Finish a window of the place filter; the next event or tick is at `next_us`."""
        raise NotImplementedError

    def prepare(self) -> None:
        """Update the distances for the present codes."""

    def to_arrays(self) -> Arrays:
        """Return the arrays that `resume` needs, for an archive."""
        control = self._control
        told = np.array([control.next_tick, control.place_told], dtype=np.int64)
        return {self.schedule_name: told}

    def resume(self, arrays: Arrays) -> None:
        """Restore the state from the arrays of `to_arrays`."""
        self._control.next_tick, self._control.place_told = arrays[self.schedule_name].tolist()
