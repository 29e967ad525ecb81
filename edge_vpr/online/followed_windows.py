"""The newest L windows of a stream, and the distances of their sequence to all places of a map."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays
from edge_vpr.descriptors.descriptors import narrow
from edge_vpr.descriptors.windows import Window
from edge_vpr.errors import EdgeVprError, MapError
from edge_vpr.online.state import grown, recount
from edge_vpr.online.state_distances import start, with_distances
from edge_vpr.online.state_kernels import advance, settle
from edge_vpr.reference_map import ReferenceMap


class FollowedWindows:
    """State that the kernels update at each event, see `edge_vpr.online.state`.

    Counters and distances are updated when they are read. They are then those at the time `now_us`;
    all earlier events have been processed.

    Parameters
    ----------
    reference : ReferenceMap
    window : FixedTime or FixedCount

    Attributes
    ----------
    s : Sliding
    places : ndarray of unsigned int, shape (K, J)
        Those of the map, and those that were appended.
    """

    def __init__(self, reference: ReferenceMap, window: Window) -> None:
        self.places = reference.places.counts
        self._codes = None if reference.own_mean_code is not None else reference.codes
        self.s = start(self.places, window, reference.settings.windows_per_match, self._codes)

    def _settle(self, now_us: int) -> None:
        advance(self.s, now_us)
        settle(self.s)

    def counts_at(self, now_us: int) -> npt.NDArray[np.int64]:
        """Return the events in each window, newest first, shape (L, J); a copy."""
        self._settle(now_us)
        return self.s.counts.copy()

    def sums_at(self, now_us: int) -> npt.NDArray[np.int64]:
        """Return the distance of the sequence that ends at each place, shape (K - L + 1,)."""
        self._settle(now_us)
        sums = self.s.sums[: self.s.totals["sums"][0]].astype(np.int64)
        return sums + self.s.totals["common"][0]

    def append(self, counts: npt.NDArray[np.integer], now_us: int) -> None:
        """Add a place at the end of the map.

        Parameters
        ----------
        counts : ndarray of int, shape (J,)
            Its descriptor, in codes where the map has a code.
        now_us : int

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
        self._settle(now_us)
        self.s = with_distances(self.s, self.places)

    def verify(self, now_us: int) -> None:
        """Recompute counters and distances from the events in the windows, and compare.

        Raises
        ------
        EdgeVprError
            If anything differs, which no sequence of events can bring about.
        """
        self._settle(now_us)
        fresh = with_distances(self.s, self.places)
        used = slice(fresh.totals["sums"][0])
        same = (
            np.array_equal(recount(self.s), self.s.counts)
            and np.array_equal(fresh.sums[used], self.s.sums[used])
            and fresh.totals["common"] == self.s.totals["common"]
        )
        if not same:
            raise EdgeVprError(
                f"counters or distances have drifted by {now_us} us: this is a fault of "
                "edge-vpr, report it with the recording"
            )

    def to_arrays(self, now_us: int) -> Arrays:
        """Return the places and the events of the windows as arrays, for an archive."""
        self._settle(now_us)
        alive = np.arange(self.s.bound[-1], self.s.bound[0]) & (self.s.slot.size - 1)
        return {
            "places": self.places,
            "slot": self.s.slot[alive],
            "time": self.s.time[alive],
            "bound": self.s.bound,
        }

    def resume(self, arrays: Arrays) -> None:
        """Restore the events from the arrays of `to_arrays`; the map has the saved places."""
        while self.s.slot.size < arrays["slot"].size:
            self.s = grown(self.s)
        s, first = self.s, int(arrays["bound"][-1])
        at = np.arange(first, first + arrays["slot"].size) & (s.slot.size - 1)
        s.slot[at] = arrays["slot"]
        s.time[at] = arrays["time"]
        s.bound[:] = arrays["bound"]
        s.counts[:] = recount(s)
        self.s = with_distances(s, self.places)
