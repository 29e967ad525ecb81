"""`edge-vpr ports`: list serial ports and their probable protocols."""

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


# Serial ports, and the likely protocol of a USB device by its numbers.


LINKS = "/dev/serial"  # where udev has names that stay
_USB_IDS = "usb.ids"  # http://www.linux-usb.org/usb.ids, as in systemd's hwdb
_OPENMV = "github.com/openmv/openmv, boards/"


class Device(NamedTuple):
    """Meaning of a USB vendor's and product's numbers."""

    vendor: int
    product: int | None  #: None for any product.
    what: str
    protocol: str
    baud: int | None  #: None if the baud rate has no effect, or is the user's own choice.
    source: str  #: Document that assigns these numbers; that a camera uses the chip is a guess.


DEVICES = (
    Device(0x37C5, 0x1206, "OpenMV N6, which takes a GENX320; see examples/openmv", "evpr",
           921_600, f"{_OPENMV}OPENMV_N6/omv_boardconfig.mk"),
    Device(0x37C5, 0x16E3, "OpenMV AE3", "evpr", 921_600,
           f"{_OPENMV}OPENMV_AE3/omv_boardconfig.mk"),
    Device(0x37C5, None, "OpenMV camera", "evpr", 921_600, f"{_OPENMV}: every board's vendor"),
    Device(0x1209, 0xABD1, "OpenMV camera", "evpr", 921_600, _USB_IDS),
    # we found no document that states which of these chips an eDVS has; the first two support its
    # 12 Mbaud, the third only its older 2 Mbaud (FTDI's data sheets)
    Device(0x0403, 0x6010, "FTDI dual bridge, perhaps an eDVS", "edvs", 12_000_000, _USB_IDS),
    Device(0x0403, 0x6014, "FTDI bridge, perhaps an eDVS", "edvs", 12_000_000, _USB_IDS),
    Device(0x0403, 0x6001, "FTDI bridge, perhaps an eDVS", "edvs", 2_000_000, _USB_IDS),
    # boards that are often used for bridges
    Device(0x0483, 0x5740, "STM32 with USB, perhaps a bridge of your own", "evpr", None, _USB_IDS),
    Device(0x0483, 0x374B, "ST-LINK/V2.1 of an STM32 board", "evpr", None, _USB_IDS),
    Device(0x0483, 0x374E, "STLINK-V3 of an STM32 board", "evpr", None, _USB_IDS),
)  # fmt: skip


def guess(vendor: int | None, product: int | None) -> Device | None:
    """Return the entry for the numbers of a USB device, preferably of its exact product."""
    return next(
        (row for row in DEVICES if row.vendor == vendor and row.product in (None, product)),
        None,
    )


class AttachedPort(NamedTuple):
    """Serial port of this machine."""

    port: str  #: Path of the port.
    always: str | None  #: Path that is the same whenever this device is plugged in here.
    description: str  #: The attached device, by its numbers or by its own description.
    usb: str | None  #: Numbers of vendor and product, for example ``0403:6014``.
    protocol: str | None  #: Likely protocol.
    baud: int | None


def attached_ports() -> list[AttachedPort]:
    """Return the serial ports of this machine, sorted by name."""
    from serial.tools import list_ports

    attached = []
    for port in sorted(list_ports.comports()):
        camera = guess(port.vid, port.pid)
        attached.append(
            AttachedPort(
                port=port.device,
                always=lasting_name(port.device),
                description=camera.what if camera else port.description,
                usb=None if port.vid is None else f"{port.vid:04x}:{port.pid:04x}",
                protocol=camera.protocol if camera else None,
                baud=camera.baud if camera else None,
            )
        )
    return attached


def lasting_name(port: str) -> str | None:
    """Return the name that udev gives a port by its maker and serial number, or by its socket."""
    for folder in ("by-id", "by-path"):
        for link in sorted(Path(LINKS, folder).glob("*")):
            if link.resolve() == Path(port).resolve():
                return str(link)
    return None


def run(args: argparse.Namespace) -> None:
    """List the ports."""
    from edge_vpr.results import json_text

    attached = attached_ports()
    if args.json:
        print(json_text(attached, indent=2))
        return
    for one in attached:
        how = f"--protocol {one.protocol}" if one.protocol else "-"
        how += f" --baud {one.baud}" if one.baud else ""
        # the name comes from the device and can contain anything
        name, what = printable(one.port), printable(one.description, 80)
        summary(f"{name}  {one.usb or '-'}  {what}  {how}")
        if one.always is not None:
            summary(f"    always {printable(one.always)}")
    if not attached:
        summary("no serial ports; edge-vpr bridge RECORDING makes a virtual one")
