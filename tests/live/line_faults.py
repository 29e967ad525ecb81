"""What a bad line does to a camera's bytes, and what of them a decoder then delivers.

``python tests/live/line_faults.py --events 100_000`` runs every protocol over every kind of fault
at every rate, with so many events each, and prints what became of them.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from edge_vpr.events import Events, Sensor, join_events, make_events
from edge_vpr.live.protocols import Health, open_decoder, open_encoder
from tests.live.devices import DEVICES
from tests.streams import balanced

SENSOR = Sensor(128, 128)
KINDS = ("flip", "drop", "insert", "repeat", "truncate", "noise", "garbage", "restart", "wrap")
RATES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
#: pixel and polarity of an event say its number, modulo this
PERIOD = SENSOR.pixels * 2
PIECE = 4_096

Longs = npt.NDArray[np.int64]


@dataclass
class Sent:
    """Bytes of a device and where its events lie in them.

    Attributes
    ----------
    begin, end : shape (n,)
        Bytes of each event, or of the frame it is in.
    since : shape (n,)
        Where to begin reading at the latest to know all of the event: words of time and row may
        lie before it.
    timed : bool
        Whether the bytes of an event tell its time.
    """

    events: Events
    data: bytes
    begin: Longs
    end: Longs
    since: Longs
    timed: bool = True


def numbered_events(first: int, times: Longs) -> Events:
    """Events whose pixels seem random, and say each event's number."""
    number = first + np.arange(times.size)
    code = (number * 20_077 + 12_345) % PERIOD
    return make_events(times, code & 127, code >> 7 & 127, code >> 14)


def numbers_of(events: Events) -> Longs:
    """Numbers modulo `PERIOD`, of events of `numbered_events`."""
    code = events["x"].astype(np.int64) | events["y"].astype(np.int64) << 7
    code |= events["p"].astype(np.int64) << 14
    return (code - 12_345) * pow(20_077, -1, PERIOD) % PERIOD


def send(device: str, first: int, times: Longs) -> Sent:
    """Encode events with these numbers and times."""
    events = numbered_events(first, times)
    encoder = open_encoder(device, SENSOR)
    if device.startswith("evpr"):
        n = 40 if "frame=200" in device else 250
        chunks = [events[i : i + n] for i in range(0, events.size, n)]
        frames = [encoder.encode(chunk) for chunk in chunks]
        lengths = [len(frame) for frame in frames]
        end = np.repeat(np.cumsum(lengths), [chunk.size for chunk in chunks])
        begin = end - np.repeat(lengths, [chunk.size for chunk in chunks])
        return Sent(events, b"".join(frames), begin, end, begin)
    data = encoder.encode(events)
    size = {"evt2": 4, "evt21": 8, "evt3": 2}.get(device)
    if size is None and "E1" not in device:
        end = (np.arange(events.size) + 1) * (len(data) // events.size)
    elif size is None:
        raw = np.frombuffer(data, dtype=np.uint8)
        steps = np.diff(times, prepend=0)
        end = np.cumsum(3 + (steps >= 1 << 7) + (steps >= 1 << 14) + (steps >= 1 << 21))
        assert end[-1] == raw.size
    else:
        words = np.frombuffer(data, dtype=f"<u{size}").astype(np.uint64)
        kind = (words >> np.uint64(8 * size - 4)).astype(np.int64)
        is_event = kind == 2 if device == "evt3" else kind < 2
        at = np.arange(words.size) * size
        end = at[is_event] + size
        since = end - size
        for told in (8, 6, 0) if device == "evt3" else (8,):
            newest = np.maximum.accumulate(np.where(kind == told, at, 0))
            since = np.minimum(since, newest[is_event])
        return Sent(events, data, np.append(0, end[:-1]), end, since)
    begin = np.append(0, end[:-1])
    return Sent(events, data, begin, end, begin, "E0" not in device and "E1" not in device)


def join(parts: list[Sent]) -> Sent:
    """One run of a device after another."""
    at = np.cumsum([0, *(len(part.data) for part in parts[:-1])])
    begin, end, since = (
        np.concatenate([getattr(part, name) + a for part, a in zip(parts, at, strict=True)])
        for name in ("begin", "end", "since")
    )
    events = join_events([part.events for part in parts])
    data = b"".join(part.data for part in parts)
    return Sent(events, data, begin, end, since, parts[0].timed)


def corrupt(rng: np.random.Generator, data: bytes, kind: str, rate: float) -> tuple[bytes, Longs]:
    """Damage about `rate` of the bytes, or reads as often.

    Returns
    -------
    bytes
        As received.
    ndarray of int64
        Of each received byte, where it was sent from; -1 for one that was not sent, or twice.
    """
    raw, origin = np.frombuffer(data, dtype=np.uint8).copy(), np.arange(len(data))
    number = min(raw.size, max(1, rng.poisson(rate * raw.size)))
    at = np.sort(rng.choice(raw.size, number, replace=False))
    if kind == "flip":
        raw[at] ^= (1 << rng.integers(0, 8, at.size)).astype(np.uint8)
        origin[at] = -1
    elif kind == "drop":
        raw, origin = np.delete(raw, at), np.delete(origin, at)
    elif kind == "insert":
        raw = np.insert(raw, at, rng.integers(0, 256, at.size).astype(np.uint8))
        origin = np.insert(origin, at, -1)
    elif kind == "garbage":
        extra = rng.integers(0, 256, int(rng.integers(1, 20_000)))
        raw, origin = np.append(extra, raw), np.append(np.full(extra.size, -1), origin)
    elif kind in ("repeat", "truncate", "noise"):
        # a read comes twice, or its end is lost, or it came at a wrong baud rate
        lengths = rng.integers(1, 600, at.size)
        pieces, origins, last = [], [], 0
        for cut, length in zip(at.tolist(), lengths.tolist(), strict=True):
            if cut < last:
                continue
            pieces.append(raw[last:cut])
            origins.append(origin[last:cut])
            last = cut if kind == "repeat" else min(cut + length, raw.size)
            if kind != "truncate":
                again = raw[max(0, cut - length) : cut]
                pieces.append(again if kind == "repeat" else baud_noise(rng, length))
                origins.append(np.full(pieces[-1].size, -1))
        raw = np.concatenate([*pieces, raw[last:]])
        origin = np.concatenate([*origins, origin[last:]])
    return raw.astype(np.uint8).tobytes(), origin


def baud_noise(rng: np.random.Generator, n: int) -> npt.NDArray[np.uint8]:
    """Bytes read too fast: long runs of equal bits."""
    bits = np.repeat(rng.integers(0, 2, n * 8 // 3 + 1), 3)[: n * 8]
    return np.packbits(bits.astype(np.uint8))


@cache
def _undisturbed(device: str, n: int) -> Sent:
    """`n` events as a device sends them, always the same: to encode them takes longest."""
    return send(device, 0, np.cumsum(np.random.default_rng(n).integers(1, 20, n)))


def make_line(
    rng: np.random.Generator, device: str, kind: str, rate: float, n: int, *, same: bool = False
) -> tuple[Sent, bytes, Longs]:
    """`n` events as a device sends them, and what arrives of them; see `corrupt`.

    With `same`, the events are the same for all kinds of damage to the bytes.
    """
    if same and kind not in ("wrap", "restart"):
        sent = _undisturbed(device, n)
        return (sent, *corrupt(rng, sent.data, kind, rate))
    steps = rng.integers(1, 20, n)
    if kind == "wrap":
        bits = next(each.clock_bits for each in DEVICES if each.sends == device)
        # two wraps or more, unless that takes too long: then one in the midst
        if bits and 2 << bits <= n * 400:
            steps = rng.integers(1, max(2, (5 << bits) // n), n)
        times = np.cumsum(steps) + max(0, (1 << bits) - int(steps.sum()) // 2)
        sent = send(device, 0, times)
        return sent, sent.data, np.arange(len(sent.data))
    if kind == "restart":
        cuts = np.sort(rng.choice(np.arange(1, n), max(1, rng.poisson(rate * n)), replace=False))
        parts = []
        for i, start in enumerate([0, *cuts.tolist()]):
            boot = f"{device}{',' if ':' in device else ':'}boot={i % 65_536}"
            times = np.cumsum(steps[start : [*cuts, n][i]])
            parts.append(send(boot if "evpr" in device else device, start, times))
        sent = join(parts)
        # the last bytes before each start are lost
        ends = np.cumsum([len(part.data) for part in parts])[:-1]
        lost = np.concatenate([np.arange(end - rng.integers(1, 30), end) for end in ends])
        raw = np.delete(np.frombuffer(sent.data, dtype=np.uint8), lost)
        return sent, raw.tobytes(), np.delete(np.arange(len(sent.data)), lost)
    sent = send(device, 0, np.cumsum(steps))
    return (sent, *corrupt(rng, sent.data, kind, rate))


@dataclass
class Outcome:
    """What became of the events.

    Attributes
    ----------
    sent, intact : int
        Events, and those of which all bytes arrived.
    right, wrong : int
        Delivered: as sent, and once; and otherwise.
    missed : int
        Intact and not delivered.
    resync : int
        Bytes: so many undamaged ones, at most, lay before an event that was missed.
    """

    sent: int
    intact: int
    right: int
    wrong: int
    missed: int
    resync: int
    health: Health


def decode(host: str, sent: Sent, received: bytes, origin: Longs, piece: int = PIECE) -> Outcome:
    """Decode what arrived, in pieces, and compare it with what was sent.

    Times are compared where each event has one of its own, and a lost event does not shift others.

    Raises
    ------
    AssertionError
        If the books do not balance after a piece, too many bytes are kept, time runs backwards,
        or an event lies off the sensor; or, where losses are known exactly, if those from the
        first event that was delivered to the last are not what is missing.
    """
    decoder = open_decoder(host, SENSOR)
    n = sent.events.size
    # where each byte arrived, and the run of undamaged bytes it belongs to
    where = np.full(len(sent.data), -1)
    true = origin >= 0
    where[origin[true]] = np.flatnonzero(true)
    broken = np.diff(origin, prepend=-2) != 1
    run = np.maximum.accumulate(np.where(broken, np.arange(origin.size), 0))
    first, last = where[sent.begin], where[sent.end - 1]
    intact = (first >= 0) & (last - first == sent.end - 1 - sent.begin)
    intact &= np.where(intact, run[first] == run[last], False)
    tellable = intact & (where[sent.since] >= 0)
    tellable &= np.where(tellable, run[where[sent.since]] == run[first], False)
    delivered = np.zeros(n, dtype=np.bool_)
    right = wrong = now = 0
    last = -1, -1
    newest_byte = np.maximum.accumulate(origin)
    for start in [*range(0, len(received), piece), None]:
        if start is None:
            events, start = decoder.finish(), len(received)
        else:
            events = decoder.feed(received[start : start + piece])
        health = decoder.health
        assert balanced(health), health
        assert health.bytes == min(start + piece, len(received))
        assert health.pending_bytes < 66_000
        if events.size == 0:
            continue
        assert events["t"][0] >= now
        assert (np.diff(events["t"]) >= 0).all()
        assert events["x"].max() < SENSOR.width
        assert events["y"].max() < SENSOR.height
        now = int(events["t"][-1])
        # the newest event that may have arrived
        stop = min(start + piece, len(received))
        newest = int(np.searchsorted(sent.begin, newest_byte[stop - 1] + 1))
        number = newest - (newest - numbers_of(events)) % PERIOD
        # random pixels are taken for an event's if that has been sent lately
        good = (number >= 0) & (number < delivered.size) & (number > newest - 12_000)
        number = np.where(good, number, 0)
        good &= ~delivered[number]
        ahead = (events["t"] - sent.events["t"][number]) * sent.timed
        good &= in_line(np.append(last[0], number), np.append(last[1], ahead))[1:]
        last = number[-1], ahead[-1]
        # each once
        once = np.zeros(number.size, dtype=np.bool_)
        at = np.flatnonzero(good)
        once[at[np.unique(number[at], return_index=True)[1]]] = True
        good &= once
        delivered[number[good]] = True
        right, wrong = right + int(good.sum()), wrong + int((~good).sum())
    missed = tellable & ~delivered
    if health.accounting == "exact" and health.device_resets == 0 and delivered.any():
        first_and_last = np.flatnonzero(delivered)[[0, -1]]
        assert health.decoded + health.lost == first_and_last[1] - first_and_last[0] + 1, health
    away = where[sent.since[missed]] - run[where[sent.since[missed]]]
    return Outcome(n, int(intact.sum()), right, wrong, int(missed.sum()),
                   int(away.max(initial=-1)) + 1, decoder.health)  # fmt: skip


def in_line(number: Longs, ahead: Longs) -> npt.NDArray[np.bool_]:
    """Tell which events come soon after, or before, the one beside them, as they were sent.

    `ahead` is how far their times are ahead of those sent. The clock may be set anew, so that
    only the time from one event to the next counts.
    """
    steps = np.diff(number)
    agree = (steps > 0) & (steps < 100) & (np.diff(ahead) == 0)
    return np.append(agree, False) | np.append(False, agree)


_COLUMNS = (
    "protocol", "fault", "rate", "sent", "intact", "right", "wrong", "missed", "rejected", "lost",
    "resyncs", "longest resync, bytes", "stated",
)  # fmt: skip


def main() -> int:
    """Print what becomes of the events of every protocol under every fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--events", type=int, default=100_000, help="of each case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="protocols whose name has this")
    parser.add_argument("--kind", default="", help="only this kind of fault")
    options = parser.parse_args()
    begun, total, failed = time.monotonic(), 0, 0
    print("| " + " | ".join(_COLUMNS) + " |")
    print("|---|---|" + "--:|" * (len(_COLUMNS) - 2))
    for pair, (device, host, *_) in enumerate(DEVICES):
        name = host if device in host else device
        for kind in KINDS:
            if options.only not in name or options.kind not in kind:
                continue
            for rate in RATES if kind not in ("garbage", "wrap") else (0.0,):
                # a restart is rarer than a damaged byte
                share = rate / 10 if kind == "restart" else rate
                seed = [options.seed, pair, KINDS.index(kind), int(share * 1e7)]
                line = make_line(np.random.default_rng(seed), device, kind, share, options.events)
                result = decode(host, *line)
                total += result.sent
                health = result.health
                exact = health.accounting == "exact"
                stated = open_decoder(host, SENSOR).resync_bytes
                failed += result.resync > stated or (exact and result.wrong > 0)
                values = (
                    name, kind, f"{share:g}", result.sent, result.intact, result.right,
                    result.wrong, result.missed, health.rejected,
                    health.lost if exact else "unknown", health.resyncs, result.resync, stated,
                )  # fmt: skip
                print("| " + " | ".join(map(str, values)) + " |", flush=True)
    print(f"\n{total:,} events in {time.monotonic() - begun:.0f} s, {failed} cases failed")
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
