"""Interface of a link to a device or to a host, and its errors."""

from __future__ import annotations

import contextlib
import os
import select
from abc import ABC, abstractmethod
from collections.abc import Iterator

from edge_vpr.errors import EdgeVprError

READ_BYTES = 1 << 16


class LinkError(EdgeVprError):
    """A link cannot be opened, or has broken."""


class LinkClosed(LinkError):  # noqa: N818, an end is no error of its own
    """The other side has closed the link, or the file has ended."""


class Link(ABC):
    """A link to a device (or, for a bridge, to a host).

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
        """Return the bytes that have arrived, after at most `timeout` seconds; may be empty.

        Raises
        ------
        LinkClosed, LinkError
        """

    @abstractmethod
    def write(self, data: bytes, timeout: float) -> int:
        """Send as much as possible within `timeout` seconds; return the number of bytes sent."""

    @abstractmethod
    def close(self) -> None:
        """Close the link; may be called again."""

    def line_errors(self) -> int:
        """Return the number of characters that the system reports as damaged or dropped."""
        return 0

    def began_anew(self) -> bool:
        """Return whether another stream began with the bytes that were read last."""
        return False

    def drain(self, timeout: float) -> None:  # noqa: B027, most links need none
        """Wait until the other side has received what was sent."""


class DescriptorLink(Link):
    """Link over a file descriptor."""

    def __init__(self, address: str, descriptor: int, *, live: bool = True) -> None:
        super().__init__(address)
        self.live = live
        self._fd = descriptor
        # one buffer for all reads: allocating the largest size and truncating it would fragment
        # the memory
        self._room = memoryview(bytearray(READ_BYTES))
        if live:
            # standard input is shared (on a terminal even with the output), and is not changed
            os.set_blocking(descriptor, False)

    def read(self, timeout: float) -> bytes:
        """See `Link.read`."""
        try:
            if not select.select([self._fd], [], [], timeout)[0]:
                return b""
            size = os.readv(self._fd, [self._room])
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise link_error(self.address, error) from error
        if not size:
            raise LinkClosed(f"{self.address} has ended")
        return bytes(self._room[:size])

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
    """Convert errors of the system to `LinkError`."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise link_error(address, error) from error


def link_error(address: str, error: Exception) -> LinkError:
    """Return what an error of the system means for a link."""
    # select raises ValueError for a closed descriptor
    kind = LinkClosed if isinstance(error, (ConnectionError, ValueError)) else LinkError
    return kind(f"{address}: {error}: check that the other side is there")
