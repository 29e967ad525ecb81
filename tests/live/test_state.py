"""A session that goes on from the state of the one before, as a service that is started again."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from edge_vpr import Line, LiveSession, SessionFiles
from edge_vpr.archive import read_archive, write_archive
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.live import state as state_module
from edge_vpr.live.bridge import open_device_link
from edge_vpr.live.protocols import open_decoder, open_encoder
from edge_vpr.live.state import KIND, StateWriter
from edge_vpr.live.stream_matcher import StreamMatcher
from edge_vpr.matching.place_filter import NUMBERS
from edge_vpr.online import localiser as localiser_module
from edge_vpr.online.localiser import Localiser
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair
from tests.live.devices import DEVICES, Pipe, fed, greeted, send_all, sent_by, wait_until
from tests.streams import Drive, split_events

SENSOR = Sensor(128, 128)
TYPICAL = [(each.host, each.sends) for each in DEVICES if each.typical]


def played(events, state, path, host="evpr", device="evpr", overwrite=False, **changes):
    """The matches of a session that gets these events, and what it says of its state.

    They come read by read. If one read held all of them, and with them what the gap lost (the
    restart of a clock, or a device's answer to its commands), all of them would miss something.
    """
    pipe, encoder, said = Pipe(), open_encoder(device, SENSOR), []
    with LiveSession(
        Line(pipe, on_overload="wait"), protocol=host, reference=path,
        files=SessionFiles(state=state, overwrite=overwrite), max_age="60s",
        on_message=said.append, **changes,
    ) as session:  # fmt: skip
        fed(session, pipe, encoder.respond(session.decoder.setup()) + encoder.start())
        matches = [
            m for piece in Drive(events, SENSOR) for m in fed(session, pipe, encoder.encode(piece))
        ]
        session.stop()
        matches += session
    return matches, [message.text for message in said if message.kind == "state"]


def between(events, begin_s, end_s):
    return events[(events["t"] >= 1e6 * begin_s) & (events["t"] < 1e6 * end_s)].copy()


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize("times", ["go on", "restart"])
@pytest.mark.parametrize(("host", "device"), TYPICAL)
def test_a_session_goes_on_where_the_one_before_was(host, device, times, street, tmp_path):
    path, events, track = street
    if times == "restart" and host == "edvs":
        # one of 24 bits wraps after 17 s: a restart is then no other than a silence
        host = device = "edvs:format=E4"
    before, said = played(between(events, 0, 20), tmp_path / "run.state", path, host, device)
    assert said == []
    late = between(events, 20, 24)
    true_m = track.at(late["t"][-1:])[0, 0]
    late.t -= late["t"][0] if times == "restart" else 0
    matches, (said,) = played(late, tmp_path / "run.state", path, host, device)
    assert "goes on" in said
    assert matches[0].time_s > before[-1].time_s
    assert matches[0].missing == 1.0
    assert matches[-1].missing == 0.0
    assert not any(match.lost for match in matches)
    assert abs(matches[-1].along_m - true_m) < 8.0
    assert matches[-1].probability > 0.8


def resumed(live, reference, passed_us):
    """A localiser that goes on from the state of another one, so much later."""
    arrays, values = live.to_state()
    localiser = Localiser(reference, every="50ms")
    localiser.resume(arrays, values["now_us"], values["floor_us"])
    later = StreamMatcher(open_decoder("evpr", SENSOR), reference, "50ms")
    later.resume(localiser, values, passed_us)
    return later


@pytest.mark.parametrize("how", ["another run", "the same run"])
@pytest.mark.parametrize("first", ["events", "a frame without events"])
@pytest.mark.parametrize("count", [100, 1])
def test_the_time_in_which_nothing_was_seen_gives_no_matches(count, first, how, street):
    """After it, matches miss nothing as soon as their windows begin later, however bytes come."""
    path, events, _ = street
    reference, encoder = ReferenceMap.load(path), open_encoder("evpr", SENSOR)
    live = StreamMatcher(open_decoder("evpr", SENSOR), reference, "50ms")
    for piece in split_events(between(events, 0, 4), 100):
        live.feed(encoder.encode(piece), int(piece["t"][-1]))
    if how == "another run":
        live = resumed(live, reference, 40_000_000)
    late, reopened, matches = between(events, 4, 6), how == "the same run", 0
    late.t += 40_000_000
    pieces = [encoder.idle(int(late["t"][0]) - 10)] if first != "events" else []
    pieces += [encoder.encode(piece) for piece in split_events(late, count)]
    missing = []
    for n, data in enumerate(pieces):
        result = live.feed(data, 44_000_000, reopened=reopened and n == 0)
        matches += len(result.matches)
        missing += [match.missing for match in result.matches]
    assert 30 <= matches <= 2 / 0.05 + 10
    assert (missing[0], missing[-1]) == (1.0, 0.0)
    assert missing == sorted(missing, reverse=True)


@pytest.mark.parametrize("clock", ["goes on", "restarts"])
@pytest.mark.parametrize("how", ["another run", "the same run"])
def test_a_robot_that_drove_on_unseen_is_found_again(how, clock, street, tmp_path):
    """It is within three windows, and no match before claims to be right and is not."""
    path, events, track = street
    reference, encoder = ReferenceMap.load(path), open_encoder("evpr", SENSOR)
    late = between(events, 17, 22)
    off_us = int(late["t"][0]) if clock == "restarts" else 0
    late.t -= off_us
    live = StreamMatcher(open_decoder("evpr", SENSOR), reference)
    live.decoder.live = True  # the host's clock says how long a restart took
    for piece in split_events(between(events, 0, 14), 700):
        live.feed(encoder.encode(piece), int(piece["t"][-1]))
    if how == "another run":
        live = resumed(live, reference, 3_000_000)
    if clock == "restarts":
        encoder = open_encoder("evpr:boot=1", SENSOR)
    rows = []
    for n, piece in enumerate(split_events(late, 250)):
        reopened = how == "the same run" and n == 0
        result = live.feed(
            encoder.encode(piece), int(piece["t"][-1]) + 17_000_000, reopened=reopened
        )
        true_m = track.at(piece["t"][-1:] + off_us)[0, 0]
        for match in result.matches:
            off_m = abs(match.along_m - true_m)
            rows.append((match.time_us, off_m, match.probability))
    assert 16_500_000 < rows[0][0] < 17_500_000
    assert all(off_m < 8.0 for time_us, off_m, _ in rows if time_us > rows[0][0] + 3_100_000)
    assert all(off_m < 8.0 for _, off_m, probability in rows if probability > 0.9)
    assert rows[-1][2] > 0.8


def spoilt(what, state):
    """Make a state unusable, and return what is said of it."""
    arrays, values = read_archive(state, KIND)
    if what == "cut":
        state.write_bytes(state.read_bytes()[:-100])
        return "damaged"
    if what == "of fewer arrays":
        del arrays["filter_metric"]
        write_archive(state, KIND, arrays, values)
        return "lacks 'filter_metric'"
    passed_s = {"old": -601, "of later": 3_600}[what]
    kept_us = values["since_boot_us"] + passed_s * 10**6
    write_archive(state, KIND, arrays, values | {"since_boot_us": kept_us})
    return "at most 600 s" if what == "old" else "later than now"


@pytest.mark.parametrize("what", ["cut", "of fewer arrays", "old", "of later"])
def test_a_state_that_cannot_be_used_is_told_and_costs_nothing_else(what, street, tmp_path):
    path, events, _ = street
    state, early = tmp_path / "run.state", between(events, 0, 3)
    expected, _ = played(early, state, path)
    says = spoilt(what, state)
    matches, (said,) = played(early, state, path)
    assert "starts afresh" in said
    assert says in said
    assert "\n" not in said
    assert [(m.time_s, m.place) for m in matches] == [(m.time_s, m.place) for m in expected]
    assert "goes on" in played(early, state, path)[1][0]


@pytest.mark.parametrize("off_s", [-3_600, 3_600])
def test_a_clock_that_is_set_in_the_meantime_changes_nothing(off_s, street, tmp_path, clock):
    """As that of a computer without a battery for it, when the network tells the time."""
    path, events, track = street
    played(between(events, 0, 20), tmp_path / "run.state", path)
    clock.off_s += off_s
    late = between(events, 20, 24)
    matches, (said,) = played(late, tmp_path / "run.state", path)
    assert "goes on after" in said
    assert abs(matches[-1].along_m - track.at(late["t"][-1:])[0, 0]) < 8.0


def test_after_another_start_of_the_machine_a_state_says_where_and_not_when(
    street, tmp_path, monkeypatch
):
    """Which is seen at the place where it was, and as well where it may have come to since."""
    path, events, track = street
    played(between(events, 0, 10), tmp_path / "run.state", path)
    state = (tmp_path / "run.state").read_bytes()
    (tmp_path / "boot_id").write_text("another\n")
    monkeypatch.setattr(state_module, "BOOT_ID", tmp_path / "boot_id")
    for begin_s in (10, 20):
        (tmp_path / "run.state").write_bytes(state)
        late = between(events, begin_s, begin_s + 4)
        late.t -= late["t"][0]
        true_m = track.at(np.array([1e6 * (begin_s + 4)], dtype=np.int64))[0, 0]
        matches, (said,) = played(late, tmp_path / "run.state", path)
        assert said == "goes on after another start of the machine"
        assert (matches[0].missing, matches[-1].missing) == (1.0, 0.0)
        assert abs(matches[-1].along_m - true_m) < 8.0


def test_two_sessions_do_not_keep_their_states_in_one_file(street, tmp_path):
    """While one has it, another is refused; then it is free, and nothing else is left."""
    path, events, _ = street
    link = open_device_link("tcp://127.0.0.1:0")
    state = tmp_path / "run.state"
    arguments = {"protocol": "evpr", "reference": path}
    first = LiveSession(link.address, **arguments, files=SessionFiles(state=state))
    first.open()
    (tmp_path / "link.state").symlink_to(state)
    for name in ("run.state", "link.state"):
        files = SessionFiles(state=tmp_path / name)
        second = LiveSession(link.address, **arguments, files=files)
        with pytest.raises(UsageError, match="another session keeps its state there"):
            second.open()
    first.close()
    link.close()
    assert played(between(events, 0, 3), state, path)[0]
    assert sorted(each.name for each in tmp_path.iterdir()) == ["link.state", "run.state"]


def test_a_file_that_is_no_state_is_not_replaced(street, tmp_path):
    path, events, _ = street
    state = tmp_path / "run.state"
    foreign = b"{}", b"PK\x03\x04 cut off", Path(path).read_bytes()
    for content in foreign:
        state.write_bytes(content)
        damaged = content.startswith(b"PK") and content is not foreign[2]
        for overwrite in (False, True):
            files = SessionFiles(state=state, overwrite=overwrite)
            words = {"protocol": "evpr", "reference": path, "files": files}
            if damaged or overwrite:
                LiveSession("tcp://127.0.0.1:1", **words)
                continue
            with pytest.raises(UsageError, match=r"is no state of edge-vpr: .*overwrite=True"):
                LiveSession("tcp://127.0.0.1:1", **words)
        assert state.read_bytes() == content
    said = played(between(events, 0, 3), state, path, overwrite=True)[1][0]
    assert "is a reference map, not a live state" in said


def test_a_state_of_another_map_or_of_other_settings_is_not_used(street, tmp_path):
    path, events, _ = street
    state, early = tmp_path / "run.state", between(events, 0, 3)
    played(early, state, path)
    reference = ReferenceMap.load(path)
    other = ReferenceMap.build(simulate_pair(seed=3, length_m=40.0)[0])
    assert len(other) < len(reference)
    for route, changes in ((other, {}), (reference, {"exclusion": 3})):
        _, (said,) = played(early, state, route, **changes)
        assert "of another map, of other settings" in said


def test_a_state_with_other_numbers_of_the_filter_is_of_another_edge_vpr(street, monkeypatch):
    """Of the same version too: such a state is not called damaged."""
    localiser = Localiser(ReferenceMap.load(street[0]))
    own = localiser.checksum()
    monkeypatch.setattr(localiser_module, "NUMBERS", np.dtype(NUMBERS.descr[:-1]))
    assert localiser.checksum() != own


def test_a_file_is_read_without_keeping_a_state_which_is_told(street, tmp_path):
    path, events, _ = street
    said = []
    (tmp_path / "sent.bin").write_bytes(sent_by(between(events, 0, 3), SENSOR))
    with LiveSession(
        tmp_path / "sent.bin", protocol="evpr", reference=path, on_message=said.append,
        files=SessionFiles(state=tmp_path / "run.state"),
    ) as session:  # fmt: skip
        assert list(session)
    assert [each.text for each in said if each.kind == "state"] == [
        "a file or pipe is read again from its start: no state is kept"
    ]
    assert not (tmp_path / "run.state").exists()


def test_a_disk_that_is_slow_is_not_waited_for(monkeypatch, tmp_path):
    written, free = [], threading.Event()

    def write(path, kind, arrays, values):
        free.wait()
        written.append(values["n"])

    monkeypatch.setattr(state_module, "write_archive", write)
    writer = StateWriter(tmp_path / "run.state")
    for n in range(9):
        writer.offer(state_module.LiveState({}, {"n": n}))
    free.set()
    writer.close(state_module.LiveState({}, {"n": 9}))
    assert written[0] == 0
    assert written[-1] == 9
    assert len(written) < 9


def test_a_state_that_cannot_be_written_is_told_once_and_ends_nothing(
    monkeypatch, street, tmp_path
):
    path, events, _ = street
    monkeypatch.setattr(state_module, "KEEP_S", 0.0)
    (tmp_path / "run.state").mkdir()
    pipe, encoder, said = Pipe(), open_encoder("evpr", SENSOR), []

    def told():
        return [message for message in said if "not kept" in message.text]

    with LiveSession(
        pipe, protocol="evpr", reference=path, on_message=said.append,
        files=SessionFiles(state=tmp_path / "run.state"),
    ) as session:  # fmt: skip
        # the writer is a thread, which takes its time
        wait_until(lambda: fed(session, pipe, encoder.idle(0)) or told())
        for piece in Drive(between(events, 0, 3), SENSOR):
            fed(session, pipe, encoder.encode(piece))
    assert session.health.events == between(events, 0, 3).size
    assert len(told()) == 1


@pytest.mark.slow
def test_a_service_that_is_killed_goes_on_when_it_is_started_again(street, tmp_path):
    """What it had kept is whole, and its lock is nobody's."""
    path, events, track = street
    state, link = tmp_path / "run.state", open_device_link("virtual")
    encoder = open_encoder("evpr", SENSOR)
    words = [sys.executable, "-m", "edge_vpr_tools.cli", "stream", "--port", link.address, "-q"]
    words += ["--protocol", "evpr", "--map", path, "--state", state, "--on-overload", "wait"]
    process = subprocess.Popen(list(map(str, words)))
    try:
        greeted(link)
        send_all(link, encoder.start())
        for piece in Drive(between(events, 0, 20), SENSOR):
            send_all(link, encoder.encode(piece))

        def is_kept():
            send_all(link, encoder.idle(20_000_000))
            return state.exists() and read_archive(state, KIND)[1]["now_us"] > 19_500_000

        wait_until(is_kept, 120)
    finally:
        process.kill()
        process.wait()
        link.close()
    late = between(events, 20, 30)
    matches, (said,) = played(late, state, path)
    assert "goes on" in said
    assert matches[0].time_s > 20
    assert abs(matches[-1].along_m - track.at(late["t"][-1:])[0, 0]) < 8.0
