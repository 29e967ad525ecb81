"""The program of a robot: reads a line, and notes when each match is there.

``python tools/bench/robot_program.py PORT MAP.npz`` is what `byte_to_match.py` measures. When the
line is silent it prints a line of JSON for each match, with the time at which it had it.
"""

from __future__ import annotations

import json
import sys
import time

from edge_vpr import MatchSchedule, ReferenceMap
from edge_vpr.live.links import LinkReader, open_link
from edge_vpr.live.protocols import open_decoder
from edge_vpr.live.session import LiveLocaliser


def run(port: str, map_path: str, every_us: int, causal_bursts: bool) -> None:
    """Match what comes on the line until it is closed."""
    reference = ReferenceMap.load(map_path)
    decoder = open_decoder("evpr", reference.pixel_map.sensor)
    schedule = MatchSchedule(interval_us=every_us)
    live = LiveLocaliser(decoder, reference, schedule, causal_bursts=causal_bursts)
    reader = LinkReader(lambda: open_link(port, baud=decoder.baud), setup=decoder.setup())
    had: list[dict[str, float]] = []
    while not reader.ended:
        chunk = reader.take(timeout=0.05)
        if chunk is None:
            for row in had:
                print(json.dumps(row))
            sys.stdout.flush()
            had.clear()
            continue
        found = live.feed(chunk.data, int(chunk.at_s * 1e6), lost=chunk.lost)
        if found.matches.size:
            now = time.perf_counter()
            had += [{"time_s": match["time_us"] / 1e6, "at_s": now} for match in found.matches]


if __name__ == "__main__":
    run(sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4] == "causal")
