"""A serial power meter, played over a real pseudo-terminal by a script of what it answers."""

from __future__ import annotations

import threading
import time

import pytest
from edge_vpr_tools.profile.measurement import Sampler
from edge_vpr_tools.profile.sensors import um_meter
from edge_vpr_tools.profile.sensors.sensor import SensorError
from edge_vpr_tools.profile.sensors.um_meter import UmMeter, decode, from_head

from edge_vpr.live.bridge import VirtualLink
from edge_vpr.live.links import LinkError

UM24C, UM25C, UM34C = 0x0963, 0x09C9, 0x0D4C
END = b"\xff\xf1"


def frame(model=UM25C, volts=5_000, amperes=4_000, milliwatts=2_000, end=END):
    """Bytes by hand: model at 0, voltage at 2, current at 4, power at 6, end at 128."""
    head = model.to_bytes(2, "big") + volts.to_bytes(2, "big") + amperes.to_bytes(2, "big")
    head += milliwatts.to_bytes(4, "big")
    return head + bytes(118) + end


class Script(threading.Thread):
    """A meter that gives its answers in turn, the last one for ever; None unplugs it."""

    def __init__(self, *answers):
        super().__init__(daemon=True)
        self.link, self.answers, self.asked = VirtualLink(), list(answers), []
        self.address = self.link.address
        self.ended = threading.Event()

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *unused):
        self.ended.set()
        self.join()
        self.link.close()

    def run(self):
        while not self.ended.is_set():
            try:
                asked = self.link.read(0.05)
            except LinkError:
                return  # the host has closed its end
            for byte in asked:
                self.asked.append(byte)
                answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
                if answer is None:
                    self.link.close()
                    return
                self.link.write(answer, 1.0)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """A meter that is asked ten times as often, and given up ten times as soon."""
    for name, seconds in (("_PERIOD_S", 0.05), ("_ANSWER_S", 0.04), ("_PATIENCE_S", 0.5)):
        monkeypatch.setattr(um_meter, name, seconds)


@pytest.mark.parametrize(
    ("model", "volts", "amperes", "name"),
    [
        (UM25C, 5_000, 4_000, "UM25C"),  # steps of 1 mV and 0.1 mA
        (UM24C, 500, 400, "UM24C"),  # of 10 mV and 1 mA
        (UM34C, 500, 400, "UM34C"),
    ],
)
def test_each_model_has_its_own_steps(model, volts, amperes, name):
    """5 V and 0.4 A are 2 W, whatever they are told in."""
    found, watts = decode(frame(model, volts, amperes))
    assert found.name == name and watts == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (frame()[:-1], "129 bytes"),
        (frame(model=0x1234), "0x1234"),
        (frame(end=b"\0\0"), "ends with 0000"),
        (frame(UM34C, 500, 400, 90_000), "90 W told"),
    ],
)
def test_what_is_no_frame_is_refused(wrong, says):
    """Length, model, end, and a power that is not volts times amperes."""
    with pytest.raises(SensorError, match=says):
        decode(wrong)


def test_a_frame_is_found_behind_noise():
    """Wherever it begins, and also if only its first byte has come."""
    assert from_head(b"noise" + frame()) == frame()
    assert from_head(b"noise\x09") == b"\x09"
    assert from_head(b"noise") == b""


def test_a_meter_is_asked_and_says_what_it_is():
    """Over a terminal: one byte 0xF0 a reading, which tells watts and its own moment."""
    with Script(frame()) as script:
        meter = UmMeter(script.address)
        try:
            assert meter.read() == pytest.approx(2.0)
            about = meter.about
            assert about.name.startswith("UM25C@") and about.kind == "power"
            assert about.period_s == um_meter._PERIOD_S and about.resolution == 5e-4
            assert about.gain_error > 0 and "assumption" in about.detail
            first = meter.sample()
            time.sleep(0.2)
            assert meter.sample()[0] > first[0]
        finally:
            meter.close()
        assert set(script.asked) == {0xF0}


def test_reading_never_waits():
    """A silent meter does not hold up who reads it."""
    with Script(frame(), b"") as script:
        meter = UmMeter(script.address)
        try:
            start = time.perf_counter()
            for _ in range(100):
                meter.read()
            assert time.perf_counter() - start < 0.1
        finally:
            meter.close()


def test_short_frames_and_noise_are_passed_over():
    """A reading comes once a whole frame does; a sampler takes each frame once."""
    noisy = b"\x55\xaa" * 40 + frame(amperes=6_000, milliwatts=3_000) + b"\x09\xc9"
    with Script(frame()[:60], b"garbage" * 30, noisy) as script:
        meter = UmMeter(script.address)
        with Sampler(meter) as sampler:
            time.sleep(0.3)
        meter.close()
    trace = sampler.trace()
    assert 2 <= trace.time_s.size <= 12
    assert trace.energy_j[-1] / (trace.time_s[-1] - trace.time_s[0]) == pytest.approx(3.0)


def test_readings_that_repeat_are_no_new_ones():
    """As a slow meter's do."""
    with Script(frame()) as script:
        meter = UmMeter(script.address)
        with Sampler(meter) as sampler:
            time.sleep(0.3)
        meter.close()
    assert sampler.trace().fresh.sum() == 1


@pytest.mark.parametrize(
    ("last", "says"), [(None, "plugged in"), (b"", "no whole reading"), (frame()[:60], "60 bytes")]
)
def test_a_meter_that_goes_silent_or_is_pulled_ends_the_sampling(last, says):
    """With its reason, and without a figure."""
    with Script(frame(), frame(), last) as script:
        meter = UmMeter(script.address)
        with Sampler(meter) as sampler:
            time.sleep(0.9)
        meter.close()
    with pytest.raises(SensorError, match=says):
        sampler.trace()


def test_a_port_without_a_meter_says_so():
    """Nothing there; nothing that answers; something else that does."""
    with pytest.raises(SensorError, match="cannot open /dev/nowhere"):
        UmMeter("/dev/nowhere")
    for answer, says in ((b"", "no byte"), (b"OK\r\n", "no byte"), (frame()[:9], "9 bytes")):
        with Script(answer) as script, pytest.raises(SensorError, match=says):
            UmMeter(script.address)
