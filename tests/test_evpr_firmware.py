"""The encoder in C: what it takes arrives at the decoder to the bit, and the rest is counted."""

from __future__ import annotations

import subprocess
from dataclasses import astuple, dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_stream_protocols import plain_evpr

from edge_vpr.events import Sensor, make_events
from edge_vpr.stream.gate import SILENCE_US
from edge_vpr.stream.protocols import open_decoder
from edge_vpr.stream.protocols.evpr import HEADER, EvprEncoder
from firmware_model.build import EMULATED, HOST, SOURCES, build
from firmware_model.emulator import Emulator

pytest.importorskip("ziglang", reason="ziglang is not installed (extra firmware)")
pytest.importorskip("unicorn", reason="unicorn is not installed (extra firmware)")
pytest.importorskip("elftools", reason="pyelftools is not installed (extra firmware)")

FILES = ("evpr.c", "evpr_drive.c")
PUSH, DROP, POLL, FLUSH, SEND = range(5)
ALL = 1 << 30
MAX_32 = (1 << 32) - 1


@dataclass(frozen=True)
class Setup:
    """As in evpr_drive.h."""

    buffer_bytes: int = 4_096
    frame_bytes: int = 1_024
    boot: int = 1
    event_bytes: int = 4
    x_bits: int = 9
    y_bits: int = 9
    now: int = 0
    sequence: int = 0
    dropped: int = 0
    position: int = 0

    @property
    def time_at(self):
        return self.x_bits + self.y_bits + 1

    @property
    def step_limit(self):
        """Longest step that needs no pause."""
        return (1 << (8 * self.event_bytes - self.time_at)) - 2

    @property
    def pause_limit(self):
        return (1 << self.time_at) - 1

    @property
    def sensor(self):
        return Sensor(1 << self.x_bits, 1 << self.y_bits)


@dataclass
class Script:
    """Steps for the encoder: what, value (of times, all 64 bits), x, y, p; shape (n,) each."""

    what: np.ndarray
    value: np.ndarray
    x: np.ndarray
    y: np.ndarray
    p: np.ndarray

    @classmethod
    def of(cls, steps):
        rows = [(*step, 0, 0, 0)[:5] for step in steps]
        return cls(*np.array(rows, dtype=np.int64).reshape(-1, 5).T)

    def then(self, *steps):
        more = Script.of(steps)
        pairs = zip(vars(self).values(), vars(more).values(), strict=True)
        return Script(*(np.concatenate(pair) for pair in pairs))

    def ended(self):
        """Send all, and tell all."""
        now = int(self.value[self.what != SEND].max(initial=0)) if self.what.size else 0
        now = max((int(v) for v in self.value[np.isin(self.what, (PUSH, POLL, FLUSH))]), default=0)
        rest = [(SEND, ALL), (FLUSH, now)] * 2
        return self.then(*rest, (SEND, ALL))

    def packed(self):
        words = np.stack([self.what, self.value, self.p << 31 | self.y << 16 | self.x], axis=1)
        return (words & MAX_32).astype("<u4").tobytes()


@dataclass
class Ran:
    """What the encoder did: result and bytes of whole frames after each step, and all bytes."""

    result: np.ndarray
    ready: np.ndarray
    out: bytes


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("evpr")


def built_for_host(folder, sources=SOURCES, name="evpr", options=()):
    # what is undefined behaviour ends the program
    trap = ("-fsanitize=undefined", "-fsanitize-trap=undefined")
    main = "evpr_drive_main.c"
    return build(HOST, folder, sources=sources, files=FILES, program=main, name=name,
                 options=(*trap, *options))  # fmt: skip


@pytest.fixture(scope="module")
def program(folder):
    return built_for_host(folder)


@pytest.fixture(scope="module", params=EMULATED, ids=lambda target: target.name)
def emulator(request, folder):
    return Emulator(request.param, build(request.param, folder, files=FILES, name="evpr"))


def run_host(program, setup, script):
    files = [program.with_suffix(suffix) for suffix in (".setup", ".steps", ".done", ".out")]
    files[0].write_bytes(np.array(astuple(setup), dtype="<u4").tobytes())
    files[1].write_bytes(script.packed())
    run = subprocess.run([program, *files], capture_output=True, text=True, check=False)
    assert run.returncode == 0, f"exit {run.returncode}: {run.stderr}"
    return ran(files[2].read_bytes(), files[3].read_bytes())


def run_emulated(emulator, setup, script):
    emulator.release()
    at = emulator.put(np.array(astuple(setup), dtype="<u4").tobytes())
    count = script.what.size
    steps = emulator.put(script.packed())
    buffer = emulator.put(bytes(setup.buffer_bytes))
    done = emulator.put(bytes(8 * count))
    out = emulator.put(bytes(64 * count + setup.buffer_bytes))
    used = emulator.call("evpr_drive", at, steps, count, buffer, done, out)
    return ran(emulator.get(done, 8 * count), emulator.get(out, used))


def ran(done, out):
    result, ready = np.frombuffer(done, dtype="<u4").reshape(-1, 2).T
    return Ran(result, ready.astype(np.int64), out)


def random_script(rng, n, setup):
    """Events in bursts and silences of every kind, on a line that may stall for long."""
    pause, limit = setup.step_limit + 1, setup.pause_limit
    odd = [0, 1, pause - 2, pause - 1, pause, pause + 1, limit - 1, limit, limit + 1, 2 * limit,
           pause + limit, 6 * limit, 6 * limit + 1, 3_999, 4_000, 4_001, 5_000, 98_999, 99_000,
           1_000_000, 1_000_001, 59_000_000]  # fmt: skip
    odd = np.array([step for step in odd if 0 <= step < 60_000_000])
    usual = rng.geometric(1 / rng.choice([1, 3, 30, 300, 3_000]), n) - 1
    step = np.where(rng.random(n) < rng.choice([0.01, 0.3]), rng.choice(odd, n), usual)
    sending = rng.choice([0.002, 0.02, 0.2])
    rest = 1 - 0.02 - 0.1 - 0.01 - sending
    what = rng.choice([PUSH, DROP, POLL, FLUSH, SEND], n, p=[rest, 0.02, 0.1, 0.01, sending])
    time = setup.now + np.cumsum(step)
    most = rng.choice([7, 100, 5_000, ALL], n)
    value = np.choose(what, [time, rng.choice([0, 1, 1_000, 1 << 26], n), time, time, most])
    # one in 100 lies beyond the bits
    beyond = rng.random(n) < 0.01
    x = rng.integers(0, 1 << setup.x_bits, n) + (beyond << setup.x_bits)
    y = rng.integers(0, 1 << setup.y_bits, n)
    return Script(what, value, x, y, rng.integers(0, 2, n)).ended()


def taken(setup, script, run):
    """Events that the encoder took, with all 64 bits of their times, and how many were dropped."""
    pushed = script.what == PUSH
    good = pushed & (run.result == 1)
    off = (script.x >> setup.x_bits) | (script.y >> setup.y_bits)
    assert not (good & (off > 0)).any()
    columns = (script.value, script.x, script.y, script.p)
    dropped = int((pushed & ~good).sum()) + int(script.value[script.what == DROP].sum())
    return make_events(*(column[good] for column in columns)), dropped


def check(setup, script, run):
    """All that must hold for any script that ends with `ended`; returns the frames' events."""
    events, dropped = taken(setup, script, run)
    frames = run.out.split(b"\0")
    assert frames.pop() == b"", "ends within a frame"

    # the decoder of the specification, and the encoder in Python: frame by frame
    said = [plain_evpr(frame) for frame in frames]
    assert [event for frame in said for event in frame] == events.tolist()
    encoder = EvprEncoder(setup.sensor, setup.event_bytes, setup.boot, frame_bytes=8_192)
    encoder._sequence = setup.sequence
    last = 0
    for frame, found in zip(frames, said, strict=True):
        header = HEADER.unpack_from(unstuffed(frame))
        encoder.dropped, base = header[4], header[5]
        assert len(unstuffed(frame)) <= setup.frame_bytes <= 8_192
        assert last <= base, "time runs backwards"
        last = found[-1][0] if found else base
        columns = zip(*found, strict=True)
        made = encoder.encode(make_events(*columns)) if found else encoder.idle(base)
        assert frame + b"\0" == made

    # the decoder that is in use
    decoder = open_decoder("evpr", setup.sensor)
    arrived = decoder.feed(run.out)
    health = decoder.health
    assert np.array_equal(arrived, on_the_host(events, setup.now, health.clock_resets))
    assert (health.lost, health.sequence_gaps, health.crc_errors, health.skipped_bytes) == (0,) * 4
    assert health.device_dropped == dropped
    assert health.balanced() and health.frames == len(frames)
    assert not decoder.finish().size
    return said


def on_the_host(events, start, resets):
    """Times from 0 on; the host takes a silence of more than a minute for a clock's restart."""
    steps = np.diff(events["t"], prepend=start)
    long = steps > SILENCE_US
    assert resets == long.sum()
    shifted = events.copy()
    shifted["t"] = np.cumsum(np.where(long, 1, steps))
    return shifted


def unstuffed(frame):
    raw = bytearray()
    at = 0
    while at < len(frame):
        code = frame[at]
        raw += frame[at + 1 : at + code] + (b"\0" if code < 255 else b"")
        at += code
    return bytes(raw[:-1] if code < 255 else raw)


@st.composite
def setups(draw):
    event_bytes = draw(st.sampled_from([3, 4]))
    x_bits = draw(st.integers(1, 15))
    y_bits = draw(st.integers(1, min(15, 8 * event_bytes - 2 - x_bits)))
    x_bits, y_bits = draw(st.sampled_from([(x_bits, y_bits), (7, 7), (9, 9)]))
    shortest = 24 + event_bytes
    frame_bytes = draw(st.sampled_from([shortest, shortest + 1, 64, 300, 1_024, 8_192]))
    stuffed = frame_bytes + (frame_bytes >> 7) + 2
    least = 1 << (stuffed - 1).bit_length()
    counters = st.sampled_from([0, MAX_32, MAX_32 - 100])
    buffer_bytes = least * draw(st.sampled_from([1, 2, 8]))
    return Setup(
        buffer_bytes, frame_bytes, draw(st.sampled_from([0, 1, 0xFFFF])), event_bytes,
        x_bits, y_bits, draw(st.sampled_from([0, 77, MAX_32 - 1_000, MAX_32])),
        draw(counters), draw(counters), draw(counters),
    )  # fmt: skip


@given(setup=setups(), seed=st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_what_is_taken_arrives_and_what_is_not_is_counted(program, setup, seed):
    """For any widths, buffers, silences and stalls, with all counters about to wrap."""
    script = random_script(np.random.default_rng(seed), 700, setup)
    check(setup, script, run_host(program, setup, script))
