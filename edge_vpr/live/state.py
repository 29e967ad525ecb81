"""State of a live session in a file, from which a program that is started again goes on.

`StateFile` reads it when a session begins, and keeps it until the session ends. A state is what
matching has learnt of the drive: the events of the newest windows, the place filter, the running
mean, the position, and the camera's clock. It belongs to one map with its settings. To go on from
it is like a link that was disconnected and opened again.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from edge_vpr.archive import Arrays, archive_errors, read_archive, write_archive
from edge_vpr.errors import EdgeVprError, UsageError, printable
from edge_vpr.live.localiser import LiveLocaliser
from edge_vpr.map_record import MapRecord
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.warm_up import WarmUpStep

KIND = "live state"
#: Suffix of its file, so that it replaces neither a map nor a recording.
SUFFIX = ".state"
#: Interval at which a session keeps its state.
KEEP_S = 2.0


class LiveState(NamedTuple):
    """State of a session at one time."""

    arrays: Arrays  #: See `LiveLocaliser.to_state`.
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


class StateFile:
    """Goes on from the state of a file, and keeps the state of a live line there.

    Parameters
    ----------
    reference : MapRecord
        Map of the session.
    every : MatchSchedule or None
        Its schedule.
    say : callable
        Takes the kind and the text of a message, and `over`.
    """

    def __init__(
        self,
        path: Path,
        reference: MapRecord,
        every: MatchSchedule | None,
        say: Callable[..., None],
    ) -> None:
        localiser = Localiser(reference, every=every)
        self._path, self._say = path, say
        self._checksum = localiser.checksum()
        self._saved = read_state(path, localiser, self._checksum)
        self._writer: StateWriter | None = None
        self._reported = ""

    def resume(self, live: LiveLocaliser, host_us: int, *, live_line: bool) -> None:
        """Go on from the state of the file when the first bytes come, or say why not."""
        saved, self._saved = self._saved, None
        limit_us = live.decoder.timestamps.longest_silence_us
        if isinstance(saved, Resumable):
            passed_us = host_us - saved.values["host_us"]
            if not live_line:
                saved = "it is of a live line, and this is none"
            elif passed_us < 0:
                saved = "by this machine's clock it was kept later than now"
            elif passed_us > limit_us:
                saved = f"it is {passed_us / 1e6:,.0f} s old, of at most {limit_us / 1e6:.0f} s"
            else:
                live.resume(*saved, passed_us)
                self._say("state", f"goes on after {passed_us / 1e6:.1f} s", over=True)
        if isinstance(saved, str):
            self._say("state", f"{self._path} is not used, matching starts afresh: {saved}")
        if self._writer is None and live_line:
            self._writer = StateWriter(self._path)
        elif self._writer is None and not self._reported:
            self._reported = "no live line"
            self._say("state", "a file or pipe is read again from its start: no state is kept")

    def keep(self, live: LiveLocaliser, host_us: int) -> None:
        """Hand the state to its writer now and then, and report once that it cannot be written.

        Parameters
        ----------
        host_us : int
            When the newest bytes came.
        """
        writer = self._writer
        if writer is None or not writer.due():
            return
        writer.offer(self._state(live, host_us))
        if writer.error and not self._reported:
            self._say("state", f"the state is not kept: {writer.error}")
        self._reported = writer.error

    def close(self, live: LiveLocaliser, host_us: int) -> None:
        """Keep the last state."""
        if self._writer is not None:
            self._writer.close(self._state(live, host_us))

    def _state(self, live: LiveLocaliser, host_us: int) -> LiveState:
        arrays, values = live.to_state()
        return LiveState(arrays, values | {"of": self._checksum, "host_us": host_us})


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

    def close(self, last: LiveState) -> None:
        """Write the last state, and end."""
        self._waiting.put(last)
        self._waiting.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (state := self._waiting.get()) is not None:
            try:
                write_archive(self._path, KIND, state.arrays, state.values)
                self.error = ""
            except (EdgeVprError, OSError) as error:
                self.error = printable(error)
