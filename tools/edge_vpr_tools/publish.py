"""Live matches over HTTP: a page, rows as server-sent events, and health for a watchdog."""

from __future__ import annotations

import base64
import hashlib
import ipaddress
import json
import math
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, NamedTuple, Self

from edge_vpr.errors import UsageError, printable
from edge_vpr.live.links import bracketed, listening_socket

#: Largest number of readers of ``/events``, and of threads of this process, of which a connection
#: takes one; others are refused.
MOST_READERS, MOST_THREADS = 32, 64
#: Largest number of rows that wait for a reader; beyond it, its oldest rows are left out.
WAITING_ROWS = 1_000
#: Whoever sends and takes nothing for this time is disconnected, in seconds.
_STUCK_S = 60.0
#: Bytes that are sent at once, and the system's buffer for a slow reader.
_SENT_BYTES, _SYSTEM_BYTES = 16_384, 65_536
#: Time at the end for readers to read what waits for them, in seconds.
_LAST_S = 1.0
#: Silence of the camera, and of `stream` itself, that is an error for a watchdog, in seconds.
SILENT_S, STUCK_S = 2.0, 5.0
_ADDRESS = re.compile(r"(?:(?:\[(?P<six>[^\]]+)\]|(?P<host>[^:\[\]]*)):)?(?P<port>\d{1,5})")


def parse_address(address: str) -> tuple[str, int]:
    """Return host and port of ``[HOST:]PORT``; the host is loopback unless one is named.

    Examples
    --------
    >>> parse_address("7000"), parse_address("0.0.0.0:7000"), parse_address("[::1]:7000")
    (('127.0.0.1', 7000), ('0.0.0.0', 7000), ('::1', 7000))
    """
    parts = _ADDRESS.fullmatch(address)
    if parts is None or int(parts["port"]) > 65_535:
        raise UsageError(
            f"--http {address}: expected a port, as 7000, or an address to listen on with a port, "
            "as 0.0.0.0:7000"
        )
    return parts["six"] or parts["host"] or "127.0.0.1", int(parts["port"])


class _Reader:
    """The rows that wait for a reader of ``/events``."""

    def __init__(self, *rows: bytes) -> None:
        self._rows = deque(rows)
        self._left_out = 0

    def add(self, row: bytes) -> None:
        """Add a row, in place of the oldest if too many wait."""
        if len(self._rows) >= WAITING_ROWS:
            self._rows.popleft()
            self._left_out += 1
        self._rows.append(row)

    def take(self) -> bytes:
        """Return the oldest rows, and before them the number of rows that were left out."""
        taken, size = [], 0
        if self._left_out:
            taken.append(_event(json.dumps({"kind": "left_out", "lines": self._left_out})))
            self._left_out = 0
        while self._rows and size < _SENT_BYTES:
            taken.append(self._rows.popleft())
            size += len(taken[-1])
        return b"".join(taken)


def _event(line: str) -> bytes:
    """Return a row as a server-sent event."""
    return b"data: " + line.encode() + b"\n\n"


class _Newest(NamedTuple):
    """The newest row of a kind."""

    at_s: float  #: When it was sent, on the monotonic clock.
    line: str


class MatchServer(ThreadingHTTPServer):
    """Serves the rows of a live run, read-only; matching never waits for a reader.

    ``/`` is a page, ``/events`` sends each row as a server-sent event from the moment of the
    connection, and before them the ``route`` row; ``/health`` is the newest health and match, with
    status 503 if the camera or `stream` itself is silent once the run has begun. A slow reader
    loses its oldest rows, and gets a row ``{"kind": "left_out", "lines": n}`` in their place.

    Parameters
    ----------
    address : str
        ``[HOST:]PORT``; port 0 is any that is free. Loopback unless a host is named.

    Raises
    ------
    LinkError
        If it cannot be listened on.
    """

    daemon_threads = True

    def __init__(self, address: str) -> None:
        host, port = parse_address(address)
        super().__init__((host, port), _Request, bind_and_activate=False)
        self.socket.close()
        self.socket = listening_socket(host, port, "serve on ")
        own = socket.gethostname().lower()
        #: Names under which a browser may ask; any address is one too.
        self.names = {"localhost", host.lower(), own, f"{own}.local"}
        shown = own if host in ("0.0.0.0", "::") else bracketed(host)
        #: Where a browser finds the page.
        self.address = f"http://{shown}:{self.socket.getsockname()[1]}/"
        self._changed = threading.Condition()  # of all below
        self._newest: dict[str, _Newest] = {}
        self._readers: set[_Reader] = set()
        self._closing = False
        self.stage = ""  #: What is compiled before the run begins.
        self._thread = threading.Thread(target=self.serve_forever, name="http", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Give readers a second to read waiting rows, then close."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._readers, _LAST_S)
        self.shutdown()
        self._thread.join()
        self.server_close()

    # rows, from the thread that matches

    def send(self, kind: str, line: str) -> None:
        """Send a row of JSON to each reader.

        Parameters
        ----------
        kind : str
            The row's own.
        line : str
            Without a line feed.
        """
        with self._changed:
            self._newest[kind] = _Newest(time.monotonic(), line)
            if self._readers:
                row = _event(line)
                for reader in self._readers:
                    reader.add(row)
                self._changed.notify_all()

    # requests, from a thread each

    @contextmanager
    def reader(self) -> Iterator[_Reader | None]:
        """Add a reader until the block ends; None if there are too many."""
        with self._changed:
            if len(self._readers) >= MOST_READERS or self._closing:
                reader = None
            else:
                route = self._newest.get("route")
                reader = _Reader(*([] if route is None else [_event(route.line)]))
                self._readers.add(reader)
        try:
            yield reader
        finally:
            with self._changed:
                self._readers -= {reader}
                self._changed.notify_all()

    def rows_for(self, reader: _Reader) -> Iterator[bytes]:
        """Yield the data to send to a reader, until the server closes."""
        while True:
            with self._changed:
                rows = reader.take()
                while not rows and not self._closing:
                    self._changed.wait()
                    rows = reader.take()
            if not rows:
                return
            yield rows

    def health(self) -> dict[str, Any]:
        """Return the newest health and match, whether to go on, and what is wrong."""
        with self._changed:
            health, match = (self._newest.get(kind) for kind in ("health", "match"))
        now = time.monotonic()
        newest_health = {} if health is None else json.loads(health.line)
        since_s = 0.0 if health is None else now - health.at_s
        why = ""
        if health is None:
            why = self.stage or "edge-vpr has only just begun"
        elif since_s > STUCK_S:
            why = f"edge-vpr stands still for {since_s:.0f} s"
        elif newest_health["lost_link"]:
            why = f"the link is lost: {newest_health['lost_link']}"
        elif newest_health["silent_s"] > SILENT_S:
            why = f"nothing came for {newest_health['silent_s']:.0f} s"
        newest = None
        if match is not None:
            newest = json.loads(match.line)
            newest["age_s"] = (newest.get("age_s") or 0.0) + now - match.at_s
            if newest["age_s"] > (newest_health.get("max_age_s") or math.inf):
                newest["lost"], newest["probability"] = True, 0.0
        # to restart what still compiles would only begin it again
        ok = health is None or not why
        return {"ok": ok, "why": why, "health": newest_health or None, "match": newest}

    # connections

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread, unless there are too many."""
        if threading.active_count() < MOST_THREADS:
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore connections that end in the middle, and a system that has no thread left."""


class _Request(BaseHTTPRequestHandler):
    """Answers one request, of which nothing but a GET of a known path is accepted."""

    server: MatchServer
    timeout = _STUCK_S
    default_request_version = "HTTP/1.0"  # else an error for a request of two words has no status

    def parse_request(self) -> bool:
        """Read the headers, and return whether the request is to be answered."""
        if not super().parse_request():
            return False
        if refusal := self._refusal():
            self.send_error(*refusal)
        return refusal is None

    def do_GET(self) -> None:
        """Answer with what the path names."""
        path = self.path.partition("?")[0]
        if path == "/":
            self._answer(HTTPStatus.OK, "text/html", _PAGE)
        elif path == "/health":
            health = self.server.health()
            status = HTTPStatus.OK if health["ok"] else HTTPStatus.SERVICE_UNAVAILABLE
            self._answer(status, "application/json", json.dumps(health).encode() + b"\n")
        elif path == "/events":
            self._events()
        else:
            self.send_error(HTTPStatus.NOT_FOUND, "there are /, /events and /health")

    def _refusal(self) -> tuple[HTTPStatus, str] | None:
        """Return why a request is refused; a page of another site must not read this one."""
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1:
            return HTTPStatus.BAD_REQUEST, "expected one Host header"
        if not self._is_own(hosts[0]):
            name = printable(hosts[0], 80)
            own = ", ".join(sorted(self.server.names))
            return HTTPStatus.FORBIDDEN, f"{name} is no name of this machine: use {own}"
        origin = self.headers.get("Origin")
        if origin is not None and origin.partition("://")[2] != hosts[0]:
            return HTTPStatus.FORBIDDEN, "another site may not read this"
        return None

    def _is_own(self, host: str) -> bool:
        """Return whether a Host header has an address or a name of this machine.

        Any other name can be made by its owner to lead here, so that a page of theirs reads ours.
        """
        name = re.sub(r":\d*$", "", host).lower().rstrip(".")
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return name in self.server.names
        return True

    def _answer(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _events(self) -> None:
        with self.server.reader() as reader:
            if reader is None:
                text = f"{MOST_READERS} readers are there: close one"
                self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, text)
                return
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SYSTEM_BYTES)
            self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/event-stream")
            self.end_headers()
            for rows in self.server.rows_for(reader):
                self.wfile.write(rows)

    def end_headers(self) -> None:
        """End the headers with those that each answer has."""
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", _POLICY)
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("X-Content-Type-Options", "nosniff")
        super().end_headers()

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Send an error as one line of text; a message may contain any text of the request."""
        status = HTTPStatus(code)
        body = f"{status:d} {printable(message or status.phrase)}\n".encode()
        self._answer(status, "text/plain", body)

    def version_string(self) -> str:
        """Return what the Server header says."""
        return "edge-vpr"

    def log_message(self, format: str, *args: object) -> None:
        """Write nothing: requests are no events of the run."""


_PAGE = files("edge_vpr_tools").joinpath("live_page.html").read_bytes()
_script = re.search(rb"<script>(.*?)</script>", _PAGE, re.DOTALL)
assert _script is not None
_HASH = base64.b64encode(hashlib.sha256(_script[1]).digest()).decode()
#: The page runs its own script and reads its own server, and nothing else.
_POLICY = (
    f"default-src 'none'; script-src 'sha256-{_HASH}'; style-src 'unsafe-inline'; "
    "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
