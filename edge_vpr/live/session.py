"""A live session: a link, matching, the robot's odometer, files, and messages to the user."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self, Unpack

from edge_vpr.compiling import have_kernels
from edge_vpr.errors import RecordingError, UsageError, expect, printable
from edge_vpr.events import Events, Sensor
from edge_vpr.live.links import Line, link_opener
from edge_vpr.live.odometer import OdometerReader
from edge_vpr.live.protocols import Health, ProtocolName, open_decoder
from edge_vpr.live.reader import LinkReader
from edge_vpr.live.rehearsal import rehearse
from edge_vpr.live.session_files import SessionFiles
from edge_vpr.live.stream_matcher import LiveResult, StreamMatcher
from edge_vpr.live.watches import SILENT_S, LagWatch, LineWatch, MisfitWatch
from edge_vpr.matching.match import Match, heartbeat
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.run_log import compiling_reported
from edge_vpr.settings import (
    MatchingChanges,
    PartName,
    duration_us,
)

#: seconds after which a step ends for which no bytes came
_TICK_S = 0.1
#: Largest number of pieces of bytes that one `LiveSession.poll` matches.
_MOST_PIECES = 16

#: Readings of the odometer wait for events that are older than they are by more.
_APART_S = 0.05
#: Most readings that wait, the newest ones.
_MOST_SHOWN = 4_096

_LOG = logging.getLogger("edge_vpr.live")


class Message(NamedTuple):
    """Something that happened to a session.

    Attributes
    ----------
    kind : str
        ``link`` (disconnected or opened), ``state`` (whether it was resumed), ``stalled``
        (silence), ``lag`` (the host is too slow), ``misfit`` (another place or light), ``device``
        and ``sender`` (remarks on the camera and on a second one), ``senseless`` (bytes that do not
        decode), ``odometer``, ``compiling``, ``file`` (given up), or ``drive`` (kept).
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

    events: Events | None  #: None if nothing came.
    at_s: float  #: When the bytes came, on the clock of `time.monotonic`.
    #: Readings of the odometer since the step before: time in microseconds of the camera's clock,
    #: and metres.
    odometry: tuple[tuple[int, float], ...] = ()
    matches: tuple[Match, ...] = ()


class LiveStatus(NamedTuple):
    """State of a session now."""

    health: Health
    #: Share of the first match's windows that has passed; there are matches from 1 on.
    filled: float = 0.0
    lost_link: str = ""  #: Why the link is disconnected; empty while it is open.
    dead_s: float = 0.0  #: Seconds for which the link was disconnected, in all so far.
    max_age_s: float = math.inf  #: Age beyond which a match is lost.
    bursts_removed: int = 0  #: Events removed as bursts.
    no_odometry: bool = False  #: Whether no reading has come of the odometer that the session has.


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

    The session owns the link, its files and a `StreamMatcher`, which has the decoder and the
    localiser. All kernels are loaded or compiled before the link is opened, so that a camera never
    waits for a compiler.

    Parameters
    ----------
    line : Line, str, Path or object
        Where the camera is: a `Line`, or only its link: a serial port, ``tcp://HOST:PORT``, a file
        of bytes, an open socket, ...
    protocol : str
        Of the camera: ``evpr``, ``edvs``, ``evt3``, ..., with options after a colon.
    reference : ReferenceMap or path, optional
        Without one, events are decoded and recorded, and nothing is matched.
    every : str or MatchSchedule, optional
        When to give a match: ``50ms`` (the default), ``event``, ``window``, ``change``, or a number
        of events.
    sensor : Sensor or str, optional
        Such as ``128x128``; by default the map's.
    heartbeat : str, optional
        Yield a heartbeat (see `Match`) whenever no match came for this time, such as ``500ms``;
        longer than a window if matches come at its end.
    odometry : str, optional
        Where the robot sends its odometer, see `open_link`; not a file.
    max_age : str, optional
        A match that is older than this when it is given is `lost`, with a `probability` of 0; by
        default two windows.
    files : SessionFiles, optional
        Recordings, a map of the drive, the state of matching.
    on_message : callable, optional
        Called with each `Message`; by default problems go to the logger ``edge_vpr.live``.
    **changes
        Single settings of matching that replace those of `reference`, such as ``precision=0.99``,
        below which matches are rejected (`lost`).

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
    files : SessionFiles
        Also what was written.
    """

    def __init__(
        self,
        line: Any,
        *,
        protocol: ProtocolName | PartName,
        reference: ReferenceMap | str | Path | None = None,
        every: str | MatchSchedule | None = None,
        sensor: Sensor | tuple[int, int] | str | None = None,
        heartbeat: str | None = None,
        odometry: str | None = None,
        max_age: str | None = None,
        files: SessionFiles | None = None,
        on_message: Callable[[Message], object] | None = None,
        **changes: Unpack[MatchingChanges],
    ) -> None:
        expect(protocol, str, "protocol", "its name, such as 'edvs'")
        _check_odometry(odometry)
        self._heartbeat_s = _seconds(heartbeat, "heartbeat") or math.inf
        self._max_age_s = _seconds(max_age, "max_age")
        map_file = Path(reference) if isinstance(reference, str | Path) else None
        loaded = _loaded(reference)
        if loaded is None and changes:
            raise UsageError(f"{', '.join(changes)}: nothing is matched without reference=")
        self.sensor = _sensor_of(sensor, loaded)
        self.reference = None
        if loaded is not None:
            self.reference = loaded.causal_with(None, changes, "LiveSession")
        line = line if isinstance(line, Line) else Line(line)
        source = Path(line.link) if isinstance(line.link, str | os.PathLike) else None
        self.files = SessionFiles() if files is None else files
        self.files.check(loaded, (source, map_file))
        self._protocol = protocol
        self.decoder = open_decoder(protocol, self.sensor)
        if not isinstance(every, MatchSchedule | None):
            expect(every, str, "every", _SUCH_AS)
        self._every = None
        if self.reference is not None:
            self._every = MatchSchedule.parse(every, self.reference.settings)
        self._open_link, reopens = link_opener(
            line.link, line.baud or self.decoder.baud, line.flow_control
        )
        self._address, self._odometry = str(line.link), odometry
        self._reconnect = line.reconnect and reopens
        self._drop, self._max_lag_s = line.drop, line.max_lag_s
        self.on_message = on_message
        self.stopping = threading.Event()
        self.ended = False
        self._warm = self._opened = self._closed = self._raised = False
        self._next_query = self._jumps = self._heard_us = 0
        # readings of the odometer that wait, and when each came
        self._shown: deque[tuple[float, int]] = deque(maxlen=_MOST_SHOWN)
        self._newest: Match | None = None
        self._first_mm: int | None = None  # of the odometer
        self._fresh: list[tuple[int, float]] = []

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

    def warm_up(self) -> None:
        """Load all kernels of this session, or compile them by a few windows of a simulated drive.

        `open` calls this before it opens the link.
        """
        if self._warm:
            return
        protocol, reference = self._protocol, self.reference
        odometry, state = self._odometry is not None, self.files.keeps_state
        types: list[object] = [protocol, self._every, odometry, state]
        if reference is not None:
            measured = (reference.along_mm is None, len(reference.pixel_map))
            types += [reference.settings, reference.places.counts.dtype, *measured]
        with compiling_reported(lambda text: self._say("compiling", text)):
            self._matcher = StreamMatcher(self.decoder, reference, self._every)
            if self._matcher.localiser is not None:
                types.append(self._matcher.localiser.state.windows.sums.dtype)
            have_kernels(
                repr(types),
                lambda: rehearse(
                    protocol, self.sensor, reference, self._every, odometry=odometry, state=state
                ),
            )
        self._warm = True

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
        reference, decoder, files = self.reference, self.decoder, self.files
        with contextlib.ExitStack() as stack:
            files.lock(self._matcher.localiser, self._say)
            stack.callback(files.release)
            self._reader = LinkReader(
                self._open_link, address=self._address,
                setup=decoder.setup(), teardown=decoder.teardown(),
                retry=self._reconnect, drop=self._drop, max_lag_s=self._max_lag_s,
            )  # fmt: skip
            stack.callback(self._reader.stop)
            # a sender that waits for this host, such as a replay, may be faster than the clock
            decoder.live = self._reader.live and self._reader.drops
            self._odometer: OdometerReader | None = None
            if self._odometry is not None:
                self._odometer = OdometerReader(self._odometry, self._say, retry=self._reconnect)
                stack.callback(self._odometer.stop)
            files.open(self.sensor, self.stop, self._say)
            self._stack = stack.pop_all()
        self._line = LineWatch(self._reader, decoder, self._say)
        window_us = SILENT_S * 1e6
        if reference is not None and reference.settings.window == "time":
            window_us = reference.settings.tau_us
        self._lag = LagWatch(decoder.health, window_us, self._say, live=self._reader.live)
        self._misfits = MisfitWatch(decoder.health, self._say)
        self._begin_s = self._beat_s = time.monotonic()
        self._newest_max_age_s = math.inf
        self._opened = True

    def stop(self) -> None:
        """End the session from a signal handler or another thread; iteration then ends."""
        self.stopping.set()

    def close(self) -> None:
        """Close the link, complete the files, and make the map to learn; again is harmless.

        Raises
        ------
        EdgeVprError
            If the drive makes no map; the drive is kept, and a message names its file.
        """
        if self._closed or not self._opened:
            return
        self._closed = True
        with self.files.work:
            self._end()
            self.files.make_map(self.reference)

    # -- matches

    def __iter__(self) -> Iterator[Match]:
        """Yield matches, and heartbeats if they were asked for, until the link ends.

        When none came until the newest was older than `max_age`, that one is given once more.

        A program that takes longer than the matches to come does not fall behind a live camera: of
        matches that were ready at once, those older than half of `max_lag` are left out, but for
        the newest.
        """
        for step in self.steps():
            ready_s = time.monotonic()
            for i, match in enumerate(step.matches, 1):
                waited_s = time.monotonic() - ready_s
                age_s = match.age_s + waited_s
                late = age_s > self._max_lag_s / 2 and self._reader.drops
                if late and i < len(step.matches):
                    continue
                yield match.at_age(age_s, self._oldest_s(match))
            if (now := time.monotonic()) - self._beat_s >= self._heartbeat_s:
                self._beat_s = now
                yield self._heartbeat()

    def poll(self) -> list[Match]:
        """Return the matches that are ready, without waiting; the newest is the last.

        Raises
        ------
        LinkError
            If the link has failed, once its last matches were returned.
        """
        self.open()
        matches: list[Match] = []
        for _ in range(_MOST_PIECES):
            if self.ended:
                if not matches:
                    self._raise_once()
                break
            step = self._take(0.0)
            self._look(step)
            matches += step.matches
            if step.events is None:
                break
        now = time.monotonic()
        if not matches and now - self._beat_s >= self._heartbeat_s:
            self._beat_s = now
            matches.append(self._heartbeat())
        return matches

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
            step = self._take(min(_TICK_S, max(wait_s, 0.0)))
            # a match comes first: what else there is to do can wait
            yield step
            if not self.ended:
                self._look(step)
        self._raise_once()

    @property
    def health(self) -> Health:
        """Counts of what was received, dropped and lost so far."""
        health = self.decoder.health
        if self._opened and not self.ended:
            health.silent_s = self._line.silent_s
            health.cut_off = bool(self._reader.lost_link)
        return health

    @property
    def status(self) -> LiveStatus:
        """State of the session now."""
        if not self._opened:
            return LiveStatus(self.health)
        reader, matcher = self._reader, self._matcher
        return LiveStatus(
            self.health, matcher.filled, reader.lost_link, reader.dead_s, self._newest_max_age_s,
            matcher.bursts_removed, self._odometer is not None and self._first_mm is None,
        )  # fmt: skip

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
        self.decoder.health.line_errors = reader.line_errors
        if chunk is None:
            return LiveStep(None, now, self._new_readings(), self._outdated(now))
        self._line.heard(chunk.at_s)
        # first, so that errors can be reproduced
        self.files.take_bytes(chunk, self._matcher, live=reader.live)
        self._heard_us = int(1e6 * (time.time() - (now - chunk.at_s)))
        since_us = int((chunk.at_s - self._begin_s) * 1e6)
        result = self._matcher.feed(
            chunk.data, since_us, dropped=chunk.dropped, reopened=chunk.reopened
        )
        # before the match is used: a program that fails then has a whole file
        self.files.take_events(result.events)
        self._lag.look(result.events, self.decoder.reached_us, time.monotonic())
        self._misfits.look([match.misfit for match in result.matches])
        matches = self._matches(result, self._heard_us) or self._outdated(time.monotonic())
        return LiveStep(result.events, chunk.at_s, self._new_readings(), matches)

    def _oldest_s(self, match: Match) -> float:
        """Return the age beyond which a match is rejected: by default two windows."""
        return self._max_age_s or 2 * (match.time_us - match.start_us) / 1e6

    def _heartbeat(self) -> Match:
        return heartbeat(self._next_query, self._jumps, int(1e6 * time.time()))

    def _matches(self, result: LiveResult, host_us: int) -> tuple[Match, ...]:
        """Return the matches of a piece of bytes that came at `host_us`."""
        if not result.matches:
            return ()
        self._beat_s = time.monotonic()
        matches = []
        for match in result.matches:
            age_s = self._lag.age_s(match.time_us, self._beat_s)
            oldest_s = self._newest_max_age_s = self._oldest_s(match)
            then_us = host_us
            if not math.isnan(age_s):
                then_us = int(1e6 * (time.time() - age_s))
            matches.append(match.at_age(age_s, oldest_s, query=self._next_query, host_us=then_us))
            self._next_query, self._jumps = self._next_query + 1, match.jumps
        self._newest = matches[-1]
        return tuple(matches)

    def _outdated(self, now_s: float) -> tuple[Match, ...]:
        """Return the newest match once more, as lost, if none came until it was too old."""
        newest = self._newest
        if newest is None or newest.lost or self._every is None:
            return ()
        # matches at a change of the place hold for as long as the camera is heard
        held_us = self.decoder.reached_us if self._every.change else newest.time_us
        if not self._lag.age_s(held_us, now_s) > self._newest_max_age_s:
            return ()
        age_s = self._lag.age_s(newest.time_us, now_s)
        self._newest = newest.at_age(age_s, self._newest_max_age_s)
        return (self._newest,)

    def _look(self, step: LiveStep) -> None:
        """Do what remains after a step: odometer and messages."""
        if step.events is not None:
            self.files.keep(self._matcher)
        self._look_at_odometer(time.monotonic())
        self._line.look(nothing_came=step.events is None)

    def _look_at_odometer(self, now_s: float) -> None:
        """Give each reading to the filter as soon as the camera's events are of its time.

        Where the line stands still, the events of the way come later than the readings, which would
        move the robot twice: at once, and again with the events.
        """
        if self._odometer is not None and (shown_mm := self._odometer.look()) is not None:
            self._shown.append((now_s, shown_mm))
        while self._shown:
            at_s, shown_mm = self._shown[0]
            if self._lag.age_s(self.decoder.reached_us, at_s) > _APART_S:
                return  # an age that is not known is NaN
            self._shown.popleft()
            self._read_odometer(shown_mm)

    def _read_odometer(self, shown_mm: int) -> None:
        """Give a reading to the filter, and report the first leap."""
        check = self._matcher.odometer_check
        leaps = check.leaps
        reading = self._matcher.read_odometer(shown_mm)
        if check.leaps > leaps == 0:
            self._say(
                "odometer",
                f"the odometer leapt to {shown_mm / 1e3:,.2f} m, faster than 100 m/s: such "
                "readings are left out; send metres",
            )
        if reading is not None:
            time_us, distance_mm = reading
            if self._first_mm is None:
                self._first_mm = distance_mm
            self.decoder.health.odometer_m = (distance_mm - self._first_mm) / 1e3
            self._fresh.append((time_us, distance_mm / 1e3))
            self.files.take_reading(time_us, distance_mm)

    def _end(self) -> LiveStep:
        """Take the last matches, close the link and complete the recordings."""
        now = time.monotonic()
        if self.ended:
            return LiveStep(None, now, self._new_readings())
        self.decoder.health.cut_off = bool(self._reader.lost_link)
        self.ended = True
        result = self._matcher.finish()
        self._misfits.look([match.misfit for match in result.matches])
        self.files.take_events(result.events)
        self.files.end(self._matcher)
        self._stack.close()
        self.decoder.health.line_errors = self._reader.line_errors
        matches = self._matches(result, int(1e6 * time.time()))
        return LiveStep(result.events, now, self._new_readings(), matches)

    def _raise_once(self) -> None:
        """Raise what ended the session."""
        if self._raised:
            return
        self._raised = True
        if self._reader.error is not None:
            raise self._reader.error
        error = self.files.error
        if error is None:
            return
        if self.health.events or not isinstance(error, RecordingError):
            raise error
        raise RecordingError(f"no events came from {self.address}: check protocol= and baud=")

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


def _sensor_of(
    sensor: Sensor | tuple[int, int] | str | None, reference: ReferenceMap | None
) -> Sensor:
    if sensor is not None:
        return Sensor.of(sensor)
    if reference is None:
        raise UsageError(
            "the size of the sensor is not known: pass sensor='WIDTHxHEIGHT' or reference="
        )
    return reference.pixel_map.sensor
