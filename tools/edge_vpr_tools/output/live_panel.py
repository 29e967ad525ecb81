"""The full-screen view of a live run on a terminal."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import NamedTuple

from rich.console import Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

#: Notices that are shown, and that are printed again at the end.
_SHOWN, _KEPT = 6, 50
_BAR_WIDTH = 50
_STALE, _WARNING = "bright_black", "yellow"
#: Texts that have no meaning once nothing arrives.
_OF_THE_NEWEST = {"place", "certainty", "latency"}


class Notice(NamedTuple):
    """Something that happened."""

    kind: str
    clock: str
    text: str


class Panel:
    """Shows named texts, the position as a bar, and notices.

    Attributes
    ----------
    lost : bool
        Whether the terminal has gone.
    """

    def __init__(self, live: Live) -> None:
        self._live = live
        self._notices: deque[Notice] = deque(maxlen=_KEPT)
        self._standing: set[str] = set()
        self.lost = False

    def notice(self, kind: str, text: str, *, over: bool) -> None:
        """Add a notice, shown as a warning until a notice of its kind says that it is over."""
        self._notices.append(Notice(kind, time.strftime("%H:%M:%S"), text))
        self.settle(kind)
        if not over:
            self._standing.add(kind)

    def settle(self, kind: str) -> None:
        """Show the notices of a kind as past."""
        self._standing.discard(kind)

    def show(self, rows: Mapping[str, str], share: float | None, *, stale: bool) -> None:
        """Draw the screen anew.

        Parameters
        ----------
        rows : mapping
            What there is to say, by name.
        share : float or None
            Position on the bar, 0 to 1.
        stale : bool
            Whether it is too old to be believed; it is greyed then.
        """
        try:
            self._live.update(self._drawn(rows, share, stale=stale), refresh=True)
            # what was hung up between two pictures is to Rich no terminal, and gets none
            self.lost = not self._live.console.file.isatty()
        except OSError:
            self.lost = True

    def close(self) -> None:
        """Give the screen back; again is harmless."""
        # a terminal that has gone needs nothing to be put back
        with suppress(OSError):
            self._live.stop()

    def history(self) -> Iterator[str]:
        """Give the notices, oldest first, for whoever has left the screen."""
        return (f"{notice.clock} {notice.text}" for notice in self._notices)

    def _drawn(
        self, rows: Mapping[str, str], share: float | None, *, stale: bool
    ) -> RenderableType:
        table = Table.grid(padding=(0, 2))
        table.add_column(style=_STALE, justify="right")
        table.add_column()
        for name, text in rows.items():
            style = _STALE if stale and name in _OF_THE_NEWEST else ""
            # a Text, as in a string square brackets would be marks
            table.add_row(name, Text(text, style=_WARNING if name == "silent" else style))
            if name == "place" and share is not None:
                shown = _STALE if stale else "bar.complete"
                table.add_row(
                    "",
                    ProgressBar(1.0, share, _BAR_WIDTH, complete_style=shown, finished_style=shown),
                )
        return Group(table, *self._notice_lines())

    def _notice_lines(self) -> Iterable[RenderableType]:
        """Give the newest notices, and before them the standing ones that are older."""
        newest = list(self._notices)[-_SHOWN:]
        last = {notice.kind: notice for notice in self._notices}
        older = [last[kind] for kind in self._standing if kind in last and last[kind] not in newest]
        yield Text("")
        for notice in [*older, *newest]:
            stands = notice.kind in self._standing and notice is last[notice.kind]
            yield Text(f"{notice.clock} {notice.text}", style=_WARNING if stands else _STALE)


@contextmanager
def open_panel() -> Iterator[Panel]:
    """Take the terminal's other screen until the block ends."""
    live = Live("waiting for events", auto_refresh=False, screen=True)
    live.start(refresh=True)
    panel = Panel(live)
    try:
        yield panel
    finally:
        panel.close()
