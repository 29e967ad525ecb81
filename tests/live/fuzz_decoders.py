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
from tests.streams import balanced, map_of_counts

#: a host, and a device that it may listen to: those of all tests, and what else is worth a run
PAIRS = (
    *((each.host, each.sends) for each in DEVICES),
    ("evpr", "evpr:frame=64"),
    ("evpr", "evpr:width=3,frame=100"),
)
SENSOR = Sensor(128, 128)
#: bytes that no decoder keeps
MOST_PENDING = 36_000
#: one input takes a millisecond or so; an endless loop, or one that grows, takes longer
MOST_SECONDS = 10.0
#: one input in so many is matched as well, which takes longer
MATCHED = 400
_STEPS_US = (0, 1, 50, 5_000, 900_000, 2_000_000, 70_000_000, 599_000_000)


class Seeded:
    """Choices of a generator."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def integer(self, low, high):
        """A whole number, `high` included."""
        return int(self._rng.integers(low, high + 1))

    def bytes(self, n):
        """`n` bytes, of all values or of few."""
        if self._rng.random() < 0.3:
            return self._rng.choice(np.frombuffer(b"\0\xff\xaa\xd5\x80", np.uint8), n).tobytes()
        return self._rng.bytes(n)


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


def damaged(data, choose):
    """Return bytes with up to six faults."""
    data = bytearray(data)
    for _ in range(choose.integer(0, 6)):
        at, n = choose.integer(0, len(data)), choose.integer(1, 12)
        what = choose.integer(0, 5)
        if what == 0 and at < len(data):
            data[at] ^= 1 << choose.integer(0, 7)
        elif what == 1:
            del data[at : at + n]
        elif what == 2:
            data[at:at] = choose.bytes(n)
        elif what == 3:
            data[at : at + n] = choose.bytes(n)
        elif what == 4:  # a read that comes twice
            data[at:at] = data[max(0, at - 40) : at]
        elif what == 5:
            del data[at:]
    return bytes(data)


def one_input(pair, choose):
    """Feed one stream to a decoder; raise AssertionError if a promise is broken."""
    host, device = pair
    rehearsed(host)
    began = time.process_time()
    matched = choose.integer(1, MATCHED) == 1
    small = Sensor(choose.integer(1, 128), choose.integer(1, 128))
    sensor = SENSOR if matched else small
    decoder = open_decoder(host, sensor)
    live = None
    if matched:
        live = StreamMatcher(decoder, a_map(), MatchSchedule(interval_us=500))
    now = received = 0
    for _ in range(choose.integer(1, 5)):
        what = choose.integer(0, 9)
        if what == 0:
            lost = choose.integer(0, 1 << 16)
            now = checked(decoder, decoder.gap(lost), sensor, now)
            continue
        if what == 1:
            data = choose.bytes(choose.integer(0, 600))
        elif what == 2:  # what another device sends
            others = PAIRS[choose.integer(0, len(PAIRS) - 1)][1]
            data = good_streams(others)[choose.integer(0, 39)]
        else:
            data = damaged(good_streams(device)[choose.integer(0, 39)], choose)
        received += len(data)
        host_us = choose.integer(0, 1 << 40)
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
                one_input(pair, Seeded(np.random.default_rng([number, seed])))
            except Exception:
                print(f"{pair[0]}, a device of {pair[1]}: seed {seed}", flush=True)
                raise
        took = time.monotonic() - start
        print(f"{pair[0]}, a device of {pair[1]}: {share:,} inputs in {took:.0f} s", flush=True)


if __name__ == "__main__":
    main()
