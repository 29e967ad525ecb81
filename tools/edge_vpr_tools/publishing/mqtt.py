"""Publisher that sends rows of JSON to an MQTT broker."""

from __future__ import annotations

import os
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple
from urllib.parse import unquote

from edge_vpr.errors import MissingExtraError, UsageError

#: Largest number of messages that wait for the broker; beyond it, the newest are left out.
WAITING_MESSAGES = 1_000
#: Environment variable with the password; other users could read an argument.
PASSWORD = "EDGE_VPR_MQTT_PASSWORD"
_KEEP_ALIVE_S = 10
_LAST_S = 1.0
_URL = re.compile(
    r"mqtt://(?:(?P<user>[^@/:]+)@)?(?P<host>\[[^\]/]+\]|[^@:/\[\]]+)(?::(?P<port>\d{1,5}))?"
    r"/(?P<topic>.+)"
)


class Broker(NamedTuple):
    """Address of a broker, and topic of the messages.

    Attributes
    ----------
    host : str
    port : int
    topic : str
        Of matches; other rows go to ``TOPIC/KIND``.
    user : str or None
    """

    host: str
    port: int
    topic: str
    user: str | None = None


def parse_url(url: str) -> Broker:
    """Parse ``mqtt://[USER@]HOST[:PORT]/TOPIC``.

    Raises
    ------
    UsageError
        If it is no such address.

    Examples
    --------
    >>> parse_url("mqtt://localhost/rover/match")
    Broker(host='localhost', port=1883, topic='rover/match', user=None)
    """
    found = _URL.fullmatch(url)
    port = int((found and found["port"]) or 1883)
    if found is None or not 0 < port < 65_536:
        raise UsageError(
            f"--mqtt {url}: expected mqtt://HOST/TOPIC, as mqtt://localhost/rover/match; a "
            f"password is taken from {PASSWORD}"
        )
    topic = unquote(found["topic"])
    if set("+#\0") & set(topic) or len(topic.encode()) > 60_000:
        raise UsageError(f"--mqtt {url}: a topic has no +, # or NUL and at most 60,000 bytes")
    user = unquote(found["user"]) if found["user"] else None
    return Broker(found["host"].strip("[]"), port, topic, user)


class MqttPublisher:
    """Passes rows to a client of paho-mqtt, which reconnects by itself.

    Messages are sent with QoS 0. While there is no broker, they are not stored.
    """

    name = "mqtt"

    def __init__(self, client: Any, broker: Broker) -> None:
        self._client, self._broker = client, broker
        self._lock = threading.Lock()
        self._waiting = 0
        self._there, self._tried = threading.Event(), threading.Event()
        self._notices: deque[tuple[str, bool]] = deque(maxlen=100)
        self._said = ""
        client.on_connect = self._connected
        client.on_disconnect = self._lost
        client.on_connect_fail = self._failed
        client.on_publish = self._published

    def send(self, kind: str, line: str) -> None:
        """See `Publisher.send`."""
        if not self._there.is_set():
            return
        with self._lock:
            if self._waiting >= WAITING_MESSAGES:
                return
            self._waiting += 1
        topic = self._broker.topic if kind == "match" else f"{self._broker.topic}/{kind}"
        self._client.publish(topic, line.encode())

    def notices(self) -> Iterator[tuple[str, bool]]:
        """See `Publisher.notices`."""
        while self._notices:
            yield self._notices.popleft()

    def wait_for_broker(self, seconds: float) -> None:
        """Wait until the broker answers or cannot be reached, so that the first rows are sent."""
        self._tried.wait(seconds)

    def close(self) -> None:
        """Give the broker a second to receive waiting messages, then disconnect."""
        end = time.monotonic() + _LAST_S
        while self._there.is_set() and self._waiting and time.monotonic() < end:
            time.sleep(0.01)
        self._client.on_disconnect = None
        self._client.disconnect()
        if self._waiting and (sock := self._client.socket()) is not None:
            # otherwise the client would wait for a hanging broker until a ping times out
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        self._client.loop_stop()

    def _say(self, text: str, good: bool) -> None:
        if text != self._said:  # each attempt fails in the same way
            self._said = text
            self._notices.append((text, good))
        self._tried.set()

    def _where(self) -> str:
        return f"{self._broker.host}:{self._broker.port}"

    def _connected(self, client: Any, data: Any, flags: Any, reason: Any, more: Any) -> None:
        if reason.is_failure:
            self._say(f"the broker at {self._where()} refuses: {reason}", False)
            return
        self._waiting = 0
        self._there.set()
        self._say(f"matches go to {self._where()}, topic {self._broker.topic}", True)

    def _lost(self, client: Any, data: Any, flags: Any, reason: Any, more: Any) -> None:
        if self._there.is_set():
            self._there.clear()
            self._say(f"the broker at {self._where()} is lost; trying again", False)

    def _failed(self, client: Any, data: Any) -> None:
        self._say(f"no broker at {self._where()}; trying again", False)

    def _published(self, client: Any, data: Any, number: int, reason: Any, more: Any) -> None:
        with self._lock:
            self._waiting -= 1


@contextmanager
def open_mqtt(url: str) -> Iterator[MqttPublisher]:
    """Connect to a broker; if it cannot be reached, try again during the run.

    Parameters
    ----------
    url : str
        ``mqtt://[USER@]HOST[:PORT]/TOPIC``. There is no encryption.

    Raises
    ------
    UsageError
        If it is no such address.
    MissingExtraError
        If the library is not installed.
    """
    broker = parse_url(url)
    try:
        from paho.mqtt import client as paho
        from paho.mqtt import enums
    except ImportError as error:
        raise MissingExtraError("--mqtt", "paho-mqtt", "mqtt") from error
    client = paho.Client(enums.CallbackAPIVersion.VERSION2)
    client.reconnect_delay_set(1, 10)
    if broker.user is not None:
        client.username_pw_set(broker.user, os.environ.get(PASSWORD))
    publisher = MqttPublisher(client, broker)
    client.connect_async(broker.host, broker.port, keepalive=_KEEP_ALIVE_S)
    client.loop_start()
    try:
        publisher.wait_for_broker(2.0)
        yield publisher
    finally:
        publisher.close()
