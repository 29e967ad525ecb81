"""Recordings of a session: bytes as they come, and events in files of any format."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from io import FileIO
from pathlib import Path

from edge_vpr.errors import UsageError, printable
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings import WRITTEN, writable_format, write_recording

#: Largest number of pieces of events that wait for a file.
_MOST_WAITING = 256


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


def ends_early(path: str, error: OSError) -> str:
    """Return the message that no more can be written to a file."""
    return (
        f"{printable(path)} ends early: {error.strerror}: check its permissions and the free space"
    )


class Recorder:
    """Writes bytes and events to files, and gives up those that cannot be written.

    Parameters
    ----------
    paths : sequence of Path
        Of bytes, if they end in ``.bin``, or of events.
    drive : Path or None
        One more recording of events, without which the session has no purpose.
    stop : callable
        Called when `drive` cannot be written.
    say : callable
        Takes the kind and the text of a message.
    overwrite : bool
        Whether files that exist may be replaced.

    Attributes
    ----------
    unwritten : str
        Which file was given up and why, if one was.

    Raises
    ------
    OSError
        If a file of bytes cannot be opened.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        drive: Path | None,
        sensor: Sensor,
        stop: Callable[[], None],
        say: Callable[..., None],
        *,
        overwrite: bool,
    ) -> None:
        self.unwritten = ""
        self._drive, self._stop, self._say = drive, stop, say
        self._begun = False  # whether there were events
        with contextlib.ExitStack() as stack:
            self._raw = [
                stack.enter_context(path.open("wb", buffering=0))
                for path in paths
                if path.suffix == ".bin"
            ]
            targets = [path for path in (*paths, drive) if path and path.suffix != ".bin"]
            self._writers = [EventWriter(path, sensor, overwrite) for path in targets]
            for writer in self._writers:
                stack.callback(writer.close)
            self._files = stack.pop_all()

    def close(self) -> None:
        """Complete the files."""
        self._files.close()
        self._give_up_failed()

    @property
    def error(self) -> Exception | None:
        """Why `drive` cannot be written, or any recording if there were no events."""
        return next((each.error for each in self._writers if each.error is not None), None)

    def write_bytes(self, data: bytes) -> None:
        """Write bytes to their files."""
        for file in list(self._raw):
            try:
                _write_all(file, data)
            except OSError as error:
                self._raw.remove(file)
                self._give_up(ends_early(str(file.name), error))

    def write_events(self, events: Events) -> None:
        """Append events to their recordings."""
        if events.size:
            self._begun = True
            for writer in self._writers:
                writer.write(events)
        self._give_up_failed()

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


def _write_all(file: FileIO, data: bytes) -> None:
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]


class EventWriter:
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
