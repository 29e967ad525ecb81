"""OpenMV's protocol: the host asks, the camera answers, and nothing is lost unsaid."""

from __future__ import annotations

import enum
import struct
import threading
import time
import tracemalloc

import numpy as np
import pytest
from edge_vpr_tools.commands.ports import KNOWN, guess
from hypothesis import given, settings
from hypothesis import strategies as st
from openmv_camera import Camera, CameraEncoder, open_encoder
from streams import Drive, balanced, from_first, random_events

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor, make_events
from edge_vpr.live.bridge import Bridge, LineFaults, open_device_link
from edge_vpr.live.links import open_link
from edge_vpr.live.protocols import open_decoder
from edge_vpr.live.protocols.openmv import PATIENCE_S, PERIOD_US, record_encoder
from edge_vpr.live.protocols.openmv_packets import (
    HEADER,
    MAX_PACKET,
    Flag,
    Opcode,
    Packet,
    crc,
    pack,
)
from edge_vpr.live.reader import LinkReader

SENSOR = Sensor(320, 320)
CHANNELS = [
    "openmv",
    "openmv:channel=raw_events",
    "openmv:channel=raw_events,format=evt2",
    "openmv:channel=raw_events,format=evt3",
]
every_channel = pytest.mark.parametrize("spec", CHANNELS)


def with_option(spec, option):
    return f"{spec}{',' if ':' in spec else ':'}{option}"


def marked(n, every_us=7):
    """Events that tell which one they are: by time, and by pixel and polarity."""
    i = np.arange(n)
    return make_events(i * every_us + 3, i % 320, i // 320 % 320, i % 2)


def assert_none_is_corrupt(events, every_us=7):
    """Each event is one of `marked`, at its time, and none came twice."""
    if events.size:
        first = int(events["x"][0]) + 320 * int(events["y"][0])
        i = events["t"] // every_us + first
        expected = make_events(events["t"], i % 320, i // 320 % 320, i % 2)
        assert np.array_equal(events, expected)
        assert (events["t"] % every_us == 0).all()
        assert (np.diff(events["t"]) > 0).all()


def assert_accounted(sent, arrived, health):
    """What was made lies between what is known to have come or gone, and the most of it."""
    assert balanced(health)
    assert arrived + health.lost <= sent <= arrived + health.rejected + health.lost_at_most


def converse(decoder, camera, events, *, up=None, down=None, cut=None, chunk=3_000):
    """Let the two speak until all has been fetched, on a clock of our own.

    `up` and `down` say what arrives of what the camera and the host sent.
    """
    arrived, now, given_events, quiet, started = [], 0.0, 0, 0, False
    to_camera = decoder.setup()
    while quiet < 40:
        answer = b""
        if to_camera:
            answer = camera.respond(down(to_camera) if down else to_camera)
            if not started:
                started, answer = True, answer + camera.start()
        answer += camera.to_send(now)
        if started and camera.held <= camera.capacity and given_events < events.size:
            camera.encode(events[given_events : given_events + chunk])
            given_events += chunk
        answer = up(answer) if up and answer else answer
        cuts = cut(answer) if cut else []
        for start, stop in zip([0, *cuts], [*cuts, len(answer)], strict=True):
            if stop > start:
                arrived.append(decoder.feed(answer[start:stop]))
                assert balanced(decoder.health)
        to_camera = decoder.to_send(now)
        now += 1e-4 if to_camera else decoder.tick_s
        done = given_events >= events.size and camera.held == 0
        quiet = quiet + 1 if done else 0
        assert now < 3_000, f"hangs: {decoder.health}"
    arrived.append(decoder.finish())
    return np.concatenate(arrived)


def test_the_checksums_are_those_that_were_published():
    assert (crc(b"123456789", 16), crc(b"123456789", 32)) == (0xE541, 0x41B403D3)


@given(data=st.binary(max_size=60))
def test_checksums_taken_eight_bytes_at_a_time_are_those_taken_bit_by_bit(data):
    for bits, polynomial in ((16, 0xF94F), (32, 0xFA567D89)):
        value = (1 << bits) - 1
        for byte in data:
            value ^= byte << (bits - 8)
            for _ in range(8):
                value = (value << 1) ^ (polynomial if value >> (bits - 1) else 0)
                value &= (1 << bits) - 1
        assert crc(data, bits) == value


@every_channel
@given(data=st.data())
@settings(max_examples=12)
def test_what_is_asked_for_arrives_to_the_bit_however_the_bytes_are_cut(spec, data):
    n, seed = data.draw(st.integers(1, 3_000)), data.draw(st.integers(0, 99))
    rng = np.random.default_rng(seed)
    events = random_events(rng, n, SENSOR, n)
    events["t"] = np.cumsum(rng.integers(0, data.draw(st.sampled_from([2, 50, 5_000])), n))
    encode = record_encoder(_format_of(spec), SENSOR)
    channel = "raw_events" if "raw" in spec else "events"
    camera = CameraEncoder(
        SENSOR, channel, encode, buffer_events=data.draw(st.sampled_from([64, 1_000])),
        fragment=data.draw(st.sampled_from([52, 512, 4_082])),
    )  # fmt: skip
    decoder = open_decoder(with_option(spec, data.draw(st.sampled_from(["ack=off", "ack=on"]))),
                           SENSOR)  # fmt: skip

    def cut(answer):
        return np.sort(rng.integers(0, len(answer) + 1, rng.integers(0, 4))).tolist()

    arrived = converse(decoder, camera, events, cut=cut, chunk=data.draw(st.integers(1, 1_000)))
    assert np.array_equal(arrived, from_first(events))
    health = decoder.health
    assert (health.skipped_bytes, health.lost_at_most, health.retries, health.losses) == (0,) * 4


def _format_of(spec):
    return spec.partition("format=")[2] or ("evt21" if "raw" in spec else "events")


def test_events_of_three_bytes_have_the_time_of_their_arrival():
    spec = "openmv:channel=raw_events,format=aer"
    decoder, events = open_decoder(spec, SENSOR), marked(1_000)
    arrived = converse(decoder, open_encoder(spec, SENSOR), events)
    assert np.array_equal(arrived[["x", "y", "p"]], events[["x", "y", "p"]])
    assert set(arrived["t"]) == {0}


@pytest.mark.parametrize("acknowledge", [False, True])
@pytest.mark.parametrize("check", [False, True])
def test_the_makers_own_host_reads_our_camera_to_the_bit(acknowledge, check, monkeypatch):
    openmv = pytest.importorskip("openmv", reason="the maker's host is the package openmv")
    # openmv 1.0.7 looks numbers up in enumerations, as Python can from 3.12 on
    monkeypatch.setattr(
        enum.EnumMeta, "__contains__",
        lambda kind, value: isinstance(value, kind) or value in kind._value2member_map_,
    )  # fmt: skip
    events = random_events(np.random.default_rng(0), 12_000, SENSOR, 3_000_000)
    link = open_device_link("virtual")
    bridge = Bridge(link, open_encoder("openmv", SENSOR), speed=0)
    thread = threading.Thread(target=bridge.run, args=(Drive(events, SENSOR, 3_000),), daemon=True)
    thread.start()
    data, end = b"", time.monotonic() + 20
    with openmv.Camera(link.address, ack=acknowledge, crc=check) as camera:
        assert camera.version()["protocol_version"] == (1, 0, 0)
        while len(data) < 12 * events.size and time.monotonic() < end:
            if camera.read_status().get("events"):
                data += camera.channel_read("events", camera.channel_size("events"))
        camera.read_status()
        assert camera.host_stats()["checksum"] == 0
    thread.join(timeout=5)
    link.close()
    assert not thread.is_alive()
    kind, s, ms, us, x, y = np.frombuffer(data, dtype="<u2").reshape(-1, 6).T.astype(np.int64)
    assert np.array_equal(make_events(s * 1_000_000 + ms * 1_000 + us, x, y, kind), events)
    assert bridge.sent_events == events.size


def test_the_channel_is_found_by_its_name_whatever_its_number():
    camera = open_encoder("openmv", SENSOR)
    camera._camera._names[4] = ("profile", 1)
    camera._camera._names[5] = ("ticks", 32)
    events = marked(500)
    assert np.array_equal(converse(open_decoder("openmv", SENSOR), camera, events),
                          from_first(events))  # fmt: skip
    assert camera._camera._number == 6


def test_a_camera_whose_script_starts_later_is_waited_for_and_the_user_is_told():
    decoder, camera = open_decoder("openmv", SENSOR), open_encoder("openmv", SENSOR)
    answer, now = camera.respond(decoder.setup()), 0.0
    for _ in range(100):
        decoder.feed(answer)
        answer = camera.respond(decoder.to_send(now))
        now += decoder.tick_s
    assert "no channel events (it has usb, stdin, stdout, stream)" in decoder.remark
    camera.encode(marked(100))
    decoder.feed(camera.start())
    arrived = []
    for _ in range(20):
        arrived.append(decoder.feed(answer))
        answer = camera.respond(decoder.to_send(now))
        now += decoder.tick_s
    assert np.array_equal(np.concatenate(arrived), from_first(marked(100)))
    assert decoder.remark == ""
    assert decoder.health.retries == 0


def without_the(k):
    """Loses the k-th message that passes."""
    passed = iter(range(1_000_000))
    return lambda data: b"" if next(passed) == k else data


@every_channel
@pytest.mark.parametrize("direction", ["up", "down"])
def test_no_single_message_lost_hangs_the_stream_or_goes_unsaid(spec, direction):
    retries = 0
    for k in range(14):
        decoder, camera = open_decoder(spec, SENSOR), open_encoder(spec, SENSOR)
        arrived = converse(
            decoder, camera, marked(4_000), chunk=1_000, **{direction: without_the(k)}
        )
        assert_none_is_corrupt(arrived)
        assert_accounted(4_000, arrived.size, decoder.health)
        # a command that is lost takes nothing with it, but that words after it may lean on words
        # before it, so that those without a time or a row of their own are not believed
        came = arrived.size + decoder.health.undated
        assert came >= (4_000 if direction == "down" else 2_900)
        assert spec != "openmv" or decoder.health.undated == 0
        retries += decoder.health.retries
    assert retries > 5


@every_channel
@pytest.mark.parametrize("direction", ["up", "down"])
def test_with_acknowledgements_no_single_message_lost_loses_an_event(spec, direction):
    for k in range(0, 60, 3):
        decoder = open_decoder(with_option(spec, "ack=on"), SENSOR)
        arrived = converse(decoder, open_encoder(spec, SENSOR), marked(2_000), chunk=1_000,
                           **{direction: without_the(k)})  # fmt: skip
        assert_none_is_corrupt(arrived)
        assert arrived.size + decoder.health.undated == 2_000
        assert decoder.health.undated == 0 or (direction, spec) == ("down", CHANNELS[3])
        assert decoder.health.lost == 0


def test_one_fragment_lost_loses_its_own_records_and_says_how_many():
    decoder, camera = open_decoder("openmv", SENSOR), open_encoder("openmv", SENSOR)

    def third_fragment(answer):
        at = 2 * 526
        return answer[:at] + answer[at + 526 :] if len(answer) > 5_000 else answer

    arrived = converse(decoder, camera, marked(1_000), up=third_fragment)
    health = decoder.health
    # bytes 1,024 to 1,535 touch records 85 to 127
    assert (health.lost, health.lost_at_most) == (43, 43)
    assert arrived.size == 1_000 - 43
    assert (health.sequence_gaps, health.retries) == (1, 0)
    assert_none_is_corrupt(arrived)


@every_channel
@pytest.mark.parametrize("acknowledge", ["ack=off", "ack=on"])
@pytest.mark.parametrize(
    "faults", ["flip=1e-4", "drop=1e-4", "insert=1e-4", "flip=1e-3,drop=1e-3,insert=1e-3"]
)
def test_a_line_that_is_bad_both_ways_delivers_nothing_false_and_never_hangs(
    spec, acknowledge, faults
):
    line, n = LineFaults.parse(faults), 3_000 if "1e-3" in faults else 20_000
    for seed in range(3):
        rng = np.random.default_rng(seed)
        decoder = open_decoder(with_option(spec, acknowledge), SENSOR)
        arrived = converse(
            decoder, open_encoder(spec, SENSOR), marked(n), chunk=500,
            up=lambda data, rng=rng: line.corrupt(data, rng),
            down=lambda data, rng=rng: line.corrupt(data, rng),
        )  # fmt: skip
        assert_none_is_corrupt(arrived)
        assert_accounted(n, arrived.size, decoder.health)
        if n == 20_000:
            assert arrived.size > n // 2
            assert decoder.health.crc_errors > 0
        if decoder.health.accounting == "bound" and spec == "openmv":
            assert "events lost on the way" in decoder.health.describe_losses()


def test_a_camera_that_restarts_is_asked_anew():
    decoder, camera = open_decoder("openmv", SENSOR), open_encoder("openmv", SENSOR)
    first = converse(decoder, camera, marked(1_000))
    restarted = open_encoder("openmv", SENSOR)
    restarted.start()
    restarted.encode(marked(1_000))
    arrived, answer, now = [first], b"", 1.0
    for _ in range(300):
        answer = restarted.respond(decoder.to_send(now))
        arrived.append(decoder.feed(answer) if answer else first[:0])
        now += decoder.tick_s
    events = np.concatenate(arrived)
    assert events.size == 2_000
    assert np.array_equal(events[1_000:][["x", "y", "p"]], marked(1_000)[["x", "y", "p"]])
    assert (np.diff(events["t"]) >= 0).all()
    assert decoder.health.clock_resets == 1
    assert balanced(decoder.health)


def test_a_cable_pulled_and_put_back_starts_a_new_conversation():
    decoder, camera = open_decoder("openmv", SENSOR), open_encoder("openmv", SENSOR)
    camera.start()
    camera.encode(marked(600))
    setup = decoder.setup()
    answer = camera.respond(setup)
    for step in range(8):
        answer_before, answer = answer, b""
        if len(answer_before) > 5_000:
            break
        decoder.feed(answer_before)
        answer = camera.respond(decoder.to_send(step * 0.01))
    # the cable goes in the middle of what was asked for
    got = [decoder.feed(answer_before[:3_000])]
    camera.encode(marked(1_000)[600:])
    answer = camera.respond(setup)  # sent when the link opens
    got.append(decoder.gap())
    for step in range(12):
        got.append(decoder.feed(answer))
        answer = camera.respond(decoder.to_send(1 + step * 0.01))
    arrived = np.concatenate(got)
    assert_none_is_corrupt(arrived)
    assert decoder.health.lost == 600 - (arrived.size - 400)
    assert_accounted(1_000, arrived.size, decoder.health)
    assert decoder.health.retries == 0


def test_recorded_bytes_replay_without_a_camera():
    recorded, decoder = [], open_decoder("openmv", SENSOR)

    def keep(answer):
        recorded.append(answer)
        return answer

    arrived = converse(decoder, open_encoder("openmv", SENSOR), marked(9_000), up=keep)
    again = open_decoder("openmv", SENSOR)
    replayed = np.concatenate([again.feed(b"".join(recorded)), again.finish()])
    assert np.array_equal(replayed, arrived)


def test_seconds_that_wrap_after_18_hours_are_no_step_in_time():
    events = marked(2_000, 50)
    events["t"] += PERIOD_US - 40_000
    decoder = open_decoder("openmv", SENSOR)
    arrived = converse(decoder, open_encoder("openmv", SENSOR), events)
    assert np.array_equal(arrived, from_first(events))
    assert decoder.health.wraps == 1


def fetched(payload):
    """A decoder that was given this as what its channel holds."""
    decoder, camera = open_decoder("openmv", SENSOR), Camera()
    camera.register("events")
    camera.buffers.append(payload)
    answer, arrived = camera.receive(decoder.setup()), []
    for step in range(12):
        arrived.append(decoder.feed(answer))
        answer = camera.receive(decoder.to_send(step * 0.01))
    return decoder, np.concatenate(arrived)


def test_triggers_are_no_events_and_records_that_cannot_be_are_counted():
    rows = [
        (1, 5, 0, 0, 10, 20),
        (3, 5, 0, 1, 0, 0),  # a trigger
        (0, 5, 0, 2, 11, 21),
        (9, 5, 0, 3, 1, 1),  # no type
        (0, 5, 1_000, 3, 1, 1),  # no time
        (0, 5, 0, 1_000, 1, 1),
        (1, 5, 0, 4, 400, 1),  # no pixel
        (1, 5, 0, 9, 12, 22),
    ]
    decoder, arrived = fetched(np.array(rows, dtype="<u2").tobytes())
    assert arrived.tolist() == [(0, 10, 20, True), (2, 11, 21, False), (9, 12, 22, True)]
    assert (decoder.health.undated, decoder.health.off_sensor) == (3, 1)
    assert balanced(decoder.health)


def test_a_false_beginning_of_a_packet_holds_the_stream_up_no_longer_than_a_retry():
    decoder, camera = open_decoder("openmv", SENSOR), open_encoder("openmv", SENSOR)
    camera.start()
    camera.encode(marked(100))
    # a header without an end, in place of the answer to the first command
    camera.respond(decoder.setup())
    decoder.feed(pack(Opcode.READ, 0, 4, 0, bytes(60_000))[:30])
    arrived, now, answer = [], 0.0, b""
    while now < 2 * PATIENCE_S:
        answer = camera.respond(decoder.to_send(now))
        if answer:
            arrived.append(decoder.feed(answer))
        now += decoder.tick_s
    assert np.array_equal(np.concatenate(arrived), from_first(marked(100)))
    assert decoder.health.retries == 1
    assert decoder.health.skipped_bytes == 30


@pytest.mark.parametrize(
    "noise",
    [
        b"Traceback (most recent call last):\n" * 100,
        pack(Opcode.SYS_EVENT, 0, 0, Flag.EVENT, b"\0\0") * 100,
        pack(Opcode.SYNC, 0, 0, Flag.ACK) * 100,
        pack(Opcode.READ, 0, 4, Flag.FRAGMENT | Flag.ACK_REQ, bytes(4_000)),
        pack(Opcode.POLL, 0, 0, Flag.NAK, b"\x06\0") * 50,
        b"\xaa\xd5" * 2_000,
    ],
    ids=["prompt", "events", "synchronised", "fragments", "refusals", "marks"],
)
def test_a_camera_that_says_anything_is_asked_again_and_again_in_bounded_memory(noise):
    decoder, asked = open_decoder("openmv", SENSOR), b""
    decoder.to_send(0.0)
    for step in range(200):
        if step == 50:
            tracemalloc.start()
        assert decoder.feed(noise).size == 0
        asked += decoder.to_send(step * 0.2)[-HEADER.size :]
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 50_000 < 150 * len(noise)  # of all that came meanwhile, little is kept
    assert balanced(decoder.health)
    assert decoder.health.pending_bytes <= MAX_PACKET
    assert asked.count(pack(Opcode.SYNC, 0)) + asked.count(pack(Opcode.GET_CAPS, 0)) >= 8


def test_bytes_come_and_go_over_a_real_terminal_while_the_camera_plays_in_real_time():
    events = marked(20_000, 20)
    link = open_device_link("virtual")
    bridge = Bridge(link, open_encoder("openmv:channel=raw_events,format=evt3", SENSOR))
    thread = threading.Thread(target=bridge.run, args=(Drive(events, SENSOR),), daemon=True)
    thread.start()
    decoder = open_decoder("openmv:channel=raw_events,format=evt3", SENSOR)
    decoder.warm_up()
    reader = LinkReader(lambda: open_link(link.address, baud=decoder.baud), setup=decoder.setup())
    arrived, end = [], time.monotonic() + 10
    while sum(part.size for part in arrived) < events.size and time.monotonic() < end:
        piece = reader.take(decoder.tick_s)
        if piece is not None:
            arrived.append(decoder.feed(piece.data))
        reader.send(decoder.to_send(time.monotonic()))
    thread.join(timeout=1)
    while thread.is_alive() and time.monotonic() < end:
        piece = reader.take(decoder.tick_s)
        if piece is not None:
            decoder.feed(piece.data)
        reader.send(decoder.to_send(time.monotonic()))
    reader.stop()
    link.close()
    assert not thread.is_alive()
    assert np.array_equal(np.concatenate(arrived), from_first(events))
    assert (bridge.sent_events, bridge.dropped_events) == (20_000, 0)


def test_a_camera_that_nobody_asks_drops_what_it_has_no_room_for_and_says_so():
    link = open_device_link("virtual")
    camera = open_encoder("openmv", SENSOR)
    camera.capacity = 1_000
    bridge = Bridge(link, camera, speed=50.0)
    thread = threading.Thread(
        target=bridge.run, args=(Drive(marked(50_000, 100), SENSOR),), daemon=True
    )
    thread.start()
    host = open_link(link.address)
    host.write(open_decoder("openmv", SENSOR).setup(), 1)
    end = time.monotonic() + 10
    while bridge.dropped_events + camera.held < 50_000 and time.monotonic() < end:
        time.sleep(0.02)
    bridge.stopping.set()
    thread.join(timeout=5)
    host.close()
    link.close()
    assert bridge.dropped_events > 40_000
    assert bridge.sent_events == 0
    assert bridge.dropped_events + camera.held == 50_000


def test_the_camera_refuses_what_the_firmware_refuses():
    camera = Camera()
    camera.register("events")

    def answer(opcode, sequence, channel=0, payload=b"", flags=0):
        data = camera.receive(pack(opcode, sequence, channel, flags, payload))
        _, number, _, flags, code, length, _ = HEADER.unpack_from(data)
        assert code == opcode
        return Packet(number, channel, flags, code, data[10 : 10 + length])

    assert answer(Opcode.SYNC, 77)[:3] == (0, 0, Flag.ACK)
    caps = struct.pack("<IH10x", 11, 4_082)
    assert answer(Opcode.SET_CAPS, 0, payload=caps[:-1]).payload == b"\x02\0"
    assert answer(Opcode.SET_CAPS, 1, payload=caps).flags == Flag.ACK
    assert answer(Opcode.POLL, 9).payload == b"\x06\0"
    assert answer(Opcode.LOCK, 3, 4).payload == b"\x04\0"
    assert answer(Opcode.SIZE, 4, 7).payload == b"\x02\0"
    assert answer(Opcode.SIZE, 5, 4).payload == bytes(4)
    assert answer(Opcode.GET_CAPS, 6, 4).payload == b"\x02\0"
    damaged = bytearray(pack(Opcode.READ, 7, 4, 0, bytes(8)))
    damaged[12] ^= 1
    assert camera.receive(bytes(damaged))[10:12] == b"\x05\0"
    # with nothing to give, the maker's scripts give zeros
    assert answer(Opcode.READ, 8, 4, struct.pack("<II", 0, 24)).payload == bytes(24)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("openmv:channel=300", "expected 0 to 255, or a name"),
        ("openmv:format=evt9", "expected one of auto, events"),
        ("openmv:ack=maybe", "expected one of off, on"),
        ("openmv:raw=1", "openmv has no option raw: it has channel, format, ack"),
    ],
)
def test_wrong_use_is_one_line_with_the_remedy(spec, words):
    with pytest.raises(UsageError) as raised:
        open_decoder(spec, SENSOR)
    assert words in str(raised.value)


def test_a_port_is_guessed_by_its_exact_number_before_its_vendors():
    assert guess(0x37C5, 0x1206).what.startswith("OpenMV N6")
    assert guess(0x37C5, 0x9999).protocol == "openmv"
    assert guess(0x0403, 0x6014).baud == 12_000_000
    assert guess(0x0403, 0x9999) is None
    assert guess(None, None) is None
    assert all(row.source for row in KNOWN)
    assert len({row[:2] for row in KNOWN}) == len(KNOWN)
