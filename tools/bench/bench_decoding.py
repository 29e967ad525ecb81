"""Decoding 4 million events of a 128 x 128 sensor from a camera's line, in pieces of three sizes.

Each protocol is compared with reading the same bytes once, and with peers where there are any.
The note says how many events a second it decodes, and which share of a core a line of 12 Mbaud
takes, whose serial reads bring 1 to 4 KiB.
"""

from __future__ import annotations

import zlib
from types import SimpleNamespace

import numpy as np
import pytest
from table import OURS

from edge_vpr.events import Sensor, make_events
from edge_vpr.live.protocols import open_decoder, open_encoder

SENSOR, EVENTS = Sensor(128, 128), 4_000_000
#: bytes a second of a line of 12 Mbaud, ten bits a byte
LINE = 1_200_000
PIECES = {"64 KiB": 65_536, "4 KiB": 4_096, "600 bytes": 600}
#: what the device speaks, and what the host is set to
PROTOCOLS = {
    "evpr": "evpr",
    "evpr:width=3,frame=200": "evpr",
    "edvs:format=E0": "edvs:format=E0,sync=1",
    "edvs:format=E1": "edvs",
    "edvs:format=E2": "edvs",
    "edvs:format=E3": "edvs",
    "edvs:format=E4": "edvs",
    "evt2": "evt2",
    "evt21": "evt21",
    "evt3": "evt3",
    "aer": "aer",
    "aer:layout=jaer8": "aer:layout=jaer8",
}


@pytest.fixture(scope="module", params=PROTOCOLS)
def line(request):
    """Make 4 million events, 10 us apart on average, as one device sends them."""
    rng = np.random.default_rng(2022)
    x, y = rng.integers(0, 128, EVENTS), rng.integers(0, 128, EVENTS)
    p = rng.integers(0, 2, EVENTS)
    events = make_events(np.cumsum(rng.integers(1, 20, EVENTS)), x, y, p)
    encoder = open_encoder(request.param, SENSOR)
    data = b"".join(encoder.encode(part) for part in np.array_split(events, 1_000))
    decoder = open_decoder(PROTOCOLS[request.param], SENSOR)
    decoded = np.concatenate([decoder.feed(data), decoder.finish()])
    np.testing.assert_array_equal(decoded[["x", "y", "p"]], events[["x", "y", "p"]])
    return SimpleNamespace(device=request.param, data=data)


def cut(data: bytes, piece: int) -> list[bytes]:
    return [data[i : i + piece] for i in range(0, len(data), piece)]


@pytest.mark.parametrize("size", PIECES)
def bench_decoding(race, benchmark, line, size):
    pieces = cut(line.data, PIECES[size])
    host = PROTOCOLS[line.device]
    open_decoder(host, SENSOR).warm_up()

    def run():
        decoder = open_decoder(host, SENSOR)
        return sum(decoder.feed(piece).size for piece in pieces) + decoder.finish().size

    race(f"decode 4 M events, {line.device}, pieces of {size}", OURS, run, EVENTS, rounds=5)
    if benchmark.stats is None:  # --benchmark-disable: run once, to see that it still runs
        return
    least = benchmark.stats.stats.min
    share = least / (len(line.data) / LINE)
    benchmark.extra_info["note"] = f"{EVENTS / least / 1e6:.0f} M events/s, {share:.1%} of a core"


@pytest.mark.parametrize("size", PIECES)
def bench_reading_only(race, line, size):
    pieces = cut(line.data, PIECES[size])
    expected = int(np.frombuffer(line.data, np.uint8).sum())

    def run():
        return sum(int(np.frombuffer(piece, np.uint8).sum()) for piece in pieces)

    work = f"decode 4 M events, {line.device}, pieces of {size}"
    race(work, "sum of the bytes, NumPy", run, expected, rounds=5, limit=True)


@pytest.mark.parametrize("line", ["evpr", "evpr:width=3,frame=200"], indirect=True)
def bench_framing_of_others(race, line):
    """Race COBS and its checksum alone, without decoding events: `cobs` in C, and zlib."""
    cobs = pytest.importorskip("cobs.cobs", reason="cobs is not installed")
    pieces = cut(line.data, PIECES["64 KiB"])

    def run():
        rest, frames = b"", 0
        for piece in pieces:
            *whole, rest = (rest + piece).split(b"\0")
            for frame in whole:
                plain = cobs.decode(frame)
                frames += zlib.crc32(plain[:-4]) == int.from_bytes(plain[-4:], "little")
        return frames

    work = f"decode 4 M events, {line.device}, pieces of 64 KiB"
    race(work, "cobs + zlib, framing only", run, line.data.count(b"\0"), rounds=3)


def by_eventcv(path):
    eventcv = pytest.importorskip("eventcv", reason="eventcv is not installed")
    return lambda: len(eventcv.load(str(path)).numpy())


def by_faery(path):
    faery = pytest.importorskip("faery", reason="faery is not installed")
    return lambda: faery.events_stream_from_file(path).to_array().size


def by_expelliarmus(path, encoding):
    expelliarmus = pytest.importorskip("expelliarmus", reason="expelliarmus is not installed")
    return lambda: expelliarmus.Wizard(encoding=encoding).read(str(path)).size


@pytest.mark.parametrize("line", ["evt2", "evt3"], indirect=True)
@pytest.mark.parametrize("peer", ["eventcv", "faery", "expelliarmus"])
def bench_words_by_readers_of_files(race, line, peer, tmp_path):
    """Race readers of files, none of which takes words from a line: the file lies in memory."""
    path = tmp_path / "words.raw"
    header = (
        f"% evt {line.device[3]}.0\n% format {line.device.upper()}\n% geometry {SENSOR}\n% end\n"
    )
    path.write_bytes(header.encode() + line.data)
    run = {
        "eventcv": lambda: by_eventcv(path),
        "faery": lambda: by_faery(path),
        "expelliarmus": lambda: by_expelliarmus(path, line.device),
    }[peer]()
    race(
        f"decode 4 M events, {line.device}, pieces of 64 KiB",
        f"{peer}, whole file",
        run,
        EVENTS,
        rounds=3,
    )
