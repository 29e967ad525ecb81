"""`edge-vpr bridge`: replay a recording over a line, like a camera."""

from __future__ import annotations

import argparse
import math

from edge_vpr.errors import UsageError, printable
from edge_vpr.stream.bridge import Bridge, LineFaults
from edge_vpr.stream.links import open_device_link
from edge_vpr.stream.protocols import open_encoder
from edge_vpr_tools.arguments.reading import open_from
from edge_vpr_tools.output.interrupt import stopped_by_signals


def run(args: argparse.Namespace) -> None:
    """Wait for a host and send everything."""
    if not 0 <= args.speed < math.inf:
        raise UsageError(f"speed {args.speed}: give 1 for real time, 2 for twice that, 0: no limit")
    faults = LineFaults.parse(args.faults)
    recording = open_from(args, args.recording)
    encoder = open_encoder(args.protocol, recording.sensor)
    link = open_device_link(args.port, baud=args.baud, flow_control=args.flow_control)
    try:
        bridge = Bridge(link, encoder, speed=args.speed, faults=faults, seed=args.seed)
        # a host recognises the options of a device, except its channel or its layout
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
