"""The pipeline as a load: a recording is repeatedly fed to a localiser in packets."""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.events import Events
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap

#: pause between two rounds of a recording, in microseconds
_PAUSE_US = 1


class Workload:
    """Feeds events to a localiser as fast as it accepts them.

    Parameters
    ----------
    reference : ReferenceMap
    events : iterable of ndarray
        Cleaned events of the recording; held in memory.
    every : MatchSchedule
        Schedule of matches.
    packet : int
        Number of events in one call, as from a camera's driver.

    Attributes
    ----------
    events, matches : int
        Numbers since the last `reset`.
    busy_s : float
        Time in the localiser since the last `reset`.
    latencies_s : list of float
        Latencies of the calls that gave a match.
    recorded_s : float
    events_a_round : int
        Number of events in the recording.

    Raises
    ------
    UsageError
        If one round of the recording gives no match.
    """

    def __init__(
        self,
        reference: ReferenceMap,
        events: Iterable[Events],
        every: MatchSchedule,
        packet: int = 512,
    ) -> None:
        if packet < 1:
            raise UsageError(f"packets of {packet} events: expected 1 or more")
        pieces = list(events)
        whole = np.concatenate(pieces) if pieces else None
        if whole is None or whole.size == 0:
            raise UsageError("the recording holds no events: name another one")
        self._packets = [whole[i : i + packet].copy() for i in range(0, whole.size, packet)]
        self._period = int(whole["t"][-1]) - int(whole["t"][0]) + _PAUSE_US
        self._localiser = Localiser(reference, every=every)
        self._next = 0
        self.recorded_s, self.events_a_round = self._period / 1e6, whole.size
        self.reset()
        self.round()
        if self.matches == 0:
            raise UsageError(
                "one round of the recording gives no match: take shorter windows or a longer drive"
            )
        self.reset()

    def reset(self) -> None:
        """Reset the counts."""
        self.events = self.matches = 0
        self.busy_s = 0.0
        self.latencies_s: list[float] = []

    def round(self) -> None:
        """Feed the recording once more; this also compiles the kernels and warms the caches."""
        for _ in range(len(self._packets)):
            self._feed()

    def run(self, seconds: float) -> int:
        """Feed events for some seconds; return the number of matches."""
        end, before = time.perf_counter() + seconds, self.matches
        while time.perf_counter() < end:
            self._feed()
        return self.matches - before

    def _feed(self) -> None:
        packet = self._packets[self._next]
        start = time.perf_counter()
        found: npt.NDArray[np.void] = self._localiser.update(packet)
        took = time.perf_counter() - start
        # the same events again, one round later
        packet["t"] += self._period
        self._next = (self._next + 1) % len(self._packets)
        self.events += packet.size
        self.matches += found.size
        self.busy_s += took
        if found.size:
            self.latencies_s.append(took)
