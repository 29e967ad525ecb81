"""A live run whose clock runs for a day, in minutes: sparse events, silences, wraps, heartbeats.

``python tools/bench/long_day.py`` feeds the bytes of each protocol to a live localiser and the same
events, offline, to another; the matches must be the same to the bit, and memory must not grow.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from soak import a_map

from edge_vpr.descriptors.cleaning import BurstFilter
from edge_vpr.events import Events, Sensor, make_events
from edge_vpr.live.localiser import LiveLocaliser
from edge_vpr.live.protocols import open_decoder, open_encoder
from edge_vpr.live.protocols.timestamps import CONFIRM
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap

SENSOR = Sensor(346, 260)
HOUR_US = 3_600_000_000
#: Protocols, and the longest silence after which their clocks are still unambiguous: evt3's wraps
#: after 16.8 s, and evpr says each second that it is there.
SILENCES_S = {"evpr": 120.0, "evt2": 30.0, "evt3": 15.0}


class Day(NamedTuple):
    """What was seen.

    Attributes
    ----------
    same : bool
        Whether the live matches are the offline ones, to the bit.
    wraps, lost, rejected : int
        Of the device's clock, and of events.
    blocks, resident : list of int
        Blocks that Python holds, and bytes in memory, after each hour.
    """

    matches: int
    same: bool
    wraps: int
    lost: int
    rejected: int
    blocks: list[int]
    resident: list[int]


def spells(rng: np.random.Generator, silence_s: float, hours: float) -> Iterator[Events]:
    """Yield a spell of events after each silence, up to the end of the time."""
    now = 0
    while now < hours * HOUR_US:
        # fewer would not confirm to a decoder without checksums how late it is
        n = int(rng.integers(CONFIRM + 1, 200))
        flat = rng.integers(0, SENSOR.pixels, n)
        times = now + np.sort(rng.integers(0, 200_000, n))
        yield make_events(times, flat % SENSOR.width, flat // SENSOR.width)
        now = int(times[-1]) + int(rng.uniform(0.1, 1.0) * silence_s * 1e6)


def live_day(protocol: str, reference: ReferenceMap, hours: float, pauses: int = 1) -> Day:
    """Run a day.

    Parameters
    ----------
    protocol : str
        Of `SILENCES_S`.
    pauses : int
        Silences are so many times shorter than the protocol allows.
    """
    rng = np.random.default_rng(0)
    every = MatchSchedule(events=50, interval_us=1_000_000)
    encoder, decoder = open_encoder(protocol, SENSOR), open_decoder(protocol, SENSOR)
    live = LiveLocaliser(decoder, reference, every)
    offline, bursts = Localiser(reference, every=every), BurstFilter(SENSOR)
    digests = hashlib.sha256(), hashlib.sha256()
    matches, start, reached, hour = 0, None, 0, HOUR_US
    blocks: list[int] = []
    resident: list[int] = []

    def take(data: bytes) -> int:
        result = live.feed(data, 0)
        assert not any(result.missing)
        digests[0].update(result.matches.tobytes())
        return int(result.matches.size)

    take(encoder.start())
    for events in spells(rng, SILENCES_S[protocol] / pauses, hours):
        start = int(events["t"][0]) if start is None else start
        for second in range(reached // 1_000_000 + 1, int(events["t"][0]) // 1_000_000):
            matches += take(encoder.idle(second * 1_000_000))
        matches += take(encoder.encode(events))
        reached = int(events["t"][-1])
        if protocol != "evpr":
            events["t"] -= start  # only evpr tells when the stream began
        for piece in bursts.pieces(events):
            digests[1].update(offline.update(piece).tobytes())
        if reached >= hour:
            hour += HOUR_US
            gc.collect()
            blocks.append(sys.getallocatedblocks())
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
            resident.append(pages * os.sysconf("SC_PAGE_SIZE"))
    rest = live.finish().matches
    digests[0].update(rest.tobytes())
    digests[1].update(offline.update(bursts.finish()).tobytes())
    health = decoder.health
    return Day(
        matches + rest.size, digests[0].digest() == digests[1].digest(), health.wraps,
        health.lost, health.rejected, blocks, resident,
    )  # fmt: skip


def main() -> None:
    """Run a day of each protocol and print what was seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=24)
    parser.add_argument("--pauses", type=int, default=20, help="makes silences shorter")
    args: Any = parser.parse_args()
    for protocol in SILENCES_S:
        reference = a_map(np.random.default_rng(1), SENSOR)
        start = time.monotonic()
        day = live_day(protocol, reference, args.hours, args.pauses)
        grown = (day.resident[-1] - day.resident[0]) / 1e6
        print(
            f"{protocol}: {args.hours:g} h in {time.monotonic() - start:.0f} s, {day.matches:,} "
            f"matches, {'the same as' if day.same else 'OTHERS THAN'} offline; {day.wraps:,} "
            f"wraps, {day.lost} lost, {day.rejected} rejected; from the first hour to the last "
            f"{day.blocks[-1] - day.blocks[0]:+,} blocks of Python, {grown:+.1f} MB resident"
        )


if __name__ == "__main__":
    main()
