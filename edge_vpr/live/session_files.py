"""Files of a live session: recordings, a map of its drive, and the state of matching."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from io import FileIO
from itertools import count
from pathlib import Path

import numpy as np

from edge_vpr.descriptors.counting import Removed
from edge_vpr.errors import UsageError, as_path, printable
from edge_vpr.evaluation.tables import save_odometry
from edge_vpr.events import Events, Sensor
from edge_vpr.files import check_new_file, check_new_map, work_folder
from edge_vpr.learning import MapUpdate
from edge_vpr.live.reader import Chunk
from edge_vpr.live.state import StateFile, check_state_file
from edge_vpr.live.stream_matcher import StreamMatcher
from edge_vpr.odometry import Odometry
from edge_vpr.online.localiser import Localiser
from edge_vpr.recordings import WRITTEN, writable_format, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Preset, Settings, resolve_settings

#: Largest number of pieces of events that wait for a file.
_MOST_WAITING = 256


def ends_early(path: str, error: OSError) -> str:
    """Return the message that no more can be written to a file."""
    return (
        f"{printable(path)} ends early: {error.strerror}: check its permissions and the free space"
    )


def _write_whole(file: FileIO, data: bytes) -> None:
    """Write all bytes."""
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]


class _EventWriter:
    """Writes events to a recording in a thread, as formats pull what they write."""

    def __init__(self, path: Path, sensor: Sensor, overwrite: bool) -> None:
        self.path = path
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


class SessionFiles:
    """Files that a live session writes, each of them if it is named.

    A recording that cannot be written is given up, which a message says.

    Parameters
    ----------
    record : path or sequence of paths
        Files of the bytes (``.bin``) or of the events (``.npz``, ``.raw``, ...).
    learn : path, optional
        When the session is closed, write its map, updated with this drive, to this file (see
        `ReferenceMap.update`). If it has none, or if `settings` has other windows, pixels or codes,
        it is a new map of this drive. All the while, the drive is matched with the map as it was.
    settings : Settings or str, optional
        Of the map to write, or the name of a preset; by default those of the session's map.
    state : path, optional
        A file with the suffix ``.state``, in which the session keeps what it knows of the drive,
        every two seconds and at its end; a session with the same map and settings goes on from
        there. A state that is older than a silence of the camera's clock may be (60 s; 600 s where
        a checksum protects times), or is damaged, is not used, and a message says so. After another
        start of the machine its age is not known, and the robot may be as far from there as this
        time allows. Not with `learn`; files and pipes have none. Each session needs a file of its
        own.
    overwrite : bool
        Whether files that exist may be replaced.

    Attributes
    ----------
    learnt : ReferenceMap or None
        The map that was written, after `LiveSession.close`.
    update : MapUpdate or None
        What the session's map has learnt, if it has.
    removed : Removed
        Counts of events that were removed as bursts for that map.
    unwritten : str
        Which recording was given up and why, if one was; else empty.
    keeps_state : bool
        Whether the session's state is kept.
    """

    def __init__(
        self,
        *,
        record: str | Path | Sequence[str | Path] = (),
        learn: str | Path | None = None,
        settings: Settings | Preset | None = None,
        state: str | Path | None = None,
        overwrite: bool = False,
    ) -> None:
        paths = list(record) if isinstance(record, list | tuple) else [record]
        self._record = [as_path(path, "a file to record") for path in paths]
        self._learn = None if learn is None else as_path(learn, "the map to learn")
        self._state = None if state is None else as_path(state, "the state")
        self._settings = resolve_settings(settings) if isinstance(settings, str) else settings
        self._of_map = self._settings  # or those of the session's map
        self._overwrite = overwrite
        self._state_file: StateFile | None = None
        self.keeps_state = state is not None
        self._raw: list[FileIO] = []  # files of bytes
        self._writers: list[_EventWriter] = []
        self._recordings = contextlib.ExitStack()
        self._begun = False  # whether there were events
        self._drive: Path | None = None  # the recording of which the map is made
        self.unwritten = ""
        self._readings: dict[int, int] = {}
        self._heard_s = 0.0
        #: Removes what was needed only while the session was open.
        self.work = contextlib.ExitStack()
        self.learnt: ReferenceMap | None = None
        self.update: MapUpdate | None = None
        self.removed = Removed()

    @property
    def error(self) -> Exception | None:
        """Why the drive to learn from cannot be recorded, or any recording without events."""
        return next((each.error for each in self._writers if each.error is not None), None)

    # What follows is called by the session, in this order.

    def check(self, reference: ReferenceMap | None, inputs: Sequence[Path | None]) -> None:
        """Check, before the link is opened, that the files can be written and replace no other.

        Parameters
        ----------
        reference : ReferenceMap or None
            Map of the session.
        inputs : sequence of (Path or None)
            What the session reads: the link's file, and the map's.
        """
        source, map_file = inputs
        for path in self._record:
            if path.suffix != ".bin":
                try:
                    writable_format(path)
                except UsageError as error:
                    formats = ", ".join(WRITTEN)
                    raise UsageError(
                        f"record='{path}': expected .bin for bytes, or {formats}"
                    ) from error
        if self._state is not None:
            if reference is None or self._learn is not None:
                raise UsageError(
                    f"state {self._state}: it is of matching with a map: give reference=, and "
                    "leave out learn="
                )
            check_state_file(self._state, self._overwrite)
        seen: set[Path] = set()
        for path in filter(None, (*self._record, self._learn)):
            if path.resolve() in seen:
                raise UsageError(f"{path} is named twice: give each file another name")
            seen.add(path.resolve())
            if path is self._learn:  # it may replace the map of the session
                check_new_map(path, [source], self._overwrite)
            else:
                check_new_file(path, [source, map_file], self._overwrite)
        self._of_map = self._settings or (None if reference is None else reference.settings)

    def lock(self, localiser: Localiser | None, say: Callable[..., None]) -> None:
        """Read the state, which no other session can have until `release`."""
        if self._state is not None and localiser is not None:
            self._state_file = StateFile(self._state, localiser, say)

    def open(self, sensor: Sensor, stop: Callable[[], None], say: Callable[..., None]) -> None:
        """Open the recordings: last, so that a missing camera does not overwrite the run before.

        Parameters
        ----------
        stop : callable
            Called when the drive to learn from cannot be recorded.
        say : callable
            Takes the kind and the text of a message.

        Raises
        ------
        OSError
            If a file of bytes cannot be opened.
        """
        self._stop, self._say = stop, say
        # not those of a session before, nor of an opening that failed
        self._raw, self._writers, self._readings = [], [], {}
        self._begun, self.unwritten = False, ""
        with contextlib.ExitStack() as work, contextlib.ExitStack() as recordings:
            if self._learn is not None:
                self._drive = work.enter_context(work_folder(self._learn)) / "drive.npz"
            of_bytes = [path for path in self._record if path.suffix == ".bin"]
            for path in of_bytes:
                self._raw.append(recordings.enter_context(path.open("wb", buffering=0)))
            for path in filter(None, (*self._record, self._drive)):
                if path not in of_bytes:
                    self._writers.append(_EventWriter(path, sensor, self._overwrite))
                    recordings.callback(self._writers[-1].close)
            self.work, self._recordings = work.pop_all(), recordings.pop_all()

    def take_bytes(self, chunk: Chunk, matcher: StreamMatcher, *, live: bool) -> None:
        """Record bytes before they are decoded; go on from the state when the first come.

        Parameters
        ----------
        live : bool
            Whether the link is.
        """
        self._heard_s = chunk.at_s
        for file in list(self._raw):
            try:
                _write_whole(file, chunk.data)
            except OSError as error:
                self._raw.remove(file)
                self._give_up(ends_early(str(file.name), error))
        if self._state_file is not None:
            self._state_file.resume(matcher, chunk.at_s, live_line=live)

    def take_events(self, events: Events) -> None:
        """Record events."""
        if events.size:
            self._begun = True
            for writer in self._writers:
                writer.write(events)
        self._give_up_failed()

    def take_reading(self, time_us: int, distance_mm: int) -> None:
        """Take a reading of the robot's odometer."""
        if self._learn is not None:
            self._readings[time_us] = distance_mm

    def keep(self, matcher: StreamMatcher) -> None:
        """Keep the state now and then."""
        if self._state_file is not None:
            self._state_file.keep(matcher, self._heard_s)

    def end(self, matcher: StreamMatcher) -> None:
        """Keep the last state, and complete the recordings."""
        if self._state_file is not None:
            self._state_file.close(matcher, self._heard_s)
        self._recordings.close()
        self._give_up_failed()

    def release(self) -> None:
        """Let another session have the state."""
        if self._state_file is not None:
            self._state_file.release()

    def make_map(self, prior: ReferenceMap | None) -> None:
        """Write the map of the drive, unless nothing came; if it makes none, the drive is kept.

        Parameters
        ----------
        prior : ReferenceMap or None
            Map of the session. It learns the drive, if the settings have its windows, pixels and
            codes; else the map is new.
        """
        drive, target = self._drive, self._learn
        if drive is None or target is None or not drive.exists():
            return
        settings, odometry, update = self._of_map or resolve_settings(), None, None
        learns = prior is not None and (
            settings.at_places_of(prior.settings).of_map == prior.settings.of_map
        )
        if self._readings:
            odometry = Odometry(
                np.array(list(self._readings), dtype=np.int64),
                np.array(list(self._readings.values()), dtype=np.int64),
            )
        try:
            if prior is not None and learns:
                # aligned by whole drives, whatever the settings that it was matched with
                prior = prior.matched_with(settings)
                update = prior.update(drive, odometry=odometry, removed=self.removed)
                made = update.reference
            else:
                made = ReferenceMap.build(drive, settings, odometry=odometry, removed=self.removed)
            made.save(target, overwrite=self._overwrite)
            drive.unlink()
        finally:
            if drive.exists():
                _keep(drive, target, odometry, self._say, learns=learns)
        self.learnt, self.update = made, update

    def _give_up_failed(self) -> None:
        for writer in [each for each in self._writers if each.error is not None]:
            if writer.path == self._drive:
                self._stop()
            elif self._begun:
                self._writers.remove(writer)
                self._give_up(str(writer.error))

    def _give_up(self, text: str) -> None:
        self.unwritten = text
        self._say("file", f"{text}; going on without it")


def _keep(
    drive: Path, target: Path, odometry: Odometry | None, say: Callable[..., None], *, learns: bool
) -> None:
    """Keep a drive that gave no map, or that a map did not learn; say how to continue with it."""
    stems = (target.with_name(f"{target.stem}_drive{n or ''}") for n in count())
    kept = next(stem.with_suffix(".npz") for stem in stems if not stem.with_suffix(".npz").exists())
    drive.replace(kept)
    words = ["edge-vpr", "map", printable(kept), "-o", printable(target)]
    if odometry is not None:
        table = kept.with_suffix(".csv")
        save_odometry(table, odometry)
        words += ["--odometry", printable(table)]
    new = " makes a new map of it, and adds nothing to the old one" * learns
    say("drive", f"the drive is kept: {' '.join(words)}{new}")
