"""Protocols of serial cameras: what is sent arrives, and what does not arrive is accounted for."""

from __future__ import annotations

import struct
import time
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor, join_events, make_events
from edge_vpr.live.protocols import PROTOCOLS, Health, open_decoder, open_encoder, parse_protocol
from edge_vpr.live.protocols.aer import read_layout
from edge_vpr.live.protocols.evpr import HEADER, MAX_FRAME, MAX_STUFFED, stuff
from edge_vpr.live.protocols.timestamps import UNKNOWN_US
from edge_vpr.recordings import open_recording
from edge_vpr.recordings.prophesee import read_header
from tests.live.devices import DEVICES
from tests.live.fuzz_decoders import MOST_PENDING
from tests.live.line_faults import KINDS, corrupt, decode, make_line
from tests.recordings.recording_files import payloads
from tests.streams import balanced, from_first, random_events, read_events, split_events

SENSOR = Sensor(128, 128)
#: with time stamps, so that all events come back
TIMED = [each[:3] for each in DEVICES if "E0" not in each.sends]
#: clocks that wrap, and their bits
WRAPPING = [(each.sends, each.host, each.clock_bits) for each in DEVICES if each.clock_bits]
every_protocol = pytest.mark.parametrize(("device", "host", "checked"), TIMED)


def encoded(device, events, pieces=7):
    encoder = open_encoder(device, SENSOR)
    cuts = split_events(events, pieces)
    return encoder.start() + b"".join(encoder.encode(part) for part in cuts)


def decoded(decoder, data, cuts=()):
    """All events of the bytes, cut at the given places, and a check of the books at each."""
    events = []
    for start, stop in zip([0, *cuts], [*cuts, len(data)], strict=True):
        events.append(decoder.feed(data[start:stop]))
        assert balanced(decoder.health)
    events.append(decoder.finish())
    assert balanced(decoder.health)
    return join_events(events)


def received(host, data, cuts=()):
    """All events of the bytes, and what the decoder has counted."""
    decoder = open_decoder(host, SENSOR)
    return decoded(decoder, data, cuts), decoder.health


def pixels(events):
    """Events without their times."""
    return np.asarray(events)[["x", "y", "p"]]


def dense(n, seed=0):
    return random_events(np.random.default_rng(seed), n, SENSOR, 10 * n)


@pytest.mark.slow
@every_protocol
@given(data=st.data())
@settings(max_examples=15)
def test_what_is_sent_arrives_to_the_bit_however_the_bytes_are_cut(device, host, checked, data):
    n = data.draw(st.integers(30, 600))
    gaps = data.draw(st.sampled_from([1, 30, 300, 10_000]))
    rng = np.random.default_rng(data.draw(st.integers(0, 999)))
    events = random_events(rng, n, SENSOR, n)
    events.t = np.cumsum(rng.integers(0, gaps, n))
    sent = encoded(device, events, pieces=data.draw(st.integers(1, 5)))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(sent)), max_size=12)))
    arrived, health = received(host, sent, cuts)
    expected = events if device.startswith("evpr") else from_first(events)
    assert arrived.packed
    assert np.array_equal(arrived, expected)
    assert (health.skipped_bytes, health.resyncs, health.lost, health.rejected) == (0, 0, 0, 0)
    assert health.decoded_bytes == len(sent)


#: fewer events in plain Python, and no rate at which so few of them meet no fault
PLAIN = bool(config.DISABLE_JIT)
EVENTS = 1_000 if PLAIN else 20_000
RATES = (1e-2,) if PLAIN else (1e-4, 1e-2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number", range(len(DEVICES)), ids=[f"{a}-{b}" for a, b, *_ in DEVICES])
def test_after_any_fault_the_stream_is_found_again_within_the_stated_bytes(number, kind):
    """And the books balance at every piece, and what a checksum guards is as it was sent."""
    device, host, *_ = DEVICES[number]
    for rate in RATES:
        rng = np.random.default_rng([number, KINDS.index(kind)])
        line = make_line(rng, device, kind, rate, EVENTS, same=True)
        outcome = decode(host, *line)
        assert outcome.resync <= open_decoder(host, SENSOR).resync_bytes
        if outcome.health.accounting != "unknown":
            assert outcome.wrong == 0
        if kind == "wrap":
            assert (outcome.right, outcome.health.clock_resets) == (EVENTS, 0)
            return
        if rate < 1e-3 and kind not in ("truncate", "noise", "garbage") and not PLAIN:
            assert outcome.right > 0.5 * EVENTS


@every_protocol
@given(data=st.data())
@settings(max_examples=5 if PLAIN else 30)
def test_silences_restarts_and_damage_are_the_same_however_the_bytes_are_cut(
    device, host, checked, data
):
    """Of `evpr`, a silence before a restart in the same piece was forgotten."""
    rng = np.random.default_rng(data.draw(st.integers(0, 999)))
    encoder, at_us, received = open_encoder(device, SENSOR), 0, b""
    parts = st.sampled_from(["events", "damaged", "silence", "restart", "noise", "repeat"])
    places, part = [], b""
    for kind in data.draw(st.lists(parts, min_size=2, max_size=12)):
        if kind in ("events", "damaged"):
            number = 1_500 if rng.random() < 0.1 and not PLAIN else 40
            events = random_events(rng, number, SENSOR, 50 * number)
            events.t += at_us
            at_us = int(events["t"][-1])
            part = encoder.encode(events)
            if kind == "damaged":
                part, _ = corrupt(rng, part, rng.choice(KINDS[:-3]), 1e-2)
        elif kind == "silence":
            at_us += int(rng.choice([1_000, 5_000_000, 100_000_000]))
            part = encoder.idle(at_us)
        elif kind == "restart":
            new = f"{device}{',' if ':' in device else ':'}boot={rng.integers(3)}"
            encoder = open_encoder(new if "evpr" in device else device, SENSOR)
            at_us = int(rng.choice([0, 2_000_000]))
            part = encoder.start()
        elif kind == "noise":
            part = rng.bytes(int(rng.integers(1, 60)))
        received += part
        places.append(len(received))
    cuts = data.draw(st.lists(st.integers(0, len(received)), max_size=12))
    whole = open_decoder(host, SENSOR)
    expected = decoded(whole, received)
    bytewise = range(1, min(len(received), 3_000))
    for each in (sorted([*cuts, *places[:-1]]), sorted(cuts), bytewise):
        cut = open_decoder(host, SENSOR)
        assert np.array_equal(decoded(cut, received, list(each)), expected)
        assert (cut.health, cut.reached_us) == (whole.health, whole.reached_us)


@every_protocol
def test_the_next_event_comes_once_the_stated_bytes_have_come(device, host, checked):
    """And not only when more have come, or the stream has ended."""
    events = dense(20_000)
    sent = encoded(device, events, 400)
    decoder = open_decoder(host, SENSOR)
    half = len(sent) // 2
    before = decoder.feed(sent[:half]).size
    behind = decoder.feed(sent[half + 1 : half + 1 + decoder.resync_bytes])
    assert behind.size > 0
    newest = np.flatnonzero(pixels(events) == pixels(behind)[-1])
    assert (newest > before).any()


@pytest.mark.parametrize("device", ["edvs:format=E2", "aer"])
def test_events_so_rare_that_their_times_say_nothing_are_not_taken_for_a_lost_place(device):
    events = dense(300)
    events.t = np.cumsum(np.random.default_rng(0).integers(0, 500_000, events.size))
    sent = encoded(device, events)
    arrived, health = received(device, sent)
    assert arrived.size + health.late == events.size
    assert health.late < events.size // 30
    assert (health.skipped_bytes, health.resyncs) == (0, 0)


def test_evpr_frames_that_come_twice_are_delivered_once():
    events = dense(2_000)
    encoder = open_encoder("evpr:frame=256", SENSOR)
    frames = [frame + b"\0" for frame in encoder.encode(events).split(b"\0")[:-1]]
    again = [*frames[:10], *frames[4:10], *frames[9:]]
    arrived, health = received("evpr", b"".join(again))
    assert np.array_equal(arrived, from_first(events))
    assert (health.repeats, health.lost, health.device_resets, health.losses) == (7, 0, 0, 0)


def test_an_evpr_device_that_forgets_to_change_its_boot_number_is_followed():
    first, second = dense(3_000, 1), dense(3_000, 2)
    first.t += 5_000_000
    sent = encoded("evpr:frame=256", first)[:-300] + encoded("evpr:frame=256", second)
    arrived, health = received("evpr", sent)
    assert np.array_equal(pixels(arrived[-3_000:]), pixels(second))
    assert health.device_resets == 1
    assert health.lost < 3_000


@pytest.mark.parametrize("host", list(PROTOCOLS))
@pytest.mark.parametrize(
    "hostile",
    [
        pytest.param(b"\x01", id="a frame that does not end"),
        pytest.param(b"\xff", id="all ones"),
        pytest.param(b"\xaa\xd5", id="beginnings of packets"),
        pytest.param(b"\0", id="zeros"),
    ],
)
def test_hostile_bytes_take_bounded_memory_and_time_in_proportion(host, hostile):
    size = 1 << (12 if PLAIN else 17)
    hostile *= size // len(hostile)
    decoder = open_decoder(host, SENSOR)
    open_decoder(host, SENSOR).feed(hostile[:4_096])  # compiles
    tracemalloc.start()
    took = []
    for i in range(0, size, 4_096):
        begun = time.process_time()
        decoder.feed(hostile[i : i + 4_096])
        took.append(time.process_time() - begun)
        assert balanced(decoder.health)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4_000_000
    assert decoder.health.pending_bytes < MOST_PENDING
    # the last quarter takes no longer than the first, but for noise and a fixed cost; a test of
    # compiled code
    quarter = max(1, len(took) // 4)
    assert PLAIN or sum(took[-quarter:]) < 4 * sum(took[:quarter]) + 0.5


@every_protocol
def test_bytes_that_the_host_lost_are_told_and_the_stream_goes_on(device, host, checked):
    events = dense(20_000)
    sent = encoded(device, events, 50)
    a, b = len(sent) // 3, len(sent) // 2
    decoder = open_decoder(host, SENSOR)
    parts = [decoder.feed(sent[:a]), decoder.gap(b - a), decoder.feed(sent[b:]), decoder.finish()]
    arrived = join_events(parts)
    health = decoder.health
    assert balanced(health)
    assert (health.overruns, health.overrun_bytes) == (1, b - a)
    assert health.losses > 0
    assert np.array_equal(pixels(arrived[-5_000:]), pixels(events[-5_000:]))
    if health.accounting == "exact":
        assert health.decoded + health.lost == events.size


@pytest.mark.parametrize(("device", "host", "bits"), WRAPPING)
def test_a_wrap_of_the_devices_clock_is_no_step_in_time(device, host, bits):
    events = dense(2_000)
    events.t += (1 << bits) - 10_000
    arrived, health = received(host, encoded(device, events))
    assert np.array_equal(arrived, from_first(events))
    assert health.wraps == 1


@pytest.mark.parametrize("protocol", ["evt2", "evt3"])
@pytest.mark.parametrize("ran_s", [1, 5, 9, 13, 16.6, 17, 20, 33, 34.5])
def test_a_restart_of_a_camera_is_no_wrap_of_its_clock(protocol, ran_s):
    """EVT 3.0's clock of 24 bits falls at a restart as at a wrap, but by less."""
    runs = []
    for seconds in (ran_s, 1):
        i = np.arange(int(seconds * 2_000))
        runs.append(make_events(i * 500, i % 128, i % 100, i % 2))
    sent = b"".join(encoded(protocol, run) for run in runs)
    arrived, health = received(protocol, sent, range(4_096, len(sent), 4_096))
    assert (health.clock_resets, health.rejected) == (1, 0)
    assert np.array_equal(arrived.x, join_events(runs).x)
    assert arrived["t"][-1] - int(ran_s * 1e6) < 1_100_000
    assert health.wraps == (0 if protocol == "evt2" else int(ran_s * 1e6) >> 24)


@pytest.mark.parametrize("silence_s", [3, 8, 10, 16, 20, 50])
@pytest.mark.parametrize("ran_s", [2, 13])
def test_a_silence_on_evt3_lasts_as_long_as_it_did(silence_s, ran_s):
    """Words of time during a silence say whether the clock wraps in it."""
    t = np.arange(ran_s * 1_000) * 1_000
    t = np.append(t, t + int((ran_s + silence_s) * 1e6))
    events = make_events(t, t // 1_000 % 128, t // 1_000 % 100, t % 2)
    sent = encoded("evt3", events)
    arrived, health = received("evt3", sent, range(999, len(sent), 999))
    assert np.array_equal(arrived, events)
    assert str(health) == "no faults"


@pytest.mark.parametrize(("protocol", "size"), [("evt2", 4), ("evt21", 8), ("evt3", 2)])
def test_padding_of_lucid_cameras_is_no_damage(protocol, size):
    events = dense(3_000)
    words = np.frombuffer(encoded(protocol, events), f"<u{size}")
    at = np.sort(np.random.default_rng(0).integers(0, words.size + 1, 900))
    at[:50], at[-300:-200] = 0, words.size // 2
    sent = np.insert(words, at, int("99" * size, 16)).astype(f"<u{size}").tobytes()
    arrived, health = received(protocol, sent, range(999, len(sent), 999))
    assert np.array_equal(arrived, from_first(events))
    assert str(health) == "no faults"


def test_evpr_counts_what_was_lost_to_the_event_and_what_the_device_dropped():
    events = dense(10_000)
    encoder = open_encoder("evpr:frame=256", SENSOR)
    frames = (encoder.start() + encoder.encode(events[:6_000])).split(b"\0")[:-1]
    encoder.dropped = 1_234
    frames += (encoder.encode(events[6_000:]) + encoder.idle(10**7)).split(b"\0")[:-1]
    rng = np.random.default_rng(0)
    kept = [f for i, f in enumerate(frames) if i in (0, len(frames) - 1) or rng.random() > 0.2]
    arrived, health = received("evpr", b"".join(frame + b"\0" for frame in kept))
    assert 0 < arrived.size < 10_000
    assert arrived.size + health.lost == 10_000
    assert health.device_dropped == 1_234
    assert health.accounting == "exact"
    assert health.sequence_gaps > 0
    assert "events lost on the way, 1,234 dropped by the device" in health.describe_losses()


@pytest.mark.parametrize("accounting", ["exact", "unknown"])
def test_the_losses_name_every_event_that_came_and_was_left_out(accounting):
    health = Health(accounting=accounting, late=3, leaps=1_050, off_sensor=2)
    said = health.describe_losses()
    assert said.endswith("; of those that came, left out: 3 late, 1,050 leaps, 2 off sensor")


@pytest.mark.parametrize(
    ("size", "smaller"),
    [((65, 128), False), ((64, 128), True), ((128, 33), True), ((346, 260), False)],
)
def test_evpr_frames_of_a_smaller_sensor_are_noticed(size, smaller):
    """As far as the bits of x and y say: 65 to 128 pixels have seven."""
    decoder = open_decoder("evpr", SENSOR)
    decoder.feed(open_encoder("evpr", Sensor(*size)).start())
    assert ("sensor is smaller than 128x128" in decoder.remark) == smaller
    assert ("use the map of this camera" in decoder.remark) == smaller


def plain_evpr(frame):
    """One frame without its zero, decoded by hand from the specification."""
    raw, rest = bytearray(), bytearray(frame)
    while rest:
        code = rest.pop(0)
        raw += rest[: code - 1]
        del rest[: code - 1]
        if code < 255 and rest:
            raw.append(0)
    (*body,) = raw[:-4]
    assert zlib.crc32(bytes(body)) == int.from_bytes(raw[-4:], "little")
    kind, widths, _boot, _sequence, _dropped, now = struct.unpack_from("<BBHIIQ", raw)
    size, x_bits, y_bits = kind & 15, widths & 15, widths >> 4
    events = []
    for i in range(20, len(raw) - 4, size):
        word = int.from_bytes(raw[i : i + size], "little")
        low, step = word & ((1 << (x_bits + y_bits + 1)) - 1), word >> (x_bits + y_bits + 1)
        if step == (1 << (8 * size - x_bits - y_bits - 1)) - 1:
            now += low
        else:
            now += step
            events.append((now, low & ((1 << x_bits) - 1), low >> x_bits & ((1 << y_bits) - 1),
                           bool(low >> (x_bits + y_bits))))  # fmt: skip
    return events


@pytest.mark.parametrize("device", ["evpr", "evpr:width=3", "evpr:frame=64"])
@given(steps=st.lists(st.sampled_from([0, 1, 500, 510, 511, 512, 131_071, 131_072, 2**23]),
                      min_size=1, max_size=60))  # fmt: skip
@settings(max_examples=20)
def test_evpr_frames_are_what_the_specification_says(device, steps):
    rng = np.random.default_rng(len(steps))
    events = random_events(rng, len(steps), SENSOR, 1_000)
    events.t = np.cumsum(steps)
    sent = open_encoder(device, SENSOR).encode(events)
    frames = sent.split(b"\0")
    assert frames.pop() == b""
    assert [event for frame in frames for event in plain_evpr(frame)] == events.tolist()


def evpr_frame(kind=0x14, widths=0x77, base=0, body=b"", sequence=0):
    frame = HEADER.pack(kind, widths, 0, sequence, 0, base) + body
    return stuff(frame + struct.pack("<I", zlib.crc32(frame))) + b"\0"


@pytest.mark.parametrize(
    "frame",
    [
        evpr_frame(kind=0x24),  # a later version
        evpr_frame(kind=0x15),  # events of five bytes
        evpr_frame(kind=0x13, widths=0xFF),  # no bit left for the time
        evpr_frame(body=b"abc"),  # no whole word
        evpr_frame(base=1 << 63),
        stuff(b"short") + b"\0",
        b"\x09ab\0",  # stuffing that points beyond the end
    ],
)
def test_evpr_frames_that_make_no_sense_are_counted_and_left_out(frame):
    events = dense(10)
    arrived, health = received("evpr", frame + encoded("evpr", events))
    assert np.array_equal(arrived, events)
    assert (health.crc_errors, health.skipped_bytes) == (1, len(frame))


def test_evpr_times_and_pixels_beyond_reason_are_counted_not_delivered():
    off = evpr_frame(widths=0x99, body=struct.pack("<I", 500 | 3 << 9))
    far = evpr_frame(base=1 << 40, body=struct.pack("<I", 5), sequence=1)
    arrived, health = received("evpr", evpr_frame() + off + far)
    assert (health.off_sensor, health.clock_resets) == (1, 1)
    assert arrived["t"].tolist() == [UNKNOWN_US]


def test_a_frame_of_the_greatest_length_arrives_and_a_longer_one_does_not():
    body = bytes(MAX_FRAME - 24)
    longest = evpr_frame(body=body)
    decoder = open_decoder("evpr", SENSOR)
    decoder.feed(longest)
    assert len(longest) <= MAX_STUFFED + 1
    assert decoder.health.events == len(body) // 4
    decoder.feed(evpr_frame(body=body * 2))
    assert (decoder.health.crc_errors, decoder.health.frames) == (1, 1)


@pytest.mark.parametrize("seed", range(4))
def test_odd_times_are_believed_only_when_the_events_after_agree(seed):
    events = dense(3_000, seed)
    raw = bytearray(encoded("edvs:format=E4", events))
    for i in (100, 700, 1_500):
        raw[6 * i + 2] ^= 0x40  # 2^30 microseconds
    arrived, health = received("edvs:format=E4", bytes(raw))
    assert np.array_equal(
        arrived, from_first(events[np.delete(np.arange(3_000), [100, 700, 1_500])])
    )
    assert health.leaps + health.skipped_bytes // 6 == 3


def test_a_long_silence_is_kept_and_loses_no_event():
    events = dense(2_000)
    events.t[1_000:] += 10_000_000
    arrived, _ = received("edvs", encoded("edvs:format=E3", events))
    assert np.array_equal(arrived, from_first(events))


def test_edvs_answers_between_events_cost_no_event():
    events = dense(3_000)
    encoder = open_encoder("edvs", SENSOR)
    sent = b"EDVS128_LPC2106, V2.3\r\n" + encoder.encode(events[:1_000])
    sent += encoder.respond(b"?V\n") + encoder.encode(events[1_000:])
    assert np.array_equal(received("edvs", sent)[0], from_first(events))


def test_an_edvs_obeys_the_set_up_of_its_decoder():
    decoder, encoder = open_decoder("edvs:format=E2", SENSOR), open_encoder("edvs", SENSOR)
    events = dense(3_000)
    sent = encoder.respond(decoder.setup())
    assert sent == b"E-\n!U0\n-!E2\n"
    sent += encoder.encode(events)
    assert np.array_equal(decoded(decoder, sent), from_first(events))


def test_events_without_a_time_have_that_of_their_arrival():
    decoder = open_decoder("edvs:format=E0", SENSOR)
    sent = encoded("edvs:format=E0", dense(300))
    first, second = decoder.feed(sent[:400], 5_000), decoder.feed(sent[400:], 7_500)
    assert set(first["t"]) == {0}
    assert set(second["t"]) == {2_500}


def test_a_layout_of_ones_own_is_read_and_a_wrong_one_says_why(tmp_path):
    path = tmp_path / "bridge.toml"
    path.write_text(
        'bytes = 6\nendian = "big"\nx = {shift = 0, bits = 7}\ny = {shift = 8, bits = 7}\n'
        "p = {shift = 7, on = 0}\nt = {shift = 16, bits = 24, tick_us = 10}\n"
        "sync = {mask = 0xff0000008000, value = 0}\n"
    )
    events = dense(1_000)
    events.t -= events["t"] % 10
    spec = f"aer:layout={path}"
    assert np.array_equal(received(spec, encoded(spec, events))[0], from_first(events))
    assert read_layout(path).size == 6
    text = path.read_text()
    for old, new, words in (
        ("bytes = 6", "bytes = 9", "expected a whole number 2 to 8"),
        ("shift = 8", "shift = 3", "y overlaps another field"),
        ('"big"', '"middle"', "expected little or big"),
        ("value = 0}", "value = 1}", "value bits outside its mask"),
        ("x =", "column =", "names column"),
        ("shift = 16, bits = 24", "shift = 30, bits = 24", "ends after the word"),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(UsageError, match=words):
            read_layout(path)


@pytest.mark.parametrize(
    ("spec", "sensor", "words"),
    [
        ("modbus", SENSOR, "choose one of evpr, edvs"),
        ("edvs:format", SENSOR, "edvs:format=E3"),
        ("edvs:format=E9", SENSOR, "expected one of E3, E0"),
        ("edvs:baud=3", SENSOR, "edvs has no option baud"),
        ("edvs:format=E4,dialect=old", SENSOR, "the old dialect has no E4"),
        ("edvs", Sensor(240, 180), "edvs has 128x128"),
        ("aer", Sensor(240, 180), "holds up to 128x128"),
        ("evt2", Sensor(4000, 10), "holds up to 2048x2048"),
    ],
)
def test_wrong_use_is_one_line_with_the_remedy(spec, sensor, words):
    with pytest.raises(UsageError) as raised:
        open_decoder(spec, sensor)
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


def test_events_that_do_not_fit_a_frame_are_refused_and_options_are_read():
    with pytest.raises(UsageError, match="does not fit 3 bytes"):
        open_encoder("evpr:width=3", Sensor(4096, 4096))
    assert parse_protocol("edvs:format=E3,sync=1") == ("edvs", {"format": "E3", "sync": "1"})
    wide = make_events([0, 5], [1279, 0], [719, 0])
    sent = open_encoder("evpr", Sensor(1280, 720)).encode(wide)
    assert np.array_equal(decoded(open_decoder("evpr", Sensor(1280, 720)), sent), wide)


@pytest.mark.parametrize(
    ("name", "protocol"),
    [("evt3_gen41_1280x720_driving.raw", "evt3"), ("evt2_gen3_640x480.raw", "evt2")],
)
def test_real_words_are_the_same_events_as_in_a_recording(shared_data, name, protocol):
    path = shared_data / "recordings" / name
    recording = open_recording(path)
    assert recording.sensor is not None
    with path.open("rb") as file:
        words = path.read_bytes()[read_header(file)[1] :][: 20_000 if PLAIN else None]
    decoder = open_decoder(protocol, recording.sensor)
    arrived = decoded(decoder, words, range(4_096, len(words), 4_096))
    expected = join_events(list(recording))[: arrived.size]
    assert arrived.size > 4_000
    assert np.array_equal(arrived, expected)
    assert str(decoder.health) == "no faults"


def test_a_real_cameras_words_are_read_beyond_a_real_wrap_by_their_layout(shared_data, tmp_path):
    """The camera's own bytes, whose clock of 31 bits wraps: address-events of 8 bytes."""
    folder = shared_data / "recordings" / "ros2_libcaer_rollover"
    words, events = b"".join(payloads(folder)), read_events(folder)
    n = 2_000 if PLAIN else events.size
    middle = int(np.flatnonzero(np.diff(np.frombuffer(words, "<u4")[1::2].astype(np.int64)) < 0)[0])
    part = slice(max(0, middle - n // 2), middle + n // 2)
    path = tmp_path / "libcaer.toml"
    path.write_text(
        'bytes = 8\nendian = "little"\nx = {shift = 17, bits = 15}\ny = {shift = 2, bits = 15}\n'
        "p = {shift = 1}\nt = {shift = 32, bits = 31}\n"
        "sync = {mask = 0x8000000000000001, value = 1}\n"
    )
    decoder = open_decoder(f"aer:layout={path}", Sensor(640, 480))
    sent = words[8 * part.start : 8 * part.stop]
    arrived = decoded(decoder, sent, range(600, len(sent), 600))
    assert np.array_equal(arrived, from_first(events[part]))
    assert (decoder.health.wraps, decoder.health.clock_resets) == (1, 0)


def test_an_evpr_frame_without_an_end_is_given_up_at_the_greatest_length():
    decoder = open_decoder("evpr", SENSOR)
    events = dense(100)
    for _ in range(100):
        decoder.feed(b"\x42" * 1_000)
        assert decoder.health.pending_bytes <= MAX_STUFFED
    assert (decoder.health.crc_errors, decoder.health.skipped_bytes) == (1, 100_000)
    arrived = decoder.feed(b"\0" + encoded("evpr", events))
    assert np.array_equal(arrived, events)


@every_protocol
def test_pixels_beyond_the_sensor_are_counted_and_none_is_delivered(device, host, checked):
    """As from a camera that is larger than the host was told."""
    events = dense(3_000)
    events.x[100::7] = 127
    small = Sensor(100, 110)
    inside = events[(events["x"] < small.width) & (events["y"] < small.height)]
    decoder = open_decoder(host, small)
    arrived = decoded(decoder, encoded(device, events))
    assert arrived["x"].max() < small.width
    assert arrived["y"].max() < small.height
    health = decoder.health
    if device.startswith("evt"):
        # off the sensor is how these show a lost place
        assert health.skipped_bytes + health.undated > 0
    else:
        assert np.array_equal(pixels(arrived), pixels(inside))
        assert health.off_sensor == events.size - inside.size


WITHOUT_CHECKSUM = (
    "edvs:format=E1,dialect=old", "edvs:format=E2,dialect=old", "edvs:format=E3,dialect=old",
    "edvs:format=E1", "aer:layout=aer4", "aer:layout=jaer8", "evt2", "evt3",
)  # fmt: skip


@pytest.mark.parametrize("rate", [1e-4, 1e-3])
@pytest.mark.parametrize("kind", ["flip", "drop", "insert"])
@pytest.mark.parametrize("protocol", WITHOUT_CHECKSUM)
def test_a_damaged_line_does_not_make_the_clock_run_ahead_of_the_hosts(protocol, kind, rate):
    """Each damaged time counted as a wrap: 16-bit times ran up to six times too fast."""
    rng, number, span_us = np.random.default_rng(7), 20_000 if PLAIN else 200_000, 4_000_000
    sent = open_encoder(protocol, SENSOR).encode(random_events(rng, number, SENSOR, span_us))
    data, _ = corrupt(rng, sent, kind, rate)
    decoder = open_decoder(protocol, SENSOR)
    decoder.live = True
    end_us, count = 0, 0
    for at in range(0, len(data), 2_000):
        host_us = span_us * min(at + 2_000, len(data)) // len(data)
        events = decoder.feed(data[at : at + 2_000], host_us)
        count += events.size
        if events.size:
            end_us = int(events["t"][-1])
            assert end_us < host_us + 650_000
    assert end_us > 0.9 * span_us
    assert count > 0.95 * number


@pytest.mark.parametrize("protocol", ["edvs:format=E1,dialect=old", "edvs:format=E3,dialect=old"])
def test_pauses_of_a_live_camera_are_kept_and_its_last_event_is_given(protocol):
    """A pause within half the period of the clock is known, and the host agrees with it."""
    sensor = Sensor(16, 16)
    events = random_events(np.random.default_rng(3), 400, sensor, 4_000_000)
    decoder, encoder = open_decoder(protocol, sensor), open_encoder(protocol, sensor)
    decoder.live, parts, last_us = True, [], int(events["t"][0])
    keep = np.diff(events["t"], prepend=events["t"][0]) < 30_000
    events = events[keep][:100]
    events.t -= events["t"][0]
    for event in split_events(events, len(events)):
        last_us = int(event["t"][0])
        parts.append(decoder.feed(encoder.encode(event), 1_000 + last_us))
    parts.append(decoder.finish())
    got = join_events(parts)
    assert (got["t"].size, decoder.health.leaps) == (100, 0)
    assert np.array_equal(np.diff(got["t"]), np.diff(events["t"]))
