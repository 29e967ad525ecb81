"""Report the compilation of kernels, which is slow on the first run on a machine."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

#: What a user can do to have them all at once.
COMPILE_ALL = "; edge-vpr doctor --compile compiles all of them"

#: packages with kernels; those of Numba have names that say little
_OURS = ("edge_vpr", "fixedpoint", "firmware_model")
#: event of `numba.core.event` when a file of compiled code was damaged; its data is the path
DAMAGED = "edge_vpr:damaged"
_waiting: list[Callable[[], None]] = []
#: of the block that shows which kernel is compiled, if there is one
_show: Callable[[str], object] | None = None


def listen() -> None:
    """Connect the waiting reports to Numba's events; `edge_vpr.compiling` calls this."""
    while _waiting:
        _waiting.pop()()


@contextmanager
def kernels_shown(show: Callable[[str], object]) -> Iterator[None]:
    """Within a block of `compiling_reported`, show the name of each kernel that is compiled."""
    global _show
    before, _show = _show, show
    try:
        yield
    finally:
        _show = before


@contextmanager
def compiling_reported(
    report: Callable[[str], object], silent_s: float = 0.5
) -> Iterator[dict[str, float]]:
    """Report once when compilation within the block has taken longer than `silent_s`.

    Damaged files of compiled code, which are compiled again, are reported once too.

    Parameters
    ----------
    report : callable
        Takes the text, from another thread.
    silent_s : float
        Shorter compilations are not worth a line.

    Yields
    ------
    dict
        ``spent_s``, the seconds of compilation so far.
    """
    spent = {"spent_s": 0.0}

    def begin() -> None:
        from numba.core import event

        class CompileListener(event.Listener):
            """Sum the time of compilations; those within another one are not counted twice."""

            def __init__(self) -> None:
                self._depth, self._start, self._said = 0, 0.0, False
                self._timer: threading.Timer | None = None

            def on_start(self, event: Any) -> None:
                self._depth += 1
                function = event.data["dispatcher"].py_func
                if _show is not None and str(function.__module__).startswith(_OURS):
                    _show(function.__name__)
                if self._depth > 1:
                    return
                self._start = time.monotonic()
                if not self._said:
                    self._timer = threading.Timer(max(silent_s - spent["spent_s"], 0.0), self._say)
                    self._timer.daemon = True
                    self._timer.start()

            def on_end(self, event: Any) -> None:
                self._depth -= 1
                if self._depth:
                    return
                spent["spent_s"] += time.monotonic() - self._start
                if self._timer is not None:
                    self._timer.cancel()

            def _say(self) -> None:
                self._said = True
                report("compiling kernels, once on each machine for each kind of work")

        class DamageListener(event.Listener):
            """Report one damaged file, however many there are."""

            def __init__(self) -> None:
                self._said = False

            def on_start(self, event: Any) -> None:
                if not self._said:
                    self._said = True
                    report(
                        "compiled kernels are damaged or of an older version: they are deleted and "
                        f"compiled again ({event.data})"
                    )

            def on_end(self, event: Any) -> None:
                pass

        stack.enter_context(event.install_listener("numba:compile", CompileListener()))
        stack.enter_context(event.install_listener(DAMAGED, DamageListener()))

    with ExitStack() as stack:
        # importing Numba here would make commands slow that need no kernels
        if "edge_vpr.compiling" in sys.modules:
            begin()
        else:
            _waiting.append(begin)
        try:
            yield spent
        finally:
            if begin in _waiting:
                _waiting.remove(begin)
