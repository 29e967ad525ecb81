"""Fuzz every stream decoder, guided by the branches it takes.

``pip install atheris``, then in this folder ``NUMBA_DISABLE_JIT=1 python fuzz_decoders.py
-max_total_time=600 CORPUS_FOLDER``; kernels run as plain Python, so that their branches show. A
find is kept as a test in `test_stream_protocols.py`.
"""

from __future__ import annotations

import sys
from importlib import import_module

import atheris

with atheris.instrument_imports(include=["edge_vpr.stream", "edge_vpr.recordings.evt"]):
    from edge_vpr.events import Sensor
    from edge_vpr.stream.protocols import open_decoder, open_encoder

    # imported when first used, which is too late to be instrumented
    for protocol in ("aer", "edvs", "evpr", "evt", "openmv"):
        import_module(f"edge_vpr.stream.protocols.{protocol}")

import numpy as np

from edge_vpr.events import make_events

#: what the host is told, and a device that may speak it
PAIRS = (
    ("evpr", "evpr:frame=64"),
    ("evpr", "evpr:width=3,frame=100"),
    ("openmv", "openmv"),
    ("openmv:channel=4", "openmv:channel=4"),
    ("openmv:channel=4,format=evt21", "openmv:channel=4,format=evt21"),
    ("edvs", "edvs:format=E2"),
    ("edvs", "edvs:format=E4,sync=0"),
    ("edvs:format=E0,sync=1", "edvs:format=E0"),
    ("edvs:format=E1,dialect=new,sync=1", "edvs:format=E1"),
    ("edvs:format=E3,dialect=new,sync=1", "edvs:format=E3"),
    ("evt2", "evt2"),
    ("evt21", "evt21"),
    ("evt3", "evt3"),
    ("aer", "aer"),
    ("aer:layout=jaer8", "aer:layout=jaer8"),
)
MOST_PENDING = 66_000


def sent(data: atheris.FuzzedDataProvider, device: str) -> bytes:
    """Events with steps and pixels out of the input, as a device sends them."""
    n = data.ConsumeIntInRange(0, 120)
    steps = [data.ConsumeIntInRange(0, 3) and data.ConsumeIntInRange(0, 1 << 20) for _ in range(n)]
    pixels = np.frombuffer(data.ConsumeBytes(2 * n).ljust(2 * n, b"\7"), dtype=np.uint8) % 128
    x, y = pixels[:n], pixels[n:]
    return open_encoder(device, Sensor(128, 128)).encode(make_events(np.cumsum(steps), x, y, x % 2))


def one(raw: bytes) -> None:
    """Feed one input; raise if a promise is broken."""
    data = atheris.FuzzedDataProvider(raw)
    host, device = PAIRS[data.ConsumeIntInRange(0, len(PAIRS) - 1)]
    sensor = Sensor(data.ConsumeIntInRange(1, 128), data.ConsumeIntInRange(1, 128))
    decoder = open_decoder(host, sensor)
    now, received = 0, 0
    for _ in range(data.ConsumeIntInRange(1, 6)):
        what = data.ConsumeIntInRange(0, 7)
        if what == 0:
            events = decoder.gap(data.ConsumeIntInRange(0, 1 << 16))
        else:
            stretch = data.ConsumeBytes(data.ConsumeIntInRange(0, 600))
            if what > 3:
                good = bytearray(sent(data, device))
                at = data.ConsumeIntInRange(0, len(good))
                good[at : at + what - 4] = stretch[: what - 4]
                stretch = bytes(good)
            received += len(stretch)
            events = decoder.feed(stretch, data.ConsumeIntInRange(0, 1 << 40))
        now = check(decoder, events, sensor, now)
    check(decoder, decoder.finish(), sensor, now)
    assert decoder.health.bytes == received


def check(decoder, events, sensor, now):  # type: ignore[no-untyped-def]
    """Books balance, time runs forward, events lie on the sensor, memory is bounded."""
    assert decoder.health.balanced(), decoder.health
    assert decoder.health.pending_bytes <= MOST_PENDING
    if events.size == 0:
        return now
    assert events["t"][0] >= now
    assert (events["t"][1:] >= events["t"][:-1]).all()
    assert events["x"].max() < sensor.width
    assert events["y"].max() < sensor.height
    return int(events["t"][-1])


if __name__ == "__main__":
    atheris.Setup(sys.argv, one)
    atheris.Fuzz()
