"""From the last byte of a frame on a line to its match, as a robot's program sees it.

``python tools/bench/byte_to_match.py`` plays a device on a pseudo-terminal, and takes the time from
the write of a frame to the match that the frame gives: in a program that iterates over a
`LiveSession`, and in a program that reads the output of `edge-vpr stream`. All of them sleep in
between, as a robot's do. Before that it takes the time of the call of `StreamMatcher.feed` alone,
for frames that follow at once and after a sleep. The map keeps bursts: their removal waits for the
next 2 to 4 ms of events.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt
from soak import a_map

from edge_vpr.events import Events, Sensor, make_events
from edge_vpr.live.bridge import Bridge, VirtualLink
from edge_vpr.live.protocols import open_decoder, open_encoder
from edge_vpr.live.stream_matcher import StreamMatcher
from edge_vpr.online.schedule import MatchSchedule

SENSOR = Sensor(346, 260)
#: Time of a frame, and frames between two matches.
FRAME_US, FRAMES = 1_000, 5
#: Matches before the clock runs: the first windows, and what a program does once.
WARM = 100


def frames(rng: np.random.Generator, rate: float, number: int) -> list[Events]:
    """Make frames of events at random pixels, the first event of each at its start."""
    made = []
    for i in range(FRAMES * number):
        n = 1 + rng.poisson(rate * FRAME_US / 1e6)
        flat = rng.integers(0, SENSOR.pixels, n)
        times = i * FRAME_US + np.sort(rng.integers(0, FRAME_US, n))
        times[0] = i * FRAME_US
        made.append(make_events(times, flat % SENSOR.width, flat // SENSOR.width))
    return made


def byte_to_match(rate: float, number: int, *, in_program: bool) -> npt.NDArray[np.float64]:
    """Measure match by match.

    Parameters
    ----------
    rate : float
        Events a second.
    number : int
        Matches to measure.
    in_program : bool
        To the match in the program that reads the line; else to the line of `edge-vpr stream` in
        the program that reads its output.

    Returns
    -------
    ndarray of float64, shape (number,)
        Microseconds from before the write.
    """
    rng = np.random.default_rng(0)
    link, encoder = VirtualLink(), open_encoder("evpr", SENSOR)
    start = encoder.start()
    sent = [encoder.encode(events) for events in frames(rng, rate, WARM + number)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.npz"
        a_map(rng, SENSOR, remove_bursts=False).save(path)
        every_us = FRAMES * FRAME_US
        if in_program:
            program = str(Path(__file__).with_name("robot_program.py"))
            words = [program, link.address, str(path), str(every_us)]
        else:
            words = ["-m", "edge_vpr_tools.cli", "stream", "--port", link.address]
            words += ["--map", str(path), "--protocol", "evpr", "--json"]
            words += ["--every", f"{every_us}us"]
        with subprocess.Popen(
            [sys.executable, *words], stdout=subprocess.PIPE, bufsize=0
        ) as process:
            Bridge(link, encoder).wait_for_host()
            try:
                return _played(link, start, sent, process)
            finally:
                process.terminate()
                process.wait(timeout=30)
                link.close()


def _played(
    link: VirtualLink, start: bytes, sent: list[bytes], process: subprocess.Popen[bytes]
) -> npt.NDArray[np.float64]:
    assert process.stdout is not None
    out = process.stdout.fileno()
    line = link.fileno()
    os.set_blocking(line, True)
    os.write(line, start)
    poll = select.poll()
    poll.register(out, select.POLLIN)
    read_s: dict[int, float] = {}
    rest, begun_s = b"", time.monotonic()
    written = np.empty(len(sent))
    for number, frame in enumerate([*sent, b""]):
        due = begun_s + (number if frame else number + 200) * FRAME_US / 1e6
        while (wait := due - time.monotonic()) > 0:
            if poll.poll(1e3 * wait):
                data, now = os.read(out, 1 << 16), time.perf_counter()
                *whole, rest = (rest + data).split(b"\n")
                for row in map(json.loads, whole):
                    time_us = round(1e6 * row.get("time_s", -1))
                    read_s.setdefault(time_us, row.get("at_s", now))
        left = memoryview(frame)
        if frame:
            written[number] = time.perf_counter()
        while left:
            left = left[os.write(line, left) :]
    timed = range(WARM * FRAMES, len(sent) - FRAMES, FRAMES)
    return np.array([1e6 * (read_s[n * FRAME_US] - written[n]) for n in timed])


def feed(rate: float, number: int, *, pause_us: float = 0.0) -> npt.NDArray[np.float64]:
    """Measure the processor's work for a frame, in this process.

    Parameters
    ----------
    pause_us : float
        Sleep before each frame, in which other work uses the caches.

    Returns
    -------
    ndarray of float64, shape (FRAMES * number,)
        Microseconds.
    """
    rng, encoder = np.random.default_rng(0), open_encoder("evpr", SENSOR)
    schedule = MatchSchedule(interval_us=FRAMES * FRAME_US)
    reference = a_map(rng, SENSOR, remove_bursts=False)
    live = StreamMatcher(open_decoder("evpr", SENSOR), reference, schedule)
    live.feed(encoder.start(), 0)
    sent = [encoder.encode(events) for events in frames(rng, rate, WARM + number)]
    taken = np.empty(len(sent))
    for i, frame in enumerate(sent):
        if pause_us:
            time.sleep(pause_us / 1e6)
        start = time.perf_counter()
        live.feed(frame, i)
        taken[i] = 1e6 * (time.perf_counter() - start)
    return taken[FRAMES * WARM :]


#: Sends back what comes: the least that a program between a line and a pipe can do.
_ECHO = """
import os, select, sys, termios
line = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
settings = termios.tcgetattr(line)
settings[4:6] = [termios.B115200] * 2  # so that the other side sees that it is open
termios.tcsetattr(line, termios.TCSANOW, settings)
while True:
    select.select([line], [], [])
    os.write(1, os.read(line, 4096))
"""


def echo(number: int) -> npt.NDArray[np.float64]:
    """Measure what a pseudo-terminal, a pipe and the system take, without any work in between.

    Returns
    -------
    ndarray of float64, shape (number,)
        Microseconds.
    """
    link, taken = VirtualLink(), np.empty(number)
    line = link.fileno()
    command = [sys.executable, "-c", _ECHO, link.address]
    with subprocess.Popen(command, stdout=subprocess.PIPE, bufsize=0) as process:
        assert process.stdout is not None
        while not link.opened():
            time.sleep(0.01)
        for i in range(number):
            time.sleep(FRAMES * FRAME_US / 1e6)
            start = time.perf_counter()
            os.write(line, b"x")
            os.read(process.stdout.fileno(), 1)
            taken[i] = 1e6 * (time.perf_counter() - start)
        process.kill()
    link.close()
    return taken


def tell(what: str, taken: npt.NDArray[np.float64]) -> None:
    """Print a row."""
    half, most = np.percentile(taken, [50, 99])
    print(
        f"{what}: {half:,.0f} us median, {most:,.0f} us for 99 %, {taken.max():,.0f} us at most, "
        f"of {taken.size:,}",
        flush=True,
    )


def main() -> None:
    """Print a row of the table for each rate."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--matches", type=int, default=1_000)
    parser.add_argument("--rates", type=float, nargs="+", default=[2_000, 20_000, 100_000])
    args = parser.parse_args()
    tell("an echo of the bytes", echo(args.matches))
    for rate in args.rates:
        for pause_us in (0, FRAME_US):
            taken = feed(rate, args.matches, pause_us=pause_us)
            after = f"after {pause_us:,} us of sleep" if pause_us else "at once"
            tell(f"{rate:,.0f} events/s, a call of `feed` {after}", taken)
        for in_program in (True, False):
            taken = byte_to_match(rate, args.matches, in_program=in_program)
            where = "the program that reads the line" if in_program else "the reader of `stream`"
            tell(f"{rate:,.0f} events/s, in {where}", taken)


if __name__ == "__main__":
    main()
