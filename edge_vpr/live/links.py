"""Links to a camera: serial lines, TCP, UDP, pipes and files."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import io
import os
import re
import select
import socket
import stat
import struct
import sys
import termios
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from edge_vpr.archive import archive_kind
from edge_vpr.errors import EdgeVprError, UsageError, expect, kind_of
from edge_vpr.recordings import FORMATS
from edge_vpr.reference_map import KIND as MAP_KIND
from edge_vpr.settings import duration_us

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
        with as_link_error(self.address):
            if not select.select([self._fd], [], [], timeout)[0]:
                return b""
            try:
                size = os.readv(self._fd, [self._buffer])
            except BlockingIOError:
                return b""
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
        # select raises ValueError for a closed descriptor
        kind = LinkClosed if isinstance(error, (ConnectionError, ValueError)) else LinkError
        raise kind(f"{address}: {error}: check that the other side is there") from error


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


def open_serial(address: str, baud: int, *, flow_control: bool) -> Link:
    """Open a serial port by its name, or by another address of pyserial, such as ``hwgrep://``."""
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
    except (AttributeError, io.UnsupportedOperation, OSError) as error:
        port.close()
        raise LinkError(
            f"{address} is no port of this machine: serve it by TCP there, for example by ser2net, "
            "and take tcp://HOST:PORT"
        ) from error
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

    def end(self) -> None:
        """Send no more; what the other side sends can still be read."""
        with as_link_error(self.address):
            self._socket.shutdown(socket.SHUT_WR)


class UdpHostLink(SocketLink):
    """A bound UDP socket, which receives from one sender at a time and cannot send.

    The first sender is received until it is silent for `GIVES_WAY_S`. Mixed bytes of two senders
    could not be decoded, so that bytes of others are ignored meanwhile.
    """

    two_way = False

    def __init__(self, host: str, port: int) -> None:
        with as_link_error(f"udp://{host}:{port}"):
            resolved = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            sock = socket.socket(resolved[0], socket.SOCK_DGRAM)
            sock.bind(resolved[4])
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
        raise LinkError(f"{self.address} only receives: use TCP for a device that expects bytes")


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
        resolved = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        server = socket.create_server(resolved[4][:2], family=resolved[0])
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
        except OSError as error:
            absent = isinstance(error, ConnectionError | TimeoutError)
            kind = LinkAbsent if absent else LinkError
            raise kind(f"{address}: {error}: check that the other side is there") from error
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


#: Suffixes of recordings that are never bytes of a camera, as .raw and .bin can be.
_OF_RECORDINGS = {suffix for each in FORMATS.values() for suffix in each.suffixes} - {".raw"}


def _is_recording(path: Path) -> bool:
    # a .raw without the header of Prophesee can be bytes of a camera
    if path.suffix == ".raw":
        with path.open("rb") as file:
            return file.read(2) == b"% "
    return path.suffix in _OF_RECORDINGS


@dataclass(frozen=True)
class Line:
    """A link to a camera, and how a live session reads it.

    Parameters
    ----------
    link : str, Path or object
        A serial port, ``tcp://HOST:PORT``, ``udp://:PORT``, ``-`` or a file of bytes, see
        `open_link`; or what is open already: a `Link`, a socket, a file, a descriptor, a port of
        pyserial. Open objects cannot be opened again.
    baud : int, optional
        Of a serial port; by default the protocol's.
    flow_control : bool
        Use the RTS and CTS wires.
    reconnect : bool
        Open a live link again when it is disconnected; else its end is the session's.
    on_overload : {"drop", "wait"}, optional
        See `LinkReader`; by default files and pipes wait.
    max_lag : str
        Bytes that have waited longer than this for a host that is too slow are dropped.
    """

    link: Any
    baud: int | None = None
    flow_control: bool = False
    reconnect: bool = True
    on_overload: Literal["drop", "wait"] | None = None
    max_lag: str = "500ms"

    def __post_init__(self) -> None:
        if self.on_overload not in (None, "drop", "wait"):
            raise UsageError(f"on_overload={self.on_overload!r}: expected 'drop', 'wait' or None")
        if self.baud is not None and self.baud < 1:
            raise UsageError(
                f"baud={self.baud}: expected the speed of a serial port, such as 921600"
            )
        expect(self.max_lag, str, "max_lag", "a text such as '500ms'")
        duration_us(self.max_lag)

    @property
    def drop(self) -> bool | None:
        """Whether waiting bytes are dropped; None: if the link is live."""
        return None if self.on_overload is None else self.on_overload == "drop"

    @property
    def max_lag_s(self) -> float:
        """`max_lag` in seconds."""
        return duration_us(self.max_lag) / 1e6


def link_opener(link: Any, baud: int, flow_control: bool) -> tuple[Callable[[], Link], bool]:
    """Return what opens a link, and whether it can be opened again.

    Parameters
    ----------
    link : str, Path or object
        An address, see `open_link`, or what is open already: a `Link`, a socket, a file, a
        descriptor, or a port of pyserial.
    """
    if isinstance(link, str | os.PathLike):
        address = os.fspath(link)
        if not isinstance(address, str):
            raise UsageError(f"link {address!r}: expected text, not bytes")
        if Path(address).is_file() and archive_kind(address) == MAP_KIND:
            raise UsageError(
                f"{address} is a map, and a live session reads the bytes of a camera: give the map "
                "as reference=, and the camera's port here"
            )
        if Path(address).is_file() and _is_recording(Path(address)):
            raise UsageError(
                f"{address} is a recording, and a live session reads the bytes of a camera: match "
                "it with edge-vpr match --online, or play it with edge-vpr bridge"
            )
        return lambda: open_link(address, baud=baud, flow_control=flow_control), True
    if isinstance(link, Link):
        return lambda: link, False
    if isinstance(link, socket.socket):
        return lambda: SocketLink(f"socket {link.fileno()}", link.dup()), False
    descriptor = link if type(link) is int else _descriptor_of(link)
    name = str(getattr(link, "name", f"descriptor {descriptor}"))
    if descriptor is not None:
        kind = os.fstat(descriptor).st_mode
        live = stat.S_ISCHR(kind) or stat.S_ISSOCK(kind)
        return lambda: DescriptorLink(name, os.dup(descriptor), live=live), False
    raise UsageError(
        f"link is {kind_of(link)}: expected a port such as '/dev/ttyACM0', tcp://HOST:PORT, a file "
        "(of bytes in memory, write one), or an open file, socket or serial port"
    )


def _descriptor_of(link: Any) -> int | None:
    try:
        return int(link.fileno())
    except (AttributeError, OSError, ValueError):
        return None
