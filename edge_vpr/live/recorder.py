"""Recordings of a live session: their names, bytes written whole, and events by a thread."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

from edge_vpr.errors import UsageError, printable
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings import WRITTEN, writable_format, write_recording

#: Largest number of pieces of events that wait for a file.
_MOST_WAITING = 256


def check_recorded(path: Path) -> None:
    """Check that bytes or events can be recorded in a file of this name."""
    if path.suffix == ".bin":
        return
    try:
        writable_format(path)
    except UsageError as error:
        suffixes = ", ".join(WRITTEN)
        raise UsageError(f"record='{path}': expected .bin for bytes, or {suffixes}") from error


def ends_early(path: str, error: OSError) -> str:
    """Return the message that no more can be written to a file."""
    return (
        f"{printable(path)} ends early: {error.strerror}: check its permissions and the free space"
    )


def write_whole(file: FileIO, data: bytes) -> None:
    """Write all bytes."""
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
