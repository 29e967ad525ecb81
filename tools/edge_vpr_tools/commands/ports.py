"""`edge-vpr ports`: list the serial ports, and what is attached to them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

from edge_vpr.errors import printable
from edge_vpr_tools.console import summary

EXAMPLES = """\
  edge-vpr ports
  edge-vpr ports --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    output = parser.add_argument_group("output")
    output.add_argument("--json", action="store_true", help="print JSON, for programs")


LINKS = "/dev/serial"  # where udev has names that stay


class AttachedPort(NamedTuple):
    """Serial port of this machine."""

    port: str  #: Path of the port.
    always: str | None  #: Path that is the same whenever this device is plugged in here.
    description: str  #: What the attached device says of itself.
    usb: str | None  #: Numbers of vendor and product, for example ``0403:6014``.


def attached_ports() -> list[AttachedPort]:
    """Return the serial ports of this machine, sorted by name."""
    from serial.tools import list_ports

    return [
        AttachedPort(
            port=port.device,
            always=lasting_name(port.device),
            description=port.description,
            usb=None if port.vid is None else f"{port.vid:04x}:{port.pid:04x}",
        )
        for port in sorted(list_ports.comports())
    ]


def lasting_name(port: str) -> str | None:
    """Return the name that udev gives a port by its maker and serial number, or by its socket."""
    for folder in ("by-id", "by-path"):
        for link in sorted(Path(LINKS, folder).glob("*")):
            if link.resolve() == Path(port).resolve():
                return str(link)
    return None


def run(args: argparse.Namespace) -> None:
    """List the ports."""
    from edge_vpr.records import json_text

    attached = attached_ports()
    if args.json:
        print(json_text(attached, indent=2))
        return
    for one in attached:
        # the name comes from the device and can contain anything
        name, what = printable(one.port), printable(one.description, 80)
        summary(f"{name}  {one.usb or '-'}  {what}")
        if one.always is not None:
            summary(f"    always {printable(one.always)}")
    if not attached:
        summary("no serial ports; edge-vpr bridge RECORDING makes a virtual one")
