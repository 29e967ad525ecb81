"""Drive a route that a map knows, and stop at a goal: python rover.py PORT PROTOCOL MAP.npz GOAL_M.

The map has positions (edge-vpr map --track). `drive` is where the motors are.
"""

import sys
from collections.abc import Callable

from edge_vpr import LiveSession

FAST, SLOW = 1.0, 0.2  # m/s


def follow(port: str, protocol: str, map_path: str, goal_m: float, drive: Callable) -> float | None:
    """Return the metre of the goal, or None if the line ends before."""
    route = {"protocol": protocol, "reference": map_path, "heartbeat": "500ms"}
    try:
        with LiveSession(port, **route, reconnect=False) as session:
            if session.reference.route is None:
                sys.exit(f"{map_path} has no positions: make it with edge-vpr map --track")
            for match in session:  # a heartbeat has the probability 0
                confident = match.probability >= 0.5 and not match.incomplete
                drive(FAST if confident else SLOW)
                if confident and match.probability >= 0.8 and (match.along_m or 0.0) >= goal_m:
                    return match.along_m
    finally:
        drive(0.0)  # whatever happens
    return None


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    reached = follow(*sys.argv[1:4], float(sys.argv[4]), drive=lambda speed: print(f"{speed} m/s"))
    print("the line has ended" if reached is None else f"at {reached:.1f} m")
