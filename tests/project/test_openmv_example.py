"""What `examples/openmv/main.py` sends is decoded; stand-ins play the modules of the camera."""

from __future__ import annotations

import runpy
import sys
import time
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from edge_vpr.events import Sensor
from edge_vpr.live.protocols import open_decoder

SCRIPT = Path(__file__).parents[2] / "examples" / "openmv" / "main.py"
SENSOR = Sensor(320, 320)


class SwitchedOffError(Exception):
    """Nothing is left to read."""


def played(monkeypatch, reads):
    """Run the script on reads of (t, x, y, p), each after a time; return what the line got."""
    now, sent = [0], []

    class Camera:
        def __init__(self, cid):
            assert cid == "GENX320"
            self.left = iter(reads)

        def reset(self):
            pass

        def ioctl(self, request, argument, *more):
            if request == "SET_MODE":
                assert (argument, *more) == ("EVENT", 1024)
                return 0
            assert request == "READ" and argument.shape == (1024, 6)
            try:
                passed_us, events = next(self.left)
            except StopIteration:
                raise SwitchedOffError from None
            now[0] += passed_us
            for row, (t, x, y, p) in zip(argument, events, strict=False):
                seconds, us = divmod(t, 1_000_000)
                row[:] = p, seconds & 0xFFFF, us // 1000, us % 1000, x, y
            return len(events)

    class Line:
        def __init__(self, port, baud):
            self.bytes_per_us = baud / 1e7

        def write(self, data):
            sent.append(bytes(data))
            now[0] += round(len(data) / self.bytes_per_us)

    def viper(function):
        """Call it as viper does: arrays are pointers to their numbers."""
        return lambda *values: function(
            *(
                value.reshape(-1).tolist() if isinstance(value, np.ndarray) else value
                for value in values
            )
        )

    constants = {"GENX320": "GENX320", "IOCTL_GENX320_SET_MODE": "SET_MODE"}
    constants |= {"IOCTL_GENX320_READ_EVENTS": "READ", "GENX320_MODE_EVENT": "EVENT"}
    modules = {
        "csi": {"CSI": Camera, **constants}, "micropython": {"viper": viper},
        "machine": {"UART": Line}, "ulab": {"numpy": np},
    }  # fmt: skip
    for name, members in modules.items():
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
        vars(sys.modules[name]).update(members)
    monkeypatch.setattr(time, "ticks_us", lambda: now[0] & 0x3FFFFFFF, raising=False)
    monkeypatch.setattr(
        time,
        "ticks_diff",
        lambda a, b: ((a - b + (1 << 29)) & 0x3FFFFFFF) - (1 << 29),
        raising=False,
    )
    # viper's types are known to its compiler alone
    types = dict.fromkeys(("ptr8", "ptr16", "ptr32"), int)
    with pytest.raises(SwitchedOffError):
        runpy.run_path(str(SCRIPT), types, "__main__")
    return sent


def decoded(sent):
    decoder = open_decoder("evpr", SENSOR)
    events = np.concatenate([decoder.feed(data, 0) for data in sent])
    return decoder, [tuple(map(int, event)) for event in events[["t", "x", "y", "p"]]]


def drive(rng, number, start_us, step_us):
    times = start_us + np.cumsum(rng.integers(0, step_us, number))
    x, y, p = (rng.integers(0, most, number) for most in (320, 320, 2))
    return list(zip(times.tolist(), x.tolist(), y.tolist(), p.tolist(), strict=True))


@pytest.mark.parametrize("start_s", [0, 65_530])
def test_every_event_arrives_with_its_time(monkeypatch, start_s):
    """Of full reads, with pauses, silences of idle frames, and a wrap of the sensor's seconds."""
    rng, at_us, reads, expected = np.random.default_rng(0), start_s * 1_000_000 + 7, [], []
    for number, step_us in ((1024, 90), (3, 9_000), (600, 20_000), (700, 500), (1, 2)):
        events = drive(rng, number, at_us, step_us)
        reads += [(events[-1][0] - at_us + 20_000, events), *[(60_000, [])] * 4]
        at_us, expected = events[-1][0] + 1_000_000, expected + events
    decoder, got = decoded(played(monkeypatch, reads))
    apart = expected[0][0] - got[0][0]
    assert [(t + apart, *rest) for t, *rest in got] == expected
    assert decoder.health.lost == decoder.health.device_dropped == 0


def test_what_the_line_cannot_carry_is_counted(monkeypatch):
    """And what a line loses too; the time goes on."""
    events = drive(np.random.default_rng(1), 40 * 1024, 0, 4)
    reads = [(2_000, events[i : i + 1024]) for i in range(0, len(events), 1024)]
    sent = played(monkeypatch, reads)
    decoder, got = decoded(sent)
    health = decoder.health
    assert health.device_dropped > 0 and health.lost == 0
    # the last read's own number would be in the next frame
    assert len(events) - 1024 <= len(got) + health.device_dropped <= len(events)
    assert set(got) < set(events)
    del sent[3]
    decoder, fewer = decoded(sent)
    assert decoder.health.lost == len(got) - len(fewer) > 0
