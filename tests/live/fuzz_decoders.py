"""Fuzz every stream decoder: ``python tests/live/fuzz_decoders.py --inputs 100000``.

Streams are partly what a device sends and partly anything. Each input is drawn from a seed of its
own, which a find names. A find is kept as a test in `test_stream_protocols.py`.
"""

from __future__ import annotations

import argparse
import time
from functools import cache

import numpy as np

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.events import Sensor, make_events
from edge_vpr.live.protocols import open_decoder, open_encoder
from edge_vpr.live.rehearsal import rehearse
from edge_vpr.live.stream_matcher import StreamMatcher
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.settings import Settings
from tests.live.devices import DEVICES
from tests.live.line_faults import corrupt
from tests.streams import balanced, map_of_counts

#: a host, and a device that it may listen to: those of all tests, and what else is worth a run
PAIRS = (
    *((each.host, each.sends) for each in DEVICES),
    ("evpr", "evpr:frame=64"),
    ("evpr", "evpr:width=3,frame=100"),
)
SENSOR = Sensor(128, 128)
FAULTS = ("flip", "drop", "insert", "repeat", "truncate", "noise")
#: bytes that no decoder keeps
MOST_PENDING = 36_000
#: one input takes a millisecond or so; an endless loop, or one that grows, takes longer
MOST_SECONDS = 10.0
#: one input in so many is matched as well, which takes longer
MATCHED = 400
_STEPS_US = (0, 1, 50, 5_000, 900_000, 2_000_000, 70_000_000, 599_000_000)


@cache
def good_streams(device):
    """What a device sends, of 40 short recordings whose times make steps of all sizes."""
    rng, streams = np.random.default_rng(7), []
    for _ in range(40):
        n = int(rng.integers(1, 120))
        steps = rng.choice(_STEPS_US, n, p=(0.3, 0.3, 0.2, 0.196, 0.001, 0.001, 0.001, 0.001))
        pixels = rng.integers(0, 128, (2, n))
        encoder = open_encoder(device, SENSOR)
        events = make_events(np.cumsum(steps), *pixels, rng.integers(0, 2, n))
        streams.append(encoder.start() + encoder.encode(events))
    return streams


@cache
def a_map():
    """A small map, on which what comes out of a decoder is matched."""
    rng = np.random.default_rng(3)
    flat = rng.choice(SENSOR.pixels, 40, replace=False)
    pixels = PixelMap(SENSOR, flat % 128, flat // 128)
    settings = Settings(pixels=40, tau_us=10_000, sequence_length=3)
    return map_of_counts(pixels, rng.poisson(3, (20, 40)), settings)


@cache
def rehearsed(host):
    """Compile everything, so that no input is taken for an endless one."""
    rehearse(host, SENSOR, a_map(), MatchSchedule(interval_us=500), odometry=False, state=False)


def some_bytes(rng):
    """Up to 600 bytes, of all values or of few."""
    n = int(rng.integers(601))
    if rng.random() < 0.3:
        return rng.choice(np.frombuffer(b"\0\xff\xaa\xd5\x80", np.uint8), n).tobytes()
    return rng.bytes(n)


def damaged(data, rng):
    """Return bytes after what up to six kinds of faults have left of them."""
    for kind in rng.choice(FAULTS, int(rng.integers(7))):
        if data:
            data, _ = corrupt(rng, data, kind, 10 ** rng.uniform(-4, -2))
    return data


def one_input(pair, rng):
    """Feed one stream to a decoder; raise AssertionError if a promise is broken."""
    host, device = pair
    rehearsed(host)
    began = time.process_time()
    matched = rng.integers(MATCHED) == 0
    small = Sensor(*rng.integers(1, 129, 2).tolist())
    sensor = SENSOR if matched else small
    decoder = open_decoder(host, sensor)
    live = None
    if matched:
        live = StreamMatcher(decoder, a_map(), MatchSchedule(interval_us=500))
    now = received = 0
    for _ in range(int(rng.integers(1, 6))):
        what = rng.integers(10)
        if what == 0:
            lost = int(rng.integers(1 << 16))
            now = checked(decoder, decoder.gap(lost), sensor, now)
            continue
        if what == 1:
            data = some_bytes(rng)
        elif what == 2:  # what another device sends
            _, other = PAIRS[rng.integers(len(PAIRS))]
            data = good_streams(other)[rng.integers(40)]
        else:
            data = damaged(good_streams(device)[rng.integers(40)], rng)
        received += len(data)
        host_us = int(rng.integers(1 << 40))
        if live is None:
            now = checked(decoder, decoder.feed(data, host_us), sensor, now)
        else:
            result = live.feed(data, host_us)
            now = checked(decoder, result.events, sensor, now)
            assert len(result.matches) < 200_000
            assert all(match.place < 20 for match in result.matches)
    now = checked(decoder, decoder.finish(), sensor, now)
    assert decoder.health.bytes == received
    assert time.process_time() - began < MOST_SECONDS


def checked(decoder, events, sensor, now):
    """Books balance, time runs forward, events lie on the sensor, memory is bounded."""
    health = decoder.health
    assert balanced(health), health
    assert health.pending_bytes <= MOST_PENDING
    assert health.lost >= 0
    assert isinstance(decoder.remark, str)
    assert len(decoder.remark) < 500
    if events.size == 0:
        return now
    assert events["t"][0] >= now
    assert (events["t"][1:] >= events["t"][:-1]).all()
    assert events["x"].max() < sensor.width
    assert events["y"].max() < sensor.height
    return int(events["t"][-1])


def main() -> None:
    """Feed inputs to the decoders of each protocol, or of those named; say how it went."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000, help="for each protocol")
    parser.add_argument("--seed", type=int, default=0, help="of the first input")
    parser.add_argument("--only", nargs="+", default=[], metavar="P", help="these protocols alone")
    args = parser.parse_args()
    protocols = [host.partition(":")[0] for host, _ in PAIRS]
    for number, (pair, protocol) in enumerate(zip(PAIRS, protocols, strict=True)):
        if args.only and protocol not in args.only:
            continue
        start, share = time.monotonic(), -(-args.inputs // protocols.count(protocol))
        for seed in range(args.seed, args.seed + share):
            try:
                one_input(pair, np.random.default_rng([number, seed]))
            except Exception:
                print(f"{pair[0]}, a device of {pair[1]}: seed {seed}", flush=True)
                raise
        took = time.monotonic() - start
        print(f"{pair[0]}, a device of {pair[1]}: {share:,} inputs in {took:.0f} s", flush=True)


if __name__ == "__main__":
    main()
