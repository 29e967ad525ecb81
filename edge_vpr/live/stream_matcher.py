"""From bytes to matches: what a stream has beside its localiser: bursts, gaps, losses, position."""

from __future__ import annotations

from bisect import bisect_right
from typing import Any, NamedTuple

import numpy as np

from edge_vpr.archive import Arrays
from edge_vpr.descriptors.cleaning import BurstFilter
from edge_vpr.errors import MapError
from edge_vpr.events import NO_EVENTS, Events, join_events
from edge_vpr.live.position import Locator, PathPosition
from edge_vpr.live.protocols import Decoder
from edge_vpr.live.protocols.health import EXACT, Health
from edge_vpr.matching.match import Match, MatchRows, join_matches
from edge_vpr.odometry import OdometerCheck
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap

_NEVER_US = 1 << 62
#: A step of the clock is a jump if it is longer than this time and than this number of ticks.
JUMP_US, MOST_TICKS = 1_000_000, 10_000
#: Time over which losses are remembered for windows by number, which may last for any time.
_MOST_LOSS_US = 60_000_000


# What is missing of a match: the share of its events that is known to be lost.


#: Interval at which losses are remembered, and for how many intervals.
LOSS_STEP_US, MOST_LOSS_STEPS = 10_000, 16_384


class LossWatch:
    """Keep counts of received and lost events over time, to find the losses within a window.

    Parameters
    ----------
    health : Health
        Of the stream.
    """

    def __init__(self, health: Health) -> None:
        self._health = health
        # noticed losses, bytes without events so far, and an estimate of the events in them
        self._losses = self._bytes = self._of_bytes = 0
        self._in_loss = False  # whether no event has come since a loss was noticed
        self._decoded = 0
        self._reopened = 0  # of the gaps that were noted
        # time, events received, events lost, and losses of unknown size, each of them until then
        self._seen: list[tuple[int, int, int, int]] = [(-1, 0, 0, 0)]

    def note(self, reached_us: int, oldest_us: int) -> None:
        """Take the counts of the present time; those from before `oldest_us` are not needed."""
        seen, counts = self._seen, (reached_us, *self._counts())
        self._reopened = self._health.reopened
        if len(seen) > MOST_LOSS_STEPS or seen[len(seen) // 2][0] < oldest_us:
            del seen[: len(seen) // 2]
        if len(seen) > 1 and reached_us - seen[-2][0] < LOSS_STEP_US:
            seen[-1] = counts
        else:
            seen.append(counts)

    def gap(self, end_us: int) -> None:
        """Note that what precedes `end_us` is missing, before the counts of later bytes are taken.

        One piece of bytes may hold much that came after the gap, of which nothing is missing.
        """
        _, received, lost, unknown = self._seen[-1]
        unknown += self._health.reopened - self._reopened
        self._reopened = self._health.reopened
        self._seen.append((end_us, received, lost, unknown))

    def missing(self, begin_us: int) -> float:
        """Return the share of events that is known to be lost from a time on.

        Returns
        -------
        float
            0 to 1; 1 if something of unknown size is missing, such as the time before the camera
            started again.
        """
        seen = self._seen
        _, received, lost, unknown = seen[max(bisect_right(seen, (begin_us,)) - 1, 0)]
        _, now, lost_now, unknown_now = seen[-1]
        if unknown_now != unknown:
            return 1.0
        lost = lost_now - lost
        return lost / (lost + max(now - received, 0)) if lost > 0 else 0.0

    def _counts(self) -> tuple[int, int, int]:
        health, lost = self._health, self._health.lost
        if health.accounting != EXACT:
            before = self._bytes
            self._bytes = health.skipped_bytes + health.overrun_bytes + health.line_errors
            # a device may send other things than events, but not before a loss is over
            noticed = health.losses != self._losses
            if noticed or self._in_loss:
                events = (self._bytes - before) * health.decoded
                self._of_bytes += -(-events // max(health.decoded_bytes, 1))
            self._in_loss = noticed or (self._in_loss and health.decoded == self._decoded)
            self._decoded = health.decoded
            self._losses = health.losses
            lost = max(lost, self._of_bytes)
        lost += health.device_dropped + health.rejected
        breaks = health.reopened + health.device_resets + health.clock_resets + health.clock_jumps
        return health.events, lost, breaks


# From bytes to matches.


class LiveResult(NamedTuple):
    """Events and matches of one chunk of bytes."""

    events: Events  #: Shape (n,): as decoded.
    #: In the order of their windows, with what is missing of them, and where the robot is.
    matches: tuple[Match, ...] = ()


class StreamMatcher:
    """Decodes a stream of bytes, and matches its events with a map.

    Parameters
    ----------
    reference : ReferenceMap, optional
        Without a map, events are decoded but not matched.
    every : MatchSchedule, optional
        When to give a match.

    Attributes
    ----------
    localiser : Localiser or None
        Has the state of matching; None without a map.
    """

    def __init__(
        self,
        decoder: Decoder,
        reference: ReferenceMap | None = None,
        every: MatchSchedule | None = None,
    ) -> None:
        self.decoder = decoder
        self.localiser: Localiser | None = None
        self._bursts: BurstFilter | None = None
        if reference is not None and reference.settings.remove_bursts:
            self._bursts = BurstFilter(reference.pixel_map.sensor)
        self._losses = LossWatch(decoder.health)
        self._time = 0  # time that the localiser has reached
        self._dropped = False  # whether the host dropped bytes since the newest event
        self._away = False  # whether the link was lost, or the program, since then
        self._odometer_check = OdometerCheck()  # without a map
        if reference is None:
            return
        sensor, settings = reference.pixel_map.sensor, reference.settings
        if sensor != decoder.sensor:
            raise MapError(
                f"the stream is of a {decoder.sensor} sensor and the map of a {sensor} one: "
                "use the map of this camera"
            )
        self.localiser = Localiser(reference, every=every)
        self._position, self._locator = PathPosition(settings), Locator(reference)
        # longest time that is matched in one step
        self._most_us = MOST_TICKS * self.localiser.every.interval_us or _NEVER_US
        #: windows that a match compares, and how far back from a match its losses may lie
        self._windows = settings.windows_per_match
        span_us = settings.tau_us if settings.window == "time" else _MOST_LOSS_US
        self._horizon_us = (self._windows + 1) * span_us

    @property
    def odometer_check(self) -> OdometerCheck:
        """Findings about the robot's odometer."""
        return self._odometer_check if self.localiser is None else self.localiser.odometer_check

    @property
    def bursts_removed(self) -> int:
        """Events removed as bursts."""
        return 0 if self._bursts is None else self._bursts.removed

    @property
    def filled(self) -> float:
        """Share of the first match's windows that has passed; there are matches from 1 on."""
        return 0.0 if self.localiser is None else self.localiser.filled

    def feed(
        self, data: bytes, host_us: int, *, dropped: int = 0, reopened: bool = False
    ) -> LiveResult:
        """Decode and match the next bytes.

        Parameters
        ----------
        host_us : int
            When they came.
        dropped : int
            Bytes that the host dropped before them.
        reopened : bool
            Whether the link was disconnected before them.
        """
        decoder, early = self.decoder, NO_EVENTS
        if dropped or reopened:
            early = decoder.gap(dropped)
        if reopened:
            decoder.health.reopened += 1
            self._away = True
        events = decoder.feed(data, host_us)
        matched = 0
        self._dropped = self._dropped or dropped > 0
        if self.localiser is not None:
            # a frame without events, or a state that was kept, tells the time too
            begin_us = int(events.t[0]) if events.size else decoder.reached_us
            if self._away and (events.size or begin_us > self._time):
                self._come_back(self.localiser, early, begin_us)
                matched = early.size
            elif self._dropped and events.size:
                # no matches of time in which nothing was seen
                self.localiser.skip_ticks(begin_us)
            self._dropped = self._dropped and not events.size
        return self._match(join_events([early, events]), matched)

    def finish(self) -> LiveResult:
        """End the stream, and return the matches of what was held."""
        return self._match(self.decoder.finish(), last=True)

    def read_odometer(self, distance_mm: int) -> tuple[int, int] | None:
        """Take a reading of the robot's odometer, at the time that the stream has reached.

        Returns
        -------
        tuple of int, optional
            That time, in microseconds, and the distance without leaps; None if the reading does not
            count, see `OdometerCheck`.
        """
        check, localiser = self.odometer_check, self.localiser
        if localiser is None:
            time_us = self.decoder.reached_us
            counts = check.read(time_us, distance_mm)
        else:
            time_us, before = self._time, check.leaps
            # all matches due until then have been given
            localiser.read_odometer(time_us, distance_mm / 1e3)
            counts = check.leaps == before
        self.decoder.health.odometer_leaps = check.leaps
        return (time_us, check.distance_mm) if counts else None

    def to_state(self) -> tuple[Arrays, dict[str, Any]]:
        """Return what is known of the drive; matching goes on meanwhile, and changes it no more.

        Returns
        -------
        arrays : dict of str to ndarray
            See `Localiser.to_arrays`.
        values : dict
            Of JSON.
        """
        kept = self.localiser
        assert kept is not None
        arrays = {name: array.copy() for name, array in kept.to_arrays().items()}
        values = {
            "now_us": kept.now_us, "floor_us": kept.floor_us, "time_us": self._time,
            "clock": self.decoder.timestamps.to_values(), "position": self._position.to_values(),
        }  # fmt: skip
        return arrays, values

    def resume(self, localiser: Localiser, values: dict[str, Any], passed_us: int) -> None:
        """Go on from a state, before the first bytes, which come `passed_us` after its newest.

        Parameters
        ----------
        localiser : Localiser
            With the arrays of `to_state`.
        """
        self.localiser, self._time = localiser, values["time_us"]
        self._position.resume(values["position"])
        self.decoder.timestamps.resume(values["clock"], passed_us)
        # what was missed is of unknown size
        self.decoder.health.reopened += 1
        self._away = True

    def _come_back(self, localiser: Localiser, early: Events, begin_us: int) -> None:
        """Match what came before a gap, and go on after it; of the gap there are no matches."""
        bursts = self._bursts
        for piece in [early] if bursts is None else [*bursts.pieces(early), bursts.finish()]:
            self._update(localiser, piece, [])
        localiser.skip_ticks(begin_us)
        localiser.advance(begin_us)
        self._losses.gap(begin_us)
        self._time, self._away = begin_us, False

    def _match(self, events: Events, matched: int = 0, *, last: bool = False) -> LiveResult:
        """Match the events after the `matched` ones that are known to be in no burst."""
        localiser, bursts, reached = self.localiser, self._bursts, self.decoder.reached_us
        if localiser is None:
            return LiveResult(events)
        row_arrays: MatchRows = []
        # the burst filter may hold events back for long: matches follow the time matched so far
        oldest_us = self._time - self._horizon_us
        pieces, complete_us = [events[matched:]], reached
        if bursts is not None:
            pieces = bursts.pieces(pieces[0])
            pieces.append(bursts.finish() if last else bursts.advance(reached))
            complete_us = min(reached, bursts.complete_us)
        for piece in pieces:
            self._update(localiser, piece, row_arrays)
        if complete_us > self._time:
            # held events are later than this; the device may have reported that nothing happened
            self._catch_up(localiser, complete_us, row_arrays)
            if localiser.every.interval_us and localiser.next_match_us <= complete_us:
                # without a tick, the windows age with the next event
                row_arrays.append(localiser.advance(complete_us))
            self._time = complete_us
        self._losses.note(reached, oldest_us)
        rows = join_matches(row_arrays).tolist()
        return LiveResult(events, tuple(map(self._located, rows)))

    def _located(self, row: tuple[Any, ...]) -> Match:
        """Return a match with what is missing of it, and where the robot is."""
        match = Match(*row)
        span_us = match.time_us - match.start_us
        missing = self._losses.missing(match.time_us - self._windows * span_us)
        at = self._position.update(match.time_us, span_us, match.place)
        where: dict[str, Any] = self._locator.locate(at)
        return match._replace(missing=missing, jumps=self._position.jumps, **where)

    def _update(self, localiser: Localiser, events: Events, row_arrays: MatchRows) -> None:
        """Match events in parts that each span less than `MOST_TICKS`."""
        while events.size:
            taken, last = events.size, int(events.t[-1])
            if last - self._time > self._most_us:
                self._catch_up(localiser, int(events.t[0]), row_arrays)
                taken = int(np.searchsorted(events.t, self._time + self._most_us, "right"))
                last = int(events.t[taken - 1])
            row_arrays.append(localiser.update(events if taken == events.size else events[:taken]))
            self._time = last
            events = events[taken:]

    def _catch_up(self, localiser: Localiser, time_us: int, row_arrays: MatchRows) -> None:
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
            row_arrays.append(localiser.advance(self._time))
