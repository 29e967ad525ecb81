"""`edge-vpr stream` on a line that is full for minutes: what it loses, takes, and how late it is.

``python tools/bench/soak.py --minutes 10`` plays a device of 12 Mbaud on a pseudo-terminal, runs
the command as its own process, and watches it from outside: a match is late by the time from the
write of the byte that it needed to the line in which it was read.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from bisect import bisect_right
from pathlib import Path
from typing import Any

import numpy as np

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.events import Sensor, join_events, make_events
from edge_vpr.live.bridge import Bridge, VirtualLink
from edge_vpr.live.protocols import open_encoder
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings

SLICE_US = 1_000
SENSORS = {"edvs": Sensor(128, 128)}
PLACES = 1_000
_PAGE, _TICK = os.sysconf("SC_PAGE_SIZE"), os.sysconf("SC_CLK_TCK")


def slices(rng: np.random.Generator, sensor: Sensor, rate: float) -> Any:
    """Yield events at random pixels, a millisecond at a time, for ever."""
    start = 0
    while True:
        n = rng.poisson(rate * SLICE_US / 1e6)
        flat = rng.integers(0, sensor.pixels, n)
        times = start + np.sort(rng.integers(0, SLICE_US, n))
        yield make_events(times, flat % sensor.width, flat // sensor.width, rng.integers(0, 2, n))
        start += SLICE_US


class Watched:
    """The command as a process, and what is seen of it from outside."""

    def __init__(self, words: list[str]) -> None:
        program = [sys.executable, "-m", "edge_vpr_tools.cli", *words]
        self.process = subprocess.Popen(program, stdout=subprocess.PIPE, text=True)
        self.matches: list[tuple[int, float]] = []
        self.summary: dict[str, Any] = {}
        self.started = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            now = time.monotonic()
            self.started.set()
            row = json.loads(line)
            if row["kind"] == "match":
                self.matches.append((round(1e6 * row["time_s"]), now))
            elif row["kind"] == "summary":
                self.summary = row

    def resident(self) -> int:
        """Return the bytes in memory."""
        return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * _PAGE

    def cpu_s(self) -> float:
        """Return the seconds of processor time so far, of all its threads."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(") ", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / _TICK

    def stop(self) -> None:
        """End it as a service manager would."""
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(timeout=30)
        self._reader.join(timeout=10)


def soak(protocol: str, minutes: float, baud: int, every: str) -> dict[str, Any]:
    """Run once; return what was seen."""
    rng = np.random.default_rng(0)
    sensor = SENSORS.get(protocol.partition(":")[0], Sensor(346, 260))
    encoder = open_encoder(protocol, sensor)
    # about what fits, as a protocol may take more bytes an event where there are few
    light = slices(rng, sensor, baud / 40)
    probe = join_events([next(light) for _ in range(100)])
    bytes_per_event = len(open_encoder(protocol, sensor).encode(probe)) / probe.size
    rate = baud / 10 / bytes_per_event
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.npz"
        a_map(rng, sensor).save(path)
        link = VirtualLink()
        words = ["stream", "--port", link.address, "--baud", str(baud), "--map", str(path)]
        host = "evpr" if protocol.startswith("evpr") else protocol  # frames state their form
        words += ["--protocol", host, "--json", "--every", every]
        watched = Watched(words)
        bridge = Bridge(link, encoder)
        bridge.wait_for_host()
        watched.started.wait(60)
        seen = _play(link, encoder, slices(rng, sensor, rate), watched, 60 * minutes)
        link.drain(5)
        time.sleep(0.5)
        cpu = watched.cpu_s()
        watched.stop()
        link.close()
    seen_later = compared(watched, *seen.pop("slices"))
    return {"protocol": protocol, "every": every, "cpu_s": cpu, **seen, **seen_later}


def a_map(rng: np.random.Generator, sensor: Sensor, *, remove_bursts: bool = True) -> ReferenceMap:
    """Make a map of 1,000 places of 100 ms at 150 pixels."""
    settings = Settings(pixels=150, tau_us=100_000, sequence_length=4, remove_bursts=remove_bursts)
    flat = rng.choice(sensor.pixels, settings.pixels, replace=False)
    times = np.arange(PLACES + 1) * settings.tau_us
    counts = rng.poisson(3, (PLACES, settings.pixels)).astype(np.uint8)
    image = np.zeros((sensor.height, sensor.width))
    return ReferenceMap(
        settings,
        PixelMap(sensor, flat % sensor.width, flat // sensor.width),
        Descriptors(counts, times[:-1], times[1:], counts.sum(axis=1, dtype=np.int64)),
        image.astype(np.float32),
        image > 0,
    )


def _play(
    link: VirtualLink, encoder: Any, stream: Any, watched: Watched, seconds: float
) -> dict[str, Any]:
    """Send a slice each millisecond; note when, and how much memory and time the command takes."""
    sent, sent_bytes, late = 0, 0, 0.0
    times, writes, memory = [0], [0.0], []
    link.write(encoder.start(), 1)
    start = time.monotonic()
    cpu = watched.cpu_s()
    for number, events in enumerate(stream):
        due = start + number * SLICE_US / 1e6
        now = time.monotonic()
        if now < due:
            time.sleep(due - now)
        late = max(late, now - due)
        if due - start >= seconds:
            break
        data = encoder.encode(events)
        view = memoryview(data)
        times.append((number + 1) * SLICE_US)
        writes.append(time.monotonic())
        while view:
            view = view[link.write(bytes(view), 1.0) :]
        sent, sent_bytes = sent + events.size, sent_bytes + len(data)
        if number % 1_000 == 0:
            memory.append(watched.resident())
    return {
        "sent": sent, "sent_bytes": sent_bytes, "seconds": time.monotonic() - start,
        "device_late_ms": 1e3 * late, "cpu_before_s": cpu, "memory": memory,
        "slices": (times, writes),
    }  # fmt: skip


def compared(watched: Watched, times: list[int], writes: list[float]) -> dict[str, Any]:
    """Compare what was sent with what came out, and when."""
    # a match at time T is known with the first event that is not earlier
    late = np.array(
        [
            1e3 * (at - writes[min(bisect_right(times, t), len(writes) - 1)])
            for t, at in watched.matches
        ]
    )
    summary = watched.summary
    return {
        "delivered": summary["events"], "lost": summary["lost"],
        "overrun_bytes": summary["overrun_bytes"], "rejected": summary["late"] + summary["leaps"],
        "matches": len(watched.matches),
        "latency_ms": np.percentile(late, [50, 99, 100]).tolist() if late.size else None,
        "own_p99_ms": summary["lag_p99_ms"],
    }  # fmt: skip


def main() -> None:
    """Run one protocol, and print what was seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--protocol", default="evpr")
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--baud", type=int, default=12_000_000)
    parser.add_argument("--every", default="50ms")
    args = parser.parse_args()
    seen = soak(args.protocol, args.minutes, args.baud, args.every)
    # the first tenth is the start
    memory = np.array(seen["memory"])[len(seen["memory"]) // 10 :] / 1e6
    half, most, worst = seen["latency_ms"]
    share = (seen["cpu_s"] - seen["cpu_before_s"]) / seen["seconds"]
    print(
        f"{args.protocol}: {seen['sent']:,} events in {seen['sent_bytes']:,} bytes over "
        f"{seen['seconds']:.0f} s; {seen['delivered']:,} delivered, {seen['rejected']:,} rejected, "
        f"{seen['lost']:,} lost, {seen['overrun_bytes']:,} bytes overrun"
    )
    print(
        f"from byte to match {half:.1f} ms median, {most:.1f} ms for 99 %, {worst:.1f} ms at most, "
        f"of {seen['matches']:,} matches; {share:.0%} of a core; resident {memory[0]:.1f} MB at "
        f"first, {memory[-1]:.1f} MB at the end, {memory.max():.1f} MB at most"
    )
    print(f"the device itself was late by up to {seen['device_late_ms']:.1f} ms")


if __name__ == "__main__":
    main()
