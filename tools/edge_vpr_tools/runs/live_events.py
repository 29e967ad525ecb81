"""The loop of a live run: takes bytes, matches them, shows results, and watches the line."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from io import FileIO

from edge_vpr.events import Events
from edge_vpr.stream.health import Health
from edge_vpr.stream.link_reader import LinkReader
from edge_vpr.stream.live import LiveLocaliser, LiveResult
from edge_vpr_tools.output.live_view import SILENT_S, View, ends_early
from edge_vpr_tools.output.rerun_view import RerunView
from edge_vpr_tools.runs.live_odometer import OdometerReader

#: Bytes and events before a warning: more than the start of a protocol, or chance on a bad line,
#: can make undecodable.
SENSELESS_BYTES, SENSELESS_EVENTS = 8_192, 1_000


class LineWatch:
    """Reports once when a line becomes silent, is lost, or sends bytes that cannot be decoded.

    Parameters
    ----------
    reader : LinkReader
    live : LiveLocaliser
    view : View
        Is told.
    """

    def __init__(self, reader: LinkReader, live: LiveLocaliser, view: View) -> None:
        self._reader, self._decoder, self._view = reader, live.decoder, view
        self._heard_s = time.monotonic()
        self._silent = self._closed = False
        self._remark = self._senseless = self._stranger = ""

    def heard(self, at_s: float) -> None:
        """Note that bytes have arrived."""
        self._heard_s, self._silent = at_s, False

    def look(self, *, nothing_came: bool) -> None:
        """Report what has changed since the last call."""
        if nothing_came:
            self._look_at_silence()
        decoder, reader, view = self._decoder, self._reader, self._view
        if not self._senseless and (senseless := _senseless(decoder.health)):
            self._senseless = senseless
            view.say("senseless", senseless)
        if decoder.remark != self._remark:
            self._remark = decoder.remark
            view.say("device", self._remark or "the device answers", over=not self._remark)
        if reader.remark != self._stranger:
            self._stranger = reader.remark
            view.say("sender", self._stranger or "another sender is heard", over=not self._stranger)

    def _look_at_silence(self) -> None:
        reader, view = self._reader, self._view
        if bool(reader.lost_link) != self._closed:
            self._closed = not self._closed
            said = f"{reader.lost_link}; trying again" if self._closed else "open again"
            view.say("link", said, over=not self._closed)
        elif not (self._silent or self._closed or reader.ended) and (
            time.monotonic() - self._heard_s > SILENT_S
        ):
            self._silent = True
            self._decoder.health.stalls += 1
            view.say("stalled", f"no bytes for {SILENT_S:g} s from {reader.address}")


def live_events(
    reader: LinkReader,
    live: LiveLocaliser,
    view: View,
    raw: Sequence[FileIO],
    rerun: RerunView | None,
    odometer: OdometerReader | None,
    stopping: threading.Event,
) -> Iterator[Events]:
    """Yield the stream's events while it is matched and shown.

    Parameters
    ----------
    reader : LinkReader
    live : LiveLocaliser
    view : View
    raw : sequence of file
        Get the bytes as they came.
    rerun : RerunView or None
    odometer : OdometerReader or None
    stopping : threading.Event
        Ends the run when it is set.

    Yields
    ------
    Events
        As decoded.
    """
    begin_s, files = time.monotonic(), list(raw)
    watch = LineWatch(reader, live, view)
    health = live.decoder.health
    while not (stopping.is_set() or reader.ended or view.unread):
        chunk = reader.take(live.decoder.tick_s)
        result: LiveResult | None = None
        health.line_errors = reader.line_errors
        if chunk is not None:
            _write_raw(files, chunk.data, view)  # first, so that errors can be reproduced
            came_us = int((chunk.at_s - begin_s) * 1e6)
            result = live.feed(chunk.data, came_us, lost=chunk.lost, reopened=chunk.reopened)
            view.matches(result, time.monotonic() - chunk.at_s)
            watch.heard(chunk.at_s)
        if odometer is not None:
            odometer.look(live, view)
        watch.look(nothing_came=chunk is None)
        reader.send(live.decoder.to_send(time.monotonic()))
        if result is not None:
            if rerun is not None:
                rerun.show(result)
            if result.events.size:
                yield result.events
        view.tick(live)
    result = live.finish()
    view.matches(result, 0.0)
    if result.events.size:
        yield result.events


def _senseless(health: Health) -> str:
    """Warn if most bytes do not decode, or most events are off the sensor."""
    if health.skipped_bytes > SENSELESS_BYTES and (
        health.decoded == 0 or health.skipped_bytes > 9 * health.decoded_bytes
    ):
        return (
            f"{health.skipped_bytes:,} of {health.bytes:,} bytes are not of this protocol: check "
            "--protocol and --baud"
        )
    if health.off_sensor > max(SENSELESS_EVENTS, health.events):
        return (
            f"{health.off_sensor:,} of {health.decoded:,} events are not on this sensor: check "
            "--sensor, or the map"
        )
    return ""


def _write_raw(raw: list[FileIO], data: bytes, view: View) -> None:
    """Write bytes to all files; close a file that cannot be written."""
    for file in list(raw):
        left = memoryview(data)
        try:
            while left:
                left = left[file.write(left) :]
        except OSError as error:
            raw.remove(file)
            view.give_up(ends_early(str(file.name), error))
