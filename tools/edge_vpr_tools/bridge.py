"""`edge-vpr bridge`: a recording goes out as if a camera sent it."""

from __future__ import annotations

import argparse
import math

from edge_vpr_tools.reading import add_reading_arguments

HELP = "replay a recording over a line, as a camera would send it"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recording", metavar="RECORDING", help="what the camera saw")
    parser.add_argument(
        "--port", default="virtual",
        help="virtual (a pseudo-terminal, whose name is printed), tcp://[HOST]:PORT to listen "
        "(loopback unless a host is named), udp://HOST:PORT, or a serial port",
    )  # fmt: skip
    parser.add_argument(
        "--protocol", default="evpr", metavar="P", help="evpr, edvs:format=E3, evt2, ..."
    )
    parser.add_argument("--baud", type=int, default=115_200, help="of a serial port")
    parser.add_argument("--flow-control", action="store_true", help="use RTS and CTS")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="times real time; 0: as fast as the line takes it"
    )
    parser.add_argument(
        "--faults", default="", metavar="LIST",
        help="drop=P, flip=P, insert=P (chance of each byte), garbage=BYTES, stall=SECONDS",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="of the faults")
    add_reading_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Wait for a host and send everything.

    Raises
    ------
    EdgeVprError
        If an argument is wrong or the recording cannot be read.
    """
    from edge_vpr.errors import UsageError, printable
    from edge_vpr.stream.bridge import Bridge, LineFaults
    from edge_vpr.stream.links import open_device_link
    from edge_vpr.stream.protocols import open_encoder
    from edge_vpr_tools.interrupt import stopped_by_signals
    from edge_vpr_tools.reading import open_from

    if not 0 <= args.speed < math.inf:
        raise UsageError(f"speed {args.speed}: give 1 for real time, 2 for twice that, 0: no limit")
    faults = LineFaults.parse(args.faults)
    recording = open_from(args, args.recording)
    encoder = open_encoder(args.protocol, recording.sensor)
    link = open_device_link(args.port, baud=args.baud, flow_control=args.flow_control)
    try:
        bridge = Bridge(link, encoder, speed=args.speed, faults=faults, seed=args.seed)
        # a host finds out the options of a device, but for its channel or its layout
        name = args.protocol.partition(":")[0]
        host = args.protocol if name in ("openmv", "aer") else name
        address = printable(link.address)
        print(f"{address} waits for a host: edge-vpr stream --port {address} "
              f"--protocol {printable(host)} --sensor {recording.sensor}", flush=True)  # fmt: skip
        with stopped_by_signals(bridge.stopping):
            bridge.run(recording)
    finally:
        link.close()
    dropped = f", dropped {bridge.dropped_events:,}" if bridge.dropped_events else ""
    print(f"sent {bridge.sent_events:,} events in {bridge.sent_bytes:,} bytes{dropped}")
