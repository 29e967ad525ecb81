"""Drive a route that a map knows, and stop at a goal: python rover.py PORT PROTOCOL MAP.npz GOAL_M.

The map has positions (edge-vpr map --track). `drive` is where the motors are.
"""

import sys
import time
from collections.abc import Callable

from edge_vpr import MatchSchedule, ReferenceMap
from edge_vpr.live.links import LinkReader, open_link
from edge_vpr.live.protocols import open_decoder
from edge_vpr.live.session import LiveLocaliser

FAST, SLOW, BLIND_S = 1.0, 0.2, 0.5  # m/s; after so long without a good match it is slow


def follow(port: str, protocol: str, map_path: str, goal_m: float, drive: Callable) -> float | None:
    """Return the metre of the goal, or None if the line ends before."""
    reference = ReferenceMap.load(map_path)
    decoder = open_decoder(protocol, reference.pixel_map.sensor)
    live = LiveLocaliser(decoder, reference, MatchSchedule(interval_us=50_000))
    reader = LinkReader(lambda: open_link(port, baud=decoder.baud), setup=decoder.setup())
    begin, sure_at = time.monotonic(), float("-inf")
    try:
        while not reader.ended:
            chunk, now = reader.take(timeout=0.05), time.monotonic()
            if chunk is not None:
                found = live.feed(chunk.data, int((chunk.at_s - begin) * 1e6), lost=chunk.lost)
                for match in [] if found.incomplete else found.matches:
                    along_m = reference.route.along_m[match["place"]]
                    if match["probability"] >= 0.8 and along_m >= goal_m:
                        return float(along_m)
                    sure_at = now if match["probability"] >= 0.5 else sure_at
            drive(FAST if now - sure_at < BLIND_S else SLOW)
    finally:
        drive(0.0)  # whatever happens
        reader.stop()
    return None


if __name__ == "__main__":
    reached = follow(*sys.argv[1:4], float(sys.argv[4]), drive=lambda speed: print(f"{speed} m/s"))
    print("the line has ended" if reached is None else f"at {reached:.1f} m")
