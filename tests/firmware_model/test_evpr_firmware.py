"""The encoder in C: what it takes arrives at the decoder to the bit, and the rest is counted."""

from __future__ import annotations

import csv
import re
import shutil
import struct
import subprocess
import sys
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge_vpr.events import Sensor, make_events
from edge_vpr.live.protocols import open_decoder
from edge_vpr.live.protocols.evpr import HEADER, EvprEncoder
from edge_vpr.live.protocols.timestamps import VOUCHED_SILENCE_US
from firmware_model.emulation.build import COUNTED, EMULATED, GCC, HOST, SOURCES, WARNINGS, build
from firmware_model.emulation.emulator import Emulator
from firmware_model.emulation.evpr_instructions import TABLE, measure
from firmware_model.emulation.instructions import table
from tests.live.test_stream_protocols import plain_evpr
from tests.streams import balanced

pytest.importorskip("ziglang", reason="ziglang is not installed (extra firmware)")
pytest.importorskip("unicorn", reason="unicorn is not installed (extra firmware)")
pytest.importorskip("elftools", reason="pyelftools is not installed (extra firmware)")

FILES = ("evpr.c", "evpr_drive.c")
PUSH, DROP, POLL, FLUSH, SEND = range(5)
TIMED = (PUSH, POLL, FLUSH)
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
        now = self.clock().max(initial=0)
        rest = [(SEND, ALL), (FLUSH, now)] * 2
        return self.then(*rest, (SEND, ALL))

    def clock(self):
        """Time of each step; that of the newest before it, where it has none."""
        return np.maximum.accumulate(np.where(np.isin(self.what, TIMED), self.value, 0))

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


def built_for_host(folder, name="evpr", options=()):
    # what is undefined behaviour ends the program
    trap = ("-fsanitize=undefined", "-fsanitize-trap=undefined")
    main = "evpr_drive_main.c"
    return build(HOST, folder, sources=SOURCES, files=FILES, program=main, name=name,
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
    run = subprocess.run([program, *files], capture_output=True, text=True, timeout=60, check=False)
    assert not run.returncode, f"exit {run.returncode}: {run.stderr}"
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
    most = rng.choice([1, 7, 100, 5_000, ALL], n)
    value = np.choose(what, [time, rng.choice([0, 1, 1_000, 1 << 26], n), time, time, most])
    x, y = rng.integers(0, 1 << setup.x_bits, n), rng.integers(0, 1 << setup.y_bits, n)
    p = rng.integers(0, 2, n)
    # here and there words without a zero, or of zeros: for the stuffing
    same = np.repeat(rng.choice([0, 1, 2], n // 100 + 1, p=[0.6, 0.2, 0.2]), 100)[:n]
    x, y, p = (np.choose(same, [v, top, 0]) for v, top in ((x, (1 << setup.x_bits) - 1),
               (y, (1 << setup.y_bits) - 1), (p, 1)))  # fmt: skip
    x += (rng.random(n) < 0.01) << setup.x_bits  # and some beyond the bits
    return Script(what, value, x, y, p).ended()


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
    for frame, of_frame in zip(frames, said, strict=True):
        header = HEADER.unpack_from(unstuffed(frame))
        encoder.dropped, base = header[4], header[5]
        assert len(unstuffed(frame)) <= setup.frame_bytes <= 8_192
        assert last <= base, "time runs backwards"
        last = of_frame[-1][0] if of_frame else base
        columns = zip(*of_frame, strict=True)
        made = encoder.encode(make_events(*columns)) if of_frame else encoder.idle(base)
        assert frame + b"\0" == made

    # the decoder that is in use
    decoder = open_decoder("evpr", setup.sensor)
    arrived = decoder.feed(run.out)
    health = decoder.health
    silent = np.diff(events["t"], prepend=setup.now) > VOUCHED_SILENCE_US
    if all(said) or not silent.any():
        assert np.array_equal(arrived, on_the_host(events, setup.now, health.clock_resets))
    else:  # an idle frame may end a silence: tests of the decoder hold its times
        for name in "xyp":
            assert np.array_equal(arrived[name], events[name])
    assert (health.lost, health.sequence_gaps, health.crc_errors, health.skipped_bytes) == (0,) * 4
    assert health.device_dropped == dropped
    assert balanced(health) and health.frames == len(frames)
    assert not decoder.finish().size
    return said


def on_the_host(events, start, resets):
    """Times from 0 on; the host takes a silence of more than 10 minutes for a clock's restart."""
    steps = np.diff(events["t"], prepend=start)
    long = steps > VOUCHED_SILENCE_US
    assert resets == long.sum()
    shifted = events.copy()
    shifted.t = np.cumsum(np.where(long, 1, steps))
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


@pytest.mark.slow
@given(setup=setups(), seed=st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_what_is_taken_arrives_and_what_is_not_is_counted(program, setup, seed):
    """For any widths, buffers, silences and stalls, with all counters about to wrap."""
    script = random_script(np.random.default_rng(seed), 700, setup)
    check(setup, script, run_host(program, setup, script))


#: what a careless engineer gets wrong shows in these
CORNERS = [
    Setup(now=MAX_32 - 500, sequence=MAX_32 - 50, dropped=MAX_32, position=MAX_32 - 3_000),
    Setup(128, 64, event_bytes=3, x_bits=7, y_bits=7),
    Setup(1_024, 512, event_bytes=3, x_bits=9, y_bits=9, position=5),
    Setup(64, 28, x_bits=15, y_bits=15),
    Setup(32, 27, event_bytes=3, x_bits=1, y_bits=1),
    Setup(16_384, 8_192, x_bits=11, y_bits=10),
    Setup(256, 100, event_bytes=3),
    Setup(64, 30, event_bytes=3, x_bits=7, y_bits=7),
    Setup(1 << 17, position=(1 << 17) - 100),  # a ring longer than 16 bits can tell
]


def corner_scripts():
    for seed, setup in enumerate(CORNERS):
        yield setup, random_script(np.random.default_rng(seed), 900, setup)


def test_every_processor_does_what_this_computer_does(program, emulator):
    """Each result, the moment at which each frame is ready, and each byte."""
    for setup, script in corner_scripts():
        here, there = run_host(program, setup, script), run_emulated(emulator, setup, script)
        assert np.array_equal(here.result, there.result)
        assert np.array_equal(here.ready, there.ready)
        assert here.out == there.out
        check(setup, script, there)


def polled_script(rng, setup):
    """A poll within each millisecond, and a line that takes all."""
    gaps = [0, 1, 50, 900, 3_999, 4_000, 4_001, 5_000, 98_999, 99_000, 99_001, 100_001, 350_000]
    pushed = setup.now + np.cumsum(rng.choice(gaps, 300, p=[0.3, 0.2, 0.2, 0.1, *[0.2 / 9] * 9]))
    end = int(pushed[-1]) + 250_000
    polled = setup.now + np.cumsum(rng.integers(900, 1_001, (end - setup.now) // 900))
    steps = [(t, PUSH, int(rng.integers(0, 1 << setup.x_bits))) for t in pushed.tolist()]
    steps += [(t, POLL, 0) for t in polled[polled <= end].tolist()]
    parts = [((what, t, x), (SEND, ALL)) for t, what, x in sorted(steps)]
    return Script.of([step for part in parts for step in part]).ended()


def check_times(setup, script, run):
    """A frame 5 ms after its first event at the latest, one in 100 ms at least, few of them empty.

    The two last frames are those of the end.
    """
    said = check(setup, script, run)
    ends = np.cumsum([len(frame) + 1 for frame in run.out.split(b"\0")[:-1]])
    made = script.clock()[np.searchsorted(run.ready, ends)]
    made[0] = setup.now
    waited = [at - of_frame[0][0] for at, of_frame in zip(made, said, strict=True) if of_frame]
    assert max(waited) <= 5_000 and sum(wait >= 3_000 for wait in waited) > 20
    silences = np.diff(made)[:-2]
    assert silences.max() <= 100_000
    empty = np.array([not of_frame for of_frame in said[1:-2]])
    assert empty.sum() > 10 and silences[empty].min() >= 98_000


@pytest.mark.parametrize("setup", CORNERS[:3], ids=lambda setup: f"{setup.frame_bytes}")
def test_frames_are_ready_in_time(program, setup):
    """Polled each millisecond, and no more often than that."""
    setup = replace(setup, buffer_bytes=1 << 16)
    script = polled_script(np.random.default_rng(1), setup)
    check_times(setup, script, run_host(program, setup, script))


def test_a_line_that_is_too_slow_carries_long_frames(program):
    """A quarter of the events fits through, and not in frames of one event, the dearest ones."""
    setup = Setup(4_096, 1_024)
    steps = [step for t in range(20_000) for step in ((PUSH, t, t % 300, 7), (SEND, 1))]
    script = Script.of(steps).ended()
    run = run_host(program, setup, script)
    said = check(setup, script, run)
    assert [len(of_frame) for of_frame in said[1:-3]] == [250] * (len(said) - 4)
    events, dropped = taken(setup, script, run)
    assert events.size > 20_000 / 4 and events.size + dropped == 20_000


def test_silences_of_any_length(program):
    """Up to 2^31 - 1 us between two calls, and beyond 2^32 us with calls between."""
    for silence in (0, 5_000, (1 << 31) - 1, 1 << 31, 1 << 32, (1 << 33) + 12_345):
        setup = Setup(now=MAX_32 - 7)
        between = range(setup.now, setup.now + silence, 20 * 60_000_000)
        polls = [step for t in between for step in ((POLL, t), (SEND, ALL))]
        end = setup.now + silence
        script = Script.of([*polls, (PUSH, end, 1, 2, 1), (PUSH, end + 1, 3, 4, 0)]).ended()
        said = check(setup, script, run_host(program, setup, script))
        events = [event for frame in said for event in frame]
        assert events == [(end, 1, 2, True), (end + 1, 3, 4, False)]


#: frames may be as old as they like, so that there are long pauses in them
PATIENT = ("-DEVPR_FRAME_US=0x7FFFFFFFU",)


def test_pauses_stand_in_for_a_frame_as_long_as_they_are_shorter(folder):
    """Any step, up to the longest that six pauses make."""
    patient = built_for_host(folder, name="patient", options=PATIENT)
    for setup, script, frames in pause_scripts():
        said = check(setup, script, run_host(patient, setup, script))
        assert [len(of_frame) for of_frame in said[:-2]] == frames


def pause_scripts():
    """Yield setups, scripts and the events of each frame but the two of the end."""
    for event_bytes, x_bits, y_bits in ((3, 7, 7), (3, 9, 9), (4, 9, 9), (4, 11, 10), (4, 15, 14)):
        setup = Setup(1 << 14, 8_192, 1, event_bytes, x_bits, y_bits)
        step, longest = setup.step_limit, setup.pause_limit
        steps = [step, step + 1, step + 2, longest, longest + 1, 6 * longest - 1, 6 * longest]
        times = np.cumsum([0, *(step for step in steps if step < 1 << 28)]).tolist()
        yield setup, Script.of([(PUSH, t, 1, 1, 1) for t in times]).ended(), [0, len(times)]
        beyond = times[-1] + max(6 * longest, step) + 1
        if beyond < 1 << 31:
            script = Script.of([(PUSH, t, 1, 1, 1) for t in (*times, beyond)]).ended()
            yield setup, script, [0, len(times), 1]


def test_time_does_not_run_backwards(program):
    """An event earlier than what was told gets its time, and nothing else changes."""
    steps = [(PUSH, 100, 1), (PUSH, 90, 2), (PUSH, 101, 3), (FLUSH, 200), (PUSH, 150, 4),
             (PUSH, 201, 5), (POLL, 150), (POLL, 300_000), (POLL, 400_000), (PUSH, 399_000, 6),
             (POLL, 399_500), (PUSH, 400_001, 7)]  # fmt: skip
    setup = Setup()
    script = Script.of(steps).ended()
    run = run_host(program, setup, script)
    assert (run.result[script.what == PUSH] == 1).all()
    told = [100, 100, 101, 200, 201, 400_000, 400_001]
    script.value[script.what == PUSH] = told
    said = check(setup, script, run)
    assert [event[:2] for frame in said for event in frame] == list(
        zip(told, range(1, 8), strict=True)
    )


REFUSED = {
    "buffer_bytes": (0, 1_024, 4_095, 4_097, 6_144),
    "frame_bytes": (0, 27, 8_193, 4_096, MAX_32),
    "event_bytes": (0, 2, 5),
    "x_bits": (0, 16, 22, 255),
    "y_bits": (0, 16, 22, 255),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_configuration_that_cannot_be_is_refused(emulator, name):
    """Instead of writing beyond the ring."""
    nothing = Script.of([(SEND, ALL)])
    assert run_emulated(emulator, Setup(), nothing).out
    for value in REFUSED[name]:
        setup = replace(Setup(), **{name: value})
        assert not run_emulated(emulator, setup, nothing).out, setup


# in evpr_t on a processor of 32 bits
READY_AT, STATE_BYTES = 68, 80


@pytest.mark.parametrize("most", [1, 40])
def test_the_consumer_may_interrupt_the_producer_anywhere(folder, most):
    """After each instruction of the producer the consumer takes up to `most` bytes, or none."""
    import unicorn

    target = EMULATED[0]
    emulator = Emulator(target, build(target, folder, files=FILES, name="evpr"))
    assert emulator.call("evpr_struct_bytes") == STATE_BYTES
    rng = np.random.default_rng(most)
    setup = Setup(128, 64, event_bytes=3, x_bits=7, y_bits=7)
    script = random_script(rng, 400, setup)
    ring, state = emulator.put(bytes(setup.buffer_bytes)), emulator.put(bytes(STATE_BYTES))
    out = bytearray()

    def consume(uc, most):
        ready, sent = struct.unpack("<II", uc.mem_read(state + READY_AT, 8))
        for at in range(sent, min(ready, sent + most)):
            out.extend(uc.mem_read(ring + at % setup.buffer_bytes, 1))
        uc.mem_write(state + READY_AT + 4, struct.pack("<I", min(ready, sent + most)))

    draws = iter(np.where(rng.random(1 << 20) < 0.02, most, 0).tolist())
    uc = emulator._uc
    uc.hook_add(unicorn.UC_HOOK_CODE, lambda uc, *_: consume(uc, next(draws)))
    config = struct.pack("<IIIHBBB", ring, setup.buffer_bytes, setup.frame_bytes, 1, 3, 7, 7)
    assert emulator.call("evpr_init", state, emulator.put(config), setup.now) & 1
    result = []
    columns = zip(*(column.tolist() for column in vars(script).values()), strict=True)
    for what, value, x, y, p in columns:
        value &= MAX_32
        if what == PUSH:
            result.append(emulator.call("evpr_push", state, value, x, y, p) & 1)
            continue
        result.append(0)
        if what == SEND:
            consume(uc, ALL)
        else:
            name = {DROP: "evpr_drop", POLL: "evpr_poll", FLUSH: "evpr_flush"}[what]
            emulator.call(name, state, value)
    check(setup, script, Ran(np.array(result), np.empty(0), bytes(out)))
    assert 0 < sum(result) < (script.what == PUSH).sum()


def test_no_address_or_arithmetic_is_undefined(folder):
    """Under the sanitisers of this computer's own compiler, if it has them."""
    compiler = shutil.which("cc")
    files = [str(SOURCES / file) for file in (*FILES, "evpr_drive_main.c")]
    checked = folder / "checked.elf"
    options = ["-std=c11", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    command = [compiler or "cc", *options, *files, "-o", str(checked)]
    if not compiler or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("no C compiler with -fsanitize=address,undefined")
    for setup, script in corner_scripts():
        check(setup, script, run_host(checked, setup, script))


def test_the_example_runs_and_accounts_for_every_event(folder):
    """What firmware authors copy: bursts, drops, silence, and an end in good order."""
    options = ("-fsanitize=undefined", "-fsanitize-trap=undefined")
    files, main = ("evpr.c",), "evpr_example.c"
    program = build(HOST, folder, files=files, program=main, name="example", options=options)
    run = subprocess.run([program], capture_output=True, check=True)
    decoder = open_decoder("evpr", Sensor(346, 260))
    events = decoder.feed(run.stdout)
    made, dropped = (int(word) for word in re.findall(rb"\d+", run.stderr))
    health = decoder.health
    assert events.size + health.device_dropped == made == 23_600
    assert health.device_dropped == dropped > 1_000
    assert health.lost == health.crc_errors == health.skipped_bytes == health.pending_bytes == 0
    times, number = events["t"], np.searchsorted(events["t"], 20_001)
    assert np.array_equal(times[number:], np.arange(20_050, 200_001, 50))
    assert np.array_equal(events["x"], times % 346) and np.array_equal(events["y"], times % 260)


def test_the_header_may_be_included_from_cpp(folder):
    """Many boards' libraries are in C++; its names are then those of C."""
    source, made = folder / "board.cpp", folder / "board.o"
    source.write_text('#include "evpr.h"\nvoid tick(evpr_t *e) { evpr_poll(e, 1U); }\n')
    options = ["-std=c++11", *WARNINGS, "-I", str(SOURCES), "-c", "-o", str(made)]
    command = [sys.executable, "-m", "ziglang", "c++", *options, str(source)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not run.returncode, run.stderr
    assert b"\0evpr_poll\0" in made.read_bytes()


@pytest.fixture(scope="module")
def measured(folder):
    with_gcc = shutil.which("arm-none-eabi-gcc") is not None
    return [measure(target, folder) for target in COUNTED if target != GCC or with_gcc]


@pytest.mark.slow
def test_the_table_of_instructions_is_true(measured):
    """It lies beside the sources, if they are compiled by the version that it names."""
    told, counted = TABLE.read_text(encoding="ascii").splitlines(), table(measured).splitlines()
    assert told[0] == counted[0]
    same = [line for line in told[1:] if line.split(",")[1] in {row.compiler for row in measured}]
    if not same:
        pytest.skip("the table is of other compilers than those that are here")
    assert set(same) <= set(counted)


@pytest.mark.slow
def test_instructions_and_sizes_stay_within_their_limits(measured):
    """A microcontroller has time and room for other things."""
    for row in measured:
        assert row.event_most <= 250 and row.frame <= 800 and row.dropped <= 80
        assert row.ram_bytes <= 80 and row.stack_bytes <= 160 and row.code_bytes <= 4_096


PAGE = Path(__file__).parents[2] / "docs/protocol_evpr.md"


def test_the_figures_in_the_specification_are_those_of_the_table():
    """And its events a second follow from them: 250 in a frame, a clock each instruction."""
    page = PAGE.read_text(encoding="utf-8")
    told = {row["target"]: row for row in csv.DictReader(TABLE.read_text("ascii").splitlines())}
    m0 = told["cortex-m0plus"]
    code, ram, stack = (int(m0[name]) for name in ("code_bytes", "ram_bytes", "stack_bytes"))
    assert f"the code takes {code:,} bytes, the RAM beside the ring {ram} bytes" in page
    assert f"the stack at most {stack} bytes" in page
    each = float(m0["event_4"]) + int(m0["frame"]) / 250
    assert f"takes {each:.0f} instructions per event" in page
    assert f"{48e6 / each / 1e3:.0f},000 events/s at 48 MHz" in page


def test_the_worked_frame_in_the_specification_is_what_the_encoder_makes(program):
    """docs/protocol_evpr.md: each line of the frame, and what goes over the line."""
    page = PAGE.read_text(encoding="utf-8")
    raw, line = (
        bytes.fromhex("".join(re.findall(r"^((?:[0-9a-f]{2} ?)+)(?:  |$)", block, re.MULTILINE)))
        for block in re.findall(r"```hex\n(.*?)```", page, re.DOTALL)
    )
    setup = Setup(256, 64, 0x1234, 3, 7, 7, 1_000_000, 7, 2)
    times = 1_000_000, 1_000_010, 1_001_000
    pushes = [
        (PUSH, *event) for event in zip(times, (5, 0, 127), (6, 127, 0), (1, 0, 1), strict=True)
    ]
    run = run_host(program, setup, Script.of(pushes).ended())
    frame = run.out.split(b"\0")[1]
    assert (unstuffed(frame), frame + b"\0") == (raw, line)
