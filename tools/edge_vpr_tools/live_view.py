"""Output of a live run: a view on a terminal, plain lines in a pipe, JSON for programs."""

from __future__ import annotations

import errno
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from rich.live import Live
from rich.table import Table
from rich.text import Text

from edge_vpr.confidence import OFF_MAP_MISFIT, OFF_MAP_TEXT
from edge_vpr.errors import printable
from edge_vpr.live.position import Locator
from edge_vpr.live.protocols.health import UNKNOWN
from edge_vpr.live.session import LiveStatus, LiveStep
from edge_vpr.live.session_files import ends_early
from edge_vpr.live.watches import SILENT_S
from edge_vpr.matching.match import Match
from edge_vpr.odometry import ratio_text
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import ALONG
from edge_vpr_tools.console import in_flags, is_quiet, warning
from edge_vpr_tools.publish import MatchServer

# The view of a live run on a terminal.


_STALE, _WARNING = "bright_black", "yellow"
#: Texts that have no meaning once nothing arrives.
_OF_THE_NEWEST = {"place", "certainty", "latency"}


class Panel:
    """Shows named texts, which change in place, below notices, which scroll as all output does."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self.gone = False  #: Whether the terminal has gone.

    def notice(self, text: str, *, over: bool) -> None:
        """Print a notice, as a warning unless it says that something is over."""
        # a Text, as in a string square brackets would be marks
        shown = Text(f"{time.strftime('%H:%M:%S')} {text}", style=_STALE if over else _WARNING)
        self._to_terminal(lambda: self._live.console.print(shown))

    def show(self, rows: Mapping[str, str], *, stale: bool) -> None:
        """Draw texts by their names.

        Parameters
        ----------
        stale : bool
            Whether the newest match is out of date; it is then shown in grey.
        """
        table = Table.grid(padding=(0, 2))
        table.add_column(style=_STALE, justify="right")
        table.add_column()
        for name, text in rows.items():
            style = _STALE if stale and name in _OF_THE_NEWEST else ""
            table.add_row(name, Text(text, style=_WARNING if name == "silent" else style))
        self._to_terminal(lambda: self._live.update(table, refresh=True))

    def close(self) -> None:
        """Take the texts off the terminal; calling it again has no effect."""
        self._to_terminal(self._live.stop)

    def _to_terminal(self, draw: Callable[[], None]) -> None:
        """Draw, and note whether the terminal has gone, which needs nothing to be put back."""
        try:
            draw()
            # one that was closed between two updates is no terminal for Rich, and gets none
            self.gone = not self._live.console.file.isatty()
        except OSError:
            self.gone = True


# Conversion of live matches to rows of JSON.


#: Decimals of what is rounded: some 0.1 mm, and 0.1 degrees of a direction.
_COORDINATES = {"x_m": 3, "y_m": 3, "z_m": 3, "latitude": 9, "longitude": 9}
_DIGITS = {**_COORDINATES, "heading_deg": 1, **dict.fromkeys((*ALONG, "route_m"), 3)}
#: Fields of a match that no row has, or that of a map with them.
_UNSHOWN = {"query", "ties", *_COORDINATES}


def row_of(match: Match, coordinates: Sequence[str] = ()) -> str:
    """Return a live match as a line of JSON, without a line feed.

    Parameters
    ----------
    match : Match
        Its fields are the row's, but for the `query`, the `ties`, other coordinates, and times,
        which are in seconds.
    coordinates : sequence of str
        Names of the coordinates that the map has.

    Returns
    -------
    str
        What is not known is null: JSON has no not-a-number.
    """
    row: dict[str, Any] = {"kind": "match"}
    for name, value in match._asdict().items():
        if name in ("time_us", "start_us"):
            row[f"{name[:-3]}_s"] = value / 1e6
        elif name in coordinates or name not in _UNSHOWN:
            row[name] = _rounded(name, value)
    return json.dumps(row)


def _rounded(name: str, value: float | None) -> float | None:
    """Return a value of a row, rounded; None if it is not known."""
    if value is None or value != value:
        return None
    digits = _DIGITS.get(name)
    return value if digits is None else round(value, digits)


def route_row(reference: ReferenceMap) -> dict[str, Any]:
    """Return the first row of a run on a map: its number of places, and where they are if known."""
    locator = Locator(reference)
    row: dict[str, Any] = {"kind": "route", "places": len(reference)}
    if locator.route_m is not None:
        places = [locator.locate(place) for place in range(len(reference))]
        for name in (*locator.names, "along_m", "heading_deg"):
            row[name] = [_rounded(name, place[name]) for place in places]
    return row


# Output of a live run: a view on a terminal, plain lines in a pipe, JSON for programs.


_REFRESH_S, _LINE_S = 0.125, 1.0
_NO_ODOMETRY = "no reading of the odometer has come"
#: Lag that is shown; less is the scheduling of any machine.
_LAG_US = 100_000


class Lags:
    """Histogram of the time from arrival to match, in bins of 0.1 ms up to a second."""

    def __init__(self) -> None:
        self._pieces = np.zeros(10_001, dtype=np.int64)

    def add(self, lag_s: float) -> None:
        """Count a piece."""
        self._pieces[min(int(1e4 * lag_s), self._pieces.size - 1)] += 1

    def percentile_ms(self, share: float) -> float | None:
        """Return the lag below which this share of pieces stayed, to 0.1 ms; None if none."""
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
        Gets each row as a line of JSON, as the server does.
    line_s : float, optional
        Interval of status lines where there is neither a panel nor JSON.
    """

    def __init__(
        self,
        as_json: bool,
        log: TextIO | None,
        reference: ReferenceMap | None,
        panel: Panel | None,
        server: MatchServer | None = None,
        line_s: float | None = None,
    ) -> None:
        self._json, self._log, self._panel = as_json, log, panel
        self._server = server
        self._coordinates = () if reference is None else Locator(reference).names
        self._places = len(reference or ())
        self._quiet = is_quiet() or as_json
        self._goal = "match" if self._places else "event"
        self.unread = False  #: Whether the reader of the output has gone, as after `head`.
        self.unwritten = ""  #: Which file was given up and why, if one was.
        self._started = self._shown = self._logged = time.monotonic()
        self._line_s, self._printed = line_s, self._started
        self._state: tuple[bool, ...] = ()
        self._events_then = 0
        self._rate = 0.0
        self._lag_s = 0.0
        self._lags = Lags()
        self._newest: Match | None = None
        self.matched = self.accepted = 0
        if reference is not None:
            self._write(route_row(reference))
        if server is not None:
            self.say("http", f"matches are at {server.address}", over=True)

    def matches(self, step: LiveStep) -> None:
        """Count and write the matches of a step."""
        if step.events is not None and step.events.size:
            self._lag_s = time.monotonic() - step.at_s
            self._lags.add(self._lag_s)
        if step.matches:
            lines = [row_of(match, self._coordinates) for match in step.matches]
            if self._json:  # first: a program may wait at the other end of a pipe
                self._print(*lines)
            self._newest = step.matches[-1]
            self.matched = self._newest.query + 1  # one that was given again counts once
            self.accepted += sum(not match.lost for match in step.matches)
            for line in lines:
                self._hand_on("match", line)

    def say(self, kind: str, text: str, *, over: bool = False) -> None:
        """Report that something happened, or that it is over."""
        text = in_flags(text)
        self._write({"kind": kind, "text": text})
        # texts of a device or of the system can contain anything
        text = printable(text)
        if self._panel is not None:
            self._panel.notice(text, over=over)
        elif not self._quiet:
            self._print(text)
        elif not (self._json or over):
            warning(text)

    def odometry(self, time_us: int, distance_m: float) -> None:
        """Write a reading of the odometer."""
        self._write({"kind": "odometry", "time_s": time_us / 1e6, "distance_m": distance_m})

    def tick(self, status: LiveStatus) -> None:
        """Update the view, if it is time to."""
        now = time.monotonic()
        since = now - self._shown
        if since < (_LINE_S if self._panel is None else _REFRESH_S):
            return
        health = status.health
        silent = bool(status.lost_link) or health.silent_s > SILENT_S
        self._rate = (health.events - self._events_then) / since
        self._events_then, self._shown = health.events, now
        if now - self._logged >= _LINE_S:
            self._logged = now
            self._write(self._health(status))
        if self._panel is not None:
            self._panel.show(self._texts(status), stale=silent)
            self.unread |= self._panel.gone
        elif not self._quiet:
            self._print_status(status, now)

    def _print_status(self, status: LiveStatus, now: float) -> None:
        """Print a line of the status if one is due, or if the kind of status has changed."""
        newest = self._newest
        state = bool(status.lost_link), newest is not None, newest is not None and newest.lost
        due = now - self._printed >= (_LINE_S if self._line_s is None else self._line_s)
        if due or state != self._state:
            self._state, self._printed = state, now
            self._print(" | ".join(self._texts(status).values()))

    def summary(self, status: LiveStatus) -> None:
        """Write the summary of the run."""
        health = status.health
        counted = {"matches": self.matched, "accepted": self.accepted}
        self._write({**self._health(status), "kind": "summary", **counted})
        if self._quiet:
            return
        if self._panel is not None:
            self._panel.close()
        seconds = time.monotonic() - self._started
        text = f"{health.events:,} events in {health.bytes:,} bytes over {seconds:.1f} s"
        if self._places:
            text += f", {self.matched:,} matches, {self.accepted:,} of them not lost; "
            text += f"{status.bursts_removed:,} events removed as bursts"
        half, most = (self._lags.percentile_ms(share) for share in (0.5, 0.99))
        if half is not None:
            text += f"\nfrom byte to {self._goal}: {half:.1f} ms median, {most:.1f} ms for 99 %"
        if health.longest_lag_us >= _LAG_US:
            text += f"; events were matched up to {health.longest_lag_us / 1e3:,.0f} ms late"
        faults = str(health)
        if status.dead_s:
            dead = f"the link was lost for {status.dead_s:,.1f} s"
            faults = dead if faults == "no faults" else f"{faults}; {dead}"
        if status.no_odometry:
            text += f"\n{_NO_ODOMETRY}" + ": matched without it" * bool(self._places)
        self._print(f"{text}\nhealth: {faults}\nlosses: {health.describe_losses()}")

    def _health(self, status: LiveStatus) -> dict[str, Any]:
        return {
            "kind": "health",
            **asdict(status.health),
            **({"accounting": UNKNOWN} if status.health.cut_off else {}),
            "faults": status.health.faults,
            "dead_s": status.dead_s,
            "max_age_s": status.max_age_s if math.isfinite(status.max_age_s) else None,
            "lost_link": status.lost_link,
            "rate": self._rate,
            "lag_ms": 1e3 * self._lag_s,
            "lag_p50_ms": self._lags.percentile_ms(0.5),
            "lag_p99_ms": self._lags.percentile_ms(0.99),
        }

    def _texts(self, status: LiveStatus) -> dict[str, str]:
        """Return the parts of a line, or of the panel, by name."""
        health = status.health
        texts = {"rate": f"{self._rate:,.0f} events/s", "received": f"{health.events:,} events"}
        if health.silent_s > SILENT_S:
            texts["silent"] = f"nothing came for {health.silent_s:.0f} s"
        if status.lost_link:
            texts["silent"] = f"the link is lost for {health.silent_s:.0f} s"
        if (newest := self._newest) is not None:
            # an age that is not known is NaN, and comes last
            gone = bool(status.lost_link) or (max(health.silent_s, newest.age_s) > status.max_age_s)
            share = newest.place / max(1, self._places - 1)
            texts["place"] = ("lost, last at " if gone else "lost, at best " * newest.lost) + (
                f"place {newest.place} of {self._places} ({100 * share:.0f} % of the route)"
            )
            if newest.along_m is not None:
                texts["place"] += f", at {newest.along_m:,.1f} m"
            certainty = list(self._certainty(newest, gone=gone))
            if certainty:
                texts["certainty"] = ", ".join(certainty)
            if health.odometer_m is not None and newest.route_m is not None:
                texts["odometer"] = ratio_text(health.odometer_m, newest.route_m)
        elif self._places:
            texts["place"] = f"waiting for the first match: {100 * status.filled:.0f} %"
        if status.no_odometry:
            texts["odometer"] = _NO_ODOMETRY
        if status.lost_link:
            texts["health"] = "link lost" if str(health) == "no faults" else f"link lost, {health}"
            return texts
        if health.events:
            texts["latency"] = f"{1e3 * self._lag_s:.1f} ms from byte to {self._goal}"
            if health.lag_us >= _LAG_US:
                texts["latency"] += f", {health.lag_us / 1e3:,.0f} ms late"
        texts["health"] = str(health)
        return texts

    def _certainty(self, match: Match, *, gone: bool) -> Iterator[str]:
        """Yield how certain a match is; a place where the robot is not has no probability."""
        if not (gone or match.lost):
            has_table = not math.isnan(match.probability)
            ratio = "ratio -" if math.isnan(match.ratio) else f"ratio {match.ratio:.3f}"
            yield f"probability {match.probability:.2f}" if has_table else ratio
        if match.misfit >= OFF_MAP_MISFIT:
            yield OFF_MAP_TEXT
        if match.missing == 1:
            yield "after a gap of unknown size"
        elif match.missing:
            yield f"{100 * match.missing:.0f} % of its events lost"

    def _write(self, row: dict[str, Any]) -> None:
        text = json.dumps(row)
        self._hand_on(row["kind"], text)
        if self._json:
            self._print(text)

    def _hand_on(self, kind: str, text: str) -> None:
        """Pass a row to the server and to the log."""
        if self._server is not None:
            self._server.send(kind, text)
        if self._log is not None:
            try:
                self._log.write(text + "\n")
                if kind != "match":
                    self._log.flush()
            except OSError as error:
                name, self._log = self._log.name, None
                self.unwritten = ends_early(name, error)
                self.say("file", f"{self.unwritten}; going on without it")

    def _print(self, *text: str) -> None:
        """Print lines at once; end the run in an orderly way if the reader has gone.

        A second signal ends it too, if the reader does not read.
        """
        try:
            if text:
                print(*text, sep="\n", flush=True)
        except (OSError, KeyboardInterrupt) as error:
            if isinstance(error, OSError) and error.errno not in (errno.EPIPE, errno.EIO):
                raise
            self.unread = True
            with Path(os.devnull).open("wb") as nowhere:
                os.dup2(nowhere.fileno(), sys.stdout.fileno())


@contextmanager
def open_view(
    as_json: bool,
    log: str | None,
    reference: ReferenceMap | None,
    server: MatchServer | None,
    line_s: float | None,
) -> Iterator[View]:
    """Open a view and its log until the block ends."""
    file = None if log is None else Path(log).open("w", encoding="utf-8")  # noqa: SIM115
    panel = None
    try:
        plain = as_json or is_quiet() or os.environ.get("TERM") == "dumb"
        if not plain and sys.stdout.isatty():
            live = Live("waiting for events", auto_refresh=False, transient=True)
            live.start(refresh=True)
            panel = Panel(live)
        yield View(as_json, file, reference, panel, server, line_s)
    finally:
        if panel is not None:
            panel.close()
        if file is not None:
            # every line was flushed when written, and failures were reported then
            with suppress(OSError):
                file.close()
