"""Matches after time in which nothing was seen: are accepted ones right, and how soon do they come.

``python tools/bench/gaps.py > docs/results/gaps.csv`` plays simulated drives over each line, with
gaps. Each match is judged at its own time, which is its age before it came; as in a session, one
that is older than two windows is not accepted. Nothing is played in real time, so that each run
gives the same table.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.events import Events, join_events
from edge_vpr.live.protocols import open_decoder, open_encoder
from edge_vpr.live.stream_matcher import StreamMatcher
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import QUERY, SimulatedRecording, simulate_pair

#: What is read at once, as from a serial port.
PIECE_US = 20_000
#: When the gaps begin: every so often, after a while in which the robot is found.
FIRST_S, EVERY_S = 20.0, 20.0
#: An accepted match that is farther off is wrong.
RIGHT_M = 10.0
PRECISION = 0.99
EVERY = MatchSchedule(interval_us=50_000)
#: The protocol of each line, and of the n-th start of its device.
LINES = {
    "evpr": ("evpr", "evpr:boot={}"), "EVT 3": ("evt3", "evt3"),
    "eDVS": ("edvs:format=E3", "edvs:format=E3"),
}  # fmt: skip
LOSSES = ("restart of the camera", "black-out of the line", "bytes dropped by the host")


class Gap(NamedTuple):
    """A part of a drive that does not arrive."""

    begin_us: int
    end_us: int


class Came(NamedTuple):
    """Matches, each with its time by the clock of the host."""

    at_us: npt.NDArray[np.int64]
    along_m: npt.NDArray[np.float64]
    accepted: npt.NDArray[np.bool_]


def gaps_of(duration_us: int, length_s: float) -> list[Gap]:
    """Return gaps of this length, of which those of 0 s take nothing."""
    begins = np.arange(FIRST_S, duration_us / 1e6 - EVERY_S / 2, EVERY_S).tolist()
    return [Gap(int(1e6 * begin), int(1e6 * (begin + length_s))) for begin in begins]


def played(reference: ReferenceMap, events: Events, gaps: list[Gap], line: str, loss: str) -> Came:
    """Play a drive over a line; its matches come with the pieces of bytes that give them."""
    device, again = LINES[line]
    decoder = open_decoder(device, reference.pixel_map.sensor)
    decoder.live = True
    live, encoder = StreamMatcher(decoder, reference, EVERY), open_encoder(device, decoder.sensor)
    rows = []
    begun_us = dropped = starts = 0
    begins = np.arange(0, int(events.t[-1]), PIECE_US)
    cuts = np.searchsorted(events.t, begins[1:])
    parts = (events[a:b] for a, b in pairwise([0, *cuts.tolist(), len(events)]))
    for begin_us, part in zip(begins.tolist(), parts, strict=True):
        host_us, piece = begin_us + PIECE_US, part.copy()
        piece.t -= begun_us
        data = encoder.encode(piece) or encoder.idle(host_us - begun_us)
        if any(gap.begin_us <= begin_us < gap.end_us for gap in gaps):
            dropped += len(data)
            if loss == LOSSES[0]:  # its clock begins anew with the next piece
                starts, begun_us = starts + 1, host_us
                encoder = open_encoder(again.format(starts), decoder.sensor)
            continue
        by_host = dropped if loss == LOSSES[2] else 0
        dropped, result = 0, live.feed(data, host_us, dropped=by_host)
        for match in result.matches:
            age_us = live.decoder.reached_us - match.time_us
            accepted = not match.lost and age_us <= 2 * reference.settings.tau_us
            rows.append((host_us - age_us, match.along_m, accepted))
    return Came(*(np.array(column) for column in zip(*rows, strict=True)))


def recorded(reference: ReferenceMap, events: Events, gaps: list[Gap]) -> Came:
    """Match a recording of the drive, of whose windows each is judged at its middle."""
    kept = np.ones(events.size, dtype=np.bool_)
    for gap in gaps:
        kept &= (events.t < gap.begin_us) | (events.t >= gap.end_us)
    matches = reference.match(events[kept]).matches
    assert reference.route is not None
    return Came(matches.time_us, reference.route.along_m[matches.place], ~matches.lost)


def judged(
    came: Came, drive: SimulatedRecording, gaps: list[Gap]
) -> tuple[int, int, int, list[float]]:
    """Return how many matches came, were accepted and were right, and the seconds after gaps."""
    true_m = np.interp(came.at_us, drive.track.time_us, drive.track.position[:, 0])
    off_m = np.abs(came.along_m - true_m)
    good = off_m <= RIGHT_M
    waits = []
    for gap in gaps:
        later = came.at_us[(came.at_us > gap.end_us) & came.accepted]
        waits.append(float(later[0] - gap.end_us) / 1e6 if later.size else np.inf)
    return came.accepted.size, int(came.accepted.sum()), int((good & came.accepted).sum()), waits


def rows(pairs: list[tuple[ReferenceMap, Events, SimulatedRecording]]) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    cases = [(line, loss) for line in LINES for loss in LOSSES]
    cases += [("recording", "cut out"), ("smoothed recording", "cut out")]
    for (line, loss), length_s in ((case, s) for case in cases for s in (0, 0.2, 0.5, 1, 2, 4)):
        if not length_s and loss not in (LOSSES[0], "cut out"):
            continue
        matches = accepted = right = 0
        waits: list[float] = []
        for reference, events, drive in pairs:
            gaps = gaps_of(int(events.t[-1]), length_s)
            if line in LINES:
                came = played(reference, events, gaps, line, loss)
            else:
                smooth = replace(reference.settings, smooth=line != "recording")
                came = recorded(reference.matched_with(smooth), events, gaps)
            n, taken, good, waited = judged(came, drive, gaps)
            matches, accepted, right = matches + n, accepted + taken, right + good
            waits += waited
        yield [
            line, loss if length_s else "none", f"{length_s:g}", f"{accepted / matches:.3f}",
            f"{right / max(accepted, 1):.4f}",
            f"{np.median(waits):.1f}",
        ]  # fmt: skip


def main() -> None:
    """Print the table as CSV."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="drives (default: 2)")
    parser.add_argument("--length", type=float, default=500, help="metres of each (default: 500)")
    args = parser.parse_args()
    pairs = []
    for seed in range(args.seeds):
        # every second robot stands now and then, also in gaps
        query = replace(QUERY, stops=6 * (seed % 2), stop_s=10.0)
        first, second = simulate_pair(seed, length_m=args.length, query=query)
        reference = ReferenceMap.build(first, track=first.track)
        settings = replace(reference.settings, precision=PRECISION, smooth=False)
        pairs.append((reference.matched_with(settings), join_events(list(second)), second))
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(
        ["line", "gap", "length [s]", "accepted", f"right of these within {RIGHT_M:g} m",
         "seconds until the next accepted (median)"]
    )  # fmt: skip
    for row in rows(pairs):
        table.writerow(row)
        sys.stdout.flush()


if __name__ == "__main__":
    main()
