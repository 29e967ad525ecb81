"""Where bytes come from and go to: serial lines, TCP, UDP, pipes, files, and a virtual line."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import sys
import termios
import time
import tty
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from edge_vpr.errors import EdgeVprError, UsageError

READ_BYTES = 1 << 16
# Linux's struct serial_icounter_struct: cts, dsr, rng, dcd, rx, tx, frame, overrun, parity, brk,
# buf_overrun, and nine that are spare
_COUNTERS = struct.Struct("20i")


class LinkError(EdgeVprError):
    """A link cannot be opened, or broke."""


class LinkClosed(LinkError):  # noqa: N818, an end is no error of its own
    """The other side has ended, or the file has."""


class Link(ABC):
    """One line to a device (or, for a bridge, to a host).

    Attributes
    ----------
    address : str
    live : bool
        Whether the other side goes on without waiting for us, so that a late reader must drop.
    """

    live = True

    def __init__(self, address: str) -> None:
        self.address = address

    @abstractmethod
    def read(self, timeout: float) -> bytes:
        """Return what has come, after at most `timeout` seconds; empty if nothing did.

        Raises
        ------
        LinkClosed, LinkError
        """

    @abstractmethod
    def write(self, data: bytes, timeout: float) -> int:
        """Send what can be sent within `timeout` seconds; return how many bytes that is."""

    @abstractmethod
    def close(self) -> None:
        """Close; again is harmless."""

    def line_errors(self) -> int:
        """Characters that the system says the line damaged or dropped since it was opened."""
        return 0

    def drain(self, timeout: float) -> None:  # noqa: B027, most links need none
        """Wait until the other side has taken what was sent."""


class DescriptorLink(Link):
    """A link over one file descriptor, not blocking."""

    def __init__(self, address: str, descriptor: int, *, live: bool = True) -> None:
        super().__init__(address)
        self.live = live
        self._fd = descriptor
        os.set_blocking(descriptor, False)

    def read(self, timeout: float) -> bytes:
        """See `Link.read`."""
        with _as_link_error(self.address):
            if not select.select([self._fd], [], [], timeout)[0]:
                return b""
            try:
                data = os.read(self._fd, READ_BYTES)
            except BlockingIOError:
                return b""
        if not data:
            raise LinkClosed(f"{self.address} has ended")
        return data

    def write(self, data: bytes, timeout: float) -> int:
        """See `Link.write`."""
        with _as_link_error(self.address):
            if not select.select([], [self._fd], [], timeout)[1]:
                return 0
            try:
                return os.write(self._fd, data)
            except BlockingIOError:
                return 0

    def close(self) -> None:
        """See `Link.close`."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class VirtualLink(DescriptorLink):
    """The device's end of a pseudo-terminal; `address` is what a host opens."""

    def __init__(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        super().__init__(os.ttyname(slave), master)
        # held open, so that a host may come and go
        self._slave = slave

    def drain(self, timeout: float) -> None:
        """Wait until the host has read all: closing a terminal throws away what it has not."""
        import fcntl

        end, quiet = time.monotonic() + timeout, 0
        while time.monotonic() < end and quiet < 3:
            waiting = fcntl.ioctl(self._slave, termios.FIONREAD, b"\0\0\0\0")
            quiet = 0 if any(waiting) else quiet + 1
            time.sleep(0.02)

    def close(self) -> None:
        """See `Link.close`."""
        if self._fd >= 0:
            os.close(self._slave)
        super().close()


class SocketLink(DescriptorLink):
    """A TCP connection, or a bound UDP socket."""

    def __init__(self, address: str, sock: socket.socket) -> None:
        self._socket = sock
        super().__init__(address, sock.fileno())

    def close(self) -> None:
        """See `Link.close`."""
        self._socket.close()
        self._fd = -1


class TcpServerLink(Link):
    """A bridge's TCP port: one host at a time, and the next when it has gone."""

    def __init__(self, host: str, port: int) -> None:
        with _as_link_error(f"tcp://{host}:{port}"):
            self._server = socket.create_server((host, port))
        self._server.setblocking(False)
        found = self._server.getsockname()
        super().__init__(f"tcp://{found[0]}:{found[1]}")
        self._host: SocketLink | None = None

    def accepted(self, timeout: float) -> bool:
        """Tell whether a host is there, after at most `timeout` seconds."""
        if self._host is None and select.select([self._server], [], [], timeout)[0]:
            self._host = SocketLink(self.address, self._server.accept()[0])
        return self._host is not None

    def read(self, timeout: float) -> bytes:
        """See `Link.read`."""
        if not self.accepted(timeout):
            return b""
        assert self._host is not None
        return self._host.read(timeout)

    def write(self, data: bytes, timeout: float) -> int:
        """See `Link.write`."""
        if not self.accepted(timeout):
            return 0
        assert self._host is not None
        return self._host.write(data, timeout)

    def close(self) -> None:
        """See `Link.close`."""
        if self._host is not None:
            self._host.close()
        self._server.close()


class UdpSenderLink(DescriptorLink):
    """A bridge's UDP sender."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((host, port))
        super().__init__(f"udp://{host}:{port}", self._socket.fileno())

    def write(self, data: bytes, timeout: float) -> int:
        """Send one datagram; see `Link.write`."""
        return super().write(data[:1_400], timeout)

    def close(self) -> None:
        """See `Link.close`."""
        self._socket.close()
        self._fd = -1


class SerialLink(DescriptorLink):
    """A serial port that is set up by pyserial, and read without it.

    pyserial sets the port up anew for each change of the time-out, and waits for one byte where
    thousands come together.
    """

    def __init__(self, address: str, port: Any) -> None:
        super().__init__(address, port.fileno())
        self._port = port
        self._errors_before = 0
        self._errors_before = self.line_errors()

    def line_errors(self) -> int:
        """See `Link.line_errors`; 0 as well where the port's driver does not count."""
        import fcntl

        try:
            raw = fcntl.ioctl(self._fd, termios.TIOCGICOUNT, bytes(_COUNTERS.size))
        except (OSError, ValueError, AttributeError):
            return 0
        *_, framing, overrun, parity, _, buffer_overrun = _COUNTERS.unpack(raw)[:11]
        return int(framing + overrun + parity + buffer_overrun) - self._errors_before

    def read(self, timeout: float) -> bytes:
        """See `Link.read`; a port that fails is one whose cable was pulled."""
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
    """An address of pyserial's that is no file of the system's, such as ``rfc2217://``."""

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
                # TypeError: pyserial's port that another thread has closed
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


def _open_serial(address: str, baud: int, *, flow_control: bool) -> Link:
    """Open a serial port, or any other address of pyserial's ``serial_for_url``."""
    import io

    import serial

    try:
        port = serial.serial_for_url(
            address, baudrate=baud, timeout=0, write_timeout=1, rtscts=flow_control
        )
    except (serial.SerialException, OSError, ValueError) as error:
        raise LinkError(f"cannot open {address}: {error}: check cable and permissions") from error
    try:
        port.fileno()
    except (AttributeError, io.UnsupportedOperation, OSError):
        return UrlLink(address, port)
    return SerialLink(address, port)


def open_link(address: str, *, baud: int = 115_200, flow_control: bool = False) -> Link:
    """Open a host's end of a link; nothing listens, but for UDP.

    Parameters
    ----------
    address : str
        ``/dev/ttyACM0`` or another address of pyserial, ``tcp://HOST:PORT``,
        ``udp://[HOST]:PORT`` (bound to loopback unless a host is named), ``-`` for standard input,
        or a file of raw bytes.
    baud : int
        Of a serial port.
    flow_control : bool
        Use RTS and CTS.

    Raises
    ------
    LinkError
        If it cannot be opened.
    UsageError
        If the address makes no sense.
    """
    if address == "-":
        return DescriptorLink("standard input", os.dup(sys.stdin.fileno()), live=False)
    if address.startswith("tcp://"):
        with _as_link_error(address):
            return SocketLink(address, socket.create_connection(_host_port(address), timeout=5))
    if address.startswith("udp://"):
        with _as_link_error(address):
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sock.bind(_host_port(address))
            return SocketLink("udp://{}:{}".format(*sock.getsockname()), sock)
    path = Path(address)
    if path.is_file():
        with _as_link_error(address):
            return DescriptorLink(address, os.open(path, os.O_RDONLY), live=False)
    return _open_serial(address, baud, flow_control=flow_control)


def open_device_link(address: str, *, baud: int = 115_200, flow_control: bool = False) -> Link:
    """Open a device's end, for a bridge.

    Parameters
    ----------
    address : str
        ``virtual`` for a pseudo-terminal, ``tcp://[HOST]:PORT`` to listen (port 0: any free one;
        loopback unless a host is named), ``udp://HOST:PORT`` to send to, or a serial port.
    baud, flow_control
        See `open_link`.
    """
    if address == "virtual":
        return VirtualLink()
    if address.startswith("tcp://"):
        return TcpServerLink(*_host_port(address))
    if address.startswith("udp://"):
        return UdpSenderLink(*_host_port(address))
    return _open_serial(address, baud, flow_control=flow_control)


def _host_port(address: str) -> tuple[str, int]:
    host, colon, port = address.split("://", 1)[1].rpartition(":")
    if not (colon and port.isdigit() and int(port) < 65_536):
        raise UsageError(
            f"address {address!r} names no port: write for example tcp://127.0.0.1:5000"
        )
    return host.strip("[]") or "127.0.0.1", int(port)


@contextlib.contextmanager
def _as_link_error(address: str) -> Any:
    try:
        yield
    except (OSError, ValueError) as error:
        # a closed descriptor is a ValueError to select
        kind = LinkClosed if isinstance(error, (ConnectionError, ValueError)) else LinkError
        raise kind(f"{address}: {error}: check that the other side is there") from error
