"""One line to a device, or to a host, and what can go wrong with it."""

from __future__ import annotations

import contextlib
import os
import select
from abc import ABC, abstractmethod
from collections.abc import Iterator

from edge_vpr.errors import EdgeVprError

READ_BYTES = 1 << 16


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
    two_way : bool
        Whether a host and a device hear each other, or only the host the device.
    remark : str
        What the user should know of the link now, if anything.
    """

    live = True
    two_way = True
    remark = ""

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

    def began_anew(self) -> bool:
        """Tell whether another stream began with the bytes that were read last."""
        return False

    def drain(self, timeout: float) -> None:  # noqa: B027, most links need none
        """Wait until the other side has taken what was sent."""


class DescriptorLink(Link):
    """A link over one file descriptor."""

    def __init__(self, address: str, descriptor: int, *, live: bool = True) -> None:
        super().__init__(address)
        self.live = live
        self._fd = descriptor
        # read into again and again: bytes made for the most that can come, and then cut short,
        # leave holes between those that other threads keep
        self._room = bytearray(READ_BYTES)
        if live:
            # standard input is shared, on a terminal even with the output: it stays as it is
            os.set_blocking(descriptor, False)

    def read(self, timeout: float) -> bytes:
        """See `Link.read`."""
        with as_link_error(self.address):
            if not select.select([self._fd], [], [], timeout)[0]:
                return b""
            try:
                size = os.readv(self._fd, [self._room])
            except BlockingIOError:
                return b""
        if not size:
            raise LinkClosed(f"{self.address} has ended")
        with memoryview(self._room) as room:
            return bytes(room[:size])

    def write(self, data: bytes, timeout: float) -> int:
        """See `Link.write`."""
        with as_link_error(self.address):
            if not select.select([], [self._fd], [], timeout)[1]:
                return 0
            try:
                return os.write(self._fd, data)
            except BlockingIOError:
                return 0

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
    """Turn the system's errors into ours."""
    try:
        yield
    except (OSError, ValueError) as error:
        # a closed descriptor is a ValueError to select
        kind = LinkClosed if isinstance(error, (ConnectionError, ValueError)) else LinkError
        raise kind(f"{address}: {error}: check that the other side is there") from error
