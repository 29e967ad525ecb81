"""Links over TCP and UDP."""

from __future__ import annotations

import select
import socket
import time

from edge_vpr.stream.link import READ_BYTES, DescriptorLink, Link, LinkError, as_link_error

# a peer that vanished without closing, for example without power, is noticed after 11 s
_KEEP_ALIVE = (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3))
#: Largest datagram, which fits into one Ethernet packet.
DATAGRAM_BYTES = 1_400
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
    could not be decoded, so that bytes of others are ignored meanwhile, and counted in `strangers`.
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
        self._anew = False
        self.strangers = 0

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
        self._anew = False
        if sender == self._sender:
            return True
        if self._sender is None or now_s - self._heard_s > GIVES_WAY_S:
            self._anew = self._sender is not None
            self._sender, self.remark = sender, ""
            return True
        self.strangers += 1
        # of many, only the first is reported
        self.remark = self.remark or (
            f"{sender[0]}:{sender[1]} sends to {self.address} as well and is left out: give each "
            "device a port of its own"
        )
        return False

    def began_anew(self) -> bool:
        """See `Link.began_anew`: another sender is heard."""
        return self._anew

    def write(self, data: bytes, timeout: float) -> int:
        """Raise `LinkError`."""
        raise LinkError(f"{self.address} only hears: take TCP for a device that is asked")


class TcpServerLink(Link):
    """TCP port of a bridge, for one host; others are refused."""

    def __init__(self, host: str, port: int) -> None:
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
            self._server = socket.create_server(found[4][:2], family=found[0])
        except OSError as error:
            raise LinkError(
                f"cannot listen on tcp://{bracketed(host)}:{port}: {error.strerror}: name an "
                "address of this machine, and a port that is free (0: any)"
            ) from error
        self._server.setblocking(False)
        super().__init__(address_of("tcp", self._server))
        self._host: TcpLink | None = None

    def accepted(self, timeout: float) -> TcpLink | None:
        """Return the link to the host once one is connected, after at most `timeout` seconds."""
        if self._host is None and select.select([self._server], [], [], timeout)[0]:
            self._host = TcpLink(self.address, self._server.accept()[0])
            self._server.close()
        return self._host

    def read(self, timeout: float) -> bytes:
        """See `Link.read`."""
        host = self.accepted(timeout)
        return host.read(timeout) if host else b""

    def write(self, data: bytes, timeout: float) -> int:
        """See `Link.write`."""
        host = self.accepted(timeout)
        return host.write(data, timeout) if host else 0

    def close(self) -> None:
        """See `Link.close`."""
        if self._host is not None:
            self._host.close()
        self._server.close()


class UdpSenderLink(SocketLink):
    """UDP sender of a bridge, which cannot know whether its datagrams arrive."""

    two_way = False

    def __init__(self, host: str, port: int) -> None:
        with as_link_error(f"udp://{host}:{port}"):
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            # not connected, because a missing receiver would then be an error
            sock = socket.socket(found[0], socket.SOCK_DGRAM)
        self._to = found[4]
        super().__init__(f"udp://{bracketed(host)}:{port}", sock)

    def read(self, timeout: float) -> bytes:
        """Wait."""
        time.sleep(timeout)
        return b""

    def write(self, data: bytes, timeout: float) -> int:
        """Send one datagram; see `Link.write`."""
        with as_link_error(self.address):
            if not select.select([], [self._fd], [], timeout)[1]:
                return 0
            try:
                return self._socket.sendto(data[:DATAGRAM_BYTES], self._to)
            except BlockingIOError:
                return 0


def address_of(kind: str, sock: socket.socket) -> str:
    """Return the own address of a socket, in the form of a link's address."""
    host, port = sock.getsockname()[:2]
    return f"{kind}://{bracketed(host)}:{port}"


def bracketed(host: str) -> str:
    """Put an IPv6 address into brackets, to separate its colons from that of the port."""
    return f"[{host}]" if ":" in host else host
