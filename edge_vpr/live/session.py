"""A live session: from the bytes of a camera to matches."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import queue
import socket
import stat
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from io import FileIO
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, NamedTuple, Self, Unpack

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import archive_kind
from edge_vpr.compile_report import COMPILE_ALL, compiling_reported
from edge_vpr.confidence import OFF_MAP_MISFIT, OFF_MAP_TEXT
from edge_vpr.descriptors.cleaning import BurstFilter, CausalBurstFilter
from edge_vpr.descriptors.counting import Removed
from edge_vpr.errors import MapError, RecordingError, UsageError, as_path, expect, printable
from edge_vpr.evaluation.tables import save_odometry
from edge_vpr.events import EVENT_DTYPE, Events, Sensor, join_events
from edge_vpr.files import check_output, work_folder
from edge_vpr.learning import MapUpdate
from edge_vpr.live.links import DescriptorLink, Link, LinkReader, SocketLink, UrlLink, open_link
from edge_vpr.live.odometer import OdometerReader
from edge_vpr.live.position import Locator, PathPosition
from edge_vpr.live.protocols import EXACT, Decoder, Health, open_decoder
from edge_vpr.live.state import (
    LiveState,
    Resumable,
    StateWriter,
    check_state_file,
    read_state,
    state_steps,
)
from edge_vpr.map_record import KIND as MAP_KIND
from edge_vpr.online.localiser import MATCH_DTYPE, Localiser, MatchSchedule
from edge_vpr.recordings import FORMATS, WRITTEN, writable_format, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.results import check_new_file, check_new_map
from edge_vpr.route import OdometerCheck, Odometry
from edge_vpr.settings import MatchingChanges, Settings, duration_us, resolve_settings
from edge_vpr.warm_up import WarmUpStep, localising_steps, warm_up

# From bytes to matches: the decoder, the burst filter and the localiser as one.


_NEVER_US = 1 << 62
#: A step of the clock is a jump if it is longer than this time and than this number of ticks.
JUMP_US, MOST_TICKS = 1_000_000, 10_000
_NO_EVENTS = np.empty(0, dtype=EVENT_DTYPE)
_NO_MATCHES = np.empty(0, dtype=MATCH_DTYPE)
#: Interval at which losses are remembered, for how long of windows by number, and how many.
LOSS_STEP_US, MOST_LOSS_US, MOST_LOSS_STEPS = 10_000, 60_000_000, 16_384


class LiveResult(NamedTuple):
    """Events and matches of one chunk of bytes."""

    events: Events  #: Shape (n,): as decoded.
    matches: npt.NDArray[np.void]  #: Shape (m,): in the order of their windows.
    #: Time up to which the stream is known; with a delay, matches are of earlier windows.
    reached_us: int = 0
    #: Of each match, the share of the events of its windows that is known to be lost.
    missing: tuple[float, ...] = ()
    #: Of each match, the place where the robot is at its time, see `PathPosition`.
    at: tuple[float, ...] = ()
    #: Of each match, how often the position has jumped until then.
    jumps: tuple[int, ...] = ()


class LossWatch:
    """Keep counts of received and lost data over time, to find the losses within a window.

    Parameters
    ----------
    health : Health
        Of the stream.
    """

    def __init__(self, health: Health) -> None:
        self._health = health
        # noticed losses, lost bytes so far, and the number of events in them
        self._losses = self._bytes = self._of_bytes = 0
        self._in_loss = False  # whether no event has come since a loss was noticed
        self._decoded = 0
        # time, events received, events lost, and losses of unknown size, each of them until then
        self._seen: list[tuple[int, int, int, int]] = [(-1, 0, 0, 0)]

    def note(self, reached_us: int, horizon_us: int) -> None:
        """Take the counts of the present time; those older than the horizon are not needed."""
        seen, counts = self._seen, (reached_us, *self._counts())
        # what comes now may give matches from the time before on
        if len(seen) > MOST_LOSS_STEPS or seen[len(seen) // 2][0] < seen[-1][0] - horizon_us:
            del seen[: len(seen) // 2]
        if len(seen) > 1 and reached_us - seen[-2][0] < LOSS_STEP_US:
            seen[-1] = counts
        else:
            seen.append(counts)

    def missing(self, begin_us: int) -> float:
        """Return the share of events that is known to be lost from a time on.

        Returns
        -------
        float
            0 to 1; 1 if something of unknown size is missing, such as the time before a restart.
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


class LiveLocaliser:
    """Decodes a stream of bytes, and matches its events with a map.

    Parameters
    ----------
    reference : ReferenceMap, optional
        Without a map, events are decoded but not matched.
    every : MatchSchedule, optional
        When to give a match.
    causal_bursts : bool
        Remove bursts, if the map's settings ask for it, without waiting for their end: a match
        comes 2 ms earlier, and is no longer to the bit that of the recording.
    odometry : bool
        Whether readings of an odometer are to come.
    show : callable
        Takes the name of what is compiled now; all kernels are compiled before the first bytes.
    """

    def __init__(
        self,
        decoder: Decoder,
        reference: ReferenceMap | None = None,
        every: MatchSchedule | None = None,
        *,
        causal_bursts: bool = False,
        odometry: bool = False,
        show: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.decoder = decoder
        self._localiser: Localiser | None = None
        self._bursts: BurstFilter | CausalBurstFilter | None = None
        self._losses = LossWatch(decoder.health)
        self._position: PathPosition | None = None
        self._time = 0  # time that the localiser has reached
        self._heard_us = 0  # host's time of the newest bytes
        self._unseen_us = 0  # for how long nothing was seen until the next event
        self._seen_us = 0  # time of the device until which something was seen before
        self.odometer_check = OdometerCheck()
        if reference is not None:
            sensor = reference.pixel_map.sensor
            if sensor != decoder.sensor:
                raise MapError(
                    f"the stream is of a {decoder.sensor} sensor and the map of a {sensor} one: "
                    "use the map of this camera"
                )
            steps = localising_steps(
                reference, every, _burst_filter(reference, causal_bursts), odometry=odometry
            )
            warm_up([*steps, WarmUpStep("decoder", decoder.warm_up)], show)
            self._localiser = Localiser(reference, every=every)
            self._settings = self._localiser.settings
            self.odometer_check = self._localiser.odometer_check or self.odometer_check
            self._position = PathPosition(self._settings.window_parts)
            # longest time that is matched in one step
            self._most_us = MOST_TICKS * self._localiser.every.interval_us or _NEVER_US
            self._bursts = _burst_filter(reference, causal_bursts)
        else:
            warm_up([WarmUpStep("decoder", decoder.warm_up)], show)

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
        host_us : int
            When they came.
        lost : int
            Bytes that the host dropped before them.
        reopened : bool
            Whether the link was lost before them.
        """
        decoder, early = self.decoder, _NO_EVENTS
        if lost or reopened:
            early = decoder.gap(lost)
        if reopened:
            decoder.health.reopened += 1
            self._unseen_us = max(host_us - self._heard_us, 1)
            self._seen_us = decoder.reached_us
        self._heard_us = host_us
        events = decoder.feed(data, host_us)
        matched = 0
        if self._localiser is not None:
            # a frame without events, or a state that was kept, tells the time too
            begin_us = int(events["t"][0]) if events.size else decoder.reached_us
            if self._unseen_us and (events.size or begin_us > self._seen_us):
                self._go_unseen(self._localiser, early, begin_us)
                matched = early.size
            elif lost and events.size:
                # no matches of time in which nothing was seen
                self._localiser.skip_ticks(begin_us)
        return self._match(join_events([early, events]), matched)

    def _go_unseen(self, localiser: Localiser, early: Events, begin_us: int) -> None:
        """Match what came before a gap, and go on after it; of the gap there are no matches."""
        assert self._bursts is not None
        for piece in (*self._bursts.pieces(early), self._bursts.finish()):
            self._update(localiser, piece, [])
        localiser.skip_ticks(begin_us)
        localiser.go_unseen(begin_us, max(begin_us - self._time, self._unseen_us))
        self._time, self._unseen_us = begin_us, 0

    def read_odometer(self, distance_mm: int) -> tuple[int, int] | None:
        """Take a reading of the robot's odometer, at the time that the stream has reached.

        Returns
        -------
        tuple of int, optional
            That time, in microseconds, and the distance without leaps; None if the odometer cannot
            be right, see `OdometerCheck`.
        """
        check, localiser = self.odometer_check, self._localiser
        if localiser is None:
            time_us = self.decoder.reached_us
            check.read(time_us, distance_mm, 0)
        else:
            time_us = self._time
            # all matches due until then have been given
            localiser.read_odometer(time_us, distance_mm / 1e3)
        health = self.decoder.health
        health.odometer_leaps, health.odometer_unused = check.leaps, check.unused
        return None if check.wrong else (time_us, check.distance_mm)

    def finish(self) -> LiveResult:
        """End the stream, and return the matches of what was held."""
        found = self._match(self.decoder.finish(), last=True)
        if self._localiser is None:
            return found
        held = self._located(self._localiser.finish())
        return found._replace(
            matches=np.concatenate([found.matches, held.matches]),
            missing=found.missing + held.missing,
            at=found.at + held.at,
            jumps=found.jumps + held.jumps,
        )

    def to_state(self) -> LiveState:
        """Return what is known of the drive; matching goes on meanwhile, and changes it no more."""
        localiser, position = self._localiser, self._position
        assert localiser is not None and position is not None
        run = localiser.run
        arrays = {name: array.copy() for name, array in run.to_arrays().items() if name != "places"}
        values = {
            "now_us": run.now_us, "floor_us": run.floor_us, "time_us": self._time,
            "clock": self.decoder.clock_values(), "position": position.to_values(),
        }  # fmt: skip
        return LiveState(arrays, values)

    def resume(self, saved: Resumable, passed_us: int) -> None:
        """Go on from a state, before the first bytes, which come `passed_us` after its newest."""
        localiser, values = saved
        assert self._position is not None
        self._localiser, self._time = localiser, values["time_us"]
        self.odometer_check = localiser.odometer_check or self.odometer_check
        self._position.resume(values["position"])
        self.decoder.resume_clock(values["clock"], passed_us)
        # what was missed is of unknown size
        self.decoder.health.reopened += 1
        self._unseen_us, self._seen_us = passed_us, self._time

    @property
    def filled(self) -> float:
        """Share of the first match's windows that has passed; there are matches from 1 on."""
        return 0.0 if self._localiser is None else self._localiser.filled

    @property
    def _windows(self) -> int:
        """Windows that a match compares."""
        return self._settings.windows_per_match + self._settings.match_delay

    def _match(self, events: Events, matched: int = 0, *, last: bool = False) -> LiveResult:
        """Match the events after the `matched` ones that are known to be in no burst."""
        localiser, bursts, reached = self._localiser, self._bursts, self.decoder.reached_us
        if localiser is None or bursts is None:
            return LiveResult(events, _NO_MATCHES)
        matches: list[npt.NDArray[np.void]] = []
        for piece in bursts.pieces(events[matched:]):
            self._update(localiser, piece, matches)
        self._update(localiser, bursts.finish() if last else bursts.advance(reached), matches)
        known = min(reached, bursts.known_us)
        if known > self._time:
            # held events are later than this; the device may have reported that nothing happened
            self._catch_up(localiser, known, matches)
            if localiser.every.interval_us and localiser.next_match_us <= known:
                # without a tick, the windows age with the next event
                matches.append(localiser.advance(known))
            self._time = known
        found = _NO_MATCHES
        if matches:
            found = matches[0] if len(matches) == 1 else np.concatenate(matches)
        span_us = self._settings.tau_us if self._settings.window == "time" else MOST_LOSS_US
        self._losses.note(reached, (self._windows + 1) * span_us)
        return self._located(found)._replace(events=events, reached_us=reached)

    def _located(self, matches: npt.NDArray[np.void]) -> LiveResult:
        """Return matches with what is missing in their windows, and where the robot is."""
        position, losses, windows = self._position, self._losses, self._windows
        missing, at, jumps = [], [], []
        if matches.size and position is not None:
            columns = (matches[name].tolist() for name in ("time_us", "start_us", "place"))
            for time_us, start_us, place in zip(*columns, strict=True):
                span_us = time_us - start_us
                missing.append(losses.missing(time_us - windows * span_us))
                at.append(position.update(time_us, span_us, place))
                jumps.append(position.jumps)
        return LiveResult(
            _NO_EVENTS, matches, missing=tuple(missing), at=tuple(at), jumps=tuple(jumps)
        )

    def _update(
        self, localiser: Localiser, events: Events, matches: list[npt.NDArray[np.void]]
    ) -> None:
        """Match events in parts that each span less than `MOST_TICKS`."""
        while events.size:
            taken, last = events.size, int(events["t"][-1])
            if last - self._time > self._most_us:
                self._catch_up(localiser, int(events["t"][0]), matches)
                taken = int(np.searchsorted(events["t"], self._time + self._most_us, "right"))
                last = int(events["t"][taken - 1])
            matches.append(localiser.update(events if taken == events.size else events[:taken]))
            self._time = last
            events = events[taken:]

    def _catch_up(
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


def _burst_filter(reference: ReferenceMap, causal: bool) -> BurstFilter | CausalBurstFilter:
    """Return what removes bursts live; without pixels, it removes nothing."""
    if not reference.settings.remove_bursts:
        return CausalBurstFilter(Sensor(0, 0))
    sensor = reference.pixel_map.sensor
    return CausalBurstFilter(sensor) if causal else BurstFilter(sensor)


# The session: `LiveLocaliser` with its link, the robot's odometer, files, and messages to the user.


#: Length of a silence that is reported.
SILENT_S = 1.0
#: Silence after which a device is greeted again, and interval of greetings.
GREET_S = 0.5
#: Interval at which it is said what is compiled.
PROGRESS_S = 2.0
#: Bytes and events before a warning: more than the start of a protocol, or chance on a bad line,
#: can make undecodable.
SENSELESS_BYTES, SENSELESS_EVENTS = 8_192, 1_000
#: Largest number of pieces of bytes that one `LiveSession.poll` matches, and of pieces of events
#: that wait for a file.
_MOST_PIECES, _MOST_WAITING = 16, 256

#: Time after which clocks of camera and host are compared from the start, because they drift apart.
_LAG_S = 300.0

#: Suffixes of recordings that are never bytes of a camera, as .raw and .bin can be.
_OF_RECORDINGS = {suffix for each in FORMATS.values() for suffix in each.suffixes} - {".raw"}

_LOG = logging.getLogger("edge_vpr.live")


class LiveMatch(NamedTuple):
    """One match of a live session, or a heartbeat.

    `time_s`, the position and the interval are of the same moment: the end of the newest window.
    What is not known is None, or NaN where the field is a number.

    A heartbeat says that no match came for the time that `heartbeat` names. Its `place` is -1, its
    `probability` 0, its `missing` 1, it has no position, and it is `lost`: a program that checks
    any of them slows down without a branch of its own.

    Attributes
    ----------
    time_s : float
        Time of the match by the camera's clock, in seconds; NaN in a heartbeat.
    query : int
        Matches of this session before this one.
    place : int
        Best place of the map: that whose middle looks most like the newest window.
    distance : float
        With sequences, distance to it per window; with the place filter, its cost.
    second : int
        Best place outside the exclusion zone of `place`; -1: there is none.
    second_distance : float
        Distance to that; NaN if there is none.
    ratio : float
        `distance` / `second_distance`; NaN if it is not known.
    events : int
        In the newest window, at the selected pixels.
    start_s : float
        When this window began, by the camera's clock.
    trust : int
        Higher means more confident.
    misfit : int
        0 where views resemble the map's, `confidence.OFF_MAP_MISFIT` or more in another place or
        light; -1 for sequences.
    probability : float
        Probability that the match is correct; NaN if the map has no table of probabilities.
    lost : bool
        Whether the match is below the precision that the settings ask for, or older than the
        session's `max_age`.
    missing : float
        Share of the events of its windows that is known to be lost, 0 to 1; 1 also after a gap of
        unknown size.
    age_s : float
        How much time has passed since `time_s` when the match was given, by the clocks of camera
        and host, less the shortest time that events have taken to arrive; NaN of files and pipes,
        which wait for the host.
    host_us : int
        `time_s` by this machine's clock, in microseconds since 1970; of files and pipes, when the
        last bytes for this match were read.
    jumps : int
        How often the position has jumped until now. From one match to another with the same number,
        it has moved with the path.
    x_m, y_m, z_m, latitude, longitude : float or None
        Position of the robot.
    heading_deg : float or None
        Direction of the route there, in degrees clockwise from north (in metres: from y towards x).
    along_m : float or None
        Metres along the route, from the start of the drive that the map was made of.
    along_from_m, along_to_m : float or None
        Interval of the same: the probability is that of being in it.
    route_m : float or None
        Length of the route.
    """

    time_s: float
    query: int
    place: int
    distance: float
    second: int
    second_distance: float
    ratio: float
    events: int
    start_s: float
    trust: int
    misfit: int
    probability: float
    lost: bool
    missing: float
    age_s: float
    host_us: int
    jumps: int
    x_m: float | None = None
    y_m: float | None = None
    z_m: float | None = None
    latitude: float | None = None
    longitude: float | None = None
    heading_deg: float | None = None
    along_m: float | None = None
    along_from_m: float | None = None
    along_to_m: float | None = None
    route_m: float | None = None

    @property
    def incomplete(self) -> bool:
        """Whether events are missing."""
        return self.missing > 0


class Message(NamedTuple):
    """Something that happened to a session.

    Attributes
    ----------
    kind : str
        ``link`` (lost or opened), ``state`` (gone on from or not), ``stalled`` (silence), ``lag``
        (the host is too slow), ``misfit`` (another place or light), ``device`` and ``sender``
        (remarks on the camera and on a second one), ``senseless`` (bytes that do not decode),
        ``odometer``, ``compiling``, ``file`` (given up), or ``drive`` (kept).
    text : str
        One sentence, which may quote a device or the system: pass it through `errors.printable`
        before it reaches a terminal.
    over : bool
        Whether it reports the end of a problem.
    """

    kind: str
    text: str
    over: bool = False


class LiveStep(NamedTuple):
    """Results of one piece of bytes, for views that show more than matches."""

    result: LiveResult | None  #: Events and matches; None if nothing came.
    at_s: float  #: When the bytes came, on the clock of `time.monotonic`.
    host_us: int  #: The same in microseconds since 1970.
    #: Readings of the odometer since the step before: time in microseconds of the camera's clock,
    #: and metres.
    odometry: tuple[tuple[int, float], ...] = ()
    matches: tuple[LiveMatch, ...] = ()


class LiveStatus(NamedTuple):
    """State of a session now."""

    health: Health
    #: Share of the first match's windows that has passed; there are matches from 1 on.
    filled: float = 0.0
    lost_link: str = ""  #: Why the link is closed; empty while it is open.
    dead_s: float = 0.0  #: Seconds for which the link was lost, in all so far.


class LiveSession:
    """Matches what a camera sends, from the opening of its line to the last file.

    >>> import socket
    >>> from edge_vpr.simulation import simulate_pair
    >>> from edge_vpr.live.protocols import open_encoder
    >>> import edge_vpr as ev
    >>> drive, _ = simulate_pair(seed=0, length_m=20.0)
    >>> route = ev.ReferenceMap.build(drive, tau="250ms")
    >>> encoder = open_encoder("evpr", drive.sensor)
    >>> camera, port = socket.socketpair()
    >>> with ev.LiveSession(port, protocol="evpr", reference=route) as session:
    ...     camera.sendall(encoder.start() + encoder.encode(next(iter(drive))))
    ...     camera.close()
    ...     places = [match.place for match in session]
    >>> port.close()
    >>> len(places) > 5, str(session.health)
    (True, 'no faults')

    The session owns the link, the decoder and its requests to the camera, the localiser, the clock,
    the counts of what was lost, reconnection, recordings and the robot's odometer. All kernels are
    compiled before the link is opened, so that a camera never waits for a compiler.

    Parameters
    ----------
    link : str, Path or object
        A serial port, ``tcp://HOST:PORT``, ``udp://:PORT``, ``-`` or a file of bytes, see
        `open_link`; or what is open already: a `Link`, a socket, a file, a descriptor, a port of
        pyserial. Open objects cannot be opened again when they are lost.
    protocol : str
        Of the camera: ``evpr``, ``edvs``, ``evt3``, ``openmv``, ..., with options after a colon.
    reference : ReferenceMap or path, optional
        Without one, events are decoded and recorded, and nothing is matched.
    every : str or MatchSchedule, optional
        When to give a match: ``50ms`` (the default), ``event``, ``window``, ``change``, or a number
        of events. Maps with a delay give one at the end of each window.
    sensor : Sensor or str, optional
        Such as ``128x128``; by default the map's.
    baud : int, optional
        Of a serial port; by default the protocol's.
    flow_control : bool
        Use the RTS and CTS wires.
    reconnect : bool
        Open a live link again when it is lost; else its end is the session's.
    heartbeat : str, optional
        Yield a heartbeat (see `LiveMatch`) whenever no match came for this time, such as ``500ms``;
        longer than a window if matches come at its end.
    odometry : str, optional
        Where the robot sends its odometer, see `open_link`; not a file.
    burst_filter : {"exact", "causal"}
        Whether a match waits for the end of a burst, as in a recording, or comes 2 ms earlier and
        is no longer to the bit that of the recording. It matters to maps that remove bursts.
    record : path or sequence of paths
        Files of the bytes (``.bin``) or of the events (``.npz``, ``.raw``, ...).
    learn : path, optional
        Write a map here when the session is closed: `reference`, which has learnt this drive (see
        `ReferenceMap.update`). Without `reference`, or with other settings of windows, pixels or
        codes than it has, it is a new map of this drive. All the while, the drive is matched with
        `reference` as it was.
    state : path, optional
        A file with the suffix ``.state``, in which the session keeps what it knows of the drive,
        every two seconds and at its end; a session with the same map and settings goes on from
        there. A state that is older than a silence of the camera's clock may be (60 s; 600 s where
        a checksum protects times), or is damaged, is not used, and a message says so. Not with a
        delay or `learn`; files and pipes have none.
    settings : Settings or str, optional
        Of the map to write, or the name of a preset; by default those of `reference`.
    overwrite : bool
        Whether files that exist may be replaced.
    on_overload : {"drop", "wait"}, optional
        See `LinkReader`; by default files and pipes wait.
    max_lag : str
        Bytes that have waited longer than this for a host that is too slow are dropped.
    max_age : str, optional
        A match that is older than this when it is given is `lost`; by default two windows.
    on_message : callable, optional
        Called with each `Message`; by default problems go to the logger ``edge_vpr.live``.
    **changes
        Single settings of matching that replace those of `reference`, such as ``precision=0.99``,
        by which other matches are marked `lost`, or ``delay=4``.

    Raises
    ------
    MapError
        If the map cannot be read.

    Attributes
    ----------
    ended : bool
        Whether the link has ended for good, or `stop` was called, and all matches were given.
    stopping : threading.Event
        Ends the session when it is set, as `stop` does.
    unwritten : str
        Which recording was given up and why, if one was.
    learnt : ReferenceMap or None
        The map that was written, after `close`.
    update : MapUpdate or None
        What `reference` has learnt, if it has.
    removed : Removed
        Counts of events that were removed as bursts for that map.
    """

    def __init__(
        self,
        link: Any,
        *,
        protocol: str,
        reference: ReferenceMap | str | Path | None = None,
        every: str | MatchSchedule | None = None,
        sensor: Sensor | tuple[int, int] | str | None = None,
        baud: int | None = None,
        flow_control: bool = False,
        reconnect: bool = True,
        heartbeat: str | None = None,
        odometry: str | None = None,
        burst_filter: Literal["exact", "causal"] = "exact",
        record: str | Path | Sequence[str | Path] = (),
        learn: str | Path | None = None,
        state: str | Path | None = None,
        settings: Settings | str | None = None,
        overwrite: bool = False,
        on_overload: Literal["drop", "wait"] | None = None,
        max_lag: str = "500ms",
        max_age: str | None = None,
        on_message: Callable[[Message], object] | None = None,
        **changes: Unpack[MatchingChanges],
    ) -> None:
        expect(protocol, str, "protocol", "its name, such as 'edvs'")
        _check_odometry(odometry)
        if burst_filter not in ("exact", "causal"):
            raise UsageError(f"burst_filter={burst_filter!r}: expected 'exact' or 'causal'")
        if on_overload not in (None, "drop", "wait"):
            raise UsageError(f"on_overload={on_overload!r}: expected 'drop', 'wait' or None")
        map_file = reference if isinstance(reference, str | Path) else None
        known = _loaded(reference)
        if settings is None:
            settings = "default" if known is None else known.settings
        if known is None and changes:
            raise UsageError(f"{', '.join(changes)}: nothing is matched without reference=")
        if known is not None and changes:
            known = known.changed(changes, "LiveSession")
        self.reference = None if known is None else known.causal()
        self.sensor = _sensor_of(sensor, known)
        self.decoder = open_decoder(protocol, self.sensor)
        if not isinstance(every, MatchSchedule | None):
            expect(every, str, "every", _SUCH_AS)
        self.locator, self._every = None, None
        if self.reference is not None:
            self.locator = Locator(self.reference)
            self._every = MatchSchedule.parse(every, self.reference.settings)
        self._settings = settings if isinstance(settings, Settings) else resolve_settings(settings)
        self._causal = burst_filter == "causal"
        self._drop = None if on_overload is None else on_overload == "drop"
        self._open_link, reopens = _opener(link, baud or self.decoder.baud, flow_control)
        self._address, self._odometry = str(link), odometry
        self._reconnect = reconnect and reopens
        self._heartbeat_s = _seconds(heartbeat, "heartbeat") or math.inf
        self._max_lag_s = _seconds(max_lag, "max_lag") or 0.0
        self._max_age_s = _seconds(max_age, "max_age")
        paths = list(record) if isinstance(record, list | tuple) else [record]
        self._record = [as_path(path, "a file to record") for path in paths]
        self._learn = None if learn is None else as_path(learn, "the map to learn")
        self._state = None if state is None else as_path(state, "the state")
        self._overwrite = overwrite
        source = Path(link) if isinstance(link, str | os.PathLike) else None
        self._check_files(source, map_file)
        self.on_message = on_message
        self.stopping = threading.Event()
        self.ended, self.unwritten, self._unkept = False, "", ""
        self.learnt: ReferenceMap | None = None
        self.update: MapUpdate[ReferenceMap] | None = None
        self.removed = Removed()
        self._live: LiveLocaliser | None = None
        self._given = self._jumps = 0
        self._resumable: Resumable | str | None = None
        self._keeper: StateWriter | None = None
        self._files = contextlib.ExitStack()
        self._opened = self._closed = self._raised = False
        self._readings: dict[int, int] = {}
        self._fresh: list[tuple[int, float]] = []

    def _check_files(self, source: Path | None, map_file: str | Path | None) -> None:
        """Check, before the link is opened, that the files can be written and replace no other."""
        for path in self._record:
            check_recorded(path, "record")
            check_output(path, [map_file])
        if self._state is not None:
            reference = self.reference
            if reference is None or reference.settings.match_delay or self._learn is not None:
                raise UsageError(
                    f"state {self._state}: it is of matching with a map at once: give reference=, "
                    "and leave out delay= and learn="
                )
            check_state_file(self._state)
        seen: set[Path] = set()
        for path in filter(None, (*self._record, self._learn)):
            if path.resolve() in seen:
                raise UsageError(f"{path} is named twice: give each file another name")
            seen.add(path.resolve())
            check = check_new_map if path is self._learn else check_new_file
            check(path, [source], self._overwrite)

    # -- opening and closing

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def warm_up(self, show: Callable[[str], object] = lambda text: None) -> None:
        """Compile all kernels of this session; `open` calls this before it opens the link.

        Parameters
        ----------
        show : callable
            Takes the name of what is compiled now.
        """
        if self._live is not None:
            return
        said_s = time.monotonic()

        def progress(text: str) -> None:
            nonlocal said_s
            show(text)
            if text.startswith("compiling") and time.monotonic() - said_s > PROGRESS_S:
                said_s = time.monotonic()
                self._say("compiling", text)

        with compiling_reported(lambda text: self._say("compiling", text + COMPILE_ALL)):
            self._live = LiveLocaliser(
                self.decoder, self.reference, self._every,
                causal_bursts=self._causal, odometry=self._odometry is not None, show=progress,
            )  # fmt: skip
            if self._state is not None and self.reference is not None:
                warm_up(state_steps(self.reference, self._every), progress)

    def open(self) -> None:
        """Compile the kernels, open the link, then the files; again is harmless.

        Raises
        ------
        LinkError
            If the link or the odometer cannot be opened.
        OSError
            If a file of bytes cannot be written.
        """
        if self._closed:
            raise UsageError("this session is closed: make a new one")
        if self._opened:
            return
        self.warm_up()
        if self._state is not None and self.reference is not None:
            localiser = Localiser(self.reference, every=self._every)
            self._checksum = localiser.checksum()
            self._resumable = read_state(self._state, localiser, self._checksum)
        decoder = self.decoder
        with contextlib.ExitStack() as stack:
            self._reader = LinkReader(
                self._open_link, address=self._address,
                setup=decoder.setup(), teardown=decoder.teardown(),
                retry=self._reconnect, drop=self._drop, max_lag_s=self._max_lag_s,
            )  # fmt: skip
            stack.callback(self._reader.stop)
            # a sender that waits for this host, such as a replay, may be faster than the clock
            decoder.live = self._reader.live and self._drop is not False
            self._odometer: OdometerReader | None = None
            if self._odometry is not None:
                self._odometer = OdometerReader(self._odometry, self._say, retry=self._reconnect)
                stack.callback(self._odometer.stop)
            # last, so that a missing camera does not overwrite the run before
            self._raw = [
                stack.enter_context(path.open("wb", buffering=0))
                for path in self._record
                if path.suffix == ".bin"
            ]
            targets = [path for path in self._record if path.suffix != ".bin"]
            self._drive: Path | None = None
            if self._learn is not None:
                folder = self._files.enter_context(work_folder(self._learn))
                self._drive = folder / "drive.npz"
                targets.append(self._drive)
            self._writers = [_EventWriter(path, self.sensor, self._overwrite) for path in targets]
            for writer in self._writers:
                stack.callback(writer.close)
            self._stack = stack.pop_all()
        if self._state is not None and self._reader.live:
            self._keeper = StateWriter(self._state)
        self._watch = _LineWatch(self._reader, self.decoder, self._say)
        window_us = SILENT_S * 1e6
        if self.reference is not None and self.reference.settings.window == "time":
            window_us = self.reference.settings.tau_us
        self._lag = _LagWatch(self.health, window_us, self._say, live=self._reader.live)
        self._strange = False
        self._begin_s = self._beat_s = time.monotonic()
        self._opened = True

    def stop(self) -> None:
        """End the session from a signal handler or another thread; iteration then ends."""
        self.stopping.set()

    def close(self) -> None:
        """Close the link, complete the files, and make the map of `learn`; again is harmless.

        Raises
        ------
        EdgeVprError
            If the drive makes no map; the drive is kept, and a message names its file.
        """
        if self._closed or not self._opened:
            return
        self._closed = True
        with self._files:
            self._end()
            if self._drive is not None and self._learn is not None:
                self._make_map(self._drive, self._learn)

    # -- matches

    def __iter__(self) -> Iterator[LiveMatch]:
        """Yield matches, and heartbeats if they were asked for, until the link ends.

        A program that takes longer than the matches to come does not fall behind a live camera: of
        matches that were ready at once, those older than half of `max_lag` are left out, but for
        the newest.
        """
        for step in self.steps():
            ready_s = time.monotonic()
            for i, match in enumerate(step.matches, 1):
                waited_s = time.monotonic() - ready_s
                age_s = match.age_s + waited_s
                if (
                    i < len(step.matches)
                    and age_s > self._max_lag_s / 2
                    and self._drop is not False
                ):
                    continue
                late = age_s > self._oldest_s(match.time_s - match.start_s)
                yield match._replace(age_s=age_s, lost=match.lost or late)
            if (now := time.monotonic()) - self._beat_s >= self._heartbeat_s:
                self._beat_s = now
                yield _heartbeat(self._given, self._jumps)

    def poll(self) -> list[LiveMatch]:
        """Return the matches that are ready, without waiting.

        Call it at least every 20 ms, or a thread of the session has to read in between.

        Raises
        ------
        LinkError
            If the link has failed, once its last matches were returned.
        """
        self.open()
        found: list[LiveMatch] = []
        for _ in range(_MOST_PIECES):
            if self.ended:
                if not found:
                    self._raise_once()
                break
            step = self._take(0.0)
            self._look(step)
            found += step.matches
            if step.result is None:
                break
        now = time.monotonic()
        if not found and now - self._beat_s >= self._heartbeat_s:
            self._beat_s = now
            found.append(_heartbeat(self._given, self._jumps))
        return found

    def latest(self) -> LiveMatch | None:
        """Return the newest match that came since the last call, without waiting; None if none.

        For a loop that takes longer than the matches to come: see `poll`.
        """
        found = self.poll()
        return found[-1] if found else None

    def steps(self) -> Iterator[LiveStep]:
        """Yield a step for each piece of bytes and for each time-out, for views.

        Raises
        ------
        LinkError
            If the link has failed, after its last matches.
        RecordingError
            If the drive to learn from cannot be recorded.
        """
        self.open()
        while not self.ended:
            wait_s = self._beat_s + self._heartbeat_s - time.monotonic()
            step = self._take(min(self.decoder.tick_s, max(wait_s, 0.0)))
            # a match comes first: what else there is to do can wait
            yield step
            if not self.ended:
                self._look(step)
        self._raise_once()

    @property
    def health(self) -> Health:
        """Counts of what was received and lost so far."""
        health = self.decoder.health
        if self._opened and not self.ended:
            health.silent_s = self._watch.silent_s
            health.cut_off = bool(self._reader.lost_link)
        return health

    @property
    def status(self) -> LiveStatus:
        """State of the session now."""
        if not self._opened:
            return LiveStatus(self.health)
        live, reader = self._live_or_raise(), self._reader
        return LiveStatus(self.health, live.filled, reader.lost_link, reader.dead_s)

    @property
    def bursts_removed(self) -> int:
        """Events removed as bursts."""
        return 0 if self._live is None else self._live.bursts_removed

    @property
    def address(self) -> str:
        """Address of the link; once it is open, with the port that the system chose."""
        return self._reader.address if self._opened else self._address

    # -- one step

    def _take(self, timeout: float) -> LiveStep:
        """Take what comes within `timeout` seconds, and match it."""
        reader = self._reader
        if self.stopping.is_set() or reader.ended:
            return self._end()
        chunk = reader.take(timeout)
        now = time.monotonic()
        if chunk is None:
            return LiveStep(None, now, int(1e6 * time.time()), self._new_readings())
        for file in list(self._raw):  # first, so that errors can be reproduced
            self._write_raw(file, chunk.data)
        host_us = int(1e6 * (time.time() - (now - chunk.at_s)))
        since_us = int((chunk.at_s - self._begin_s) * 1e6)
        if self._resumable is not None:
            self._resume(host_us)
        result = self._live_or_raise().feed(
            chunk.data, since_us, lost=chunk.lost, reopened=chunk.reopened
        )
        self._heard_us = host_us
        # before the match is used: a program that fails then has a whole file
        self._write_events(result.events)
        self._lag.look(result.events, self.decoder.reached_us, time.monotonic())
        self._count_misfits(result)
        if result.matches.size:
            self._look_at_misfit(int(result.matches["misfit"][-1]))
        found = self._matches(result, host_us)
        return LiveStep(result, chunk.at_s, host_us, self._new_readings(), found)

    def _oldest_s(self, window_s: float) -> float:
        """Return the age beyond which a match is lost: by default two windows after it is due."""
        delay = 0 if self.reference is None else self.reference.settings.match_delay
        return self._max_age_s or (2 + delay) * window_s

    def _matches(self, result: LiveResult, host_us: int) -> tuple[LiveMatch, ...]:
        """Return the matches of a piece of bytes that came at `host_us`."""
        reference, locator = self.reference, self.locator
        if not result.matches.size or reference is None or locator is None:
            return ()
        self._beat_s = time.monotonic()
        delay, found = reference.settings.match_delay, []
        rows = zip(result.matches.tolist(), result.missing, result.at, result.jumps, strict=True)
        for row, missing, at, jumps in rows:
            time_us, place, distance, second, after, ratio, events, start_us, *rest = row
            trust, misfit, probability, lost = rest
            age_s = self._lag.age_s(time_us, self._beat_s)
            then_us = host_us - (result.reached_us - time_us) * (delay > 0)
            if not math.isnan(age_s):
                then_us = int(1e6 * (time.time() - age_s))
            lost = lost or age_s > self._oldest_s((time_us - start_us) / 1e6)
            found.append(
                LiveMatch(
                    time_us / 1e6, self._given, place, distance, second, after, ratio, events,
                    start_us / 1e6, trust, misfit, probability, lost, missing, age_s,
                    then_us, jumps,
                    *locator.locate(at), locator.route_m,
                )
            )  # fmt: skip
            self._given, self._jumps = self._given + 1, jumps
        return tuple(found)

    def _look(self, step: LiveStep) -> None:
        """Do what remains after a step: odometer, requests to the camera, and messages."""
        reader, decoder = self._reader, self.decoder
        decoder.health.line_errors = reader.line_errors
        if step.result is not None:
            self._watch.heard(step.at_s)
            self._keep_state()
        if self._odometer is not None and (shown_mm := self._odometer.look()) is not None:
            self._read_odometer(shown_mm)
        self._watch.look(nothing_came=step.result is None)
        reader.send(decoder.to_send(time.monotonic()))

    def _read_odometer(self, shown_mm: int) -> None:
        """Give a reading to the filter, and report an odometer that cannot be right."""
        live = self._live_or_raise()
        before = live.odometer_check.wrong
        reading = live.read_odometer(shown_mm)
        wrong = live.odometer_check.wrong
        if wrong and not before:
            self._say("odometer", f"the odometer is not used: {wrong}")
        elif before and not wrong:
            self._say("odometer", "the odometer is used again", over=True)
        if reading is not None:
            time_us, distance_mm = reading
            self._fresh.append((time_us, distance_mm / 1e3))
            if self._learn is not None:
                self._readings[time_us] = distance_mm

    def _count_misfits(self, result: LiveResult) -> None:
        self.health.misfits += int(np.count_nonzero(result.matches["misfit"] >= OFF_MAP_MISFIT))

    def _look_at_misfit(self, misfit: int) -> None:
        """Report when views become unlike those of the map, and when they are like them again."""
        if not self._strange and misfit >= OFF_MAP_MISFIT:
            self._strange = True
            self._say(
                "misfit",
                f"{OFF_MAP_TEXT}: what is seen has not fitted the matched places for some windows",
            )
        elif self._strange and misfit < OFF_MAP_MISFIT // 2:
            self._strange = False
            self._say("misfit", "what is seen fits the map again", over=True)

    def _end(self) -> LiveStep:
        """Take the last matches, close the link and complete the recordings."""
        now = time.monotonic()
        nothing = LiveStep(None, now, int(1e6 * time.time()), self._new_readings())
        if self.ended:
            return nothing
        self.decoder.health.cut_off = bool(self._reader.lost_link)
        self.ended = True
        result = self._live_or_raise().finish()
        self._count_misfits(result)
        self._write_events(result.events)
        if self._keeper is not None:
            self._keeper.close(self._state_now() if self.health.bytes else None)
        self._stack.close()
        self.decoder.health.line_errors = self._reader.line_errors
        for writer in self._writers:
            self._look_at(writer)
        return nothing._replace(result=result, matches=self._matches(result, nothing.host_us))

    def _raise_once(self) -> None:
        if self._raised or not self.ended:
            return
        self._raised = True
        if self._reader.error is not None:
            raise self._reader.error
        for writer in self._writers:
            if writer.error is not None and (self.health.events == 0 or writer.path == self._drive):
                raise self._no_events(writer.error)

    def _live_or_raise(self) -> LiveLocaliser:
        assert self._live is not None
        return self._live

    def _new_readings(self) -> tuple[tuple[int, float], ...]:
        if not self._fresh:
            return ()
        fresh, self._fresh = tuple(self._fresh), []
        return fresh

    def _say(self, kind: str, text: str, *, over: bool = False) -> None:
        message = Message(kind, text, over)
        if self.on_message is not None:
            self.on_message(message)
        elif not over:
            _LOG.warning("%s", printable(text))

    # -- state

    def _resume(self, host_us: int) -> None:
        """Go on from the state of the file, now that the first bytes have come, or say why not."""
        saved, self._resumable = self._resumable, None
        limit_s = self.decoder.longest_silence_us / 1e6
        if isinstance(saved, Resumable):
            passed_us = host_us - saved.values["host_us"]
            if not self._reader.live:
                saved = "it is of a live line, and this is none"
            elif passed_us < 0:
                saved = "by this machine's clock it was kept later than now"
            elif passed_us > 1e6 * limit_s:
                saved = f"it is {passed_us / 1e6:,.0f} s old, of at most {limit_s:.0f} s"
            else:
                self._live_or_raise().resume(saved, passed_us)
                self._say("state", f"goes on after {passed_us / 1e6:.1f} s", over=True)
        if isinstance(saved, str):
            self._say("state", f"{self._state} is not used, matching starts afresh: {saved}")

    def _state_now(self) -> LiveState:
        arrays, values = self._live_or_raise().to_state()
        return LiveState(arrays, values | {"of": self._checksum, "host_us": self._heard_us})

    def _keep_state(self) -> None:
        """Hand the state to its writer now and then, and report once that it cannot be written."""
        keeper = self._keeper
        if keeper is None or not keeper.due():
            return
        keeper.offer(self._state_now())
        if keeper.error and not self._unkept:
            self._say("state", f"the state is not kept: {keeper.error}")
        self._unkept = keeper.error

    # -- files

    def _write_raw(self, file: FileIO, data: bytes) -> None:
        """Write bytes; give up a file that cannot be written."""
        left = memoryview(data)
        try:
            while left:
                left = left[file.write(left) :]
        except OSError as error:
            self._raw.remove(file)
            self._give_up(ends_early(str(file.name), error))

    def _write_events(self, events: Events) -> None:
        for writer in self._writers:
            if events.size:
                writer.write(events)
            self._look_at(writer)

    def _look_at(self, writer: _EventWriter) -> None:
        """Report an error of a writer once; without its drive, learning ends."""
        if writer.error is None or writer.reported:
            return
        writer.reported = True
        if writer.path == self._drive:
            self.stop()
        elif self.health.events:
            self._give_up(str(writer.error))

    def _give_up(self, text: str) -> None:
        self.unwritten = text
        self._say("file", f"{text}; going on without it")

    def _no_events(self, error: Exception) -> Exception:
        if self.health.events or not isinstance(error, RecordingError):
            return error
        return RecordingError(f"no events came from {self.address}: check protocol= and baud=")

    # -- learning

    def _make_map(self, drive: Path, target: Path) -> None:
        """Make the map of the drive; keep the drive if it makes none."""
        odometry = None
        if self._readings:
            odometry = Odometry(
                np.array(list(self._readings), dtype=np.int64),
                np.array(list(self._readings.values()), dtype=np.int64),
            )
        if not drive.exists():
            return
        try:
            reference = self.reference
            if reference is not None and (
                self._settings.at_places_of(reference.settings).of_map == reference.settings.of_map
            ):
                # aligned by whole drives, whatever the settings that it was matched with
                known = reference.matched_with(self._settings)
                self.update = known.update(drive, odometry=odometry, removed=self.removed)
                self.learnt = self.update.reference
            else:
                self.learnt = ReferenceMap.build(
                    drive, self._settings, odometry=odometry, removed=self.removed
                )
            self.learnt.save(target, overwrite=self._overwrite)
            drive.unlink()
        finally:
            if drive.exists():
                self._keep(drive, target, odometry)

    def _keep(self, drive: Path, target: Path, odometry: Odometry | None) -> None:
        """Keep a drive that gave no map, and say how to continue with it."""
        stems = (target.with_name(f"{target.stem}_drive{n or ''}") for n in count())
        kept = next(
            stem.with_suffix(".npz") for stem in stems if not stem.with_suffix(".npz").exists()
        )
        drive.replace(kept)
        words = ["edge-vpr", "map", printable(kept), "-o", printable(target)]
        if odometry is not None:
            table = kept.with_suffix(".csv")
            save_odometry(table, odometry)
            words += ["--odometry", printable(table)]
        self._say("drive", f"the drive is kept: {' '.join(words)}")


class _EventWriter:
    """Writes events to a recording in a thread, as formats pull what they write."""

    def __init__(self, path: Path, sensor: Sensor, overwrite: bool) -> None:
        self.path, self.reported = path, False
        self.error: Exception | None = None
        self._waiting: queue.Queue[Events | None] = queue.Queue(_MOST_WAITING)
        self._thread = threading.Thread(
            target=self._run, args=(sensor, overwrite), name="edge-vpr recording", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Complete the file."""
        self.write(None)
        self._thread.join()

    def write(self, events: Events | None) -> None:
        """Append events (None ends the file); waits for a disk that is slower than the camera."""
        while self._thread.is_alive():
            with contextlib.suppress(queue.Full):
                self._waiting.put(events, timeout=0.1)
                return

    def _run(self, sensor: Sensor, overwrite: bool) -> None:
        try:
            write_recording(self.path, self._pieces(), sensor=sensor, overwrite=overwrite)
        except Exception as error:  # an error in the thread would go unnoticed
            self.error = error

    def _pieces(self) -> Iterator[Events]:
        while (events := self._waiting.get()) is not None:
            yield events


class _LineWatch:
    """Greets a silent device, and reports once when a line is silent, lost or undecodable.

    Parameters
    ----------
    say : callable
        Takes the kind and the text of a message, and `over`.
    """

    def __init__(self, reader: LinkReader, decoder: Decoder, say: Callable[..., None]) -> None:
        self._reader, self._decoder, self._say = reader, decoder, say
        self._heard_s = self._greeted_s = self._newest_s = time.monotonic()
        self._silent = self._closed = False
        self._remark = self._senseless = self._stranger = ""

    @property
    def silent_s(self) -> float:
        """Seconds since the newest bytes."""
        return time.monotonic() - self._newest_s

    def heard(self, at_s: float) -> None:
        """Note that bytes have arrived."""
        self._heard_s = self._newest_s = at_s
        if self._silent:
            self._silent = False
            self._say("stalled", f"bytes come again from {self._reader.address}", over=True)

    def look(self, *, nothing_came: bool) -> None:
        """Report what has changed since the last call."""
        if nothing_came:
            self._look_at_silence()
        decoder, reader, say = self._decoder, self._reader, self._say
        if not self._senseless and (senseless := _senseless_bytes(decoder.health)):
            self._senseless = senseless
            say("senseless", senseless)
        if decoder.remark != self._remark:
            self._remark = decoder.remark
            say("device", self._remark or "the device answers", over=not self._remark)
        if reader.remark != self._stranger:
            self._stranger = reader.remark
            say("sender", self._stranger or "another sender is heard", over=not self._stranger)

    def _look_at_silence(self) -> None:
        reader = self._reader
        now = time.monotonic()
        if bool(reader.lost_link) != self._closed:
            self._closed = not self._closed
            said = f"{reader.lost_link}; trying again" if self._closed else "open again"
            self._say("link", said, over=not self._closed)
            self._heard_s = now
        elif not self._closed and now - max(self._heard_s, self._greeted_s) > GREET_S:
            # the device may have started after the link was opened, or again; what it does not
            # read now is not waited for
            self._greeted_s = now
            reader.send(self._decoder.greeting(), timeout=0.0)
        if not (self._silent or self._closed or reader.ended) and (now - self._heard_s > SILENT_S):
            self._silent = True
            self._decoder.health.stalls += 1
            self._say("stalled", f"no bytes for {SILENT_S:g} s from {reader.address}")


class _LagWatch:
    """Compares the clocks of camera and host, and reports when the host falls behind.

    Parameters
    ----------
    health : Health
        Gets the lag.
    limit_us : float
        Lag that is reported.
    say : callable
        Takes the kind and the text of a message, and `over`.
    live : bool
        Whether the sender goes on without waiting for the host.
    """

    def __init__(
        self, health: Health, limit_us: float, say: Callable[..., None], *, live: bool
    ) -> None:
        self._health, self._limit_us, self._say, self._live = health, limit_us, say, live
        self._behind = False
        self._newest_us, self._restarts = 0, -1
        self._since_s = 0.0
        # smallest differences of the clocks, of this stretch of time and of the one before
        self._least_us = self._before_us = math.inf

    def look(self, events: Events, reached_us: int, now_s: float) -> None:
        """Compare the time at which events were matched with that of the oldest of them."""
        health = self._health
        t_us = int(events["t"][0]) if events.size else reached_us
        restarts = health.clock_resets + health.clock_jumps + health.device_resets
        if restarts != self._restarts or now_s - self._since_s > _LAG_S:
            before = self._least_us if restarts == self._restarts else math.inf
            self._restarts, self._since_s = restarts, now_s
            self._before_us, self._least_us = before, math.inf
        if t_us <= self._newest_us:
            return
        self._newest_us = t_us
        apart_us = 1e6 * now_s - t_us
        self._least_us = min(self._least_us, apart_us)
        lag_us = int(apart_us - min(self._least_us, self._before_us))
        health.lag_us = lag_us
        health.longest_lag_us = max(health.longest_lag_us, lag_us)
        if not self._behind and lag_us > self._limit_us:
            self._behind = True
            self._say(
                "lag",
                f"events are matched {lag_us / 1e6:.1f} s late: this machine is busy with "
                "something else, or the line is slower than the camera",
            )
        elif self._behind and lag_us < self._limit_us / 2:
            self._behind = False
            self._say("lag", "events are matched in time again", over=True)

    def age_s(self, time_us: int, now_s: float) -> float:
        """Return how long ago something happened by the camera's clock; NaN if it is not known."""
        least_us = min(self._least_us, self._before_us)
        if not self._live or least_us == math.inf:
            return math.nan
        return max(0.0, now_s - (time_us + least_us) / 1e6)


def ends_early(path: str, error: OSError) -> str:
    """Return the message that no more can be written to a file."""
    return (
        f"{printable(path)} ends early: {error.strerror}: check its permissions and the free space"
    )


def nothing_valid(health: Health) -> str:
    """Return what to check if hardly any byte, or none at all, was valid; else empty text."""
    if not health.bytes:
        return "no bytes came: check that this is the camera's port, and that the camera is on"
    if not health.decoded_bytes:
        return f"none of {health.bytes:,} bytes are of this protocol: check protocol= and baud="
    return _senseless_bytes(health)


def _senseless_bytes(health: Health) -> str:
    """Return a warning if most bytes do not decode, or most events are off the sensor."""
    if health.skipped_bytes > SENSELESS_BYTES and (
        health.decoded == 0 or health.skipped_bytes > 9 * health.decoded_bytes
    ):
        return (
            f"{health.skipped_bytes:,} of {health.bytes:,} bytes are not of this protocol: check "
            "protocol= and baud="
        )
    if health.off_sensor > max(SENSELESS_EVENTS, health.events):
        return (
            f"{health.off_sensor:,} of {health.decoded:,} events are not on this sensor: check "
            "sensor=, or the map"
        )
    return ""


_SUCH_AS = "a text such as '500ms'"


def _seconds(text: str | None, name: str) -> float | None:
    if text is None:
        return None
    expect(text, str, name, _SUCH_AS)
    return duration_us(text) / 1e6


def _check_odometry(odometry: str | None) -> None:
    if odometry is None:
        return
    expect(odometry, str, "odometry", "the odometer's port as text")
    if Path(odometry).is_file():
        raise UsageError(
            f"odometry {odometry} is a file, and a live odometer is read as the robot drives: "
            "match a recording with edge-vpr match --odometry"
        )


def _loaded(reference: ReferenceMap | str | Path | None) -> ReferenceMap | None:
    if isinstance(reference, str | Path):
        return ReferenceMap.load(reference)
    if reference is not None:
        expect(reference, ReferenceMap, "reference", "a ReferenceMap or the path of one")
    return reference


def _heartbeat(given: int, jumps: int) -> LiveMatch:
    return LiveMatch(
        time_s=math.nan, query=given, place=-1, distance=math.nan, second=-1,
        second_distance=math.nan, ratio=math.nan, events=0, start_s=math.nan, trust=0, misfit=-1,
        probability=0.0, lost=True, missing=1.0, age_s=math.nan, host_us=int(1e6 * time.time()),
        jumps=jumps,
    )  # fmt: skip


def _sensor_of(
    sensor: Sensor | tuple[int, int] | str | None, reference: ReferenceMap | None
) -> Sensor:
    if sensor is not None:
        return Sensor.of(sensor)
    if reference is None:
        raise UsageError("the size of the sensor is not known: pass sensor= or reference=")
    return reference.pixel_map.sensor


def check_recorded(path: Path, argument: str) -> None:
    """Check that bytes or events can be recorded in a file of this name.

    Parameters
    ----------
    argument : str
        That names the file, for the message.
    """
    if path.suffix == ".bin":
        return
    try:
        writable_format(path)
    except UsageError as error:
        known = ", ".join(WRITTEN)
        raise UsageError(f"{argument} {path}: expected .bin for bytes, or {known}") from error


def _is_recording(path: Path) -> bool:
    # a .raw without the header of Prophesee can be bytes of a camera
    if path.suffix == ".raw":
        with path.open("rb") as file:
            return file.read(2) == b"% "
    return path.suffix in _OF_RECORDINGS


def _opener(link: Any, baud: int, flow_control: bool) -> tuple[Callable[[], Link], bool]:
    """Return what opens a link, and whether it can be opened again."""
    if isinstance(link, str | os.PathLike):
        address = os.fspath(link)
        if not isinstance(address, str):
            raise UsageError(f"link {address!r}: expected text, not bytes")
        if Path(address).is_file() and archive_kind(address) == MAP_KIND:
            raise UsageError(
                f"{address} is a map, and a live session reads the bytes of a camera: give the map "
                "as reference=, and the camera's port here"
            )
        if Path(address).is_file() and _is_recording(Path(address)):
            raise UsageError(
                f"{address} is a recording, and a live session reads the bytes of a camera: match "
                "it with edge-vpr match --online, or play it with edge-vpr bridge"
            )
        return lambda: open_link(address, baud=baud, flow_control=flow_control), True
    if isinstance(link, Link):
        return lambda: link, False
    if isinstance(link, socket.socket):
        return lambda: SocketLink(f"socket {link.fileno()}", link.dup()), False
    descriptor = link if type(link) is int else _descriptor_of(link)
    name = str(getattr(link, "name", f"descriptor {descriptor}"))
    if descriptor is not None:
        kind = os.fstat(descriptor).st_mode
        live = stat.S_ISCHR(kind) or stat.S_ISSOCK(kind)
        return lambda: DescriptorLink(name, os.dup(descriptor), live=live), False
    if hasattr(link, "read") and hasattr(link, "timeout"):
        return lambda: UrlLink(name, link), False
    raise UsageError(
        f"link {link!r}: expected a port such as '/dev/ttyACM0', tcp://HOST:PORT, a file, or an "
        "open file, socket or serial port"
    )


def _descriptor_of(link: Any) -> int | None:
    try:
        return int(link.fileno())
    except (AttributeError, OSError, ValueError):
        return None
