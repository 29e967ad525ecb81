"""Reading of a link by a thread: a bounded queue of pieces of bytes, and opening again."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from edge_vpr.live.links import AbsentLink, Link, LinkAbsent, LinkClosed, LinkError

#: Size of the queue: 0.9 s of a line of 12 Mbaud.
BUFFER_BYTES = 1 << 20
#: When bytes have waited for this time, they and all later waiting bytes are dropped.
MAX_LAG_S = 0.5
_WAIT_S = 0.1
#: Interval at which the system's count of errors is read.
_LOOK_S = 0.25
_FIRST_RETRY_S, _LAST_RETRY_S = 0.25, 1.0


class Chunk(NamedTuple):
    """Bytes that arrived together."""

    data: bytes
    at_s: float  #: When, on the host's monotonic clock.
    dropped: int = 0  #: Bytes dropped right before these, because the caller was late.
    reopened: bool = False  #: Whether the link was disconnected and opened again before these.


class LinkReader:
    """Reads a link by a thread, for one caller.

    Parameters
    ----------
    open_link : callable
        Opens the link, at first and again.
    address : str
        Of the link, where it is absent at first.
    setup, teardown : bytes
        What to send when it opens and before it closes.
    retry : bool
        Open a live link again when it is disconnected, and wait for one that is absent at first;
        else, and for files and pipes, that is the end.
    drop : bool or None
        When the queue is full or its oldest bytes have waited for `max_lag_s`, drop all of it, so
        that no bytes are missing within what follows; else let the link wait. None: drop if live.
    max_lag_s : float
        Longest time in seconds that bytes wait for the caller.

    Attributes
    ----------
    error : Exception or None
        Why it ended, if that was no ordinary end.
    line_errors : int
        Characters that the system says the line damaged or dropped.
    lost_link : str
        Why the link is disconnected right now; empty while it is open.
    """

    def __init__(
        self,
        open_link: Callable[[], Link],
        *,
        address: str = "",
        setup: bytes = b"",
        teardown: bytes = b"",
        retry: bool = False,
        drop: bool | None = None,
        max_lag_s: float = MAX_LAG_S,
    ) -> None:
        self._open, self._setup, self._teardown = open_link, setup, teardown
        self._retry, self._drop = retry, drop
        self._max_lag_s = max_lag_s
        self._chunks: deque[Chunk] = deque()
        self._held, self._ended = 0, False
        self._changed = threading.Condition()
        self._stopping = threading.Event()
        self.error: Exception | None = None
        self.line_errors = 0
        self.lost_link = ""
        # held while sending and while closing, so that nothing is sent to a closed link
        self._send_lock = threading.Lock()
        self._reopened = False  # whether the link was reopened before the next bytes
        self._errors_before = 0  # line errors of the links before this one
        self._dead_since_s = math.inf  # when the link was disconnected, while it is
        self._dead_s = 0.0
        try:
            self._link = open_link()  # an error of the first opening is raised to the caller
        except LinkAbsent as error:
            if not retry:
                raise
            self._link = AbsentLink(address, str(error))
            self.lost_link, self._dead_since_s = str(error), time.monotonic()
        self.address = self._link.address
        self._thread = threading.Thread(target=self._run, name="edge-vpr reader", daemon=True)
        self._thread.start()

    def take(self, timeout: float) -> Chunk | None:
        """Return all waiting bytes, or None if none arrive within `timeout` seconds.

        A late host gets fewer and longer pieces, and so catches up with the link.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._chunks or self._ended, timeout)
            if not self._chunks:
                return None
            first = self._chunks.popleft()
            parts = [first.data]
            # a gap is reported before the bytes that follow it
            while self._chunks and not (self._chunks[0].dropped or self._chunks[0].reopened):
                parts.append(self._chunks.popleft().data)
            data = b"".join(parts)
            self._held -= len(data)
            self._changed.notify_all()
            return first._replace(data=data)

    def send(self, data: bytes, timeout: float = 1.0) -> None:
        """Send to the device from any thread, if the link is open; else they are dropped.

        Parameters
        ----------
        timeout : float
            Seconds to wait for a line that takes no more bytes.
        """
        if data:
            with self._send_lock, contextlib.suppress(LinkError):
                self._send(self._link, data, timeout)

    @property
    def dead_s(self) -> float:
        """Seconds for which the link was disconnected, in all so far."""
        since_s = self._dead_since_s
        return self._dead_s + max(0.0, time.monotonic() - since_s)

    @property
    def remark(self) -> str:
        """Message to the user about the present state of the link; empty if there is none."""
        return self._link.remark

    @property
    def live(self) -> bool:
        """Whether the other side goes on without waiting for the host."""
        return self._link.live

    @property
    def drops(self) -> bool:
        """Whether bytes that have waited for too long are dropped."""
        return self.live if self._drop is None else self._drop

    @property
    def ended(self) -> bool:
        """Whether the link has ended for good."""
        with self._changed:
            return self._ended and not self._chunks

    def stop(self) -> None:
        """Stop reading and close the link; returns within about a second."""
        self._stopping.set()
        with self._changed:
            self._changed.notify_all()
        self._thread.join(timeout=2)

    def _run(self) -> None:
        link = self._link
        try:
            while not self._stopping.is_set():
                try:
                    self._send(link, self._setup)
                    self._read(link)
                except LinkError as error:
                    self._close(link)
                    if not (self._retry and link.live):
                        # the end of a link is no error; anything else is reported
                        self.error = None if isinstance(error, LinkClosed) else error
                        return
                    self.lost_link = str(error)
                    self._dead_since_s = min(self._dead_since_s, time.monotonic())
                again = self._reopen()
                if again is None:
                    return
                with self._send_lock:
                    self._link = again
                self._reopened = not isinstance(link, AbsentLink)
                self._dead_s, self._dead_since_s = self.dead_s, math.inf
                link, self.lost_link = again, ""
        except Exception as error:
            # an error in the thread would go unnoticed: pass it to the caller
            self.error = error
        finally:
            self._dead_s, self._dead_since_s = self.dead_s, math.inf
            with contextlib.suppress(LinkError):
                self._send(link, self._teardown)
            self._close(link)
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _read(self, link: Link) -> None:
        self._errors_before, look = self.line_errors, 0.0
        while not self._stopping.is_set():
            if time.monotonic() >= look:
                look = time.monotonic() + _LOOK_S
                self._look_at_errors(link)
            data = link.read(_WAIT_S)
            if data:
                reopened, self._reopened = self._reopened or link.stream_changed(), False
                self._put(Chunk(data, time.monotonic(), 0, reopened), self.drops)

    def _put(self, piece: Chunk, drop: bool) -> None:
        with self._changed:
            while not drop and self._held and self._held + len(piece.data) > BUFFER_BYTES:
                if self._stopping.is_set():
                    return
                self._changed.wait(_WAIT_S)
            if drop and self._chunks:
                oldest = self._chunks[0]
                full = self._held + len(piece.data) > BUFFER_BYTES
                if full or piece.at_s - oldest.at_s > self._max_lag_s:
                    piece = piece._replace(
                        dropped=self._held + sum(each.dropped for each in self._chunks),
                        reopened=piece.reopened or any(each.reopened for each in self._chunks),
                    )
                    self._chunks.clear()
                    self._held = 0
            self._chunks.append(piece)
            self._held += len(piece.data)
            self._changed.notify_all()

    def _reopen(self) -> Link | None:
        wait = _FIRST_RETRY_S
        while not self._stopping.wait(wait):
            try:
                return self._open()
            except LinkError:
                wait = min(2 * wait, _LAST_RETRY_S)
        return None

    def _look_at_errors(self, link: Link) -> None:
        # a port that was disconnected counts none
        self.line_errors = max(self.line_errors, self._errors_before + link.line_errors())

    def _close(self, link: Link) -> None:
        self._look_at_errors(link)
        with self._send_lock:
            link.close()

    @staticmethod
    def _send(link: Link, data: bytes, timeout: float = 1.0) -> None:
        end = time.monotonic() + timeout
        while data:
            try:
                data = data[link.write(data, min(0.1, timeout)) :]
            except LinkClosed:
                raise
            except LinkError:
                return  # a link that cannot be written to, such as a file
            if time.monotonic() >= end:
                return
