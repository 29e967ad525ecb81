"""State of a live session in a file, from which a program that is started again goes on.

`StateFile` reads it when a session begins, and keeps it until the session ends. A state is what
matching has learnt of the drive: the events of the newest windows, the place filter, the running
mean, the position, and the camera's clock. It belongs to one map with its settings. To go on from
it is like a link that was disconnected and opened again.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import queue
import threading
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from edge_vpr.archive import Arrays, archive_errors, archive_kind, read_archive, write_archive
from edge_vpr.errors import EdgeVprError, UsageError, printable
from edge_vpr.live.stream_matcher import StreamMatcher
from edge_vpr.online.localiser import Localiser

KIND = "live state"
#: Suffix of its file, so that it replaces neither a map nor a recording.
SUFFIX = ".state"
#: Interval at which a session keeps its state.
KEEP_S = 2.0
#: What Linux draws anew at each start of the machine.
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class LiveState(NamedTuple):
    """State of a session at one time."""

    arrays: Arrays  #: See `StreamMatcher.to_state`.
    values: dict[str, Any]  #: Of JSON.


class Resumable(NamedTuple):
    """A localiser with the state of a file, and the other values of this state."""

    localiser: Localiser
    values: dict[str, Any]


def check_state_file(path: Path, overwrite: bool) -> None:
    """Check that a state can be kept in a file of this name, and that it replaces no other file."""
    if path.suffix != SUFFIX:
        raise UsageError(f"state {path}: expected a file of its own, such as live{SUFFIX}")
    if not path.parent.is_dir():
        raise UsageError(f"state {path}: there is no folder {path.parent}: make it first")
    if not overwrite and _is_foreign(path):
        raise UsageError(
            f"state {path}: the file that is there is no state of edge-vpr: name another one, or "
            "give overwrite=True"
        )


def _is_foreign(path: Path) -> bool:
    """Return whether a file is something else than a state, also than a damaged one."""
    try:
        if not path.is_file() or path.stat().st_size == 0:
            return False
        if not zipfile.is_zipfile(path):
            with path.open("rb") as file:
                return file.read(2) != b"PK"
        with zipfile.ZipFile(path) as archive:
            ours = "edge_vpr.npy" in archive.namelist()
    except (OSError, ValueError, zipfile.BadZipFile):
        return False  # it is damaged, or what it is shows when it is read
    return not ours or archive_kind(path) not in (None, KIND)


def boot() -> str:
    """Return what names this run of the machine; empty if it does not tell."""
    try:
        return BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def read_state(path: Path, localiser: Localiser) -> Resumable | str | None:
    """Read the state of a file.

    Parameters
    ----------
    localiser : Localiser
        That of the session, which stays as it is.

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
            if values["of"] != localiser.checksum():
                return f"{path} is of another map, of other settings or of another edge-vpr"
            resumed = localiser.fresh()
            resumed.resume(arrays, values["now_us"], values["floor_us"])
    except EdgeVprError as error:
        return str(error)
    return Resumable(resumed, values)


class StateFile:
    """Goes on from the state of a file, and keeps the state of a live line there.

    No other process can have the same file until `release`. Times are those since the machine was
    started: a computer without a battery for its clock has another time of day after each start.

    Parameters
    ----------
    localiser : Localiser
        Of the session, before its first event.
    say : callable
        Takes the kind and the text of a message, and `over`.

    Raises
    ------
    UsageError
        If another session has the file.
    """

    def __init__(self, path: Path, localiser: Localiser, say: Callable[..., None]) -> None:
        self._path, self._say = path, say
        self._lock = _Lock(path)
        self._checksum = localiser.checksum()
        self._saved = read_state(path, localiser)
        self._writer: StateWriter | None = None
        self._reported = ""

    def resume(self, live: StreamMatcher, heard_s: float, *, live_line: bool) -> None:
        """Go on from the state of the file when the first bytes come, or say why not.

        After another start of the machine, the state says where the robot was, and not when: it may
        then be as far from there as the longest time allows after which a state is used.

        Parameters
        ----------
        heard_s : float
            When they came, by `time.monotonic`.
        """
        saved, self._saved = self._saved, None
        limit_us = live.decoder.timestamps.longest_silence_us
        if isinstance(saved, Resumable):
            passed_us = _since_boot_us_at(heard_s) - saved.values["since_boot_us"]
            if not live_line:
                saved = f"{self._path} is of a live line, and this is none"
            elif saved.values["boot"] != boot() or not boot():
                live.resume(*saved, limit_us)
                self._say("state", "goes on after another start of the machine", over=True)
            elif passed_us < 0:
                saved = f"{self._path} was kept later than now"
            elif passed_us > limit_us:
                old_s, most_s = passed_us / 1e6, limit_us / 1e6
                saved = f"{self._path} is {old_s:,.0f} s old, of at most {most_s:.0f} s"
            else:
                live.resume(*saved, passed_us)
                self._say("state", f"goes on after {passed_us / 1e6:.1f} s", over=True)
        if isinstance(saved, str):
            self._say("state", f"matching starts afresh: {saved}")
        if self._writer is None and live_line:
            self._writer = StateWriter(self._path)
        elif self._writer is None and not self._reported:
            self._reported = "no live line"
            self._say("state", "a file or pipe is read again from its start: no state is kept")

    def keep(self, live: StreamMatcher, heard_s: float) -> None:
        """Hand the state to its writer now and then, and report once that it cannot be written.

        Parameters
        ----------
        heard_s : float
            When the newest bytes came, by `time.monotonic`.
        """
        writer = self._writer
        if writer is None or not writer.due():
            return
        writer.offer(self._state(live, heard_s))
        if writer.error and not self._reported:
            self._say("state", f"the state is not kept: {writer.error}")
        self._reported = writer.error

    def close(self, live: StreamMatcher, heard_s: float) -> None:
        """Keep the last state."""
        if self._writer is not None:
            self._writer.close(self._state(live, heard_s))

    def release(self) -> None:
        """Let another session have the file."""
        self._lock.release()

    def _state(self, live: StreamMatcher, heard_s: float) -> LiveState:
        arrays, values = live.to_state()
        heard_us = _since_boot_us_at(heard_s)
        when = {"boot": boot(), "since_boot_us": heard_us}
        return LiveState(arrays, values | when | {"of": self._checksum})


def _since_boot_us_at(heard_s: float) -> int:
    """Return the time of a moment since the machine was started, its sleep included."""
    since_boot_us = time.clock_gettime_ns(time.CLOCK_BOOTTIME) // 1_000
    return since_boot_us - round(1e6 * (time.monotonic() - heard_s))


class _Lock:
    """A hidden file beside a state, which one session has as long as it lives.

    Where it cannot be made, no state can be written either, which is reported then.
    """

    def __init__(self, path: Path) -> None:
        real = path.resolve()
        self._path = real.with_name(f".{real.name}.lock")
        self._file: BinaryIO | None = None
        while self._file is None:
            try:
                file = self._path.open("ab")
            except OSError:
                return
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                file.close()
                raise UsageError(
                    f"state {path}: another session keeps its state there: give each a file of "
                    "its own"
                ) from None
            # the session that had it may have removed it in the meantime
            if self._path.exists() and os.path.samestat(os.fstat(file.fileno()), self._path.stat()):
                self._file = file
            else:
                file.close()

    def release(self) -> None:
        """Remove the file."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            self._file.close()


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
