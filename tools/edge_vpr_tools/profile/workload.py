"""The load that is profiled: the events of a drive, which are fed to a localiser in packets."""

from __future__ import annotations

import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.events import Events, join_events
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap

# The pipeline as a load: a recording is repeatedly fed to a localiser in packets.


#: events in one call, as from a camera's driver
PACKET = 512
#: pause between two rounds of a recording, in microseconds
_PAUSE_US = 1


class Workload:
    """Feeds events to a localiser as fast as it accepts them; each window gives a match.

    Parameters
    ----------
    name : str
        Of the recording of the query drive.
    events : sequence of Events
        Cleaned events of the recording.
    files : sequence of str
        That map and events were read from.

    Attributes
    ----------
    events, matches : int
        Numbers since the last `reset`.
    latencies_s : list of float
        Latencies of the calls that gave a match.
    events_a_round : int
        Number of events in the recording.

    Raises
    ------
    UsageError
        If one round of the recording gives no match.
    """

    def __init__(
        self, name: str, reference: ReferenceMap, events: Sequence[Events], files: Sequence[str]
    ) -> None:
        self.name, self.reference, self.files = name, reference, files
        whole = join_events(events)
        if whole.size == 0:
            raise UsageError("the recording holds no events: name another one")
        self._packets = [whole[i : i + PACKET].copy() for i in range(0, whole.size, PACKET)]
        self._period = int(whole.t[-1]) - int(whole.t[0]) + _PAUSE_US
        every = MatchSchedule.window(reference.settings)
        self._localiser = Localiser(reference, every=every)
        self._next = 0
        self.recorded_s, self.events_a_round = self._period / 1e6, whole.size
        self.reset()
        for _ in self._packets:  # this also compiles the kernels and warms the caches
            self._feed()
        if self.matches == 0:
            raise UsageError(
                "one round of the recording gives no match: take shorter windows or a longer drive"
            )
        self.reset()

    def reset(self) -> None:
        """Reset the counts."""
        self.events = self.matches = 0
        self.latencies_s: list[float] = []

    def run(self, seconds: float) -> int:
        """Feed events for some seconds; return the number of matches."""
        end, before = time.perf_counter() + seconds, self.matches
        while time.perf_counter() < end:
            self._feed()
        return self.matches - before

    def _feed(self) -> None:
        packet = self._packets[self._next]
        start = time.perf_counter()
        matches: npt.NDArray[np.void] = self._localiser.update(packet)
        took = time.perf_counter() - start
        # the same events again, one round later
        packet.t += self._period
        self._next = (self._next + 1) % len(self._packets)
        self.events += packet.size
        self.matches += matches.size
        if matches.size:
            self.latencies_s.append(took)


# Speed of the load on this machine: events, matches, latency, processor time and memory.


@dataclass(frozen=True, kw_only=True)
class Throughput:
    """Speed at full load."""

    events_per_s: float
    matches_per_s: float
    times_real_time: float
    #: latency_p50_s, latency_p99_s: latency of the calls that gave a match.
    latency_p50_s: float
    latency_p99_s: float
    cpu_s_per_match: float  #: Processor time of a match.
    peak_memory_bytes: int  #: Peak memory of the process.


def measure_throughput(workload: Workload, seconds: float) -> Throughput:
    """Measure at full speed; the load must already be compiled and in the caches.

    Raises
    ------
    UsageError
        If there was no match.
    """
    workload.reset()
    cpu, start = time.process_time(), time.perf_counter()
    workload.run(seconds)
    elapsed, cpu = time.perf_counter() - start, time.process_time() - cpu
    if workload.matches == 0:
        raise UsageError(f"no match within {seconds} s: take longer windows (--window-s)")
    rate = workload.events / elapsed
    p50, p99 = np.quantile(workload.latencies_s, [0.5, 0.99]).tolist()
    return Throughput(
        events_per_s=rate,
        matches_per_s=workload.matches / elapsed,
        times_real_time=rate * workload.recorded_s / workload.events_a_round,
        latency_p50_s=p50,
        latency_p99_s=p99,
        cpu_s_per_match=cpu / workload.matches,
        # Linux reports KiB
        peak_memory_bytes=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
    )
