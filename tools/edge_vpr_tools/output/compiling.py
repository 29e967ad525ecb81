"""Note that kernels are being compiled, which takes long once on each machine."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from edge_vpr_tools.output.messages import detail, note

#: shorter compilations are not worth a line
SILENT_S = 0.5


@contextmanager
def compiling_noted() -> Iterator[None]:
    """Print one note when compilation within the block has taken longer than `SILENT_S`.

    Does nothing if Numba was not imported before.
    """
    if "numba" not in sys.modules:
        yield
        return
    from numba.core import event

    listener = _listener(event)
    with event.install_listener("numba:compile", listener):
        yield
    if listener.spent_s:
        detail(f"compiling kernels took {listener.spent_s:.1f} s")


def _listener(event: Any) -> Any:
    class CompileListener(event.Listener):  # type: ignore[misc]
        """Sum the time of compilations; a kernel compiled for another one is not counted twice."""

        def __init__(self) -> None:
            self.spent_s, self._depth, self._start, self._said = 0.0, 0, 0.0, False
            self._timer: threading.Timer | None = None

        def on_start(self, event: Any) -> None:
            self._depth += 1
            if self._depth > 1:
                return
            self._start = time.monotonic()
            if not self._said:
                self._timer = threading.Timer(max(SILENT_S - self.spent_s, 0.0), self._say)
                self._timer.daemon = True
                self._timer.start()

        def on_end(self, event: Any) -> None:
            self._depth -= 1
            if self._depth:
                return
            self.spent_s += time.monotonic() - self._start
            if self._timer is not None:
                self._timer.cancel()

        def _say(self) -> None:
            self._said = True
            note("compiling kernels: once on each machine, up to a minute")

    return CompileListener()
