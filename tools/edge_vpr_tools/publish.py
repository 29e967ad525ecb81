"""Publishing of live matches: TCP lines and MQTT."""

from __future__ import annotations

import errno
import json
import os
import re
import selectors
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple, Self
from urllib.parse import parse_qsl, unquote

from edge_vpr.errors import MissingExtraError, UsageError
from edge_vpr.live.links import address_of, listening_socket

#: Time at the end for readers to read what waits for them, in seconds.
_LAST_S = 1.0


# Notices that would come too often are counted, and shown once a minute.


#: Shortest time between two notices of the same text, in seconds.
PAUSE_S = 60.0
#: Largest number of notices that wait, and of different texts whose last time is known.
_MOST = 100


class RareNotices:
    """Notices of a publisher; a text that comes again and again is given once a minute.

    Otherwise a program that connects, or a broker that answers and leaves, a hundred times a second
    would fill the log. One thread may add notices while another one takes them.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._new: deque[tuple[str, bool]] = deque(maxlen=_MOST)
        #: by text: when it was last given, whether it is good news, how often it came since
        self._given: dict[str, tuple[float, bool, int]] = {}

    def add(self, text: str, good: bool) -> None:
        """Add a notice, and whether it is good news."""
        now = self._clock()
        last, _, more = self._given.get(text, (now - PAUSE_S, good, 0))
        if more == 0 and now - last >= PAUSE_S:
            if len(self._given) >= _MOST:
                self._given.clear()
            self._given[text] = now, good, 0
            self._new.append((text, good))
        else:
            self._given[text] = last, good, more + 1

    def take(self) -> Iterator[tuple[str, bool]]:
        """Yield what is to be shown since the last call."""
        while self._new:
            yield self._new.popleft()
        now = self._clock()
        for text, (last, good, more) in list(self._given.items()):
            if more and now - last >= PAUSE_S:
                self._given[text] = now, good, 0
                yield f"{text} ({more:,} times in {now - last:.0f} s)", good


class Publisher(ABC):
    """Sends rows to readers, without ever waiting for a reader."""

    name: str  #: Kind of the row that its notices are.

    def __init__(self) -> None:
        self._notices = RareNotices()

    @abstractmethod
    def send(self, kind: str, line: str) -> None:
        """Send a row of JSON.

        Parameters
        ----------
        kind : str
            The row's own.
        line : str
            Without a line feed.
        """

    def notices(self) -> Iterator[tuple[str, bool]]:
        """Yield what happened since the last call, and whether it is good news."""
        return self._notices.take()


# Server that sends rows of JSON, one in each line, to every program that connects.


#: Largest number of lines that wait for a reader; beyond it, its oldest lines are left out.
WAITING_LINES = 1_000
#: Largest number of readers; others are refused.
MOST_READERS = 32
#: Buffer of the system for a slow reader, in bytes.
_SYSTEM_BYTES = 65_536
#: Pause after a connection that could not be accepted for want of these, in seconds.
_PAUSE_S = 1.0
_EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
_ADDRESS = re.compile(r"(?:(?:\[(?P<six>[^\]]+)\]|(?P<host>[^:\[\]]*)):)?(?P<port>\d{1,5})")


def parse_address(address: str) -> tuple[str, int]:
    """Return host and port of ``[HOST:]PORT``; the host is loopback unless one is named.

    Raises
    ------
    UsageError
        If it is no such address.

    Examples
    --------
    >>> parse_address("7000"), parse_address("0.0.0.0:7000"), parse_address("[::1]:7000")
    (('127.0.0.1', 7000), ('0.0.0.0', 7000), ('::1', 7000))
    """
    found = _ADDRESS.fullmatch(address)
    if found is None or int(found["port"]) > 65_535:
        raise UsageError(
            f"--serve {address}: expected a port, as 7000, or an address to listen on with a port, "
            "as 0.0.0.0:7000"
        )
    return found["six"] or found["host"] or "127.0.0.1", int(found["port"])


class _Reader:
    """A connection and the lines that wait for it."""

    def __init__(self, sock: socket.socket) -> None:
        self.socket = sock
        self.lines: deque[bytes] = deque()
        self.left_out = 0
        self._rest = b""

    def add(self, line: bytes) -> None:
        """Add a line, in place of the oldest if too many wait."""
        if len(self.lines) == WAITING_LINES:
            self.lines.popleft()
            self.left_out += 1
        self.lines.append(line)

    @property
    def waits(self) -> bool:
        """Whether something is to be sent."""
        return bool(self._rest or self.lines)

    def next_bytes(self) -> bytes:
        """Return the next bytes to send; the number of lines left out is sent in their place."""
        if not self._rest:
            if self.left_out:
                note = {"kind": "left_out", "lines": self.left_out}
                self.lines.appendleft(json.dumps(note).encode() + b"\n")
                self.left_out = 0
            self._rest = b"".join(self.lines)
            self.lines.clear()
        return self._rest

    def was_sent(self, n: int) -> None:
        """Take note that `n` bytes of `next_bytes` are sent."""
        self._rest = self._rest[n:]


class LineServer(Publisher):
    """Sends each row to every reader; bytes from readers are ignored.

    A slow reader loses only its own lines, and gets a row ``{"kind": "left_out", "lines": n}`` in
    their place. Rows are not stored for readers that connect later.

    Parameters
    ----------
    address : str
        ``[HOST:]PORT``; port 0 is any that is free. Loopback unless a host is named.

    Raises
    ------
    UsageError
        If the address is none.
    LinkError
        If it cannot be listened on.
    """

    name = "serve"

    def __init__(self, address: str) -> None:
        super().__init__()
        self._server = listening_socket(*parse_address(address), "serve on ")
        #: Where readers connect to, as ``tcp://HOST:PORT``.
        self.address = address_of("tcp", self._server)
        self._notices.add(f"matches are at {self.address}", True)
        self._readers: frozenset[_Reader] = frozenset()
        self._lock = threading.Lock()  # of the readers and their lines
        self._woken, self._wake = socket.socketpair()
        self._wake.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._server, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._paused_until_s: float | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="serve", daemon=True)
        self._thread.start()

    def send(self, kind: str, line: str) -> None:
        """See `Publisher.send`."""
        if not self._readers:
            return
        data = line.encode() + b"\n"
        with self._lock:
            for reader in self._readers:
                reader.add(data)
        self._rouse()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Give readers a second to read waiting lines, then close."""
        self._closing.set()
        self._rouse()
        self._thread.join()

    def _rouse(self) -> None:
        # full: the thread will wake up anyway
        with suppress(BlockingIOError):
            self._wake.send(b"\0")

    def _run(self) -> None:
        end_s = None
        while end_s is None or (
            time.monotonic() < end_s and any(reader.waits for reader in self._readers)
        ):
            if end_s is None and self._closing.is_set():
                end_s = time.monotonic() + _LAST_S
            if self._paused_until_s is not None and time.monotonic() >= self._paused_until_s:
                self._paused_until_s = None
                self._selector.register(self._server, selectors.EVENT_READ)
            wait_s = None if self._paused_until_s is None else _PAUSE_S
            for key, ready in self._selector.select(wait_s if end_s is None else 0.05):
                if key.fileobj is self._server:
                    self._accept()
                elif key.fileobj is self._woken:
                    self._woken.recv(4096)
                else:
                    self._serve(key.data, ready)
            for reader in self._readers:
                self._listen_to(reader)
        for sock in (*(r.socket for r in self._readers), self._server, self._woken, self._wake):
            sock.close()
        self._selector.close()

    def _accept(self) -> None:
        try:
            sock, _ = self._server.accept()
        except OSError as error:
            if error.errno in _EXHAUSTED:
                # the program still waits to be accepted: without a pause, this would run in circles
                self._selector.unregister(self._server)
                self._paused_until_s = time.monotonic() + _PAUSE_S
                self._notices.add(f"no reader can connect: {error.strerror}", False)
            return  # else it is gone again
        if len(self._readers) >= MOST_READERS:
            self._notices.add(f"{MOST_READERS} readers are there, another is refused", False)
            sock.close()
            return
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SYSTEM_BYTES)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        reader = _Reader(sock)
        self._selector.register(sock, selectors.EVENT_READ, reader)
        with self._lock:
            self._readers |= {reader}

    def _serve(self, reader: _Reader, ready: int) -> None:
        try:
            if ready & selectors.EVENT_READ and not reader.socket.recv(4096):
                self._leave(reader)
            elif ready & selectors.EVENT_WRITE:
                with self._lock:
                    data = reader.next_bytes()
                reader.was_sent(reader.socket.send(data))
        except BlockingIOError:
            pass
        except OSError:
            self._leave(reader)

    def _listen_to(self, reader: _Reader) -> None:
        """Wait for the socket to be ready to send only while lines wait."""
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if reader.waits else 0)
        if self._selector.get_key(reader.socket).events != wanted:
            self._selector.modify(reader.socket, wanted, reader)

    def _leave(self, reader: _Reader) -> None:
        self._selector.unregister(reader.socket)
        with self._lock:
            self._readers -= {reader}
        reader.socket.close()


# Publisher that sends rows of JSON to an MQTT broker.


#: Largest number of messages that wait for the broker; beyond it, the newest are left out.
WAITING_MESSAGES = 1_000
#: Environment variable with the password; other users could read an argument.
PASSWORD = "EDGE_VPR_MQTT_PASSWORD"
_KEEP_ALIVE_S = 10
#: Kinds of packets that a broker sends to a client without subscriptions: CONNACK, PUBACK (with
#: QoS 1) and PINGRESP; and the length of the longest in bytes.
_EXPECTED, _LONGEST_PACKET = (0x20, 0x40, 0xD0), 2
_URL = re.compile(
    r"mqtt(?P<tls>s?)://(?:(?P<user>[^@/:]+)@)?(?P<host>\[[^\]/]+\]|[^@:/\[\]]+)"
    r"(?::(?P<port>\d{1,5}))?/(?P<topic>[^?]+)(?:\?(?P<options>.*))?"
)


class Broker(NamedTuple):
    """Address of a broker, and topic of the messages."""

    host: str
    port: int
    topic: str  #: Of matches; other rows go to ``TOPIC/KIND``, and ``TOPIC/status`` is retained.
    user: str | None = None
    tls: bool = False  #: Encrypt the connection, and check the certificate of the broker.
    #: File with the certificate that the broker's is checked with; None: those of the system.
    authority: str | None = None
    qos: int = 0  #: 0, or 1: messages are sent again until the broker has acknowledged them.


def parse_url(url: str) -> Broker:
    """Parse ``mqtt://[USER@]HOST[:PORT]/TOPIC[?qos=1]``, or ``mqtts://...[?ca=FILE]`` for TLS.

    Raises
    ------
    UsageError
        If it is no such address.

    Examples
    --------
    >>> parse_url("mqtt://localhost/rover/match")[:4]
    ('localhost', 1883, 'rover/match', None)
    """
    found = _URL.fullmatch(url)
    port = int((found and found["port"]) or (8883 if found and found["tls"] else 1883))
    if found is None or not 0 < port < 65_536:
        raise UsageError(
            f"--mqtt {url}: expected mqtt://HOST/TOPIC, as mqtt://localhost/rover/match; a "
            f"password is taken from {PASSWORD}"
        )
    topic = unquote(found["topic"])
    if set("+#\0") & set(topic) or len(topic.encode()) > 60_000:
        raise UsageError(f"--mqtt {url}: a topic has no +, # or NUL and at most 60,000 bytes")
    user = unquote(found["user"]) if found["user"] else None
    options = dict(parse_qsl(found["options"] or "", keep_blank_values=True))
    qos, authority = options.pop("qos", "0"), options.pop("ca", None)
    if qos not in ("0", "1") or options or (authority is not None and not found["tls"]):
        raise UsageError(f"--mqtt {url}: expected ?qos=0 or 1, and ?ca=FILE with mqtts:// only")
    tls = bool(found["tls"])
    return Broker(found["host"].strip("[]"), port, topic, user, tls, authority, int(qos))


class MqttPublisher(Publisher):
    """Passes rows to a client of paho-mqtt, which reconnects by itself.

    While there is no broker, messages are not stored. ``TOPIC/status`` is retained, and is
    ``online``, ``ended`` or, by the will that the broker has, ``lost``.
    """

    name = "mqtt"

    def __init__(self, client: Any, broker: Broker) -> None:
        super().__init__()
        self._client, self._broker = client, broker
        self._there, self._tried = threading.Event(), threading.Event()
        self._said = ""
        client.will_set(f"{broker.topic}/status", _status("lost"), qos=1, retain=True)
        client.on_connect = self._connected
        client.on_disconnect = self._lost
        client.on_connect_fail = self._failed

    def send(self, kind: str, line: str) -> None:
        """See `Publisher.send`."""
        if not self._there.is_set():
            return
        if self._client.waiting >= WAITING_MESSAGES:
            text = (
                f"{WAITING_MESSAGES:,} messages wait for {self._where()}, newer ones are left out"
            )
            self._notices.add(text, False)
            return
        topic = self._broker.topic if kind == "match" else f"{self._broker.topic}/{kind}"
        self._client.publish(topic, line.encode(), qos=self._broker.qos)

    def wait_for_broker(self, seconds: float) -> None:
        """Wait until the broker answers or cannot be reached, so that the first rows are sent."""
        self._tried.wait(seconds)

    def close(self) -> None:
        """Give the broker a second to receive waiting messages, then disconnect."""
        end = time.monotonic() + _LAST_S
        self._wait_until_sent(end)
        if self._there.is_set():
            self._publish_status("ended")
        self._wait_until_sent(end)
        hangs = self._client.waiting > 0
        self._client.on_disconnect = None
        self._client.disconnect()
        if hangs and (sock := self._client.socket()) is not None:
            # otherwise the client would wait for a hanging broker until a ping times out
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        self._client.loop_stop()
        # without this circle the client is freed, and closes its sockets, when the publisher is
        self._client.on_connect = self._client.on_connect_fail = None

    def _wait_until_sent(self, end_s: float) -> None:
        while self._there.is_set() and self._client.waiting and time.monotonic() < end_s:
            time.sleep(0.01)

    def _publish_status(self, status: str) -> None:
        # with QoS 1 the client would keep one more of each connection of a broker that never
        # acknowledges; one that is lost with its connection is followed by the will
        self._client.publish(f"{self._broker.topic}/status", _status(status), retain=True)

    def _say(self, text: str, good: bool) -> None:
        if text != self._said:  # each attempt fails in the same way
            self._said = text
            self._notices.add(text, good)
        self._tried.set()

    def _where(self) -> str:
        return f"{self._broker.host}:{self._broker.port}"

    def _connected(self, client: Any, data: Any, flags: Any, reason: Any, more: Any) -> None:
        if reason.is_failure:
            self._say(f"the broker at {self._where()} refuses: {reason}", False)
            return
        if not self._there.is_set():  # a broker may say it more than once
            self._publish_status("online")
        self._there.set()
        self._say(f"matches go to {self._where()}, topic {self._broker.topic}", True)

    def _lost(self, client: Any, data: Any, flags: Any, reason: Any, more: Any) -> None:
        if self._there.is_set():
            self._there.clear()
            self._say(f"the broker at {self._where()} is lost; trying again", False)

    def _failed(self, client: Any, data: Any) -> None:
        other = ", or none whose certificate is valid" if self._broker.tls else ""
        self._say(f"no broker at {self._where()}{other}; trying again", False)


def _status(status: str) -> str:
    """Return what a subscriber reads of the stream itself."""
    return json.dumps({"kind": "status", "status": status})


def _guarded(client: Any) -> Any:
    """Return a class of clients that leave a broker which sends what nobody asked for.

    The library accepts packets of 256 MB. It also stores messages that were not subscribed to, and
    answers to requests, until the broker reads them.
    """

    class GuardedClient(client):  # type: ignore[misc]
        @property
        def waiting(self) -> int:
            """Number of messages to be sent, or to be acknowledged in this or a later connection.

            One that is to be sent and acknowledged counts twice.
            """
            return len(self._out_packet) + len(self._out_messages)

        def _sock_recv(self, size: int) -> Any:
            packet = self._in_packet
            kind = packet["command"] & 0xF0
            if kind and (kind not in _EXPECTED or packet["remaining_length"] > _LONGEST_PACKET):
                raise ConnectionAbortedError("the broker sends what was not asked for")
            return super()._sock_recv(size)

    return GuardedClient


@contextmanager
def open_mqtt(url: str) -> Iterator[MqttPublisher]:
    """Connect to a broker; if it cannot be reached, try again during the run.

    Raises
    ------
    UsageError
        If it is no such address, or the file of the certificate cannot be read.
    MissingExtraError
        If the library is not installed.
    """
    broker = parse_url(url)
    try:
        from paho.mqtt import client as paho
        from paho.mqtt import enums
    except ImportError as error:
        raise MissingExtraError("--mqtt", "paho-mqtt", "mqtt") from error
    client = _guarded(paho.Client)(enums.CallbackAPIVersion.VERSION2)
    client.reconnect_delay_set(1, 10)
    if broker.user is not None:
        client.username_pw_set(broker.user, os.environ.get(PASSWORD))
    if broker.tls:
        try:
            client.tls_set(ca_certs=broker.authority)
        except (OSError, ValueError) as error:
            raise UsageError(
                f"--mqtt {url}: the certificate cannot be read: {error}: name a file in PEM"
            ) from error
    publisher = MqttPublisher(client, broker)
    client.connect_async(broker.host, broker.port, keepalive=_KEEP_ALIVE_S)
    client.loop_start()
    try:
        publisher.wait_for_broker(2.0)
        yield publisher
    finally:
        publisher.close()
