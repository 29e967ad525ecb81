"""Watches of a session: a silent or undecodable line, a host that falls behind, another place."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from edge_vpr.confidence import OFF_MAP_MISFIT, OFF_MAP_TEXT
from edge_vpr.events import Events
from edge_vpr.live.protocols import Decoder, Health
from edge_vpr.live.reader import LinkReader

#: Length of a silence that is reported.
SILENT_S = 1.0
#: Silence after which a device is greeted again, and interval of greetings.
GREET_S = 0.5
#: Bytes and events before a warning: more than the start of a protocol, or chance on a bad line,
#: can make undecodable.
SENSELESS_BYTES, SENSELESS_EVENTS = 8_192, 1_000
#: Time after which clocks of camera and host are compared from the start, because they drift apart.
_LAG_S = 300.0


class LineWatch:
    """Greets a silent device, and reports once when a line is silent, disconnected or undecodable.

    Parameters
    ----------
    say : callable
        Takes the kind and the text of a message, and `over`.
    """

    def __init__(self, reader: LinkReader, decoder: Decoder, say: Callable[..., None]) -> None:
        self._reader, self._decoder, self._say = reader, decoder, say
        self._heard_s = self._greeted_s = self._newest_s = time.monotonic()
        self._silent = self._closed = False
        self._remark = self._senseless = self._stranger = ""

    @property
    def silent_s(self) -> float:
        """Seconds since the newest bytes."""
        return time.monotonic() - self._newest_s

    def heard(self, at_s: float) -> None:
        """Note that bytes have arrived."""
        self._heard_s = self._newest_s = at_s
        if self._silent:
            self._silent = False
            self._say("stalled", f"bytes come again from {self._reader.address}", over=True)

    def look(self, *, nothing_came: bool) -> None:
        """Report what has changed since the last call."""
        if nothing_came:
            self._look_at_silence()
        decoder, reader, say = self._decoder, self._reader, self._say
        if not self._senseless and (senseless := _senseless_bytes(decoder.health)):
            self._senseless = senseless
            say("senseless", senseless)
        if decoder.remark != self._remark:
            self._remark = decoder.remark
            say("device", self._remark or "the device answers", over=not self._remark)
        if reader.remark != self._stranger:
            self._stranger = reader.remark
            say("sender", self._stranger or "another sender is heard", over=not self._stranger)

    def _look_at_silence(self) -> None:
        reader = self._reader
        now = time.monotonic()
        if bool(reader.lost_link) != self._closed:
            self._closed = not self._closed
            said = f"{reader.lost_link}; trying again" if self._closed else "open again"
            self._say("link", said, over=not self._closed)
            self._heard_s = now
        elif not self._closed and now - max(self._heard_s, self._greeted_s) > GREET_S:
            # the device may have started after the link was opened, or again; what it does not
            # read now is not waited for
            self._greeted_s = now
            reader.send(self._decoder.greeting(), timeout=0.0)
        if not (self._silent or self._closed or reader.ended) and (now - self._heard_s > SILENT_S):
            self._silent = True
            # a device that has not begun does not stall
            self._decoder.health.stalls += self._decoder.health.bytes > 0
            self._say("stalled", f"no bytes for {SILENT_S:g} s from {reader.address}")


class LagWatch:
    """Compares the clocks of camera and host, and reports when the host falls behind.

    Parameters
    ----------
    health : Health
        Gets the lag.
    limit_us : float
        Lag that is reported.
    say : callable
        Takes the kind and the text of a message, and `over`.
    live : bool
        Whether the sender goes on without waiting for the host.
    """

    def __init__(
        self, health: Health, limit_us: float, say: Callable[..., None], *, live: bool
    ) -> None:
        self._health, self._limit_us, self._say, self._live = health, limit_us, say, live
        self._behind = False
        self._newest_us, self._restarts = 0, -1
        self._stalls = 0  # until events were last matched in time
        self._since_s = 0.0
        # smallest differences of the clocks, of this stretch of time and of the one before
        self._least_us = self._before_us = math.inf

    def look(self, events: Events, reached_us: int, now_s: float) -> None:
        """Compare the time at which events were matched with that of the oldest of them."""
        health = self._health
        t_us = int(events.t[0]) if events.size else reached_us
        restarts = health.clock_resets + health.clock_jumps + health.device_resets
        if restarts != self._restarts or now_s - self._since_s > _LAG_S:
            before = self._least_us if restarts == self._restarts else math.inf
            self._restarts, self._since_s = restarts, now_s
            self._before_us, self._least_us = before, math.inf
        if t_us <= self._newest_us:
            return
        self._newest_us = t_us
        apart_us = 1e6 * now_s - t_us
        self._least_us = min(self._least_us, apart_us)
        lag_us = int(apart_us - min(self._least_us, self._before_us))
        health.lag_us = lag_us
        health.longest_lag_us = max(health.longest_lag_us, lag_us)
        if not self._behind and lag_us > self._limit_us:
            self._behind = True
            why = "the line stood still"
            if health.stalls == self._stalls:
                why += ", or is slower than the camera, or this machine is busy with something else"
            self._say("lag", f"events are matched {lag_us / 1e6:.1f} s late: {why}")
        elif lag_us < self._limit_us / 2:
            self._stalls = health.stalls
            if self._behind:
                self._behind = False
                self._say("lag", "events are matched in time again", over=True)

    def age_s(self, time_us: int, now_s: float) -> float:
        """Return how long ago something happened by the camera's clock; NaN if it is not known."""
        least_us = min(self._least_us, self._before_us)
        if not self._live or least_us == math.inf:
            return math.nan
        return max(0.0, now_s - (time_us + least_us) / 1e6)


class MisfitWatch:
    """Counts matches that are off the map, and reports once when they begin and when they end.

    Parameters
    ----------
    health : Health
        Gets their number.
    say : callable
        Takes the kind and the text of a message, and `over`.
    """

    def __init__(self, health: Health, say: Callable[..., None]) -> None:
        self._health, self._say = health, say
        self._off_map = False

    def look(self, misfits: Sequence[int]) -> None:
        """Take the misfits of matches, the newest last."""
        self._health.misfits += sum(misfit >= OFF_MAP_MISFIT for misfit in misfits)
        if not misfits:
            return
        newest = misfits[-1]
        if not self._off_map and newest >= OFF_MAP_MISFIT:
            self._off_map = True
            self._say(
                "misfit",
                f"{OFF_MAP_TEXT}: what is seen has not fitted the matched places for some windows",
            )
        elif self._off_map and newest < OFF_MAP_MISFIT // 2:
            self._off_map = False
            self._say("misfit", "what is seen fits the map again", over=True)


def nothing_valid(health: Health) -> str:
    """Return what to check if hardly any byte, or none at all, was valid; else empty text."""
    if not health.bytes:
        return "no bytes came: check that this is the camera's port, and that the camera is on"
    if not health.decoded_bytes:
        return f"none of {health.bytes:,} bytes are of this protocol: check protocol= and baud="
    return _senseless_bytes(health)


def _senseless_bytes(health: Health) -> str:
    """Return a warning if most bytes do not decode, or most events are off the sensor."""
    if health.skipped_bytes > SENSELESS_BYTES and (
        health.decoded == 0 or health.skipped_bytes > 9 * health.decoded_bytes
    ):
        return (
            f"{health.skipped_bytes:,} of {health.bytes:,} bytes are not of this protocol: check "
            "protocol= and baud="
        )
    if health.off_sensor > max(SENSELESS_EVENTS, health.events):
        return (
            f"{health.off_sensor:,} of {health.decoded:,} events are not on this sensor: check "
            "sensor=, or the map"
        )
    return ""
