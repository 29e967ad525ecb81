"""Drive a route that a map knows, and stop at a goal: python rover.py PORT PROTOCOL MAP.npz GOAL_M.

The map has positions (edge-vpr map --track or --odometry). `drive` is where the motors are.
"""

import sys
from collections.abc import Callable

from edge_vpr import LiveSession

FAST, SLOW, STOP = 1.0, 0.2, 0.0  # m/s
SURE, MOST_MISSING = 0.9, 0.25  # probability, and share of the events lost, of a match to rely on
REACH_M = 10.0  # from there on


def follow(port: str, protocol: str, map_path: str, goal_m: float, drive: Callable) -> float | None:
    """Return the metre at which the goal was reached, or None if the line ends before."""
    route = {"protocol": protocol, "reference": map_path, "heartbeat": "500ms"}
    path, until_m = None, 0.0  # of the last match to rely on: its path, and how far to trust it
    try:
        with LiveSession(port, **route, reconnect=False) as session:
            if session.reference.along_mm is None:
                sys.exit(f"{map_path} has no positions: make it with edge-vpr map --track")
            for match in session:
                if match.place < 0:  # a heartbeat: the camera is silent, and nothing is seen
                    drive(STOP)
                    continue
                confident = match.probability >= SURE and match.missing <= MOST_MISSING
                confident = confident and not match.lost  # which a match that comes late is
                if confident:
                    path, until_m = match.jumps, (match.along_m or 0.0) + REACH_M
                drive(FAST if confident else SLOW)
                # from a match to rely on, the position moves with the path until it jumps
                on_path = match.jumps == path and match.along_m is not None
                if on_path and goal_m <= match.along_m <= until_m:
                    return match.along_m
    finally:
        drive(STOP)  # whatever happens
    return None


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    reached = follow(*sys.argv[1:4], float(sys.argv[4]), drive=lambda speed: print(f"{speed} m/s"))
    print("the line has ended" if reached is None else f"at {reached:.1f} m")
