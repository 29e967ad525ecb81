"""The program of a robot: follows a line, and notes when each match is there.

``python tools/bench/robot_program.py PORT MAP.npz`` is what `byte_to_match.py` measures. When the
line is silent it prints a line of JSON for each match, with the time at which it had it.
"""

from __future__ import annotations

import json
import sys
import time

from edge_vpr import Line, LiveSession, MatchSchedule


def run(port: str, map_path: str, every_us: int) -> None:
    """Match what comes on the line until it is closed."""
    had: list[dict[str, float]] = []
    with LiveSession(
        Line(port, reconnect=False), protocol="evpr", reference=map_path,
        every=MatchSchedule(interval_us=every_us), heartbeat="50ms",
    ) as session:  # fmt: skip
        for match in session:
            if match.place >= 0:
                had.append({"time_s": match.time_s, "at_s": time.perf_counter()})
                continue
            for row in had:
                print(json.dumps(row))
            sys.stdout.flush()
            had.clear()


if __name__ == "__main__":
    run(sys.argv[1], sys.argv[2], int(sys.argv[3]))
