"""Some windows of a simulated drive, through the functions of a live session.

Afterwards all kernels are compiled that the session calls, before a camera could wait for them.
"""

from __future__ import annotations

import numpy as np

from edge_vpr.events import Events, Sensor, make_events
from edge_vpr.live.protocols import open_decoder, open_encoder
from edge_vpr.live.stream_matcher import StreamMatcher
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.state import CHUNK_EVENTS
from edge_vpr.reference_map import ReferenceMap

#: windows after the first match
_MORE_WINDOWS = 3
#: length of a window without a map
_WINDOW_US = 10_000


def rehearse(
    protocol: str,
    sensor: Sensor,
    reference: ReferenceMap | None,
    every: MatchSchedule | None,
    *,
    odometry: bool,
    state: bool,
) -> None:
    """Decode and match a drive of which some bytes are lost.

    Parameters
    ----------
    odometry : bool
        Whether readings of an odometer are to come.
    state : bool
        Whether the state is to be kept.
    """
    encoder = open_encoder(protocol, sensor)
    matcher = StreamMatcher(open_decoder(protocol, sensor), reference, every)
    matcher.feed(encoder.start(), 0)
    windows = _windows(reference)
    for number, events in enumerate(windows, 1):
        # a single event, and few events, are processed otherwise than many
        for piece in (events[:1], events[1:3], events[3:]):
            sent, now_us = encoder.encode(piece), int(piece.t[-1])
            middle = len(sent) // 2
            lost = int(number == len(windows))
            matcher.feed(sent[:middle] + sent[middle + lost :], now_us)
        if odometry:
            matcher.read_odometer(1_000 * number)
    matcher.feed(b"", now_us, dropped=1, reopened=True)
    matcher.finish()
    if state and reference is not None:
        arrays, values = matcher.to_state()
        Localiser(reference, every=every).resume(arrays, values["now_us"], values["floor_us"])


def _windows(reference: ReferenceMap | None) -> list[Events]:
    """Return the events of one window after another, in none of which the robot pauses."""
    windows, most, window_us = 1, 0, _WINDOW_US
    x = y = np.zeros(1, dtype=np.uint16)
    if reference is not None:
        settings, pixels = reference.settings, reference.pixel_map
        x, y, windows = pixels.x, pixels.y, settings.windows_per_match
        most = int(reference.places.selected_events.max())
        if settings.window == "time":
            window_us = settings.tau_us
        else:
            most = max(most, settings.events_per_window)
    drive = []
    for number in range(windows + _MORE_WINDOWS):
        n = max(most, 8) + 2 * CHUNK_EVENTS * (number % 2)
        t = number * window_us + np.arange(n) * window_us // n
        drive.append(make_events(t, np.resize(x, n), np.resize(y, n), np.arange(n) % 2))
    return drive
