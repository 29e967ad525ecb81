"""ROS bags: event arrays and event packets, by topic, against plain decoders."""

from __future__ import annotations

import struct
import tempfile
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import Sensor, join_events
from edge_vpr.recordings import open_recording
from edge_vpr.recordings.rosbag import Cursor, LibcaerCmpDecoder, read_event_array, read_preamble
from tests.recordings import recording_files as files
from tests.streams import absolute

rosbags = pytest.importorskip("rosbags")

SENSOR = Sensor(346, 260)
START = 1_587_452_582_350_123
EVENTS = [(START + 7 * i, 3 * i % 346, 5 * i % 260, i % 3 == 0) for i in range(500)]


def arrays(events, ros, size=100):
    return [
        files.event_array(events[i : i + size], *SENSOR, ros) for i in range(0, len(events), size)
    ]


def on_e(ros):
    """All events, on the topic /e."""
    return [("/e", data) for data in arrays(EVENTS, ros)]


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("chunk", [7, 1 << 16])
def test_event_arrays_of_both_ros_are_read_with_their_wall_clock(ros, chunk, tmp_path):
    path = tmp_path / ("a.bag" if ros == 1 else "a")
    messages = [("/dvs/events", data) for data in [*arrays(EVENTS, ros), *arrays([], ros)]]
    messages.insert(0, ("/dvs/events", files.event_array([], *SENSOR, ros)))
    messages.insert(2, ("/dvs/imu", b"something else"))
    files.write_bag(path, ros, messages, {"/dvs/imu": "sensor_msgs/msg/Imu"})
    events, recording = absolute(path, chunk_events=chunk)
    assert events.tolist() == EVENTS
    assert (recording.sensor, recording.start_us) == (SENSOR, START)
    assert recording.format == f"rosbag{ros}"
    assert recording.position == 1.0


@pytest.mark.parametrize("ros", [1, 2])
@given(
    events=st.lists(
        st.tuples(
            st.integers(0, 2**32 * 10**6 - 1),
            st.integers(0, 65535),
            st.integers(0, 65535),
            st.booleans(),
        ),
        max_size=9,
    )
)
def test_any_event_array_is_read_to_the_bit(ros, events):
    cursor = Cursor(files.event_array(events, *SENSOR, ros), ros)
    assert read_preamble(cursor)[1:] == (SENSOR.height, SENSOR.width)
    columns = read_event_array(cursor)
    assert list(zip(*(column.tolist() for column in columns), strict=True)) == events


def test_packets_of_evt3_go_on_from_one_to_the_next(tmp_path):
    events = [((1 << 24) - 2000 + 9 * i, 3 * i % 346, 5 * i % 260, i % 3 == 0) for i in range(500)]
    words = files.encode_evt3(events)
    cut = [0, 2, 900, 902, len(words)]
    packets = [
        ("/events", files.event_packet("evt3", words[a:b], *SENSOR)) for a, b in pairwise(cut)
    ]
    kind = {"/events": "event_camera_msgs/msg/EventPacket"}
    files.write_bag(tmp_path / "a", 2, packets, kind)
    recording = open_recording(tmp_path / "a")
    again = join_events(list(recording))
    again.t += events[0][0]
    assert again.tolist() == events
    # the camera's clock is its own; the packet's time stamp is the wall clock's
    assert recording.start_us == 1_600_000_000_123_456


def test_packets_of_unknown_encoding_say_so(tmp_path):
    kind = {"/events": "event_camera_msgs/msg/EventPacket"}
    data = files.event_packet("trigger", bytes(16), *SENSOR)
    files.write_bag(tmp_path / "a", 2, [("/events", data)], kind)
    with pytest.raises(RecordingError, match="encoding 'trigger' are not decoded: known are evt3"):
        open_recording(tmp_path / "a")


@pytest.mark.parametrize("chunk", [7, 1 << 16])
@pytest.mark.parametrize("encoding", ["libcaer_cmp", "mono"])
def test_packets_that_count_from_their_time_base_are_read(encoding, chunk, tmp_path):
    """A packet each 10 ms with the same words: their times go on by the time bases alone."""
    events = [(9 * i, 3 * i % 346, 5 * i % 260, i % 3 == 0) for i in range(900)]
    encode = {"libcaer_cmp": files.encode_libcaer_cmp, "mono": files.encode_mono}[encoding]
    packets = [
        files.event_packet(encoding, encode(events), *SENSOR, base_ns=base * 10**7 + 999)
        for base in range(3)
    ]
    kind = {"/events": "event_camera_msgs/msg/EventPacket"}
    files.write_bag(tmp_path / "a", 2, [("/events", data) for data in packets], kind)
    recording = open_recording(tmp_path / "a", chunk_events=chunk)
    again = join_events(list(recording)).tolist()
    assert again == [(t + 10_000 * base, x, y, p) for base in range(3) for t, x, y, p in events]


def test_libcaer_cmp_vectors_give_an_event_for_each_bit_from_the_row_on():
    """The words as event_camera_codecs decodes them: the next vector starts 8 rows further."""
    words = [1 << 12 | 5, 2 << 12 | 77, 4 << 12 | 1 << 11 | 20, 5 << 12 | 0x81, 5 << 12 | 0x01]
    decoder = LibcaerCmpDecoder()
    columns = decoder.decode(np.array(words, np.uint16), 1000)
    assert [c.tolist() for c in columns] == [[1005] * 3, [77] * 3, [20, 27, 28], [True] * 3]
    # column and polarity go on in the next packet, times do not
    columns = decoder.decode(np.array([5 << 12 | 2, 0 << 12 | 1, 3 << 12 | 9], np.uint16), 0)
    assert [c.tolist() for c in columns] == [[0, 4096], [77, 77], [37, 9], [True, False]]
    with pytest.raises(RecordingError, match="word 1 of a libcaer_cmp packet is of the unknown"):
        decoder.decode(np.array([0, 9 << 12], np.uint16), 0)


def test_a_message_that_is_cut_off_says_which(tmp_path):
    first, second, *_ = arrays(EVENTS, 1)
    files.write_bag(tmp_path / "a.bag", 1, [("/e", first), ("/e", second[:-20])])
    with pytest.raises(RecordingError, match=r"message 2 on /e is cut off \(100 events"):
        absolute(tmp_path / "a.bag")


def test_the_topic_is_asked_for_where_there_are_several(tmp_path):
    path = tmp_path / "a.bag"
    left, right = arrays(EVENTS, 1), arrays(EVENTS[:50], 1)
    files.write_bag(path, 1, [("/left", left[0]), ("/right", right[0]), ("/left", left[1])])
    with pytest.raises(UsageError, match="events on /left, /right: choose one with topic="):
        open_recording(path)
    with pytest.raises(RecordingError, match=r"no events on /up; its topics are: /left \("):
        open_recording(path, topic="/up")
    assert absolute(path, topic="/left")[0].tolist() == EVENTS[:200]
    assert absolute(path, topic="/right")[0].tolist() == EVENTS[:50]


def test_a_bag_of_other_things_says_what_it_holds(tmp_path):
    files.write_bag(tmp_path / "a.bag", 1, [("/imu", b"1234")], {"/imu": "sensor_msgs/msg/Imu"})
    with pytest.raises(RecordingError, match=r"its topics are: /imu \(sensor_msgs/msg/Imu\)"):
        open_recording(tmp_path / "a.bag")


@pytest.mark.parametrize("ros", [1, 2])
def test_a_bag_that_is_cut_off_is_one_line_with_the_remedy(ros, tmp_path):
    path = tmp_path / ("a.bag" if ros == 1 else "a")
    files.write_bag(path, ros, on_e(ros))
    file = path if ros == 1 else next(path.glob("*.db3"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(RecordingError, match="reindex") as raised:
        absolute(path)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("metadata", ["", "{[", None])
def test_a_file_of_a_ros2_bag_is_read_alone_and_a_folder_by_its_metadata(
    metadata, plugin, tmp_path
):
    files.write_bag(tmp_path / "a", 2, on_e(2), storage=plugin)
    (file,) = (f for f in (tmp_path / "a").iterdir() if f.suffix in (".mcap", ".db3"))
    for path in (tmp_path / "a", file):
        assert absolute(path)[0].tolist() == EVENTS
    listing = tmp_path / "a" / "metadata.yaml"
    listing.unlink()
    if metadata is not None:
        listing.write_text(metadata)
    assert absolute(file)[0].tolist() == EVENTS
    with pytest.raises(RecordingError, match="ros2 bag reindex, or name one file of the bag"):
        open_recording(tmp_path / "a")


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_a_compressed_ros1_bag_is_read(compression, tmp_path):
    files.write_bag(tmp_path / "a.bag", 1, on_e(1), compression=compression)
    assert absolute(tmp_path / "a.bag")[0].tolist() == EVENTS


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("mode", ["MESSAGE", "FILE"])
def test_a_compressed_ros2_bag_is_read_and_leaves_nothing_behind(
    mode, plugin, tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    files.write_bag(tmp_path / "a", 2, on_e(2), storage=plugin, compression=mode)
    for chunk in (7, 1 << 16):
        assert absolute(tmp_path / "a", chunk_events=chunk)[0].tolist() == EVENTS
        assert not list((tmp_path / "temporary").iterdir())


@pytest.mark.parametrize("damage", ["cut off", "other bytes", "none of it"])
def test_a_damaged_compressed_bag_is_one_line_that_names_the_file(damage, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    files.write_bag(tmp_path / "a", 2, on_e(2), compression="FILE")
    (file,) = (tmp_path / "a").glob("*.zstd")
    data = file.read_bytes()
    changed = {"cut off": data[:-20], "other bytes": data[:40] + b"~" * 40 + data[80:]}
    file.write_bytes(changed.get(damage, b""))
    with pytest.raises(RecordingError, match=r"/a is (cut off|damaged)"):
        absolute(tmp_path / "a")
    assert not list((tmp_path / "temporary").iterdir())


# --- real bags --------------------------------------------------------------------------------


def test_a_real_bag_of_evt3_is_what_a_plain_decoder_makes_of_it(shared_data):
    folder = shared_data / "recordings" / "ros2_evt3_trigger"
    words = np.frombuffer(b"".join(files.payloads(folder)), files.EVT_WORDS["evt3"])
    expected = files.PlainDecoder("evt3").decode(words)
    recording = open_recording(folder)
    events = join_events(list(recording))
    events.t += expected[0][0]
    assert events.tolist() == expected
    assert (events.size, recording.sensor) == (82_469, Sensor(1280, 720))


def test_a_real_bag_of_libcaer_is_read_beyond_the_wrap_of_its_31_bits(shared_data):
    folder = shared_data / "recordings" / "ros2_libcaer_rollover"
    expected, wraps, last = [], 0, 0
    for payload in files.payloads(folder):
        for word, t in struct.iter_unpack("<Ii", payload):
            wraps += t < last - (1 << 30)
            last = t
            expected.append((t + (wraps << 31), word >> 17, word >> 2 & 0x7FFF, bool(word & 2)))
    recording = open_recording(folder)
    events = join_events(list(recording))
    events.t += expected[0][0]
    assert wraps == 1
    assert events.tolist() == expected
    assert (events.size, recording.sensor) == (334_331, Sensor(640, 480))
    assert recording.faults.total == 0


# --- arrays of other packages, and cut-off MCAP files -------------------------------------------

#: Definitions of events, and of what stands before them in a message.
EVENT_FORMS = {
    "dvs_msgs": "uint16 x\nuint16 y\ntime ts\nbool polarity",
    "other order": "bool p\nbuiltin_interfaces/Time timestamp\nuint16 y\nuint16 x",
    "microseconds": "uint32 x\nuint32 y\nint8 polarities\nint64 t_us",
    "nanoseconds": "uint64 time_ns\nuint16 x\nuint16 y\nuint8 pol",
    "seconds": "int16 x\nuint8 reserved\nint16 y\nfloat64 t\nbool on",
}
BEFORE = {
    "header": "std_msgs/Header header\nuint32 height\nuint32 width\n",
    "own": "string camera\nuint8[3] marks\nfloat32[] gains\nuint16 width\nuint16 height\n",
}


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize(
    ("package", "form", "before"),
    [
        ("dvs_msgs", "dvs_msgs", "header"),
        *(("some_msgs", form, before) for form in EVENT_FORMS for before in BEFORE),
    ],
)
def test_arrays_are_read_by_their_package_or_definition(ros, package, form, before, tmp_path):
    """Messages that rosbags serialises, which knows nothing of our readers; one is big-endian."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    name = f"{package}/msg/EventArray"
    head = "uint32 seq\n" if ros == 1 else ""
    parts = [
        f"{BEFORE[before]}{package}/Event[] events\nuint8 after",
        f"MSG: std_msgs/Header\n{head}{'time' if ros == 1 else 'builtin_interfaces/Time'} stamp\n"
        "string frame_id",
        f"MSG: {package}/Event\n{EVENT_FORMS[form]}",
    ]
    definition = f"\n{'=' * 80}\n".join(parts) + "\n"
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    types = get_types_from_msg(definition, name)
    store.register({key: value for key, value in types.items() if key.startswith(package)})
    time = store.types["builtin_interfaces/msg/Time"]

    def made(kind, **values):
        fields = [field for field, _ in store.get_msgdef(kind).fields]
        return store.types[kind](**{field: values[field] for field in fields})

    def event(t, x, y, p):
        stamp = time(sec=t // 10**6, nanosec=t % 10**6 * 1000)
        return made(
            f"{package}/msg/Event", x=x, y=y, reserved=9, ts=stamp, timestamp=stamp, t_us=t,
            time_ns=t * 1000, t=t / 1e6, p=p, polarity=p, on=p, pol=int(p), polarities=2 * p - 1,
        )  # fmt: skip

    messages = []
    for i in range(0, 90, 30):
        rows = [event(*row) for row in EVENTS[i : i + (1 if i == 30 else 30)]]
        stamp = time(sec=1, nanosec=2)
        message = made(
            name, height=260, width=346, events=rows, after=1, camera="front",
            header=made("std_msgs/msg/Header", stamp=stamp, frame_id="cam", seq=3),
            marks=np.arange(3, dtype=np.uint8), gains=np.arange(5, dtype=np.float32),
        )  # fmt: skip
        if ros == 1:
            messages.append(bytes(store.serialize_ros1(message, name)))
        else:
            messages.append(bytes(store.serialize_cdr(message, name, little_endian=i != 30)))
    path = tmp_path / ("a.bag" if ros == 1 else "a")
    sent = [("/camera/events", message) for message in messages]
    files.write_bag(path, ros, sent, {"/camera/events": name}, {"/camera/events": definition})
    events, recording = absolute(path, time_unit="s" if form == "seconds" else None)
    assert events.tolist() == [*EVENTS[:31], *EVENTS[60:90]]
    assert recording.sensor == SENSOR


def test_a_cut_off_mcap_file_is_refused_with_the_command_that_mends_it(tmp_path):
    files.write_bag(tmp_path / "a", 2, on_e(2), storage="MCAP")
    data, path = next((tmp_path / "a").glob("*.mcap")).read_bytes(), tmp_path / "a.mcap"
    for cut in (*range(20, len(data), len(data) // 37), len(data) - 9, len(data) - 1):
        path.write_bytes(data[:cut])
        with pytest.raises(RecordingError, match=r"is cut off, .* mcap recover a\.mcap"):
            open_recording(path)
    path.write_bytes(data[: len(data) // 2] + bytes(5_000))  # the disk lost power
    with pytest.raises(RecordingError, match="mcap recover"):
        open_recording(path)
