"""TCP and UDP."""

from __future__ import annotations

import select
import socket

from edge_vpr.stream.link import DescriptorLink, Link, as_link_error


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
        with as_link_error(f"tcp://{host}:{port}"):
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
