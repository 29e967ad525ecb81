"""Links to a camera: serial lines, TCP, UDP, pipes and files; opened, read and opened again."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import io
import math
import os
import re
import select
import socket
import struct
import sys
import termios
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from edge_vpr.errors import EdgeVprError, UsageError

# Interface of a link to a device or to a host, and its errors.


READ_BYTES = 1 << 16


class LinkError(EdgeVprError):
    """A link cannot be opened, or has broken."""


class LinkClosed(LinkError):  # noqa: N818, an end is no error of its own
    """The other side has closed the link, or the file has ended."""


class LinkAbsent(LinkError):  # noqa: N818, a camera that is not there yet is no error of its own
    """There is no device at the address now, but one may appear later."""


class Link(ABC):
    """A link to a device (or, for a bridge, to a host).

    Attributes
    ----------
    live : bool
        Whether the sender continues without waiting for the reader, so that a late reader must drop
        data.
    two_way : bool
        Whether bytes go in both directions, or only from the device to the host.
    remark : str
        Current message about the link for the user; empty if there is none.
    """

    live = True
    two_way = True
    remark = ""

    def __init__(self, address: str) -> None:
        self.address = address

    @abstractmethod
    def read(self, timeout: float) -> bytes:
        """Return the bytes that have arrived, after at most `timeout` seconds; may be empty."""

    @abstractmethod
    def write(self, data: bytes, timeout: float) -> int:
        """Send as much as possible within `timeout` seconds; return the number of bytes sent."""

    @abstractmethod
    def close(self) -> None:
        """Close the link; may be called again."""

    def line_errors(self) -> int:
        """Return the number of characters that the system reports as damaged or dropped."""
        return 0

    def stream_changed(self) -> bool:
        """Return whether the bytes that were read last are the beginning of another stream."""
        return False


class AbsentLink(Link):
    """Placeholder for a link that could not be opened yet."""

    def __init__(self, address: str, why: str) -> None:
        super().__init__(address)
        self._why = why

    def read(self, timeout: float) -> bytes:
        """Raise `LinkClosed`."""
        raise LinkClosed(self._why)

    def write(self, data: bytes, timeout: float) -> int:
        """Raise `LinkClosed`."""
        raise LinkClosed(self._why)

    def close(self) -> None:
        """See `Link.close`."""


class DescriptorLink(Link):
    """Link over a file descriptor."""

    def __init__(self, address: str, descriptor: int, *, live: bool = True) -> None:
        super().__init__(address)
        self.live = live
        self._fd = descriptor
        # one buffer for all reads: allocating the largest size and truncating it would fragment
        # the memory
        self._buffer = memoryview(bytearray(READ_BYTES))
        if live:
            # standard input is shared (on a terminal even with the output), and is not changed
            os.set_blocking(descriptor, False)

    def read(self, timeout: float) -> bytes:
        """See `Link.read`."""
        try:
            if not select.select([self._fd], [], [], timeout)[0]:
                return b""
            size = os.readv(self._fd, [self._buffer])
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise _link_error(self.address, error) from error
        if not size:
            raise LinkClosed(f"{self.address} has ended")
        return bytes(self._buffer[:size])

    def write(self, data: bytes, timeout: float) -> int:
        """See `Link.write`."""
        with as_link_error(self.address):
            if not select.select([], [self._fd], [], timeout)[1]:
                return 0
            try:
                return self._put(data)
            except BlockingIOError:
                return 0

    def _put(self, data: bytes) -> int:
        return os.write(self._fd, data)

    def fileno(self) -> int:
        """Return the descriptor; -1 once the link is closed."""
        return self._fd

    def close(self) -> None:
        """See `Link.close`."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


@contextlib.contextmanager
def as_link_error(address: str) -> Iterator[None]:
    """Convert errors of the system to `LinkError`."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise _link_error(address, error) from error


def _link_error(address: str, error: Exception) -> LinkError:
    """Return what an error of the system means for a link."""
    # select raises ValueError for a closed descriptor
    kind = LinkClosed if isinstance(error, (ConnectionError, ValueError)) else LinkError
    return kind(f"{address}: {error}: check that the other side is there")


# Links over serial ports.


# Linux's struct serial_icounter_struct: cts, dsr, rng, dcd, rx, tx, frame, overrun, parity, brk,
# buf_overrun, and nine that are spare
_COUNTERS = struct.Struct("20i")


class SerialLink(DescriptorLink):
    """Serial port that is configured by pyserial, and read without it.

    pyserial configures the port again for each change of the time-out, and waits for single bytes
    where thousands arrive together.
    """

    def __init__(self, address: str, port: Any) -> None:
        super().__init__(address, port.fileno())
        self._port = port
        self._errors_before = 0
        self._errors_before = self.line_errors()

    def line_errors(self) -> int:
        """See `Link.line_errors`; also 0 if the driver of the port does not count."""
        try:
            raw = fcntl.ioctl(self._fd, termios.TIOCGICOUNT, bytes(_COUNTERS.size))
        except (OSError, ValueError, AttributeError):
            return 0
        *_, framing, overrun, parity, _, buffer_overrun = _COUNTERS.unpack(raw)[:11]
        return int(framing + overrun + parity + buffer_overrun) - self._errors_before

    def read(self, timeout: float) -> bytes:
        """See `Link.read`; an error means that the cable was disconnected."""
        try:
            return super().read(timeout)
        except LinkError as error:
            raise LinkClosed(f"{self.address} was lost: {error}") from error

    def write(self, data: bytes, timeout: float) -> int:
        """See `Link.write`."""
        try:
            return super().write(data, timeout)
        except LinkError as error:
            raise LinkClosed(f"{self.address} was lost: {error}") from error

    def close(self) -> None:
        """See `Link.close`."""
        self._fd = -1
        with contextlib.suppress(Exception):
            self._port.close()


class UrlLink(Link):
    """Link over an address of pyserial that is no device file, such as ``rfc2217://``."""

    def __init__(self, address: str, port: Any) -> None:
        super().__init__(address)
        port.timeout = 0
        self._port = port

    def read(self, timeout: float) -> bytes:
        """See `Link.read`."""
        import serial

        end = time.monotonic() + timeout
        while True:
            try:
                data: bytes = self._port.read(READ_BYTES)
            except (serial.SerialException, OSError, TypeError) as error:
                # pyserial raises TypeError for a port that another thread has closed
                raise LinkClosed(f"{self.address} was lost: {error}") from error
            left = end - time.monotonic()
            if data or left <= 0:
                return data
            time.sleep(min(0.001, left))

    def write(self, data: bytes, timeout: float) -> int:
        """See `Link.write`."""
        import serial

        try:
            return int(self._port.write(data) or 0)
        except serial.SerialTimeoutException:
            return 0
        except (serial.SerialException, OSError, TypeError) as error:
            raise LinkClosed(f"{self.address} was lost: {error}") from error

    def close(self) -> None:
        """See `Link.close`."""
        with contextlib.suppress(Exception):
            self._port.close()


def open_serial(address: str, baud: int, *, flow_control: bool) -> Link:
    """Open a serial port, or any other address that pyserial's ``serial_for_url`` accepts."""
    import serial

    try:
        port = serial.serial_for_url(
            address,
            baudrate=baud,
            timeout=0,
            write_timeout=1,
            rtscts=flow_control,
            exclusive=True,  # exclusive, because two readers would each get a part of the bytes
        )
    except (serial.SerialException, OSError, ValueError, termios.error, re.error) as error:
        text = f"cannot open {address or 'no port'}: {_why(error)}"
        raise (LinkAbsent if _may_come(address, error) else LinkError)(text) from error
    # a bridge of FTDI gathers bytes for 16 ms otherwise; other drivers have no such mode
    with contextlib.suppress(Exception):
        port.set_low_latency_mode(True)
    try:
        port.fileno()
    except (AttributeError, io.UnsupportedOperation, OSError):
        return UrlLink(address, port)
    return SerialLink(address, port)


def _may_come(address: str, error: Exception) -> bool:
    """Return whether a port that cannot be opened may be plugged in later."""
    if address.startswith("hwgrep://"):
        # pyserial's error has no number if no port is found
        return isinstance(error, OSError) and error.errno is None
    if getattr(error, "errno", None) not in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        return False
    # names of ports by their path or maker have dots, others with a suffix are those of files
    return address.startswith("/dev/") or (address != "" and not Path(address).suffix)


def _why(error: Exception) -> str:
    """Return what is wrong with a port, and what to do."""
    number = getattr(error, "errno", None)
    if isinstance(error, re.error):
        return f"{error}: after hwgrep:// is a regular expression, matched with names and numbers"
    if number == errno.ENOENT:
        return "there is no such file or port: `edge-vpr ports` lists those that are attached"
    if number in (errno.EACCES, errno.EPERM):
        return "permission denied: join the group that owns it, often dialout"
    if number in (errno.EAGAIN, errno.EBUSY):
        return "another program has it: end that one first"
    return f"{error}: check that it is a serial port, its cable and its permissions"


# Links over TCP and UDP.


# a peer that vanished without closing, for example without power, is noticed after 11 s
_KEEP_ALIVE = (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3))
#: When the sender was silent for this time, another one may take its place.
GIVES_WAY_S = 2.0


class SocketLink(DescriptorLink):
    """Link over a connected or bound socket."""

    def __init__(self, address: str, sock: socket.socket) -> None:
        self._socket = sock
        super().__init__(address, sock.fileno())

    def close(self) -> None:
        """See `Link.close`."""
        self._socket.close()
        self._fd = -1


class TcpLink(SocketLink):
    """A TCP connection."""

    def __init__(self, address: str, sock: socket.socket) -> None:
        super().__init__(address, sock)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEP_ALIVE:
            if option := getattr(socket, name, None):
                sock.setsockopt(socket.IPPROTO_TCP, option, value)


class UdpHostLink(SocketLink):
    """A bound UDP socket, which receives from one sender at a time and cannot send.

    The first sender is received until it is silent for `GIVES_WAY_S`. Mixed bytes of two senders
    could not be decoded, so that bytes of others are ignored meanwhile.
    """

    two_way = False

    def __init__(self, host: str, port: int) -> None:
        with as_link_error(f"udp://{host}:{port}"):
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            sock = socket.socket(found[0], socket.SOCK_DGRAM)
            sock.bind(found[4])
        super().__init__(address_of("udp", sock), sock)
        self._sender: object = None
        self._heard_s = 0.0
        self._sender_changed = False

    def read(self, timeout: float) -> bytes:
        """See `Link.read`; an empty datagram is no end."""
        end = time.monotonic() + timeout
        with as_link_error(self.address):
            while select.select([self._fd], [], [], max(0.0, end - time.monotonic()))[0]:
                try:
                    data, sender = self._socket.recvfrom(READ_BYTES)
                except BlockingIOError:  # a datagram with a wrong checksum
                    continue
                now = time.monotonic()
                if data and self._is_heard(sender, now):
                    self._heard_s = now
                    return data
                if now >= end:
                    break
        return b""

    def _is_heard(self, sender: tuple[object, ...], now_s: float) -> bool:
        self._sender_changed = False
        if sender == self._sender:
            return True
        if self._sender is None or now_s - self._heard_s > GIVES_WAY_S:
            self._sender_changed = self._sender is not None
            self._sender, self.remark = sender, ""
            return True
        # of many, only the first is reported
        self.remark = self.remark or (
            f"{sender[0]}:{sender[1]} sends to {self.address} as well and is left out: give each "
            "device a port of its own"
        )
        return False

    def stream_changed(self) -> bool:
        """See `Link.stream_changed`: another sender is heard."""
        return self._sender_changed

    def write(self, data: bytes, timeout: float) -> int:
        """Raise `LinkError`."""
        raise LinkError(f"{self.address} only hears: take TCP for a device that is asked")


def listening_socket(host: str, port: int, what: str) -> socket.socket:
    """Open a TCP port; calls of the socket do not wait.

    Parameters
    ----------
    what : str
        What the port is for, for the message; the address follows.

    Raises
    ------
    LinkError
        If it cannot be listened on.
    """
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        server = socket.create_server(found[4][:2], family=found[0])
    except OSError as error:
        raise LinkError(
            f"cannot {what}{bracketed(host)}:{port}: {error.strerror}: name an address of this "
            "machine, and a port that is free (0: any)"
        ) from error
    server.setblocking(False)
    return server


def address_of(kind: str, sock: socket.socket) -> str:
    """Return the own address of a socket, in the form of a link's address."""
    host, port = sock.getsockname()[:2]
    return f"{kind}://{bracketed(host)}:{port}"


def bracketed(host: str) -> str:
    """Put an IPv6 address into brackets, to separate its colons from that of the port."""
    return f"[{host}]" if ":" in host else host


# Opening of links by their addresses.


def open_link(address: str, *, baud: int = 115_200, flow_control: bool = False) -> Link:
    """Open the host's end of a link; only UDP listens.

    Parameters
    ----------
    address : str
        ``/dev/ttyACM0`` or another address of pyserial, such as ``hwgrep://37c5:1206`` for the
        port of a device wherever it is, ``tcp://HOST:PORT``, ``udp://[HOST]:PORT`` (bound to
        loopback unless a host is named), ``-`` for standard input, or a file of raw bytes.
    baud : int
        Of a serial port.
    flow_control : bool
        Use RTS and CTS.

    Raises
    ------
    LinkError
        If it cannot be opened.
    """
    if address == "-":
        return DescriptorLink("standard input", os.dup(sys.stdin.fileno()), live=False)
    if address.startswith("tcp://"):
        host, port = host_port(address)
        try:
            return TcpLink(address, socket.create_connection((host, port), timeout=5))
        except (ConnectionError, TimeoutError) as error:
            raise LinkAbsent(f"{address}: {error}: check that the other side is there") from error
        except OSError as error:
            raise _link_error(address, error) from error
    if address.startswith("udp://"):
        return UdpHostLink(*host_port(address))
    path = Path(address)
    if path.is_file():
        try:
            return DescriptorLink(address, os.open(path, os.O_RDONLY), live=False)
        except OSError as error:
            raise LinkError(
                f"cannot read {address}: {error.strerror}: check its permissions"
            ) from error
    return open_serial(address, baud, flow_control=flow_control)


def host_port(address: str) -> tuple[str, int]:
    """Return the host of an address, this machine if it names none, and the port."""
    host, colon, port = address.split("://", 1)[1].rpartition(":")
    if not (colon and port.isdigit() and int(port) < 65_536):
        raise UsageError(
            f"address {address!r} names no port: write for example tcp://127.0.0.1:5000"
        )
    return host.strip("[]") or "127.0.0.1", int(port)


# The reader of a link has a bounded buffer for bytes that its caller is late to take, and opens a
# link that is lost again.
#
# A caller that is in time reads the link itself, so that no thread has to be woken between bytes
# and their match. A thread of the reader checks every `_HELP_S` whether the caller is late, and
# then reads in its place until the caller is back. Until then the system buffers the bytes: 64 KiB
# for a serial line, which are 54 ms at 12 Mbaud.


#: Size of the buffer: 0.9 s of a line of 12 Mbaud.
BUFFER_BYTES = 1 << 20
#: When bytes have waited for this time, they and all later waiting bytes are dropped.
MAX_LAG_S = 0.5
_WAIT_S = 0.1
#: A caller that has not come back for this time is late.
_HELP_S = 0.02
#: Interval at which the system's count of errors is read.
_LOOK_S = 0.25
_FIRST_RETRY_S, _LAST_RETRY_S = 0.25, 1.0


class Chunk(NamedTuple):
    """Bytes that arrived together."""

    data: bytes
    at_s: float  #: When, on the host's monotonic clock.
    lost: int = 0  #: Bytes dropped right before these, because the reader was late.
    reopened: bool = False  #: Whether the link was lost and opened again before these.


class LinkReader:
    """Reads a link for one caller; while the caller is late, a thread reads.

    Parameters
    ----------
    open_link : callable
        Opens the link, at first and again.
    address : str
        Of the link, where it is absent at first.
    setup, teardown : bytes
        What to send when it opens and before it closes.
    retry : bool
        Open a live link again when it is lost, and wait for one that is absent at first; else, and
        for files and pipes, that is the end.
    drop : bool or None
        When the buffer is full or its oldest bytes have waited for `max_lag_s`, drop all of it, so
        that no bytes are missing within what follows; else let the link wait. None: drop if live.
    buffer_bytes : int
        Most bytes that wait for the caller.
    max_lag_s : float
        Longest time in seconds that bytes wait for the caller.

    Attributes
    ----------
    error : Exception or None
        Why it ended, if that was no ordinary end.
    line_errors : int
        Characters that the system says the line damaged or dropped.
    lost_link : str
        Why the link is closed right now, until it is open again; else empty.
    """

    def __init__(
        self,
        open_link: Callable[[], Link],
        *,
        address: str = "",
        setup: bytes = b"",
        teardown: bytes = b"",
        retry: bool = False,
        drop: bool | None = None,
        buffer_bytes: int = BUFFER_BYTES,
        max_lag_s: float = MAX_LAG_S,
    ) -> None:
        self._open, self._setup, self._teardown = open_link, setup, teardown
        self._retry, self._drop = retry, drop
        self._most, self._max_lag_s = buffer_bytes, max_lag_s
        self._chunks: deque[Chunk] = deque()
        self._held, self._ended = 0, False
        self._changed = threading.Condition()
        self._stopping = threading.Event()
        self.error: Exception | None = None
        self.line_errors = 0
        self.lost_link = ""
        # held while sending and while closing, so that nothing is sent to a closed link
        self._send_lock = threading.Lock()
        # whether the caller reads; changed only under the lock that is held for reading
        self._caller_reads, self._read_lock = False, threading.Lock()
        self._caller_waits = False  # whether the caller waits, and could read itself
        self._left_s = time.monotonic()  # time at which the caller left with bytes
        self._failure: Exception | None = None  # error while reading
        self._reopened = False  # whether the link was reopened before the next bytes
        self._wake = threading.Event()  # set to end a pause of the thread
        self._errors_before = 0  # line errors of the links before this one
        self._lost_s = math.inf  # time at which the link was lost, while it is
        self._dead_s = 0.0
        try:
            self._link = open_link()  # an error of the first opening is raised to the caller
        except LinkAbsent as error:
            if not retry:
                raise
            self._link = AbsentLink(address, str(error))
            self.lost_link, self._lost_s = str(error), time.monotonic()
        self.address = self._link.address
        self._thread = threading.Thread(target=self._run, name="edge-vpr reader", daemon=True)
        self._thread.start()

    def take(self, timeout: float) -> Chunk | None:
        """Return all waiting bytes, or None if none arrive within `timeout` seconds.

        A late host gets fewer and longer pieces, and so catches up with the link.
        """
        end = time.monotonic() + timeout
        self._left_s = math.inf
        chunk, left = None, timeout
        while chunk is None and left >= 0 and not self._ended:
            # first the reader, then the waiting bytes: the thread has stored all that it read
            if self._caller_reads and not self._chunks:
                chunk = self._read_directly(min(left, _WAIT_S))
            else:
                chunk = self._read_by_thread(left)
            left = end - time.monotonic()
        if chunk is None:
            chunk = self._read_by_thread(0)
        self._left_s = time.monotonic()
        return chunk

    def _read_directly(self, timeout: float) -> Chunk | None:
        with self._read_lock:
            if not self._caller_reads or self._chunks:
                return None
            try:
                data = self._link.read(timeout)
                return self._chunk(self._link, data) if data else None
            except Exception as error:
                # the thread has to open the link again, or has to end
                self._failure, self._caller_reads = error, False
                self._wake.set()
                return None

    def _read_by_thread(self, timeout: float) -> Chunk | None:
        with self._changed:
            if not self._chunks and not self._ended and timeout > 0:
                self._caller_waits = True
                self._changed.wait(timeout)
                self._caller_waits = False
            if not self._chunks:
                return None
            first = self._chunks.popleft()
            parts = [first.data]
            # a loss is reported before the bytes that follow it
            while self._chunks and not (self._chunks[0].lost or self._chunks[0].reopened):
                parts.append(self._chunks.popleft().data)
            data = b"".join(parts)
            self._held -= len(data)
            self._changed.notify_all()
            return first._replace(data=data)

    def send(self, data: bytes, timeout: float = 1.0) -> None:
        """Send to the device from any thread, if the link is open; other bytes are lost.

        Parameters
        ----------
        timeout : float
            Seconds to wait for a line that takes no more bytes.
        """
        if data:
            with self._send_lock, contextlib.suppress(LinkError):
                self._send(self._link, data, timeout)

    @property
    def dead_s(self) -> float:
        """Seconds for which the link was lost, in all so far."""
        lost_s = self._lost_s
        return self._dead_s + max(0.0, time.monotonic() - lost_s)

    @property
    def remark(self) -> str:
        """Message to the user about the present state of the link; empty if there is none."""
        return self._link.remark

    @property
    def live(self) -> bool:
        """Whether the other side goes on without waiting for the host."""
        return self._link.live

    @property
    def ended(self) -> bool:
        """Whether the link has ended for good."""
        with self._changed:
            return self._ended and not self._chunks

    def stop(self) -> None:
        """Stop reading and close the link; returns within about a second."""
        self._stopping.set()
        self._wake.set()
        with self._changed:
            self._changed.notify_all()
        self._thread.join(timeout=2)

    def _run(self) -> None:
        link = self._link
        try:
            while not self._stopping.is_set():
                try:
                    self._send(link, self._setup)
                    self._read(link)
                except LinkError as error:
                    self._close(link)
                    if not (self._retry and link.live):
                        # the end of a link is no error; anything else is reported
                        self.error = None if isinstance(error, LinkClosed) else error
                        return
                    self.lost_link = str(error)
                    self._lost_s = min(self._lost_s, time.monotonic())
                again = self._reopen()
                if again is None:
                    return
                with self._send_lock:
                    self._link = again
                self._reopened = not isinstance(link, AbsentLink)
                self._dead_s, self._lost_s = self.dead_s, math.inf
                link, self.lost_link = again, ""
        except Exception as error:
            # an error in the thread would go unnoticed: pass it to the caller
            self.error = error
        finally:
            self._dead_s, self._lost_s = self.dead_s, math.inf
            with self._read_lock:  # the caller is not reading the closed link
                self._caller_reads = False
            with contextlib.suppress(LinkError):
                self._send(link, self._teardown)
            self._close(link)
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _read(self, link: Link) -> None:
        drop = link.live if self._drop is None else self._drop
        self._errors_before, look = self.line_errors, 0.0
        while not self._stopping.is_set():
            if time.monotonic() >= look:
                look = time.monotonic() + _LOOK_S
                self._look_at_errors(link)
            if self._caller_reads:
                self._watch_caller()
                continue
            data = link.read(_WAIT_S)
            if data:
                self._put(self._chunk(link, data), drop)
            if self._caller_waits:
                self._wake.clear()
                self._caller_reads = True
                with self._changed:
                    self._changed.notify_all()

    def _chunk(self, link: Link, data: bytes) -> Chunk:
        reopened, self._reopened = self._reopened or link.stream_changed(), False
        return Chunk(data, time.monotonic(), 0, reopened)

    def _watch_caller(self) -> None:
        """Pause; then read in the place of a late caller, and raise an error that it found."""
        self._wake.wait(_HELP_S)
        late = time.monotonic() - self._left_s > _HELP_S
        if late and self._read_lock.acquire(blocking=False):
            self._caller_reads = False
            self._read_lock.release()
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure

    def _put(self, piece: Chunk, drop: bool) -> None:
        with self._changed:
            while not drop and self._held and self._held + len(piece.data) > self._most:
                if self._stopping.is_set():
                    return
                self._changed.wait(_WAIT_S)
            if drop and self._chunks:
                oldest = self._chunks[0]
                full = self._held + len(piece.data) > self._most
                if full or piece.at_s - oldest.at_s > self._max_lag_s:
                    piece = piece._replace(
                        lost=self._held + sum(each.lost for each in self._chunks),
                        reopened=piece.reopened or any(each.reopened for each in self._chunks),
                    )
                    self._chunks.clear()
                    self._held = 0
            self._chunks.append(piece)
            self._held += len(piece.data)
            self._changed.notify_all()

    def _reopen(self) -> Link | None:
        wait = _FIRST_RETRY_S
        while not self._stopping.wait(wait):
            try:
                return self._open()
            except LinkError:
                wait = min(2 * wait, _LAST_RETRY_S)
        return None

    def _look_at_errors(self, link: Link) -> None:
        # a port that was disconnected counts none
        self.line_errors = max(self.line_errors, self._errors_before + link.line_errors())

    def _close(self, link: Link) -> None:
        self._look_at_errors(link)
        with self._send_lock:
            link.close()

    @staticmethod
    def _send(link: Link, data: bytes, timeout: float = 1.0) -> None:
        end = time.monotonic() + timeout
        while data:
            try:
                data = data[link.write(data, min(0.1, timeout)) :]
            except LinkClosed:
                raise
            except LinkError:
                return  # a link that cannot be written to, such as a file
            if time.monotonic() >= end:
                return
