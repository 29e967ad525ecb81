"""Live matching: decoder, burst filter and localiser in one, from bytes to matches."""

from __future__ import annotations

import copy
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.cleaning import BurstFilter, CausalBurstFilter
from edge_vpr.errors import MapError
from edge_vpr.events import Events, Sensor, join_events, make_events
from edge_vpr.live.protocols.protocol import Decoder, synthetic_events
from edge_vpr.online.localiser import JUMP_US, MOST_TICKS, Follower, Localiser, Step
from edge_vpr.online.state import CHUNK_EVENTS, MATCH_DTYPE, MatchSchedule
from edge_vpr.reference_map import ReferenceMap

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
        self._follower: Follower | None = None  # unless the burst filter holds events
        self._losses = 0
        # number of events at the selected pixels, in all and since the newest loss
        self._selected = self._since = 0
        self._whole_us = -1  # first time after the newest loss
        self._reached = 0  # time of the decoder, after the newest piece
        self._time = 0  # time that the localiser has reached
        if reference is not None:
            sensor = reference.pixel_map.sensor
            if sensor != decoder.sensor:
                raise MapError(
                    f"the stream is of a {decoder.sensor} sensor and the map of a {sensor} one: "
                    "use the map of this camera"
                )
            burst_filter = CausalBurstFilter if causal_bursts else BurstFilter
            _warm_up(decoder, reference, every, burst_filter(sensor), odometry)
            self._localiser = Localiser(reference, every=every)
            self._settings = self._localiser.settings
            # longest time that is matched in one step
            self._most_us = MOST_TICKS * self._localiser.every.interval_us or _NEVER_US
            if not reference.settings.remove_bursts:
                self._bursts = CausalBurstFilter(Sensor(0, 0))
            else:
                self._bursts = burst_filter(sensor)
            if isinstance(self._bursts, CausalBurstFilter):
                self._follower = Follower(self._bursts, self._localiser)

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
        decoder, follower = self.decoder, self._follower
        if follower is not None and not (lost or reopened):
            return self._follow(*decoder.decode_and_follow(data, host_us, follower))
        early = []
        if lost or reopened:
            early.append(decoder.gap(lost))
            decoder.health.reopened += reopened
        return self._clean(join_events([*early, decoder.feed(data, host_us)]))

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
        found = self._clean(self.decoder.finish(), last=True)
        if self._localiser is None:
            return found
        late = self._localiser.finish()
        return found._replace(matches=np.concatenate([found.matches, late]))

    @property
    def filled(self) -> float:
        """Share of the first sequence that is complete, 0 to 1; there are matches from 1 on."""
        return 0.0 if self._localiser is None else self._localiser.filled

    def _clean(self, events: Events, *, last: bool = False) -> LiveResult:
        """Remove bursts, and match the events that are known to be in none."""
        bursts, reached = self._bursts, self.decoder.reached_us
        pieces = []
        if bursts is not None:
            pieces = bursts.pieces(events)
            pieces.append(bursts.finish() if last else bursts.advance(reached))
        return self._follow(events, (reached, [], -1, tuple(pieces)))

    def _follow(self, events: Events, step: Step) -> LiveResult:
        """Match what is left of the events, up to the time that is known."""
        localiser, bursts = self._localiser, self._bursts
        if localiser is None or bursts is None:
            return LiveResult(events, _NO_MATCHES, False)
        reached, matches, last_us, rest = step
        before_us = self._time
        if last_us > before_us:
            self._time = last_us
        for piece in rest:
            self._update(localiser, piece, matches)
        known = reached if self._follower is not None else min(reached, bursts.known_us)
        if known > self._time:
            # held events are later than this; the device may have reported that nothing happened
            self._near(localiser, known, matches)
            if localiser.every.interval_us and localiser.next_match_us <= known:
                # without a tick, the windows age with the next event
                matches.append(localiser.advance(known))
            self._time = known
        found = _NO_MATCHES
        if matches:
            found = matches[0] if len(matches) == 1 else np.concatenate(matches)
        moved, self._reached = len(events) > 0 or reached > self._reached, reached
        incomplete = self._incomplete(localiser, before_us, moved)
        return LiveResult(events, found, incomplete, reached)

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

    def _incomplete(self, localiser: Localiser, before_us: int, moved: bool) -> bool:
        """Return whether there was a loss within the windows that are compared.

        The flag can stay one piece too long, but is never removed too early. It is decided for the
        first match of these pieces, which is not earlier than `before_us`, the time of the
        localiser before them. `moved` says whether time or events came with them.
        """
        losses = self.decoder.health.losses
        if losses == 0:
            return False
        if losses != self._losses:
            self._losses, self._since, self._whole_us = losses, 0, -1
        whole_us, since = self._whole_us, self._since
        if whole_us < 0 and moved:
            self._whole_us = self._reached
        before, self._selected = self._selected, localiser.selected
        if 0 <= whole_us <= before_us:
            self._since += self._selected - before
        settings = self._settings
        windows = settings.windows_per_match + settings.late
        if settings.window == "time":
            return whole_us < 0 or before_us - whole_us < windows * settings.tau_us
        return since < windows * settings.events_per_window


def _warm_up(
    decoder: Decoder,
    reference: ReferenceMap,
    every: MatchSchedule | None,
    bursts: BurstFilter | CausalBurstFilter,
    odometry: bool,
) -> None:
    """Compile the kernels of matching before the first bytes arrive; this takes up to seconds."""
    # if there are more than a few, the last part is processed by columns
    events = synthetic_events(2 * CHUNK_EVENTS)
    localiser = Localiser(reference, every=every)
    if isinstance(bursts, CausalBurstFilter):
        follower = Follower(bursts, localiser)
        follower.follow(events[:1], 0)
        copy.deepcopy(decoder).decode_and_follow(b"", 0, follower)
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
