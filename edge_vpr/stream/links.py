"""Links by address: serial lines, TCP, UDP, pipes, files, and a virtual line."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.stream.link import DescriptorLink, Link, LinkError, as_link_error
from edge_vpr.stream.network_links import TcpLink, TcpServerLink, UdpHostLink, UdpSenderLink
from edge_vpr.stream.serial_links import VirtualLink, open_serial


def open_link(address: str, *, baud: int = 115_200, flow_control: bool = False) -> Link:
    """Open the host's end of a link; only UDP listens.

    Parameters
    ----------
    address : str
        ``/dev/ttyACM0`` or another address of pyserial, ``tcp://HOST:PORT``, ``udp://[HOST]:PORT``
        (bound to loopback unless a host is named), ``-`` for standard input, or a file of raw
        bytes.
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
        with as_link_error(address):
            return TcpLink(address, socket.create_connection(_host_port(address), timeout=5))
    if address.startswith("udp://"):
        return UdpHostLink(*_host_port(address))
    path = Path(address)
    if path.is_file():
        try:
            return DescriptorLink(address, os.open(path, os.O_RDONLY), live=False)
        except OSError as error:
            raise LinkError(
                f"cannot read {address}: {error.strerror}: check its permissions"
            ) from error
    return open_serial(address, baud, flow_control=flow_control)


def open_device_link(address: str, *, baud: int = 115_200, flow_control: bool = False) -> Link:
    """Open the device's end of a link, for a bridge.

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
    return open_serial(address, baud, flow_control=flow_control)


def _host_port(address: str) -> tuple[str, int]:
    host, colon, port = address.split("://", 1)[1].rpartition(":")
    if not (colon and port.isdigit() and int(port) < 65_536):
        raise UsageError(
            f"address {address!r} names no port: write for example tcp://127.0.0.1:5000"
        )
    return host.strip("[]") or "127.0.0.1", int(port)
