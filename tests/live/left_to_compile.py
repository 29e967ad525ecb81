"""Program: print what a live session compiles after it has opened its link, which must be nothing.

It has to run in a process of its own, in which nothing else has compiled a kernel. The first word
is "cold", and sessions rehearse, or "warm", and they load what the cold run has noted under the
second word. The others are protocols.
"""

from __future__ import annotations

import gc
import socket
import sys

import numpy as np
from numba.core.dispatcher import Dispatcher

from edge_vpr import LiveSession
from edge_vpr.events import Sensor, make_events
from edge_vpr.live import session as live_session
from edge_vpr.live.protocols import open_encoder
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from tests.streams import Drive, random_events

SENSOR = Sensor(64, 48)


def compiled():
    """Every kernel of this process, with the types that it is compiled for."""
    kernels = [each for each in gc.get_objects() if isinstance(each, Dispatcher)]
    return {(k.py_func.__module__, k.__name__, str(s)) for k in kernels for s in k.signatures}


class Camera:
    """The other end of a socket."""

    def __init__(self, protocol, session, line):
        self.encoder, self._session, self._line = open_encoder(protocol, SENSOR), session, line
        line.setblocking(False)

    def send(self, data):
        """Send in pieces, each of which is matched at once."""
        for at in range(0, len(data), 4_000):
            self._line.setblocking(True)
            self._line.sendall(data[at : at + 4_000])
            self._line.setblocking(False)
            self._session.poll()

    def play(self, events, lost=0):
        """Send events, some bytes of which are lost."""
        data = self.encoder.encode(events)
        self.send(data[: len(data) // 2] + data[len(data) // 2 + lost :])


def main():
    """Run a session of each kind of matching and protocol."""
    state, run, *protocols = sys.argv[1:]
    have, rehearsed = live_session.have_kernels, []

    def have_kernels(work, drive):
        have(f"{work} of {run}", lambda: rehearsed.append(work) or drive())

    live_session.have_kernels = have_kernels
    rng, sessions = np.random.default_rng(0), 0
    drive = random_events(rng, 60_000, SENSOR, 3_000_000)
    small = {"pixels": 20, "sigma": 1.0, "tau": "100ms"}
    for preset, changes in (
        ("paper", {}), ("paper", {"window": "count", "events_per_pixel": 1.0}),
        ("default", {}), ("default", {"places_per_window": 1}),
    ):  # fmt: skip
        settings = PRESETS[preset].replaced(small | changes, "the test")
        reference = ReferenceMap.build(Drive(drive, SENSOR), settings)
        for protocol in protocols:
            near, far = socket.socketpair()
            session = LiveSession(far, protocol=protocol, reference=reference)
            with near, far, session:
                before = compiled()
                camera = Camera(protocol, session, near)
                camera.send(camera.encoder.start())
                for i in range(20):
                    part = random_events(rng, 500, SENSOR, 25_000)
                    part.t += i * 25_000
                    camera.play(part, lost=int(i % 4 == 3))
                for i in range(20):  # events that come one by one are arrays of another kind
                    camera.play(make_events([600_000 + i], [1], [1]))
                near.close()
                assert all(match.place >= 0 for match in session)
            late = compiled() - before
            assert session.health.events > 5_000, (protocol, session.health)
            assert not late, (preset, changes, protocol, late)
            sessions += 1
    assert len(rehearsed) == (sessions if state == "cold" else 0)


if __name__ == "__main__":
    main()
