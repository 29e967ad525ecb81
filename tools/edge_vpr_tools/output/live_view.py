"""What a live run shows: a view on a terminal, plain lines in a pipe, JSON for programs."""

from __future__ import annotations

import errno
import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from rich.console import RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table

from edge_vpr.stream.health import Health
from edge_vpr.stream.live import LiveLocaliser, Step

_REFRESH_S, _LINE_S = 0.125, 1.0


class Lags:
    """How long pieces took from their arrival to their match, in bins of 0.1 ms up to a second."""

    def __init__(self) -> None:
        self._pieces = np.zeros(10_001, dtype=np.int64)

    def add(self, lag_s: float) -> None:
        """Count a piece."""
        self._pieces[min(int(1e4 * lag_s), self._pieces.size - 1)] += 1

    def percentile_ms(self, share: float) -> float | None:
        """Lag that this share of the pieces stayed under, to 0.1 ms; None without pieces."""
        sums = np.cumsum(self._pieces)
        if not sums[-1]:
            return None
        return float(np.searchsorted(sums, share * sums[-1]) + 1) / 10


class View:
    """Counts, shows and logs.

    Parameters
    ----------
    as_json : bool
        JSON lines on standard output.
    log : text file or None
    places : int
        In the map; 0 without one.
    live : rich.live.Live or None
        On a terminal.

    Attributes
    ----------
    unread : bool
        Whether nobody reads our output any more, as after `head`.
    unwritten : str
        Which file was given up and why, if one was.
    """

    def __init__(self, as_json: bool, log: TextIO | None, places: int, live: Any) -> None:
        self._json, self._log, self._places, self._live = as_json, log, places, live
        self._goal = "match" if places else "event"
        self.unread = False
        self.unwritten = ""
        self._begin = self._shown = self._logged = time.monotonic()
        self._events_then = 0
        self._rate = 0.0
        self._lag_s = 0.0
        self._lags = Lags()
        self._last: dict[str, Any] | None = None
        self.matched = 0

    def matches(self, step: Step, lag_s: float) -> None:
        """Take what a piece of bytes brought, `lag_s` after it came."""
        if step.events.size:
            self._lag_s = lag_s
            self._lags.add(lag_s)
        names = step.matches.dtype.names or ()
        for row in step.matches.tolist():
            match = dict(zip(names, row, strict=True))
            # JSON has no not-a-number
            for name in ("ratio", "probability"):
                match[name] = match[name] if match[name] == match[name] else None
            self._last = {"kind": "match", **match, "incomplete": step.incomplete}
            self.matched += 1
            self._write(self._last)
        if self._json and step.matches.size:
            # a program at the other end of a pipe waits for this
            self._print()

    def say(self, kind: str, text: str) -> None:
        """Say that something happened."""
        self._write({"kind": kind, "text": text})
        if not self._json and self._live is None:
            self._print(text)

    def give_up(self, text: str) -> None:
        """Say that a file is given up; the run goes on without it."""
        self.unwritten = text
        self.say("file", f"{text}; going on without it")

    def tick(self, live: LiveLocaliser) -> None:
        """Show how things are, if it is time to."""
        now = time.monotonic()
        since = now - self._shown
        if since < (_LINE_S if self._live is None else _REFRESH_S):
            return
        health = live.decoder.health
        self._rate = (health.events - self._events_then) / since
        self._events_then, self._shown = health.events, now
        if now - self._logged >= _LINE_S:
            self._logged = now
            self._write(self._health(health))
        if self._live is not None:
            self._live.update(self._panel(health, live.filled))
        elif not self._json:
            self._print(" | ".join(self._said(health, live.filled).values()))

    def summary(self, health: Health, bursts_removed: int) -> None:
        """Say how it went."""
        self._write({**self._health(health), "kind": "summary", "matches": self.matched})
        if self._json:
            return
        seconds = time.monotonic() - self._begin
        text = f"{health.events:,} events in {health.bytes:,} bytes over {seconds:.1f} s"
        if self._places:
            text += f", {self.matched:,} matches; {bursts_removed:,} events removed as bursts"
        half, most = (self._lags.percentile_ms(share) for share in (0.5, 0.99))
        if half is not None:
            text += f"\nfrom byte to {self._goal}: {half:.1f} ms median, {most:.1f} ms for 99 %"
        self._print(f"{text}\nhealth: {health}\nlosses: {health.describe_losses()}")

    def _health(self, health: Health) -> dict[str, Any]:
        return {
            "kind": "health",
            **asdict(health),
            "rate": self._rate,
            "lag_ms": 1e3 * self._lag_s,
            "lag_p50_ms": self._lags.percentile_ms(0.5),
            "lag_p99_ms": self._lags.percentile_ms(0.99),
        }

    def _said(self, health: Health, filled: float) -> dict[str, str]:
        """Name what there is to say, and say it."""
        said = {"rate": f"{self._rate:,.0f} events/s", "received": f"{health.events:,} events"}
        if self._last is not None:
            said["place"] = (
                f"place {self._last['place']} of {self._places}"
                f" ({100 * self._position():.0f} % of the route)"
            )
            ratio, probability = self._last["ratio"], self._last["probability"]
            said["certainty"] = "ratio -" if ratio is None else f"ratio {ratio:.3f}"
            if probability is not None:
                said["certainty"] = f"right with probability {probability:.2f}"
            if self._last["lost"]:
                said["certainty"] += ", lost"
            if self._last["incomplete"]:
                said["certainty"] += ", incomplete: events were lost"
        elif self._places:
            said["place"] = f"first sequence {100 * filled:.0f} % full"
        if health.events:
            said["latency"] = f"{1e3 * self._lag_s:.1f} ms from byte to {self._goal}"
        said["health"] = str(health)
        return said

    def _position(self) -> float:
        """Share of the route that lies behind the newest match."""
        assert self._last is not None
        return float(self._last["place"] / max(1, self._places - 1))

    def _panel(self, health: Health, filled: float) -> RenderableType:
        """Lay out what there is to say, with the position as a bar."""
        table = Table.grid(padding=(0, 2))
        table.add_column(style="dim", justify="right")
        table.add_column()
        for name, text in self._said(health, filled).items():
            table.add_row(name, text)
            if name == "place":
                share = filled if self._last is None else self._position()
                table.add_row("", ProgressBar(total=1.0, completed=share, width=50))
        return table

    def _write(self, row: dict[str, Any]) -> None:
        text = json.dumps(row)
        if self._log is not None:
            try:
                self._log.write(text + "\n")
                if row["kind"] != "match":
                    self._log.flush()
            except OSError as error:
                name, self._log = self._log.name, None
                self.give_up(ends_early(name, error))
        if self._json:
            self._print(text, flush=row["kind"] != "match")

    def _print(self, *text: str, flush: bool = True) -> None:
        """Print lines, or only flush those before; a reader that has gone ends the run well.

        So does a second signal while the reader neither goes nor reads.
        """
        try:
            for line in text:
                print(line)
            if flush:
                sys.stdout.flush()
        except (OSError, KeyboardInterrupt) as error:
            if isinstance(error, OSError) and error.errno not in (errno.EPIPE, errno.EIO):
                raise
            self.unread = True
            with Path(os.devnull).open("wb") as nowhere:
                os.dup2(nowhere.fileno(), sys.stdout.fileno())


def ends_early(path: str, error: OSError) -> str:
    """Say that no more can be written to a file."""
    return f"{path} ends early: {error.strerror}: check its permissions and the free space"


@contextmanager
def open_view(as_json: bool, log: str | None, places: int) -> Iterator[View]:
    """Open a view, and its log until the block ends."""
    file = None if log is None else Path(log).open("w", encoding="utf-8")  # noqa: SIM115
    try:
        if as_json or not sys.stdout.isatty():
            yield View(as_json, file, places, None)
        else:
            with Live("waiting for events", auto_refresh=True) as live:
                yield View(as_json, file, places, live)
    finally:
        if file is not None:
            # lines are flushed as they are written, and what failed then was told then
            with suppress(OSError):
                file.close()
