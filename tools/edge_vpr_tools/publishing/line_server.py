"""Server that sends rows of JSON, one in each line, to every program that connects."""

from __future__ import annotations

import json
import re
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from typing import Self

from edge_vpr.errors import UsageError
from edge_vpr.stream.link import LinkError
from edge_vpr.stream.network_links import bracketed

#: Largest number of lines that wait for a reader; beyond it, its oldest lines are left out.
WAITING_LINES = 1_000
#: Largest number of readers; others are refused.
MOST_READERS = 32
#: Buffer of the system for a slow reader, in bytes.
_SYSTEM_BYTES = 65_536
#: Time at the end for readers to read their waiting lines, in seconds.
_LAST_S = 1.0
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


class LineServer:
    """Sends each row to every reader; bytes from readers are ignored.

    A slow reader loses only its own lines, and gets a row ``{"kind": "left_out", "lines": n}`` in
    their place. Rows are not stored for readers that connect later.

    Parameters
    ----------
    address : str
        ``[HOST:]PORT``; port 0 is any that is free. Loopback unless a host is named.

    Attributes
    ----------
    address : str
        Where readers connect to, as ``tcp://HOST:PORT``.

    Raises
    ------
    UsageError
        If the address is none.
    LinkError
        If it cannot be listened on.
    """

    name = "serve"

    def __init__(self, address: str) -> None:
        host, port = parse_address(address)
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
            self._server = socket.create_server(found[4][:2], family=found[0])
        except OSError as error:
            raise LinkError(
                f"cannot serve on {bracketed(host)}:{port}: {error.strerror}: name an address of "
                "this machine, and a port that is free (0: any)"
            ) from error
        self._server.setblocking(False)
        host, port = self._server.getsockname()[:2]
        self.address = f"tcp://{bracketed(host)}:{port}"
        self._notices = deque([(f"matches are at {self.address}", True)])
        self._readers: frozenset[_Reader] = frozenset()
        self._lock = threading.Lock()  # of the readers and their lines
        self._woken, self._wake = socket.socketpair()
        self._wake.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._server, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
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

    def notices(self) -> Iterator[tuple[str, bool]]:
        """See `Publisher.notices`."""
        while self._notices:
            yield self._notices.popleft()

    def close(self) -> None:
        """Give readers a second to read waiting lines, then close; may be called again."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._rouse()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

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
            for key, ready in self._selector.select(None if end_s is None else 0.05):
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
        except OSError:  # gone again, or no descriptor is free
            return
        if len(self._readers) >= MOST_READERS:
            self._notices.append((f"{MOST_READERS} readers are there, another is refused", False))
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
