"""`edge-vpr bridge`: replay a recording over a line, like a camera."""

from __future__ import annotations

import argparse
import math
from contextlib import suppress

from edge_vpr.errors import UsageError, printable
from edge_vpr_tools.console import note, stopped_by_signals
from edge_vpr_tools.flags import add_protocol_flag, add_reading_arguments, open_from

EXAMPLES = """\
  edge-vpr bridge tuesday.raw
  edge-vpr bridge tuesday.raw --port tcp://:7000 --protocol evt3
  edge-vpr bridge tuesday.raw --faults drop=1e-4,stall=5@20"""

#: which is reported, if events are sent later than this
_BEHIND_S = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recording", metavar="RECORDING", help="recording to replay")
    line = parser.add_argument_group("line")
    line.add_argument(
        "--port", default="virtual",
        help="where to send: virtual (a new pseudo-terminal, whose name bridge prints), "
        "tcp://[HOST]:PORT (waits for a client; without HOST, for one on this machine), "
        "udp://HOST:PORT, or the name of a serial port",
    )  # fmt: skip
    add_protocol_flag(line, "protocol of the camera: evpr, edvs:format=E3, evt2, ...")
    line.add_argument(
        "--baud", type=int, default=115_200, metavar="N", help="bits per second of a serial port"
    )
    line.add_argument(
        "--flow-control", action="store_true", help="use the RTS and CTS wires of a serial port"
    )
    line.add_argument(
        "--speed", type=float, default=1.0, metavar="F",
        help="speed as a multiple of real time; 0: as fast as possible. Protocols without a "
        "checksum need 1: at other speeds, their clock looks damaged to the reader",
    )  # fmt: skip
    faults = parser.add_argument_group("faults")
    faults.add_argument(
        "--faults", default="", metavar="LIST",
        help="faults of the line to imitate: drop=P, flip=P, insert=P (probability per byte), "
        "garbage=BYTES, stall=SECONDS[@TIME] (a silence that begins at TIME, else at 1 s) "
        "(default: none)",
    )  # fmt: skip
    faults.add_argument("--seed", type=int, default=0, help="seed of random faults")
    add_reading_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Wait for a host and send everything."""
    from edge_vpr.live.bridge import Bridge, LineFaults, open_device_link
    from edge_vpr.live.protocols import open_encoder

    if not 0 <= args.speed < math.inf:
        raise UsageError(f"speed {args.speed}: give 1 for real time, 2 for twice that, 0: no limit")
    faults = LineFaults.parse(args.faults)
    recording = open_from(args, args.recording)
    encoder = open_encoder(args.protocol, recording.sensor)
    link = open_device_link(args.port, baud=args.baud, flow_control=args.flow_control)
    try:
        bridge = Bridge(link, encoder, speed=args.speed, faults=faults, seed=args.seed)
        host = args.protocol if encoder.host_needs_options else args.protocol.partition(":")[0]
        address = printable(link.address)
        print(f"{address} waits for a host: edge-vpr stream --port {address} "
              f"--protocol {printable(host)} --sensor {recording.sensor} --map MAP.npz "
              "--precision 0.99 (to make a map: --learn -o MAP.npz)", flush=True)  # fmt: skip
        # no file waits for an orderly end, so that a second signal is as good as the first
        with stopped_by_signals(bridge.stopping), suppress(KeyboardInterrupt):
            bridge.run(recording)
    finally:
        link.close()
    if bridge.behind_s > _BEHIND_S:
        note(
            f"the events were sent up to {bridge.behind_s:.1f} s late: the host, the line or this "
            "machine is too slow for them; a lower --speed is in time"
        )
    print(f"sent {bridge.sent_events:,} events in {bridge.sent_bytes:,} bytes")
