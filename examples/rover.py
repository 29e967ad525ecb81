"""Drive a route that a map knows, and stop at a goal: python rover.py PORT PROTOCOL MAP.npz GOAL_M.

The map needs positions (edge-vpr map --track or --odometry). `drive` sets the speed of the motors.
"""

import sys
import time
from collections.abc import Callable

from edge_vpr import Line, LiveSession
from edge_vpr.errors import EdgeVprError

FAST, SLOW, STOP = 1.0, 0.2, 0.0  # m/s
PRECISION, MOST_MISSING = 0.99, 0.25  # of matches to rely on, and the share of events they miss
REACH_M = 10.0  # how far beyond such a match the goal may be
MOST_AGE_S = 1.0  # an older match stops the robot
BLIND_M = 30.0  # longest way between two matches to rely on


def follow(port: str, protocol: str, map_path: str, goal_m: float, drive: Callable) -> float | None:
    """Return the metre at which the goal was reached, or None if the line ends before.

    The program ends if the robot drives too far without knowing where it is.
    """
    route = {
        "protocol": protocol,
        "reference": map_path,
        "heartbeat": "500ms",
        "precision": PRECISION,
    }
    path, until_m = None, 0.0  # of the last match to rely on: its path, and how far it reaches
    speed, since_s, blind_m = STOP, time.monotonic(), 0.0  # blind_m: driven since that match
    try:
        with LiveSession(Line(port, reconnect=False), **route) as session:
            if session.reference.along_mm is None:
                sys.exit(f"{map_path} has no positions: make it with edge-vpr map --track")
            for match in session:
                now_s = time.monotonic()
                blind_m, since_s = blind_m + speed * (now_s - since_s), now_s
                # a heartbeat has no place: the camera is silent
                late = match.age_s > MOST_AGE_S  # an age that is not known is NaN
                seen = match.place >= 0 and not late
                confident = seen and not match.lost and match.missing <= MOST_MISSING
                if confident:
                    path, until_m = match.jumps, (match.along_m or 0.0) + REACH_M
                    blind_m = 0.0
                if blind_m > BLIND_M:
                    sys.exit(f"no match to rely on for {blind_m:.0f} m: this may not be the route")
                speed = FAST if confident else SLOW if seen else STOP
                drive(speed)
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
    try:
        goal_m = float(sys.argv[4])
        reached = follow(*sys.argv[1:4], goal_m, drive=lambda speed: print(f"{speed} m/s"))
    except (EdgeVprError, ValueError) as error:
        sys.exit(f"rover.py: {error}")
    print("the line has ended" if reached is None else f"at {reached:.1f} m")
