"""`edge-vpr ports`: what is attached, and which protocol fits."""

from __future__ import annotations

import argparse

HELP = "list serial ports, with a guess which protocol fits"

#: Vendor and product numbers of USB, product None for any; what it is; how to open it.
KNOWN = (
    (0x37C5, None, "OpenMV camera", "openmv", 921_600),
    (0x1209, 0xABD1, "OpenMV camera", "openmv", 921_600),
    (0x0403, 0x6010, "FTDI dual bridge, perhaps an eDVS", "edvs", 12_000_000),
    (0x0403, 0x6014, "FTDI bridge, perhaps an eDVS", "edvs", 12_000_000),
    (0x0403, 0x6001, "FTDI bridge, perhaps an eDVS", "edvs", 2_000_000),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("--json", action="store_true", help="for other programs")


def run(args: argparse.Namespace) -> None:
    """List the ports."""
    import json

    from serial.tools.list_ports import comports

    found = []
    for port in sorted(comports()):
        guess = next(
            (row for row in KNOWN if row[0] == port.vid and row[1] in (None, port.pid)), None
        )
        found.append(
            {
                "port": port.device,
                "description": guess[2] if guess else port.description,
                "usb": None if port.vid is None else f"{port.vid:04x}:{port.pid:04x}",
                "protocol": guess[3] if guess else None,
                "baud": guess[4] if guess else None,
            }
        )
    if args.json:
        print(json.dumps(found, indent=2))
        return
    for row in found:
        how = f"--protocol {row['protocol']} --baud {row['baud']}" if row["protocol"] else "-"
        print(f"{row['port']}  {row['usb'] or '-'}  {row['description']}  {how}")
    if not found:
        print("no serial ports; edge-vpr bridge RECORDING makes a virtual one")
