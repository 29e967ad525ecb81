"""`edge-vpr ports`: list serial ports and their probable protocols."""

from __future__ import annotations

import argparse
import json

from edge_vpr.errors import printable
from edge_vpr_tools.device.serial_ports import attached_ports
from edge_vpr_tools.output.json_records import to_json


def run(args: argparse.Namespace) -> None:
    """List the ports."""
    found = attached_ports()
    if args.json:
        print(json.dumps(to_json(found), indent=2))
        return
    for one in found:
        how = f"--protocol {one.protocol}" if one.protocol else "-"
        how += f" --baud {one.baud}" if one.baud else ""
        # the name comes from the device and can contain anything
        name, what = printable(one.port), printable(one.description, 80)
        print(f"{name}  {one.usb or '-'}  {what}  {how}")
    if not found:
        print("no serial ports; edge-vpr bridge RECORDING makes a virtual one")
