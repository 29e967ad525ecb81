"""Links over serial ports, and over a pseudo-terminal that imitates one."""

from __future__ import annotations

import contextlib
import errno
import os
import struct
import termios
import time
import tty
from typing import Any

from edge_vpr.stream.link import READ_BYTES, DescriptorLink, Link, LinkClosed, LinkError

# Linux's struct serial_icounter_struct: cts, dsr, rng, dcd, rx, tx, frame, overrun, parity, brk,
# buf_overrun, and nine that are spare
_COUNTERS = struct.Struct("20i")


class VirtualLink(DescriptorLink):
    """The device's end of a pseudo-terminal; a host opens its `address`."""

    def __init__(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        super().__init__(os.ttyname(slave), master)
        # held open, so that a host can connect and disconnect
        self._slave = slave
        self._as_made = termios.tcgetattr(slave)

    def opened(self) -> bool:
        """Return whether a host has configured the terminal, as hosts do with a serial port."""
        return termios.tcgetattr(self._slave) != self._as_made

    def drain(self, timeout: float) -> None:
        """Wait until the host has read everything, because closing a terminal discards the rest."""
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
        import fcntl

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
    import io

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
    except (serial.SerialException, OSError, ValueError, termios.error) as error:
        raise LinkError(f"cannot open {address or 'no port'}: {_why(error)}") from error
    try:
        port.fileno()
    except (AttributeError, io.UnsupportedOperation, OSError):
        return UrlLink(address, port)
    return SerialLink(address, port)


def _why(error: Exception) -> str:
    """Return what is wrong with a port, and what to do."""
    number = getattr(error, "errno", None)
    if number == errno.ENOENT:
        return "there is no such file or port: `edge-vpr ports` lists those that are attached"
    if number in (errno.EACCES, errno.EPERM):
        return "permission denied: join the group that owns it, often dialout"
    if number in (errno.EAGAIN, errno.EBUSY):
        return "another program has it: end that one first"
    return f"{error}: check that it is a serial port, its cable and its permissions"
