"""Orderly end, with files and summary, on Ctrl-C, SIGTERM and a closed terminal."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def stopped_by_signals(stopping: threading.Event) -> Iterator[None]:
    """Set `stopping` at the first signal; a second one interrupts as usual."""
    caught = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # `nohup` wants the run to continue
        caught.append(signal.SIGHUP)

    def stop(number: int, frame: FrameType | None) -> None:
        if stopping.is_set():
            raise KeyboardInterrupt
        stopping.set()

    with _handled(caught, stop):
        yield


_interrupted = threading.Event()


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Let SIGTERM end the block as Ctrl-C does, so that no incomplete file is left.

    Python drops an interrupt that is raised in a callback from C, which Numba makes when it loads
    and looks up kernels. The interrupt is therefore stored for `check_interrupted`.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        _interrupted.set()
        raise KeyboardInterrupt

    caught = [signal.SIGTERM]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # and not ignored
        caught.append(signal.SIGINT)
    with _handled(caught, interrupt):
        _interrupted.clear()
        try:
            yield
        finally:
            _interrupted.clear()


@contextmanager
def _handled(
    caught: Iterable[signal.Signals], handler: Callable[[int, FrameType | None], None]
) -> Iterator[None]:
    """Handle signals within the block; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in caught}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def check_interrupted() -> None:
    """Raise KeyboardInterrupt if one was dropped within `terminated_as_interrupted`."""
    if _interrupted.is_set():
        raise KeyboardInterrupt
