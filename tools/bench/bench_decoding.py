"""Decoding 4 million events of a 128 x 128 sensor: from a camera's line in pieces, and from a file.

Each protocol is compared with reading the same bytes once, and with peers where there are any.
The note says how many events a second it decodes, and which share of a core a line of 12 Mbaud
takes, whose serial reads bring 1 to 4 KiB. Readers of files are rows of their own: they check no
word, hold no clock against the host's, and count no loss.
"""

from __future__ import annotations

import zlib
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from table import OURS

from edge_vpr.events import Sensor, join_events, make_events
from edge_vpr.live.protocols import open_decoder, open_encoder
from edge_vpr.recordings import open_recording
from edge_vpr.recordings.reading import CHUNK_EVENTS

SENSOR, EVENTS = Sensor(128, 128), 4_000_000
#: bytes a second of a line of 12 Mbaud, ten bits a byte
LINE = 1_200_000
PIECES = {"64 KiB": 65_536, "4 KiB": 4_096, "600 bytes": 600}
#: what the device speaks
PROTOCOLS = (
    "evpr", "evpr:width=3,frame=200", "edvs:format=E0", "edvs:format=E1", "edvs:format=E2", "edvs",
    "edvs:format=E4", "evt2", "evt21", "evt3", "aer", "aer:layout=jaer8",
)  # fmt: skip


def host_of(device):
    """Return what the host is set to: frames of evpr state their form."""
    return "evpr" if device.startswith("evpr") else device


@pytest.fixture(scope="module", params=PROTOCOLS)
def line(request):
    """Make 4 million events, 10 us apart on average, as one device sends them."""
    rng = np.random.default_rng(2022)
    x, y = rng.integers(0, 128, EVENTS), rng.integers(0, 128, EVENTS)
    p = rng.integers(0, 2, EVENTS)
    events = make_events(np.cumsum(rng.integers(1, 20, EVENTS)), x, y, p)
    encoder = open_encoder(request.param, SENSOR)
    data = b"".join(encoder.encode(events[i : i + 4_000]) for i in range(0, EVENTS, 4_000))
    decoder = open_decoder(host_of(request.param), SENSOR)
    decoded = join_events([decoder.feed(data), decoder.finish()])
    for name in "xyp":
        np.testing.assert_array_equal(decoded[name], events[name])
    return SimpleNamespace(device=request.param, data=data)


def cut(data: bytes, piece: int) -> list[bytes]:
    return [data[i : i + piece] for i in range(0, len(data), piece)]


@pytest.mark.parametrize("size", PIECES)
def bench_decoding(race, benchmark, line, size):
    pieces = cut(line.data, PIECES[size])
    host = host_of(line.device)

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


@pytest.mark.parametrize("line", ["evt3"], indirect=True)
def bench_words_by_a_decoder_of_pieces(race, line):
    """Race evt3, of Rust, which takes pieces of any size."""
    evt3 = pytest.importorskip("evt3", reason="evt3 is not installed")
    pieces = cut(line.data, PIECES["64 KiB"])

    def run():
        decoder = evt3.Decoder()
        return sum(len(decoder.feed(piece)) for piece in pieces)

    race("decode 4 M events, evt3, pieces of 64 KiB", "evt3, pieces", run, EVENTS, rounds=5)


def by_us(path, encoding):
    return sum(events.size for events in open_recording(path))


def by_eventcv(path, encoding):
    return len(pytest.importorskip("eventcv").load(str(path)).numpy())


def by_faery(path, encoding):
    return pytest.importorskip("faery").events_stream_from_file(path).to_array().size


def by_expelliarmus(path, encoding):
    return pytest.importorskip("expelliarmus").Wizard(encoding=encoding).read(str(path)).size


def by_expelliarmus_in_chunks(path, encoding):
    wizard = pytest.importorskip("expelliarmus").Wizard(encoding=encoding, chunk_size=CHUNK_EVENTS)
    wizard.set_file(str(path))
    return sum(chunk.size for chunk in wizard.read_chunk())


def by_evt3(path, encoding):
    return len(pytest.importorskip("evt3").decode_file(str(path)))


READERS = {
    OURS: by_us,
    "eventcv": by_eventcv,
    "faery": by_faery,
    "expelliarmus": by_expelliarmus,
    "expelliarmus, in chunks": by_expelliarmus_in_chunks,
    "evt3": by_evt3,
}


@pytest.mark.parametrize("line", ["evt2", "evt3"], indirect=True)
@pytest.mark.parametrize("reader", READERS)
def bench_readers_of_files(race, line, reader, tmp_path):
    if reader == "evt3" and line.device != "evt3":
        pytest.skip("evt3 reads EVT 3.0 alone")
    path = tmp_path / "words.raw"
    header = (
        f"% evt {line.device[3]}.0\n% format {line.device.upper()}\n% geometry {SENSOR}\n% end\n"
    )
    path.write_bytes(header.encode() + line.data)
    run = partial(READERS[reader], path, line.device)
    race(f"read 4 M events of a file, {line.device}", reader, run, EVENTS, rounds=5)
