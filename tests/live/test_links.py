"""Links to devices, and the thread that reads them: late hosts, lost cables, refused ports."""

from __future__ import annotations

import contextlib
import fcntl
import os
import random
import socket
import struct
import sys
import termios
import threading
import time

import numpy as np
import pytest

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor, make_events
from edge_vpr.live import bridge as bridge_module
from edge_vpr.live import links
from edge_vpr.live import reader as reader_module
from edge_vpr.live.bridge import Bridge, open_device_link
from edge_vpr.live.links import Link, LinkAbsent, LinkClosed, LinkError, SerialLink, open_link
from edge_vpr.live.protocols import open_encoder
from edge_vpr.live.reader import Chunk, LinkReader
from tests.live.devices import Clock, Pipe, bytes_waiting, play, send_all, wait_until


def ended(*pieces, live=True):
    """A link that gives these pieces, and then ends."""
    pipe = Pipe()
    pipe.live, pipe.error, pipe.waiting = live, LinkClosed("pipe has ended"), list(pieces)
    return pipe


def drained(reader):
    pieces = []
    while not reader.ended:
        piece = reader.take(0.1)
        if piece is not None:
            pieces.append(piece)
    return pieces


def test_a_late_reader_gets_the_newest_bytes_and_is_told_how_many_are_gone(monkeypatch):
    monkeypatch.setattr(reader_module, "BUFFER_BYTES", 1_000)
    sent = [bytes([i]) * 100 for i in range(50)]
    reader = LinkReader(lambda: ended(*sent), max_lag_s=60)
    reader._thread.join()
    pieces = drained(reader)
    assert b"".join(piece.data for piece in pieces) == b"".join(sent[-10:])
    assert sum(piece.dropped for piece in pieces) == 4_000
    assert pieces[0].dropped == 4_000


def test_what_has_waited_too_long_is_dropped_however_little_it_is():
    pipe = ended(b"old", b"older still")
    pipe.error, error = None, pipe.error
    reader = LinkReader(lambda: pipe, max_lag_s=0.1)
    time.sleep(0.2)
    pipe.error = error
    pipe.fill(b"new")
    reader._thread.join()
    assert [(p.data, p.dropped) for p in drained(reader)] == [(b"new", 14)]


def test_a_host_that_was_late_takes_all_that_waits_but_never_across_a_loss():
    reader = LinkReader(lambda: ended(b"ab", b"cd", b"ef"), drop=False)
    reader._thread.join()
    assert [piece.data for piece in drained(reader)] == [b"abcdef"]
    reader = LinkReader(ended)
    reader._thread.join()
    pieces = [Chunk(b"a", 0.0), Chunk(b"b", 0.0), Chunk(b"c", 0.0, 7), Chunk(b"d", 0.0, 0, True)]
    for piece in pieces:
        reader._chunks.append(piece)
        reader._held += 1
    assert [reader.take(0) for _ in range(4)] == [Chunk(b"ab", 0.0), *pieces[2:], None]


def test_a_link_that_can_wait_loses_nothing_to_a_late_reader(monkeypatch):
    monkeypatch.setattr(reader_module, "BUFFER_BYTES", 1_000)
    sent = [bytes([i]) * 100 for i in range(50)]
    reader = LinkReader(lambda: ended(*sent, live=False))
    wait_until(lambda: reader._held == 1_000)
    pieces = drained(reader)
    assert b"".join(piece.data for piece in pieces) == b"".join(sent)
    assert sum(piece.dropped for piece in pieces) == 0


def has_ipv6():
    with contextlib.suppress(OSError), socket.create_server(("::1", 0), family=socket.AF_INET6):
        return True
    return False


@pytest.mark.parametrize("name", ["", "[::1]"])
def test_udp_and_tcp_arrive_and_nothing_listens_beyond_loopback(name):
    if name and not has_ipv6():
        pytest.skip("no IPv6 here")
    loopback = name or "127.0.0.1"
    host = open_link(f"udp://{name}:0")
    assert host.address.startswith(f"udp://{loopback}:")
    device = open_device_link(host.address)
    assert device.write(b"events", 1) == 6
    assert host.read(30) == b"events"
    assert host.read(0) == b""
    with pytest.raises(LinkError, match="use TCP for a device that expects bytes"):
        host.write(b"x", 1)
    server = open_device_link(f"tcp://{name}:0")
    assert server.address.startswith(f"tcp://{loopback}:")
    client = open_link(server.address)
    assert server.write(b"events", 1) == 6
    assert client.read(30) == b"events"
    for link in (host, device, server, client):
        link.close()


def test_a_second_sender_is_left_out_and_told_until_the_first_is_silent(monkeypatch):
    """Two streams in one would be garbage to any decoder."""
    clock = Clock()
    monkeypatch.setattr(links, "time", clock)
    host = open_link("udp://:0")
    first, second = (open_device_link(host.address) for _ in range(2))
    for number in range(20):
        first.write(b"a%d" % number, 1)
        second.write(b"b%d" % number, 1)
    heard = [host.read(30) for _ in range(20)]
    assert heard == [b"a%d" % number for number in range(20)]
    assert host.read(0) == b""
    assert f"sends to {host.address} as well and is left out" in host.remark
    assert not host.stream_changed()
    clock.sleep(links.GIVES_WAY_S + 0.1)
    second.write(b"mine", 1)
    assert host.read(30) == b"mine"
    assert host.stream_changed()
    assert host.remark == ""
    for link in (host, first, second):
        link.close()


def test_a_sender_that_is_replaced_is_a_new_stream_to_the_decoder(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(links, "time", clock)
    reader = LinkReader(lambda: open_link("udp://:0"))
    first, second = (open_device_link(reader.address) for _ in range(2))
    first.write(b"one", 1)
    assert reader.take(30).data == b"one"
    clock.sleep(links.GIVES_WAY_S + 0.1)
    second.write(b"two", 1)
    piece = reader.take(30)
    assert (piece.data, piece.reopened) == (b"two", True)
    second.write(b"three", 1)
    piece = reader.take(30)
    assert (piece.data, piece.reopened) == (b"three", False)
    reader.stop()
    for link in (first, second):
        link.close()


def test_a_datagram_without_bytes_is_no_end_and_one_to_nobody_no_failure():
    host = open_link("udp://:0")
    device = open_device_link(host.address)
    assert device.write(bytes(5_000), 1) == 1_400
    assert host.read(30) == bytes(1_400)
    device._socket.sendto(b"", device._to)
    assert host.read(0.1) == b""
    host.close()
    for _ in range(3):
        assert device.write(b"x", 1) == 1
        time.sleep(0.01)  # for the answer that nobody is there
    device.close()


def test_a_second_host_is_refused_and_a_silent_one_is_missed():
    server = open_device_link("tcp://:0")
    first = open_link(server.address)
    assert server.accepted(30)
    with pytest.raises(LinkError, match="refused"):
        open_link(server.address)
    for link in (first, server._host):
        assert link._socket.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
    first.close()
    server.close()


def test_two_programs_cannot_read_one_serial_port():
    device = open_device_link("virtual")
    host = open_link(device.address)
    with pytest.raises(LinkError, match="another program has it: end that one first"):
        open_link(device.address)
    host.close()
    open_link(device.address).close()
    device.close()


def test_standard_input_stays_as_it_is_for_those_who_share_it(monkeypatch):
    ends = os.pipe()
    monkeypatch.setattr("sys.stdin", os.fdopen(ends[0]))
    link = open_link("-")
    assert os.get_blocking(ends[0])
    assert link.read(0) == b""
    os.write(ends[1], b"events")
    assert link.read(1) == b"events"
    os.close(ends[1])
    with pytest.raises(LinkClosed, match="has ended"):
        link.read(1)
    link.close()
    sys.stdin.close()


def test_a_link_that_cannot_be_opened_is_one_line(tmp_path):
    for address, says in (
        ("tcp://127.0.0.1:1", "refused: check that the other side is there"),
        (str(tmp_path / "ttyNone"), "there is no such file or port: `edge-vpr ports` lists"),
        (str(tmp_path), "check that it is a serial port"),
        ("loop://", "loop:// is no port of this machine: serve it by TCP"),
    ):
        with pytest.raises(LinkError, match=says):
            open_link(address)
    with pytest.raises(UsageError, match="names no port"):
        open_link("tcp://somewhere")


def test_a_serial_port_is_read_in_whole_pieces_and_ends_when_its_other_side_does(any_baud):
    device = open_device_link("virtual")
    host = open_link(device.address, baud=12_000_000)
    assert isinstance(host, SerialLink)
    assert host.read(0.01) == b""
    sent = bytes(range(256)) * 8
    send_all(device, sent)
    wait_until(lambda: bytes_waiting(host) == len(sent))
    assert host.read(0) == sent  # and not byte by byte
    send_all(host, b"E+\n")
    wait_until(lambda: bytes_waiting(device) == 3)
    assert device.read(0) == b"E+\n"
    device.close()
    with pytest.raises(LinkClosed, match="was lost"):
        while True:
            host.read(1)
    host.close()
    host.close()


def test_what_the_ports_driver_counts_as_damaged_is_told(monkeypatch):
    counted, real = {"framing": 3, "overrun": 5, "parity": 7, "buffer": 11}, fcntl.ioctl

    def ioctl(descriptor, request, *rest):
        if request != termios.TIOCGICOUNT:
            return real(descriptor, request, *rest)
        names = ("framing", "overrun", "parity", None, "buffer")
        return struct.pack("20i", *[1] * 6, *(counted.get(name, 1) for name in names), *[1] * 9)

    device = open_device_link("virtual")
    monkeypatch.setattr("fcntl.ioctl", ioctl)
    host = open_link(device.address)
    assert host.line_errors() == 0
    counted.update(framing=4, buffer=111)
    assert host.line_errors() == 101
    monkeypatch.undo()
    host.close()
    device.close()


def test_damage_counted_by_the_system_is_added_up_over_links():
    links = [ended(b"one"), ended(b"two")]
    for link, errors in zip(links, (2, 3), strict=True):
        link.line_errors = lambda errors=errors: errors
    reader = LinkReader(lambda: links.pop(0) if links else ended(), retry=True)
    wait_until(lambda: reader.take(0) is None and reader.line_errors == 5)
    reader.stop()


def test_damage_in_the_last_moment_is_counted(monkeypatch):
    """The count is read from time to time, and once more when the link ends."""

    class Damaged(Pipe):
        def line_errors(self):
            return 3 if self.ending else 0

    pipe = Damaged()
    pipe.ending = False
    reader = LinkReader(lambda: pipe)
    reader.take(0.05)
    pipe.ending = True
    reader.stop()
    reader._thread.join()
    assert reader.line_errors == 3


def test_a_bridge_that_nobody_greets_waits_until_its_terminal_has_been_set_up():
    device = open_device_link("virtual")
    assert not device.opened()
    # evt3 has no greeting: what it sends before the host is there would be thrown away
    bridge = Bridge(device, open_encoder("evt3", Sensor(4, 4)), speed=0)
    waiting = threading.Thread(target=bridge.wait_for_host, daemon=True)
    waiting.start()
    waiting.join(timeout=0.8)
    assert waiting.is_alive()
    host = open_link(device.address)
    assert device.opened()
    waiting.join(timeout=30)
    assert not waiting.is_alive()
    host.close()
    device.close()


@pytest.mark.parametrize("late_s", [0.0, 0.3])
def test_a_bridge_says_by_how_much_it_was_late(late_s, monkeypatch):
    """Of 0.2 s of events, by a line that takes none for a while."""
    clock = Clock()
    monkeypatch.setattr(bridge_module, "time", clock)

    class Slow(Link):
        def read(self, timeout):
            clock.sleep(timeout)
            return b""

        def write(self, data, timeout):
            nonlocal late_s
            clock.sleep(late_s)
            late_s = 0.0
            return len(data)

        def close(self):
            pass

    expected_s, events = late_s, make_events(np.arange(0, 200_000, 1_000), [1] * 200, [2] * 200)
    bridge = Bridge(Slow("slow"), open_encoder("evt3", Sensor(4, 4)))
    bridge.run([events])
    # the next slice of events is due 5 ms later
    assert bridge.behind_s == pytest.approx(expected_s, abs=0.01)


def fed(pipe, reader, number):
    """Feed bytes one by one to a caller in time."""
    for i in range(number):
        pipe.fill(bytes([i]))
        chunk = reader.take(30)
        assert (chunk.data, chunk.reopened) == (bytes([i]), False)


def test_whatever_the_caller_does_the_thread_reads_and_nothing_is_lost_or_changes_places():
    pipe = Pipe()
    reader = LinkReader(lambda: pipe, max_lag_s=60)
    rng, sent, received = random.Random(5), [], []
    for number in range(60):
        data = b"%d," % number
        pipe.fill(data)
        sent.append(data)
        if rng.random() < 0.15:
            time.sleep(0.08)
        if rng.random() < 0.7:
            chunk = reader.take(rng.choice([0, 0.001, 0.2]))
            received.append(b"" if chunk is None else chunk.data)
    wait_until(lambda: not pipe.waiting)  # it is read while the caller takes nothing
    while sum(map(len, received)) < sum(map(len, sent)):
        received.append(reader.take(30).data)
    assert b"".join(received) == b"".join(sent)
    reader.stop()
    assert len(set(pipe.readers)) == 1


@pytest.mark.parametrize("retry", [True, False])
def test_a_link_that_breaks_under_the_caller_is_opened_again_or_ends(retry):
    pipes = [Pipe(), Pipe()]
    opened = iter([pipes[0], None, pipes[1]])

    def open_next():
        if (link := next(opened)) is None:
            raise LinkError("not there yet")
        return link

    reader = LinkReader(open_next, retry=retry)
    assert reader.take(0.3) is None
    fed(pipes[0], reader, 3)
    pipes[0].error = LinkError("cable pulled")
    assert reader.take(0.8) is None  # it may be open again, and idle
    pipes[1].fill(b"again")
    chunk = reader.take(30)
    if retry:
        assert (chunk.data, chunk.reopened) == (b"again", True)
        assert not reader.ended
        fed(pipes[1], reader, 3)
        reader.stop()
    else:
        assert chunk is None
        assert reader.ended
        assert reader.error is pipes[0].error


def test_a_mistake_of_ours_under_the_caller_ends_the_reader_and_is_told():
    pipe = Pipe()
    reader = LinkReader(lambda: pipe, retry=True)
    assert reader.take(0.3) is None
    pipe.error = RuntimeError("a mistake of ours")
    assert reader.take(30) is None
    assert reader.ended
    assert reader.error is pipe.error


@pytest.mark.parametrize(
    ("address", "is_waited_for"),
    [
        ("/dev/ttyACM97", True),
        ("/dev/serial/by-path/platform-fd500000.pcie-pci-0000:01:00.0-usb-0:1.3:1.0-port0", True),
        ("/dev/serial/by-id/usb-Arduino__www.arduino.cc__0043_7563-if00", True),
        ("hwgrep://no camera of this name", True),
        ("hwgrep://(", False),
        ("hwgrep://x&colour=1", False),
        ("missing.bin", False),
        ("/dev/null", False),
    ],
)
def test_a_port_is_waited_for_whatever_its_name_and_a_file_is_not(address, is_waited_for, tmp_path):
    """A dot in its name made a port by path a file."""
    with pytest.raises(LinkError) as raised:
        open_link(address if "/" in address else str(tmp_path / address))
    assert isinstance(raised.value, LinkAbsent) is is_waited_for


def test_a_camera_that_comes_back_under_another_name_is_found_by_its_numbers(monkeypatch):
    """The kernel gives the next free number to a port that is still open when it is lost."""
    from serial.tools import list_ports, list_ports_common

    def plug_in():
        ours, theirs = os.openpty()
        port = list_ports_common.ListPortInfo(os.ttyname(theirs))
        port.hwid = "USB VID:PID=37C5:1206 SER=3456 LOCATION=1-1.3"
        os.close(theirs)
        return ours, port

    attached = []
    monkeypatch.setattr(list_ports, "comports", lambda *_: list(attached))

    ours, port = plug_in()
    attached.append(port)
    reader = LinkReader(lambda: open_link("hwgrep://37C5:1206"), retry=True, max_lag_s=60)
    try:
        os.write(ours, b"first")
        assert reader.take(30).data == b"first"
        attached.clear()
        ours_then, port_then = plug_in()
        assert port_then.device != port.device
        os.close(ours)
        attached.append(port_then)
        end, data = time.monotonic() + 30, b""
        while not data and time.monotonic() < end:
            os.write(ours_then, b"again")
            chunk = reader.take(0.2)
            data = chunk.data if chunk is not None else b""
        assert data.startswith(b"again")
        os.close(ours_then)
    finally:
        reader.stop()


def test_an_adapter_that_gathers_bytes_is_told_to_send_them_at_once(monkeypatch):
    import serial

    modes = []
    monkeypatch.setattr(serial.Serial, "set_low_latency_mode", lambda _, on: modes.append(on))
    ours, theirs = os.openpty()
    open_link(os.ttyname(theirs)).close()
    assert modes == [True]
    os.close(ours)
    os.close(theirs)


def test_a_bridge_on_tcp_keeps_its_line_until_the_host_has_all(monkeypatch):
    """A socket that is closed while words of the host are unread discards what it still holds."""
    monkeypatch.setattr(Bridge, "_serve", lambda *_: None)
    rng, spoken = np.random.default_rng(0), threading.Event()
    times, pixels = np.sort(rng.integers(0, 10**6, 30_000)), rng.integers(0, 64, (3, 30_000))
    events = make_events(times, pixels[0], pixels[1], pixels[2] % 2)

    def pieces():
        spoken.wait()
        yield events

    address, bridge, thread = play(pieces(), Sensor(64, 64))
    with socket.socket() as host:
        host.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_096)
        host.connect(("127.0.0.1", int(address.rpartition(":")[2])))
        host.sendall(b"here I am")
        wait_until(lambda: bridge.sent_bytes)  # it has read that
        host.sendall(b"and here I stay")
        spoken.set()
        wait_until(lambda: bridge.sent_events == len(events))
        thread.join(0.3)  # it would end at once
        got = 0
        while data := host.recv(1 << 16):
            got += len(data)
    thread.join()
    assert got == bridge.sent_bytes > 100_000
