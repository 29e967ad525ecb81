"""Speed of the load on this machine: events, matches, latency, processor time and memory."""

from __future__ import annotations

import resource
import time
from dataclasses import dataclass

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr_tools.energy.workload import Workload
from edge_vpr_tools.output.interrupt import check_interrupted


@dataclass(frozen=True, kw_only=True)
class Throughput:
    """Speed at full load.

    Attributes
    ----------
    seconds : float
        Duration of the measurement.
    events_per_s, matches_per_s, times_real_time : float
    latency_p50_s, latency_p99_s : float
        Latency of the calls that gave a match; `calls_with_a_match` is their number.
    cpu_s_per_match, cpu_share : float
        Processor time of a match, and processor time per second.
    peak_memory_bytes : int
        Peak memory of the process.
    events_a_round : int
        Number of events in the recording.
    """

    seconds: float
    events_per_s: float
    matches_per_s: float
    times_real_time: float
    latency_p50_s: float
    latency_p99_s: float
    calls_with_a_match: int
    cpu_s_per_match: float
    cpu_share: float
    peak_memory_bytes: int
    events_a_round: int


def measure_throughput(workload: Workload, seconds: float) -> Throughput:
    """Measure at full speed; the load must already be compiled and in the caches.

    Parameters
    ----------
    workload : Workload
    seconds : float
        Duration of the measurement.

    Raises
    ------
    UsageError
        If there was no match.
    """
    workload.reset()
    cpu, start = time.process_time(), time.perf_counter()
    workload.run(seconds)
    check_interrupted()
    elapsed, cpu = time.perf_counter() - start, time.process_time() - cpu
    if workload.matches == 0:
        raise UsageError(f"no match within {seconds} s: take longer windows (--window-s)")
    rate = workload.events / elapsed
    p50, p99 = np.quantile(workload.latencies_s, [0.5, 0.99]).tolist()
    return Throughput(
        seconds=elapsed,
        events_per_s=rate,
        matches_per_s=workload.matches / elapsed,
        times_real_time=rate * workload.recorded_s / workload.events_a_round,
        latency_p50_s=p50,
        latency_p99_s=p99,
        calls_with_a_match=len(workload.latencies_s),
        cpu_s_per_match=cpu / workload.matches,
        cpu_share=cpu / elapsed,
        # Linux reports KiB
        peak_memory_bytes=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
        events_a_round=workload.events_a_round,
    )
