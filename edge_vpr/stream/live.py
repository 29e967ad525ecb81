"""Live matching: decoder, burst filter and localiser in one, from bytes to matches."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.bursts import BurstFilter
from edge_vpr.descriptors.causal_bursts import CausalBurstFilter
from edge_vpr.descriptors.counters import select_events
from edge_vpr.errors import MapError
from edge_vpr.events import Events, join_events, make_events
from edge_vpr.online.followed import FEW
from edge_vpr.online.localiser import MATCH_DTYPE, Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.stream.protocols.protocol import Decoder, synthetic_events

#: A step of the clock is a jump if it is longer than this time and than this number of ticks.
JUMP_US = 1_000_000
MOST_TICKS = 10_000
_NEVER_US = 1 << 62
_NO_MATCHES = np.empty(0, dtype=MATCH_DTYPE)


class LiveResult(NamedTuple):
    """Events and matches of one chunk of bytes.

    Attributes
    ----------
    events : ndarray of EVENT_DTYPE, shape (n,)
        As decoded.
    matches : ndarray of MATCH_DTYPE, shape (m,)
    incomplete : bool
        Whether events are known to be missing from the windows of these matches.
    reached_us : int
        Time up to which the stream is known; with a delay, matches are of earlier windows.
    """

    events: Events
    matches: npt.NDArray[np.void]
    incomplete: bool
    reached_us: int = 0


class LiveLocaliser:
    """Decodes a stream of bytes, and matches its events with a map.

    Parameters
    ----------
    decoder : Decoder
    reference : ReferenceMap, optional
        Without one, events are decoded and nothing is matched.
    every : MatchSchedule, optional
        When to give a match.
    causal_bursts : bool
        Remove bursts, if the map's settings ask for it, without waiting for their end: a match
        comes 2 ms earlier, and is no longer to the bit that of the recording.
    odometry : bool
        Whether readings of an odometer are to come.

    Raises
    ------
    MapError
        If the map is of another sensor.
    UsageError
        If readings of an odometer are to come and matching with the map takes none.
    """

    def __init__(
        self,
        decoder: Decoder,
        reference: ReferenceMap | None = None,
        every: MatchSchedule | None = None,
        *,
        causal_bursts: bool = False,
        odometry: bool = False,
    ) -> None:
        self.decoder = decoder
        self._localiser: Localiser | None = None
        self._bursts: BurstFilter | CausalBurstFilter | None = None
        self._losses = 0
        self._since = 0  # number of events at the selected pixels since the newest loss
        self._whole_us = -1  # first time after the newest loss
        self._reached = self._events = 0  # time and events of the decoder, after the newest piece
        self._time = 0  # time that the localiser has reached
        if reference is not None:
            sensor = reference.pixel_map.sensor
            if sensor != decoder.sensor:
                raise MapError(
                    f"the stream is of a {decoder.sensor} sensor and the map of a {sensor} one: "
                    "use the map of this camera"
                )
            self._table = reference.pixel_map.table()
            burst_filter = CausalBurstFilter if causal_bursts else BurstFilter
            _rehearse(reference, every, burst_filter(sensor), odometry)
            self._localiser = Localiser(reference, every=every)
            self._settings = self._localiser.settings
            # longest time that is matched in one step
            self._most_us = MOST_TICKS * self._localiser.every.interval_us or _NEVER_US
            if reference.settings.remove_bursts:
                self._bursts = burst_filter(sensor)

    @property
    def bursts_removed(self) -> int:
        """Events removed as bursts."""
        return 0 if self._bursts is None else self._bursts.removed

    def feed(
        self, data: bytes, host_us: int, *, lost: int = 0, reopened: bool = False
    ) -> LiveResult:
        """Decode and match the next bytes.

        Parameters
        ----------
        data : bytes
        host_us : int
            When they came.
        lost : int
            Bytes that the host dropped before them.
        reopened : bool
            Whether the link was lost before them.
        """
        events = []
        if lost or reopened:
            events.append(self.decoder.gap(lost))
            self.decoder.health.reopened += reopened
        events.append(self.decoder.feed(data, host_us))
        return self._follow(join_events(events))

    def read_odometer(self, distance_m: float) -> int:
        """Take a reading of the robot's odometer, at the time that the stream has reached.

        Parameters
        ----------
        distance_m : float
            See `Localiser.read_odometer`.

        Returns
        -------
        int
            That time, in microseconds.
        """
        if self._localiser is None:
            return self.decoder.reached_us
        # all matches due until then have been given
        self._localiser.read_odometer(self._time, distance_m)
        return self._time

    def finish(self) -> LiveResult:
        """End the stream, and return the matches of what was held."""
        found = self._follow(self.decoder.finish(), last=True)
        if self._localiser is None:
            return found
        late = self._localiser.finish()
        return found._replace(matches=np.concatenate([found.matches, late]))

    @property
    def filled(self) -> float:
        """Share of the first sequence that is complete, 0 to 1; there are matches from 1 on."""
        return 0.0 if self._localiser is None else self._localiser.filled

    def _follow(self, events: Events, *, last: bool = False) -> LiveResult:
        localiser = self._localiser
        if localiser is None:
            return LiveResult(events, _NO_MATCHES, False)
        reached, before_us = self.decoder.reached_us, self._time
        matches: list[npt.NDArray[np.void]] = []
        pieces = self._cleaned(events, reached, last)
        for piece in pieces:
            self._update(localiser, piece, matches)
        known = reached if self._bursts is None else min(reached, self._bursts.known_us)
        if known > self._time:
            # held events are later than this; the device may have reported that nothing happened
            self._near(localiser, known, matches)
            if localiser.every.interval_us and localiser.next_match_us <= known:
                # without a tick, the windows age with the next event
                matches.append(localiser.advance(known))
            self._time = known
        some = [each for each in matches if each.size]
        found = np.concatenate(some) if len(some) > 1 else (some or [_NO_MATCHES])[0]
        return LiveResult(events, found, self._incomplete(pieces, before_us, reached), reached)

    def _update(
        self, localiser: Localiser, events: Events, matches: list[npt.NDArray[np.void]]
    ) -> None:
        """Match events in parts that each span less than `MOST_TICKS`."""
        while events.size:
            taken, last = events.size, int(events["t"][-1])
            if last - self._time > self._most_us:
                self._near(localiser, int(events["t"][0]), matches)
                taken = int(np.searchsorted(events["t"], self._time + self._most_us, "right"))
                last = int(events["t"][taken - 1])
            matches.append(localiser.update(events if taken == events.size else events[:taken]))
            self._time = last
            events = events[taken:]

    def _near(
        self, localiser: Localiser, time_us: int, matches: list[npt.NDArray[np.void]]
    ) -> None:
        """Advance the time until `time_us` is less than `MOST_TICKS` ahead.

        Each tick gives a match. In a jump, however, only the last tick does, so that no clock and
        no silence can stop the run; the jump is counted.
        """
        if time_us - self._time > max(self._most_us, JUMP_US):
            self.decoder.health.clock_jumps += 1
            localiser.skip_ticks(time_us)
            self._time = time_us
        while time_us - self._time > self._most_us:
            self._time += self._most_us
            matches.append(localiser.advance(self._time))

    def _cleaned(self, events: Events, reached_us: int, last: bool) -> list[Events]:
        if self._bursts is None:
            return [events]
        return [
            *self._bursts.pieces(events),
            self._bursts.finish() if last else self._bursts.advance(reached_us),
        ]

    def _incomplete(self, pieces: list[Events], before_us: int, now: int) -> bool:
        """Return whether there was a loss within the windows that are compared.

        The flag can stay one piece too long, but is never removed too early. It is decided for the
        first match of these pieces, which is not earlier than `before_us`, the time of the
        localiser before them.
        """
        health = self.decoder.health
        losses = health.losses
        if losses != self._losses:
            self._losses, self._since, self._whole_us = losses, 0, -1
        moved, self._reached = now > self._reached or health.events > self._events, now
        self._events = health.events
        if self._losses == 0:
            return False
        whole_us, since = self._whole_us, self._since
        if whole_us < 0 and moved:
            self._whole_us = now
        if 0 <= whole_us <= before_us:
            self._since += sum(self._selected(piece) for piece in pieces if piece.size)
        settings = self._settings
        windows = settings.windows_per_match + settings.late
        if settings.window == "time":
            return whole_us < 0 or before_us - whole_us < windows * settings.tau_us
        return since < windows * settings.events_per_window

    def _selected(self, events: Events) -> int:
        """Count the events at the selected pixels."""
        if self._settings.window == "time" or self._localiser is None:
            return 0
        p = events["p"] if self._settings.polarity else None
        return int(select_events(self._table, events["x"], events["y"], p)[0].size)


def _rehearse(
    reference: ReferenceMap,
    every: MatchSchedule | None,
    bursts: BurstFilter | CausalBurstFilter,
    odometry: bool,
) -> None:
    """Compile the kernels of matching before the first bytes arrive; this takes up to seconds."""
    # if there are more than a few, the last part is processed by columns
    events = synthetic_events(2 * FEW)
    localiser = Localiser(reference, every=every)
    # for Numba an array of one event has another layout: contiguous, and aligned or not
    for some in (events[:1], events[1:2], events[2:]):
        bursts.update(some)
        localiser.update(some)
    # the end of a window that is no pause runs code of its own, and the second needs the first
    settings, last_us = reference.settings, int(events["t"][-1])
    n = int(reference.places.activity.max())
    if settings.window == "count":
        n = max(n, settings.events_per_window)
    pixel = reference.pixel_map
    x, y = np.repeat(pixel.x[:1], n), np.repeat(pixel.y[:1], n)
    for _ in range(3 if odometry else 2):  # a distance is known after two readings
        localiser.update(make_events(np.full(n, last_us), x, y))
        if odometry:
            localiser.read_odometer(last_us, 0.0)
        last_us += settings.tau_us
        localiser.advance(last_us)
    localiser.finish()
