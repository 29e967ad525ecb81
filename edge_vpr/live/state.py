"""State of a live session in a file, from which a program that is started again goes on.

A state is what matching has learnt of the drive: the events of the newest windows, the place
filter, the running mean, the position, and the camera's clock. It belongs to one map with its
settings. To go on from it is like a link that was lost and opened again.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

from edge_vpr.archive import Arrays, archive_errors, read_archive, write_archive
from edge_vpr.errors import EdgeVprError, UsageError, printable
from edge_vpr.map_record import MapRecord
from edge_vpr.online.localiser import Localiser, MatchSchedule
from edge_vpr.warm_up import WarmUpStep

KIND = "live state"
#: Suffix of its file, so that it replaces neither a map nor a recording.
SUFFIX = ".state"
#: Interval at which a session keeps its state.
KEEP_S = 2.0


class LiveState(NamedTuple):
    """State of a session at one time."""

    arrays: Arrays  #: See `MatchRun.to_arrays`; without the places, which are the map's.
    values: dict[str, Any]  #: Of JSON.


class Resumable(NamedTuple):
    """A localiser with the state of a file, and the other values of this state."""

    localiser: Localiser
    values: dict[str, Any]


def check_state_file(path: Path) -> None:
    """Check that a state can be kept in a file of this name."""
    if path.suffix != SUFFIX:
        raise UsageError(f"state {path}: expected a file of its own, such as live{SUFFIX}")
    if not path.parent.is_dir():
        raise UsageError(f"state {path}: there is no folder {path.parent}: make it first")


def state_steps(reference: MapRecord, every: MatchSchedule | None) -> list[WarmUpStep]:
    """Return the warm-up of keeping a state and of going on from it."""

    def keep_and_resume() -> None:
        run = Localiser(reference, every=every).run
        Localiser(reference, every=every).run.resume(run.to_arrays(), run.now_us, run.floor_us)

    return [WarmUpStep("state", keep_and_resume)]


def read_state(path: Path, localiser: Localiser, checksum: str) -> Resumable | str | None:
    """Read the state of a file.

    Parameters
    ----------
    localiser : Localiser
        A new one, which gets the state, and is of no use if the state is damaged.
    checksum : str
        Of this localiser, see `Localiser.checksum`.

    Returns
    -------
    Resumable, str or None
        Or why it cannot be used; None if there is no file.
    """
    if not path.exists():
        return None
    try:
        arrays, values = read_archive(path, KIND)
        with archive_errors(path, "delete it", KIND):
            if values["of"] != checksum:
                return "it is of another map, of other settings or of another edge-vpr"
            localiser.run.resume(arrays, values["now_us"], values["floor_us"])
    except EdgeVprError:
        return "it is damaged, or is no state, or cannot be read"
    return Resumable(localiser, values)


class StateWriter:
    """Writes states to a file in a thread, each in place of the one before."""

    def __init__(self, path: Path) -> None:
        self.error = ""  #: Why the newest could not be written.
        self._path = path
        self._due_s = time.monotonic() + KEEP_S
        # a disk that is slow gets fewer of them, and no match waits for it
        self._waiting: queue.Queue[LiveState | None] = queue.Queue(1)
        self._thread = threading.Thread(target=self._run, name="edge-vpr state", daemon=True)
        self._thread.start()

    def due(self) -> bool:
        """Return whether a state is to be offered now."""
        now = time.monotonic()
        if now < self._due_s or self._waiting.full():
            return False
        self._due_s = now + KEEP_S
        return True

    def offer(self, state: LiveState) -> None:
        """Write a state, unless one waits to be written."""
        with contextlib.suppress(queue.Full):
            self._waiting.put_nowait(state)

    def close(self, last: LiveState | None) -> None:
        """Write the last state, and end."""
        for state in (last, None) if last is not None else (None,):
            self._waiting.put(state)
        self._thread.join()

    def _run(self) -> None:
        while (state := self._waiting.get()) is not None:
            try:
                write_archive(self._path, KIND, state.arrays, state.values)
                self.error = ""
            except (EdgeVprError, OSError) as error:
                self.error = printable(error)
