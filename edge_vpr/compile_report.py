"""Report that kernels are being compiled, which takes long once on each machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


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
    from numba.core import event

    from edge_vpr.compiling import DAMAGED

    spent = {"spent_s": 0.0}

    class CompileListener(event.Listener):
        """Sum the time of compilations; a kernel compiled for another one is not counted twice."""

        def __init__(self) -> None:
            self._depth, self._start, self._said = 0, 0.0, False
            self._timer: threading.Timer | None = None

        def on_start(self, event: Any) -> None:
            self._depth += 1
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
            report(
                "compiling the kernels that this needs, once on each machine, up to a minute; "
                "edge-vpr doctor --compile compiles all of them"
            )

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

    with (
        event.install_listener("numba:compile", CompileListener()),
        event.install_listener(DAMAGED, DamageListener()),
    ):
        yield spent
